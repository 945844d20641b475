"""The pace of a plan at which the machine can always stop straight ahead.

A servo brakes all joints in proportion, so it stops on a straight line of the joints. A plan that turns beside an
obstacle, at the edge of what `keep` allows, or near the limit of a joint, leaves room for its own curve alone: at full
speed the straight line ends beyond, and the servo would leave the plan there. With the pace s the line is s^2 times
as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.live.braking.joint_bounds import BRAKING
from backhoe_planner.live.detours.reference import Reference
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.machine import JointLimits, Robot
from backhoe_planner.motion import Keep, Trajectory
from backhoe_planner.planning import Plan
from backhoe_planner.site import ClearanceScreen, Obstacle, Proximity

_STEP = 0.02  # s between the moments of the plan that are looked at; chosen, the pace changes little within it
_PACES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)  # that are tried; chosen, the last is taken in any case
_ALONG = (0.33, 0.67, 1.0)  # parts of the braking line that are looked at; the servo proves all of it
_CHANGES = 0.5  # part of the acceleration for changes of the pace; the rest is for the plan's own
_ROUNDING = 1e-6  # rad or m
_TOLD = 10  # moments in a row, 0.2 s, for which the same cause is told; chosen, naming an obstacle takes 1 ms


class StopRule(NamedTuple):
    """What must hold where the machine stops straight ahead.

    Attributes
    ----------
    keep: the conditions to be kept.
    screen: for the static obstacles; None if only the conditions count.
    proximity: of the same obstacles, to name the one that is in the way; None if none is to be named.
    """

    keep: Keep
    screen: ClearanceScreen | None
    proximity: Proximity | None = None


class PlanPart(NamedTuple):
    """What holds from a moment of a plan on.

    Attributes
    ----------
    begins: the moment [s].
    stop: what must hold where the machine stops; None without conditions, where it may slide along obstacles instead.
    """

    begins: float
    stop: StopRule | None


class BrakingPace:
    """The greatest pace at every moment of a plan; 1 in parts without a rule for stopping.

    Parameters
    ----------
    reference: the plan.
    limits: of the joints.
    parts: of the plan, by the time at which they begin.
    """

    def __init__(self, reference: Reference, limits: JointLimits, parts: Sequence[PlanPart]) -> None:
        if reference.end <= 0.0:
            self._time, self._pace = np.zeros(1), np.ones(1)
            self._own = self._pace
            return
        count = max(round(reference.end / _STEP), 1) + 1
        self._time = np.linspace(0.0, reference.end, count)
        q = np.array([reference.at(time) for time in self._time.tolist()])
        v = np.gradient(q, self._time, axis=0)
        line = 0.5 * v * np.max(np.abs(v) / (BRAKING * limits.acceleration), axis=1)[:, None]
        part = np.searchsorted([one.begins for one in parts], self._time, side="right") - 1
        pace = np.ones(count)
        for index, one in enumerate(parts):
            if one.stop is None:
                continue
            rows = np.flatnonzero((part == index) & (np.abs(line).max(axis=1) > _ROUNDING))
            pace[rows] = _PACES[-1]
            clear = np.zeros(count, dtype=bool)
            if one.stop.screen is not None:
                clear[rows] = one.stop.screen.keeps(q[rows])  # what is on the plan itself is left to the servo
            for slower in _PACES[:-1]:
                fits = _fit(slower**2 * line, rows, q, clear, limits, one.stop)
                pace[rows[fits]] = slower
                rows = rows[~fits]
        self._own, self._pace = pace, _changing_slowly(pace, self._time, v, limits)
        self._q, self._line, self._rules, self._limits = q, line, [parts[index].stop for index in part], limits
        self._causes: dict[int, str] = {}

    def cause(self, time: float) -> str:
        """What the machine would violate where it stopped straight ahead from the full pace at `time` [s], in words.

        It is told for the place that determines the pace there. Empty if nothing does.
        """
        rows = np.flatnonzero((self._own < 1.0) & (self._own <= self._pace + _ROUNDING))
        if len(rows) == 0:
            return ""
        row = int(rows[int(np.abs(self._time[rows] - time).argmin())])
        told = self._causes.get(row // _TOLD)
        if told is None:
            told = self._causes[row // _TOLD] = self._violated(row)
        return told

    def _violated(self, row: int) -> str:
        rule, limits = self._rules[row], self._limits
        if rule is None:
            return ""
        q = self._q[row]
        places = q + np.array(_ALONG)[:, None] * self._line[row]
        if not _kept_along(rule.keep, q[None], places).all():
            return "`keep`"
        if ((places < limits.lower - _ROUNDING) | (places > limits.upper + _ROUNDING)).any():
            return "a joint limit"
        found = [] if rule.proximity is None else [rule.proximity.tightest(place) for place in places]
        nearest = min((one for one in found if one is not None), key=lambda one: one.margin, default=None)
        return "a clearance" if nearest is None else f"the clearance of {nearest.link} from {nearest.name}"

    def at(self, time: float) -> float:
        """The greatest pace at `time` [s] of the plan, above 0 and at most 1."""
        return float(np.interp(time, self._time, self._pace))


def parts_of(servo: Servo, plan: Plan | Trajectory, keep: Keep | None) -> list[PlanPart]:
    """What holds in each leg of a plan, or along all of it: conditions, and the static obstacles present now."""
    if isinstance(plan, Plan) and plan.legs:
        return [_part(leg.begins, leg.problem.keep, leg.problem.robot, leg.problem.obstacles) for leg in plan.legs]
    return [_part(0.0, keep, servo.robot, servo.snapshot())]


def _part(begins: float, keep: Keep | None, robot: Robot, obstacles: Sequence[Obstacle]) -> PlanPart:
    if keep is None:
        return PlanPart(begins, None)
    still = [one for one in obstacles if not one.moves and one.appears_at <= 0.0]
    proximity = Proximity(robot, still)
    return PlanPart(begins, StopRule(keep, ClearanceScreen(proximity), proximity))


def _fit(line: Matrix, rows: Indices, q: Matrix, clear: Flags, limits: JointLimits, rule: StopRule) -> Flags:
    """(R,) whether the braking lines (K, n) of `rows` (R,), from q (K, n), keep the limits and the rule.

    clear: (K,) whether the plan itself keeps its clearances there.
    """
    fits = np.ones(len(rows), dtype=bool)
    for along in reversed(_ALONG):
        here = np.flatnonzero(fits)
        places = q[rows[here]] + along * line[rows[here]]
        within = np.all((places >= limits.lower - _ROUNDING) & (places <= limits.upper + _ROUNDING), axis=1)
        within &= _kept_along(rule.keep, q[rows[here]], places)
        if rule.screen is not None:
            asked = np.flatnonzero(within & clear[rows[here]])
            within[asked] = rule.screen.keeps(places[asked])
        fits[here] = within
    return fits


def _kept_along(keep: Keep, q: Matrix, places: Matrix) -> Flags:
    """(K,) whether `places` (K, n) break no condition more than q does, (K, n) or (1, n)."""
    kept = np.ones(len(places), dtype=bool)
    for condition in keep.conditions:
        least = np.minimum(condition.margins(condition.values(q)), 0.0) - _ROUNDING
        kept &= condition.margins(condition.values(places)) >= least
    return kept


def _changing_slowly(pace: Vector, time: Vector, v: Matrix, limits: JointLimits) -> Vector:
    """(K,) the pace, lowered where it would change faster than the joints allow at the rates `v` (K, n) of the plan."""
    with np.errstate(divide="ignore"):
        change = 2.0 * _CHANGES * np.min(limits.acceleration / np.abs(v), axis=1)  # of the squared pace, 1/s
    squared = pace**2
    for rows, step in ((range(len(pace) - 2, -1, -1), 1), (range(1, len(pace)), -1)):
        for row in rows:
            beside = row + step
            squared[row] = min(squared[row], squared[beside] + change[row] * abs(time[beside] - time[row]))
    return np.asarray(np.sqrt(squared))
