"""Files of a survey: heights on a grid, and the points of a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file
from backhoe_planner.files.text_file import read_text
from backhoe_planner.files.whole_mesh import check_whole
from backhoe_planner.site.schema.geotiff import HeightTable, read_geotiff
from backhoe_planner.site.schema.quantities import LARGEST

_FEWEST_POINTS = 9  # in a list of those at the nodes of a grid, 3 each way; chosen
_MOST_HOLES = 1.5  # nodes of its grid for each of them at most; chosen
_MOST_COLUMNS = 32  # of a list of points: what scanners write beside x, y, z are colour, normal, time, ...; chosen
_POINT_FORMATS = "text with x, y, z in a line (CSV, XYZ), or .ply, .obj, .stl"


def read_heights(path: Path) -> Matrix:
    """(rows, columns) heights [m] from a CSV without header, or from a GeoTIFF.

    Raises
    ------
    InputError: missing, empty, ragged, fewer than 2 x 2, or with a height that is missing, not finite or beyond
        `LARGEST`.
    """
    return _read_heights(path, holes=False).heights


def read_height_grid(path: Path) -> HeightTable:
    """The same, with where they lie if the file says so, and NaN where a height is missing.

    Raises
    ------
    InputError: as of `read_heights`, but not for a height that is missing.
    """
    return _read_heights(path, holes=True)


def _read_heights(path: Path, *, holes: bool) -> HeightTable:
    is_tiff = path.suffix.lower() in (".tif", ".tiff")
    found = read_geotiff(path) if is_tiff else HeightTable(_heights_from_text(path, holes=holes))
    if min(found.heights.shape) < 2:
        raise InputError("a height map needs at least 2 x 2 heights", file=path, found=str(found.heights.shape))
    if not is_tiff and _is_list_of_points(found.heights):
        rows, columns = found.heights.shape
        raise InputError(
            "holds x, y, z of points, not heights on a grid", file=path, found=f"{rows} rows of {columns}",
            allowed="one row for each y, with one height for each x", hint="as a pointcloud, or as a .xyz, it is read",
        )  # fmt: skip
    _check_size(found.heights, "a height", path, ("row", "column"), holes=holes)
    return found


def _heights_from_text(path: Path, *, holes: bool) -> Matrix:
    text = read_text(path, what="height map", formats="a CSV of heights, or a GeoTIFF (.tif, .tiff)")
    heights = _plain_table(text)
    if heights is not None and min(heights.shape) >= 2:
        return heights
    rows = [_cells(line) for line in text.splitlines() if line.strip()]
    # a comma at the end of every line ends the last cell; one at the end of some lines has a hole behind it
    ended = not holes or not any(row[-1].strip() for row in rows)
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


def _cells(line: str) -> list[str]:
    """The cells between semicolons, in which a comma is a decimal point, or else between commas."""
    return line.replace(",", ".").split(";") if ";" in line else line.split(",")


def _is_list_of_points(table: Matrix) -> bool:
    """Whether a narrow table is x, y, z, ... at the nodes of a grid: nearly every x stands beside every y, once."""
    if not 3 <= table.shape[1] <= _MOST_COLUMNS or len(table) < _FEWEST_POINTS or not np.isfinite(table).all():
        return False
    x, y = (np.unique(column) for column in table[:, :2].T)
    pairs = np.unique(table[:, :2], axis=0)
    return min(len(x), len(y)) > 1 and len(pairs) == len(table) and len(x) * len(y) <= _MOST_HOLES * len(table)


def _height(cell: str, path: Path, row: int, column: int, *, holes: bool) -> float:
    if holes and not cell.strip():
        return np.nan
    try:
        return _number(cell)
    except ValueError:
        key = f"row {row}, column {column}"
        hint = (
            "heights alone, without a header or quotes" if cell.strip() else "every cell has a height: fill holes first"
        )
        raise InputError("is not a number", file=path, key=key, found=cell.strip() or "nothing", hint=hint) from None


def read_points(path: Path) -> Matrix:
    """(n, 3) points [m] from a PLY, or from text with x, y, z in the first columns.

    Raises
    ------
    InputError: missing, empty, cut short, or with a coordinate that is not finite or beyond `LARGEST`.
    """
    if not is_file(path):
        raise InputError("no such point cloud file", file=path)
    if path.suffix.lower() in (".ply", ".obj", ".stl"):
        import trimesh

        try:
            check_whole(path)
            loaded = trimesh.load(path, process=False)
        except InputError:
            raise
        except Exception as error:  # trimesh raises whatever its format readers run into
            raise InputError(f"is not a file of points that can be read: {error}", file=path) from error
        points = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=float)
    else:
        points = _points_from_text(path)
    if len(points) == 0:
        raise InputError("holds no points", file=path)
    _check_size(points, "a coordinate", path, ("point", "coordinate"))
    return points


def _check_size(values: Matrix, what: str, path: Path, axes: tuple[str, str], *, holes: bool = False) -> None:
    """InputError that names the first of `values` (rows, columns) that is no number of metres on a site."""
    wrong = ~(np.abs(values) <= LARGEST)
    if holes:
        wrong &= ~np.isnan(values)
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        found = float(values[row, column])
        raise InputError(
            f"{what} is not finite" if not np.isfinite(found) else f"{what} is too large",
            file=path, key=f"{axes[0]} {row + 1}, {axes[1]} {column + 1}", found=f"{found:g}",
            allowed=f"{-LARGEST:g} to {LARGEST:g} m",
        )  # fmt: skip


def _plain_table(text: str) -> Matrix | None:
    """(rows, columns) of a text of nothing but numbers with commas, or with blanks, between them; None of any other.

    It takes a tenth of the time that is needed line by line, where messages say what is wrong with which.
    """
    first = text.lstrip().partition("\n")[0]
    comma = "," in first
    if comma and len(first.replace(",", " ").split()) != first.count(",") + 1:
        return None
    try:
        found = np.loadtxt(text.splitlines(), delimiter="," if comma else None, comments=None, ndmin=2)
    except ValueError:
        return None
    return found if found.size else None


def _points_from_text(path: Path) -> Matrix:
    text = read_text(path, what="point cloud", formats=_POINT_FORMATS)
    table = _plain_table(text)
    if table is not None and table.shape[1] > _MOST_COLUMNS:
        raise InputError(
            "has too many numbers in a row for a list of points", file=path, found=table.shape[1],
            allowed=f"x, y, z and up to {_MOST_COLUMNS - 3} more", hint="heights on a grid are a heightmap",
        )  # fmt: skip
    if table is not None and table.shape[1] >= 3:
        return np.ascontiguousarray(table[:, :3])
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#") or (number == 1 and _is_header(line)):
            continue
        words = [] if ";" in line else line.split()
        if len(words) > 1 and any("," in word[:-1] for word in words):
            hint = "a comma stands between numbers, not in them"
            raise InputError("has commas and blanks", file=path, key=f"line {number}", found=line.strip(), hint=hint)
        cells = _cells(line) if ";" in line or "," in line else words
        try:
            rows.append([_number(cell) for cell in cells[:3]])
        except ValueError:
            raise InputError(
                "is not a number" if all(cell.strip() for cell in cells[:3]) else "has an empty cell among x, y, z",
                file=path, key=f"line {number}", found=line.strip(), allowed=_POINT_FORMATS,
            ) from None  # fmt: skip
        if len(rows[-1]) < 3:
            raise InputError("has fewer than three numbers", file=path, key=f"line {number}", found=line.strip())
    return np.array(rows, dtype=float).reshape(-1, 3)


def _is_header(line: str) -> bool:
    """Whether no word of a line is a number."""
    for word in line.replace(";", " ").replace(",", " ").split():
        try:
            _number(word)
        except ValueError:
            continue
        return False
    return True


def _number(cell: str) -> float:
    """The number in a cell; unlike Python's own, it has no underscores and no digits of other scripts."""
    if "_" in cell or not cell.isascii():
        raise ValueError
    return float(cell)
