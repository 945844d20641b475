"""The bound beside a plan to a goal, in the plan and in its file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

import backhoe_planner as bp
from backhoe_planner.machine import load_robot
from backhoe_planner.proof import least_duration, least_work
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

FREE = {"version": 1, "start": {"joints": {f"joint{j}": 0.0 for j in range(1, 5)}}}
BENT = {"joints": {"joint1": 1.6, "joint2": 0.4, "joint3": -0.3, "joint4": 0.2}}


@pytest.fixture(scope="module")
def to_a_posture() -> bp.Plan:
    """Nothing is in the way, and joint 1 has the longest way."""
    scene = bp.scene_from_dict(FREE | {"task": {"goal": BENT}})
    return bp.plan(load_robot("example:planar4"), scene, effort="quick")


def test_a_plan_at_its_joints_limits_is_bounded_within_2_percent(to_a_posture: bp.Plan) -> None:
    """1.6 rad at 1 rad/s, and 0.5 s for both ramps at 2 rad/s^2."""
    bound = to_a_posture.bound
    assert bound is not None
    assert bound.settled
    assert 0.98 * 2.1 < bound.duration < 2.1
    assert to_a_posture.trajectory.duration <= 1.02 * 2.1
    longer = to_a_posture.trajectory.duration / bound.duration - 1.0
    assert bound.longer_percent == pytest.approx(100.0 * longer)


@pytest.mark.long
def test_a_slow_motion_does_not_make_the_bound_weak() -> None:
    """The time that a motion for the least work is allowed, here three times a bound, follows from the bound shown."""
    scene = bp.scene_from_dict(FREE | {"task": {"goal": BENT}, "objective": "work"})
    plan = bp.plan(load_robot("example:planar4"), scene)
    assert plan.bound is not None
    assert plan.findings.allowed_time is not None
    assert 0.97 * 2.1 < plan.bound.duration < 2.1
    assert 3.0 * plan.bound.duration >= plan.findings.allowed_time * (1.0 - 1e-9)


def test_a_start_on_the_goal_is_not_compared_with_nothing(to_a_posture: bp.Plan) -> None:
    """Percentages of a time of 0 say nothing."""
    standing = bp.scene_from_dict(FREE | {"task": {"goal": FREE["start"]}})
    bound = bp.plan(load_robot("example:planar4"), standing, effort="quick").bound
    assert bound is not None
    assert bound.duration < 0.005
    assert bound.excess == ""
    assert to_a_posture.bound is not None
    assert to_a_posture.bound.excess == f"this one takes {to_a_posture.bound.longer_percent:.0f} % longer"


def test_the_bound_stands_in_the_plan_file(to_a_posture: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    to_a_posture.save(file)
    assert bp.load_plan(file).bound == to_a_posture.bound
    content = json.loads(file.read_text())
    assert set(content["bound"]) == {"duration", "longer_percent", "settled", "energy"}
    del content["bound"]  # as in older files
    file.write_text(json.dumps(content))
    assert bp.load_plan(file).bound is None


def test_what_is_not_verified_has_no_bound(to_a_posture: bp.Plan, tmp_path: Path) -> None:
    """A plan file whose motion was made too fast still says what it said before."""
    file = tmp_path / "plan.json"
    motion = to_a_posture.trajectory
    replace(to_a_posture, trajectory=bp.Trajectory.from_steps(0.5 * motion.time, motion.q)).save(file)
    loaded = bp.load_plan(file)
    assert not loaded.verified
    assert loaded.bound is None


def test_a_plan_along_a_path_has_no_bound(around_a_ball: bp.Plan) -> None:
    assert around_a_ball.verified
    assert around_a_ball.bound is None


@pytest.mark.parametrize("index", [0, *(pytest.param(index, marks=pytest.mark.long) for index in range(1, 2))])
@pytest.mark.parametrize("machine", ["planar4", "backhoe", "panda"])
def test_plans_of_random_sites_take_longer(machine: str, index: int) -> None:
    """Also where the search does not know how long a motion takes, nor where it ends."""
    robot = load_machine(machine)
    scene = random_site(robot, SiteKey(machine, ("open", "cluttered")[index % 2], "goal", index)).scene
    plan = bp.plan(robot, scene, effort="quick")
    if not plan.verified:
        pytest.skip("no plan")
    duration = plan.trajectory.duration
    assert plan.bound is not None
    assert 0.0 < plan.bound.duration <= duration
    unknown = least_duration(plan.problem, plan.trajectory.q[0], known=2.0 * duration, boxes=1_000)
    assert unknown.duration <= duration
    q = plan.trajectory.q
    least = least_work(plan.problem, q[0], end=q[-1], boxes=100)
    assert least is not None
    assert least <= plan.metrics.energy["work"]
