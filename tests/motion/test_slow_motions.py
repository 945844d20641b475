"""Motions with little progress: very slow ones, and stations without length."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import SAMPLE_PERIOD, FastestRun, TipPath, build_problem
from backhoe_planner.planning import resolve_along
from backhoe_planner.site import Proximity, Waypoint


def test_a_very_slow_motion_has_samples_only_where_it_moves(planar4: bp.Robot) -> None:
    """1 m of the tip at 0.1 mm/s are 500,000 periods; then the joints turn while the tip is at rest."""
    stations = np.concatenate((np.linspace(0.0, 1.0, 101), np.ones(20)))
    turn = np.concatenate((np.linspace(0.0, 0.3, 101), np.linspace(0.3, 1.0, 21)[1:]))
    q = np.outer(turn, [1.0, -1.0, 0.5, 0.2])
    limits = planar4.limits
    motion = FastestRun(stations, q, limits, speed=1e-4).motion(SAMPLE_PERIOD)
    assert len(motion) < 5000
    assert motion.duration == pytest.approx(1e4, rel=0.01)
    np.testing.assert_allclose(motion.q[[0, -1]], q[[0, -1]], atol=1e-12)
    # a step is at most the requested one plus that of one period of 0.02 s at full rate
    assert np.all(np.abs(np.diff(motion.q, axis=0)) <= 2.5e-3 + 0.02 * limits.velocity)
    assert np.all(np.abs(motion.segment_velocities()) <= limits.velocity * (1.0 + 1e-9))
    assert np.all(np.abs(motion.corner_accelerations()) <= limits.acceleration * (1.0 + 1e-9))


@pytest.mark.long
def test_a_path_at_a_tenth_of_a_millimetre_per_second_is_planned(backhoe: bp.Robot) -> None:
    points = [{"position": [4.6, 0.0, -0.3]}, {"position": [4.2, 0.0, -0.45]}]
    scene = bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": points, "speed": 1e-4}}})
    found = bp.plan(backhoe, scene, effort="quick")
    assert found.verified, found.message
    assert found.trajectory.duration == pytest.approx(np.hypot(0.4, 0.15) / 1e-4, rel=0.01)
    assert len(found.trajectory) < 5000
    assert found.certificate.tracking.max_error < 0.005


@pytest.mark.parametrize("rate", [pytest.param(1e-2, marks=pytest.mark.long), 1e-3])
def test_a_slow_joint_takes_the_time_of_its_distance_at_full_rate(planar4: bp.Robot, rate: float) -> None:
    """0.8 rad at the full rate, which it reaches at once."""
    names = planar4.joint_names
    start, goal = dict.fromkeys(names, 0.0), dict.fromkeys(names, 0.1) | {names[0]: 0.8}
    limits = {"velocity": {names[0]: rate}}
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": goal}}, "limits": limits}
    plan = bp.plan(planar4, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    assert 0.8 / rate <= plan.trajectory.duration <= 1.02 * 0.8 / rate


A, B = {"position": [4.6, 0.0, -0.3]}, {"position": [3.9, 0.0, -0.6]}


@pytest.mark.parametrize("method", ["auto", pytest.param("reactive", marks=pytest.mark.long)])
def test_repeated_waypoints_change_nothing(backhoe: bp.Robot, method: str) -> None:
    """Without warnings, which are errors in tests."""

    def planned(*waypoints: dict[str, list[float]]) -> bp.Plan:
        task = {"path": {"waypoints": list(waypoints), "speed": 0.5}}
        return bp.plan(backhoe, bp.scene_from_dict({"version": 1, "task": task}), method=method, effort="quick")

    once, twice = planned(A, B), planned(A, A, B, B)
    assert once.verified
    assert twice.verified
    np.testing.assert_array_equal(twice.trajectory.q, once.trajectory.q)
    assert twice.metrics.objective == once.metrics.objective


def test_the_law_follows_a_path_with_legs_without_length(backhoe: bp.Robot) -> None:
    content = {"version": 1, "task": {"path": {"waypoints": [A, B]}}}
    problem = build_problem(backhoe, bp.scene_from_dict(content))
    path = TipPath([Waypoint.model_validate(point) for point in (A, A, B, B)])
    kinematics, proximity = bp.Kinematics(backhoe), Proximity(backhoe, ())
    start = bp.solve_inverse_kinematics(backhoe, path.target(0.0)).q
    found = resolve_along(problem, path, 0.0, start, proximity=proximity, kinematics=kinematics)
    assert found.obstruction is None
    assert np.all(np.isfinite(found.q))
    assert found.reached == pytest.approx(np.hypot(0.7, 0.3))
