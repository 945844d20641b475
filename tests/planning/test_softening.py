"""Hydraulic energy, which jumps as a rod begins to move, is lowered as a smooth cost first."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Dynamics, Hydraulics
from backhoe_planner.planning.descent.softening import soft_flows, soft_power, soft_power_slopes

MOMENTS = 200


@pytest.fixture
def hydraulics(backhoe: bp.Robot) -> Hydraulics:
    assert backhoe.hydraulics is not None
    return backhoe.hydraulics


@pytest.fixture
def moments(backhoe: bp.Robot) -> tuple[Matrix, Matrix, Matrix]:
    """(K, n) configurations well within the limits, velocities and torques."""
    rng = np.random.default_rng(3)
    lower, upper = backhoe.limits.lower, backhoe.limits.upper
    q = lower + (0.1 + 0.8 * rng.random((MOMENTS, backhoe.n))) * (upper - lower)
    return q, 0.3 * rng.normal(size=q.shape), 3e3 * rng.normal(size=q.shape)


def test_the_smooth_power_approaches_the_power_as_the_flow_goes_to_zero(
    hydraulics: Hydraulics, moments: tuple[Matrix, Matrix, Matrix]
) -> None:
    q, v, torque = moments
    exact = hydraulics.load_sensing_power(q, v, torque)
    # two cylinders turn the swing: a norm counts their equal pressures 2^(1/8) times, 9 % too much
    soft = soft_power(hydraulics, q, v, torque, flow=1e-9)
    assert np.all(soft >= exact * (1.0 - 1e-3))
    assert np.all(soft <= exact * (1.0 + 0.2))
    off = [
        float(np.mean(np.abs(soft_power(hydraulics, q, v, torque, flow=flow) - soft))) for flow in (1e-3, 1e-4, 1e-5)
    ]
    assert off[0] > 3.0 * off[1] > 9.0 * off[2]


def test_the_smooth_power_does_not_jump_as_a_rod_begins_to_move(
    hydraulics: Hydraulics, moments: tuple[Matrix, Matrix, Matrix]
) -> None:
    """Three joints sink under their loads; the swing is at rest, or begins to turn against a torque."""
    q, _, torque = moments
    v = -0.2 * np.sign(torque)
    v[:, 0] = 0.0
    begun = v.copy()
    begun[:, 0] = 1e-6 * np.sign(torque[:, 0])
    assert np.max(hydraulics.load_sensing_power(q, v, torque)) == 0.0
    assert np.min(hydraulics.load_sensing_power(q, begun, torque)) > 0.1
    steps = [soft_power(hydraulics, q, each, torque, flow=1e-4) for each in (v, begun)]
    assert np.max(np.abs(steps[1] - steps[0])) < 1e-2
    assert np.max(soft_power(hydraulics, q, np.zeros_like(q), torque, flow=1e-4)) == 0.0


def test_the_flows_of_softening_decrease() -> None:
    flows = soft_flows(1e-4, first=False, fine=False, hurried=False)
    assert np.all(np.diff(flows) < 0.0)
    assert flows[0] == pytest.approx(3e-4)
    assert soft_flows(1e-4, first=True, fine=False, hurried=False) == flows[:1]
    fine = soft_flows(1e-4, first=False, fine=True, hurried=False)
    assert fine == flows[-len(fine) :]
    assert len(fine) < len(flows)
    hurried = soft_flows(1e-4, first=False, fine=False, hurried=True)
    assert np.all(np.diff(hurried) < 0.0)
    assert len(hurried) < len(flows)
    assert soft_flows(0.0, first=False, fine=False, hurried=False) == (0.0,)


@pytest.mark.parametrize("flow", [1e-3, 1e-4])
def test_the_slopes_of_the_smooth_power_are_its_differences(
    backhoe: bp.Robot, hydraulics: Hydraulics, moments: tuple[Matrix, Matrix, Matrix], flow: float
) -> None:
    """Also where a joint is at rest, and where two cylinders turn it: the swing."""
    q, v, _ = moments
    a, dynamics = np.random.default_rng(4).normal(size=q.shape), Dynamics(backhoe)
    v[:40, 1] = 0.0

    def power(at: Matrix) -> Vector:
        q, v, a = np.split(at, 3, axis=1)
        return soft_power(hydraulics, q, v, dynamics.torques_along(q, v, a), flow=flow)

    here, step = np.hstack((q, v, a)), 1e-7
    nudges = step * np.eye(here.shape[1])
    differences = np.stack([power(here + nudge) - power(here - nudge) for nudge in nudges], axis=1) / (2.0 * step)
    found, slopes = soft_power_slopes(hydraulics, q, v, *dynamics.torque_slopes(q, v, a), flow=flow)
    np.testing.assert_allclose(found, power(here), rtol=1e-12)
    scale = np.abs(differences).max()
    assert scale > 1e4
    np.testing.assert_allclose(slopes, differences, rtol=1e-4, atol=1e-6 * scale)


def test_pressures_that_are_only_rounding_have_no_slope(backhoe: bp.Robot, hydraulics: Hydraulics) -> None:
    """The eighth power of 1e-45 Pa is 0 in floating point, so that a pressure over their norm was infinite."""
    at = np.array([[0.1, 0.3, -1.2, -0.6]])
    v = np.array([[0.0, 1e-16, 0.2, 0.0]])
    torque = np.array([[0.0, 1e-10, -2e3, 0.0]])  # the stick sinks under its load, the others are at rest
    counted = [soft_power(hydraulics, at, v, torque * scale, flow=1e-3)[0] for scale in (1.0, 1e-5, 1e-10)]
    assert counted == pytest.approx(np.array([1.0, 1e-5, 1e-10]) * counted[0])
    assert 0.0 < counted[0] < 1e-30
    slopes = np.zeros((1, 4, 12))
    for scale in (1.0, 1e-5, 1e-10):
        found, slope = soft_power_slopes(hydraulics, at, v, torque * scale, slopes, flow=1e-3)
        assert found[0] < 1e-30
        assert np.max(np.abs(slope)) < 1e-10
