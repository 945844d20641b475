"""The law's motions as fast as the machine allows: known durations, the same path, limits that bind."""

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
    """A motion at rest at q, and the law's motion straight to the goal from there."""
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
    """A lower bound of the duration along the polyline q (T, n) [s], from the joints' velocity limits alone."""
    return float(np.sum(np.max(np.abs(np.diff(q, axis=0)) / limits.velocity, axis=1)))


def off(q: Array, corners: Array) -> float:
    """The largest distance of the places q (K, n) from the polyline [rad]."""
    begin, step = corners[:-1], np.diff(corners, axis=0)
    part = np.einsum("kmn,mn->km", q[:, None] - begin, step) / np.maximum(np.sum(step**2, axis=1), 1e-18)
    near = begin + np.clip(part, 0.0, 1.0)[:, :, None] * step
    return float(np.max(np.min(np.linalg.norm(q[:, None] - near, axis=2), axis=1)))


def test_places_are_even_in_time_on_a_bent_path() -> None:
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


def test_a_slide_takes_the_duration_of_the_textbook_trapezium(tmp_path: Path) -> None:
    """2 m at 1 m/s and 2 m/s^2: d / v + v / a = 2.5 s."""
    file = tmp_path / "lift.urdf"
    file.write_text(CAGE, encoding="utf-8")
    content = {"version": 1, "start": {"joints": {"hoist": 0.5}}, "task": {"goal": {"position": [0.0, 0.0, 2.5]}}}
    plan = bp.plan(bp.load_robot(file, tip="cage"), bp.scene_from_dict(content), method="reactive")
    assert plan.verified, plan.message
    assert 2.5 - 1e-9 <= plan.trajectory.duration <= 2.5 * 1.02


@pytest.mark.parametrize("seed", range(6))
def test_speeding_up_keeps_the_path_and_a_limit_binds_nearly_always(backhoe: bp.Robot, seed: int) -> None:
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


def test_past_the_pole_a_limit_binds_nearly_always_and_clearance_is_kept(backhoe: bp.Robot) -> None:
    scene = bp.load_scene(SCENES / "pole.yaml")
    plan = bp.plan(backhoe, scene, method="reactive")
    assert plan.verified, plan.message
    assert plan.findings.way == "straight"
    usage = limit_usage(build_problem(backhoe, scene), plan.trajectory)
    assert np.mean(usage.greatest > 0.9) > 0.9
    tightest = plan.certificate.min_clearance
    assert tightest is not None
    assert tightest.distance >= 0.2


def test_among_moving_obstacles_the_timing_is_not_changed(backhoe: bp.Robot) -> None:
    q, scene = free_goal(backhoe, 0)
    content = scene.model_dump(mode="json", exclude_defaults=True)
    content["version"] = 1
    content["obstacles"] = [
        {"name": "bird", "shape": "sphere", "radius": 0.1, "position": [0, 30, 20], "velocity": [0, 1, 0]}
    ]
    begun, arrived = by_law(build_problem(backhoe, bp.scene_from_dict(content)), q)
    assert speed_up(begun, arrived) is arrived


@pytest.mark.parametrize("seed", [0, 2, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 3))])
def test_no_plan_takes_longer_than_the_law_before_or_after_speeding_up(backhoe: bp.Robot, seed: int) -> None:
    q, scene = free_goal(backhoe, seed)
    plan = bp.plan(backhoe, scene)
    assert plan.verified, plan.message
    _, arrived = by_law(build_problem(backhoe, scene), q)
    assert plan.trajectory.duration <= arrived.trajectory().duration + 1e-9
    reactive = bp.plan(backhoe, scene, method="reactive")
    assert plan.trajectory.duration <= reactive.trajectory.duration + 1e-9


# --- the paper's iteration ----------------------------------------------------------


def test_a_motion_passes_all_iterates_in_near_the_least_duration(planar4: bp.Robot) -> None:
    """Iterates on a quarter of a circle of joint angles, ever closer, as those of an iteration that converges."""
    problem = build_problem(planar4, bp.load_scene(SCENES / "paper_planar.yaml"))
    angle = 0.5 * np.pi * (1.0 - 0.7 ** np.arange(40))
    q = np.column_stack((0.5 * np.sin(angle), 0.5 * np.cos(angle), 0.0 * angle, 0.1 * angle))
    motion = time_iterates(problem, q, proximity=bp.Proximity(planar4))
    np.testing.assert_allclose(motion.q[[0, -1]], q[[0, -1]], atol=1e-12)
    assert off(q, motion.q) < 2e-3
    usage = limit_usage(problem, motion)
    assert float(np.max(usage.ratio)) <= 1.01
    assert motion.duration < 3.0 * shortest_time(q, problem.limits)


def test_the_motion_of_the_method_paper_takes_less_than_10_s(planar4: bp.Robot) -> None:
    """With one slow ramp over all iterates it took 148 s, because of the corners."""
    plan = bp.plan(planar4, bp.load_scene(SCENES / "paper_planar.yaml"), method="paper")
    assert plan.verified, plan.message
    assert plan.trajectory.duration < 10.0


def test_equal_iterates_are_a_motion_at_rest(planar4: bp.Robot) -> None:
    problem = build_problem(planar4, bp.load_scene(SCENES / "paper_planar.yaml"))
    motion = time_iterates(problem, np.full((5, 4), 0.1), proximity=bp.Proximity(planar4))
    assert motion.duration == 0.0


@pytest.mark.parametrize("slower", [3.0, 40.0])
def test_a_motion_that_uses_no_limit_is_sped_up(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch, slower: float
) -> None:
    """No smoother motion is proven clear here: the samples stay where they are, and a limit binds."""
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
