"""Files of a survey: heights on a grid, and the points of a scan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file
from backhoe_planner.files.meshes.ply_points import ply_points
from backhoe_planner.files.meshes.whole_mesh import check_whole, has_single_precision
from backhoe_planner.files.numbers import FURTHEST, LARGEST
from backhoe_planner.files.text_file import read_text
from backhoe_planner.site.surveys.geotiff import HeightTable, read_geotiff
from backhoe_planner.site.surveys.number_tables import (
    COMMENTS,
    are_missing,
    cells_of,
    counts_rows,
    number_in,
    plain_table,
)
from backhoe_planner.site.surveys.packed_scans import read_e57
from backhoe_planner.site.surveys.point_lists import MOST_COLUMNS, read_obj_vertices, read_point_list
from backhoe_planner.site.surveys.scan_files import pcd_has_single_precision, read_las, read_pcd
from backhoe_planner.site.surveys.single_precision import rounded_error, rounding_of

_FEWEST = 2  # heights along x and along y, so that there is ground between them
_FEWEST_POINTS = 9  # in a list of points at the nodes of a grid, 3 each way; chosen
_MOST_HOLES = 1.5  # the most nodes of a grid for each point in its list; chosen
_ROUNDING = 1e-6  # of a cell
_OTHER_CLOUDS = (".rcp", ".rcs", ".fls")
_POINT_TEXTS = (".xyz", ".txt", ".pts")  # endings of text that is always a list of points
_MESHES = (".off", ".dae", ".glb", ".gltf", ".3mf")
_DEGREES_WITHIN = 0.05  # degrees: some kilometres; chosen
_MOST_STRAYS = 0.01  # part of the points that may be far away by mistake; chosen
_STEEPEST = 500.0  # times as high as wide: points in metres are not; chosen, flat ground in degrees is steeper


def read_heights(path: Path, *, size: tuple[float, float] | None = None) -> Matrix:
    """(rows, columns) heights [m] from a CSV without header, or from a GeoTIFF.

    Parameters
    ----------
    size: from the first to the last height along x and y [m], if known; a GeoTIFF that places its
        heights is checked against it, to within a cell, since some sizes count whole cells.

    Raises
    ------
    InputError: missing, empty, ragged, fewer than 2 x 2, or with a height that is missing, not finite or beyond
        `LARGEST`; a GeoTIFF of another size.
    """
    found = _read_heights(path, holes=False)
    if size is not None and found.cell > 0.0:
        own = found.cell * (np.array(found.heights.shape[::-1]) - 1.0)
        if (np.abs(own - size) > (1.0 + _ROUNDING) * found.cell).any():
            raise InputError(
                "is of another size than the scene says", file=path, key="size", found=f"[{size[0]:g}, {size[1]:g}]",
                allowed=f"[{own[0]:g}, {own[1]:g}], along x and y",
            )  # fmt: skip
    return found.heights


def read_height_grid(path: Path, *, fewest: int = _FEWEST) -> HeightTable:
    """The heights as in `read_heights`, with their location if the file has one, and NaN where one is missing.

    Parameters
    ----------
    fewest: the least number of rows and of columns.

    Raises
    ------
    InputError: as `read_heights`, but not for a missing height.
    """
    return _read_heights(path, holes=True, fewest=fewest)


def _read_heights(path: Path, *, holes: bool, fewest: int = _FEWEST) -> HeightTable:
    is_tiff = path.suffix.lower() in (".tif", ".tiff")
    found = read_geotiff(path) if is_tiff else HeightTable(_heights_from_text(path, holes=holes))
    if min(found.heights.shape) < fewest:
        raise InputError(
            f"a height map needs at least {fewest} x {fewest} heights", file=path, found=str(found.heights.shape)
        )
    if not is_tiff and _is_list_of_points(found.heights):
        rows, columns = found.heights.shape
        raise InputError(
            "holds x, y, z of points, not heights on a grid", file=path, found=f"{rows} rows of {columns}",
            allowed="one row for each y, with one height for each x", hint="as a pointcloud, or as a .xyz, it is read",
        )  # fmt: skip
    found = found._replace(heights=np.where(are_missing(found.heights), np.nan, found.heights))
    _check_size(found.heights, "a height", path, ("row", "column"), holes=holes)
    return found


def _heights_from_text(path: Path, *, holes: bool) -> Matrix:
    text = read_text(path, what="height map", formats="a CSV of heights, or a GeoTIFF (.tif, .tiff)")
    heights = plain_table(text)
    if heights is not None and min(heights.shape) >= _FEWEST:
        return heights
    rows = [cells_of(line) for line in text.splitlines() if line.strip() and not line.startswith(COMMENTS)]
    # a comma at the end of every line ends the last cell; at the end of only some lines, it precedes a hole
    ended = not any(row[-1].strip() for row in rows)
    values = [
        [
            _height(cell, path, number, column, holes=holes)
            for column, cell in enumerate(row[:-1] if ended and not row[-1].strip() else row, start=1)
        ]
        for number, row in enumerate(rows, start=1)
    ]
    widths = {len(row) for row in values}
    if len(widths) != 1:
        raise InputError("the rows have different lengths", file=path, found=sorted(widths))
    return np.array(values)


def _is_list_of_points(table: Matrix) -> bool:
    """Whether a narrow table is x, y, z, ... at the nodes of a grid, numbered or not.

    In such a table nearly every x is paired with every y once.
    """
    if table.shape[1] > 3 and counts_rows(table[:, 0]):
        return _is_list_of_points(table[:, 1:])
    if not 3 <= table.shape[1] <= MOST_COLUMNS or len(table) < _FEWEST_POINTS or not np.isfinite(table).all():
        return False
    x, y = (np.unique(column) for column in table[:, :2].T)
    pairs = np.unique(table[:, :2], axis=0)
    return min(len(x), len(y)) > 1 and len(pairs) == len(table) and len(x) * len(y) <= _MOST_HOLES * len(table)


def _height(cell: str, path: Path, row: int, column: int, *, holes: bool) -> float:
    if holes and not cell.strip():
        return np.nan
    try:
        return number_in(cell)
    except ValueError:
        key = f"row {row}, column {column}"
        hint = "heights alone, without a header" if cell.strip() else "every cell has a height: fill holes first"
        if cell.lower().startswith("ncols"):
            hint = "of an ESRI grid make a GeoTIFF: gdal_translate ground.asc ground.tif"
        raise InputError("is not a number", file=path, key=key, found=cell.strip() or "nothing", hint=hint) from None


def read_points(path: Path, *, map_origin: Sequence[float] | None = None) -> Matrix:
    """(n, 3) points [m] from a PLY, PCD, LAS, LAZ, E57, OBJ or STL, or from text; see `read_point_list`.

    Parameters
    ----------
    map_origin: (3,) is subtracted from the points in the file [m]; None if there is no such key to set.

    Raises
    ------
    InputError: missing, empty, cut short, or with a coordinate that is not finite or, after that, beyond `LARGEST`;
        or of 32 bits so far from 0 that it is rounded to more than 1 cm.
    """
    if not is_file(path):
        raise InputError("no such point cloud file", file=path)
    if path.stat().st_size == 0:
        raise InputError("the file is empty", file=path, allowed="a point cloud")
    kind, formats = path.suffix.lower(), f"text with x, y, z in a line (CSV, XYZ), or {', '.join(_READERS)}"
    if kind in (*_OTHER_CLOUDS, *_MESHES):
        hint = "CloudCompare makes a PLY of it, or it is a mesh" if kind in _MESHES else (
            "CloudCompare, or the program of the scanner, makes an E57 or LAZ of it"
        )  # fmt: skip
        raise InputError(f"is a {kind} file, which is not read", file=path, allowed=formats, hint=hint)
    points = _READERS[kind](path) if kind in _READERS else read_point_list(path, formats=formats)
    if len(points) == 0:
        raise InputError("holds no points", file=path)
    _check_not_degrees(points, path)
    check_near(points, path, map_origin=map_origin)
    return points if map_origin is None else points - np.array(map_origin)


def _read_ply(path: Path) -> Matrix:
    check_whole(path)
    return ply_points(path)


def _read_stl(path: Path) -> Matrix:
    import trimesh

    try:
        check_whole(path)
        loaded = trimesh.load(path, file_type="stl", process=False)
    except InputError:
        raise
    except Exception as error:  # trimesh passes on any exception of its format readers
        raise InputError(f"is not a file of points that can be read: {error}", file=path) from error
    parts = getattr(loaded, "geometry", {"": loaded}).values()  # a file of several solids is a scene of them
    return np.vstack([np.zeros((0, 3)), *(part.vertices for part in parts if hasattr(part, "vertices"))])


# by the ending of the file's name; a file with any other ending is read as text
_READERS: dict[str, Callable[[Path], Matrix]] = {
    ".ply": _read_ply, ".pcd": read_pcd, ".las": read_las, ".laz": read_las, ".e57": read_e57,
    ".obj": read_obj_vertices, ".stl": _read_stl,
}  # fmt: skip


def is_cloud(file: Path) -> bool:
    """Whether a file has points, by the ending of its name; a CSV, which may have them, is a table of heights here."""
    return file.suffix.lower() in (*_READERS, *_POINT_TEXTS)


def _check_not_degrees(points: Matrix, path: Path) -> None:
    """Raise an InputError if points (n, 3) are all at one place but at many heights, like longitude and latitude."""
    if len(points) < _FEWEST_POINTS or not (np.abs(points[:, :2]) <= (180.0, 180.0)).all():
        return
    wide, high = np.ptp(points[:, :2], axis=0), float(np.ptp(points[:, 2]))
    if wide.min() > 0.0 and wide.max() < _DEGREES_WITHIN and high > _STEEPEST * wide.max():
        found = f"{wide[0]:.2g} along x, {wide[1]:.2g} along y and {high:.2g} along z, at {points[0, 0]:.6g}, "
        raise InputError(
            "looks like degrees", file=path, found=f"{found}{points[0, 1]:.6g}", allowed="x, y, z in metres",
            hint="project it, such as to UTM",
        )  # fmt: skip


def check_near(
    points: Matrix, path: Path, *, map_origin: Sequence[float] | None, scale: Vector | float = 1.0,
    turn: Matrix | None = None, what: str = "point",
) -> None:  # fmt: skip
    """Check that points (n, 3) of a file lie on the site once `map_origin` (3,) is subtracted; see `read_points`.

    Parameters
    ----------
    scale: from the file's units to metres; that of each axis (3,), or of all.
    turn: (3, 3) the rotation that turns the points upright; None if they are.

    Raises
    ------
    InputError: they do not, or a coordinate is not finite, or of 32 bits and rounded to more than 1 cm.
    """
    origin = np.zeros(3) if map_origin is None else np.array(map_origin)
    placed = (points - origin) * scale
    largest = float(np.max(np.abs(points), initial=0.0))
    far = f"its numbers go up to {largest:,.0f}, which no map in metres has: they may be feet or millimetres"
    if largest <= FURTHEST:
        turn = np.eye(3) if turn is None else turn
        stood = points @ turn.T
        low, high = stood.min(axis=0), stood.max(axis=0)
        middle = np.round(turn.T @ [*(low + high)[:2] / 2.0, low[2]]).astype(int).tolist()
        do = f"subtract {middle} from all points" if map_origin is None else f"`map_origin: {middle}`"
        far = f"map coordinates are too large: {do} puts the middle of the survey at 0, 0, or take the machine's place"
        rounding = rounding_of(points, scale)
        is_single = pcd_has_single_precision if path.suffix.lower() == ".pcd" else has_single_precision
        if map_origin is not None and rounding > 0.0 and is_single(path):
            raise rounded_error(points, rounding, path)
    away = int(np.count_nonzero((np.abs(placed) > LARGEST).any(axis=1)))
    if 0 < away <= _MOST_STRAYS * len(points):
        those = f"it and {away - 1:,} others" if away > 1 else "it"
        far = f"the other {len(points) - away:,} are near: leave {those} out"
    less = f" less map_origin {origin.tolist()}" if origin.any() else ""
    _check_size(placed, f"a coordinate{less}", path, (what, "coordinate"), far=far)


def _check_size(
    values: Matrix, what: str, path: Path, axes: tuple[str, str], *, holes: bool = False, far: str | None = None
) -> None:
    """Raise an InputError that names the first of `values` (rows, columns) that is no number of metres on a site.

    `far` is what to do about values that are too large.
    """
    wrong = ~(np.abs(values) <= LARGEST)
    if holes:
        wrong &= ~np.isnan(values)
    if not wrong.any():
        return
    row, column = np.argwhere(wrong)[0].tolist()
    value, hint = float(values[row, column]), None
    found = f"{value:g}"
    if np.isnan(value):
        found = "none, or a figure that stands for one, such as -9999"
        problem, hint = f"{what} is missing", "fill it first, or leave out that part of the survey"
    elif np.isinf(value):
        problem = f"{what} is not finite"
    else:
        problem, hint = f"{what} is too large", far
    raise InputError(
        problem, file=path, key=f"{axes[0]} {row + 1}, {axes[1]} {column + 1}", found=found,
        allowed=f"{-LARGEST:g} to {LARGEST:g} m", hint=hint,
    )  # fmt: skip
