"""Lower bounds of the distances along a curve, from the last measurement at each place.

A pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints moved by dq. A place moves
little from round to round of a descent, so most pairs need not be measured there again.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector

# distances that are kept, 40 MB; chosen: more than a thousand pairs have at all places of a curve
_MOST = 5_000_000
_FIRST_ROWS = 64  # places for which there is room at first; chosen


class SeenDistances:
    """Lower bounds of P distances at places of a changing curve among static obstacles."""

    def __init__(self) -> None:
        self._row: dict[int, int] = {}  # of each place in the two arrays, which have room for more
        self._q, self._lower = np.zeros((0, 0)), np.zeros((0, 0))

    def bounds(self, places: Indices, q: Matrix, travel: Matrix) -> Matrix:
        """(K, P) lower bounds of the distances at `places` (K,), now at q (K, n); minus infinity if none is known.

        Parameters
        ----------
        travel: (P, n) the largest change of each distance per joint motion, see `Proximity` [m/rad or 1].
        """
        found = np.full((len(q), len(travel)), -np.inf)
        row = np.array([self._row.get(place, -1) for place in places.tolist()], dtype=np.intp)
        known = np.flatnonzero(row >= 0)
        if len(known):
            seen = row[known]
            found[known] = self._lower[seen] - np.abs(q[known] - self._q[seen]) @ travel.T
        return found

    def keep(self, place: int, q: Vector, lower: Vector) -> None:
        """Keep that at a place, with joints q (n,), the distances are at least `lower` (P,) [m]."""
        row = self._row.get(place)
        if row is None:
            row = len(self._row)
            if len(lower) * (row + 1) > _MOST:
                return
            self._row[place] = row
            if row == len(self._q):
                self._q, self._lower = _with_more_room(self._q, len(q)), _with_more_room(self._lower, len(lower))
        self._q[row], self._lower[row] = q, lower


def _with_more_room(rows: Matrix, width: int) -> Matrix:
    grown = np.empty((max(2 * len(rows), _FIRST_ROWS), width))
    if len(rows):
        grown[: len(rows)] = rows
    return grown
