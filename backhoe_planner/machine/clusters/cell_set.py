"""Cells of a solid: cubes along the axes, and triangles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.link_box import LinkReach
from backhoe_planner.machine.clusters.tiles import Tiles
from backhoe_planner.machine.shape.shapes import Gauge, cube, thin_triangle, transform
from backhoe_planner.native import compiled

_ROOT3 = 3.0**0.5


@dataclass(frozen=True)
class CellSet:
    """K cubes, then T triangles. Each coordinate is a row, so that operations on it run along memory.

    Attributes
    ----------
    middle, half: (3, K) and (K,) middles and half edges of the cubes [m].
    corners: (3, 3, T) first, second and third corners of the triangles, each by coordinates [m].
    """

    middle: Matrix
    half: Vector
    corners: Array

    @staticmethod
    def of_triangles(corners: Array) -> CellSet:
        """A set of triangles only, with `corners` (3, 3, T) [m]."""
        return CellSet(_NONE, _NONE[0], corners)

    @staticmethod
    def of_cubes(middle: Matrix, half: float) -> CellSet:
        """A set of cubes only, with middles (3, K) and the same half edge [m]."""
        return CellSet(middle, np.full(middle.shape[1], half), _NO_TRIANGLES)

    def __len__(self) -> int:
        return len(self.half) + int(self.corners.shape[2])

    def together(self, other: CellSet) -> CellSet:
        """The cells of both sets: the cubes of both, then the triangles of both."""
        if not len(other):
            return self
        return CellSet(
            np.concatenate((self.middle, other.middle), axis=1),
            np.concatenate((self.half, other.half)),
            np.concatenate((self.corners, other.corners), axis=2),
        )

    def only(self, those: Indices) -> CellSet:
        """The cells with the numbers `those` (k,), which ascend."""
        count = len(self.half)
        if not self.corners.shape[2]:
            return CellSet(self.middle.take(those, axis=1), self.half.take(those), self.corners)
        if not count:
            return CellSet(self.middle, self.half, self.corners.take(those, axis=2))
        first = int(those.searchsorted(count))
        cubes, triangles = those[:first], those[first:] - count
        return CellSet(self.middle.take(cubes, axis=1), self.half.take(cubes), self.corners.take(triangles, axis=2))

    def around(self) -> tuple[Matrix, Vector]:
        """(3, K + T) the middles of all cells, and (K + T,) how far they reach from there [m]."""
        cubes = _ROOT3 * self.half
        if not self.corners.shape[2]:
            return self.middle, cubes
        middle = self.corners.sum(axis=0) / 3.0
        reach = self.corners - middle
        reach *= reach
        size = np.sqrt(np.maximum.reduce(np.add.reduce(reach, axis=1), axis=0))
        if not len(cubes):
            return middle, size
        return np.concatenate((self.middle, middle), axis=1), np.concatenate((cubes, size))

    def least_along(self, n: Vector) -> Vector:
        """(K + T,) the least of n . x over each cell [m]."""
        return _least_along(n, self.middle, self.half, self.corners)

    def extent(self, axes: Matrix) -> tuple[Vector, Vector]:
        """(3,), (3,) the least and greatest coordinates of all cells along the columns of `axes` (3, 3) [m]."""
        return extent_along(axes, self.middle, self.half, self.corners)

    def split(self, n: Vector, nearest: int, slack: float) -> tuple[Indices, Indices, float]:
        """The cells behind the plane across `n` (3,) in front of the `nearest` cell, or at most `slack` [m] before it.

        Returns these cells, the others, and the position of the nearest of these relative to the plane [m], at most 0.
        """
        return split_by_plane(n, nearest, slack, self.middle, self.half, self.corners)

    def is_cell(self, index: int, finest: float) -> bool:
        """Whether the cell is an original one, not a larger cube that replaces cells with the edge `finest` [m]."""
        return index >= len(self.half) or bool(self.half[index] < 0.75 * finest)

    def measure(self, index: int, gauge: Gauge, shape: object, T: object) -> tuple[float, Vector, Vector, Vector]:
        """The distance of a cell from a convex `shape` at `T`, as from `Gauge.measure`."""
        if index < len(self.half):
            own, there = cube(2.0 * float(self.half[index])), transform(_AXES, self.middle[:, index])
        else:
            own, there = thin_triangle(self.corners[:, :, index - len(self.half)]), _HERE
        return gauge.measure(shape, T, own, there)


def _least_along(n: Vector, middle: Matrix, half: Vector, corners: Array) -> Vector:
    """(K + T,) the least of n . x over each of the cells of a `CellSet` [m]."""
    x, y, z = n.tolist()
    of_cubes = n @ middle - (abs(x) + abs(y) + abs(z)) * half
    if not corners.shape[2]:
        return np.asarray(of_cubes)
    least = np.minimum.reduce(np.matmul(n, corners), axis=0)
    return np.concatenate((of_cubes, least)) if len(half) else np.asarray(least)


@compiled
def split_by_plane(
    n: Vector, nearest: int, slack: float, middle: Matrix, half: Vector, corners: Array, /
) -> tuple[Indices, Indices, float]:
    """`CellSet.split` for the `middle`, `half` and `corners` of a set."""
    along = _least_along(n, middle, half, corners)
    plane = float(along[nearest])
    behind = along >= plane - slack
    own = behind.nonzero()[0]
    return own, (~behind).nonzero()[0], min(float(along[own].min()) - plane, 0.0)


@compiled
def extent_along(axes: Matrix, middle: Matrix, half: Vector, corners: Array, /) -> tuple[Vector, Vector]:
    """`CellSet.extent` for the `middle`, `half` and `corners` of a set."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    if len(half):
        at, more = axes.T @ middle, np.multiply.outer(np.add.reduce(np.abs(axes), axis=0), half)
        high = np.maximum.reduce(np.add(at, more), axis=1)
        low = np.minimum.reduce(np.subtract(at, more, out=at), axis=1)
    if corners.shape[2]:
        at = np.matmul(axes.T, corners)
        low = np.minimum(low, np.minimum.reduce(at, axis=(0, 2)))
        high = np.maximum(high, np.maximum.reduce(at, axis=(0, 2)))
    return low, high


