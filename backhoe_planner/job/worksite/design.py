"""The design: where to dig, and how deep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job.ground.grids import nearest_columns
from backhoe_planner.job.schema.work import Trench
from backhoe_planner.job.worksite.column_parts import overlaps, parts_within

_ROUNDING = 1e-9  # m


class Design(Protocol):
    """The depth to be dug, by place."""

    def height(self, points: Array) -> Array:
        """(...) height of the design at points (..., 2) x, y [m]; nan where nothing is to be dug."""

    def within(self, points: Array, slack: float) -> Flags:
        """(...) whether points (..., 2) are at most `slack` [m] outside of what is to be dug."""

    def columns(self, x: Vector, y: Vector, cell: float) -> tuple[Matrix, Matrix]:
        """(rows, columns) the part of each column of a ground within what is to be dug, and its mean height there [m].

        Parameters
        ----------
        x, y: (columns,), (rows,) coordinates of the ground's columns [m].
        cell: edge of a column [m].
        """

    @property
    def outline(self) -> Matrix:
        """(k, 2) corners of a convex area around the design, counter-clockwise [m]."""


@dataclass(frozen=True, eq=False)
class TrenchDesign:
    """A trench with upright walls.

    Attributes
    ----------
    trench: as in the job file.
    ground: height of the ground at the trench's beginning [m].
    """

    trench: Trench
    ground: float

    @property
    def direction(self) -> Vector:
        """(2,) unit vector from the trench's beginning to its end."""
        return (np.array(self.trench.end) - self.trench.start) / self.trench.length

    def along(self, points: Array) -> tuple[Array, Array]:
        """(...), (...) distances of points (..., 2) along the trench, and to its left [m]."""
        off = np.asarray(points, dtype=float) - self.trench.start
        ahead = self.direction
        return off @ ahead, off @ np.array([-ahead[1], ahead[0]])

    def height(self, points: Array) -> Array:
        """See `Design`."""
        along, _ = self.along(points)
        bottom = self.ground - self.trench.depth - self.trench.slope * along
        return np.where(self.within(points, 0.0), bottom, np.nan)

    def within(self, points: Array, slack: float) -> Flags:
        """See `Design`."""
        along, aside = self.along(points)
        room = slack + _ROUNDING
        inside = (along >= -room) & (along <= self.trench.length + room)
        return np.asarray(inside & (np.abs(aside) <= 0.5 * self.trench.width + room))

    def columns(self, x: Vector, y: Vector, cell: float) -> tuple[Matrix, Matrix]:
        """See `Design`."""
        share, middle = parts_within(np.stack(np.meshgrid(x, y), axis=-1), cell, self.outline)
        along, _ = self.along(middle)
        bottom = self.ground - self.trench.depth - self.trench.slope * along
        return share, np.where(share > 0.0, bottom, np.nan)

    @property
    def outline(self) -> Matrix:
        """See `Design`."""
        ahead = self.direction
        left = 0.5 * self.trench.width * np.array([-ahead[1], ahead[0]])
        a, b = np.array(self.trench.start), np.array(self.trench.end)
        return np.array([a - left, b - left, b + left, a + left])


@dataclass(frozen=True, eq=False)
class SurfaceDesign:
    """A design surface on a grid.

    Attributes
    ----------
    low: (2,) x, y of the first height [m].
    cell: distance between heights [m].
    z: (rows, columns) heights [m]; nan where nothing is to be dug.
    """

    low: Vector
    cell: float
    z: Matrix

    def height(self, points: Array) -> Array:
        """See `Design`."""
        row, column, on = nearest_columns(np.asarray(points, dtype=float), self.low, self.cell, self.z.shape)
        return np.where(on, self.z[row, column], np.nan)

    def within(self, points: Array, slack: float) -> Flags:
        """See `Design`; `slack` is rounded up to whole cells."""
        from scipy.ndimage import binary_dilation

        known = np.isfinite(self.z)
        steps = int(np.ceil(slack / self.cell - _ROUNDING))
        if steps:
            known = np.pad(known, steps)
            known = binary_dilation(known, np.ones((3, 3), dtype=bool), iterations=steps)
        low = self.low - self.cell * steps
        row, column, on = nearest_columns(np.asarray(points, dtype=float), low, self.cell, known.shape)
        return np.asarray(on & known[row, column])

    def columns(self, x: Vector, y: Vector, cell: float) -> tuple[Matrix, Matrix]:
        """See `Design`."""
        rows, columns = self.z.shape
        down = overlaps(float(self.low[1]), self.cell, rows, y, cell)
        right = overlaps(float(self.low[0]), self.cell, columns, x, cell).T
        known = np.isfinite(self.z)
        share = np.minimum(down @ known.astype(float) @ right, 1.0)
        share[share < _ROUNDING] = 0.0
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = down @ np.where(known, self.z, 0.0) @ right / share
        return share, np.where(share > 0.0, mean, np.nan)

    @property
    def outline(self) -> Matrix:
        """See `Design`."""
        rows, columns = np.nonzero(np.isfinite(self.z))
        corners = [
            self.low + self.cell * np.array([column, row])
            for row, column in (
                (rows.min(), columns.min()), (rows.min(), columns.max()),
                (rows.max(), columns.max()), (rows.max(), columns.min()),
            )
        ]  # fmt: skip
        return np.array(corners)
