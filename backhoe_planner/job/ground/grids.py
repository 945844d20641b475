"""Heights on a grid that may have holes: filled, interpolated, resampled on other grids, made from points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector, as_number, as_vector
from backhoe_planner.errors import InputError

CELL = 0.05  # m, edge of a column by default; chosen: a twelfth of a bucket's width
_FINEST, _COARSEST = 0.005, 5.0  # m; chosen: finer or coarser grids are of no use for a trench
MOST_COLUMNS = 4_000_000  # as for a height map in a scene
_ON_BORDER = 1e-9  # m^2: rounding of the product of a side and a distance
_NO_FURTHER = 1e-6  # cells: a point on the border of a grid is in it, despite rounding


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Heights on a grid, NaN where the height is unknown.

    Attributes
    ----------
    low: (2,) x, y of the first node [m].
    cell: distance between nodes [m].
    z: (rows, columns) heights [m]; rows run along y, columns along x, both ascending.
    """

    low: Vector
    cell: float
    z: Matrix

    @property
    def high(self) -> Vector:
        """(2,) x, y of the last node [m]."""
        return self.low + self.cell * (np.array(self.z.shape[::-1]) - 1)

    def nodes(self) -> Array:
        """(rows, columns, 2) x, y of the nodes [m]."""
        rows, columns = self.z.shape
        x, y = np.meshgrid(self.low[0] + self.cell * np.arange(columns), self.low[1] + self.cell * np.arange(rows))
        return np.stack((x, y), axis=-1)

    def at(self, points: Array) -> Array:
        """(...) bilinear height at points (..., 2) [m]; NaN beyond the grid and next to a hole."""
        last = np.array(self.z.shape[::-1]) - 1
        place = (points - self.low) / self.cell
        off = ((place < -_NO_FURTHER) | (place > last + _NO_FURTHER)).any(axis=-1)
        place = np.clip(np.nan_to_num(place), 0.0, last)
        first = np.minimum(place.astype(int), last - 1)
        u, v = np.moveaxis(place - first, -1, 0)
        c, r = np.moveaxis(first, -1, 0)
        found = np.zeros(u.shape)
        for dr, dc, weight in ((0, 0, (1 - v) * (1 - u)), (0, 1, (1 - v) * u), (1, 0, v * (1 - u)), (1, 1, v * u)):
            # a corner without weight may be a hole
            found += np.where(weight > _NO_FURTHER, weight * self.z[r + dr, c + dc], 0.0)
        return np.where(off, np.nan, found)


def as_cell(cell: float) -> float:
    """`cell` as the distance between nodes [m]; raises InputError if it is not one."""
    return as_number(cell, key="cell", least=_FINEST, most=_COARSEST)


def empty_grid(low: Sequence[float] | Vector, high: Sequence[float] | Vector, cell: float) -> HeightGrid:
    """A grid of unknown heights from `low` to approximately `high` (2,) [m].

    Raises
    ------
    InputError: it would have fewer than 2 x 2 columns, or too many.
    """
    start, end, cell = as_vector(low, 2, key="low"), as_vector(high, 2, key="high"), as_cell(cell)
    counts = np.round((end - start) / cell) + 1
    if (counts < 2).any():
        raise InputError("holds less than 2 x 2 columns", key="high", found=end.tolist(), allowed="beyond low")
    check_counts((int(counts[1]), int(counts[0])), key="cell")
    return HeightGrid(start, cell, np.full((int(counts[1]), int(counts[0])), np.nan))


def widened(grid: HeightGrid, low: Vector, high: Vector, reach: float) -> tuple[HeightGrid, tuple[slice, slice]]:
    """Unknown heights in the columns of a grid and up to `reach` [m] around it, and the rows and columns of the grid.

    Parameters
    ----------
    low, high: (2,) where heights are known [m]: the columns go no further, except those of the grid.
    """
    count, last = int(reach / grid.cell), np.array(grid.z.shape[::-1]) - 1
    first = np.clip(np.round((low - grid.low) / grid.cell), -count, 0).astype(int)
    end = np.clip(np.round((high - grid.low) / grid.cell), last, last + count).astype(int)
    if np.prod(end - first + 1) > 4 * MOST_COLUMNS:
        first, end = np.zeros(2, dtype=int), last
    wide = np.full(tuple((end - first + 1)[::-1].tolist()), np.nan)
    column, row = (-first).tolist()
    part = (slice(row, row + grid.z.shape[0]), slice(column, column + grid.z.shape[1]))
    return HeightGrid(grid.low + grid.cell * first, grid.cell, wide), part


def check_counts(shape: tuple[int, ...], *, key: str) -> None:
    """Raise InputError if `shape` has fewer than 2 x 2 columns, or too many."""
    if min(shape) < 2:
        raise InputError("holds less than 2 x 2 columns", key=key, found=str(shape))
    if math.prod(shape) > MOST_COLUMNS:
        raise InputError(
            "has too many columns", key=key, found=f"{math.prod(shape)}", allowed=f"{MOST_COLUMNS}",
            hint="a larger cell, or less ground from low to high; coordinates are metres",
        )  # fmt: skip


def column_means(points: Matrix, grid: HeightGrid) -> HeightGrid:
    """The mean height of the points (n, 3) [m] in each column of a grid; NaN for a column without points."""
    on, index = columns_of(points, grid)
    z = points[on, 2]
    count = np.bincount(index, minlength=grid.z.size)
    total = np.bincount(index, weights=z, minlength=grid.z.size)
    with np.errstate(invalid="ignore"):
        return replace(grid, z=(total / count).reshape(grid.z.shape))


