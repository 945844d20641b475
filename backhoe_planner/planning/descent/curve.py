"""A curve in joint space from rest to rest: a cubic B-spline over a parameter s from 0 to 1.

The first two control points are the start and the last two the end, so that dq/ds is 0 at both.
A joint stays between the least and the greatest of its control points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Trajectory

_DEGREE = 3
_SAMPLES_PER_PIECE = 10  # of a motion to which a curve is fitted; chosen


@dataclass(frozen=True, eq=False)
class JointCurve:
    """A curve from rest to rest.

    Attributes
    ----------
    control: (L + 1, n) control points of a curve of L pieces: the start, L - 1 between, the end [rad or m].
    """

    control: Matrix

    @property
    def pieces(self) -> int:
        """How many polynomials it is made of."""
        return len(self.control) - 1

    def __call__(self, s: Vector, derivative: int = 0) -> Matrix:
        """(K, n) the joints at s (K,), or a derivative by s."""
        return _read(self._coefficients, s, derivative)

    @cached_property
    def _coefficients(self) -> Array:
        """(L, 4, n), see `_read`."""
        doubled = np.vstack((self.control[:1], self.control, self.control[-1:]))
        return np.asarray(_polynomials(self.pieces) @ doubled[np.arange(self.pieces)[:, None] + np.arange(_DEGREE + 1)])

    @classmethod
    def straight(cls, start: Vector, end: Vector, pieces: int) -> JointCurve:
        """The straight line from `start` to `end` (n,)."""
        return cls(np.tile(start, (pieces + 1, 1))).ending_at(end)

    def ending_at(self, end: Vector) -> JointCurve:
        """The curve with its end moved to `end` (n,), and the rest along with it, ever less towards the start."""
        part = np.linspace(0.0, 1.0, len(self.control))[:, None]
        return JointCurve(self.control + part * part * (3.0 - 2.0 * part) * (end - self.control[-1]))

    @classmethod
    def fitted(cls, motion: Trajectory, pieces: int, limits: JointLimits) -> JointCurve:
        """The curve within joint limits that is nearest to a motion over its time, with its ends."""
        q = motion.at(np.linspace(0.0, motion.duration, _SAMPLES_PER_PIECE * pieces + 1))
        weights = basis(pieces, len(q), 0)
        control = np.zeros((pieces + 1, q.shape[1]))
        control[0], control[-1] = q[0], q[-1]
        control[1:-1] = np.linalg.lstsq(weights[:, 1:-1], q - weights @ control, rcond=None)[0]
        control[1:-1] = np.clip(control[1:-1], limits.lower, limits.upper)
        return cls(control)


@lru_cache(maxsize=64)
def basis(pieces: int, places: int, derivative: int) -> Matrix:
    """(places, pieces + 1) weights of the control points at equally spaced s, or their derivatives by s."""
    each = _read(_polynomials(pieces), np.linspace(0.0, 1.0, places), derivative)
    first = _piece_of(np.linspace(0.0, 1.0, places), pieces)
    weights = np.zeros((places, pieces + _DEGREE))
    np.put_along_axis(weights, first[:, None] + np.arange(_DEGREE + 1), each, axis=1)
    found = weights[:, 1:-1].copy()
    found[:, 0] += weights[:, 0]
    found[:, -1] += weights[:, -1]
    found.setflags(write=False)
    return found


def _piece_of(s: Vector, pieces: int) -> NDArray[np.intp]:
    """(K,) the number of the piece in which each s (K,) lies."""
    return np.clip((s * pieces).astype(np.intp), 0, pieces - 1)


def _read(coefficients: Array, s: Vector, derivative: int) -> Matrix:
    """(K, m) a piecewise polynomial at s (K,), or its derivative by s.

    Parameters
    ----------
    coefficients: (L, 4, m) of each piece, by powers of u = L s - (number of the piece), the lowest first.
    """
    pieces = len(coefficients)
    piece = _piece_of(s, pieces)
    u = (s * pieces - piece)[:, None]
    found = np.zeros((len(s), coefficients.shape[2]))
    for power in range(_DEGREE, derivative - 1, -1):
        found = found * u + math.perm(power, derivative) * coefficients[piece, power]
    return found * float(pieces) ** derivative


@lru_cache(maxsize=64)
def _polynomials(pieces: int) -> Array:
    """(L, 4, 4) every piece of a cubic B-spline: powers of u, times the four control points that bear on it.

    The recursion of Cox and de Boor over the knots 0, 0, 0, 0, 1, 2, ..., L, L, L, L, done for all pieces at once.
    """
    knots = np.clip(np.arange(-_DEGREE, pieces + _DEGREE + 1), 0, pieces).astype(float)
    left = np.arange(pieces, dtype=float)  # knot at which a piece begins, knots[piece + _DEGREE]
    basis_functions = [np.eye(1, _DEGREE + 1) * np.ones((pieces, 1))]
    for degree in range(1, _DEGREE + 1):
        higher = [np.zeros((pieces, _DEGREE + 1)) for _ in range(degree + 1)]
        for r, lower in enumerate(basis_functions):
            before = knots[_DEGREE + 1 + r - degree + np.arange(pieces)]
            after = knots[_DEGREE + 1 + r + np.arange(pieces)]
            part = lower / (after - before)[:, None]
            times_u = np.roll(part, 1, axis=1)  # the highest power is 0 until the last degree
            higher[r] += (after - left)[:, None] * part - times_u
            higher[r + 1] += (left - before)[:, None] * part + times_u
        basis_functions = higher
    found = np.stack(basis_functions, axis=2)
    found.setflags(write=False)
    return found
