"""Lower bounds of the distances along a curve, from the last measurement at each place.

A pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints moved by dq. A place moves
little from round to round of a descent, so most pairs need not be measured there again.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector

# distances that are kept, 40 MB; chosen: more than a thousand pairs have at all places of a curve
_MOST = 5_000_000


class SeenDistances:
    """Lower bounds of P distances at places of a changing curve among static obstacles."""

    def __init__(self) -> None:
        self._at: dict[int, tuple[Vector, Vector]] = {}

    def bounds(self, places: Indices, q: Matrix, travel: Matrix) -> Matrix:
        """(K, P) lower bounds of the distances at `places` (K,), now at q (K, n); minus infinity if none is known.

        Parameters
        ----------
        travel: (P, n) the largest change of each distance per joint motion, see `Proximity` [m/rad or 1].
        """
        found = np.full((len(q), len(travel)), -np.inf)
        known = [self._at.get(place) for place in places.tolist()]
        rows = [row for row, one in enumerate(known) if one is not None]
        if rows:
            before = np.array([one[0] for one in known if one is not None])
            lower = np.array([one[1] for one in known if one is not None])
            found[rows] = lower - np.abs(q[rows] - before) @ travel.T
        return found

    def keep(self, place: int, q: Vector, lower: Vector) -> None:
        """Keep that at a place, with joints q (n,), the distances are at least `lower` (P,) [m]."""
        if place in self._at or len(lower) * (len(self._at) + 1) <= _MOST:
            self._at[place] = q, lower
