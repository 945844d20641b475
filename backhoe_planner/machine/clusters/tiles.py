"""Cells sorted by the tile of their middle, to find those near a box or a link."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine.clusters.link_box import ANYWHERE, LinkReach, off_turned_box
from backhoe_planner.native import compiled

_MOST_ALONG = 2_000  # tiles along an axis; chosen: the numbers of all tiles fit into one integer


class Tiles:
    """Cells by tiles.

    Parameters
    ----------
    low, high: (n, 3) box around each cell [m].
    edge: of a tile [m]; tiles are larger if there would be too many.

    Attributes
    ----------
    order: (n,) the cells, sorted by tiles. If they are stored in this order, those of a tile are consecutive.
    """

    def __init__(self, low: Matrix, high: Matrix, edge: float) -> None:
        middle = 0.5 * (low + high)
        self._spread = 0.5 * (high - low).max(axis=0)  # how far a cell reaches beyond its middle
        self._low = middle.min(axis=0)
        self._edge = max(edge, float((middle.max(axis=0) - self._low).max()) / _MOST_ALONG)
        tile = np.floor((middle - self._low) / self._edge).astype(np.int64)
        self._counts = tile.max(axis=0) + 1
        number = (tile[:, 0] * self._counts[1] + tile[:, 1]) * self._counts[2] + tile[:, 2]
        self.order: Indices = np.argsort(number, kind="stable")
        # for each of the M tiles that are not empty: its number, its first place in the order, and its cells' box
        self._number, first = np.unique(number[self.order], return_index=True)
        self._start = np.append(first, len(number))
        lowest = np.minimum.reduceat(low[self.order], first, axis=0)
        highest = np.maximum.reduceat(high[self.order], first, axis=0)
        self._middle = np.ascontiguousarray(0.5 * (lowest + highest).T)
        self._radius = 0.5 * np.linalg.norm(highest - lowest, axis=1)

    @property
    def arrays(self) -> tuple[Vector, Vector, float, Indices, Indices, Indices, Matrix, Vector]:
        """The arguments of `cells_of_tiles` about the tiles, from `origin` on."""
        return (
            self._low, self._spread, self._edge, self._counts, self._number, self._start, self._middle, self._radius
        )  # fmt: skip

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> Indices:
        """(k,) places in `order` of the cells that may touch the box from `low` to `high` (3,) [m], and of some others.

        link: cells out of its reach are not needed.
        """
        box, reach = ANYWHERE if link is None else link
        return cells_of_tiles(low, high, *self.arrays, box.R, box.middle, box.half, box.radius, reach)


@compiled
def cells_of_tiles(
    low: Vector, high: Vector, origin: Vector, spread: Vector, edge: float, counts: Indices, number: Indices,
    start: Indices, middle: Matrix, size: Vector, R: Matrix, of_link: Vector, half: Vector, radius: float,
    reach: float, /,
) -> Indices:  # fmt: skip
    """(k,) places of the cells in those of M tiles that may touch the box from `low` to `high` (3,) and a link.

    Parameters
    ----------
    origin, spread: (3,), (3,) the lowest corner of the first tile, and how far cells may extend out of their tile [m].
    edge, counts: of a tile [m], and (3,) the number of tiles on each axis.
    number, start: (M,) numbers of the tiles that are not empty, ascending; (M + 1,) their first places and the end.
    middle, size: (3, M), (M,) centres and radii of balls around the cells of each tile [m].
    R, of_link, half, radius, reach: of the link's box, see `off_turned_box`, and how far from it tiles count [m].
    """
    first = np.floor((low - spread - origin) / edge).astype(np.int64)
    last = np.floor((high + spread - origin) / edge).astype(np.int64)
    first, last = np.maximum(first, 0), np.minimum(last, counts - 1)
    if (last < first).any():
        return np.zeros(0, dtype=np.intp)
    x, y = np.arange(first[0], last[0] + 1), np.arange(first[1], last[1] + 1)
    column = ((x[:, None] * counts[1] + y) * counts[2]).reshape(-1)
    starts = number.searchsorted(column + first[2])
    tiles = _spans(starts, number.searchsorted(column + (last[2] + 1)))
    away = off_turned_box(middle.take(tiles, axis=1), R, of_link, half, radius)
    away -= size.take(tiles)
    tiles = tiles.take((away <= reach).nonzero()[0])
    return _spans(start.take(tiles), start.take(tiles + 1))


def _spans(starts: Indices, ends: Indices) -> Indices:
    """The numbers from each start to just before its end, one span after another."""
    counts = ends - starts
    until = counts.cumsum()
    found = np.arange(until[-1] if len(until) else 0)
    found += (starts - until + counts).repeat(counts)
    return np.asarray(found, dtype=np.intp)
