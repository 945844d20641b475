"""Bounds on how far the joints may move, from sample to sample of a stretch and from waypoint to waypoint.

Smoothing considers only the cost: without bounds it would let one sample jump to another
posture if all the others gain more by it.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.motion import TipPath
from backhoe_planner.planning.stretches.stretch import BENT, JUMP, STRAIGHT_STEP, Stretch

_SAME = 1e-9  # m: rounding of an arc length


class StepBounds:
    """The bounds of one stretch: its present steps are always allowed.

    Parameters
    ----------
    path, stretch: the stretch follows the path.
    allowed: (n,) how far a joint may move from waypoint to waypoint [rad or m]; None if all may move freely.
    """

    def __init__(self, path: TipPath, stretch: Stretch, allowed: Vector | None) -> None:
        q = stretch.q
        # the longest step of a resolved path
        self._longest = max(BENT * STRAIGHT_STEP + JUMP, float(np.max(np.abs(np.diff(q, axis=0)), initial=0.0)))
        self._ends: Indices = np.zeros((0, 2), dtype=int)  # for every leg, its first sample and the one after its last
        if allowed is not None:
            marks = np.unique(path.stations)
            ends = np.searchsorted(stretch.stations, np.column_stack((marks[:-1] - _SAME, marks[1:] + _SAME)))
            self._ends = ends[ends[:, 1] > ends[:, 0] + 1]
            self._most = np.maximum(allowed, self._spans(q))

    def broken(self, q: Matrix) -> Flags:
        """(K,) the samples of q (K, n) next to a step that is too long, or on a leg on which a joint moves too far."""
        torn = np.max(np.abs(np.diff(q, axis=0)), axis=1) > self._longest
        found = np.append(torn, False) | np.append(False, torn)
        if len(self._ends):
            for first, behind in self._ends[np.any(self._spans(q) > self._most, axis=1)].tolist():
                found[first:behind] = True
        return np.asarray(found)

    def _spans(self, q: Matrix) -> Matrix:
        """(L, n) the range of each joint on each leg [rad or m]."""
        if not len(self._ends):
            return np.zeros((0, q.shape[1]))
        padded, ends = np.vstack((q, q[-1:])), self._ends.ravel()  # because an end may be after the last sample
        highest, lowest = np.maximum.reduceat(padded, ends), np.minimum.reduceat(padded, ends)
        return np.asarray(highest[::2] - lowest[::2])