def column_lowest(points: Matrix, grid: HeightGrid) -> Matrix:
    """(rows, columns) the least height of the points (n, 3) [m] in each column of a grid; NaN without points."""
    on, index = columns_of(points, grid)
    return lowest_in_columns(points[on, 2], index, grid)


def lowest_in_columns(heights: Vector, columns: Indices, grid: HeightGrid) -> Matrix:
    """(rows, columns) the least of the heights (m,) [m] in each column of a grid, NaN for none.

    Parameters
    ----------
    columns: (m,) of the heights, see `columns_of`.
    """
    found = np.full(grid.z.size, np.inf)
    np.minimum.at(found, columns, heights)
    return np.where(np.isinf(found), np.nan, found).reshape(grid.z.shape)


def columns_of(points: Matrix, grid: HeightGrid) -> tuple[Flags, Indices]:
    """(n,) which of the points (n, 3) [m] are on the grid, and (m,) the columns of these."""
    row, column, on = nearest_columns(points[:, :2], grid.low, grid.cell, grid.z.shape)
    return on, row[on] * grid.z.shape[1] + column[on]


def nearest_columns(points: Array, low: Vector, cell: float, shape: tuple[int, ...]) -> tuple[Indices, Indices, Flags]:
    """(...), (...) row and column nearest to each of the points (..., 2), and (...) whether a point is in that column.

    Parameters
    ----------
    points: x, y [m].
    low: (2,) x, y of the first node of the grid [m].
    cell: distance between nodes, and edge of the column around each [m].
    shape: rows and columns of the grid.
    """
    place = np.round((points - low) / cell).astype(np.int64)
    nearest = np.clip(place, 0, np.array(shape[1::-1]) - 1)
    return nearest[..., 1], nearest[..., 0], np.asarray((place == nearest).all(axis=-1))


def lattice_within(x: Vector, y: Vector, corners: Matrix) -> Flags:
    """(k, m) whether the points of a lattice are in a convex polygon; those on its border are.

    Parameters
    ----------
    x, y: (m,) and (k,) coordinates of the lattice's columns and rows [m].
    corners: (c, 2) of the polygon, counter-clockwise [m].
    """
    found = np.ones((len(y), len(x)), dtype=bool)
    for corner, side in zip(corners, np.roll(corners, -1, axis=0) - corners, strict=True):
        found &= (side[0] * (y - corner[1]))[:, None] - side[1] * (x - corner[0]) >= -_ON_BORDER
    return found


def resampled(grid: HeightGrid, onto: HeightGrid) -> HeightGrid:
    """The heights of a grid at the nodes of another; NaN where unknown.

    If the other grid is coarser, each of its columns has the mean of the heights within it.
    """
    if onto.cell >= 2.0 * grid.cell:
        points = np.concatenate((grid.nodes(), grid.z[..., None]), axis=-1).reshape(-1, 3)
        return column_means(points[np.isfinite(points[:, 2])], onto)
    return replace(onto, z=grid.at(onto.nodes()))


def filled(grid: HeightGrid, reach: float) -> HeightGrid:
    """Holes filled up to `reach` [m] from a known column: linear between the columns at their rims."""
    holes = np.isnan(grid.z)
    if reach <= 0.0 or not holes.any() or holes.all():
        return grid
    from scipy.ndimage import distance_transform_edt

    return filled_at(grid, holes & (distance_transform_edt(holes) * grid.cell <= reach + _NO_FURTHER))


def filled_at(grid: HeightGrid, wanted: Flags) -> HeightGrid:
    """Those holes filled that are `wanted` (rows, columns): linear between the columns at their rims."""
    holes = np.isnan(grid.z)
    if not wanted.any() or holes.all():
        return grid
    from scipy.interpolate import griddata
    from scipy.ndimage import binary_dilation

    rim = binary_dilation(holes, np.ones((3, 3), dtype=bool)) & ~holes
    z = grid.z.copy()
    z[wanted] = from_nearest(z, holes)[wanted]  # beyond the hull of the rim
    corners = np.argwhere(rim)
    if np.linalg.matrix_rank(corners - corners[0]) == 2:
        between = griddata(corners, grid.z[rim], np.argwhere(wanted), method="linear")
        places = tuple(np.argwhere(wanted)[np.isfinite(between)].T)
        z[places] = between[np.isfinite(between)]
    return replace(grid, z=z)


def from_nearest(values: Matrix, missing: Flags) -> Matrix:
    """Values (rows, columns) with the missing ones replaced by the nearest that there are."""
    from scipy.ndimage import distance_transform_edt

    if not missing.any():
        return values
    nearest: Indices = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


def refuse_holes(grid: HeightGrid, file: Path | None, *, before: HeightGrid) -> None:
    """Check that every column of a grid has a height.

    Parameters
    ----------
    before: the grid before holes were filled.

    Raises
    ------
    InputError: a column has none; names the first, where it is, and how many there are.
    """
    holes: Flags = np.isnan(grid.z)
    if holes.any():
        row, column = np.argwhere(holes)[0].tolist()
        x, y = (grid.low + grid.cell * np.array([column, row])).tolist()
        hint = "give a rectangle without holes by low and high"
        if not holes.all():
            from scipy.ndimage import distance_transform_edt

            furthest = float(distance_transform_edt(np.isnan(before.z)).max()) * grid.cell
            hint += f", or fill: holes are up to {math.ceil(100.0 * furthest - 1e-6) / 100.0:g} m from a known column"
        raise InputError(
            "a height is missing", file=file, key=f"row {row + 1}, column {column + 1} (x {x:.2f} m, y {y:.2f} m)",
            found=f"{int(holes.sum())} of {holes.size} columns without a height",
            hint=hint,
        )  # fmt: skip
