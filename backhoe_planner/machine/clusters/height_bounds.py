"""Lower bounds of the distance from the ground: the highest of it in squares around a point, in each ring of them.

Ground that is between two squares around a point is to the side by at least half the edge of the inner
one, and below by at least the height of the point over the highest ground in the outer one. On even
ground that is the true distance, where a grid of cells falls short by up to three of its edges.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector

_RINGS = (0, 1, 2, 3, 4, 6, 8, 12, 17, 24, 34)  # cells from that of the point to the ends of each square; chosen
REACH = _RINGS[-1]  # cells around a region that are looked at
_ROUNDING = 1e-9  # m by which a point may lie beyond the cell in which it is counted


class HeightBounds:
    """Lower bounds of the distance from ground that lies over a region of cells.

    Parameters
    ----------
    tops: (I + 2 REACH, J + 2 REACH) the highest of the ground in each cell, along x and y, of the region and
        `REACH` cells around it [m]; minus infinity where there is none.
    low: (2,) lowest corner of the region [m].
    cell: (2,) edges of a cell [m].
    """

    def __init__(self, tops: Matrix, low: Vector, cell: Vector) -> None:
        from scipy.ndimage import maximum_filter

        tops = np.nextafter(tops.astype(np.float32), np.float32(np.inf))
        own = slice(REACH, -REACH)
        rings = [maximum_filter(tops, size=2 * ring + 1, mode="constant", cval=-np.inf)[own, own] for ring in _RINGS]
        self._counts = np.array(rings[0].shape)[:, None]
        self._highest = np.stack(rings, axis=2).reshape(-1, len(_RINGS))
        self._low, self._per_cell = low[:, None], 1.0 / cell[:, None]
        aside = np.maximum(np.array(_RINGS) * float(cell.min()) - _ROUNDING, 0.0)
        # ground that is in a square and not in the one before is that far to the side at least
        self._squared_aside = np.concatenate(([0.0], aside[:-1] ** 2))[:, None]
        self._furthest = float(aside[-1])

    def lower(self, points: Matrix) -> tuple[Vector, Flags]:
        """(k,) lower bounds of the distance from points (3, k) [m], and (k,) which points are over the region.

        The others have 0.
        """
        at = points[:2] - self._low
        at *= self._per_cell
        over = np.logical_and.reduce((at >= 0.0) & (at < self._counts), axis=0)
        x, y = np.minimum(np.maximum(at, 0.0, out=at), self._counts - 1, out=at).astype(np.intp)
        x *= int(self._counts[1, 0])
        x += y
        # squares run along the first axis, in which numpy is quick
        above = np.empty((len(_RINGS), len(x)))
        np.subtract(points[2], self._highest.take(x, axis=0).T, out=above)
        np.maximum(above, 0.0, out=above)
        above *= above
        above += self._squared_aside
        found = np.sqrt(np.minimum.reduce(above, axis=0))
        np.minimum(found, self._furthest, out=found)
        found *= over
        return found, over
