"""What every solid of thousands of cells can say: a scan, a terrain, a fine mesh."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.cell_set import CellSet
from backhoe_planner.machine.clusters.distance_grid import GridFrame
from backhoe_planner.machine.clusters.height_bounds import HeightBounds
from backhoe_planner.machine.clusters.link_box import LinkReach
from backhoe_planner.machine.clusters.trees import Reading
from backhoe_planner.machine.shape.shapes import Piece, transform


class Placed:
    """A piece of a body in the frame of a solid.

    Parameters
    ----------
    R_body, t_body: (3, 3) and (3,) T_solid_body [m].

    Attributes
    ----------
    shape: coal's object.
    R, t: (3, 3) and (3,) T_solid_shape [m].
    radius: the shape lies within it of the convex hull of `hull` [m].
    """

    def __init__(self, piece: Piece, R_body: Matrix, t_body: Vector) -> None:
        R, t = piece.pose
        self.shape: Any = piece.shape
        self.R, self.t = R_body.dot(R), R_body.dot(t) + t_body
        self.radius = piece.radius
        self._own, self._R_body, self._t_body = piece.hull, R_body, t_body

    @cached_property
    def hull(self) -> Matrix:
        """(k, 3) points [m]; who only asks a tree does without."""
        return np.asarray(self._own.dot(self._R_body.T) + self._t_body)

    def shifted(self, by: Vector) -> Any:
        """Coal's transform, after a shift `by` (3,) [m]."""
        return transform(self.R, self.t + by)

    def box(self, reach: float) -> tuple[Vector, Vector]:
        """(3,), (3,) lowest and highest corner of the box around all that is within `reach` [m]."""
        more = self.radius + reach
        return np.minimum.reduce(self.hull) - more, np.maximum.reduce(self.hull) + more


@dataclass(frozen=True, eq=False)
class HeightMap:
    """The heights of ground, in its own frame.

    Attributes
    ----------
    heights: (rows, columns) [m].
    x, y: (columns,) and (rows,) where they are, at even distances [m].
    floor, top: how far down the ground reaches, and how far up [m].
    """

    heights: Matrix
    x: Vector
    y: Vector
    floor: float
    top: float


class Solid(Protocol):
    """A solid of many cells, in its own frame.

    Attributes
    ----------
    bounds: (2, 3) box around it [m].
    finest: edge of its cells, about [m].
    is_full: whether more is solid than its cells: what is below the ground or within a closed mesh.
    """

    bounds: Matrix
    finest: float
    is_full: bool

    @property
    def ground(self) -> HeightMap | None:
        """Its heights, where all that is below them is solid; None of what is no ground."""

    @property
    def voxels(self) -> tuple[Any, ...] | None:
        """Its cells, where they are voxels, as `boxes_of_voxels` takes them from `keys` on; None of other cells."""

    def __len__(self) -> int:
        """How many cells it has."""

    def prepare(self) -> None:
        """Build what it is measured with."""

    def prepare_near(self) -> None:
        """Build what `near` needs, and what says whether a shape that touches no cell is inside."""

    def taken(self, frame: GridFrame) -> Flags:
        """(frame.counts) which cells of a grid it may touch."""

    def height_bounds(self, low: Vector, high: Vector) -> HeightBounds | None:
        """Bounds of the distance for points in the box from `low` to `high` (3,) [m]; None of what is no ground."""

    def measure(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from a convex shape, where it is less than `reach` [m]; None where it is not."""

    def deeper(self, link: Placed, found: Reading) -> Reading:
        """What was found of a shape that is inside, or what says that it is deeper, where more than cells is solid."""

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> CellSet:
        """The cells of its surface that may touch the box from `low` to `high` (3,) [m], and some others.

        link: cells out of its reach are not needed either.
        """

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m] and triangles (m, 3) of its surface, about `most` at most."""


def clustered(vertices: Matrix, triangles: Indices, most: int) -> tuple[Matrix, Indices]:
    """A surface with at most `most` triangles, by moving vertices that are near each other into one, for pictures."""
    points, left = vertices, triangles
    extent = float(np.ptp(vertices, axis=0).max())
    step = extent * np.sqrt(2.0 / most) / 2.0
    while len(left) > most:
        cell = np.floor((vertices - vertices.min(axis=0)) / step).astype(np.int64)
        _, first, number = np.unique(cell, axis=0, return_index=True, return_inverse=True)
        points, left = vertices[first], number.reshape(-1)[triangles]
        left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 0] != left[:, 2])]
        left = left[np.unique(np.sort(left, axis=1), axis=0, return_index=True)[1]]
        step *= 1.3
    return points, left
