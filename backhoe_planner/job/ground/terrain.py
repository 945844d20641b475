"""The ground as a state: heights of undisturbed soil on a grid, and how thick loose soil lies on it.

A node of the grid stands for the square column around it. Volumes are sums over columns, so
that nothing is lost or won between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind, check_path
from backhoe_planner.job.ground.grids import HeightGrid, column_means, filled, refuse_holes, resampled
from backhoe_planner.site import Soil, read_height_grid, read_points

CELL = 0.05  # m, edge of a column by default; chosen: a twelfth of a bucket's width
SWELL = 1.25  # loose volume per bank volume of common earth, by default; published 1.2 to 1.3
REPOSE = 0.6  # rad by default, 34 degrees; usual for common earth 30 to 40
_FINEST, _COARSEST = 0.005, 5.0  # m; chosen: finer or coarser says nothing about a trench
_MOST_COLUMNS = 4_000_000  # as of a height map in a scene
_STEEPEST = 1.5  # rad of repose: steeper nothing loose stands


@dataclass(frozen=True, eq=False)
class Terrain:
    """The ground at one moment.

    Attributes
    ----------
    low: (2,) x, y of the first node [m], world.
    cell: between nodes, and edge of a column [m].
    bank: (rows, columns) height z to which soil is undisturbed [m]; rows run along y, columns along x, both ascending.
    loose: (rows, columns) thickness of the loose soil on it [m], 0 or more.
    soil: of what it is.
    swell: loose volume per bank volume.
    repose: the steepest slope of loose soil [rad].

    Raises
    ------
    InputError: a height is no number, `loose` is negative somewhere, or the grid is too fine or too coarse.
    """

    low: Vector
    cell: float
    bank: Matrix
    loose: Matrix
    soil: Soil
    swell: float = SWELL
    repose: float = REPOSE

    def __post_init__(self) -> None:
        cell = as_number(self.cell, key="cell", least=_FINEST, most=_COARSEST)
        bank = as_array(self.bank, None, None, key="bank")
        loose = as_array(self.loose, *bank.shape, key="loose")
        _check_counts(bank.shape, key="bank")
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

    # --- made from -----------------------------------------------------------------------

    @classmethod
    def level(
        cls, z: float, low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float = CELL, *,
        soil: Soil | None = None, swell: float = SWELL, repose: float = REPOSE,
    ) -> Terrain:  # fmt: skip
        """Flat ground.

        Parameters
        ----------
        z: its height [m].
        low, high: (2,) x, y of the first node, and about of the last [m].
        cell: between nodes [m].
        soil, swell, repose: as of the class.

        Raises
        ------
        InputError: one of them is not such a number, or the grid has less than 2 x 2 or too many nodes.
        """
        z = as_number(z, key="z")
        low, counts = _frame(low, high, cell)
        bank = np.full(counts, z)
        return cls(low, cell, bank, np.zeros_like(bank), _soil(soil), swell, repose)

    @classmethod
    def from_points(
        cls, points: Matrix, low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float = CELL, *,
        soil: Soil | None = None, swell: float = SWELL, repose: float = REPOSE, fill: float = 0.0,
    ) -> Terrain:  # fmt: skip
        """Ground through the points of a scan: each column has the mean height of its points.

        Parameters
        ----------
        points: (n, 3) [m], world; what lies beyond the grid is left out.
        low, high, cell, soil, swell, repose: as of `level`.
        fill: holes are filled from their rims up to this far from a known column [m]; by default none is.

        Raises
        ------
        InputError: a column without a point is left, or an argument is not such a number; it says where.
        """
        points = as_array(points, None, 3, key="points")
        low, counts = _frame(low, high, cell)
        heights = column_means(points, HeightGrid(low, cell, np.full(counts, np.nan)))
        return cls._of(heights, fill=fill, soil=soil, swell=swell, repose=repose, file=None)

    @classmethod
    def from_file(
        cls, file: str | Path, *, low: Sequence[float] | Vector | None = None,
        high: Sequence[float] | Vector | None = None, cell: float | None = None, soil: Soil | None = None,
        swell: float = SWELL, repose: float = REPOSE, fill: float = 0.0,
    ) -> Terrain:  # fmt: skip
        """Ground from a survey, all of it undisturbed.

        Parameters
        ----------
        file: heights as CSV (rows along y, columns along x, both ascending) or GeoTIFF, or points as PLY, XYZ or TXT.
        low: (2,) x, y of the first node [m]. A CSV needs it; a GeoTIFF says where it is itself, unless this
            is given, then as if its south-west height stood there; of points by default their least x and y.
        high: (2,) x, y of about the last node [m]; by default as far as the file goes.
        cell: between nodes [m]; by default 0.05, of a CSV the distance between its heights.
        soil, swell, repose: as of the class.
        fill: holes are filled from their rims up to this far from a known column [m]; by default none is.

        Raises
        ------
        InputError: the file is missing or malformed, or a height is missing; it says which, and where.
        """
        file = check_path(file, key="file")
        wanted = None if cell is None else as_number(cell, key="cell", least=_FINEST, most=_COARSEST)
        heights = read_survey(file, low=low, high=high, cell=wanted)
        return cls._of(heights, fill=fill, soil=soil, swell=swell, repose=repose, file=file)

    @classmethod
    def _of(
        cls, heights: HeightGrid, *, fill: float, soil: Soil | None, swell: float, repose: float, file: Path | None
    ) -> Terrain:
        heights = filled(heights, as_number(fill, key="fill", least=0.0))
        refuse_holes(heights, file)
        zero = np.zeros_like(heights.z)
        return cls(heights.low, heights.cell, heights.z, zero, _soil(soil), swell, repose)

    # --- what it is ------------------------------------------------------------------------

    @property
    def surface(self) -> Matrix:
        """(rows, columns) height z of what one sees [m]."""
        return self.bank + self.loose

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.bank.shape[0], self.bank.shape[1]

    @property
    def x(self) -> Vector:
        """(columns,) of the nodes [m]."""
        return np.asarray(self.low[0] + self.cell * np.arange(self.shape[1]))

    @property
    def y(self) -> Vector:
        """(rows,) of the nodes [m]."""
        return np.asarray(self.low[1] + self.cell * np.arange(self.shape[0]))

    @property
    def high(self) -> Vector:
        """(2,) x, y of the last node [m]."""
        return self.low + self.cell * (np.array(self.shape[::-1]) - 1)

    @property
    def loose_volume(self) -> float:
        """Of all loose soil on it [m^3]."""
        return float(self.loose.sum()) * self.cell**2

    def bank_volume_below(self, other: Terrain) -> float:
        """How much undisturbed soil it has less than another terrain on the same grid [m^3]: what was dug since.

        Raises
        ------
        InputError: the other stands on another grid.
        """
        check_kind(other, Terrain, key="other")
        if other.shape != self.shape or other.cell != self.cell or (other.low != self.low).any():
            raise InputError("is on another grid", key="other", allowed="a terrain made from the same one")
        return float((other.bank - self.bank).sum()) * self.cell**2

    def with_layers(self, bank: Matrix, loose: Matrix) -> Terrain:
        """The same place with other heights: `bank` and `loose` (rows, columns) [m]."""
        return replace(self, bank=bank, loose=loose)

    def height_at(self, points: Array) -> Array:
        """(...) height of the surface between nodes, bilinear [m]; NaN beyond the grid.

        Parameters
        ----------
        points: (..., 2) x, y [m].
        """
        grid = HeightGrid(self.low, self.cell, self.surface)
        return grid.at(np.asarray(points, dtype=float))

    def columns_within(self, low: Vector, high: Vector, margin: float = 0.0) -> tuple[slice, slice]:
        """Rows and columns of the nodes in the rectangle from `low` to `high` (2,) [m], and `margin` [m] around it."""
        last = np.array(self.shape[::-1])
        first = np.clip(np.ceil((low - margin - self.low) / self.cell), 0, last).astype(int)
        end = np.clip(np.floor((high + margin - self.low) / self.cell) + 1, first, last).astype(int)
        return slice(int(first[1]), int(end[1])), slice(int(first[0]), int(end[0]))

    def unlike(self, other: Terrain) -> Flags:
        """(rows, columns) where the surface differs from that of another terrain on the same grid."""
        return np.asarray(self.surface != other.surface)


def read_survey(
    file: Path, *, low: Sequence[float] | Vector | None, high: Sequence[float] | Vector | None, cell: float | None
) -> HeightGrid:
    """The heights in a file, see `Terrain.from_file`; NaN where there is none.

    Raises
    ------
    InputError: the file is missing or malformed, or says not where it lies.
    """
    start = None if low is None else as_vector(low, 2, key="low")
    end = None if high is None else as_vector(high, 2, key="high")
    if file.suffix.lower() in _POINTS:
        points = read_points(file)
        start = points[:, :2].min(axis=0) if start is None else start
        end = points[:, :2].max(axis=0) if end is None else end
        start, counts = _frame(start, end, CELL if cell is None else cell)
        return column_means(points, HeightGrid(start, CELL if cell is None else cell, np.full(counts, np.nan)))
    table = read_height_grid(file)
    if table.low is None:
        if start is None or cell is None:
            raise InputError(
                "does not say where its heights lie", file=file, key="low" if start is None else "cell",
                hint="give low, x and y of its first height, and cell, the distance between heights",
            )  # fmt: skip
        grid = HeightGrid(start, cell, table.heights)
        if end is None:
            return grid
    else:
        grid = HeightGrid(table.low, table.cell, table.heights)
        if start is not None and end is None:
            grid = replace(grid, low=start)
    start = grid.low if start is None else start
    end = grid.high if end is None else end
    step = CELL if cell is None else cell
    if math.isclose(step, grid.cell, rel_tol=1e-9) and (start == grid.low).all() and (end == grid.high).all():
        return grid
    start, counts = _frame(start, end, step)
    return resampled(grid, HeightGrid(start, step, np.full(counts, np.nan)))


_POINTS = (".ply", ".obj", ".stl", ".xyz", ".txt", ".pts")


def _soil(soil: Soil | None) -> Soil:
    return Soil() if soil is None else check_kind(soil, Soil, key="soil")


def _frame(
    low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float
) -> tuple[Vector, tuple[int, int]]:
    """The first node, and rows and columns, of a grid from `low` to about `high` (2,) [m]."""
    start, end = as_vector(low, 2, key="low"), as_vector(high, 2, key="high")
    cell = as_number(cell, key="cell", least=_FINEST, most=_COARSEST)
    counts = np.round((end - start) / cell) + 1
    if (counts < 2).any():
        raise InputError("holds less than 2 x 2 columns", key="high", found=end.tolist(), allowed="beyond low")
    if counts.prod() > _MOST_COLUMNS:
        raise InputError("has too many columns", key="cell", found=f"{counts.prod():.0f}", allowed=f"{_MOST_COLUMNS}")
    return start, (int(counts[1]), int(counts[0]))


def _check_counts(shape: tuple[int, ...], *, key: str) -> None:
    if min(shape) < 2:
        raise InputError("holds less than 2 x 2 columns", key=key, found=str(shape))
    if math.prod(shape) > _MOST_COLUMNS:
        raise InputError("has too many columns", key=key, found=f"{math.prod(shape)}", allowed=f"{_MOST_COLUMNS}")
