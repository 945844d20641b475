"""The interface of every solid of thousands of cells: a scan, a terrain, a fine mesh."""

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
    radius: the shape is within `radius` of the convex hull of `hull` [m].
    """

    def __init__(self, piece: Piece, R_body: Matrix, t_body: Vector) -> None:
        R, t = piece.pose
        self.shape: Any = piece.shape
        self.R, self.t = R_body.dot(R), R_body.dot(t) + t_body
        self.radius = piece.radius
        self._own, self._R_body, self._t_body = piece.hull, R_body, t_body

    @cached_property
    def hull(self) -> Matrix:
        """(k, 3) points [m]; computed on demand, because a measurement by a tree does not need them."""
        return np.asarray(self._own.dot(self._R_body.T) + self._t_body)

    def shifted(self, by: Vector) -> Any:
        """Coal's transform after a shift `by` (3,) [m]."""
        return transform(self.R, self.t + by)

    def box(self, reach: float) -> tuple[Vector, Vector]:
        """(3,), (3,) lowest and highest corner of the box around all points within `reach` [m]."""
        more = self.radius + reach
        return np.minimum.reduce(self.hull) - more, np.maximum.reduce(self.hull) + more


@dataclass(frozen=True, eq=False)
class HeightMap:
    """The heights of ground, in its own frame.

    Attributes
    ----------
    heights: (rows, columns) [m].
    x, y: (columns,) and (rows,) their coordinates, evenly spaced [m].
    floor, top: the lowest and highest z of the ground [m].
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
    finest: approximate edge of its cells [m].
    is_full: whether more than its cells is solid: everything below the surface of ground or inside a closed mesh.
    """

    bounds: Matrix
    finest: float
    is_full: bool

    @property
    def ground(self) -> HeightMap | None:
        """Its heights, if everything below them is solid; None if it is not ground."""

    @property
    def voxels(self) -> tuple[Any, ...] | None:
        """Its cells as arguments of `boxes_of_voxels` from `keys` on, if they are voxels; otherwise None."""

    @property
    def cells(self) -> tuple[Any, ...] | None:
        """The arguments of `kept_over_cells` about its cells, from `boxes` on; None if it is ground."""

    def __len__(self) -> int:
        """The number of its cells."""

    def prepare(self) -> None:
        """Build what `measure` needs."""

    def prepare_near(self) -> None:
        """Build what `near` needs, and what tells whether a shape that touches no cell is inside."""

    def taken(self, frame: GridFrame) -> Flags:
        """(frame.counts) which cells of a grid the solid may touch."""

    def height_bounds(self, low: Vector, high: Vector) -> HeightBounds | None:
        """Bounds of the distance for points in the box from `low` to `high` (3,) [m]; None if it is not ground."""

    def measure(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from a convex shape if it is less than `reach` [m]; otherwise None."""

    def deeper(self, link: Placed, found: Reading) -> Reading:
        """The reading `found` of a shape that is inside, or a deeper one if more than the cells is solid."""

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> CellSet:
        """The cells of its surface that may touch the box from `low` to `high` (3,) [m], and some other ones.

        link: cells out of its reach are not needed.
        """

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m] and triangles (m, 3) of its surface, at most about `most`."""


def clustered(vertices: Matrix, triangles: Indices, most: int) -> tuple[Matrix, Indices]:
    """A surface with at most `most` triangles, for pictures, made by merging vertices that are near each other."""
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
