"""The triangles of a mesh in a binary tree of boxes, for the distance of a convex shape from the nearest of them.

The triangles are sorted along a curve that fills space (Morton, 1966), a few of them make a leaf, and the boxes of two
neighbours make the box of their parent. Only compiled is it faster than coal's tree, so the plain version leaves all to
that, and so does the compiled one where a shape touches a triangle.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.solid import Placed
from backhoe_planner.machine.clusters.trees import Reading
from backhoe_planner.native import compiled

_IN_LEAF = 4  # triangles; measured: with 2 to 8 a query takes as long
_BITS = 10  # of each coordinate of a triangle in the order


class TriangleTree:
    """A tree of n triangles.

    Parameters
    ----------
    corners: (n, 3, 3) [m].
    """

    def __init__(self, corners: Array) -> None:
        corners = corners[_along_curve(corners.mean(axis=1))]
        starts = np.arange(0, len(corners), _IN_LEAF)
        leaves = 1 << max(len(starts) - 1, 0).bit_length()
        boxes = np.full((2 * leaves, 2, 3), np.inf)
        boxes[:, 1] = -np.inf  # of a leaf without triangles
        last = slice(leaves, leaves + len(starts))
        boxes[last, 0] = np.minimum.reduceat(corners.min(axis=1), starts, axis=0)
        boxes[last, 1] = np.maximum.reduceat(corners.max(axis=1), starts, axis=0)
        while leaves > 1:
            children = boxes[leaves : 2 * leaves].reshape(-1, 2, 2, 3)
            leaves //= 2
            boxes[leaves : 2 * leaves, 0] = children[:, :, 0].min(axis=1)
            boxes[leaves : 2 * leaves, 1] = children[:, :, 1].max(axis=1)
        self._boxes, self._corners = boxes.reshape(-1, 6), np.ascontiguousarray(corners.reshape(-1, 9))

    @property
    def arrays(self) -> tuple[Matrix, Matrix, int]:
        """The arguments of `nearest_on_mesh` about the tree, from `boxes` on."""
        return self._boxes, self._corners, _IN_LEAF

    def measure(self, link: Placed, reach: float) -> tuple[bool, Reading | None]:
        """Whether the distance of a convex shape from the triangles is known, and the distance if so.

        The distance is None if it is not less than `reach` [m].
        """
        found = nearest_on_mesh(link.hull, link.radius, *self.arrays, reach)
        if not found:
            return found is None, None
        numbers = found[0]
        return True, Reading(float(numbers[0]), numbers[1:4], numbers[4:7], numbers[7:])


@compiled
def nearest_on_mesh(
    hull: Matrix, radius: float, boxes: Matrix, corners: Matrix, in_leaf: int, reach: float, /
) -> tuple[Vector] | tuple[()] | None:
    """The place where a shape is nearest to triangles; () if that takes coal, None if none is within `reach` [m].

    Parameters
    ----------
    hull, radius: (k, 3) points [m]; the shape is what is within the radius of their convex hull [m].
    boxes: (nodes, 6) lowest and highest corner around each node of the tree [m]. The root is node 1, node i has the
        children 2 i and 2 i + 1, and the second half of the nodes are leaves.
    corners: (n, 9) of the triangles, leaf after leaf with `in_leaf` in each [m].

    Returns
    -------
    (10,) distance, normal from the shape to the triangle, and the nearest points on shape and triangle.
    """
    return ()


def _along_curve(points: Matrix) -> Indices:
    """(n,) the order of points (n, 3) along Morton's curve."""
    low, extent = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cell = ((points - low) * ((1 << _BITS) - 1) / max(extent, np.finfo(float).tiny)).astype(np.int64)
    number = np.zeros(len(points), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            number |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(number, kind="stable")
