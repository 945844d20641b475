"""Fast motions that come before the search for another cost, and how long a motion may take by them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import Problem, build_problem, motion_cost, time_evenly
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.allowed_time import bound_for_allowed_time
from backhoe_planner.planning.goals.fast_motions import FastMotions, fast_motions, in_least_time
from backhoe_planner.planning.multistart.incumbent import FoundMotion

START = np.full(4, 0.1)


def found(
    robot: bp.Robot, goal: dict[str, Any], effort: Any, allowed: float | None = None, **task: Any
) -> tuple[list[FastMotions], Problem]:
    """All results for a motion among no obstacles."""
    joints = dict(zip(robot.joint_names, START.tolist(), strict=True))
    content = {"version": 1, "start": {"joints": joints}, "objective": "work", "task": {"goal": goal, **task}}
    problem = build_problem(robot, bp.scene_from_dict(content))
    world = World(problem, seed=0, work=Work(EFFORTS[effort]))
    return list(fast_motions(world, START, time=0.0, allowed=allowed)), problem


def joints_goal(robot: bp.Robot, first: float = 0.9) -> dict[str, Any]:
    return {"joints": dict(zip(robot.joint_names, (first, 0.1, 0.1, 0.1), strict=True))}


@pytest.mark.parametrize(
    ("effort", "task", "known", "expected"),
    [
        ("normal", {}, None, "3 times the bound"),
        ("quick", {}, None, "half as long again as the fastest"),
        ("normal", {"max_duration": 4.0}, None, 4.0),
        ("quick", {"max_duration": 4.0}, None, 4.0),
        ("normal", {"max_duration": 300.0}, None, "20 times the fastest"),
        ("normal", {"max_duration": 1.29}, None, "the fastest"),  # the trapezoid of the speed takes 1.3 s
        ("normal", {}, 5.0, "as known"),
    ],
)
def test_a_motion_may_take_three_times_the_bound_or_what_the_scene_says(
    planar4: bp.Robot, effort: str, task: dict[str, Any], known: float | None, expected: Any
) -> None:
    """One joint moves freely, so the first motion is fast enough, and no second search follows."""
    results, problem = found(planar4, joints_goal(planar4), effort, known, **task)
    assert results
    fastest = results[0].fastest
    assert fastest is not None
    duration = fastest.motion.duration
    times = {
        "3 times the bound": 3.0 * bound_for_allowed_time(problem, START),
        "half as long again as the fastest": 1.5 * duration,
        "20 times the fastest": 20.0 * duration,
        "the fastest": duration,
        "as known": known,
    }
    assert results[0].allowed_time == pytest.approx(times.get(expected, expected), rel=1e-9)
    assert fastest.cost == duration
    enough = expected != "the fastest"
    assert len(results) == (1 if enough else 2)


def test_a_fast_motion_ends_at_the_position_but_belongs_to_the_goal_with_its_tolerance(planar4: bp.Robot) -> None:
    position = bp.Kinematics(planar4).at(np.array([0.9, 0.3, 0.2, 0.1])).tip_position
    results, problem = found(planar4, {"position": position.tolist(), "tolerance": 0.2}, "quick")
    (goal,) = problem.goals
    (result,) = results
    assert result.fastest is not None
    end = bp.Kinematics(planar4).at(result.fastest.motion.q[-1]).tip_position
    assert np.linalg.norm(end - position) < 1e-3
    assert {each.tolerance for each in (goal, result.fastest.goal, *result.goals)} == {0.2}
    assert all(each.goal.tolerance == 0.2 for each in result.ended)
    assert len(result.postures) == len(result.goals) > 0


def test_without_a_posture_on_a_goal_there_is_no_fast_motion(planar4: bp.Robot) -> None:
    """The arm is 4 m long."""
    results, _ = found(planar4, {"position": [9.0, 0.0, 0.0]}, "normal")
    assert results == []


def test_in_least_time_a_slow_motion_along_a_line_is_that_of_one_joint_at_its_limits(planar4: bp.Robot) -> None:
    """At acceleration a, and below its greatest rate, a joint moves by d in 2 sqrt(d / a). The way stays the same."""
    d, a = 0.2, 0.02
    goal = joints_goal(planar4, 0.1 + d)
    content = {
        "version": 1, "start": {"joints": dict.fromkeys(planar4.joint_names, 0.1)}, "objective": "work",
        "task": {"goal": goal}, "limits": {"acceleration": {"joint1": a}},
    }  # fmt: skip
    problem = build_problem(planar4, bp.scene_from_dict(content))
    curve = JointCurve.straight(START, START + d * np.eye(4)[0], 6)
    slow = FoundMotion(time_evenly(curve, 20.0), 1.0, problem.goals[0], "straight", curve)
    fast = in_least_time(slow, problem)
    assert fast.motion.duration == pytest.approx(2.0 * np.sqrt(d / a), rel=0.02)
    assert fast.cost == motion_cost(problem, fast.motion)
    assert fast.curve is None  # it is not run at an even pace
    np.testing.assert_allclose(fast.motion.q[[0, -1]], slow.motion.q[[0, -1]], atol=1e-12)
    assert in_least_time(fast, problem) is fast
