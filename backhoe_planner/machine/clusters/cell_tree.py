"""Triangles or cubes in a binary tree of boxes, for the distance of a convex shape from the nearest of them.

The cells are sorted along a curve that fills space (Morton, 1966), a few of them make a leaf, and the boxes of two
neighbours make the box of their parent. Only compiled is it faster than coal's trees, so the plain version leaves all
to them, and so does the compiled one where a shape touches a cell.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.solid import Placed
from backhoe_planner.machine.clusters.trees import LEAST_REACH, Reading
from backhoe_planner.native import compiled

_IN_LEAF = 4  # cells; measured: with 2 to 8 a query takes as long
_BITS = 16  # of each coordinate of a cell in the order: a voxel of 5 cm has a number of its own on a site of 3 km
# shifts and masks that put two zeros between the bits of a number (the usual way to Morton's numbers)
_SPREAD = (
    (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)  # fmt: skip


class CellTree:
    """A tree of n cells.

    Parameters
    ----------
    cells: (n, 9) corners of triangles, or (n, 3) middles of cubes [m].
    low, high: (n, 3) the box around each cell [m].
    half: half the edge of a cube [m].
    """

    def __init__(self, cells: Matrix, low: Matrix, high: Matrix, *, half: float = 0.0) -> None:
        order = _along_curve(0.5 * (low + high))
        cells, low, high = cells[order], low[order], high[order]
        starts = np.arange(0, len(cells), _IN_LEAF)
        leaves = 1 << max(len(starts) - 1, 0).bit_length()
        boxes = np.full((2 * leaves, 2, 3), np.inf)
        boxes[:, 1] = -np.inf  # of a leaf without cells
        last = slice(leaves, leaves + len(starts))
        boxes[last, 0] = np.minimum.reduceat(low, starts, axis=0)
        boxes[last, 1] = np.maximum.reduceat(high, starts, axis=0)
        while leaves > 1:
            children = boxes[leaves : 2 * leaves].reshape(-1, 2, 2, 3)
            leaves //= 2
            boxes[leaves : 2 * leaves, 0] = children[:, :, 0].min(axis=1)
            boxes[leaves : 2 * leaves, 1] = children[:, :, 1].max(axis=1)
        self._boxes, self._cells = boxes.reshape(-1, 6), np.ascontiguousarray(cells, dtype=float)
        self._half = half

    @staticmethod
    def of_triangles(corners: Array) -> CellTree:
        """A tree of triangles with these corners (n, 3, 3) [m]."""
        return CellTree(corners.reshape(-1, 9), corners.min(axis=1), corners.max(axis=1))

    @staticmethod
    def of_cubes(middles: Matrix, edge: float) -> CellTree:
        """A tree of upright cubes with these middles (n, 3) and an `edge` [m]."""
        half = 0.5 * edge
        return CellTree(middles, middles - half, middles + half, half=half)

    @property
    def arrays(self) -> tuple[Matrix, Matrix, int, float]:
        """The arguments of `nearest_on_cells` about the tree, from `boxes` on."""
        return self._boxes, self._cells, _IN_LEAF, self._half

    def measure(self, link: Placed, reach: float) -> tuple[bool, Reading | None]:
        """Whether the distance of a convex shape from the cells is known, and the distance if so.

        The distance is None if it is not less than `reach` [m].
        """
        return Reading.of_compiled(nearest_on_cells(link.hull, link.radius, *self.arrays, max(reach, LEAST_REACH)))


@compiled
def nearest_on_cells(
    hull: Matrix, radius: float, boxes: Matrix, cells: Matrix, in_leaf: int, half: float, reach: float, /
) -> tuple[Vector] | tuple[()] | None:
    """The place where a shape is nearest to cells; () if that takes coal, None if none is within `reach` [m].

    Parameters
    ----------
    hull, radius: (k, 3) points [m]; the shape is what is within the radius of their convex hull [m].
    boxes: (nodes, 6) lowest and highest corner around each node of the tree [m]. The root is node 1, node i has the
        children 2 i and 2 i + 1, and the second half of the nodes are leaves.
    cells: (n, 9) corners of triangles or (n, 3) middles of cubes, leaf after leaf with `in_leaf` in each [m].
    half: half the edge of a cube [m].

    Returns
    -------
    (10,) distance, normal from the shape to the cell, and the nearest points on shape and cell.
    """
    return ()


def _along_curve(points: Matrix) -> Indices:
    """(n,) the order of points (n, 3) along Morton's curve."""
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cell = ((points - low) * ((1 << _BITS) - 1) / max(extent, np.finfo(float).tiny)).astype(np.int64)
    for shift, mask in _SPREAD:
        cell = (cell | (cell << shift)) & mask
    return np.argsort(cell[:, 0] | (cell[:, 1] << 1) | (cell[:, 2] << 2), kind="stable")
