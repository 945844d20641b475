"""The time allowed to a motion of least cost: three times the bound, more where that is too little."""

from __future__ import annotations

import gc
import sys
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem, time_evenly
from backhoe_planner.planning.descent import descent_of_cost
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Options
from backhoe_planner.planning.goals.allowed_time import (
    allowed_time,
    bound_behind,
    bound_for_allowed_time,
    fastest_with_room,
    has_room,
)
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.goals.time_search import TimeSearch
from backhoe_planner.planning.search.effort import EFFORTS, Work
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import least_duration, least_duration_of_all


@pytest.mark.parametrize(
    ("bound", "fastest", "allowed"),
    [
        (2.0, 2.0, 6.0),
        (2.0, 4.9, 6.0),  # 1.2 times 4.9 s is less than 6 s
        (2.0, 5.1, 9.0),
        (2.0, 7.4, 9.0),
        (2.0, 7.6, 13.5),
        (0.0, 4.0, 6.0),  # nothing is proven
        (0.0, 0.0, 0.0),
    ],
)
def test_the_allowed_time_is_a_multiple_of_the_bound(bound: float, fastest: float, allowed: float) -> None:
    assert allowed_time(bound, fastest) == pytest.approx(allowed)


def test_a_motion_has_room_up_to_five_halves_of_the_bound() -> None:
    assert fastest_with_room(2.0) == pytest.approx(5.0)  # 1.2 times 5 s is three times 2 s
    assert has_room(2.0, 4.99)
    assert not has_room(2.0, 5.01)


def test_the_bound_behind_an_allowed_time_leads_to_the_same_time_and_room() -> None:
    assert allowed_time(bound_behind(6.0), 4.9) == pytest.approx(6.0)
    assert fastest_with_room(bound_behind(6.0)) == pytest.approx(5.0)


def test_the_bound_of_one_joint_is_its_time_to_accelerate_and_brake(planar4: bp.Robot) -> None:
    """With acceleration a, and the rate never at its limit, a joint moves by d in 2 sqrt(d / a)."""
    for d, a in ((0.2, 0.02), (1.2, 0.002)):
        start = dict.fromkeys(planar4.joint_names, 0.1)
        content = {
            "version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start | {"joint1": 0.1 + d}}},
            "limits": {"acceleration": {"joint1": a}},
        }  # fmt: skip
        problem, T = build_problem(planar4, bp.scene_from_dict(content)), 2.0 * np.sqrt(d / a)
        assert 0.97 * T <= bound_for_allowed_time(problem, np.full(4, 0.1)) <= T


def test_the_bound_equals_that_of_a_search_whose_horizon_is_doubled(backhoe: bp.Robot) -> None:
    """The first horizon follows from a rough bound; a search from 0.25 s on, doubled each time, finds the same."""
    start = dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))
    for position in ([4.0, 1.0, -1.0], [3.0, 3.0, 1.0], [4.5, 0.0, 0.0]):
        content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"position": position}}}
        problem, most = build_problem(backhoe, bp.scene_from_dict(content)), 0.25
        while (found := least_duration(problem, backhoe.middle, known=most, boxes=500).duration) >= 0.98 * most:
            most *= 2.0
        assert found > 0.5
        assert least_duration_of_all(problem, backhoe.middle, boxes=500) == found


def test_the_bound_is_cached_as_long_as_its_problem_lives(planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    start = dict.fromkeys(planar4.joint_names, 0.1)
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start | {"joint1": 0.5}}}}
    problem, q = build_problem(planar4, bp.scene_from_dict(content)), np.full(4, 0.1)
    found = least_duration_of_all(problem, q, boxes=100)
    module = sys.modules[least_duration_of_all.__module__]
    monkeypatch.setattr(module, "_least_of_all", lambda *_: -1.0)
    assert least_duration_of_all(problem, q.copy(), boxes=100) == found
    assert least_duration_of_all(problem, q, boxes=200) == -1.0
    assert least_duration_of_all(problem, q + 0.1, boxes=100) == -1.0
    alive = weakref.ref(problem)
    del problem
    gc.collect()
    assert alive() is None


@pytest.mark.parametrize(
    ("effort", "objective"),
    [("quick", "work"), ("normal", "work"), pytest.param("normal", "effort", marks=pytest.mark.long)],
)
def test_without_a_proven_fast_motion_the_first_proven_one_says_how_long_a_motion_may_take(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, effort: Any, objective: str
) -> None:
    """Descents have ended, but none was proven clear: their costs in infinite time say nothing.

    One joint moves freely. A plan in a hurry knows no bound: then a motion may take half as long again as the fastest,
    which cannot be sooner than the bound, along a curve that is bent a little to cost less.
    """

    def unproven(self: TimeSearch) -> str:
        ended = run(self)
        assert self.best is not None
        self.ended.append(self.best)
        self._incumbent.best = None
        return ended

    run = TimeSearch.run
    monkeypatch.setattr(TimeSearch, "run", unproven)
    start = dict.fromkeys(planar4.joint_names, 0.1)
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start | {"joint1": 0.6}}}}
    plan = bp.plan(planar4, bp.scene_from_dict(content | {"objective": objective}), effort=effort)
    assert plan.verified, plan.message
    bound, allowed = bound_for_allowed_time(plan.problem, np.full(4, 0.1)), plan.findings.allowed_time
    assert allowed is not None
    assert plan.metrics.duration <= allowed
    if effort == "normal":
        assert allowed == pytest.approx(3.0 * bound)
    else:
        assert 1.5 * bound <= allowed <= 2.0 * bound


