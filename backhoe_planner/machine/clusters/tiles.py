"""Which of many cells are near a box: cells sorted by the tile in which their middle lies."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector

_MOST_ALONG = 2_000  # tiles along an axis; chosen: the numbers of all tiles fit into one integer


class Tiles:
    """Cells by tiles.

    Parameters
    ----------
    low, high: (n, 3) box around each cell [m].
    edge: of a tile [m]; tiles are wider where there would be too many.
    """

    def __init__(self, low: Matrix, high: Matrix, edge: float) -> None:
        middle = 0.5 * (low + high)
        self._spread = 0.5 * (high - low).max(axis=0)  # how far a cell reaches beyond its middle
        self._low = middle.min(axis=0)
        self._edge = max(edge, float((middle.max(axis=0) - self._low).max()) / _MOST_ALONG)
        tile = np.floor((middle - self._low) / self._edge).astype(np.int64)
        self._counts = tile.max(axis=0) + 1
        number = (tile[:, 0] * self._counts[1] + tile[:, 1]) * self._counts[2] + tile[:, 2]
        self._order = np.argsort(number, kind="stable")
        self._number = number[self._order]

    def near(self, low: Vector, high: Vector) -> Indices:
        """(k,) the cells that may touch the box from `low` to `high` (3,) [m], and some others."""
        first = np.floor((low - self._spread - self._low) / self._edge).astype(np.int64)
        last = np.floor((high + self._spread - self._low) / self._edge).astype(np.int64)
        first, last = np.maximum(first, 0), np.minimum(last, self._counts - 1)
        if (last < first).any():
            return np.zeros(0, dtype=np.intp)
        x, y = np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1)
        column = ((x[:, None] * self._counts[1] + y) * self._counts[2]).reshape(-1)
        starts = self._number.searchsorted(column + first[2])
        counts = self._number.searchsorted(column + (last[2] + 1)) - starts
        ends = counts.cumsum()
        # the numbers from each start on, one span after the other
        places = np.arange(ends[-1])
        places += (starts - ends + counts).repeat(counts)
        return np.asarray(self._order.take(places), dtype=np.intp)
