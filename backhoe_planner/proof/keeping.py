"""The least margin of every condition to be kept, over a whole continuous motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Vector
from backhoe_planner.machine import tip_travel_bound
from backhoe_planner.motion import KEPT_TO, Condition, Problem, Trajectory

_RESOLUTION = 1e-3  # rad or m by which a proven margin may be below the measured one; chosen, 0.06 degrees
_FINEST = 1e-6  # part of a segment that is not halved again; chosen, its ends are a few nanometres apart
_MOST = 200_000  # measurements for one condition; chosen, some seconds


@dataclass(frozen=True)
class KeepUse:
    """The least margin of one condition to be kept.

    Attributes
    ----------
    name: ``pitch``, ``above``, ``below``, ``rotation`` or ``tilt``, as in the scene file.
    margin: proven lower bound of the margin over the whole motion [unit], less what the tracking
        error can take; negative if the condition is not kept, or not proven to be.
    value: the pitch, the tip's height or the angle from the required orientation or direction at that time [unit].
    time: the time of the least margin [s].
    unit: ``rad`` or ``m``.
    words: the sentence that gives the value and what is allowed.
    leg: name of the leg of a sequence to which it belongs; empty without a sequence.
    """

    name: str
    margin: float
    value: float
    time: float
    unit: str
    words: str
    leg: str = ""

    @property
    def kept(self) -> bool:
        """Whether the condition holds over the whole motion."""
        return self.margin >= -KEPT_TO

    @property
    def left(self) -> float:
        """The margin as it is reported [unit]: 0 if rounding alone takes it below 0."""
        return max(self.margin, 0.0) if self.kept else self.margin


def keep_uses(problem: Problem, trajectory: Trajectory) -> tuple[KeepUse, ...]:
    """The least margin of every condition, at the samples and between them; empty if there are no conditions."""
    if problem.keep is None:
        return ()
    travel = tip_travel_bound(problem.robot, trajectory.q)
    return tuple(_least(condition, trajectory, travel, problem.begins) for condition in problem.keep.conditions)


def _least(condition: Condition, trajectory: Trajectory, travel: Vector, begins: float) -> KeepUse:
    """The least margin of a condition; the sentence gives its time on a clock on which the motion `begins` then [s]."""
    q, time = trajectory.q, trajectory.time
    values = condition.values(q)
    margins = condition.margins(values)
    row = int(np.argmin(margins))
    least, value, moment, proven = float(margins[row]), float(values[row]), float(time[row]), float(margins[row])
    delta, segment = np.diff(q, axis=0), np.arange(len(q) - 1)
    begin, end = np.zeros(len(segment)), np.ones(len(segment))
    before, after = values[:-1], values[1:]
    looks = 0
    while len(segment):
        looks += len(segment)
        bound = condition.lower_bounds(before, after, (end - begin)[:, None] * delta[segment], travel)
        proven = min(proven, float(np.min(bound, initial=np.inf, where=~_open(bound, least))))
        open_ = _open(bound, least)
        finest = (end - begin <= _FINEST) | (looks > _MOST)
        if bool(np.any(open_ & finest)):
            worst = int(np.argmin(np.where(open_ & finest, bound, np.inf)))
            proven = min(proven, float(bound[worst]))
            if proven < -KEPT_TO <= least:
                moment = float(time[segment[worst]])
                words = f"it is not proven that {condition.name} is kept at {begins + moment:.2f} s"
                return KeepUse(
                    condition.name, proven, condition.absolute(float(before[worst])), moment, condition.unit, words
                )
        rows = np.flatnonzero(open_ & ~finest)
        segment, begin, end, before, after = segment[rows], begin[rows], end[rows], before[rows], after[rows]
        middle = 0.5 * (begin + end)
        between = condition.values(q[segment] + middle[:, None] * delta[segment]) if len(rows) else np.zeros(0)
        left = condition.margins(between)
        if len(left) and float(np.min(left)) < least:
            worst = int(np.argmin(left))
            least, value = float(left[worst]), float(between[worst])
            moment = float(time[segment[worst]] + middle[worst] * (time[segment[worst] + 1] - time[segment[worst]]))
        begin, end = np.append(begin, middle), np.append(middle, end)
        before, after = np.append(before, between), np.append(between, after)
        segment = np.tile(segment, 2)
    margin = min(least, proven)
    words = condition.describe(value, f" at {begins + moment:.2f} s")
    return KeepUse(condition.name, margin, condition.absolute(value), moment, condition.unit, words)


def _open(bound: Vector, least: float) -> Flags:
    """(P,) which bounds are too weak: below the least measured margin by more than the resolution, or below 0 alone."""
    enough = least - _RESOLUTION
    return np.asarray(bound < (enough if least < -KEPT_TO else max(enough, -KEPT_TO)))
