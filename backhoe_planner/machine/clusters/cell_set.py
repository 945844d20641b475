"""Cells of a solid: cubes along the axes, and triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine.clusters.tiles import Tiles
from backhoe_planner.machine.shape.shapes import convex_of_cell

_CUBE = np.array(list(np.ndindex(2, 2, 2)), dtype=float) - 0.5
_ROOT3 = 3.0**0.5


@dataclass(frozen=True)
class CellSet:
    """K cubes, then T triangles.

    Attributes
    ----------
    middle, half: (K, 3) and (K,) middles and half edges of the cubes [m].
    triangles: (T, 3, 3) their corners [m].
    """

    middle: Matrix
    half: Vector
    triangles: Array

    @staticmethod
    def of_triangles(triangles: Array) -> CellSet:
        """Triangles (T, 3, 3) alone [m]."""
        return CellSet(_NONE, _NONE[:, 0], triangles)

    @staticmethod
    def of_cubes(middle: Matrix, half: float) -> CellSet:
        """Cubes alone, all of one half edge [m]."""
        return CellSet(middle, np.full(len(middle), half), _NO_TRIANGLES)

    def __len__(self) -> int:
        return len(self.middle) + len(self.triangles)

    def together(self, other: CellSet) -> CellSet:
        """The cells of both; of the triangles, those of both follow the cubes of both."""
        return CellSet(
            np.concatenate((self.middle, other.middle)),
            np.concatenate((self.half, other.half)),
            np.concatenate((self.triangles, other.triangles)),
        )

    def only(self, those: Flags) -> CellSet:
        """The cells for which `those` (K + T,) is true."""
        cubes, triangles = those[: len(self.middle)], those[len(self.middle) :]
        return CellSet(
            self.middle[cubes], self.half[cubes], self.triangles[triangles] if len(triangles) else _NO_TRIANGLES
        )

    def off(self, link: LinkBox) -> Vector:
        """(K + T,) how far away the middles of all cells are from the box around a link [m]."""
        if not len(self.triangles):
            return link.off(self.middle)
        middle = self.triangles.mean(axis=1)
        return link.off(middle if not len(self.middle) else np.concatenate((self.middle, middle)))

    def radius(self) -> Vector:
        """(K + T,) how far they reach from their middles [m]."""
        cubes = _ROOT3 * self.half
        if not len(self.triangles):
            return cubes
        reach = self.triangles - self.triangles.mean(axis=1)[:, None]
        return np.concatenate((cubes, np.sqrt((reach * reach).sum(axis=2).max(axis=1))))

    def least_along(self, n: Vector) -> Vector:
        """(K + T,) the least of n . x over each cell [m]."""
        cubes = self.middle @ n - np.abs(n).sum() * self.half
        if not len(self.triangles):
            return np.asarray(cubes)
        along = self.triangles @ n
        least = np.minimum(np.minimum(along[:, 0], along[:, 1]), along[:, 2])
        return np.concatenate((cubes, least))

    def extent(self, axes: Matrix) -> tuple[Vector, Vector]:
        """(3,), (3,) how far all of them reach along the columns of `axes` (3, 3) [m]."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        if len(self.middle):
            at, more = self.middle @ axes, self.half[:, None] * np.abs(axes).sum(axis=0)
            low, high = (at - more).min(axis=0), (at + more).max(axis=0)
        if len(self.triangles):
            at = self.triangles.reshape(-1, 3) @ axes
            low, high = np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))
        return low, high

    def shape(self, index: int) -> Any:
        """Coal's object for one of them."""
        if index < len(self.middle):
            return convex_of_cell(self.middle[index] + 2.0 * self.half[index] * _CUBE)
        return convex_of_cell(self.triangles[index - len(self.middle)])


_NONE = np.zeros((0, 3))
_NO_TRIANGLES = np.zeros((0, 3, 3))


@dataclass(frozen=True)
class LinkBox:
    """The box around a link along axes R (3, 3) of its own: middle (3,), half edges (3,) and radius [m]."""

    R: Matrix
    middle: Vector
    half: Vector
    radius: float

    @staticmethod
    def around(hull: Matrix, R: Matrix, radius: float) -> LinkBox:
        """Around all that is within `radius` [m] of the hull of points (k, 3)."""
        own = hull @ R
        low, high = own.min(axis=0), own.max(axis=0)
        return LinkBox(R, R @ (0.5 * (low + high)), 0.5 * (high - low), radius)

    def off(self, points: Matrix) -> Vector:
        """(k,) signed distance of points from it [m]; less than the true one where the link is round."""
        off = np.abs((points - self.middle) @ self.R)
        off -= self.half
        out = np.maximum(off, 0.0)
        out *= out
        inside = np.minimum(np.maximum(np.maximum(off[:, 0], off[:, 1]), off[:, 2]), 0.0)
        return np.asarray(np.sqrt(out[:, 0] + out[:, 1] + out[:, 2]) + inside - self.radius)


class CoarseCells:
    """Cubes that contain the surface of a solid in a region.

    Parameters
    ----------
    low: (n, 3) their lowest corners [m].
    step: their edge [m].
    region: its lowest and highest corner (3,) [m].
    """

    def __init__(self, low: Matrix, step: float, region: tuple[Vector, Vector]) -> None:
        self._middle, self.step, self._region = low + 0.5 * step, step, region
        self._tiles = Tiles(low, low + step, 4.0 * step) if len(low) else None

    def hold(self, low: Vector, high: Vector, bounds: Matrix) -> bool:
        """Whether they hold all of a solid with these `bounds` (2, 3) that is in the box from `low` to `high` (3,)."""
        low, high = np.maximum(low, bounds[0]), np.minimum(high, bounds[1])
        return bool((high < low).any() or ((low >= self._region[0]) & (high <= self._region[1])).all())

    def near(self, low: Vector, high: Vector) -> Matrix:
        """(k, 3) middles of the cubes that may touch a box, and of some others [m]."""
        return self._middle[:0] if self._tiles is None else self._middle[self._tiles.near(low, high)]
