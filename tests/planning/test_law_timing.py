"""The law's motions as fast as the machine allows: known times, the same way, limits that bind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Problem, build_problem, limit_usage
from backhoe_planner.planning import Stepper, Work, World, approach_goal, places_on, speed_up, time_iterates

SCENES = Path(__file__).resolve().parents[2] / "scenes"
CAGE = """<robot name="lift">
  <link name="post"/>
  <link name="cage"><collision><geometry><sphere radius="0.01"/></geometry></collision><inertial><mass value="300"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hoist" type="prismatic"><parent link="post"/><child link="cage"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="3" velocity="1" acceleration="2" effort="1e4"/></joint>
</robot>"""


def by_law(problem: Problem, q: Array) -> tuple[Stepper, Stepper]:
    """A motion at rest at q, and the law's straight for the goal from there."""
    begun = World(problem, seed=0, work=Work()).stepper(q)
    attempt = next(iter(approach_goal(begun, problem.goals[0], (), work=Work())))
    assert attempt.arrived
    return begun, attempt.stepper


def free_goal(robot: bp.Robot, seed: int) -> tuple[Array, bp.Scene]:
    rng = np.random.default_rng(seed)
    q = np.array([0.0, 0.4, -1.4, -0.8]) + 0.2 * rng.standard_normal(4)
    goal = bp.Kinematics(robot).at(q).tip_position + rng.uniform(-1.2, 1.2, 3) * [1.0, 1.5, 0.6]
    start = dict(zip(robot.joint_names, q.tolist(), strict=True))
    content: dict[str, Any] = {"version": 1, "start": {"joints": start}, "task": {"goal": {"position": goal.tolist()}}}
    return q, bp.scene_from_dict(content)


def shortest_time(q: Array, limits: JointLimits) -> float:
    """A lower bound of the time along the polyline q (T, n) [s], by the velocity limits of the joints alone."""
    return float(np.sum(np.max(np.abs(np.diff(q, axis=0)) / limits.velocity, axis=1)))


def off(q: Array, corners: Array) -> float:
    """How far the places q (K, n) are from the polyline at most [rad]."""
    begin, step = corners[:-1], np.diff(corners, axis=0)
    part = np.einsum("kmn,mn->km", q[:, None] - begin, step) / np.maximum(np.sum(step**2, axis=1), 1e-18)
    near = begin + np.clip(part, 0.0, 1.0)[:, :, None] * step
    return float(np.max(np.min(np.linalg.norm(q[:, None] - near, axis=2), axis=1)))


def test_places_lie_evenly_on_a_bent_way() -> None:
    """0.4 rad of the first joint at 1 rad/s, then 0.6 rad of the second at 2 rad/s: 0.4 s and 0.3 s."""
    corners = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.0], [0.4, 0.0], [0.4, 0.6]])
    along, places = places_on(corners, np.array([1.0, 2.0]), 0.1)
    np.testing.assert_allclose(along, np.linspace(0.0, 0.7, 8))
    expected = [[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0], [0.4, 0.0], [0.4, 0.2], [0.4, 0.4], [0.4, 0.6]]
    np.testing.assert_allclose(places, expected, atol=1e-12)
    limits = bp.load_robot("example:planar4").limits
    two = replace(
        limits, lower=limits.lower[:2], upper=limits.upper[:2], velocity=np.array([1.0, 2.0]),
        acceleration=limits.acceleration[:2], effort=limits.effort[:2],
    )  # fmt: skip
    assert shortest_time(corners, two) == pytest.approx(0.7)


def test_a_slide_runs_the_trapezium_of_the_textbook(tmp_path: Path) -> None:
    """2 m at 1 m/s and 2 m/s^2: d / v + v / a = 2.5 s."""
    file = tmp_path / "lift.urdf"
    file.write_text(CAGE, encoding="utf-8")
    content = {"version": 1, "start": {"joints": {"hoist": 0.5}}, "task": {"goal": {"position": [0.0, 0.0, 2.5]}}}
    plan = bp.plan(bp.load_robot(file, tip="cage"), bp.scene_from_dict(content), method="reactive")
    assert plan.verified, plan.message
    assert 2.5 - 1e-9 <= plan.trajectory.duration <= 2.5 * 1.02


@pytest.mark.parametrize("seed", range(6))
def test_the_same_way_in_less_time_with_a_limit_at_nearly_every_moment(backhoe: bp.Robot, seed: int) -> None:
    q, scene = free_goal(backhoe, seed)
    problem = build_problem(backhoe, scene)
    begun, arrived = by_law(problem, q)
    slow, quick = arrived.trajectory(), speed_up(begun, arrived).trajectory()
    assert shortest_time(slow.q, problem.limits) * 0.97 <= quick.duration < slow.duration
    np.testing.assert_array_equal(quick.q[[0, -1]], slow.q[[0, -1]])
    assert off(quick.q, slow.q) < 0.03
    assert off(slow.q, quick.q) < 0.03
    assert bp.certify(backhoe, scene, quick).verified
    assert np.mean(limit_usage(problem, quick).greatest > 0.9) > 0.85


