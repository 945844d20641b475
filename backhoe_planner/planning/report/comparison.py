"""How much a plan saves: its cost compared with that of the local law on the same path.

The law follows the same path from the same joints. Its motion is timed like the plan's, as fast as the scene's
speed, the limits and the drive allow, with its corners rounded like the plan's. So the two
motions differ only in the use of the redundancy. If the law gets stuck at a joint limit,
the plain pseudo-inverse is used instead, v = J^+ xdot, which ignores limits: its cost is
given together with the limit that it breaks. Such a motion cannot be timed within the
limits, so its tip is where the plan's tip is at every moment.

A plan may move far to begin in a cheap posture. So two costs are given: of the path alone,
and of the whole motion. The law begins where the plan does, so its approach is the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, computed_field, model_validator

from backhoe_planner.arrays import Vector
from backhoe_planner.files.records import Figure, Record
from backhoe_planner.machine import Kinematics, movable_rows
from backhoe_planner.motion import Problem, TipPath, Trajectory, drive_of, retime, trajectory_costs
from backhoe_planner.planning.paths.local_resolution import has_open_range, resolve_along, sample_stations
from backhoe_planner.planning.stretches.monotone_curve import monotone_curve
from backhoe_planner.planning.stretches.stretch import LawWay, Stretch
from backhoe_planner.planning.stretches.timed_stretch import time_rounded
from backhoe_planner.proof import Certificate
from backhoe_planner.site import Obstruction, Proximity

_EXACT = 1e-9  # m and rad: chosen; with less error the tip counts as on the path
_CORRECTIONS = 12  # of Newton's iteration; chosen: it doubles the digits with each
_FURTHEST = 1.0  # rad or m: chosen; if a joint moves further in a step, the arm is stretched out
_NEARER = 1e-6  # m by which the tip must be off the path's beginning to count as having left it
_AS_MUCH = 0.5  # %: a smaller saving is rounded to none
_BREAKS = 1e-6  # rad or m beyond a limit: far above rounding errors


def _obstruction(found: Any) -> Any:
    """An obstruction from the words with which older files say what the law breaks."""
    if not isinstance(found, str):
        return found
    if found.startswith("limit of joint "):
        return Obstruction.joint_limit(found.removeprefix("limit of joint "))
    return Obstruction("obstacle", found.removeprefix("clearance: "), "", 0.0, 0.0)


def _saving(value: float, law: float | None) -> float | None:
    """By how much `value` is below what the law needs [%]."""
    return None if law is None or not law > 0.0 else 100.0 * (1.0 - value / law)


class LawComparison(Record):
    """The cost of a plan along its path compared with that of the local law."""

    name: str
    """Of the objective."""
    value: Figure
    """Cost of the plan's motion, from where it begins to follow the path."""
    whole: Figure
    """Cost of the plan's motion from its start, the approach to the path included."""
    law: float | None = None
    """Cost of the law's motion; None if the law cannot follow the path."""
    law_breaks: Annotated[Obstruction | None, BeforeValidator(_obstruction)] = None
    """What the law comes too near to, or the joint whose limit it breaks; None if it keeps everything."""

    @model_validator(mode="before")
    @classmethod
    def _compute_anew(cls, content: Any) -> Any:
        """Ignore the values that a file gives for computed properties."""
        if not isinstance(content, Mapping):
            return content
        return {key: value for key, value in content.items() if key not in cls.model_computed_fields}

    @computed_field  # type: ignore[prop-decorator]
    @property
    def saving_percent(self) -> float | None:
        """By how much `value` is below `law`, in percent of `law`; None if there is nothing to compare with."""
        return _saving(self.value, self.law)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def law_whole(self) -> float | None:
        """Cost of the plan's approach and the law's motion after it."""
        return None if self.law is None else self.whole - self.value + self.law

    @computed_field  # type: ignore[prop-decorator]
    @property
    def saving_percent_whole(self) -> float | None:
        """By how much `whole` is below `law_whole`, in percent of it; None if there is nothing to compare with."""
        return _saving(self.whole, self.law_whole)


def describe_saving(percent: float, *, law: str = "") -> str:
    """A plan's cost compared with the law's, from its saving [%]: ``95 % less``, or ``as much``.

    With words for the law's cost, such as ``the local law's``, it is ``95 % less than the local law's``.
    """
    if abs(percent) < _AS_MUCH:
        return f"as much as {law}" if law else "as much"
    words = f"{abs(percent):.0f} % {'less' if percent >= 0.0 else 'more'}"
    return f"{words} than {law}" if law else words


@dataclass(frozen=True, eq=False)
class Comparison:
    """A plan's motion compared with the law's.

    Attributes
    ----------
    figures: the cost of both.
    begun: when the plan begins to follow the path [s].
    law_motion: the law's motion along the path, with time from 0; None if the law cannot follow it.
    """

    figures: LawComparison
    begun: float
    law_motion: Trajectory | None


def compare_with_law(
    problem: Problem, trajectory: Trajectory, certificate: Certificate, *, law: LawWay | None = None
) -> Comparison | None:
    """A motion along the scene's path compared with the law's; None if the motion does not follow a path.

    Parameters
    ----------
    law: how the law follows a path, if that is known; used if it is this path, from the same joints.
    """
    path = problem.path
    if path is None or len(trajectory) < 3 or not certificate.tracking.done:
        return None
    kinematics = Kinematics(problem.robot)
    motion, begun = part_on_path(path, trajectory, certificate.tracking.approach_time, kinematics=kinematics)
    if len(motion) < 3:
        return None
    moved, breaks = None, None
    # with detours the path itself is blocked; where the tip stands, arc lengths do not say what to compare
    if not certificate.detours and not path.stands:
        moved, breaks = _along_by_law(problem, path, motion, begun, law, kinematics=kinematics)
    name = problem.objective.name
    value, whole = (trajectory_costs(problem, way)[name] for way in (motion, trajectory))
    beside = None if moved is None else trajectory_costs(problem, moved)[name]
    figures = LawComparison(name=name, value=value, whole=whole, law=beside, law_breaks=breaks)
    return Comparison(figures, begun, moved)


