"""Forward kinematics, Jacobians and pitch against closed formulas and central differences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.machine import Configuration, Kinematics, Robot, TipTarget, load_robot, movable_rows, wrap_angle

STEP = 1e-6

# (a, alpha, d) of the standard Denavit-Hartenberg table, from the lengths in models/backhoe.urdf
BACKHOE_TABLE = [(0.535, np.pi / 2.0, 0.49), (2.4, 0.0, 0.0), (1.8, 0.0, 0.0), (0.95, 0.0, 0.0)]


def denavit_hartenberg(q: Vector) -> Vector:
    T = np.eye(4)
    for (a, alpha, d), theta in zip(BACKHOE_TABLE, q, strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1.0]])
    return T


def central_differences(function: Callable[[Vector], Vector], q: Vector) -> Vector:
    """(m, n)"""
    steps = STEP * np.eye(len(q))
    return np.column_stack([(function(q + step) - function(q - step)) / (2.0 * STEP) for step in steps])


def postures(robot: Robot, count: int = 20, seed: int = 7) -> list[Vector]:
    rng = np.random.default_rng(seed)
    return [robot.random_q(rng) for _ in range(count)]


def test_the_backhoe_tip_agrees_with_a_denavit_hartenberg_table(backhoe: Robot) -> None:
    kinematics = Kinematics(backhoe)
    for q in postures(backhoe, 100):
        T = denavit_hartenberg(q)
        at = kinematics.at(q)
        np.testing.assert_allclose(at.tip_position, T[:3, 3], atol=1e-12)
        # the tip's x is along the bucket in both; its y is the table's -z
        np.testing.assert_allclose(at.tip_rotation[:, 0], T[:3, 0], atol=1e-12)
        np.testing.assert_allclose(at.tip_rotation[:, 1], -T[:3, 2], atol=1e-12)


def test_the_backhoe_tip_agrees_with_the_closed_formula(backhoe: Robot) -> None:
    kinematics = Kinematics(backhoe)
    for swing, boom, stick, bucket in postures(backhoe, 100):
        angles = np.cumsum([boom, stick, bucket])
        out = 0.535 + np.dot([2.4, 1.8, 0.95], np.cos(angles))
        up = 0.49 + np.dot([2.4, 1.8, 0.95], np.sin(angles))
        tip = kinematics.at(np.array([swing, boom, stick, bucket])).tip_position
        np.testing.assert_allclose(tip, [out * np.cos(swing), out * np.sin(swing), up], atol=1e-12)


def test_points_of_the_planar_arm_are_partial_sums_of_its_links(planar4: Robot) -> None:
    kinematics = Kinematics(planar4)
    for q in postures(planar4):
        angles = np.cumsum(q)
        steps = np.column_stack((np.cos(angles), np.sin(angles), np.zeros(4)))
        expected = np.vstack((np.zeros(3), np.cumsum(steps, axis=0)))
        np.testing.assert_allclose(kinematics.at(q).points, expected, atol=1e-12)


def test_the_tip_jacobian_agrees_with_central_differences(any_robot: Robot) -> None:
    kinematics = Kinematics(any_robot)
    for q in postures(any_robot):
        at = kinematics.at(q)

        def pose(x: Vector, R: Vector = at.tip_rotation) -> Vector:
            moved = kinematics.at(x)
            return np.concatenate((moved.tip_position, R @ pin.log3(R.T @ moved.tip_rotation)))

        np.testing.assert_allclose(at.jacobian, central_differences(pose, q), atol=1e-8)


def test_the_joint_jacobian_refers_to_the_origin_of_the_world(any_robot: Robot) -> None:
    at = Kinematics(any_robot).at(postures(any_robot, 1)[0])
    linear = at.J_world[:3] + np.cross(at.J_world[3:].T, at.tip_position).T
    np.testing.assert_allclose(linear, at.jacobian[:3], atol=1e-12)
    np.testing.assert_allclose(at.J_world[3:], at.jacobian[3:], atol=1e-12)


def test_the_pitch_is_boom_plus_stick_plus_bucket(backhoe: Robot) -> None:
    kinematics = Kinematics(backhoe)
    for q in postures(backhoe, 200):
        off = kinematics.at(q).pitch - q[1:].sum()
        assert abs(wrap_angle(off)) < 1e-12


def test_the_pitch_of_the_level_arm_is_0_and_up_is_positive(backhoe: Robot) -> None:
    kinematics = Kinematics(backhoe)
    assert kinematics.at(np.zeros(4)).pitch == 0.0
    assert kinematics.at(np.array([0.7, 0.1, 0.0, 0.0])).pitch == pytest.approx(0.1)


def test_the_pitch_row_agrees_with_central_differences(backhoe: Robot) -> None:
    kinematics = Kinematics(backhoe)
    for q in postures(backhoe):
        at = kinematics.at(q)

        def turned(x: Vector, pitch: float = at.pitch) -> Vector:
            return np.array([wrap_angle(kinematics.at(x).pitch - pitch)])

        expected = central_differences(turned, q)
        np.testing.assert_allclose(at.pitch_row, expected[0], atol=1e-8)
        np.testing.assert_allclose(at.pitch_row, [0.0, 1.0, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_the_pitch_is_positive_up_for_both_directions_of_the_joint_axes(tmp_path: Path, side: int) -> None:
    """Hinges about +y are usual in URDFs of excavators."""
    limit = '<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>'
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="base"/><link name="boom"/><link name="bucket"/><link name="tip"/>'
        f'<joint name="boom" type="revolute"><parent link="base"/><child link="boom"/><axis xyz="0 {side} 0"/>{limit}'
        '</joint><joint name="bucket" type="revolute"><parent link="boom"/><child link="bucket"/>'
        f'<origin xyz="1 0 0"/><axis xyz="0 {side} 0"/>{limit}</joint>'
        '<joint name="end" type="fixed"><parent link="bucket"/><child link="tip"/><origin xyz="1 0 0"/></joint></robot>'
    )
    robot = load_robot(path)
    kinematics = Kinematics(robot)
    assert kinematics.at(np.zeros(2)).pitch == pytest.approx(0.0)
    raised = kinematics.at(np.array([-0.1, -0.2]) * side)
    assert raised.tip_position[2] > 0.0
    assert raised.pitch == pytest.approx(0.3)
    np.testing.assert_allclose(raised.pitch_row, [-side, -side], atol=1e-12)


@pytest.mark.parametrize("name", ["planar4", "ur5", "panda"])
def test_a_pitch_is_refused_if_the_last_axis_is_not_horizontal(name: str, request: pytest.FixtureRequest) -> None:
    robot: Robot = request.getfixturevalue(name)
    assert not robot.has_pitch
    with pytest.raises(InputError, match=r"pitch is not defined for this arm.*rpy or quaternion"):
        _ = Kinematics(robot).at(np.zeros(robot.n) - 0.1).pitch


def test_a_configuration_keeps_its_own_read_only_q(planar4: Robot) -> None:
    q = np.zeros(4)
    at = Kinematics(planar4).at(q)
    q[0] = 1.0
    assert at.q[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        at.q[0] = 1.0


def test_a_configuration_is_not_changed_by_the_next_one(any_robot: Robot) -> None:
    kinematics = Kinematics(any_robot)
    first, second = postures(any_robot, 2)
    at = kinematics.at(first)
    kept = [at.tip_position.copy(), at.tip_rotation.copy(), at.jacobian.copy(), at.J_world.copy(), at.points.copy()]
    kinematics.at(second)
    now = [at.tip_position, at.tip_rotation, at.jacobian, at.J_world, at.points]
    for before, after in zip(kept, now, strict=True):
        np.testing.assert_array_equal(before, after)


def test_an_arm_of_one_joint_has_jacobians_of_one_column(tmp_path: Path) -> None:
    path = tmp_path / "door.urdf"
    path.write_text(
        '<robot name="door"><link name="wall"/><link name="door"/><link name="handle"/>'
        '<joint name="hinge" type="revolute"><parent link="wall"/><child link="door"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint><joint name="fix" type="fixed">'
        '<parent link="door"/><child link="handle"/><origin xyz="2 0 0"/></joint></robot>'
    )
    robot = load_robot(path)
    at = Kinematics(robot).at(np.zeros(1))
    np.testing.assert_allclose(at.jacobian, [[0.0], [2.0], [0.0], [0.0], [0.0], [1.0]], atol=1e-15)
    np.testing.assert_allclose(at.J_world, [[0.0], [0.0], [0.0], [0.0], [0.0], [1.0]], atol=1e-15)
    assert not robot.has_pitch


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_is_equivalent_and_within_half_a_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angle), abs=1e-9)


# --- targets ------------------------------------------------------------------


def target_jacobian_holds(robot: Robot, make: Callable[[Configuration], TipTarget]) -> None:
    kinematics = Kinematics(robot)
    for q in postures(robot):
        at = kinematics.at(q)
        target = make(at)

        def error(x: Vector, target: TipTarget = target) -> Vector:
            return target.error(kinematics.at(x))

        expected = central_differences(error, q)
        np.testing.assert_allclose(target.jacobian(at), -expected, atol=1e-8)


def test_the_jacobian_of_a_position_target_agrees_with_central_differences(any_robot: Robot) -> None:
    target_jacobian_holds(any_robot, lambda at: TipTarget(at.tip_position + np.array([0.3, -0.2, 0.1])))


def test_the_jacobian_of_a_pitch_target_agrees_with_central_differences_outside_the_range(backhoe: Robot) -> None:
    for low, high in ((-0.5, -0.3), (0.3, 0.5)):

        def beside(at: Configuration, low: float = low, high: float = high) -> TipTarget:
            return TipTarget(at.tip_position, pitch=(at.pitch + low, at.pitch + high))

        target_jacobian_holds(backhoe, beside)


def test_the_jacobian_of_a_rotation_target_agrees_with_central_differences_at_the_target(any_robot: Robot) -> None:
    target_jacobian_holds(any_robot, lambda at: TipTarget(at.tip_position + 0.1, rotation=at.tip_rotation))


def test_the_rotation_error_is_the_rotation_vector_in_world_axes(ur5: Robot) -> None:
    at = Kinematics(ur5).at(postures(ur5, 1)[0])
    turn = np.array([0.0, 0.0, 0.7])
    target = TipTarget(at.tip_position, rotation=pin.exp3(turn) @ at.tip_rotation)
    np.testing.assert_allclose(target.error(at), [0.0, 0.0, 0.0, *turn], atol=1e-12)
    position, angle = target.distances(at)
    assert position == 0.0
    assert angle == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("pitch", "excess"),
    [(-1.5, 0.0), (-2.2, 0.0), (-1.2, 0.0), (-1.0, 0.2), (-2.5, -0.3), (-1.0 + 2.0 * np.pi, 0.2), (0.0, 1.2)],
)
def test_the_pitch_excess_is_0_inside_the_range_and_signed_outside(pitch: float, excess: float) -> None:
    assert TipTarget(np.zeros(3), pitch=(-2.2, -1.2)).pitch_excess(pitch) == pytest.approx(excess)


def test_a_pitch_range_of_a_whole_turn_leaves_the_pitch_free() -> None:
    target = TipTarget(np.zeros(3), pitch=(-np.pi, np.pi))
    assert [target.pitch_excess(pitch) for pitch in np.linspace(-7.0, 7.0, 29)] == [0.0] * 29


def test_no_joint_moves_a_planar_arm_out_of_its_plane(planar4: Robot) -> None:
    at = Kinematics(planar4).at(np.array([0.1, 0.2, 0.3, 0.4]))
    np.testing.assert_array_equal(movable_rows(at.jacobian), [True, True, False, False, False, True])
