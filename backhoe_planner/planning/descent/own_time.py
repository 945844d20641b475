"""The cost of a curve over time t = T s, how it changes with the curve and T, and how short T may be.

    q = q(s)        v = q' / T        a = q'' / T^2        cost = integral of rate(q, v, a) T ds

The integral is a sum over equally many places of every piece (trapezium rule); the derivatives are those of the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import Drive, Problem, cost_rate, moment_slopes
from backhoe_planner.planning.descent.curve import JointCurve, moment_changes, spread
from backhoe_planner.planning.descent.kinks import Kinks, rising, rounded
from backhoe_planner.planning.descent.linear_model import PLACES_PER_PIECE
from backhoe_planner.planning.descent.softening import soft_power, soft_power_slopes

# of the sum, for each piece; chosen. With 3, the true cost may be three times the sum; with 4, a tenth more than the
# sum in a fine descent, at worst a half, and with 6, 1 to 4 %
PLACES, FINE_PLACES = 4, 6
_PLACES_OF_JUMPS, _FINE_PLACES_OF_JUMPS = 6, 10  # the same for a cost that jumps; chosen
_STRETCHES = 8  # iterations to find the least T; chosen: mostly two are needed
_WITHIN = 1e-3  # part of a limit that may be exceeded at the places; the samples of a motion are checked later


@dataclass(frozen=True, eq=False)
class Slope:
    """How the cost changes with the control points, one after the other, and T.

    Attributes
    ----------
    slope: (m,) of the whole cost [cost per rad or m, and per s].
    curvature: (m, m) its known part besides the kinks; positive semidefinite.
    kinks: of the cost.
    """

    slope: Vector
    curvature: Matrix
    kinks: Kinks


@dataclass(frozen=True, eq=False)
class OwnTime:
    """Curves of a problem in their own time.

    A term that counts only if positive, such as the power of a joint, has a kink where it
    changes sign. Kinks are rounded off: r^2 / (2 w) from 0 to the width w, and r - w / 2 above.

    Attributes
    ----------
    drive: of the problem's machine.
    places: of the sum, for each piece. A descent lowers the cost at these places, and raises it between them.
    soft_flow: below which cylinders count for a part of their pressure, if the cost jumps when they begin to move
        [m^3/s]; 0 for the exact cost.
    """

    problem: Problem
    drive: Drive
    places: int = PLACES
    soft_flow: float = 0.0

    def looked_at(self, *, fine: bool) -> OwnTime:
        """The same with a suitable number of places for the cost, more for a `fine` curve; without softening."""
        jumps = self.problem.objective.jumps
        usual, more = (_PLACES_OF_JUMPS, _FINE_PLACES_OF_JUMPS) if jumps else (PLACES, FINE_PLACES)
        return replace(self, places=more if fine else usual, soft_flow=0.0)

    def cost(self, curve: JointCurve, duration: float, *, width: float) -> float:
        """The cost of the motion, in the objective's unit, with kinks rounded off by `width` [unit per second]."""
        return float(self.costs([curve], np.array([duration]), width=width)[0])

    def costs(
        self, curves: Sequence[JointCurve], durations: Vector, *, width: float, places: int | None = None
    ) -> Vector:
        """(C,) the same for several curves with the same pieces and `durations` (C,), at once.

        Parameters
        ----------
        places: of the sum, for each piece; by default the usual ones.
        """
        moments = _moments_of_all(curves, durations, self.places if places is None else places)
        q, v, a = (each.reshape(-1, each.shape[2]) for each in moments)
        rate = self.rates(q, v, a, width=width).reshape(len(curves), -1)
        return np.asarray(rate @ curves[0].shares(rate.shape[1]) * durations)

    def rates(self, q: Matrix, v: Matrix, a: Matrix, *, width: float) -> Vector:
        """(K,) the cost per second of moments at q, v, a (K, n); kinks are rounded off by `width` [unit per second]."""
        parts, kinked = self.parts(q, v, a)
        return np.asarray(np.sum(rounded(parts, width) if kinked else parts, axis=1))

    def gross(self, curve: JointCurve, duration: float) -> float:
        """The cost of the motion if terms that count only if positive counted by their absolute values."""
        parts, _ = self.parts(*self._moments(curve, duration))
        return float(curve.shares(len(parts)) @ np.sum(np.abs(parts), axis=1)) * duration

    def slope(self, curve: JointCurve, duration: float, moving: slice, *, width: float) -> Slope:
        """How the cost changes with the control points `moving` and T."""
        moments = self._moments(curve, duration)
        change = _Change(curve, duration, moving, moments)
        share = duration * curve.shares(len(moments[0]))
        if self.problem.objective.is_squared_torque:
            return self._slope_of_squares(change, share, moments, duration)
        if not self.problem.objective.is_positive_power:
            rate, slopes = self._smooth_slopes(*moments)
            slope = share @ change.of(slopes)
            slope[-1] += share @ rate / duration
            return Slope(slope, np.zeros((len(slope), len(slope))), Kinks.none(len(slope)))
        torque, slopes = self.drive.torque_slopes(*moments)
        v, n = moments[1], curve.control.shape[1]
        of_torque = change.of_each(slopes.reshape(-1, 3 * n), each=n)
        value = (torque * v).ravel()
        of_power = of_torque.times(v.ravel()).plus(change.of_velocities().times(torque.ravel()))
        kinks = Kinks(change.spread(of_power), value, np.repeat(share, n), width)
        weight = kinks.share * kinks.rising
        slope = weight @ kinks.G
        slope[-1] += kinks.share @ rounded(value, width) / duration
        # (torque v)'' = torque' v' + v' torque' + v torque''; the last term is left out
        crossed = change.velocities_times(change.spread(of_torque.times(weight)))
        return Slope(slope, _convex(crossed + crossed.T), kinks)

    def _slope_of_squares(
        self, change: _Change, share: Vector, moments: tuple[Matrix, Matrix, Matrix], duration: float
    ) -> Slope:
        """The slope if the rate is the sum of the squared torques; `share` (K,) of the places in the cost [s]."""
        torque, slopes = self.drive.torque_slopes(*moments)
        n = torque.shape[1]
        of_torque = change.of(slopes.reshape(-1, 3 * n), each=n)
        value, weight = torque.ravel(), 2.0 * np.repeat(share, n)
        slope = (weight * value) @ of_torque
        slope[-1] += share @ np.sum(torque * torque, axis=1) / duration
        # (torque^2)'' = 2 torque' torque' + 2 torque torque''; the last term is left out
        return Slope(slope, of_torque.T @ (weight[:, None] * of_torque), Kinks.none(len(slope)))

    def _moments(self, curve: JointCurve, duration: float) -> tuple[Matrix, Matrix, Matrix]:
        """(K, n) q, v, a at the places of the sum."""
        q, v, a = _moments_of_all([curve], np.array([duration]), self.places)
        return q[0], v[0], a[0]

    def _torques(self, q: Matrix, v: Matrix, a: Matrix) -> Matrix:
        return np.asarray(self.drive.rigid_torques(q, v, a) + self.drive.soil_torques(q, v))

    def parts(self, q: Matrix, v: Matrix, a: Matrix) -> tuple[Matrix, bool]:
        """(K, U) the cost per second of moments at q, v, a (K, n); and whether only positive parts count."""
        if self.problem.objective.is_positive_power:
            return self._torques(q, v, a) * v, True
        if self.problem.objective.is_squared_torque:
            return np.sum(np.square(self._torques(q, v, a)), axis=1)[:, None], False
        if self.soft_flow > 0.0:
            assert self.drive.hydraulics is not None
            return soft_power(self.drive.hydraulics, q, v, self._torques(q, v, a), flow=self.soft_flow)[:, None], False
        return cost_rate(self.problem, q, v, a)[:, None], False

    def rate_slopes(self, q: Matrix, v: Matrix, a: Matrix, *, width: Vector) -> tuple[Vector, Matrix]:
        """(K,) the cost per second of moments at q, v, a (K, n), and (K, 3 n) its derivatives by these.

        Parameters
        ----------
        width: (K,) by which kinks are rounded off [unit per second].
        """
        n, width = q.shape[1], width[:, None]
        if self.problem.objective.is_positive_power:
            torque, slopes = self.drive.torque_slopes(q, v, a)
            power = torque * v
            rises = rising(power, width)
            slope = np.einsum("kj,kjm->km", rises * v, slopes)
            slope[:, n : 2 * n] += rises * torque
            return np.sum(rounded(power, width), axis=1), slope
        if self.problem.objective.is_squared_torque:
            torque, slopes = self.drive.torque_slopes(q, v, a)
            return np.sum(torque * torque, axis=1), np.einsum("kj,kjm->km", 2.0 * torque, slopes)
        return self._smooth_slopes(q, v, a)

    def _smooth_slopes(self, q: Matrix, v: Matrix, a: Matrix) -> tuple[Vector, Matrix]:
        """See `rate_slopes`, for a cost without kinks; where it is not softened, the derivatives are differences."""
        if self.soft_flow > 0.0:
            assert self.drive.hydraulics is not None
            torque, slopes = self.drive.torque_slopes(q, v, a)
            return soft_power_slopes(self.drive.hydraulics, q, v, torque, slopes, flow=self.soft_flow)
        rate, differences = moment_slopes(lambda *at: self.parts(*at)[0], q, v, a)
        return rate[:, 0], differences[:, 0]

    def mean_flow(self, curve: JointCurve, duration: float) -> float:
        """The mean flow of a cylinder over the whole motion [m^3/s]; 0 if there is none."""
        q, v, _ = self._moments(curve, duration)
        hydraulics = self.drive.hydraulics
        return 0.0 if hydraulics is None else float(curve.shares(len(q)) @ np.mean(hydraulics.flows(q, v), axis=1))

    def least_duration(self, curve: JointCurve, duration: float) -> float:
        """The least T, not below `duration` [s], that keeps all limits except those broken by static loads.

        Limits are checked at the places where the steps of a descent keep them: elsewhere a step that is at a limit
        everywhere exceeds it by some thousandths, and would count as late.
        """
        return float(self.least_durations([curve], np.array([duration]))[0])

    def least_durations(
        self, curves: Sequence[JointCurve], durations: Vector, *, places: int = PLACES_PER_PIECE
    ) -> Vector:
        """(C,) the same for several curves with the same pieces, each not below its own of `durations` (C,) [s].

        Parameters
        ----------
        places: of each piece, at which limits are checked.
        """
        limits, T, left = self.problem.limits, np.array(durations, dtype=float), np.arange(len(curves))
        held = None
        for _ in range(_STRETCHES):
            q, v, a = moments = _moments_of_all([curves[index] for index in left.tolist()], T[left], places)
            over = np.maximum(
                np.max(np.abs(v) / limits.velocity, axis=(1, 2)),
                np.sqrt(np.max(np.abs(a) / limits.acceleration, axis=(1, 2))),
            )
            if self.drive.limited:
                flat = [each.reshape(-1, each.shape[2]) for each in moments]
                use = self.drive.use(*flat)
                effort = np.max(use.effort.reshape(q.shape), axis=(1, 2))
                if held is None and (effort > (1.0 + _WITHIN) ** 2).any():
                    held = self.drive.static_use(flat[0]).reshape(q.shape) < 1.0
                if held is not None:
                    effort = np.max(use.effort.reshape(q.shape), axis=(1, 2), where=held, initial=0.0)
                power, flow = (np.max(each.reshape(q.shape[:2]), axis=1) for each in (use.power, use.flow))
                # with the weight included, these fall by 1 / T^2 and 1 / T^3
                hard = np.sqrt(np.maximum(effort, power))
                speed = np.max(use.rod_speed.reshape(q.shape), axis=(1, 2))
                over = np.maximum.reduce((over, speed, flow, hard))
            late = over > 1.0 + _WITHIN
            if not late.any():
                break
            T[left[late]] *= over[late]
            left, held = left[late], None if held is None else held[late]
        return T


