"""Lower bounds of the distance from the ground, from its highest points in nested squares around a point.

Ground between two squares around a point is to the side by at least half the edge of the inner
square, and below by at least the height of the point over the highest ground in the outer square. On level
ground that is the true distance, whereas a grid of cells is short by up to three of its edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine.clusters.distance_grid import off_box
from backhoe_planner.native import compiled

_RINGS = (0, 1, 2, 3, 4, 6, 8, 12, 17, 24, 34)  # cells from that of the point to the ends of each square; chosen
REACH = _RINGS[-1]  # cells around a region that are considered
_ROUNDING = 1e-9  # m by which a point may be outside the cell in which it is counted


# the arguments of `lower_over_heights` from `low` to `furthest`
Rings = tuple[Vector, Vector, Indices, NDArray[np.float32], Vector, float]


class HeightBounds:
    """Lower bounds of the distance from the ground, over a region of cells.

    Parameters
    ----------
    tops: (I + 2 REACH, J + 2 REACH) the highest point of the ground in each cell, along x and y, of the region and
        `REACH` cells around it [m]; minus infinity where there is no ground.
    low: (2,) lowest corner of the region [m].
    cell: (2,) edges of a cell [m].

    Attributes
    ----------
    rings: the data for the bounds.
    """

    def __init__(self, tops: Matrix, low: Vector, cell: Vector) -> None:
        from scipy.ndimage import maximum_filter

        tops = np.nextafter(tops.astype(np.float32), np.float32(np.inf))
        own = slice(REACH, -REACH)
        rings = [maximum_filter(tops, size=2 * ring + 1, mode="constant", cval=-np.inf)[own, own] for ring in _RINGS]
        aside = np.maximum(np.array(_RINGS) * float(cell.min()) - _ROUNDING, 0.0)
        self.rings: Rings = (
            low,
            1.0 / cell,
            np.array(rings[0].shape),
            np.ascontiguousarray(np.stack(rings, axis=2).reshape(-1, len(_RINGS))),
            # ground that is in a square and not in the one before is at least this far to the side
            np.concatenate(([0.0], aside[:-1] ** 2)),
            float(aside[-1]),
        )

    def lower(self, points: Matrix, bounds: Matrix) -> Vector:
        """(k,) lower bounds of the distance from points (3, k) to the ground in the box `bounds` (2, 3) [m].

        For points beside the region the bound is only their distance from that box.
        """
        return lower_over_heights(points, *self.rings, bounds)


@compiled
def lower_over_heights(
    points: Matrix, low: Vector, per_cell: Vector, counts: Indices, highest: NDArray[np.float32],
    squared_aside: Vector, furthest: float, bounds: Matrix, /,
) -> Vector:  # fmt: skip
    """(k,) lower bounds of the distance from points (3, k) to ground in the box `bounds` (2, 3), see `HeightBounds`.

    Parameters
    ----------
    low, per_cell, counts: (2,) the region's lowest corner [m], cells per metre, and the number of cells on each axis.
    highest: (cells, R) highest ground in the rings around each cell of the region, the second axis varying fastest [m].
    squared_aside: (R,) squared least distance to the side of ground that is in a ring and in none before [m^2].
    furthest: the largest possible bound [m].
    """
    at = points[:2] - low[:, None]
    at *= per_cell[:, None]
    over = np.logical_and.reduce((at >= 0.0) & (at < counts[:, None]), axis=0)
    x, y = np.minimum(np.maximum(at, 0.0, out=at), counts[:, None] - 1, out=at).astype(np.intp)
    x *= int(counts[1])
    x += y
    # the rings run along the first axis, so that numpy is fast
    above = np.empty((len(squared_aside), len(x)))
    np.subtract(points[2], highest.take(x, axis=0).T, out=above)
    np.maximum(above, 0.0, out=above)
    above *= above
    above += squared_aside[:, None]
    found = np.sqrt(np.minimum.reduce(above, axis=0))
    np.minimum(found, furthest, out=found)
    found *= over
    return np.maximum(found, off_box(points, bounds), out=found)