def test_a_motion_whose_samples_exceed_the_allowed_time_is_shortened(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first two motions are slowed by 2 and 1 %, as happens between the places where steps keep the limits."""
    slower = iter((1.02, 1.01))

    def timed(*args: Any, **kwargs: Any) -> bp.Trajectory:
        motion = time_evenly(*args, **kwargs)
        factor = next(slower, 1.0) if len(args) > 2 else 1.0
        return bp.Trajectory.from_steps(motion.time * factor, motion.q)

    monkeypatch.setattr(descent_of_cost, "time_evenly", timed)
    start = dict.fromkeys(planar4.joint_names, 0.1)
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start | {"joint1": 0.6}}}}
    problem = build_problem(planar4, bp.scene_from_dict(content | {"objective": "velocity_norm"}))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"]))
    goal, longest = problem.goals[0], 4.0
    assert problem.start_q is not None
    assert goal.q is not None
    found = descent_of_cost.DescentOfCost(
        problem, world.proximity, world.kinematics, time=0.0, brake=world.work.brake
    ).run(
        JointCurve.straight(problem.start_q, goal.q, 6), longest, goal,
        Options(6, spare=0.003, density=1, box=0.25, longest=longest),
    )  # fmt: skip
    assert found is not None
    assert next(slower, None) is None
    assert 0.96 * longest < found.motion.duration <= longest


@pytest.mark.parametrize(
    ("start", "position", "longest"),
    [
        ([-0.88, 0.79, -0.98, -0.18], [1.53, -1.5, 0.69], 3.81),
        ([-0.92, -0.03, -1.85, -1.68], [2.48, 1.81, -2.87], 3.59),
    ],
)
def test_a_motion_that_costs_little_is_shortened_even_if_it_then_costs_far_more(
    backhoe: bp.Robot, start: list[float], position: list[float], longest: float
) -> None:
    """To be in time costs a quarter more than to be 1 % late, and the extra cost of that is a tenth at first."""
    joints = dict(zip(backhoe.joint_names, start, strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"position": position}}, "objective": "work"}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    ends = find_goal_postures(world, problem.goals, near=np.array(start), time=0.0)
    assert isinstance(ends, GoalPostures)
    found = descent_of_cost.DescentOfCost(
        problem, world.proximity, world.kinematics, time=0.0, brake=world.work.brake
    ).run(
        JointCurve.straight(np.array(start), ends.clear[0], 12), longest, problem.goals[0],
        Options(80, spare=0.003, density=1, box=0.25, longest=longest),
    )  # fmt: skip
    assert found.missed == 0.0
    assert 0.98 * longest < found.motion.duration <= longest


def swung(robot: bp.Robot, *obstacles: dict[str, Any], **keys: Any) -> bp.Plan:
    """A plan in which an arm of 4 m swings by 1.2 rad among `obstacles`."""
    joints = dict(zip(robot.joint_names, (0.0, 0.3, 0.3, 0.3), strict=True))
    goal = {"goal": {"joints": joints | {"joint1": 1.2}}}
    content = {"version": 1, "objective": "velocity_norm", "start": {"joints": joints}, "task": goal} | keys
    plan = bp.plan(robot, bp.scene_from_dict(content | {"obstacles": list(obstacles)}), effort="quick")
    assert plan.verified, plan.message
    return plan


MIDDLE = np.array([1.88, 3.28, 0.0])  # m: the tip halfway
OUTWARDS = MIDDLE / np.linalg.norm(MIDDLE)


def test_a_wait_is_added_to_the_allowed_time(planar4: bp.Robot) -> None:
    """A box in the way moves outwards: the arm waits, then moves as it does without the box."""
    box = {
        "name": "box", "shape": "box", "size": [0.6, 0.6, 2.0], "position": (0.5 * MIDDLE).tolist(),
        "velocity": (0.8 * OUTWARDS).tolist(),
    }  # fmt: skip
    alone, waiting = swung(planar4), swung(planar4, box)
    wait, longest = waiting.findings.waits, alone.findings.allowed_time
    assert longest is not None
    assert wait > 0.5
    assert waiting.metrics.duration == pytest.approx(alone.metrics.duration + wait)
    assert waiting.findings.allowed_time == pytest.approx(longest + wait)
    assert alone.metrics.duration <= longest


def test_the_time_until_a_restart_is_added_to_the_allowed_time(planar4: bp.Robot) -> None:
    """A ball appears in the way after 1 s: the arm stops, waits and goes on; slow motions cost little."""
    ball = {
        "name": "ball", "shape": "sphere", "radius": 0.3, "position": MIDDLE.tolist(), "appears_at": 1.0,
        "velocity": (0.3 * OUTWARDS).tolist(),
    }  # fmt: skip
    plan = swung(planar4, ball)
    (reaction,) = plan.findings.reactions
    longest = plan.findings.allowed_time
    assert reaction.stopped_at is not None
    assert longest is not None
    assert max(reaction.stopped_at + plan.findings.waits, 0.99 * longest) < plan.metrics.duration <= longest


def test_a_leg_with_a_tip_speed_reports_no_allowed_time(planar4: bp.Robot) -> None:
    """At 0.5 m/s, 1.2 rad take longer: 4 m x 1.2 rad / 0.5 m/s is 9.6 s for the stretched arm."""
    goals = [dict(zip(planar4.joint_names, (angle, 0.3, 0.3, 0.3), strict=True)) for angle in (1.2, 1.6)]
    there, on = ({"name": f"{k}", "goal": {"joints": goal}} for k, goal in enumerate(goals))
    slow, free = swung(planar4, task={"sequence": [there | {"speed": 0.5}, on]}).legs
    assert slow.metrics.duration > 8.0
    assert slow.findings.allowed_time is None
    assert free.findings.allowed_time is not None
    assert free.metrics.duration <= free.findings.allowed_time


def test_a_limit_of_the_planner_that_a_motion_takes_whole_names_the_key_that_sets_another(planar4: bp.Robot) -> None:
    content: dict[str, Any] = {
        "version": 1, "start": {"joints": {f"joint{k}": 0.1 for k in (1, 2, 3, 4)}}, "objective": "kinetic",
        "task": {"goal": {"joints": {f"joint{k}": 0.2 for k in (1, 2, 3, 4)}}},
    }  # fmt: skip
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    T = plan.trajectory.duration
    said = [
        replace(plan, findings=plan.findings.model_copy(update={"allowed_time": longest})).allowed_time
        for longest in (T, 2.0 * T)
    ]
    assert said[0] == f"at most {T:.2f} s was allowed by the planner, which limits it: max_duration may allow more"
    assert said[1] == f"at most {2.0 * T:.2f} s was allowed by the planner"


def test_a_plan_of_least_cost_is_compared_with_the_fast_motion_from_which_its_search_began(
    planar4: bp.Robot, tmp_path: Path
) -> None:
    """The least kinetic energy needs the slowest motion that is allowed, so it is below that of any fast one."""
    content: dict[str, Any] = {
        "version": 1, "start": {"joints": {f"joint{k}": 0.1 for k in (1, 2, 3, 4)}}, "objective": "kinetic",
        "task": {"goal": {"joints": {f"joint{k}": 0.3 for k in (1, 2, 3, 4)}}},
    }  # fmt: skip
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    fast, cost, bound = plan.findings.fast, plan.metrics.cost, plan.bound
    assert fast is not None
    assert cost is not None
    assert bound is not None
    assert bound.duration <= fast.duration < plan.metrics.duration
    assert cost.value < fast.cost
    plan.save(tmp_path / "plan.json")
    assert bp.load_plan(tmp_path / "plan.json").findings.fast == fast

    def saving(times: float) -> str:
        other = bp.FastMotion(duration=2.0, cost=times * cost.value)
        return replace(plan, findings=plan.findings.model_copy(update={"fast": other})).saving

    assert saving(4.0).startswith("75 % less than a motion of 2.00 s, which takes ")
    assert not saving(1.005)
    assert not saving(0.5)
    timed = bp.plan(planar4, bp.scene_from_dict(content | {"objective": "time"}), effort="quick")
    assert timed.findings.fast is None
    assert not timed.saving
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [9.0, 9.0, 0.0], "velocity": [0.0, 0.1, 0.0]}
    moving = bp.plan(planar4, bp.scene_from_dict(content | {"obstacles": [ball]}), effort="quick")
    assert moving.findings.fast is None


@pytest.mark.long
def test_a_plan_reports_its_allowed_time_which_does_not_depend_on_the_seed(planar4: bp.Robot) -> None:
    joints = [f"joint{k}" for k in (1, 2, 3, 4)]
    tip = bp.Kinematics(planar4).at(np.array([0.8, 0.3, 0.2, 0.1])).tip_position
    content = {
        "version": 1, "start": {"joints": dict.fromkeys(joints, 0.1)}, "objective": "work",
        "task": {"goal": {"position": (0.6 * tip).tolist()}},
    }  # fmt: skip
    plans = [bp.plan(planar4, bp.scene_from_dict(content), seed=seed) for seed in (0, 1)]
    for plan in plans:
        longest = plan.findings.allowed_time
        assert plan.verified, plan.message
        assert plan.bound is not None
        assert longest is not None
        assert longest == pytest.approx(3.0 * plan.bound.duration, rel=0.02)
        assert plan.metrics.duration <= longest
    assert plans[0].findings.allowed_time == plans[1].findings.allowed_time
    fast = bp.plan(planar4, bp.scene_from_dict(content | {"objective": "time"}), effort="quick")
    assert fast.findings.allowed_time is None
