"""The tilt of the tip: angles and rotation vectors of known turns, Jacobians, and inverse kinematics onto it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch, tilt_angles, tilt_turns

UP = np.array([0.0, 0.0, 1.0])


def turned(rpy: tuple[float, float, float]) -> Vector:
    """(3,) where the z axis points after a rotation."""
    return np.asarray(pin.rpy.rpyToMatrix(*rpy) @ UP)


@pytest.mark.parametrize(
    ("rpy", "angle"),
    [
        ((0.0, 0.0, 1.3), 0.0),  # a heading is no tilt
        ((0.4, 0.0, -2.0), 0.4),
        ((0.0, -0.3, 0.7), 0.3),
        ((0.4, 0.3, 0.7), np.arccos(np.cos(0.4) * np.cos(0.3))),
        ((np.pi, 0.0, 0.2), np.pi),
    ],
)
def test_a_tilt_is_the_angle_between_axis_and_direction(rpy: tuple[float, float, float], angle: float) -> None:
    u = turned(rpy)
    assert tilt_angles(u[None], UP)[0] == pytest.approx(angle, abs=1e-12)
    turn = tilt_turns(u[None], UP[None])[0]
    assert np.linalg.norm(turn) == pytest.approx(angle, abs=1e-12)
    np.testing.assert_allclose(pin.exp3(turn) @ u, UP, atol=1e-12)
    assert turn @ u == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("tolerance", [0.0, 0.2, 4.0 * np.pi / 5.0])
def test_jacobians_of_a_tilt_equal_central_differences_and_the_batch_equals_single_targets(
    any_robot: bp.Robot, tolerance: float
) -> None:
    rng, h, kinematics = np.random.default_rng(0), 1e-6, bp.Kinematics(any_robot)
    tilts = [bp.Tilt(rng.normal(size=3), rng.normal(size=3), tolerance) if number % 3 else None for number in range(12)]
    targets = [bp.TipTarget(rng.normal(size=3), tilt=tilt) for tilt in tilts]
    q = np.array([any_robot.random_q(rng) for _ in targets])
    batch, at = TargetBatch.of(targets), BatchKinematics(any_robot).at(q)
    errors, jacobians = batch.errors(at), batch.jacobians(at)
    for row, target in enumerate(targets):
        rows = [0, 1, 2] + [7, 8, 9] * (target.tilt is not None)
        J = target.jacobian(kinematics.at(q[row]))
        np.testing.assert_allclose(errors[row, rows], target.error(kinematics.at(q[row])), atol=1e-12)
        np.testing.assert_allclose(jacobians[row, rows], J, atol=1e-12)
        assert not np.delete(errors[row], rows).any()
        for joint, step in enumerate(h * np.eye(any_robot.n)):
            ends = [target.error(kinematics.at(q[row] + sign * step)) for sign in (1.0, -1.0)]
            np.testing.assert_allclose(J[:, joint], (ends[1] - ends[0]) / (2.0 * h), rtol=1e-6, atol=1e-6)


def test_a_jacobian_near_no_tilt_and_at_half_a_turn_is_finite(tmp_path: Path) -> None:
    """The tip turns about the world's axes x, y and z. Near no tilt x and y count in full, z does not.

    At half a turn only the rotation the shortest way is left.
    """
    hinges = "".join(
        f'<link name="{name}"/><joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{name}"/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        for parent, name, axis in (("base", "x", "1 0 0"), ("x", "y", "0 1 0"), ("y", "z", "0 0 1"))
    )
    file = tmp_path / "ball.urdf"
    file.write_text(f'<robot name="ball"><link name="base"/>{hinges}</robot>')
    at = bp.Kinematics(bp.load_robot(file, tip="z")).at(np.zeros(3))
    for angle in (0.0, 1e-12, 1e-7, 1e-4):
        J = bp.TipTarget(np.zeros(3), tilt=bp.Tilt(turned((angle, 0.0, 0.0)), UP)).jacobian(at)
        np.testing.assert_allclose(J[3:], np.diag([1.0, 1.0, 0.0]), atol=1.1 * angle + 1e-15)
    target = bp.TipTarget(np.zeros(3), tilt=bp.Tilt(-UP, UP))
    error, J = target.error(at)[3:], target.jacobian(at)[3:]
    assert np.linalg.norm(error) == pytest.approx(np.pi)
    assert error[2] == 0.0
    np.testing.assert_allclose(J @ error, error, atol=1e-12)


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
def test_inverse_kinematics_reaches_a_narrow_tilt_on_arms_with_six_and_seven_joints(
    ur5: bp.Robot, panda: bp.Robot, tolerance: float
) -> None:
    """Each target is the tip's place in a random posture, so that it can be reached. Half of the searches get there."""
    for robot in (ur5, panda):
        rng, batch = np.random.default_rng(1), BatchKinematics(robot)
        q, guesses = (np.array([robot.random_q(rng) for _ in range(60)]) for _ in range(2))
        at = batch.at(q)
        tilts = [bp.Tilt(UP, rotation[:, 2], tolerance) for rotation in at.tip_rotation]
        targets = [bp.TipTarget(p, tilt=tilt) for p, tilt in zip(at.tip_position, tilts, strict=True)]
        found, reached = solve_batch(batch, TargetBatch.of(targets), guesses)
        ends = batch.at(found[reached])
        assert reached.sum() > 20
        np.testing.assert_allclose(ends.tip_position, at.tip_position[reached], atol=1e-7)
        for rotation, tilt in zip(ends.tip_rotation, np.array(tilts)[reached], strict=True):
            assert np.arccos(np.clip(rotation[:, 2] @ tilt.direction, -1.0, 1.0)) < tolerance + 1e-6


def test_an_axis_and_a_direction_have_any_length_but_0() -> None:
    tilt = bp.Tilt(3.0 * UP, np.array([0.0, 0.5, 0.0]), 0.1)
    assert tilt.axis.tolist() == [0.0, 0.0, 1.0]
    assert tilt.direction.tolist() == [0.0, 1.0, 0.0]
    long = bp.Tilt(np.array([0.0, 3e200, 4e200]), UP)  # the square of its length is no number
    np.testing.assert_allclose(long.axis, [0.0, 0.6, 0.8], atol=1e-15)
    for key, vectors in (("axis", (np.zeros(3), UP)), ("direction", (UP, np.zeros(3)))):
        with pytest.raises(bp.InputError, match=f"{key}: has no direction"):
            bp.Tilt(*vectors)
