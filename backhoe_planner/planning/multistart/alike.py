"""Which curves are alike: each can be moved along straight lines into the other, staying clear.

That is a sufficient condition for two curves to pass the obstacles on the same sides (uniform
visibility deformation, Zhou et al. 2020): a descent from either mostly ends at the same motion.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.search.motion_check import MotionCheck

_PLACES = 12  # of two curves, that are joined by straight motions; chosen
_FINE = 64  # intervals from which the length of a curve is computed; chosen
_SAME = 0.01  # part of the length by which two equal curves may be apart; chosen
_APART = 0.25  # part of the length by which two similar curves may be apart; chosen: postures may differ by more


class KnownCurves:
    """The results of descents, and which other curves are similar to one of them.

    Parameters
    ----------
    limits: of the joints.
    make_check: creates the check of motions among the obstacles that the curves keep clear of; called once,
        when two curves are first compared.
    """

    def __init__(self, limits: JointLimits, make_check: Callable[[], MotionCheck]) -> None:
        self._limits, self._make_check = limits, make_check
        self._known: list[tuple[Matrix, float]] = []

    @cached_property
    def _check(self) -> MotionCheck:
        return self._make_check()

    def anew(self) -> KnownCurves:
        """A new record without curves; both share the check."""
        return KnownCurves(self._limits, lambda: self._check)

    def add(self, curve: JointCurve, cost: float) -> None:
        """Add a clear curve, and its cost."""
        self._known.append((self._evenly(curve)[0], cost))

    def least_alike(self, curve: JointCurve) -> float:
        """The least cost of the known curves that are similar to `curve`; infinite if there is none."""
        if not self._known:
            return np.inf
        q, length = self._evenly(curve)
        for known, cost in sorted(self._known, key=lambda one: one[1]):
            apart = self._apart(q, known)
            if apart <= _SAME * length:
                return cost
            if apart <= _APART * length and all(
                self._check.segment_is_clear(a, b) for a, b in zip(q, known, strict=True)
            ):
                return cost
        return np.inf

    def _apart(self, a: Matrix, b: Matrix) -> float:
        """The largest distance between two curves [s of joint time]."""
        return float(np.max(np.linalg.norm((a - b) / self._limits.velocity, axis=1)))

    def _evenly(self, curve: JointCurve) -> tuple[Matrix, float]:
        """(K, n) places after equal parts of the length, without the start, and the length [s of joint time]."""
        q = curve(np.linspace(0.0, 1.0, _FINE + 1))
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0) / self._limits.velocity, axis=1))))
        at: Vector = np.linspace(0.0, along[-1], _PLACES + 1)[1:]
        found = np.column_stack([np.interp(at, along, column) for column in q.T])
        return np.clip(found, self._limits.lower, self._limits.upper), float(along[-1])
