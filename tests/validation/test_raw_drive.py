"""Cylinders by the places of their pins, against hand calculations and the package's linkages."""

from __future__ import annotations

import math

import numpy as np
import pytest

import backhoe_planner as bp
from validation.raw_drive import RawDrive, read_raw_drive
from validation.raw_urdf import read_raw_urdf


@pytest.fixture(scope="module")
def drive(backhoe: bp.Robot) -> RawDrive:
    assert backhoe.hydraulics is not None
    machine = read_raw_urdf(backhoe.urdf.path, find_mesh=backhoe.urdf.mesh_path)
    return read_raw_drive(backhoe.hydraulics.file, machine, backhoe.joint_names)


def test_the_cylinder_of_a_rocker_is_as_long_as_it_is_drawn(drive: RawDrive) -> None:
    """From (0.029, 0.296) on the stick to the rocker's pin at (1.395, 0.383), with the bucket at 0."""
    length = drive.lengths(np.zeros((1, 4)))[0, -1]
    assert length == pytest.approx(math.hypot(1.395 - 0.029, 0.383 - 0.296), abs=1e-12)


def test_a_turn_of_the_swing_changes_both_cylinders_by_the_law_of_cosines(drive: RawDrive) -> None:
    """The pins are at 0.7 and 0.12 m from the axis; the frame's pin is at (-0.5, +-0.49), the other at (0.041, 0.113).

    Both are in the frame of the base, and the axis is at its origin.
    """
    a, b, q = math.hypot(0.5, 0.49), math.hypot(0.041, 0.113), 0.6
    between = math.atan2(0.49, -0.5) - (math.atan2(0.113, 0.041) + q)
    expected = math.sqrt(a * a + b * b - 2.0 * a * b * math.cos(between))
    lengths = drive.lengths(np.array([[q, 0.3, -1.0, -0.5], [-q, 0.3, -1.0, -0.5]]))
    assert lengths[0, 0] == pytest.approx(expected, abs=1e-12)
    assert lengths[1, 1] == pytest.approx(expected, abs=1e-12)


def test_levers_flows_forces_and_pressures_are_those_of_the_linkages(backhoe: bp.Robot, drive: RawDrive) -> None:
    known, rng = backhoe.hydraulics, np.random.default_rng(6)
    assert known is not None
    q = np.array([backhoe.random_q(rng) for _ in range(60)])
    v, torque = 0.3 * rng.normal(size=q.shape), 2e4 * rng.normal(size=q.shape)
    np.testing.assert_allclose(drive.lengths(q), known.lengths(q), atol=1e-12)
    levers = drive.levers(q)
    np.testing.assert_allclose(levers, known.arms(q), atol=1e-9)
    limits = known.torque_limits(q)
    expected = np.where(torque > 0.0, limits.positive, limits.negative)
    np.testing.assert_allclose(drive.greatest_torques(q, torque), expected, rtol=1e-8)
    flows = drive.flows(levers * v[:, drive.joint_of])
    np.testing.assert_allclose(np.sum(flows, axis=1), known.total_flow(q, v), rtol=1e-8)
    fastest = known.velocity_limits(q)
    alone = np.abs(v) / np.where(v > 0.0, fastest.positive, fastest.negative)
    np.testing.assert_allclose(drive.rod_use(flows), alone, rtol=1e-8)
    np.testing.assert_allclose(drive.work_rates(v, torque), known.power(q, v, torque), rtol=1e-8)
    np.testing.assert_allclose(drive.pump_rates(q, v, torque), known.load_sensing_power(q, v, torque), rtol=1e-8)
