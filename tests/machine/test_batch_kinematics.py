"""Kinematics of many configurations at once equals that of each one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch

SLIDER = """<robot name="slider">
  <link name="base"/><link name="cart"/><link name="arm"/><link name="tip"/>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.5" rpy="0.3 0 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
  <joint name="turn" type="revolute"><parent link="cart"/><child link="arm"/><axis xyz="0 0.6 0.8"/>
    <origin xyz="0.2 0 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.7 0.1 0" rpy="0 0.4 0"/></joint>
</robot>"""


def _random(robot: bp.Robot, count: int, seed: int = 0) -> NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return np.array([robot.random_q(rng) for _ in range(count)])


def test_batch_kinematics_agree_with_pinocchio(any_robot: bp.Robot) -> None:
    q = _random(any_robot, 50)
    at = BatchKinematics(any_robot).at(q)
    np.testing.assert_allclose(BatchKinematics(any_robot).tip_positions(q), at.tip_position, atol=1e-12)
    kinematics = bp.Kinematics(any_robot)
    for row, one in enumerate(map(kinematics.at, q)):
        np.testing.assert_allclose(at.tip_position[row], one.tip_position, atol=1e-12)
        np.testing.assert_allclose(at.tip_rotation[row], one.tip_rotation, atol=1e-12)
        np.testing.assert_allclose(at.position_jacobian()[row], one.jacobian[:3], atol=1e-12)
        np.testing.assert_allclose(at.rotation_jacobian()[row], one.jacobian[3:], atol=1e-12)
        if any_robot.has_pitch:
            assert at.pitch()[row] == pytest.approx(one.pitch, abs=1e-12)
            np.testing.assert_allclose(at.pitch_rows()[row], one.pitch_row, atol=1e-12)


def test_batch_kinematics_of_a_slide_agree_with_pinocchio(tmp_path: object) -> None:
    from pathlib import Path

    file = Path(str(tmp_path)) / "slider.urdf"
    file.write_text(SLIDER)
    robot = bp.load_robot(file, tip="tip")
    q = _random(robot, 20)
    at = BatchKinematics(robot).at(q)
    np.testing.assert_allclose(BatchKinematics(robot).tip_positions(q), at.tip_position, atol=1e-12)
    for row, one in enumerate(map(bp.Kinematics(robot).at, q)):
        np.testing.assert_allclose(at.tip_position[row], one.tip_position, atol=1e-12)
        np.testing.assert_allclose(at.position_jacobian()[row], one.jacobian[:3], atol=1e-12)
        np.testing.assert_allclose(at.rotation_jacobian()[row], one.jacobian[3:], atol=1e-12)


def test_batch_errors_and_jacobians_equal_those_of_single_targets(any_robot: bp.Robot) -> None:
    kinematics = bp.Kinematics(any_robot)
    goals, places = _random(any_robot, 20, seed=1), _random(any_robot, 20, seed=2)
    targets = []
    for number, goal in enumerate(map(kinematics.at, goals)):
        kind = number % 3
        if kind == 0:
            targets.append(TipTarget(goal.tip_position.copy()))
        elif kind == 1:
            targets.append(TipTarget(goal.tip_position.copy(), rotation=goal.tip_rotation.copy()))
        else:
            span = (-2.0, -1.5) if any_robot.has_pitch else None
            targets.append(TipTarget(goal.tip_position.copy(), pitch=span))
        if number >= 10:
            targets[-1] = replace(targets[-1], position_tolerance=0.3 * number)
    batch = TargetBatch.of(targets)
    at = BatchKinematics(any_robot).at(places)
    errors, jacobians = batch.errors(at), batch.jacobians(at)
    for row, target in enumerate(targets):
        one = kinematics.at(places[row])
        rows = [0, 1, 2] + ([3, 4, 5] if target.rotation is not None else [6] if target.pitch is not None else [])
        np.testing.assert_allclose(errors[row, rows], target.error(one), atol=1e-9)
        np.testing.assert_allclose(jacobians[row, rows], target.jacobian(one), atol=1e-9)
        assert np.count_nonzero(np.delete(errors[row], rows)) == 0


def test_only_what_is_beyond_a_position_tolerance_is_an_error(backhoe: bp.Robot) -> None:
    """The tip is 0.5 m beside the target. To first order, a step reduces the error by jacobian @ dq."""
    kinematics, q = bp.Kinematics(backhoe), np.array([0.3, 0.4, -1.6, -0.9])
    at = kinematics.at(q)
    off = np.array([0.3, 0.0, -0.4])
    for tolerance, beyond in ((0.2, 0.3), (0.5, 0.0), (0.7, 0.0)):
        target = TipTarget(at.tip_position + off, position_tolerance=tolerance)
        np.testing.assert_allclose(target.error(at), beyond * off / 0.5, atol=1e-12)
        assert target.distances(at) == pytest.approx((beyond, 0.0), abs=1e-12)
    target = TipTarget(at.tip_position + off, position_tolerance=0.2)
    for dq in 1e-6 * np.eye(4):
        less = target.error(at) - target.error(kinematics.at(q + dq))
        np.testing.assert_allclose(target.jacobian(at) @ dq, less, atol=1e-10)
    assert not TipTarget(at.tip_position + off, position_tolerance=0.6).jacobian(at).any()


def test_solutions_end_within_a_position_tolerance(any_robot: bp.Robot) -> None:
    goals, guesses = _random(any_robot, 60, seed=3), _random(any_robot, 60, seed=4)
    kinematics = bp.Kinematics(any_robot)
    targets = [TipTarget(kinematics.at(q).tip_position.copy(), position_tolerance=0.1) for q in goals]
    q, reached = solve_batch(BatchKinematics(any_robot), TargetBatch.of(targets), guesses)
    assert reached.any()
    for row in np.flatnonzero(reached):
        assert np.linalg.norm(kinematics.at(q[row]).tip_position - targets[row].position) <= 0.1 + 1e-7


def test_solutions_are_on_the_target_and_within_the_joint_limits(any_robot: bp.Robot) -> None:
    kinematics = bp.Kinematics(any_robot)
    goals = _random(any_robot, 60, seed=3)
    full = any_robot.n >= 6
    targets = [
        TipTarget(one.tip_position.copy(), rotation=one.tip_rotation.copy() if full else None)
        for one in map(kinematics.at, goals)
    ]
    near = np.clip(goals + 0.05, any_robot.limits.lower, any_robot.limits.upper)
    q, reached = solve_batch(BatchKinematics(any_robot), TargetBatch.of(targets), near)
    assert reached.mean() > 0.95
    for row in np.flatnonzero(reached):
        one = kinematics.at(q[row])
        assert np.linalg.norm(one.tip_position - targets[row].position) < 1e-7
        if full:
            assert max(targets[row].distances(one)) < 1e-7
    assert np.all(q >= any_robot.limits.lower)
    assert np.all(q <= any_robot.limits.upper)


def test_targets_out_of_reach_are_not_reached(backhoe: bp.Robot) -> None:
    batch = TargetBatch.of([TipTarget(np.array([50.0, 0.0, 0.0]))] * 8)
    _, reached = solve_batch(BatchKinematics(backhoe), batch, _random(backhoe, 8))
    assert not reached.any()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, 2.6, 2.7, np.pi - 1e-3, np.pi - 1e-9, np.pi - 1e-13])
def test_orientation_errors_are_the_remaining_rotation_vectors(panda: bp.Robot, angle: float) -> None:
    """The target orientation is the tip's, turned about a known axis by a known angle, up to half a turn."""
    rng = np.random.default_rng(int(1e6 * angle))
    q = np.array([panda.random_q(rng) for _ in range(5)])
    axes = rng.standard_normal((5, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    at = BatchKinematics(panda).at(q)
    asked = [
        TipTarget(p, rotation=pin.exp3(angle * axis) @ R)
        for p, R, axis in zip(at.tip_position, at.tip_rotation, axes, strict=True)
    ]
    turns = TargetBatch.of(asked).errors(at)[:, 3:6]
    np.testing.assert_allclose(turns, angle * axes, atol=1e-7 if angle > 3.0 else 1e-12)


def test_a_guess_that_is_not_a_number_fails_alone(panda: bp.Robot) -> None:
    """The searches beside it end as they do without it."""
    kinematics, rng = BatchKinematics(panda), np.random.default_rng(8)
    q = np.array([panda.random_q(rng) for _ in range(6)])
    at = [bp.Kinematics(panda).at(one) for one in q]
    targets = TargetBatch.of([TipTarget(one.tip_position, rotation=one.tip_rotation) for one in at])
    guesses = q + 0.02 * rng.normal(size=q.shape)
    others = np.arange(6) != 2
    alone, arrived = solve_batch(kinematics, targets.take(others), guesses[others])
    assert arrived.all()
    guesses[2, 3] = np.nan
    found, reached = solve_batch(kinematics, targets, guesses)
    np.testing.assert_array_equal(reached, others)
    assert np.isnan(found[2, 3])
    np.testing.assert_allclose(found[others], alone, atol=1e-9)
