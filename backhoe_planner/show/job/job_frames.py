"""A job as frames for display: the motions of all cycles one after the other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from backhoe_planner.job import CycleLeg, JobPlan
from backhoe_planner.show.drawing.timeline import FRAME, ITSELF, MOST_FRAMES, CriticalPoint, Timeline, frames_at

WAIT = "wait"  # the name of a part in which the machine waits for the next truck


@dataclass(frozen=True)
class Part:
    """One leg of a cycle on the time axis of the whole job.

    Attributes
    ----------
    name: name of the leg, or `WAIT`.
    cycle: number of the cycle, from 1.
    begin, end: times from the beginning of the job [s].
    """

    name: str
    cycle: int
    begin: float
    end: float


@dataclass(frozen=True, eq=False)
class JobFrames:
    """All frames of a job, at regular times from 0.

    Attributes
    ----------
    timeline: the frames; its obstacles are those of all legs.
    parts: the legs and waits, one after the other.
    """

    timeline: Timeline
    parts: tuple[Part, ...]


def job_parts(plan: JobPlan) -> tuple[Part, ...]:
    """When each leg is driven, and when the machine waits for a truck."""
    truck, parts, now = plan.job.dump.truck, [], 0.0
    for cycle, following in zip_longest(plan.cycles, plan.cycles[1:]):
        for leg in cycle.legs:
            parts.append(Part(leg.name, cycle.number, now, now + leg.duration))
            now += leg.duration
        if truck is not None and following is not None and following.truck != cycle.truck:
            parts.append(Part(WAIT, cycle.number, now, now + truck.exchange))
            now += truck.exchange
    return tuple(parts)


def job_frames(plan: JobPlan) -> JobFrames:
    """The frames of a job with at least one cycle; a long job has fewer frames a second."""
    parts = job_parts(plan)
    end = parts[-1].end
    time = np.linspace(0.0, end, min(int(np.ceil(end / FRAME)) + 1, MOST_FRAMES))
    legs = iter([leg for cycle in plan.cycles for leg in cycle.legs])
    pieces: list[Timeline] = []
    leg: CycleLeg | None = None
    for part in parts:
        last = part is parts[-1]
        own = time[(time >= part.begin) & ((time < part.end) | last)]
        if part.name == WAIT:
            assert leg is not None
            pieces.append(frames_at(leg.problem, leg.trajectory, np.full(len(own), leg.trajectory.time[-1])))
            continue
        leg = next(legs)
        begin, most = leg.trajectory.time[0], leg.trajectory.time[-1]
        if len(own):
            pieces.append(frames_at(leg.problem, leg.trajectory, np.minimum(own - part.begin + begin, most)))
    return JobFrames(_joined(pieces, time), parts)


def _joined(pieces: list[Timeline], time: np.ndarray) -> Timeline:
    names = list(dict.fromkeys(name for piece in pieces for name in piece.obstacles if name != ITSELF))
    if any(ITSELF in piece.obstacles for piece in pieces):
        names.append(ITSELF)
    nearest: list[tuple[CriticalPoint | None, ...]] = []
    for piece in pieces:
        column = {name: index for index, name in enumerate(piece.obstacles)}
        order = [column.get(name) for name in names]
        nearest += [tuple(None if index is None else row[index] for index in order) for row in piece.nearest]
    return Timeline(
        time=time,
        q=np.vstack([piece.q for piece in pieces]),
        tip=np.vstack([piece.tip for piece in pieces]),
        poses=np.concatenate([piece.poses for piece in pieces]),
        obstacles=tuple(names),
        nearest=tuple(nearest),
    )
