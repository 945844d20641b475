"""The lower bound of a plan to a goal, in the plan and in its file."""

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
    """Nothing is in the way, and joint 1 moves furthest."""
    scene = bp.scene_from_dict(FREE | {"task": {"goal": BENT}})
    return bp.plan(load_robot("example:planar4"), scene, effort="quick")


def test_a_plan_at_its_joint_limits_is_bounded_within_2_percent(to_a_posture: bp.Plan) -> None:
    """1.6 rad at 1 rad/s, plus 0.5 s for both ramps at 2 rad/s^2."""
    bound = to_a_posture.bound
    assert bound is not None
    assert bound.settled
    assert 0.98 * 2.1 < bound.duration < 2.1
    assert to_a_posture.trajectory.duration <= 1.02 * 2.1
    longer = to_a_posture.trajectory.duration / bound.duration - 1.0
    assert bound.longer_percent == pytest.approx(100.0 * longer)


@pytest.mark.long
def test_the_bound_of_a_slow_motion_is_as_tight() -> None:
    """The time allowed to a motion of least work, here three times a bound, follows from the reported bound."""
    scene = bp.scene_from_dict(FREE | {"task": {"goal": BENT}, "objective": "work"})
    plan = bp.plan(load_robot("example:planar4"), scene)
    assert plan.bound is not None
    assert plan.findings.allowed_time is not None
    assert 0.97 * 2.1 < plan.bound.duration < 2.1
    assert 3.0 * plan.bound.duration >= plan.findings.allowed_time * (1.0 - 1e-9)


def test_a_quick_plan_far_above_its_bound_or_for_another_cost_says_that_more_effort_may_help(
    to_a_posture: bp.Plan,
) -> None:
    """The plan is within 2 % of its bound; driven at half the speed it takes 100 % longer."""
    assert to_a_posture.advice == ""
    given = to_a_posture.trajectory
    half_as_fast = bp.Trajectory.from_steps(2.0 * given.time, given.q)
    slow = replace(
        to_a_posture,
        trajectory=half_as_fast,
        certificate=bp.certify(to_a_posture.robot, to_a_posture.scene, half_as_fast),
    )
    assert slow.advice == "--effort normal may find a faster motion"
    assert replace(slow, effort="normal").advice == ""
    scene = bp.scene_from_dict(FREE | {"task": {"goal": BENT}, "objective": "velocity_norm"})
    cheap = bp.plan(load_robot("example:planar4"), scene, effort="quick")
    assert cheap.advice == "--effort normal may find a cheaper motion"
    assert replace(cheap, method="reactive").advice == ""


def test_a_bound_of_zero_gives_no_percentage(to_a_posture: bp.Plan) -> None:
    """The start is on the goal: a percentage of 0 s means nothing."""
    standing = bp.scene_from_dict(FREE | {"task": {"goal": FREE["start"]}})
    bound = bp.plan(load_robot("example:planar4"), standing, effort="quick").bound
    assert bound is not None
    assert bound.duration < 0.005
    assert bound.excess == ""
    assert to_a_posture.bound is not None
    assert to_a_posture.bound.excess == f"this one takes {to_a_posture.bound.longer_percent:.0f} % longer"


def test_the_plan_file_holds_the_bound(to_a_posture: bp.Plan, tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    to_a_posture.save(file)
    assert bp.load_plan(file).bound == to_a_posture.bound
    content = json.loads(file.read_text())
    assert set(content["bound"]) == {"duration", "longer_percent", "settled", "energy"}
    del content["bound"]  # as in older files
    file.write_text(json.dumps(content))
    assert bp.load_plan(file).bound is None


def test_a_plan_that_is_not_verified_has_no_bound(to_a_posture: bp.Plan, tmp_path: Path) -> None:
    """The plan file, whose motion is then made too fast, still holds the old bound."""
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
def test_plans_of_random_sites_take_longer_than_their_bounds(machine: str, index: int) -> None:
    """Also if the search does not know the duration of a motion, nor its end."""
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
