"""Joins legs without a stop between them, if both allow it.

The motion may pass the point between two legs at a distance that both tolerate: the tolerance of a goal, or that
of a path. A joint is accepted only if it is proven: each leg on its own part, and both of them during the time in
which one has begun while the other still slows down, with the payload, soil, obstacles and conditions of each.

Where the motion stops, the sample between two legs has the mean of the accelerations with which one ends and the other
begins. Each may be too much with the payload of the other: then the machine rests there for two samples.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.machine import BatchKinematics, Kinematics
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, append_motion, overlap, slow_where_needed
from backhoe_planner.planning.sequence.leg import DoneLeg, join
from backhoe_planner.proof import certify_motion, machine_uses

_PART = 0.5  # part of a leg that may overlap with another at either end; chosen
_SHORTEST = 0.06  # s; chosen: three samples; a shorter overlap gains hardly anything
_HALVINGS = 7  # of the overlap time of two legs; chosen: finds it to a hundredth
_SHARES = (1.0, 0.6, 0.3)  # of the longest time that the tolerance allows, tried in turn; chosen
_RESTS = 2  # samples, so that neither acceleration counts at the sample in their middle
_SPARE = 0.9  # part of a tolerance that is used; chosen: no sample is exactly where the tip is nearest


def go_over(legs: Sequence[DoneLeg]) -> Trajectory:
    """The whole motion of planned legs, with a stop between two of them only if it is needed.

    If anything moves or appears, every leg stops, because it was planned for the time at which it begins: the machine
    rests before a leg that was planned for later.
    """
    stops = any(leg.problem.is_dynamic for leg in legs)
    whole, free_from = replace(join([legs[0].motion]), begins=(0,)), 0.0
    for before, leg in itertools.pairwise(legs):
        motion = join([leg.motion])  # with at least two samples
        found = None if stops else _without_stop(whole, before, leg, motion, free_from)
        if found is None:
            planned = leg.problem.begins - before.problem.begins - before.motion.duration  # s between them
            rests = (_RESTS if planned > 0.5 * SAMPLE_PERIOD else 0) if stops else rests_between(before, leg)
            joined = _after_a_stop(whole, motion, rests)
            found = joined, float(joined.time[joined.begins[-1]])
        whole, free_from = found
    return whole


def rests_between(before: DoneLeg, leg: DoneLeg) -> int:
    """For how many samples the machine has to rest if it stops between two legs, to keep the limits; 0 if in vain."""
    first, second = replace(join([before.motion]), begins=(0,)), join([leg.motion])

    def broken(rests: int) -> int:
        return _broken_limits(_after_a_stop(first, second, rests), before.problem, leg.problem)

    at_once = broken(0)
    return _RESTS if at_once and broken(_RESTS) < at_once else 0


def _after_a_stop(whole: Trajectory, motion: Trajectory, rests: int) -> Trajectory:
    """The whole motion with one more leg, which begins in the middle of so many samples at rest."""
    joined = append_motion(whole, motion, rest=[SAMPLE_PERIOD * number for number in range(1, rests + 1)])
    return replace(joined, begins=(*whole.begins, len(whole) - 1 + rests // 2))


def _broken_limits(motion: Trajectory, first: Problem, second: Problem) -> int:
    """How many limits of joints and drive its last two legs break, each on its own part of the motion."""
    begun, meet, last = *motion.begins[-2:], len(motion) - 1
    uses = machine_uses(first, motion.part(begun, meet)) + machine_uses(second, motion.part(meet, last))
    return sum(use is not None and not use.kept for use in uses)


def _without_stop(
    whole: Trajectory, before: DoneLeg, leg: DoneLeg, motion: Trajectory, free_from: float
) -> tuple[Trajectory, float] | None:
    """The whole motion with one more leg, and when the overlap ends [s]; None if the motion must stop before it."""
    first, second = before.problem, leg.problem
    if not (before.may_go_over and leg.may_go_over):
        return None
    longest = _PART * min(whole.duration - free_from, motion.duration)
    kinematics = BatchKinematics(first.robot)
    at_end = Kinematics(first.robot).at(whole.q[-1])
    off_goal = min((goal.distances(at_end)[0] for goal in first.goals), default=0.0)
    allowed = _SPARE * min(_tolerance(first) - off_goal, _tolerance(second, at_end=False))
    corner = kinematics.at(whole.q[-1:]).tip_position[0]

    def nearest(joined: Trajectory, shared: slice) -> tuple[float, int]:
        """The distance at which the tip passes the end of the leg before [m], and the sample."""
        away = np.linalg.norm(kinematics.at(joined.q[shared]).tip_position - corner, axis=1)
        row = int(np.argmin(away))
        return float(away[row]), shared.start + row

    def off(duration: float) -> float:
        return nearest(*overlap(whole, motion, duration))[0]

    low, high = (longest, longest) if longest > 0.0 and off(longest) <= allowed else (0.0, longest)
    for _ in range(_HALVINGS if high > low else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if off(middle) <= allowed else (low, middle)
    for share in _SHARES:
        duration = share * low
        if duration < _SHORTEST:
            return None
        slower = slow_where_needed(*overlap(whole, motion, duration), first.limits)
        if slower is None or slower[0].duration >= whole.duration + motion.duration:
            continue
        joined, shared = slower
        joined = replace(joined, begins=(*whole.begins, nearest(joined, shared)[1]))
        if _is_proven(joined, shared, first, second):
            return joined, float(joined.time[shared.stop - 1])
    return None


def _tolerance(problem: Problem, *, at_end: bool = True) -> float:
    """At what distance the tip may pass the end, or the beginning, of a leg [m]."""
    path = problem.scene.task.path
    if problem.path is not None and path is not None:
        return path.tolerance
    if not at_end:
        return np.inf
    return min(goal.allowed_off for goal in problem.goals)


def _is_proven(motion: Trajectory, shared: slice, first: Problem, second: Problem) -> bool:
    """Whether both legs are proven on their own parts, and both during their overlap."""
    begun, meet, last = motion.begins[-2], motion.begins[-1], len(motion) - 1
    parts = [(first, begun, meet, len(motion.begins) > 2), (second, meet, last, True)]
    for problem, low, high, moved in parts:
        part = motion.part(low, high)
        own = problem.beginning(part.q[0]) if moved else problem
        if not certify_motion(own, part).verified:
            return False
    for problem in (first, second):
        both = certify_motion(problem, motion.part(max(shared.start - 1, 0), shared.stop - 1))
        if not (both.safe and all(use.kept for use in both.keep)):
            return False
    return True
