"""Curves in joint space against scipy's B-splines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.planning.descent.curve import JointCurve, basis, divided_evenly, moment_changes, spread


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


def test_a_curve_through_places_of_a_curve_is_that_curve(planar4: bp.Robot) -> None:
    """Straight lines between 2001 places are off a curve with second derivative b by b / (8 * 2000^2) at most."""
    limits, s = planar4.limits, np.linspace(0.0, 1.0, 2001)
    control = np.random.default_rng(5).uniform(limits.lower, limits.upper, size=(9, 4))
    curve = JointCurve(control)
    near = float(np.max(np.abs(curve(s, 2)))) / (8.0 * 2000.0**2)
    through = JointCurve.through(s, curve(s), 8, limits)
    np.testing.assert_allclose(through(s), curve(s), atol=10.0 * near)


def test_a_curve_through_places_keeps_its_ends_and_the_limits(planar4: bp.Robot) -> None:
    limits = planar4.limits
    corners = np.array([np.zeros(4), limits.upper, np.zeros(4)])
    curve = JointCurve.through(np.array([0.0, 0.3, 1.0]), corners, 8, limits)
    np.testing.assert_allclose(curve(np.array([0.0, 1.0])), 0.0, atol=1e-15)
    assert np.all(curve.control <= limits.upper)
    assert curve.control.max() > 0.5 * limits.upper.max()


def test_a_curve_is_at_rest_at_its_ends() -> None:
    control = np.random.default_rng(0).normal(size=(6, 4))
    curve, ends = JointCurve(control), np.array([0.0, 1.0])
    np.testing.assert_allclose(curve(ends), control[[0, -1]], atol=1e-15)
    np.testing.assert_allclose(curve(ends, 1), 0.0, atol=1e-13)


def test_a_curve_moved_aside_keeps_its_ends_and_the_limits(planar4: bp.Robot) -> None:
    """At skew 1 all is moved by the sine of pi u; a joint with skew k is moved by all of it where u^k is a half."""
    limits, curve = planar4.limits, JointCurve.straight(np.zeros(4), np.full(4, 0.4), 4)
    aside, skew = np.array([0.2, -0.1, 0.3, 50.0]), np.array([1.0, 0.5, 2.0, 1.0])
    moved = curve.moved_aside(aside, skew, limits).control
    np.testing.assert_array_equal(moved[[0, -1]], curve.control[[0, -1]])
    change = moved - curve.control
    half = np.sqrt(0.5)
    np.testing.assert_allclose(change[:, 0], [0.0, 0.2 * half, 0.2, 0.2 * half, 0.0], atol=1e-15)
    assert change[1, 1] == pytest.approx(-0.1)  # u = 1/4, and its root is a half
    np.testing.assert_allclose(change[1:4, 2], 0.3 * np.sin(np.pi * np.array([1.0, 4.0, 9.0]) / 16.0))
    np.testing.assert_array_equal(moved[1:4, 3], limits.upper[3])


UNEVEN = (0.0, 0.03, 0.1, 0.35, 0.6, 0.9, 0.98, 1.0)


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_a_curve_with_uneven_pieces_is_a_spline_over_its_knots(derivative: int) -> None:
    control = np.random.default_rng(7).normal(size=(8, 3))
    knots = np.concatenate((np.zeros(3), UNEVEN, np.ones(3)))
    spline = BSpline(knots, np.vstack((control[:1], control, control[-1:])), 3)
    curve, s = JointCurve(control, UNEVEN), np.linspace(0.0, 1.0, 101)
    np.testing.assert_allclose(curve(s, derivative), spline(s, nu=derivative), rtol=1e-9, atol=1e-9)
    thirds = np.interp(np.arange(22) / 3.0, np.arange(8), UNEVEN)  # three places per piece
    expected = spline(thirds, nu=derivative)
    np.testing.assert_allclose(curve.weights(22, derivative) @ control, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(curve.at(np.linspace(0.0, 1.0, 22), derivative), expected, rtol=1e-9, atol=1e-9)


def test_shares_sum_up_to_an_integral_over_s() -> None:
    """The integrals of 1 and of s, for which the trapezium rule is exact: 1 and 1/2."""
    curve = JointCurve(np.zeros((8, 1)), UNEVEN)
    s = np.interp(np.arange(22) / 3.0, np.arange(8), UNEVEN)
    assert curve.shares(22).sum() == pytest.approx(1.0)
    assert curve.shares(22) @ s == pytest.approx(0.5)


def test_a_finer_curve_has_more_pieces_where_accelerations_change() -> None:
    """A curve is even but for one kick at a third of its length: more pieces are near there."""
    control = np.tile(np.linspace(0.0, 1.0, 25)[:, None], (1, 2))
    control[8] += 0.05
    knots = np.array(JointCurve(control).finer(32, np.ones(2)).knots)
    steps = np.diff(knots)
    assert len(knots) == 33
    assert knots[0] == 0.0
    assert knots[-1] == 1.0
    assert np.all(steps > 0.0)
    near = np.abs(knots[:-1] + 0.5 * steps - 1.0 / 3.0) < 0.08
    assert np.mean(steps[near]) < 0.7 * np.mean(steps[~near])
    still = JointCurve(np.zeros((13, 2))).finer(24, np.ones(2)).knots  # nothing moves: pieces are even
    np.testing.assert_allclose(still, np.linspace(0.0, 1.0, 25), atol=1e-12)


@pytest.mark.parametrize("knots", [(), UNEVEN])
def test_a_finer_curve_is_the_same_curve(knots: tuple[float, ...]) -> None:
    """Inserting knots adds control points between those of the spline and does not change the spline."""
    rng = np.random.default_rng(3)
    curve = JointCurve(rng.normal(size=(8, 3)), knots)
    finer = curve.finer(20, np.ones(3))
    s = np.linspace(0.0, 1.0, 301)
    for derivative in range(3):
        np.testing.assert_allclose(finer(s[:-1], derivative), curve(s[:-1], derivative), rtol=1e-9, atol=1e-8)
    assert finer.pieces == 20
    assert np.all(finer.control <= curve.control.max(axis=0) + 1e-9)
    assert np.all(finer.control >= curve.control.min(axis=0) - 1e-9)


def test_a_curve_of_twice_as_many_equal_pieces_is_the_same_curve_and_back(planar4: bp.Robot) -> None:
    """Every spline is one over halved pieces too; the nearest one over the whole pieces is then itself."""
    limits, s = planar4.limits, np.linspace(0.0, 1.0, 101)
    curve = JointCurve(np.random.default_rng(8).uniform(limits.lower, limits.upper, size=(7, 4)))
    halved = curve.divided_evenly(12, limits)
    assert halved.pieces == 12
    np.testing.assert_allclose(halved(s), curve(s), atol=1e-12)
    np.testing.assert_allclose(halved.divided_evenly(6, limits).control, curve.control, atol=1e-12)


@pytest.mark.parametrize("pieces", [4, 5, 12])
def test_several_curves_are_divided_as_each_by_itself(planar4: bp.Robot, pieces: int) -> None:
    limits = planar4.limits
    control = np.random.default_rng(9).uniform(limits.lower, limits.upper, size=(5, 7, 4))
    each = [JointCurve(one).divided_evenly(pieces, limits).control for one in control]
    np.testing.assert_allclose(divided_evenly(control, pieces, limits), each, atol=1e-12)


def test_a_motion_along_a_curve_is_fitted_by_that_curve(planar4: bp.Robot) -> None:
    rng = np.random.default_rng(5)
    control = JointCurve.straight(np.full(4, -0.3), np.full(4, 0.3), 7).control
    control[1:-1] += 0.1 * rng.normal(size=(6, 4))
    curve = JointCurve(control)
    time = np.linspace(0.0, 2.0, 4001)
    motion = bp.Trajectory.from_steps(time, curve(time / 2.0))
    fitted = JointCurve.fitted(motion, 7, planar4.limits)
    np.testing.assert_allclose(fitted.control, control, atol=1e-4)


@pytest.mark.parametrize("pieces", [1, 2, 3, 8])
def test_the_acting_control_points_have_all_weights(pieces: int) -> None:
    """Four at most, equal to the rows of `basis`, which are zero elsewhere; also with pieces of different lengths."""
    knots = tuple((np.linspace(0.0, 1.0, pieces + 1) ** 1.5).tolist())
    for curve in (JointCurve(np.zeros((pieces + 1, 2))), JointCurve(np.zeros((pieces + 1, 2)), knots)):
        acting, weights = curve.support(31)
        assert acting.shape[1] == min(4, pieces + 1)
        for derivative in range(3):
            whole = np.zeros((31, pieces + 1))
            np.put_along_axis(whole, acting, weights[derivative], axis=1)
            np.testing.assert_array_equal(whole, curve.weights(31, derivative))


def test_changes_of_moments_are_the_differences_of_a_linear_function_of_them() -> None:
    """A value that is linear in q, v, a changes with a step of the moving control points by its slopes exactly."""
    rng = np.random.default_rng(3)
    curve, moving, step = JointCurve(rng.normal(size=(9, 2))), slice(1, 8), rng.normal(size=(7, 2))
    control = curve.control.copy()
    control[moving] += step
    slopes = rng.normal(size=(25, 6))

    def values(one: JointCurve) -> Vector:
        return np.asarray(np.sum(slopes * np.hstack([one.weights(25, k) @ one.control for k in range(3)]), axis=1))

    acting, weights = curve.support(25)
    changes = spread(acting, moment_changes(acting, weights, slopes, 2), moving, 8)
    np.testing.assert_allclose(changes @ step.ravel(), values(curve.moved_to(control)) - values(curve), atol=1e-10)
