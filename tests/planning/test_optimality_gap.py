"""How much a search can still gain: the best motion beside the least times of the joints."""

from __future__ import annotations

import math

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem, time_evenly
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.optimality_gap import OptimalityGap
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.search.goal_ends import GoalEnds

ALLOWANCE = 0.025  # s by which a proven bound may be below the least time: the certificate's allowances for samples
START, END = np.full(4, 0.1), np.array([0.9, 0.1, 0.1, 0.1])


def gap_of(robot: bp.Robot, times_least: float) -> tuple[OptimalityGap, float, float]:
    """The gap of a motion of one joint that takes so many times its least time, this time, and the least time [s].

    The least time is that of a trapezoid of the speed, or of a triangle if the velocity limit is not reached.
    """
    limits = build_problem(robot, scene(robot)).limits
    way, v, a = 0.8, float(limits.velocity[0]), float(limits.acceleration[0])
    least = way / v + v / a if way > v * v / a else 2.0 * math.sqrt(way / a)
    problem = build_problem(robot, scene(robot))
    world, ends = World(problem, seed=0, work=Work(EFFORTS["normal"])), GoalEnds(problem, START)
    ends.take([END], [problem.goals[0]])
    motion = time_evenly(JointCurve.straight(START, END, 12), times_least * least)
    incumbent = Incumbent(world, time=0.0)
    incumbent.best = FoundMotion(motion, motion.duration, problem.goals[0], "straight")
    return OptimalityGap(world, START, ends, incumbent), motion.duration, least


def scene(robot: bp.Robot) -> bp.Scene:
    joints = [dict(zip(robot.joint_names, q.tolist(), strict=True)) for q in (START, END)]
    return bp.scene_from_dict({"version": 1, "start": {"joints": joints[0]}, "task": {"goal": {"joints": joints[1]}}})


@pytest.mark.parametrize(("times", "near"), [(1.05, True), (1.15, False), (3.0, False)])
def test_a_motion_is_near_the_best_possible_up_to_a_tenth_above_the_least_time(
    planar4: bp.Robot, times: float, near: bool
) -> None:
    gap, duration, least = gap_of(planar4, times)
    assert least - ALLOWANCE < gap.least_time() <= least
    assert gap.is_near() == near
    assert gap.is_within(times * 1.02)
    assert not gap.is_within(times * 0.98)
    assert gap.is_above(1e9) == near  # no bound was proven: it counts as 0
    if near:
        assert gap.longest_worth(0) == duration


def test_routes_are_worth_less_than_the_best_where_much_can_be_gained(planar4: bp.Robot) -> None:
    """Three times the least time, to which the bound is near; the cost is the time."""
    gap, duration, _ = gap_of(planar4, 3.0)
    assert gap.dearest_worth() == pytest.approx(1.4 * duration)
    assert not gap.is_near()
    assert gap.is_above(2.0)
    assert not gap.is_above(4.0)
    longest = [gap.longest_worth(dull) for dull in range(4)]
    assert longest[2] == duration
    assert longest[1] == longest[3]
    # equal steps of the logarithm, to a third of the best at most
    assert longest[0] ** 2 == pytest.approx(longest[1] * duration)
    assert duration * 3.2**-0.5 < longest[1] < duration * 2.5**-0.5


def test_a_route_may_cost_little_more_than_a_motion_that_is_nearly_the_fastest(planar4: bp.Robot) -> None:
    """Twice the excess of about 5 % over the least time."""
    gap, duration, least = gap_of(planar4, 1.05)
    low, high = (duration / time - 1.0 for time in (least, least - ALLOWANCE))
    assert 1.0 + 2.0 * low <= gap.dearest_worth() / duration < 1.0 + 2.0 * high
