"""Obstacles that move and that appear: a verified plan keeps clear of them at every moment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from backhoe_planner.planning.moving_obstacles import _aside
from backhoe_planner.planning.search.effort import EFFORTS, Brake, Work
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import Obstruction
from validation.independent_check import refutations

Data = dict[str, Any]

START = {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}
GOAL: Data = {"goal": {"position": [1.5, 4.0, 0.5]}}
ENDS = ([4.0, 0.0, 0.3], [3.0, 2.8, 0.3])  # with a pitch, so that no joint is free
PATH: Data = {"path": {"waypoints": [{"position": at, "pitch": -1.6} for at in ENDS], "speed": 0.4}}
WORKER: Data = {"name": "worker", "shape": "capsule", "radius": 0.3}
CROSSING = WORKER | {"from": [3.5, 4.0, -0.5], "to": [3.5, 4.0, 1.0], "velocity": [0.0, -0.4, 0.0]}


def site(task: Data, *obstacles: Data) -> bp.Scene:
    content = {"version": 1, "start": {"joints": START}, "task": task, "clearance": 0.1, "influence": 0.6}
    return bp.scene_from_dict(content | {"obstacles": list(obstacles)})


@pytest.fixture(scope="module")
def alone(backhoe: bp.Robot) -> bp.Plan:
    """The plan along the path with nothing in the way."""
    return plan(backhoe, PATH)


def plan(robot: bp.Robot, task: Data, *obstacles: Data) -> bp.Plan:
    """A plan that, if verified, the independent check does not refute."""
    found = bp.plan(robot, site(task, *obstacles), effort="quick")
    if found.verified:
        assert refutations(found) == []
    return found


@pytest.mark.long
def test_obstacles_that_do_not_come_near_change_nothing(backhoe: bp.Robot, alone: bp.Plan) -> None:
    far = WORKER | {"from": [-8, 0, 0], "to": [-8, 0, 1.8], "velocity": [-0.5, 0.0, 0.0]}
    later = {"name": "box", "shape": "box", "size": [0.5, 0.5, 0.5], "position": [3.5, 1.4, 0.3], "appears_at": 60.0}
    np.testing.assert_array_equal(plan(backhoe, PATH, far, later).trajectory.q, alone.trajectory.q)


@pytest.mark.long
def test_the_plan_does_not_use_knowledge_of_an_obstacle_before_it_appears(backhoe: bp.Robot, alone: bp.Plan) -> None:
    """Up to that moment the motion is the one without the obstacle; then it stops and takes a detour."""
    moment = 3.0
    sudden = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [3.5, 1.4, 0.3], "appears_at": moment}
    found = plan(backhoe, PATH, sudden)
    assert alone.verified
    assert found.verified
    for time in np.linspace(0.0, moment, 31):
        np.testing.assert_allclose(found.trajectory.at(float(time)), alone.trajectory.at(float(time)), atol=1e-9)
    [reaction] = found.findings.reactions
    assert reaction.obstacle == "ball"
    assert reaction.appears_at == moment
    assert reaction.stopped_at is not None
    assert moment < reaction.stopped_at < moment + 2.0
    [detour] = found.certificate.detours
    assert detour.path_from < np.hypot(0.5, 1.4) < detour.path_to


@pytest.mark.long
def test_the_machine_waits_or_gives_way_to_a_worker_who_crosses_the_path(backhoe: bp.Robot, alone: bp.Plan) -> None:
    found = plan(backhoe, PATH, CROSSING)
    assert found.verified
    assert found.certificate.detours == ()
    # he walks 8 m at 0.4 m/s; the path alone takes as long as its length at the requested speed
    assert found.trajectory.duration > alone.trajectory.duration


@pytest.mark.long
def test_a_goal_is_reached_past_a_walking_worker(backhoe: bp.Robot) -> None:
    walker = WORKER | {"from": [3.0, 5.0, 0.0], "to": [3.0, 5.0, 1.8], "velocity": [0.0, -0.8, 0.0]}
    assert plan(backhoe, GOAL, walker).verified


@pytest.mark.long
def test_a_goal_is_reached_past_a_worker_who_appears_and_walks(backhoe: bp.Robot) -> None:
    walker = WORKER | {
        "from": [2.8, 4.0, 0.0], "to": [2.8, 4.0, 1.8], "velocity": [0.0, -0.5, 0.0], "appears_at": 1.0,
    }  # fmt: skip
    assert plan(backhoe, GOAL, walker).verified


def test_a_goal_that_becomes_blocked_is_reported_and_the_machine_stops_in_time(backhoe: bp.Robot) -> None:
    """A box appears on the goal: the machine stops within its acceleration limits, clear of the box."""
    box = {"name": "box", "shape": "box", "size": [0.6, 0.6, 2.0], "position": [1.5, 4.0, 0.8], "appears_at": 1.0}
    found = plan(backhoe, GOAL, box)
    assert found.reason == "goal_in_collision"
    assert found.message.startswith("box appears at 1.00 s in the way: the machine stops at ")
    assert found.certificate.safe
    [reaction] = found.findings.reactions
    assert reaction.stopped_at is not None
    assert found.trajectory.duration == pytest.approx(reaction.stopped_at)
    # the swing needs v / a to stop
    limits = backhoe.limits
    assert reaction.stopped_at < 1.0 + np.max(limits.velocity / limits.acceleration) + 0.1
    assert np.all(found.trajectory.v[-1] == 0.0)


@pytest.mark.parametrize(
    ("at", "verified"),
    [([1.5, 4.0, 0.8], False), pytest.param([3.5, 1.6, 0.3], True, marks=pytest.mark.long)],
    ids=["on the goal", "on the way"],
)
def test_a_sequence_reports_the_reactions_of_its_legs_in_its_own_time(
    backhoe: bp.Robot, at: list[float], verified: bool
) -> None:
    """A ball appears at 1.5 s, half a second after the second leg has begun."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": at, "appears_at": 1.5}
    found = plan(backhoe, {"sequence": [{"name": "rest", "wait": 1.0}, {"name": "over"} | GOAL]}, ball)
    assert found.verified == verified
    [own] = found.legs[1].findings.reactions
    assert own.appears_at == pytest.approx(0.5)
    [reaction] = found.findings.reactions
    assert (reaction.obstacle, reaction.way) == (own.obstacle, own.way)
    assert reaction.appears_at == pytest.approx(1.5)
    assert own.stopped_at is not None
    assert reaction.stopped_at == pytest.approx(1.0 + own.stopped_at)
    assert reaction.words.startswith("ball appears at 1.50 s: ")


