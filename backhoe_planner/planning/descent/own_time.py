"""What a curve costs that is run over time t = T s, how that changes with curve and T, and how short T may be.

    q = q(s)        v = q' / T        a = q'' / T^2        cost = integral of rate(q, v, a) T ds

The integral is a sum over equally spaced s (trapezium rule), and the derivatives are those of the sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.motion import Drive, Problem, cost_rate
from backhoe_planner.planning.descent.curve import JointCurve, basis
from backhoe_planner.planning.descent.moment_slopes import moment_slopes

_PLACES_PER_PIECE = 3  # of the sum; chosen
_STRETCHES = 8  # in which the least T is found; chosen, mostly two are needed
_WITHIN = 1e-3  # part of a limit that may be exceeded at the places; the samples of a motion are checked later


@dataclass(frozen=True, eq=False)
class Slope:
    """How the cost changes with the control points p, one after the other, and T: by slope.x + x.curvature.x / 2.

    Attributes
    ----------
    slope: (m,) [cost per rad or m, and per s].
    curvature: (m, m) that of the rounded kinks alone; positive semidefinite.
    """

    slope: Vector
    curvature: Matrix


@dataclass(frozen=True, eq=False)
class OwnTime:
    """Curves of a problem in their own time.

    What counts only where it is positive, such as the power of a joint, makes kinks where it
    changes its sign. They are rounded off: r^2 / (2 w) from 0 to the width w, and r - w / 2 above.

    Attributes
    ----------
    drive: of the problem's machine.
    """

    problem: Problem
    drive: Drive

    def cost(self, curve: JointCurve, duration: float, *, width: float) -> float:
        """What the motion costs, in the objective's unit, with kinks rounded off by `width` of it per second."""
        parts, kinked = self.parts(*_moments(curve, duration))
        rate = np.sum(_rounded(parts, width) if kinked else parts, axis=1)
        return float(_weights(len(rate)) @ rate) * duration

    def slope(self, curve: JointCurve, duration: float, moving: slice, *, width: float) -> Slope:
        """How the cost changes with the control points `moving` and T."""
        T, (q, v, a) = duration, _moments(curve, duration)
        n, places = q.shape[1], len(q)
        kinked = False

        def parts_at(*moments: Matrix) -> Matrix:
            nonlocal kinked
            parts, kinked = self.parts(*moments)
            return parts

        parts, slopes = moment_slopes(parts_at, q, v, a)
        by_part = np.clip(parts / width, 0.0, 1.0) if kinked else np.ones_like(parts)
        share = T * _weights(places)[:, None]
        rate = np.sum(_rounded(parts, width) if kinked else parts, axis=1)
        weights = [basis(curve.pieces, places, k)[:, moving] / T**k for k in range(3)]

        def by_variables(place: Indices, of: Matrix) -> Matrix:
            """(R, m) of slopes (R, 3 n) at `place` (R,)."""
            steps = sum(
                (weights[k][place][:, :, None] * of[:, None, k * n : (k + 1) * n] for k in range(3)),
                np.zeros((len(place), weights[0].shape[1], n)),
            ).reshape(len(place), n * weights[0].shape[1])
            of_T = np.sum(of[:, n : 2 * n] * v[place], axis=1) + 2.0 * np.sum(of[:, 2 * n :] * a[place], axis=1)
            return np.column_stack((steps, -of_T / T))

        each = by_variables(np.arange(places), np.einsum("ku,kum->km", share * by_part, slopes))
        slope = np.sum(each, axis=0)
        slope[-1] += float(_weights(places) @ rate)
        curvature = np.zeros((len(slope), len(slope)))
        if kinked:
            place, part = np.nonzero((parts > 0.0) & (parts < width))
            G = by_variables(place, slopes[place, part])
            curvature = G.T @ (G * (share[place] / width))
        return Slope(slope, np.asarray(curvature))

    def parts(self, q: Matrix, v: Matrix, a: Matrix) -> tuple[Matrix, bool]:
        """(K, U) what moments at q, v, a (K, n) cost a second; and whether only what is positive counts of each."""
        torque = self.drive.rigid_torques(q, v, a) + self.drive.soil_torques(q, v)
        driving = self.problem.objective.driving(v, torque)
        return (cost_rate(self.problem, q, v, a)[:, None], False) if driving is None else (driving, True)

    def least_duration(self, curve: JointCurve, duration: float) -> float:
        """The least T, not below `duration` [s], that keeps all limits at the places, but for loads at rest."""
        limits, T = self.problem.limits, duration
        held = None
        for _ in range(_STRETCHES):
            q, v, a = _moments(curve, T)
            over = max(
                float(np.max(np.abs(v) / limits.velocity)),
                float(np.sqrt(np.max(np.abs(a) / limits.acceleration))),
            )
            if self.drive.limited:
                if held is None:
                    still = np.zeros_like(q)
                    held = self.drive.effort_use(q, self.drive.rigid_torques(q, still, still)) < 1.0
                use = self.drive.use(q, v, a)
                effort = float(np.max(use.effort, where=held, initial=0.0))
                hard = max(effort, float(np.max(use.power)))  # with the weight's part, it falls by 1 / T^2 and 1 / T^3
                over = max(over, float(np.max(use.rod_speed)), float(np.max(use.flow)), hard**0.5)
            if over <= 1.0 + _WITHIN:
                break
            T *= over
        return T


def _moments(curve: JointCurve, duration: float) -> tuple[Matrix, Matrix, Matrix]:
    places = _PLACES_PER_PIECE * curve.pieces + 1
    q, v, a = (basis(curve.pieces, places, k) @ curve.control / duration**k for k in range(3))
    return q, v, a


def _weights(places: int) -> Vector:
    found = np.full(places, 1.0 / (places - 1))
    found[[0, -1]] *= 0.5
    return found


def _rounded(parts: Matrix, width: float) -> Matrix:
    """(K, U) what counts of `parts` (K, U) with kinks rounded off."""
    positive = np.maximum(parts, 0.0)
    return np.asarray(np.where(positive < width, positive * positive / (2.0 * width), positive - 0.5 * width))
