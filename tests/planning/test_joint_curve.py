"""Curves in joint space against scipy's B-splines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from backhoe_planner.planning.descent.curve import JointCurve, basis


@pytest.mark.parametrize("pieces", [1, 2, 3, 5, 24])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_a_curve_is_a_clamped_cubic_b_spline(pieces: int, derivative: int) -> None:
    control = np.random.default_rng(pieces).normal(size=(pieces + 1, 3))
    knots = np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, pieces + 1), np.ones(3)))
    spline = BSpline(knots, np.vstack((control[:1], control, control[-1:])), 3)
    s = np.linspace(0.0, 1.0, 101)
    scale = float(pieces) ** derivative
    np.testing.assert_allclose(JointCurve(control)(s, derivative) / scale, spline(s, nu=derivative) / scale, atol=1e-13)
    np.testing.assert_allclose(
        basis(pieces, 101, derivative) @ control / scale, spline(s, derivative) / scale, atol=1e-13
    )


def test_a_curve_rests_at_its_ends() -> None:
    control = np.random.default_rng(0).normal(size=(6, 4))
    curve, ends = JointCurve(control), np.array([0.0, 1.0])
    np.testing.assert_allclose(curve(ends), control[[0, -1]], atol=1e-15)
    np.testing.assert_allclose(curve(ends, 1), 0.0, atol=1e-13)