def test_braking_ends_where_the_motion_ends(backhoe: bp.Robot) -> None:
    """A sphere appears at the goal when the machine cannot stop short of it any more."""
    task = {"goal": {"position": [3.2, 1.5, 1.2]}}
    sphere = {"name": "s", "shape": "sphere", "radius": 0.2, "position": [3.2, 1.5, 1.2], "appears_at": 1.0}
    undisturbed, found = plan(backhoe, task), plan(backhoe, task, sphere)
    [reaction] = found.findings.reactions
    assert not found.certificate.safe
    assert reaction.stopped_at is not None
    assert found.message == (
        f"s appears at 1.00 s in the way: the machine stops at {reaction.stopped_at:.2f} s, "
        "and comes too near to it even while it brakes"
    )
    assert reaction.reply == f"no way to stop in time, at rest at {reaction.stopped_at:.2f} s"
    assert 1.0 < reaction.stopped_at < 1.1 * undisturbed.trajectory.duration


def test_an_obstacle_that_appears_on_the_machine_is_not_safe(backhoe: bp.Robot) -> None:
    upon = {"name": "boulder", "shape": "sphere", "radius": 0.6, "position": [3.0, 0.3, 0.6], "appears_at": 0.5}
    found = plan(backhoe, GOAL, upon)
    assert not found.verified
    assert not found.certificate.safe
    assert "boulder" in found.message


@pytest.mark.long
def test_the_same_seed_gives_the_same_plan_among_moving_obstacles(backhoe: bp.Robot) -> None:
    walker = WORKER | {"from": [2.8, 4.0, 0.0], "to": [2.8, 4.0, 1.8], "velocity": [0.0, -0.5, 0.0]}
    one, other = (bp.plan(backhoe, site(GOAL, walker), effort="quick") for _ in range(2))
    np.testing.assert_array_equal(one.trajectory.q, other.trajectory.q)
    np.testing.assert_array_equal(one.trajectory.time, other.trajectory.time)


@pytest.mark.parametrize("seed", [50, pytest.param(60, marks=pytest.mark.long)])
def test_a_machine_that_gave_way_goes_on_once_the_worker_has_passed(backhoe: bp.Robot, seed: int) -> None:
    """He walks through the machine's place, 12 m in 20 s: at 15 s he is 6 m beside it, long past its path."""
    walker = WORKER | {"from": [3.5, 3.0, 0.0], "to": [3.5, 3.0, 1.8], "clearance": 0.3, "velocity": [0.0, -0.6, 0.0]}
    found = bp.plan(backhoe, site({"goal": {"position": [3.0, 2.5, 0.8]}}, walker), effort="quick", seed=seed)
    assert found.verified
    assert refutations(found) == []
    assert found.metrics.duration < 15.0


