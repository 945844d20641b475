"""Points as text: x, y, z of one point a line."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.files.obj_lines import obj_lines
from backhoe_planner.files.text_file import read_text
from backhoe_planner.site.schema.number_tables import (
    COMMENTS,
    are_missing,
    cells_of,
    counts_rows,
    number_in,
    plain_table,
)

POINT_FORMATS = "text with x, y, z in a line (CSV, XYZ), or .ply, .obj, .stl"

_MOST_COLUMNS = 32  # of a list of points: beside x, y, z scanners write colour, normal, time, ...; chosen
_TOO_FEW = ("has fewer cells than the header", "has fewer than three numbers")
# names of x, y and z in a header, without case and a unit of metres
_NAMES = (
    ("x", "east", "easting"),
    ("y", "north", "northing"),
    ("z", "h", "height", "elev", "elevation", "altitude"),
)
_METRES = re.compile(r"(?:_m|[\s_]*[\[(]\s*(?:m|met(?:re|er)s?)\s*[\])])$")  # "x [m]", "x (metres)", "x_m"
_BEFORE_UNIT = re.compile(r" +(?=[\[(])")
_OTHER_UNITS = re.compile(
    r"(?:^|[^a-z])(?:mm|cm|km|ft|feet|foot|inch(?:es)?|deg(?:rees)?|lat(?:itude)?|lon(?:gitude)?)(?:[^a-z]|$)"
)


def read_point_list(path: Path) -> Matrix:
    """(n, 3) points [m] from a text with x, y, z in the columns that its header names, otherwise in the first three.

    Raises
    ------
    InputError: missing, not text, a cell that is not a number, fewer than three in a line, a header that names only
        some of x, y, z or that names more than three columns but none of them, or a first column of point numbers
        without a header.
    """
    text = read_text(path, what="point cloud", formats=POINT_FORMATS)
    columns, lines, first = _begin(text.splitlines(), path)
    table = plain_table("\n".join(lines) if first else text)
    if table is None:
        table = _line_by_line(lines, first, columns, path)
    if table.shape[1] > _MOST_COLUMNS:
        raise InputError(
            "has too many numbers in a row for a list of points", file=path, found=table.shape[1],
            allowed=f"x, y, z and up to {_MOST_COLUMNS - 3} more", hint="heights on a grid are a heightmap",
        )  # fmt: skip
    if table.shape[1] <= max(columns or (2,)):
        raise InputError(_TOO_FEW[columns is None], file=path, key=f"line {first + 1}", found=lines[0].strip())
    if columns is None and table.shape[1] > 3 and counts_rows(table[:, 0]):
        raise InputError(
            "has numbers of points in its first column", file=path, key="column 1",
            found=", ".join(f"{number:g}" for number in table[:3, 0]) + ", ...",
            hint="name the columns in the first line: nr,x,y,z",
        )  # fmt: skip
    points = np.ascontiguousarray(table[:, list(columns or (0, 1, 2))])
    missing = are_missing(points[:, 2])
    if missing.any():
        point = int(np.argmax(missing))
        raise InputError(
            "a height is missing", file=path, key=f"point {point + 1}, z", found=f"{points[point, 2]:g}",
            hint="leave out the points without a height",
        )  # fmt: skip
    return points


def read_obj_vertices(path: Path) -> Matrix:
    """(n, 3) the vertices of an OBJ [m], whether or not a face has them.

    Raises
    ------
    InputError: missing, not text, or a vertex without three numbers.
    """
    points = []
    try:
        for number, words in obj_lines(path):
            if words[0] == b"v":
                try:
                    if b"_" in b"".join(words[1:4]):  # in Python a number may have underscores
                        raise ValueError
                    x, y, z = map(float, words[1:4])
                except ValueError:
                    found = b" ".join(words).decode(errors="replace")
                    raise InputError(
                        "is no vertex", file=path, key=f"line {number}", found=found, allowed="v X Y Z"
                    ) from None
                points.append((x, y, z))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from error
    return np.array(points, dtype=float).reshape(-1, 3)


def _begin(lines: Sequence[str], path: Path) -> tuple[tuple[int, ...] | None, Sequence[str], int]:
    """The columns of x, y, z that a header names, or None; the lines that follow; and how many lines precede them."""
    columns, first = None, 0
    while first < len(lines):
        line = lines[first].strip()
        words = line.lstrip("#/").strip()
        if not line.startswith(COMMENTS) and line and not (first == 0 and (_is_header(line) or _is_count(lines))):
            break
        columns = columns or _named(
            words, path, of=itertools.islice(lines, first + 1, None), is_header=line == words and not _is_count(lines)
        )
        first += 1
    return columns, lines[first:], first


def _named(words: str, path: Path, *, of: Iterable[str], is_header: bool) -> tuple[int, ...] | None:
    """Which columns of the lines `of` are x, y and z by the words above them; None if the words do not name them.

    Parameters
    ----------
    is_header: whether the words must be a header; otherwise they may be a comment.
    """
    cells = [cell.strip().strip('"').lower() for cell in cells_of(_BEFORE_UNIT.sub("", words))]
    cells = [_METRES.sub("", cell) for cell in cells]
    if is_header and any(_OTHER_UNITS.search(cell) for cell in cells):
        raise InputError("is not in metres", file=path, key="header", found=words[:60], allowed="x, y, z in metres")
    found = [[index for index, cell in enumerate(cells) if cell in names] for names in _NAMES]
    unknown = is_header and len(cells) > len(_NAMES)
    if not (any(found) or unknown):
        return None
    given = len(cells_of(next((line for line in of if line.strip() and not line.startswith(COMMENTS)), "")))
    if [len(each) for each in found] == [1, 1, 1]:
        columns = tuple(index for (index,) in found)
        if len(cells) != given > max(columns) and sorted(columns) != [0, 1, 2]:
            raise InputError(
                "the header has another number of columns than the lines", file=path, key="header", found=words[:60],
                allowed=f"{given} names", hint="names with blanks stand in quotes or between tabs",
            )  # fmt: skip
        return columns
    if len(cells) == given:
        raise InputError(
            "the header does not name x, y and z once each", file=path, key="header", found=words[:60],
            allowed="x, y, z; easting, northing, elevation; with others beside them",
        )  # fmt: skip
    return None


def _line_by_line(lines: Sequence[str], first: int, columns: tuple[int, ...] | None, path: Path) -> Matrix:
    """(rows, columns) numbers; columns that are not needed are 0, whatever they contain."""
    asked = columns or (0, 1, 2)
    rows, wider = [], True
    for number, line in enumerate(lines, start=first + 1):
        if not line.strip() or line.startswith(COMMENTS):
            continue
        words = [] if ";" in line or '"' in line else line.split()
        if len(words) > 1 and any("," in word[:-1] for word in words):
            hint = "semicolons between numbers with decimal commas, or decimal points"
            raise InputError("has commas and blanks", file=path, key=f"line {number}", found=line.strip(), hint=hint)
        cells = cells_of(line)
        if len(cells) <= max(asked):
            raise InputError(_TOO_FEW[columns is None], file=path, key=f"line {number}", found=line.strip())
        try:
            row = [number_in(cells[index]) for index in asked]
        except ValueError:
            full = all(cells[index].strip() for index in asked)
            raise InputError(
                "is not a number" if full else "has an empty cell among x, y, z",
                file=path, key=f"line {number}", found=line.strip(), allowed=POINT_FORMATS,
            ) from None  # fmt: skip
        rows.append(row)
        wider = wider and len(cells) > len(asked)
    found = np.zeros((len(rows), max(asked) + 1 + wider))
    found[:, list(asked)] = np.array(rows, dtype=float).reshape(-1, 3)
    return found


def _is_header(line: str) -> bool:
    """Whether no word of a line is a number."""
    for word in line.replace(";", " ").replace(",", " ").replace('"', " ").split():
        try:
            number_in(word)
        except ValueError:
            continue
        return False
    return True


def _is_count(lines: Sequence[str]) -> bool:
    """Whether the first line is the number of lines that follow, as in PTS files."""
    return lines[0].strip().isdecimal() and int(lines[0]) == sum(bool(line.strip()) for line in lines[1:])
