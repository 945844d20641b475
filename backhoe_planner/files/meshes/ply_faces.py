"""Binary PLY files with faces of different numbers of corners, rewritten with triangles.

trimesh takes the first face's number of corners for that of all. It refuses a file whose size does not fit that,
and reads other faces than are meant where it fits, as with faces of 4, 3 and 5 corners.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
HEADER = 1_000_000  # bytes in which the header ends
_CORNERS = ("vertex_indices", "vertex_index")  # names of a face's list of vertices
_TRIANGLES = """ply
format binary_little_endian 1.0
element vertex {}
property double x
property double y
property double z
element face {}
property list uchar int vertex_indices
end_header
"""


class Property(NamedTuple):
    """A number of each row of an element, or a list of numbers."""

    name: str
    kind: str  # of numpy
    counted: str = ""  # the kind of a list's length; "" for a single number


class Element(NamedTuple):
    """What the header says of an element."""

    name: str
    rows: int
    properties: list[Property]


def ply_of_triangles(path: Path) -> BinaryIO | None:
    """The vertices and triangles of a binary PLY, as a file for trimesh; None if trimesh reads the file itself.

    A face of more corners becomes a fan of triangles around its first one, as trimesh makes it of other formats.

    Raises
    ------
    InputError: the PLY is cut short or damaged, or a face has fewer than three corners or one that is not there.
    OSError: the file cannot be read.
    """
    if path.suffix.lower() != ".ply":
        return None
    try:
        found = _with_equal_faces(path.read_bytes(), path)
    except InputError:
        raise
    except (struct.error, LookupError, ValueError) as error:
        raise InputError("is a PLY that is cut short or damaged", file=path) from error
    return None if found is None else io.BytesIO(found)


def _with_equal_faces(content: bytes, path: Path) -> bytes | None:
    head, end, _ = content[:HEADER].partition(b"end_header")
    words = [line.split() for line in head.decode("latin-1").splitlines()]
    order = next((ORDERS.get(line[1], "") for line in words if line[:1] == ["format"] and len(line) > 1), "")
    if not end or not order:
        return None
    at, columns, are_equal = content.index(b"\n", len(head)) + 1, dict[str, dict[str, Any]](), True
    for element in elements_of(words):
        table, size = equal_rows(content, element, at, order)
        if table is None:
            are_equal = False
            columns[element.name], at = unequal_rows(content, element, at, order)
        else:
            columns[element.name], at = {name: table[name] for name in table.dtype.names or ()}, at + size
    if are_equal:
        return None
    if at != len(content):
        raise InputError("the file holds more than its header says", file=path, found=f"{len(content)} bytes, not {at}")
    vertices = np.column_stack([columns["vertex"][axis] for axis in "xyz"]).astype("<f8")
    face = columns.get("face", {})
    corners = face.get(_CORNERS[0], face.get(_CORNERS[1], ()))
    for number, own in enumerate(corners, start=1):
        if len(own) < 3 or min(own) < 0 or max(own) >= len(vertices):
            allowed = f"three corners or more, from 0 to {len(vertices) - 1}"
            found = str(tuple(own)) if len(own) else "none"
            raise InputError("is not a face", file=path, key=f"face {number}", found=found, allowed=allowed)
    triangles = [(own[0], own[k], own[k + 1]) for own in corners for k in range(1, len(own) - 1)]
    faces = np.zeros(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    faces["count"], faces["corners"] = 3, np.array(triangles, dtype=np.int64).reshape(-1, 3)
    return _TRIANGLES.format(len(vertices), len(faces)).encode() + vertices.tobytes() + faces.tobytes()


def elements_of(words: list[list[str]]) -> list[Element]:
    """The elements of a header, given the words of its lines.

    Raises
    ------
    LookupError, ValueError: a line of it is not complete, or has an unknown type.
    """
    found = list[Element]()
    for line in words:
        if line[:1] == ["element"]:
            found.append(Element(line[1], int(line[2]), []))
        elif line[:2] == ["property", "list"]:
            found[-1].properties.append(Property(line[4], _TYPES[line[3]], _TYPES[line[2]]))
        elif line[:1] == ["property"]:
            found[-1].properties.append(Property(line[2], _TYPES[line[1]]))
    return found


def equal_rows(content: bytes, element: Element, at: int, order: str) -> tuple[NDArray[Any] | None, int]:
    """The rows of an element that begins at a byte, and their size in bytes; None if they differ in length.

    Parameters
    ----------
    at: the byte.
    order: of the bytes in a number, as in `struct`.

    Raises
    ------
    ValueError: the file is cut short.
    """
    fields = list[tuple[Any, ...]]()
    for each in element.properties:
        if not each.counted:
            fields.append((each.name, order + each.kind))
            continue
        fields.append((f"number of {each.name}", order + each.counted))
        if not element.rows:
            continue
        first = at + np.dtype(fields).itemsize
        length = np.frombuffer(content, order + each.counted, 1, first - np.dtype(each.counted).itemsize)
        fields.append((each.name, order + each.kind, (int(length[0]),)))
    kind = np.dtype(fields)
    size = element.rows * kind.itemsize
    if at + size > len(content):
        return None, size
    table = np.frombuffer(content, kind, element.rows, at)
    lengths = [table[f"number of {each.name}"] for each in element.properties if each.counted]
    return (table if all(np.all(each == each[:1]) for each in lengths) else None), size


def unequal_rows(content: bytes, element: Element, at: int, order: str) -> tuple[dict[str, list[Any]], int]:
    """The columns of an element with lists of different lengths, and where the next element begins.

    Raises
    ------
    struct.error: the file is cut short.
    """
    columns: dict[str, list[Any]] = {each.name: [] for each in element.properties}
    letters = {kind: np.dtype(kind).char for each in element.properties for kind in (each.kind, each.counted) if kind}
    for _ in range(element.rows):
        for each in element.properties:
            count, is_list = 1, bool(each.counted)
            if is_list:
                (count,) = struct.unpack_from(order + letters[each.counted], content, at)
                at += struct.calcsize(order + letters[each.counted])
            form = f"{order}{count}{letters[each.kind]}"
            found = struct.unpack_from(form, content, at)
            columns[each.name].append(found if is_list else found[0])
            at += struct.calcsize(form)
    return columns, at