_NONE = np.zeros((3, 0))
_NO_TRIANGLES = np.zeros((3, 3, 0))
_AXES = np.eye(3)
_HERE = transform(_AXES, np.zeros(3))


class CoarseCells:
    """Cubes that contain the surface of a solid in a region.

    Parameters
    ----------
    low: (n, 3) their lowest corners [m].
    step: their edge [m].
    region: its lowest and highest corner (3,) [m].
    bounds: (2, 3) box around the whole solid [m].

    Attributes
    ----------
    step: as above.
    regions: (4, 3) corners of the region and of the box around the solid [m].
    """

    def __init__(self, low: Matrix, step: float, region: tuple[Vector, Vector], bounds: Matrix) -> None:
        self.step, self.regions = step, np.vstack((*region, bounds))
        self._tiles = Tiles(low, low + step, 4.0 * step) if len(low) else None
        ordered = low if self._tiles is None else low[self._tiles.order]
        self._middle = np.ascontiguousarray(ordered.T) + 0.5 * step

    @cached_property
    def cubes(self) -> tuple[Any, ...] | None:
        """The arguments of `boxes_of_voxels` about the cubes, from `coarse` on; None if there are no cubes."""
        return None if self._tiles is None else (self._middle, *self._tiles.arrays)

    def hold(self, low: Vector, high: Vector) -> bool:
        """Whether the cubes contain all of the solid's surface in the box from `low` to `high` (3,) [m]."""
        first, last, *bounds = self.regions
        low, high = np.maximum(low, bounds[0]), np.minimum(high, bounds[1])
        return bool((high < low).any() or ((low >= first) & (high <= last)).all())

    def near(self, low: Vector, high: Vector, link: LinkReach) -> Matrix:
        """(3, k) middles of the cubes that may touch a box within reach of a link, and of some other cubes [m]."""
        if self._tiles is None:
            return self._middle
        return self._middle.take(self._tiles.near(low, high, link), axis=1)
