"""The working envelope, the Denavit-Hartenberg table, and the dynamics."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import (
    GRAVITY,
    Dynamics,
    Kinematics,
    Robot,
    dh_table,
    load_robot,
    motion_energy,
    working_envelope,
)

# CAT 420D class, dealer specification sheet, standard stick
SHEET = {"digging_depth": 4.39, "reach_at_ground": 5.65, "loading_height": 3.61, "loading_reach": 1.73}


def test_the_backhoe_agrees_with_the_published_data_sheet_within_two_percent(backhoe: Robot) -> None:
    envelope = working_envelope(backhoe)
    assert envelope is not None
    for name, published in SHEET.items():
        assert getattr(envelope, name) == pytest.approx(published, rel=0.02), name
    assert np.degrees(envelope.bucket_rotation) == pytest.approx(205.0, rel=0.02)
    assert envelope.swing_arc is not None
    assert np.degrees(envelope.swing_arc) == pytest.approx(180.0, rel=0.02)


def test_no_random_configuration_leaves_the_envelope(backhoe: Robot) -> None:
    envelope = working_envelope(backhoe)
    assert envelope is not None
    kinematics, rng = Kinematics(backhoe), np.random.default_rng(4)
    tips = np.array([kinematics.at(backhoe.random_q(rng)).tip_position for _ in range(3000)])
    assert np.max(-tips[:, 2]) <= envelope.digging_depth + 1e-9
    assert np.max(tips[:, 2]) <= envelope.largest_height + 1e-9
    assert np.max(np.hypot(tips[:, 0], tips[:, 1])) <= envelope.largest_reach + 1e-9
    # it is not far too large either
    assert np.max(-tips[:, 2]) > 0.9 * envelope.digging_depth
    assert np.max(np.hypot(tips[:, 0], tips[:, 1])) > 0.95 * envelope.largest_reach


def test_an_arm_in_a_level_plane_has_no_envelope(planar4: Robot) -> None:
    assert working_envelope(planar4) is None


def test_the_dh_table_of_the_planar_arm_is_four_metres_long(planar4: Robot) -> None:
    rows = dh_table(planar4).rows
    np.testing.assert_allclose([row.a for row in rows], 1.0, atol=1e-12)
    np.testing.assert_allclose([[row.theta, row.d, row.alpha] for row in rows], 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("source", "tip"),
    [
        ("example:backhoe", None),
        ("example:planar4", None),
        ("example:panda", "panda_hand_tcp"),
        ("example:ur5", "tool0"),
    ],
)
def test_the_dh_table_gives_the_same_tip_as_pinocchio(source: str, tip: str | None) -> None:
    robot = load_robot(source, tip=tip)
    table, kinematics, rng = dh_table(robot), Kinematics(robot), np.random.default_rng(5)
    for _ in range(50):
        q = robot.random_q(rng)
        expected = kinematics.at(q).T_world_tip
        np.testing.assert_allclose(table.tip(q).homogeneous, expected.homogeneous, atol=1e-12)


def test_a_payload_adds_its_weight_at_the_tip(backhoe: Robot) -> None:
    q = np.array([0.3, 0.2, -0.9, -0.6])
    still = np.zeros(4)
    empty = Dynamics(backhoe).torques(q, still, still)
    loaded = Dynamics(backhoe, payload=250.0).torques(q, still, still)
    J = Kinematics(backhoe).at(q).jacobian[:3]
    np.testing.assert_allclose(loaded - empty, J.T @ np.array([0.0, 0.0, 250.0 * GRAVITY]), rtol=1e-9, atol=1e-6)


def test_a_payload_beside_the_tip_weighs_at_its_own_place(backhoe: Robot) -> None:
    """Its torque is the gradient of m g z of that point, by differences."""
    q, still, at = np.array([0.3, 0.2, -0.9, -0.6]), np.zeros(4), np.array([-0.5, 0.1, 0.16])

    def height(q: Vector) -> float:
        pose = Kinematics(backhoe).at(q)
        return float(pose.tip_position[2] + pose.tip_rotation[2] @ at)

    empty = Dynamics(backhoe).torques(q, still, still)
    loaded = Dynamics(backhoe, payload=250.0, payload_at=at.tolist()).torques(q, still, still)
    slope = [(height(q + e) - height(q - e)) / 2e-6 for e in 1e-6 * np.eye(4)]
    np.testing.assert_allclose(loaded - empty, 250.0 * GRAVITY * np.array(slope), atol=1e-4)


def test_a_payload_leaves_the_robot_as_it_was(backhoe: Robot) -> None:
    before = [inertia.mass for inertia in backhoe.model.inertias]
    Dynamics(backhoe, payload=500.0)
    assert [inertia.mass for inertia in backhoe.model.inertias] == before


def test_lifting_slowly_takes_the_gain_in_potential_energy(backhoe: Robot) -> None:
    """The boom rises smoothly: the work is the change of potential energy, and none is recovered."""
    time = np.linspace(0.0, 60.0, 4001)
    part = time / 60.0
    ramp = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    start, end = np.array([0.0, 0.0, -1.2, -0.3]), np.array([0.0, 0.6, -1.2, -0.3])
    q = start + ramp[:, None] * (end - start)
    v = np.gradient(q, time, axis=0)
    a = np.gradient(v, time, axis=0)
    work = motion_energy(backhoe, time, q=q, v=v, a=a).work[-1]
    dynamics = Dynamics(backhoe)
    assert work == pytest.approx(dynamics.potential_energy(end) - dynamics.potential_energy(start), rel=1e-3)


def test_torques_equal_pinocchios(planar4: Robot) -> None:
    rng = np.random.default_rng(6)
    q, v, a = rng.normal(size=(3, 4))
    expected = pin.rnea(planar4.model, planar4.model.createData(), q, v, a)
    np.testing.assert_allclose(Dynamics(planar4).torques(q, v, a), expected, atol=1e-12)