def test_past_the_pole_the_machine_is_at_a_limit_and_clear(backhoe: bp.Robot) -> None:
    scene = bp.load_scene(SCENES / "pole.yaml")
    plan = bp.plan(backhoe, scene, method="reactive")
    assert plan.verified, plan.message
    assert plan.findings.way == "straight"
    usage = limit_usage(build_problem(backhoe, scene), plan.trajectory)
    assert np.mean(usage.greatest > 0.9) > 0.9
    tightest = plan.certificate.min_clearance
    assert tightest is not None
    assert tightest.distance >= 0.2


def test_among_what_moves_the_times_are_left(backhoe: bp.Robot) -> None:
    q, scene = free_goal(backhoe, 0)
    content = scene.model_dump(mode="json", exclude_defaults=True)
    content["version"] = 1
    content["obstacles"] = [
        {"name": "bird", "shape": "sphere", "radius": 0.1, "position": [0, 30, 20], "velocity": [0, 1, 0]}
    ]
    begun, arrived = by_law(build_problem(backhoe, bp.scene_from_dict(content)), q)
    assert speed_up(begun, arrived) is arrived


@pytest.mark.parametrize("seed", [0, 2, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 3))])
def test_no_goal_takes_longer_than_the_laws_own_motion_or_the_joints_straight_one(backhoe: bp.Robot, seed: int) -> None:
    q, scene = free_goal(backhoe, seed)
    plan = bp.plan(backhoe, scene)
    assert plan.verified, plan.message
    _, arrived = by_law(build_problem(backhoe, scene), q)
    assert plan.trajectory.duration <= arrived.trajectory().duration + 1e-9
    reactive = bp.plan(backhoe, scene, method="reactive")
    assert plan.trajectory.duration <= reactive.trajectory.duration + 1e-9


# --- the paper's iteration ----------------------------------------------------------


def test_a_motion_through_iterates_passes_every_one_and_is_near_the_least_time(planar4: bp.Robot) -> None:
    """Iterates on a quarter of a circle of joint angles, closer and closer, as an iteration that converges."""
    problem = build_problem(planar4, bp.load_scene(SCENES / "paper_planar.yaml"))
    angle = 0.5 * np.pi * (1.0 - 0.7 ** np.arange(40))
    q = np.column_stack((0.5 * np.sin(angle), 0.5 * np.cos(angle), 0.0 * angle, 0.1 * angle))
    motion = time_iterates(problem, q, proximity=bp.Proximity(planar4))
    np.testing.assert_allclose(motion.q[[0, -1]], q[[0, -1]], atol=1e-12)
    assert off(q, motion.q) < 2e-3
    usage = limit_usage(problem, motion)
    assert float(np.max(usage.ratio)) <= 1.01
    assert motion.duration < 3.0 * shortest_time(q, problem.limits)


def test_the_papers_law_takes_no_longer_than_a_few_times_its_rates_allow(planar4: bp.Robot) -> None:
    """With one slow ramp over all iterates it took 148 s, because the corners counted."""
    plan = bp.plan(planar4, bp.load_scene(SCENES / "paper_planar.yaml"), method="paper")
    assert plan.verified, plan.message
    assert plan.trajectory.duration < 10.0


def test_iterates_that_stay_in_one_place_are_a_motion_at_rest(planar4: bp.Robot) -> None:
    problem = build_problem(planar4, bp.load_scene(SCENES / "paper_planar.yaml"))
    motion = time_iterates(problem, np.full((5, 4), 0.1), proximity=bp.Proximity(planar4))
    assert motion.duration == 0.0


@pytest.mark.parametrize("slower", [3.0, 40.0])
def test_a_law_that_leaves_every_limit_unused_is_hastened(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch, slower: float
) -> None:
    """Its samples stay where they are, also where no smoother motion is proven clear, and a limit binds."""
    q, scene = free_goal(backhoe, 0)
    begun, arrived = by_law(build_problem(backhoe, scene), q)
    slow = arrived.trajectory()
    dawdling = begun.branch(attempt=1)
    dawdling.play(bp.Trajectory.from_steps(slower * slow.time, slow.q))
    monkeypatch.setattr("backhoe_planner.planning.reactive.law_timing.segment_is_clear", lambda *_, **__: False)
    found = speed_up(begun, dawdling).trajectory()
    np.testing.assert_array_equal(found.q, slow.q)
    assert found.duration < dawdling.trajectory().duration / 2.0
    assert 0.99 < np.max(limit_usage(begun.problem, found).greatest) <= 1.0