@dataclass(frozen=True, eq=False)
class _Changes:
    """How R values change with the control points that act on each, and with T.

    Attributes
    ----------
    of_points: (R, k, n) with the k control points.
    of_duration: (R,).
    """

    of_points: Array
    of_duration: Vector

    def times(self, factor: Vector) -> _Changes:
        """Those of the values times `factor` (R,)."""
        return _Changes(factor[:, None, None] * self.of_points, factor * self.of_duration)

    def plus(self, other: _Changes) -> _Changes:
        """Those of the sums with other values, on which the same control points act."""
        return _Changes(self.of_points + other.of_points, self.of_duration + other.of_duration)


class _Change:
    """How the moments of a curve over time t = T s change with its control points `moving`, and with T.

    Parameters
    ----------
    moments: q, v, a (K, n) of the curve.
    """

    def __init__(
        self, curve: JointCurve, duration: float, moving: slice, moments: tuple[Matrix, Matrix, Matrix]
    ) -> None:
        self._T, self._v, self._a, self._moving, self._pieces = duration, moments[1], moments[2], moving, curve.pieces
        self._acting, weights = curve.support(len(self._v))
        self._of_acting = weights / np.array([1.0, duration, duration**2])[:, None, None]
        self._of_velocity = curve.weights(len(self._v), 1)[:, moving] / duration

    def of(self, slopes: Matrix, each: int = 1) -> Matrix:
        """(K each, m) for values with derivatives `slopes` (K each, 3 n) by q, v, a; `each` values at each moment."""
        return self.spread(self.of_each(slopes, each))

    def of_each(self, slopes: Matrix, each: int) -> _Changes:
        """The same by the control points that act on each value."""
        place, n = np.repeat(np.arange(len(self._v)), each), self._v.shape[1]
        of_points = moment_changes(self._acting[place], self._of_acting[:, place], slopes, n)
        of_T = np.sum(slopes[:, n : 2 * n] * self._v[place] + 2.0 * slopes[:, 2 * n :] * self._a[place], axis=1)
        return _Changes(of_points, -of_T / self._T)

    def of_velocities(self) -> _Changes:
        """Those of all velocities, (K n) values."""
        count, n = self._v.shape
        found = np.zeros((count, n, self._acting.shape[1], n))
        joints = np.arange(n)
        found[:, joints, :, joints] = self._of_acting[1]
        return _Changes(found.reshape(count * n, -1, n), -self._v.ravel() / self._T)

    def spread(self, changes: _Changes) -> Matrix:
        """(K each, m) the same by all control points that are moving, and by T."""
        acting = np.repeat(self._acting, len(changes.of_duration) // len(self._v), axis=0)
        found = spread(acting, changes.of_points, self._moving, self._pieces, more=1)
        found[:, -1] = changes.of_duration
        return found

    def velocities_times(self, values: Matrix) -> Matrix:
        """(m, m) the changes of all velocities, transposed, times values (K n, m)."""
        n, width = self._v.shape[1], values.shape[1]
        each = self._of_velocity.T @ values.reshape(-1, n, width).transpose(1, 0, 2)  # (n, points, m)
        return np.vstack((each.transpose(1, 0, 2).reshape(-1, width), -self._v.ravel() @ values / self._T))


def _convex(H: Matrix) -> Matrix:
    """(m, m) a symmetric matrix H without its negative curvature."""
    bends, along = np.linalg.eigh(H)
    return np.asarray((along * np.maximum(bends, 0.0)) @ along.T)


def _moments_of_all(curves: Sequence[JointCurve], durations: Vector, each: int) -> tuple[Array, Array, Array]:
    """(C, K, n) q, v, a of curves with the same pieces and `durations` (C,), at `each` places of each piece."""
    places, control = each * curves[0].pieces + 1, np.array([curve.control for curve in curves])
    T = durations[:, None, None]
    q, v, a = (curves[0].weights(places, k) @ control / T**k for k in range(3))
    return q, v, a
