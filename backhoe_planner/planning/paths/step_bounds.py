"""How far the joints may move, from sample to sample of a stretch and from waypoint to waypoint.

Smoothing weighs cost alone: without bounds it would let one sample land in another posture
where all the others gain more.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.motion import TipPath
from backhoe_planner.planning.paths.stretch import BENT, JUMP, STRAIGHT_STEP, Stretch

_SAME = 1e-9  # m: rounding of an arc length


class StepBounds:
    """The bounds of one stretch: what it does already is always allowed.

    Parameters
    ----------
    path, stretch: the stretch follows the path.
    allowed: (n,) how far a joint may move from waypoint to waypoint [rad or m]; None where all may freely.
    """

    def __init__(self, path: TipPath, stretch: Stretch, allowed: Vector | None) -> None:
        q = stretch.q
        # what a resolved path's steps may be at most
        self._longest = max(BENT * STRAIGHT_STEP + JUMP, float(np.max(np.abs(np.diff(q, axis=0)), initial=0.0)))
        self._legs: list[tuple[slice, Vector]] = []
        if allowed is not None:
            for low, high in pairwise(np.unique(path.stations).tolist()):
                first, last = np.searchsorted(stretch.stations, (low - _SAME, high + _SAME))
                if last > first + 1:
                    rows = slice(int(first), int(last))
                    self._legs.append((rows, np.maximum(allowed, np.ptp(q[rows], axis=0))))

    def broken(self, q: Matrix) -> Flags:
        """(K,) the samples of q (K, n) beside a step that is too long, or on a leg on which a joint goes too far."""
        torn = np.max(np.abs(np.diff(q, axis=0)), axis=1) > self._longest
        found = np.append(torn, False) | np.append(False, torn)
        for rows, most in self._legs:
            if np.any(np.ptp(q[rows], axis=0) > most):
                found[rows] = True
        return np.asarray(found)
