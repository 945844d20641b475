"""The ground of a site from a file, resampled on the wanted grid, and what stands on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector, as_number, as_vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file
from backhoe_planner.job.ground.grids import (
    CELL,
    HeightGrid,
    as_cell,
    column_lowest,
    column_means,
    columns_of,
    empty_grid,
    filled_at,
    from_nearest,
    resampled,
    widened,
)
from backhoe_planner.job.ground.off_ground import (
    BEYOND,
    OffGround,
    below,
    describe,
    join_voxels,
    part_points,
    voxels_of,
)
from backhoe_planner.job.ground.raised import NOT_RAISED, raised_beyond
from backhoe_planner.site import HeightTable, is_cloud, read_height_grid, read_points

_SPARSE = 0.02  # part of the columns amid seen ground without a point from which a cloud is too sparse for its columns
# chosen: then an overhead line of 10 m has a wall of four columns below it


@dataclass(frozen=True, eq=False)
class Survey:
    """What a file says of the ground.

    Attributes
    ----------
    heights: of the ground; NaN where there is none.
    off_ground: what stands on it; None if nothing does, or for a table of heights.
    remark: what stands on it in words; empty if nothing does.
    beyond: the ground in the same columns and up to 10 m around them, with holes filled from the nearest column; None
        if the file goes no further.
    """

    heights: HeightGrid
    off_ground: OffGround | None = None
    remark: str = ""
    beyond: HeightGrid | None = None


def read_survey(
    file: Path, *, low: Sequence[float] | Vector | None, high: Sequence[float] | Vector | None, cell: float | None,
    map_origin: Sequence[float] | Vector | None, roughness: float,
) -> Survey:  # fmt: skip
    """The ground in a file, see `Terrain.from_file`.

    Raises
    ------
    InputError: the file is missing or malformed, or does not contain its position.
    """
    if is_cloud(file):
        ends = tuple(None if one is None else tuple(as_vector(one, 2, key=key).tolist())
                     for key, one in (("low", low), ("high", high)))  # fmt: skip
        origin, rough = _origin(map_origin), as_number(roughness, key="roughness", least=0.0)
        digest = sha256(file.read_bytes()).digest() if is_file(file) else b""  # reading tells what is wrong
        return _of_cloud(file, digest, ends, cell, origin, rough)
    moved = high is None and map_origin is None
    grid = _read_table(file, low, cell, map_origin, moved=moved)
    if high is None and (moved or low is None) and (cell is None or cell == grid.cell):
        return Survey(grid)
    start = grid.low if low is None else low
    step = CELL if cell is None else cell
    wanted = empty_grid(start, grid.high if high is None else high, step)
    heights = resampled(grid, wanted)
    if np.isnan(heights.z).all():
        raise _lies_elsewhere(grid, wanted, file, _origin(map_origin))
    wide = widened(wanted, grid.low, grid.high, BEYOND)[0]
    return Survey(heights, beyond=_further(resampled(grid, wide), wanted))


def _lies_elsewhere(grid: HeightGrid, wanted: HeightGrid, file: Path, origin: tuple[float, ...]) -> InputError:
    """The error about a table of heights, placed by its `origin` (3,), that covers nothing of the wanted ground."""
    (west, south), (east, north) = grid.low.tolist(), grid.high.tolist()
    lowest = float(np.min(grid.z, initial=np.inf, where=np.isfinite(grid.z)))
    middle = np.array([*0.5 * (grid.low + grid.high), lowest if math.isfinite(lowest) else 0.0]) + origin
    return InputError(
        "has no height on the ground that is modelled", file=file,
        found=f"heights from x {west:.10g}, y {south:.10g} to x {east:.10g}, y {north:.10g} m",
        allowed=f"heights between low {wanted.low.tolist()} and high {np.round(wanted.high, 6).tolist()}",
        hint="map_origin is the point of the file that is the site's origin: "
        f"`map_origin: {np.round(middle).astype(int).tolist()}` puts its middle there",
    )  # fmt: skip


@lru_cache(maxsize=2)
def _of_cloud(
    file: Path, _digest: bytes, ends: tuple[tuple[float, ...] | None, ...], cell: float | None,
    map_origin: tuple[float, ...], roughness: float,
) -> Survey:  # fmt: skip
    """The ground in a file of points with that digest; warnings, plan and page of a job ask for the same one."""
    points = read_points(file, map_origin=map_origin)
    low, high = ends
    start = points[:, :2].min(axis=0) if low is None else low
    end = points[:, :2].max(axis=0) if high is None else high
    grid = empty_grid(start, end, CELL if cell is None else cell)
    if not columns_of(points, grid)[0].any():
        (west, south, _), (east, north, _) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        raise InputError(
            "has no point on the ground that is modelled", file=file,
            found=f"points from x {west:g}, y {south:g} to x {east:g}, y {north:g} m",
            allowed=f"points between low {grid.low.tolist()} and high {np.round(grid.high, 6).tolist()}",
            hint="coordinates are metres, z is up, and map_origin is the point of the file that is the site's origin",
        )  # fmt: skip
    return split(points, grid, roughness)


def split(
    points: Matrix, grid: HeightGrid, roughness: float, known: Matrix | None = None, around: HeightGrid | None = None
) -> Survey:  # fmt: skip
    """Ground and what stands on it, from points (n, 3) [m]: the ground of a column is the mean of its ground
    points, and the lowest of them where something stands.

    Parameters
    ----------
    grid: the columns of the ground.
    roughness: height above the ground up to which a point belongs to it [m].
    known: (rows, columns) the ground at an earlier time [m]. Where things hide the ground it is taken as it was then,
        otherwise between the columns around them.
    around: the ground beyond it at that time; what is higher now stands there, see `raised_beyond`.
    """
    parted = part_points(points, grid, roughness, known)
    off, wide, part = parted.off, parted.ground, parted.part
    own = points[~(off | parted.stray)]
    means = column_means(own, wide).z
    # where there is a stray point alone, the ground is that around it
    means = np.where(np.isnan(means) & _columns_with(points[parted.stray], wide), wide.z, means)
    with_things = _columns_with(points[off], wide)
    beyond = _further(replace(wide, z=np.where(with_things | np.isnan(means), wide.z, means)), grid)
    heights = replace(grid, z=means[part])
    raised = NOT_RAISED if known is None else raised_beyond(replace(wide, z=means), part, known, around, roughness)
    if not off.any():
        return Survey(heights, raised.voxels, raised.remark, beyond)
    under, ground = with_things[part], wide.z[part]
    # the lower part of a wall counts as ground, but does not raise it, nor does a stray point below lower it
    lowest = column_lowest(own, grid)
    lowest = np.where(lowest < ground - roughness, ground, lowest)
    heights = replace(heights, z=np.where(under, lowest, heights.z))
    hidden = under & np.isnan(heights.z)
    missed = _missed(heights.z, under)
    there = filled_at(heights, hidden).z if known is None else known
    heights = replace(heights, z=np.where(hidden, there, heights.z))
    stands = voxels_of(np.vstack((points[off], below(points[off], heights, hidden))), grid.cell)
    remark = "; ".join(one for one in (describe(points[off], heights, stands), missed, raised.remark) if one)
    return Survey(heights, join_voxels(stands, raised.voxels), remark, beyond)


def _columns_with(points: Matrix, grid: HeightGrid) -> Flags:
    """(rows, columns) of a grid in which there is one of the points (n, 3) [m]."""
    return np.isin(np.arange(grid.z.size), columns_of(points, grid)[1]).reshape(grid.z.shape)


def _missed(z: Matrix, under: Flags) -> str:
    """In words, that the ground below what stands may only have been missed by a sparse cloud; empty if not.

    Parameters
    ----------
    z: (rows, columns) heights of the seen ground [m]; NaN where there is none.
    under: (rows, columns) where something stands or hangs.
    """
    from scipy.ndimage import uniform_filter

    seen = np.isfinite(z)
    amid = ~seen & (uniform_filter(seen.astype(float), size=3, mode="nearest") > 0.5)
    free, count = int(np.count_nonzero(~under & (amid | seen))), int(np.count_nonzero(amid & under))
    part = np.count_nonzero(amid & ~under) / max(free, 1)
    if not count or part < _SPARSE:
        return ""
    return (
        f"on {count} of these columns it counts as solid down to the ground, as no point of the ground was seen there, "
        f"though around it; {100.0 * part:.0f} % of the columns where nothing stands have none either: with a larger "
        "ground.cell fewer are missed"
    )


def _further(wide: HeightGrid, grid: HeightGrid) -> HeightGrid | None:
    """The heights on a wider grid, without holes; None if it is no wider than the grid, or nothing is known on it."""
    unknown = np.isnan(wide.z)
    if wide.z.shape == grid.z.shape or unknown.all():
        return None
    return replace(wide, z=from_nearest(wide.z, unknown))


def survey_on(
    file: Path, onto: HeightGrid, *, low: Sequence[float] | Vector | None, cell: float | None,
    map_origin: Sequence[float] | Vector | None, roughness: float, around: HeightGrid | None,
) -> Survey:  # fmt: skip
    """The ground in a file at the nodes of a grid of known heights; NaN where the file does not reach.

    Parameters
    ----------
    low, cell: position and spacing of the heights, as in `Terrain.from_file`; points and a GeoTIFF need neither.
    map_origin: of points and of a GeoTIFF, as in `Terrain.from_file`. Without it a GeoTIFF is at `low`.
    roughness: of points.
    around: the known ground beyond the grid; what is higher there by more than `roughness` is an obstacle.

    Raises
    ------
    InputError: as for `read_survey`.
    """
    rough = as_number(roughness, key="roughness", least=0.0)
    if is_cloud(file):
        return split(read_points(file, map_origin=_origin(map_origin)), onto, rough, onto.z, around)
    table = read_height_grid(file)
    origin = None if table.low is None else map_origin
    grid = _placed(table, file, low, cell, origin, moved=origin is None)
    wide, part = widened(onto, grid.low, grid.high, BEYOND)
    found = resampled(grid, wide)
    raised = raised_beyond(found, part, onto.z, around, rough)
    return Survey(replace(onto, z=found.z[part]), raised.voxels, raised.remark)


def _origin(map_origin: Sequence[float] | Vector | None) -> tuple[float, ...]:
    """The point of a file's coordinates that is the origin of the site [m], checked."""
    return (0.0,) * 3 if map_origin is None else tuple(as_vector(map_origin, 3, key="map_origin").tolist())


def _read_table(
    file: Path, low: Sequence[float] | Vector | None, cell: float | None, map_origin: Sequence[float] | Vector | None,
    *, moved: bool,
) -> HeightGrid:  # fmt: skip
    """The heights in a file; `moved` puts their first height at `low`, whatever position the file gives."""
    return _placed(read_height_grid(file), file, low, cell, map_origin, moved=moved)


def _placed(
    table: HeightTable, file: Path, low: Sequence[float] | Vector | None, cell: float | None,
    map_origin: Sequence[float] | Vector | None, *, moved: bool,
) -> HeightGrid:  # fmt: skip
    """The heights of a file where they belong on the site; see `_read_table`."""
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
