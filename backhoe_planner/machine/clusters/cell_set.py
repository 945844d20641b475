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
    """K cubes, then T triangles. Coordinates are rows, so that what is done with each of them runs along memory.

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
        """Triangles (3, 3, T) alone, as `corners` [m]."""
        return CellSet(_NONE, _NONE[0], corners)

    @staticmethod
    def of_cubes(middle: Matrix, half: float) -> CellSet:
        """Cubes with middles (3, K) alone, all of one half edge [m]."""
        return CellSet(middle, np.full(middle.shape[1], half), _NO_TRIANGLES)

    def __len__(self) -> int:
        return len(self.half) + int(self.corners.shape[2])

    def together(self, other: CellSet) -> CellSet:
        """The cells of both; of the triangles, those of both follow the cubes of both."""
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
        """(3,), (3,) how far all of them reach along the columns of `axes` (3, 3) [m]."""
        return extent_along(axes, self.middle, self.half, self.corners)

    def split(self, n: Vector, nearest: int, slack: float) -> tuple[Indices, Indices, float]:
        """Which cells lie behind the plane across `n` (3,) before the `nearest` cell, or within `slack` [m] before it.

        These, the others, and how much nearer than the plane the nearest of these is [m], not positive.
        """
        return split_by_plane(n, nearest, slack, self.middle, self.half, self.corners)

    def is_cell(self, index: int, finest: float) -> bool:
        """Whether one of them is no larger cube that stands for some with the edge `finest` [m]."""
        return index >= len(self.half) or bool(self.half[index] < 0.75 * finest)

    def measure(self, index: int, gauge: Gauge, shape: object, T: object) -> tuple[float, Vector, Vector, Vector]:
        """The distance of one of them from a convex `shape` at `T`, as `Gauge.measure` gives it."""
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
    """See `CellSet.split`; `middle`, `half` and `corners` are those of the set."""
    along = _least_along(n, middle, half, corners)
    plane = float(along[nearest])
    behind = along >= plane - slack
    own = behind.nonzero()[0]
    return own, (~behind).nonzero()[0], min(float(along[own].min()) - plane, 0.0)


@compiled
def extent_along(axes: Matrix, middle: Matrix, half: Vector, corners: Array, /) -> tuple[Vector, Vector]:
    """See `CellSet.extent`; `middle`, `half` and `corners` are those of the set."""
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
    regions: (4, 3) corners of the region and of that box [m].
    """

    def __init__(self, low: Matrix, step: float, region: tuple[Vector, Vector], bounds: Matrix) -> None:
        self.step, self.regions = step, np.vstack((*region, bounds))
        self._tiles = Tiles(low, low + step, 4.0 * step) if len(low) else None
        ordered = low if self._tiles is None else low[self._tiles.order]
        self._middle = np.ascontiguousarray(ordered.T) + 0.5 * step

    @cached_property
    def cubes(self) -> tuple[Any, ...] | None:
        """What `boxes_of_voxels` has to know of them, from `coarse` on; None where there are none."""
        return None if self._tiles is None else (self._middle, *self._tiles.arrays)

    def hold(self, low: Vector, high: Vector) -> bool:
        """Whether they hold all of the solid that is in the box from `low` to `high` (3,) [m]."""
        first, last, *bounds = self.regions
        low, high = np.maximum(low, bounds[0]), np.minimum(high, bounds[1])
        return bool((high < low).any() or ((low >= first) & (high <= last)).all())

    def near(self, low: Vector, high: Vector, link: LinkReach) -> Matrix:
        """(3, k) middles of the cubes that may touch a box within reach of a link, and of some others [m]."""
        if self._tiles is None:
            return self._middle
        return self._middle.take(self._tiles.near(low, high, link), axis=1)
