"""The vertices of a PLY as points: whatever else the file has, and with messages that say what is wrong in it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.files.meshes.ply_faces import HEADER, ORDERS, Element, elements_of, equal_rows, unequal_rows

_AXES = "xyz"
_FORMATS = ("ascii", *ORDERS)
_SHOWN = 60  # characters of a wrong line in a message; chosen


def ply_points(path: Path) -> Matrix:
    """(n, 3) the vertices of a PLY, whether or not a face has them.

    Raises
    ------
    InputError: it is no PLY, is cut short or damaged, or its vertices have no x, y and z.
    OSError: the file cannot be read.
    """
    content = path.read_bytes()
    head, end, _ = content[:HEADER].partition(b"end_header")
    words = [line.split() for line in head.decode("latin-1").splitlines()]
    if not words or words[0] != ["ply"] or not end:
        found = "no line with ply" if not words or words[0] != ["ply"] else "no line with end_header"
        raise InputError("is not a PLY", file=path, key="header", found=found)
    kind = next((line[1] for line in words if line[:1] == ["format"] and len(line) > 1), "none")
    if kind not in _FORMATS:
        raise InputError("is not a PLY", file=path, key="format", found=kind, allowed=", ".join(_FORMATS))
    try:
        elements = elements_of(words)
    except (LookupError, ValueError) as error:
        raise InputError(f"is not a PLY: its header cannot be read ({error})", file=path, key="header") from error
    _check_axes(elements, path)
    begin = len(head) + len(end)
    if kind == "ascii":
        return _from_text(content[begin:], elements, len(head.splitlines()), path)
    try:
        return _from_bytes(content, elements, content.index(b"\n", begin) + 1, ORDERS[kind], path)
    except InputError:
        raise
    except (struct.error, LookupError, ValueError) as error:
        raise InputError("is a PLY that is cut short or damaged", file=path) from error


def _check_axes(elements: list[Element], path: Path) -> None:
    vertex = next((one for one in elements if one.name == "vertex"), None)
    if vertex is None:
        found = ", ".join(one.name for one in elements) or "no element"
        raise InputError("has no points", file=path, key="header", found=found, allowed="element vertex")
    single = [each.name for each in vertex.properties if not each.counted]
    if any(single.count(axis) != 1 for axis in _AXES):
        found = ", ".join(single) or "none"
        raise InputError(
            "does not name x, y and z once each", file=path, key="element vertex", found=found,
            allowed="properties x, y and z",
        )  # fmt: skip


def _from_text(body: bytes, elements: list[Element], first: int, path: Path) -> Matrix:
    """The points of a PLY in ASCII; `first` is how many lines precede `body`."""
    numbered = [(number, line) for number, line in enumerate(body.splitlines(), start=first + 1) if line.strip()]
    at = sum(one.rows for one in elements[: [one.name for one in elements].index("vertex")])
    vertex = next(one for one in elements if one.name == "vertex")
    lines = numbered[at : at + vertex.rows]
    if not lines:
        return np.zeros((0, 3))
    if not any(each.counted for each in vertex.properties):
        names = [each.name for each in vertex.properties]
        try:
            columns = [names.index(axis) for axis in _AXES]
            return np.loadtxt([line.decode("ascii") for _, line in lines], usecols=columns, comments=None, ndmin=2)
        except ValueError:
            pass  # the wrong line is looked for
    return np.array([_point_in(line, vertex, number, path) for number, line in lines])


def _point_in(line: bytes, vertex: Element, number: int, path: Path) -> list[float]:
    words, found = iter(line.split()), dict[str, float]()
    try:
        for each in vertex.properties:
            if each.counted:
                for _ in range(int(next(words))):
                    next(words)
            else:
                found[each.name] = float(next(words))
    except (ValueError, StopIteration):
        shown = line[:_SHOWN].decode("latin-1").strip()
        allowed = "numbers for " + ", ".join(each.name for each in vertex.properties)
        raise InputError("is no point", file=path, key=f"line {number}", found=shown, allowed=allowed) from None
    return [found[axis] for axis in _AXES]


def _from_bytes(content: bytes, elements: list[Element], at: int, order: str, path: Path) -> Matrix:
    points = np.zeros((0, 3))
    for element in elements:
        table, size = equal_rows(content, element, at, order)
        if table is None:
            columns, at = unequal_rows(content, element, at, order)
            table = columns  # type: ignore[assignment]
        else:
            at += size
        if element.name == "vertex" and element.rows:
            points = np.column_stack([np.asarray(table[axis], dtype=float) for axis in _AXES])  # type: ignore[index]
    if at != len(content):
        raise InputError("the file holds more than its header says", file=path, found=f"{len(content)} bytes, not {at}")
    return points
