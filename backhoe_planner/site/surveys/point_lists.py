"""Points as text: x, y, z of one point a line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.files.meshes.obj_lines import obj_lines
from backhoe_planner.files.text_file import read_text
from backhoe_planner.site.surveys.number_tables import (
    COMMENTS,
    are_missing,
    cells_of,
    columns_of,
    counts_rows,
    delimiter_of,
    is_number,
    number_in,
)

MOST_COLUMNS = 32  # of a list of points: beside x, y, z scanners write colour, normal, time, ...; chosen
_TOO_FEW = ("has fewer cells than the header", "has fewer than three numbers")
# names of x, y and z in a header, without case and a unit of metres
_HEIGHTS = (
    "z", "h", "height", "elev", "elevation", "altitude", "alt", "up", "höhe", "hoehe", "altitud", "cota", "quota",
)  # fmt: skip
_NAMES = (
    (("x",), ("y",), _HEIGHTS),
    (
        ("e", "east", "easting", "ost", "ostwert", "rechtswert", "est", "este"),
        ("n", "north", "northing", "nord", "nordwert", "hochwert", "norte"),
        _HEIGHTS,
    ),
)
_METRES = re.compile(r"(?:_m|[\s_]*[\[(]\s*(?:m|met(?:re|er)s?)\s*[\])])$")  # "x [m]", "x (metres)", "x_m"
_ANY_UNIT = re.compile(r"[\s_]*[\[(].*[\])]$|_[a-z]+$")
_BEFORE_UNIT = re.compile(r" +(?=[\[(])")
_OTHER_UNITS = re.compile(
    r"(?:^|[^a-z])(?:mm|cm|km|ft|feet|foot|inch(?:es)?|deg(?:rees)?|lat(?:itude)?|lon(?:gitude)?)(?:[^a-z]|$)"
)
_BARE_UNIT = re.compile(r"[\[(]?(?:mm|cm|km|ft|feet|foot|inch(?:es)?)[\])]?")  # of the numbers before it
_UNITS = re.compile(r"[\[(]?(?:m|met(?:re|er)s?|-|)[\])]?")  # a cell of a line of units
_UNIT_IN_COMMENT = re.compile(r"\bunits?\b")
_WORDS = re.compile(r"[^\W\d_]+")
_TELLING = {"unit", "units", *_NAMES[0][0], *_NAMES[1][0]}  # other comments are no header and say no unit
_LIKE_A_NUMBER = tuple("0123456789+-.")


class _Head(NamedTuple):
    """What precedes the points.

    Attributes
    ----------
    columns: of x, y and z, if a header names them.
    names: how many columns the header names; 0 without a header.
    lines: how many lines precede the first point.
    """

    columns: tuple[int, ...] | None
    names: int
    lines: int


def read_point_list(path: Path, *, formats: str) -> Matrix:
    """(n, 3) points [m] from a text with x, y, z in the columns that its header names, otherwise in the first three.

    Titles, comments, a line of units and the number of points may precede the points.

    Parameters
    ----------
    formats: all formats of points, in words, for the message if the file is no text.

    Raises
    ------
    InputError: missing, not text, a cell that is not a number, fewer than three in a line, a header that does not
        name x, y and z once each, another unit than metres, lines with different numbers of cells, or, without a
        header, point numbers or decimal commas.
    """
    all_lines = read_text(path, what="point cloud", formats=formats).splitlines()
    if all_lines[0].lower().startswith("ncols"):
        raise InputError(
            "is an ESRI grid of heights, not a list of points", file=path, key="line 1", found=all_lines[0].strip(),
            hint="make a heightmap of it: gdal_translate ground.asc ground.tif",
        )  # fmt: skip
    head = _read_head(all_lines, path)
    lines = [line for line in all_lines[head.lines :] if line.strip() and not line.startswith(COMMENTS)]
    if not lines:
        return np.zeros((0, 3))
    mark, width = delimiter_of(lines[0]), len(cells_of(lines[0]))
    if width > MOST_COLUMNS:
        raise InputError(
            "has too many numbers in a row for a list of points", file=path, found=width,
            allowed=f"x, y, z and up to {MOST_COLUMNS - 3} more", hint="heights on a grid are a heightmap",
        )  # fmt: skip
    if (
        head.columns is None
        and mark == ","
        and width >= 6
        and width % 2 == 0
        and not any("." in line for line in lines)
    ):
        raise InputError(
            "may have decimal commas between commas", file=path, found=lines[0].strip(),
            hint="decimal points, or semicolons between the numbers; or name the columns in the first line",
        )  # fmt: skip
    asked = head.columns or (0, 1, 2)
    points = columns_of(lines, asked)
    if points is None:
        points = _line_by_line(all_lines, head, path, formats)
    elif mark == "," and 0 < head.names != width:
        raise _other_width(path, lines[0], head.names)
    if head.columns is None and width > 3 and counts_rows(points[:, 0]):
        raise InputError(
            "has numbers of points in its first column", file=path, key="column 1",
            found=", ".join(f"{number:g}" for number in points[:3, 0]) + ", ...",
            hint="name the columns in the first line: nr,x,y,z",
        )  # fmt: skip
    missing = are_missing(points[:, 2])
    if missing.any():
        point = int(np.argmax(missing))
        raise InputError(
            "a height is missing", file=path, key=f"point {point + 1}, z", found=f"{points[point, 2]:g}",
            hint="leave out the points without a height",
        )  # fmt: skip
    return np.ascontiguousarray(points)


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


def _read_head(lines: Sequence[str], path: Path) -> _Head:
    """What precedes the points: titles, comments, a header, a line of units, the number of points."""
    point = next((at for at, line in enumerate(lines) if _is_point(line.strip())), len(lines))
    row = lines[point] if point < len(lines) else ""
    mark, width = delimiter_of(row), len(cells_of(row))
    header: _HeadLine | None = None  # a comment that names x, y and z is replaced by a line that is no comment
    unclear: _HeadLine | None = None  # it may be a header, but does not name x, y and z
    first = point
    for at, whole in enumerate(lines[:point]):
        if whole.strip().isdecimal():
            _check_count(lines, at, path)
            continue
        line = _HeadLine.of(whole)
        if line is None:
            continue
        if line.has_other_units(width):
            raise InputError(
                "is not in metres", file=path, key="header", found=line.words[:60], allowed="x, y, z in metres"
            )
        if header is not None and not header.is_comment and not line.is_comment:
            if not line.gives_units:
                first = at
                break
        elif line.columns is not None and (header is None or not line.is_comment):
            if len(line.cells) != width > max(line.columns) and sorted(line.columns) != [0, 1, 2]:
                hint = "names with blanks stand in quotes or between tabs"
                raise InputError(
                    "the header has another number of columns than the lines", file=path, key="header",
                    found=line.words[:60], allowed=f"{width} names", hint=hint,
                )  # fmt: skip
            header = line
        elif header is None and line.names_some and len(line.cells) == width:
            unclear = line
        elif line.is_like_a_row(mark, width):
            if any(map(is_number, line.cells)):  # a wrong line of points
                first = at
                break
            unclear = line
    else:
        if header is None and unclear is not None:
            raise InputError(
                "the header does not name x, y and z once each", file=path, key="header", found=unclear.words[:60],
                allowed="x, y, z; easting, northing, elevation; with others beside them",
                hint="a title begins with #",
            )  # fmt: skip
    return _Head(None, 0, first) if header is None else _Head(header.columns, len(header.cells), first)


@dataclass(frozen=True)
class _HeadLine:
    """A line before the points that may be a header, or say in which unit the points are.

    Attributes
    ----------
    words: the line without the sign of a comment.
    cells: its cells in lower case, without units of metres.
    columns: of x, y and z, if it names each of them once.
    names_some: whether it names any of them.
    """

    words: str
    cells: list[str]
    is_comment: bool
    columns: tuple[int, ...] | None
    names_some: bool

    @classmethod
    def of(cls, whole: str) -> _HeadLine | None:
        """None for a blank line, and for a comment that does not mention coordinates or units."""
        line = whole.strip()
        words, is_comment = line.lstrip("#/").strip(), line.startswith(COMMENTS)
        if not words or (is_comment and _TELLING.isdisjoint(_WORDS.findall(words.lower()))):
            return None
        cells = _names_in(words)
        found = _columns_in(cells)
        named = (tuple(one[0] for one in each) for each in found if all(len(one) == 1 for one in each))
        return cls(words, cells, is_comment, next(named, None), any(map(any, found)))

    @property
    def gives_units(self) -> bool:
        """Whether every cell is a unit of metres, or empty."""
        return all(map(_UNITS.fullmatch, cells_of(self.words.lower())))

    def has_other_units(self, width: int) -> bool:
        """Whether it says that x, y and z of rows with `width` cells are not in metres."""
        if not any(map(_OTHER_UNITS.search, self.cells)):
            return False
        if self.columns is not None and len(self.cells) == width and not any(map(_BARE_UNIT.fullmatch, self.cells)):
            return False  # columns beside x, y, z may have other units: a range in mm, a latitude
        if not self.is_comment or _UNIT_IN_COMMENT.search(self.words.lower()):
            return True
        return any(map(any, _columns_in([_ANY_UNIT.sub("", cell) for cell in self.cells])))

    def is_like_a_row(self, mark: str | None, width: int) -> bool:
        """Whether it is no title, which has blanks where the points have a `mark`, or another number of words."""
        if self.is_comment or delimiter_of(self.words) != mark:
            return False
        return len(self.cells) == width or (bool(mark) and len(self.cells) > 2)


def _is_point(line: str) -> bool:
    """Whether a line is one of points: no comment or number of points, and no title, which begins with a word."""
    if not line or line.startswith(COMMENTS) or line.isdecimal():
        return False
    cells = cells_of(line)
    return not cells[0] or cells[0].startswith(_LIKE_A_NUMBER) or sum(map(is_number, cells)) >= len(_NAMES[0])


def _names_in(words: str) -> list[str]:
    """The cells of a header, in lower case, without units of metres."""
    cells = [cell.strip().strip('"').lower() for cell in cells_of(_BEFORE_UNIT.sub("", words))]
    return [_METRES.sub("", cell) for cell in cells]


def _columns_in(cells: Sequence[str]) -> list[list[list[int]]]:
    """For each way to name them, the columns that are named x, those named y and those named z."""
    return [[[at for at, cell in enumerate(cells) if cell in names] for names in way] for way in _NAMES]


def _check_count(lines: Sequence[str], at: int, path: Path) -> None:
    """Check a line with the number of points that follow, as in PTS files and those of CloudCompare."""
    follow = sum(1 for line in lines[at + 1 :] if line.strip() and not line.startswith(COMMENTS))
    if follow != int(lines[at]):
        raise InputError(
            _TOO_FEW[1], file=path, key=f"line {at + 1}", found=lines[at].strip(),
            allowed=f"three numbers, or how many points follow, {follow}",
        )  # fmt: skip


def _other_width(path: Path, line: str, names: int) -> InputError:
    return InputError(
        "has another number of cells than the header or the first line", file=path, found=line.strip(),
        allowed=f"{names} cells", hint="no decimal commas; texts with commas stand in quotes",
    )  # fmt: skip


def _line_by_line(lines: Sequence[str], head: _Head, path: Path, formats: str) -> Matrix:
    """(rows, 3) points of lines that `columns_of` does not read.

    Raises
    ------
    InputError: names the first line that is wrong.
    """
    asked, rows, width = head.columns or (0, 1, 2), [], head.names
    for number, line in enumerate(lines[head.lines :], start=head.lines + 1):
        if not line.strip() or line.startswith(COMMENTS):
            continue
        words = [] if ";" in line or '"' in line else line.split()
        if len(words) > 1 and any("," in word[:-1] for word in words):
            hint = "semicolons between numbers with decimal commas, or decimal points"
            raise InputError("has commas and blanks", file=path, key=f"line {number}", found=line.strip(), hint=hint)
        cells = cells_of(line)
        if len(cells) <= max(asked):
            raise InputError(_TOO_FEW[head.columns is None], file=path, key=f"line {number}", found=line.strip())
        try:
            row = [number_in(cells[index]) for index in asked]
        except ValueError:
            full = all(cells[index].strip() for index in asked)
            raise InputError(
                "is not a number" if full else "has an empty cell among x, y, z",
                file=path, key=f"line {number}", found=line.strip(), allowed=formats,
            ) from None  # fmt: skip
        width = width or len(cells)
        if delimiter_of(line) == "," and len(cells) != width:
            raise _other_width(path, f"line {number}: {line.strip()}", width)
        rows.append(row)
    return np.array(rows, dtype=float).reshape(-1, 3)