def _along_by_law(
    problem: Problem, path: TipPath, motion: Trajectory, begun: float, known: LawWay | None, *, kinematics: Kinematics
) -> tuple[Trajectory | None, Obstruction | None]:
    """The law's motion to compare with `motion`, None if the law cannot follow the path; and what the law breaks."""
    proximity, fastest = Proximity(problem.robot, problem.obstacles), None
    if known is not None and known.path is path and np.array_equal(known.stretch.q[0], motion.q[0]):
        law, fastest = known.stretch, known.fastest
    else:
        law = resolve_along(problem, path, 0.0, motion.q[0], proximity=proximity, kinematics=kinematics, time=begun)
    breaks = law.obstruction
    if breaks is None:
        if fastest is None:
            fastest = time_rounded(problem, path, law, proximity=proximity, time=begun).motion
        return retime(fastest, problem.limits, drive=drive_of(problem)), None
    if problem.objective.is_time or breaks.kind != "joint":
        return None, breaks
    blind = least_norm_resolution(problem, path, motion.q[0], kinematics=kinematics)
    return None if blind is None else law_motion(path, blind, motion, kinematics=kinematics), breaks


def part_on_path(
    path: TipPath, trajectory: Trajectory, begun: float, *, kinematics: Kinematics
) -> tuple[Trajectory, float]:
    """The part of a motion that follows the path, with time from 0, and when it begins [s].

    An approach comes within the tolerance before it ends. After an approach the part therefore
    begins where the tip is nearest to the beginning of the path.

    Parameters
    ----------
    begun: when the tip is first within the tolerance of the beginning [s].
    """
    first = int(np.searchsorted(trajectory.time, begun - 1e-9))
    if first > 0:
        off = []
        for q in trajectory.q[first:]:
            off.append(float(np.linalg.norm(kinematics.at(q).tip_position - path(0.0))))
            if off[-1] > 2.0 * off[0] + _NEARER:
                break
        first += len(off) - 1 - int(np.argmin(off[::-1]))  # the tip may stand there for a step
    time = trajectory.time[first:] - trajectory.time[first]
    return Trajectory.from_steps(time, trajectory.q[first:]), float(trajectory.time[first])


def law_motion(path: TipPath, law: Stretch, motion: Trajectory, *, kinematics: Kinematics) -> Trajectory:
    """The law's resolution of the whole path, timed so that the tip is at every moment where it is in `motion`."""
    stations = stations_of(path, motion, kinematics=kinematics)
    marks = np.searchsorted(law.stations, path.stations - 1e-9)
    q = np.empty_like(motion.q)
    for first, last in pairwise(marks.tolist()):
        if last <= first:
            continue
        low, high = law.stations[first], law.stations[last]
        rows = (stations >= low - 1e-9) & (stations <= high + 1e-9)
        leg = slice(first, last + 1)
        at, ends = np.clip(stations[rows], low, high), np.array([0, last - first])
        q[rows] = monotone_curve(law.stations[leg], law.q[leg], at, legs=ends)
    return Trajectory.from_steps(motion.time, q)


def stations_of(path: TipPath, motion: Trajectory, *, kinematics: Kinematics) -> Vector:
    """(T,) arc lengths of the tip [m] in a motion that follows the whole path."""
    tips = np.array([kinematics.at(q).tip_position for q in motion.q])
    gone = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tips, axis=0), axis=1))))
    return np.asarray(gone * (path.length / max(float(gone[-1]), 1e-12)))


def least_norm_resolution(problem: Problem, path: TipPath, q: Vector, *, kinematics: Kinematics) -> Stretch | None:
    """The whole path resolved by the pseudo-inverse alone, which breaks limits and ignores obstacles.

    Parameters
    ----------
    q: (n,) joints with the tip on the beginning of the path [rad or m].

    Returns
    -------
    The stretch; its `obstruction` is the first joint that breaks a limit. None if the
    arm is stretched out before the end.
    """
    stations = sample_stations(path, 0.0)
    found = [np.array(q, dtype=float)]
    broken: Obstruction | None = None
    limits = problem.limits
    for s in stations[1:].tolist():
        target, joints = path.target(s), found[-1]
        for _ in range(_CORRECTIONS):
            at = kinematics.at(joints)
            J, error = target.jacobian(at), target.error(at)
            rows = movable_rows(J)
            if has_open_range(target) and target.pitch_excess(at.pitch) == 0.0:
                rows &= np.array([True, True, True, False])
            if float(np.max(np.abs(error[rows]), initial=0.0)) < _EXACT:
                break
            joints = joints + np.linalg.lstsq(J[rows], error[rows], rcond=None)[0]
            if np.max(np.abs(joints - found[-1])) > _FURTHEST:
                return None
        else:
            return None
        found.append(joints)
        over = np.maximum(limits.lower - joints, joints - limits.upper)
        if broken is None and float(np.max(over)) > _BREAKS:
            worst = int(np.argmax(over))
            broken = Obstruction.joint_limit(problem.robot.joint_names[worst], -float(over[worst]))
    return Stretch(stations, np.array(found), broken)