def beside_a_car(y: float, **task: float) -> Data:
    """A goal to the left, with a car that begins at `y` on the right and drives through the way to it."""
    car = {
        "name": "car", "shape": "box", "size": [0.8, 0.8, 2.5], "position": [2.6, y, 1.2], "velocity": [0, 1.0, 0],
        "clearance": 0.3,
    }  # fmt: skip
    start = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}
    task_ = {"goal": {"position": [1.2, 2.4, 1.5]}, **task}
    return {"version": 1, "start": start, "task": task_, "obstacles": [car]}


@pytest.mark.long
def test_a_fast_motion_past_a_car_is_found_if_all_slow_ones_of_little_work_meet_it(backhoe: bp.Robot) -> None:
    content = beside_a_car(-1.5)
    plan = bp.plan(backhoe, bp.scene_from_dict({**content, "objective": "work"}), effort="quick")
    assert plan.verified, plan.message
    fastest = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.metrics.energy["work"] <= 1.01 * fastest.metrics.energy["work"]
    assert plan.certificate.duration is None


@pytest.mark.long
def test_more_allowed_time_past_a_car_does_not_cost_more_work(backhoe: bp.Robot) -> None:
    """A motion of 4.5 s passes before the car; one of 8 s meets it, and going round it costs half as much again."""
    plans = [
        bp.plan(backhoe, bp.scene_from_dict(beside_a_car(-2.5, max_duration=longest) | {"objective": "work"}),
                effort="quick")
        for longest in (4.5, 8.0)
    ]  # fmt: skip
    assert all(plan.verified for plan in plans)
    assert refutations(plans[1]) == []
    assert plans[1].metrics.energy["work"] <= 1.03 * plans[0].metrics.energy["work"]
    assert "costs least of the motions that were found" in plans[1].message
    assert plans[0].allowed_time == "at most 4.50 s was allowed by max_duration, which limits it"


def test_a_max_duration_that_no_motion_past_a_car_can_keep_is_refused_with_the_bound(backhoe: bp.Robot) -> None:
    free = bp.plan(backhoe, bp.scene_from_dict(beside_a_car(-2.5)), effort="quick")
    assert free.bound is not None
    content = beside_a_car(-2.5, max_duration=0.9 * free.bound.duration) | {"objective": "work"}
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.reason == "outside_limits"
    assert float(plan.message.partition("less than ")[2].split()[0]) == pytest.approx(free.bound.duration, rel=0.02)


def test_a_detour_to_a_place_where_a_worker_does_not_pass_is_for_the_worker(backhoe: bp.Robot) -> None:
    """Planned on from that place, it seems to be for a joint at its limit; what is further along the path stays."""
    world = World(build_problem(backhoe, site(PATH, CROSSING)), seed=0, work=Work(EFFORTS["quick"], Brake()))
    stepper = world.stepper(np.array([0.0, 0.8, -1.6, -0.8]))  # he walks over where the tip is
    apart = Obstruction.joint_limit("swing")
    detours = (replace(apart, path_from=0.6, path_to=0.7), replace(apart, obstacle="boom", path_from=2.0, path_to=2.1))
    [first, second] = _aside(world, stepper, Outcome(stepper.trajectory()).adding(detours=detours)).findings.detours
    assert (first.obstacle, first.kind, first.path_from, first.path_to) == ("worker", "obstacle", 0.6, 0.7)
    assert first.margin < 0.0
    assert second == detours[1]
    goal = Outcome(stepper.trajectory())
    assert _aside(world, stepper, goal) is goal


@pytest.mark.long
def test_a_machine_that_steps_aside_for_a_worker_says_so(backhoe: bp.Robot) -> None:
    walker = WORKER | {
        "from": [4.0, 3.0, 0.0], "to": [4.0, 3.0, 1.5], "clearance": 1.0, "appears_at": 2.0,
        "velocity": [0.0, -0.5, 0.0],
    }  # fmt: skip
    waypoints = [{"position": [4.6, 0.0, -0.3]}, {"position": [2.9, 0.0, -1.1]}]
    content = {"version": 1, "task": {"path": {"waypoints": waypoints, "speed": 0.3}}, "obstacles": [walker]}
    found = bp.plan(backhoe, bp.scene_from_dict(content))
    assert found.verified
    [detour] = found.metrics.detours
    assert detour.obstruction is not None
    assert detour.obstruction.obstacle == "worker"
    assert found.metrics.objective is not None
    assert found.metrics.objective.law_breaks == detour.obstruction
