"""Lower bounds of the distances along a curve, from the last measurement at each place.

A pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints moved by dq. A place moves
little from round to round of a descent, so most pairs need not be measured there again.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix

# distances that are kept, 40 MB; chosen: more than a thousand pairs have at all places of a curve
_MOST = 5_000_000
_FIRST_ROWS = 64  # places for which there is room at first; chosen


class SeenDistances:
    """Lower bounds of P distances at places of a changing curve among static obstacles."""

    def __init__(self) -> None:
        self._row: Indices = np.zeros(0, dtype=np.intp)  # of each place in the two arrays, -1 if it is not known
        self._known = 0  # rows; the arrays have room for more
        self._q, self._lower = np.zeros((0, 0)), np.zeros((0, 0))

    def bounds(self, places: Indices, q: Matrix, travel: Matrix) -> Matrix:
        """(K, P) lower bounds of the distances at `places` (K,), now at q (K, n); minus infinity if none is known.

        Parameters
        ----------
        travel: (P, n) the largest change of each distance per joint motion, see `Proximity` [m/rad or 1].
        """
        row = self._rows_of(places)
        known = (row >= 0).nonzero()[0]
        if len(known) == len(row) > 0:
            return np.asarray(self._lower[row] - np.abs(q - self._q[row]) @ travel.T)
        found = np.full((len(q), len(travel)), -np.inf)
        if len(known):
            seen = row[known]
            found[known] = self._lower[seen] - np.abs(q[known] - self._q[seen]) @ travel.T
        return found

    def keep(self, places: Indices, q: Matrix, lower: Matrix) -> None:
        """Keep that at different `places` (K,), with joints q (K, n), the distances are at least `lower` (K, P) [m]."""
        if not len(places):
            return
        row = self._rows_of(places)
        room = _MOST // max(lower.shape[1], 1) - self._known
        new = (row < 0).nonzero()[0][: max(room, 0)]
        if len(new):
            row[new] = self._known + np.arange(len(new))
            self._row[places[new]] = row[new]
            self._known += len(new)
            if self._known > len(self._q):
                room = max(2 * len(self._q), self._known, _FIRST_ROWS)
                self._q, self._lower = (
                    _with_more_room(rows, room, each.shape[1]) for rows, each in ((self._q, q), (self._lower, lower))
                )
        known = row >= 0
        if not known.all():
            row, q, lower = row[known], q[known], lower[known]
        self._q[row], self._lower[row] = q, lower

    def _rows_of(self, places: Indices) -> Indices:
        """(K,) the rows of `places` (K,), -1 for one that is not known."""
        most = int(places.max(initial=-1))
        if most >= len(self._row):
            self._row = np.append(self._row, np.full(2 * most + 1 - len(self._row), -1, dtype=np.intp))
        return self._row[places]


def _with_more_room(rows: Matrix, count: int, width: int) -> Matrix:
    grown = np.empty((count, width))
    if len(rows):
        grown[: len(rows)] = rows
    return grown
