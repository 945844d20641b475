"""Heights of a site from a file, resampled on the wanted grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_vector
from backhoe_planner.errors import InputError
from backhoe_planner.job.ground.grids import (
    CELL,
    HeightGrid,
    as_cell,
    column_highest,
    column_means,
    empty_grid,
    resampled,
)
from backhoe_planner.site import read_height_grid, read_points

_STANDS = 0.3  # m above the mean height of a column: what stands there, no roughness of the ground; chosen
_STEEPEST = 2.0  # times as high as wide: ground of 63 degrees; chosen
_POINTS = (".ply", ".pcd", ".las", ".laz", ".e57", ".obj", ".stl", ".xyz", ".txt", ".pts")


def read_survey(
    file: Path, *, low: Sequence[float] | Vector | None, high: Sequence[float] | Vector | None, cell: float | None,
    map_origin: Sequence[float] | Vector | None = None,
) -> HeightGrid:  # fmt: skip
    """The heights in a file, see `Terrain.from_file`; NaN where there is none.

    Raises
    ------
    InputError: the file is missing or malformed, or does not contain its position.
    """
    if file.suffix.lower() in _POINTS:
        return _means(read_points(file, map_origin=_origin(map_origin)), low=low, high=high, cell=cell)
    moved = high is None and map_origin is None
    grid = _read_table(file, low, cell, map_origin, moved=moved)
    if high is None and (moved or low is None) and (cell is None or cell == grid.cell):
        return grid
    start = grid.low if low is None else low
    step = CELL if cell is None else cell
    return resampled(grid, empty_grid(start, grid.high if high is None else high, step))


def what_stands(
    file: Path, *, low: Sequence[float] | Vector | None, high: Sequence[float] | Vector | None, cell: float | None,
    map_origin: Sequence[float] | Vector | None = None,
) -> str:  # fmt: skip
    """What is to be known of the points in a file that are far above their column's mean height; empty if none are.

    Parameters
    ----------
    file: points, or heights, of which none are; low, high, cell, map_origin: as in `Terrain.from_file`.

    Raises
    ------
    InputError: as for `read_survey`.
    """
    if file.suffix.lower() not in _POINTS:
        return ""
    points = read_points(file, map_origin=_origin(map_origin))
    means = _means(points, low=low, high=high, cell=cell)
    highest = column_highest(points, means)
    above = np.where(np.isnan(means.z), 0.0, highest - means.z)
    wrong = above > _STANDS + _STEEPEST * means.cell
    if not wrong.any():
        return ""
    row, column = np.unravel_index(int(np.argmax(above)), above.shape)
    x, y = means.nodes()[row, column].tolist()
    return (
        f"in {np.count_nonzero(wrong)} of {above.size} columns of {file.name} points are far above the mean height "
        f"that counts for the ground, by {above.max():.2f} m at x {x:.2f}, y {y:.2f}: of a wall, a machine or a tree "
        "only a part counts there. Leave out these points, and give what stands there in site.obstacles"
    )


def _means(
    points: Matrix, *, low: Sequence[float] | Vector | None, high: Sequence[float] | Vector | None, cell: float | None
) -> HeightGrid:
    """The mean heights of points on the wanted grid, by default from their least to their greatest x and y."""
    start = points[:, :2].min(axis=0) if low is None else low
    end = points[:, :2].max(axis=0) if high is None else high
    return column_means(points, empty_grid(start, end, CELL if cell is None else cell))


def survey_on(
    file: Path, onto: HeightGrid, *, low: Sequence[float] | Vector | None = None, cell: float | None = None,
    map_origin: Sequence[float] | Vector | None = None,
) -> HeightGrid:  # fmt: skip
    """The heights in a file at the nodes of a grid; NaN where the file does not reach.

    Parameters
    ----------
    low, cell: position and spacing of the heights, as in `Terrain.from_file`; points and a GeoTIFF need neither.
    map_origin: of points, as in `Terrain.from_file`.

    Raises
    ------
    InputError: as for `read_survey`.
    """
    if file.suffix.lower() in _POINTS:
        return column_means(read_points(file, map_origin=_origin(map_origin)), onto)
    return resampled(_read_table(file, low, cell, None, moved=True), onto)


def _origin(map_origin: Sequence[float] | Vector | None) -> tuple[float, ...]:
    """The point of a file's coordinates that is the origin of the site [m], checked."""
    return (0.0,) * 3 if map_origin is None else tuple(as_vector(map_origin, 3, key="map_origin").tolist())


def _read_table(
    file: Path, low: Sequence[float] | Vector | None, cell: float | None, map_origin: Sequence[float] | Vector | None,
    *, moved: bool,
) -> HeightGrid:  # fmt: skip
    """The heights in a file; `moved` puts their first height at `low`, whatever position the file gives."""
    table = read_height_grid(file)
    if map_origin is not None:
        x, y, z = _origin(map_origin)
        if table.low is None:
            raise InputError(
                "does not place its heights on a map", file=file, key="map_origin", found=f"{x:g}, {y:g}, {z:g}",
                hint="low is the place of its first height on the site",
            )  # fmt: skip
        table = table._replace(low=table.low - np.array([x, y]), heights=table.heights - z)
    start = None if low is None else as_vector(low, 2, key="low")
    if table.low is not None:
        grid = HeightGrid(table.low, as_cell(table.cell), table.heights)
        return grid if start is None or not moved else replace(grid, low=start)
    if start is None or cell is None:
        raise InputError(
            "does not say where its heights lie", file=file, key="low" if start is None else "cell",
            hint="give low, x and y of its first height, and cell, the distance between heights",
        )  # fmt: skip
    return HeightGrid(start, as_cell(cell), np.asarray(table.heights))
