"""A path as a CSV file."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from backhoe_planner.errors import SceneError, nearest_name
from backhoe_planner.files.records import describe
from backhoe_planner.files.text_file import read_text
from backhoe_planner.site.schema.tasks import Waypoint
from backhoe_planner.site.surveys.number_tables import number_in

_POSITION, _QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
_COLUMNS = (*_POSITION, "pitch", *_QUATERNION)
_TIME = "time"
_UNIT = re.compile(r"(?:_(?:deg|rad)(?:rees|ians)?|\s*[\[(].*)$")
# other names for columns of orientations, in lower case, letters and digits only
_OTHER_ORIENTATIONS = {
    "roll", "pitch", "yaw", "q0", "q1", "q2", "q3",
    *(stem + axis for stem in ("q", "quat", "quaternion", "orientation", "rot", "r") for axis in "wxyz"),
}  # fmt: skip


@dataclass(frozen=True)
class PathFile:
    """The content of a path file.

    Attributes
    ----------
    waypoints: at least two.
    warnings: which of its columns are not used, in words.
    """

    waypoints: tuple[Waypoint, ...]
    warnings: tuple[str, ...]


def read_path_file(path: Path) -> PathFile:
    """The waypoints of a CSV with a header. Columns that are not used may hold anything.

    If the names in the header are separated by semicolons, a comma in a cell is a decimal point.

    Raises
    ------
    SceneError: no such file, no header, a missing column, an orientation in columns of other names, a cell
        that is not a finite number, a row that is no waypoint, fewer than two rows.
    """
    text = read_text(path, what="path", error=SceneError)
    between = ";" if ";" in text.lstrip().partition("\n")[0] else ","
    try:
        table = csv.reader(io.StringIO(text), delimiter=between)
        rows = [(f"line {number}", row) for number, row in enumerate(table, start=1)]
    except csv.Error as error:
        raise SceneError(f"cannot be read: {error}", file=path) from error
    rows = [(line, [cell.strip() for cell in row]) for line, row in rows if any(map(str.strip, row))]
    if not rows:
        raise SceneError("the file is empty", file=path, allowed="a path")
    (_, header), *rows = rows
    header = [name.lower() if name.lower() in _COLUMNS else name for name in header]
    if between == ";":
        rows = [(line, [cell.replace(",", ".") for cell in row]) for line, row in rows]
    turned = any(column in header for column in _QUATERNION)
    missing = [column for column in (*_POSITION, *(_QUATERNION if turned else ())) if column not in header]
    if missing:
        raise SceneError(f"a column is missing: {', '.join(missing)}", file=path, key="header", found=",".join(header))
    other = [name for name in header if name not in _COLUMNS and _plain(name) in _OTHER_ORIENTATIONS]
    if other:
        raise SceneError(
            "the orientation has columns of other names", file=path, key="header", found=", ".join(other),
            allowed=f"{', '.join(_QUATERNION)} for a whole orientation, pitch [rad] for that of the bucket alone",
        )  # fmt: skip
    twice = [column for column in _COLUMNS if header.count(column) > 1]
    if twice:
        raise SceneError("a column appears twice", file=path, key="header", found=", ".join(twice))
    if len(rows) < 2:
        raise SceneError("a path needs at least 2 waypoints", file=path, found=str(len(rows)))
    waypoints = tuple(_waypoint(path, line, header, row) for line, row in rows)
    return PathFile(waypoints, tuple(_not_used(column, path) for column in header if column not in _COLUMNS))


def _waypoint(path: Path, line: str, header: Sequence[str], row: Sequence[str]) -> Waypoint:
    """The waypoint of one row."""
    if len(row) != len(header):
        raise SceneError(f"has {len(row)} cells, the header {len(header)}", file=path, key=line)
    cells = zip(header, row, strict=True)
    values = {column: _number(cell, path, f"{line}, {column}") for column, cell in cells if column in _COLUMNS}
    quaternion = tuple(values[key] for key in _QUATERNION) if _QUATERNION[0] in values else None
    position = tuple(values[key] for key in _POSITION)
    try:
        return Waypoint.model_validate({"position": position, "pitch": values.get("pitch"), "quaternion": quaternion})
    except ValidationError as error:
        raise SceneError(describe(error.errors()[0]), file=path, key=line) from None


def _plain(column: str) -> str:
    """The name of a column in lower case, without unit and signs; of `pose.orientation.w` only `orientationw`."""
    parts = _UNIT.sub("", column.lower()).split(".")
    belongs = "orientation" if any("orientation" in part for part in parts[:-1]) else ""
    return "".join(filter(str.isalnum, belongs + parts[-1]))


def _not_used(column: str, path: Path) -> str:
    """A warning that a column is not used."""
    if column == _TIME:
        return f"{path}: the column {column} is not used: the scene's speed and the machine's limits time the motion"
    near = nearest_name(column, _COLUMNS)
    hint = f" (did you mean {near!r}?)" if near else ""
    return f"{path}: the column {column} is not used; columns that are: {', '.join(_COLUMNS)}{hint}"


def _number(cell: str, path: Path, key: str) -> float:
    try:
        value = number_in(cell)
    except ValueError:
        raise SceneError("is not a number", file=path, key=key, found=repr(cell)) from None
    if not math.isfinite(value):
        raise SceneError("is not finite", file=path, key=key, found=cell)
    return value
