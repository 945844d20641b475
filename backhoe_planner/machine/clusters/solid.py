"""What every solid of thousands of cells can say: a scan, a terrain, a fine mesh."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.cell_set import CellSet
from backhoe_planner.machine.clusters.distance_grid import GridFrame
from backhoe_planner.machine.clusters.height_bounds import HeightBounds
from backhoe_planner.machine.clusters.trees import Reading
from backhoe_planner.machine.shape.shapes import Piece, transform


class Placed(NamedTuple):
    """A convex shape in the frame of a solid.

    Attributes
    ----------
    shape: coal's object.
    R, t: (3, 3) and (3,) T_solid_shape [m].
    hull: (k, 3) points, and `radius` [m]: the shape lies within the radius of their convex hull.
    """

    shape: Any
    R: Matrix
    t: Vector
    hull: Matrix
    radius: float

    @staticmethod
    def of(piece: Piece, R_body: Matrix, t_body: Vector) -> Placed:
        """A piece of a body that stands at `R_body` (3, 3), `t_body` (3,) [m] in the frame of the solid."""
        own = piece.placement
        return Placed(
            piece.shape, R_body.dot(own.rotation), R_body.dot(own.translation) + t_body,
            piece.hull.dot(R_body.T) + t_body, piece.radius,
        )  # fmt: skip

    def shifted(self, by: Vector) -> Any:
        """Coal's transform, after a shift `by` (3,) [m]."""
        return transform(self.R, self.t + by)

    def box(self, reach: float) -> tuple[Vector, Vector]:
        """(3,), (3,) lowest and highest corner of the box around all that is within `reach` [m]."""
        more = self.radius + reach
        return np.minimum.reduce(self.hull) - more, np.maximum.reduce(self.hull) + more


class Solid(Protocol):
    """A solid of many cells, in its own frame.

    Attributes
    ----------
    bounds: (2, 3) box around it [m].
    finest: edge of its cells, about [m].
    is_full: whether more is solid than its cells: what is below the ground or within a closed mesh.
    is_ground: whether all that is below its cells is solid.
    """

    bounds: Matrix
    finest: float
    is_full: bool
    is_ground: bool

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

    def near(self, low: Vector, high: Vector) -> CellSet:
        """The cells of its surface that may touch the box from `low` to `high` (3,) [m], and some others."""

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
