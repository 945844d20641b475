"""The state of the ground: heights of undisturbed soil on a grid, and the thickness of the loose soil on it.

A node of the grid represents the square column around it. Volumes are sums over columns, so that no soil is
lost or gained between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind, check_path
from backhoe_planner.job.ground.grids import (
    CELL,
    HeightGrid,
    as_cell,
    check_counts,
    empty_grid,
    filled,
    refuse_holes,
)
from backhoe_planner.job.ground.off_ground import OffGround
from backhoe_planner.job.ground.surveys import Survey, read_survey, split
from backhoe_planner.job.schema.work import ROUGHNESS
from backhoe_planner.site import Soil

SWELL = 1.25  # loose volume per bank volume of common earth, by default; published 1.2 to 1.3
REPOSE = 0.6  # rad by default, 34 degrees; usually 30 to 40 for common earth
_STEEPEST = 1.5  # rad of repose: no loose soil is stable on a steeper slope


@dataclass(frozen=True, eq=False)
class Terrain:
    """The ground at one moment.

    Attributes
    ----------
    low: (2,) x, y of the first node [m], world.
    cell: distance between nodes, and edge of a column [m].
    bank: (rows, columns) height z of the undisturbed soil [m]; rows run along y, columns along x, both ascending.
    loose: (rows, columns) thickness of the loose soil on it [m], 0 or more.
    soil: the kind of soil.
    swell: loose volume per bank volume.
    repose: the steepest slope of loose soil [rad].
    off_ground: what stands on the ground of a point cloud, an obstacle that digging does not remove; None if nothing.

    Raises
    ------
    InputError: a height is not a number, `loose` is negative somewhere, or the grid is too fine or too coarse.
    """

    low: Vector
    cell: float
    bank: Matrix
    loose: Matrix
    soil: Soil
    swell: float = SWELL
    repose: float = REPOSE
    off_ground: OffGround | None = None

    def __post_init__(self) -> None:
        cell = as_cell(self.cell)
        bank = as_array(self.bank, None, None, key="bank")
        loose = as_array(self.loose, *bank.shape, key="loose")
        check_counts(bank.shape, key="bank")
        if (loose < 0.0).any():
            raise InputError("is negative", key="loose", found=f"{float(loose.min()):g}", allowed="0 m or more")
        fields = {"low": as_vector(self.low, 2, key="low"), "bank": bank, "loose": loose}
        for name, value in fields.items():
            kept = value
            if value.flags.writeable or value.base is not None:
                kept = value.copy()
                kept.setflags(write=False)
            object.__setattr__(self, name, kept)
        object.__setattr__(self, "cell", cell)
        check_kind(self.soil, Soil, key="soil")
        object.__setattr__(self, "swell", as_number(self.swell, key="swell", least=1.0, most=3.0))
        object.__setattr__(self, "repose", as_number(self.repose, key="repose", above=0.0, most=_STEEPEST))
        if self.off_ground is not None:
            check_kind(self.off_ground, OffGround, key="off_ground")

    # --- made from -----------------------------------------------------------------------

    @classmethod
    def level(
        cls, z: float, low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float = CELL, *,
        soil: Soil | None = None, swell: float = SWELL, repose: float = REPOSE,
    ) -> Terrain:  # fmt: skip
        """Flat ground.

        Parameters
        ----------
        z: height of the ground [m].
        low, high: (2,) x, y of the first node, and approximately of the last [m].
        cell: distance between nodes [m].
        soil, swell, repose: as in the class.

        Raises
        ------
        InputError: one of them is not such a number, or the grid has fewer than 2 x 2 nodes or too many.
        """
        z = as_number(z, key="z")
        grid = empty_grid(low, high, cell)
        bank = np.full(grid.z.shape, z)
        return cls(grid.low, cell, bank, np.zeros_like(bank), _soil(soil), swell, repose)

    @classmethod
    def from_points(
        cls, points: Matrix, low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float = CELL, *,
        soil: Soil | None = None, swell: float = SWELL, repose: float = REPOSE, fill: float = 0.0,
        roughness: float = ROUGHNESS,
    ) -> Terrain:  # fmt: skip
        """Ground through the points of a scan: each column has the mean height of its ground points.

        Parameters
        ----------
        points: (n, 3) [m], world. Beyond the grid only what stands on the ground counts, up to 10 m away.
        low, high, cell, soil, swell, repose: as in `level`.
        fill: holes are filled from their rims up to this distance from a known column [m]; none by default.
        roughness: points that are higher than the ground in their column and in the eight around it by more than
            this [m] stand on it: they are in `off_ground`, not in the heights.

        Raises
        ------
        InputError: a column is left without a point, or an argument is not such a number; says where.
        """
        points = as_array(points, None, 3, key="points")
        grid = empty_grid(low, high, cell)
        found = split(points, grid, as_number(roughness, key="roughness", least=0.0))
        return terrain_of(found, fill=fill, soil=soil, swell=swell, repose=repose)

    @classmethod
    def from_file(
        cls, file: str | Path, *, low: Sequence[float] | Vector | None = None,
        high: Sequence[float] | Vector | None = None, cell: float | None = None, soil: Soil | None = None,
        swell: float = SWELL, repose: float = REPOSE, fill: float = 0.0,
        map_origin: Sequence[float] | Vector | None = None, roughness: float = ROUGHNESS,
    ) -> Terrain:  # fmt: skip
        """Ground from a survey; all of it is undisturbed.

        Parameters
        ----------
        file: heights as CSV (rows along y, columns along x, both ascending) or GeoTIFF, or points as
            PLY, PCD, LAS, LAZ, E57, XYZ or TXT.
        low: (2,) x, y of the first node [m]. Required for a CSV. A GeoTIFF has its own position; `low` without
            `high` moves its south-west height there. For points, by default their least x and y.
        high: (2,) x, y of approximately the last node [m]; by default the extent of the file.
        cell: distance between nodes [m]; by default 0.05, for a CSV the distance between its heights.
        soil, swell, repose: as in the class.
        fill: holes are filled from their rims up to this distance from a known column [m]; none by default.
        map_origin: (3,) the point of the file's coordinates that is the origin of the site [m]: of points and of a
            GeoTIFF. By default their coordinates are those of the site.
        roughness: of points, as in `from_points`.

        Raises
        ------
        InputError: the file is missing or malformed, or a height is missing; says which, and where.
        """
        file = check_path(file, key="file")
        found = read_survey(file, low=low, high=high, cell=cell, map_origin=map_origin, roughness=roughness)
        return terrain_of(found, fill=fill, soil=soil, swell=swell, repose=repose, file=file)

    # --- what it is ------------------------------------------------------------------------

    @property
    def surface(self) -> Matrix:
        """(rows, columns) height z of the visible surface [m]."""
        return self.bank + self.loose

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bank.shape[0], self.bank.shape[1]

    @property
    def x(self) -> Vector:
        """(columns,) x of the nodes [m]."""
        return np.asarray(self.low[0] + self.cell * np.arange(self.shape[1]))

    @property
    def y(self) -> Vector:
        """(rows,) y of the nodes [m]."""
        return np.asarray(self.low[1] + self.cell * np.arange(self.shape[0]))

    @property
    def high(self) -> Vector:
        """(2,) x, y of the last node [m]."""
        return self.low + self.cell * (np.array(self.shape[::-1]) - 1)

    @property
    def loose_volume(self) -> float:
        """Volume of all loose soil [m^3]."""
        return float(self.loose.sum()) * self.cell**2

    def bank_volume_below(self, other: Terrain) -> float:
        """Undisturbed soil missing compared with another terrain on the same grid [m^3]: what was dug since.

        Raises
        ------
        InputError: the other terrain is on another grid.
        """
        check_kind(other, Terrain, key="other")
        if other.shape != self.shape or other.cell != self.cell or (other.low != self.low).any():
            raise InputError("is on another grid", key="other", allowed="a terrain made from the same one")
        return float((other.bank - self.bank).sum()) * self.cell**2

    def with_layers(self, bank: Matrix, loose: Matrix) -> Terrain:
        """The same grid with other heights: `bank` and `loose` (rows, columns) [m]; what stands on it stays."""
        return replace(self, bank=bank, loose=loose)

    def height_at(self, points: Array) -> Array:
        """(...) height of the surface, bilinear between nodes [m]; NaN beyond the grid.

        Parameters
        ----------
        points: (..., 2) x, y [m].

        Raises
        ------
        InputError: the points are not such numbers.
        """
        found = check_points(points)
        grid = HeightGrid(self.low, self.cell, self.surface)
        return grid.at(found)

    def columns_within(self, low: Vector, high: Vector, margin: float = 0.0) -> tuple[slice, slice]:
        """Rows and columns of the nodes in the rectangle from `low` to `high` (2,) [m], and `margin` [m] around it."""
        low, high = as_vector(low, 2, key="low"), as_vector(high, 2, key="high")
        margin = as_number(margin, key="margin")
        last = np.array(self.shape[::-1])
        first = np.clip(np.ceil((low - margin - self.low) / self.cell), 0, last).astype(int)
        end = np.clip(np.floor((high + margin - self.low) / self.cell) + 1, first, last).astype(int)
        return slice(int(first[1]), int(end[1])), slice(int(first[0]), int(end[0]))

    def unlike(self, other: Terrain) -> Flags:
        """(rows, columns) where the surface differs from that of another terrain on the same grid.

        Raises
        ------
        InputError: the other is not a Terrain, or is on another grid.
        """
        if check_kind(other, Terrain, key="other").shape != self.shape:
            raise InputError("is on another grid", key="other", allowed="a terrain made from the same one")
        return np.asarray(self.surface != other.surface)


def terrain_of(
    survey: Survey, *, fill: float = 0.0, soil: Soil | None = None, swell: float = SWELL, repose: float = REPOSE,
    file: Path | None = None,
) -> Terrain:  # fmt: skip
    """The ground of a survey, all of it undisturbed.

    Parameters
    ----------
    fill, soil, swell, repose: as in `Terrain.from_file`.
    file: of the survey, for the message.

    Raises
    ------
    InputError: a column is left without a height, or an argument is not such a number; says where.
    """
    heights = filled(survey.heights, as_number(fill, key="fill", least=0.0))
    refuse_holes(heights, file, before=survey.heights)
    zero = np.zeros_like(heights.z)
    return Terrain(heights.low, heights.cell, heights.z, zero, _soil(soil), swell, repose, survey.off_ground)


def check_points(points: Array) -> Array:
    """`points` as an array of numbers (..., 2).

    Raises
    ------
    InputError: they are not numbers of that shape.
    """
    try:
        found = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim == 0 or found.shape[-1] != 2:
        raise InputError("are no places", key="points", found=str(np.shape(found)), allowed="(..., 2) x, y [m]")
    return found


def _soil(soil: Soil | None) -> Soil:
    return Soil() if soil is None else check_kind(soil, Soil, key="soil")
