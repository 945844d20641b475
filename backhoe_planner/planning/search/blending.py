"""Corners made round, so that a way can be run through without stopping.

At a corner the way leaves the leg at a distance d before it and joins the next leg at
d behind it, on the parabola that has both legs as tangents. With the length s along the
legs as the parameter, dq/ds turns linearly from the one leg's direction to the other's:
the way is C1, and d2q/ds2 is piecewise constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.robot import JointLimits
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.sampling import Way
from backhoe_planner.planning.task.deadline import OutOfTime

__all__ = ["SmoothWay", "blend", "chord_sagitta"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

PERIOD = 0.02  # s between the samples of a motion along the way
_HALVINGS = 7
_SHARED = 0.5  # part of a leg that each of two corners may take
_ALONE = 0.95  # part of a leg that the only corner on it may take


@dataclass(frozen=True, eq=False)
class SmoothWay:
    """Legs and parabolic corners in joint space, `way(s)`.

    Attributes
    ----------
    corners: (K, n) where the legs meet; the way itself passes by those that are cut.
    stations: (K,) length along the legs up to each corner [s of joint time].
    cuts: (K,) d of each corner, 0 at the ends and where the way goes into the corner
        and must stop there.
    """

    corners: Matrix
    stations: Vector
    cuts: Vector

    def __post_init__(self) -> None:
        for array in (self.corners, self.stations, self.cuts):
            array.setflags(write=False)

    @property
    def length(self) -> float:
        """Of the legs, the end of s."""
        return float(self.stations[-1])

    @property
    def knots(self) -> Vector:
        """Where a leg or a corner piece begins or ends, increasing, from 0 to the length."""
        return np.unique(np.concatenate((self.stations - self.cuts, self.stations + self.cuts)))

    @property
    def stops(self) -> Vector:
        """Where a motion along the way must be at rest: the ends and the corners not cut."""
        return np.array(self.stations[self.cuts == 0.0])

    def __call__(self, s: float | Vector, order: int = 0) -> Matrix:
        """(n,) or (k, n) derivative of that order (0, 1 or 2) with respect to s, from the right."""
        at = np.atleast_1d(np.asarray(s, dtype=float))
        legs = np.diff(self.corners, axis=0)
        steps = np.diff(self.stations)
        leg = np.clip(np.searchsorted(self.stations, at, side="right") - 1, 0, len(steps) - 1)
        slope = legs / steps[:, None]
        found = np.zeros((len(at), self.corners.shape[1]))
        if order == 0:
            found = self.corners[leg] + (at - self.stations[leg])[:, None] * slope[leg]
        elif order == 1:
            found = slope[leg]
        for corner in np.flatnonzero(self.cuts > 0.0):
            d, begin = self.cuts[corner], self.stations[corner] - self.cuts[corner]
            inside = (at >= begin) & (at < begin + 2.0 * d)
            if not inside.any():
                continue
            into, turn = slope[corner - 1], (slope[corner] - slope[corner - 1]) / (2.0 * d)
            along = (at[inside] - begin)[:, None]
            if order == 0:
                found[inside] = self.corners[corner] - d * into + along * into + 0.5 * along**2 * turn
            elif order == 1:
                found[inside] = into + along * turn
            else:
                found[inside] = turn
        return found if np.ndim(s) else found[0]


def blend(check: MotionCheck, way: Way) -> SmoothWay:
    """Cut every corner of `way` as far as the cut is proven clear; stop where none is.

    Parameters
    ----------
    check: that `way` was found with; at its deadline the corners that are left are not cut.
    """
    q = way.q
    steps = np.linalg.norm(np.diff(q, axis=0) / check.rate, axis=1)
    keep = np.concatenate(([True], steps > 0.0))
    q, steps = np.array(q[keep]), steps[steps > 0.0]
    stations = np.concatenate(([0.0], np.cumsum(steps)))
    cuts = np.zeros(len(q))
    try:
        for corner in range(1, len(q) - 1):
            cuts[corner] = _cut(check, q, steps, corner)
    except OutOfTime:
        pass
    return SmoothWay(q, stations, cuts)


def chord_sagitta(limits: JointLimits) -> Vector:
    """(n,) how far a motion can be from the straight line between two of its samples.

    a T^2 / 8 for an acceleration of a held over the period T; on a straight leg it is 0.
    """
    return np.asarray(limits.acceleration * PERIOD**2 / 8.0)


def _cut(check: MotionCheck, q: Matrix, steps: Vector, corner: int) -> float:
    """The longest d that is clear of the halvings of the longest possible; 0 where none is."""
    into = (q[corner] - q[corner - 1]) / steps[corner - 1]
    out = (q[corner + 1] - q[corner]) / steps[corner]
    d = min(
        steps[corner - 1] * (_ALONE if corner == 1 else _SHARED),
        steps[corner] * (_ALONE if corner == len(q) - 2 else _SHARED),
    )
    sagitta = chord_sagitta(check.problem.limits)
    for _ in range(_HALVINGS):
        if check.corner_is_clear(q[corner] - d * into, q[corner], q[corner] + d * out, sagitta=sagitta):
            return float(d)
        d *= 0.5
    return 0.0
