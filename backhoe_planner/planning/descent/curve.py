"""A curve in joint space from rest to rest: a cubic B-spline over a parameter s from 0 to 1.

The first two control points are the start and the last two the end, so that dq/ds is 0 at both.
A joint stays between the least and the greatest of its control points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import BSpline

from backhoe_planner.arrays import Matrix, Vector
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
        return np.asarray(self._spline(s, nu=derivative))

    @cached_property
    def _spline(self) -> BSpline:
        doubled = np.vstack((self.control[:1], self.control, self.control[-1:]))
        return BSpline(_knots(self.pieces), doubled, _DEGREE)

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
    spline = BSpline(_knots(pieces), np.eye(pieces + _DEGREE), _DEGREE)
    weights = spline(np.linspace(0.0, 1.0, places), nu=derivative)
    found = np.array(weights[:, 1:-1])
    found[:, 0] += weights[:, 0]
    found[:, -1] += weights[:, -1]
    found.setflags(write=False)
    return found


def _knots(pieces: int) -> Vector:
    return np.concatenate((np.zeros(_DEGREE), np.linspace(0.0, 1.0, pieces + 1), np.ones(_DEGREE)))
