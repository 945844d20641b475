"""Points of a scan in PCD (version 0.7 of the Point Cloud Library) and in LAS or LAZ (versions 1.0 to 1.4 of ASPRS)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.site.surveys.geo_keys import GeoKeys
from backhoe_planner.site.surveys.packed_scans import unpacked_points
from backhoe_planner.site.surveys.wkt_units import check_system_in_metres

_AXES = ("x", "y", "z")
_HEADER = 100_000  # bytes in which the header of a PCD ends
_ENTRIES = ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA")  # that a header must have
_TYPES = {"F": "f", "I": "i", "U": "u"}
_DATA = ("ascii", "binary", "binary_compressed")
_HERE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # a viewpoint at the origin that is not turned
_LITERALS, _LONG = 32, 7  # of LZF: control bytes below the first copy bytes, lengths of the second go on
_SMALLEST = 20  # bytes of a point of a LAS
_MARK = b"LASF"
_COMPRESSED = 0xC0  # bits of the point format that LAZ sets
# the two bytes of a point that mark it. Up to format 5 the first has the class in five bits, and the bit that withholds
# it; from format 6 on the bits are there, and the second is the class. Version 1.0 does not say what they mean
_MARKS, _FIRST_WITH_MARKS, _FIRST_NEW = 15, 1, 6
_CLASS, _WITHHELD, _WITHHELD_NEW = 0x1F, 0x80, 0x04
_NOISE, _NOISE_NEW = (7,), (7, 18)  # classes of points that are none: low noise, and high noise
_PACKING = 22204  # the record of a LAZ that says how its points are packed
_SYSTEM, _WKT = b"LASF_Projection", 2112
_KEYS, _NUMBERS, _WORDS = 34735, 34736, 34737  # records of a reference system, numbered as the tags of a GeoTIFF


def read_pcd(path: Path) -> Matrix:
    """(n, 3) the points of a PCD; points without coordinates (NaN), which stand for no echo, are left out.

    Raises
    ------
    InputError: it is no PCD, is cut short or damaged, its points have no x, y and z, or its viewpoint is not 0.
    """
    content = path.read_bytes()
    head, begin = _header_of_pcd(content, path)
    names, sizes, kinds = head["FIELDS"], head["SIZE"], head["TYPE"]
    counts = head.get("COUNT", ["1"] * len(names))
    if any(names.count(axis) != 1 for axis in _AXES):
        raise InputError(
            "does not name x, y and z once each", file=path, key="FIELDS", found=" ".join(names), allowed="x y z"
        )
    viewpoint = head.get("VIEWPOINT", [])
    try:
        if viewpoint and tuple(map(float, viewpoint)) != _HERE:
            raise InputError(
                "has a viewpoint, which may or may not be applied to its points already", file=path, key="VIEWPOINT",
                found=" ".join(viewpoint), allowed="0 0 0 1 0 0 0", hint="apply it to the points, or write that",
            )  # fmt: skip
        fields = [
            (f"{place} {name}", f"<{_TYPES[kind]}{int(size)}", (int(count),))
            for place, (name, size, kind, count) in enumerate(zip(names, sizes, kinds, counts, strict=True))
        ]
        rows = int(head["POINTS"][0])
        if head["DATA"][0] == "ascii":
            table = _text_of_pcd(content[begin:], fields, rows)
        else:
            table = _bytes_of_pcd(content[begin:], fields, rows, packed=head["DATA"][0] == "binary_compressed")
        points = np.column_stack([table[names.index(axis)][:, 0] for axis in _AXES]).astype(float)
    except InputError:
        raise
    except (LookupError, ValueError, TypeError, struct.error) as error:
        raise InputError(f"is a PCD that is cut short or damaged: {error}", file=path) from error
    return np.asarray(points[~np.isnan(points).all(axis=1)])


def pcd_has_single_precision(path: Path) -> bool:
    """Whether the coordinates of a PCD are floats of 32 bits.

    Raises
    ------
    InputError: it is no PCD.
    """
    head, _ = _header_of_pcd(path.read_bytes(), path)
    at = head["FIELDS"].index("x")
    return head["DATA"][0] != "ascii" and (head["TYPE"][at], head["SIZE"][at]) == ("F", "4")


def _header_of_pcd(content: bytes, path: Path) -> tuple[dict[str, list[str]], int]:
    """The words of each entry of the header, and where the points begin."""
    head, at = dict[str, list[str]](), 0
    while "DATA" not in head and (end := content.find(b"\n", at, _HEADER)) >= 0:
        words = content[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            head[words[0].upper()] = words[1:]
    missing = [name for name in _ENTRIES if not head.get(name)]
    if missing:
        raise InputError("is not a PCD", file=path, key="header", found=f"no {missing[0]}", allowed=", ".join(_ENTRIES))
    if head["DATA"][0] not in _DATA:
        found = head["DATA"][0]
        raise InputError("is not a PCD", file=path, key="DATA", found=found, allowed=", ".join(_DATA))
    return head, at


def _text_of_pcd(body: bytes, fields: list[tuple[str, str, tuple[int]]], rows: int) -> list[NDArray[Any]]:
    """The columns of each field."""
    lines = [line for line in body.decode("ascii").splitlines() if line.strip()]
    if len(lines) != rows:
        raise ValueError(f"{len(lines)} lines, not {rows}")
    widths = [shape[0] for _, _, shape in fields]
    found = np.loadtxt(lines, comments=None, ndmin=2) if lines else np.zeros((0, sum(widths)))
    if found.shape[1] != sum(widths):
        raise ValueError(f"{found.shape[1]} numbers in a line, not {sum(widths)}")
    return np.split(found, np.cumsum(widths)[:-1], axis=1)


def _bytes_of_pcd(
    body: bytes, fields: list[tuple[str, str, tuple[int]]], rows: int, *, packed: bool
) -> list[NDArray[Any]]:
    """The columns of each field; in a packed file, one field comes after the other."""
    kind = np.dtype(fields)
    if not packed:
        if len(body) < rows * kind.itemsize:
            raise ValueError(f"{len(body)} bytes of points, not {rows * kind.itemsize}")
        table = np.frombuffer(body, kind, rows)
        return [table[name] for name, _, _ in fields]
    small, large = struct.unpack_from("<II", body)
    if large != rows * kind.itemsize or len(body) < 8 + small:
        raise ValueError(f"{large} bytes of points, not {rows * kind.itemsize}")
    whole, found, at = _unpacked(body[8 : 8 + small], large), list[NDArray[Any]](), 0
    for _, form, shape in fields:
        found.append(np.frombuffer(whole, form, rows * shape[0], at).reshape(rows, shape[0]))
        at += found[-1].nbytes
    return found


def _unpacked(data: bytes, size: int) -> bytes:
    """Bytes that are compressed by LZF: literal runs, and copies of bytes that came before."""
    found, at = bytearray(), 0
    while at < len(data):
        control, at = data[at], at + 1
        if control < _LITERALS:
            found += data[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == _LONG:
            length, at = length + data[at], at + 1
        length, back, at = length + 2, ((control & 0x1F) << 8 | data[at]) + 1, at + 1
        if back > len(found):
            raise ValueError("a copy of bytes before the first")
        part = bytes(found[len(found) - back :][:length])
        found += (part * (length // len(part) + 1))[:length]  # it may go on into itself
    if len(found) != size:
        raise ValueError(f"{len(found)} bytes, not {size}")
    return bytes(found)


def read_las(path: Path) -> Matrix:
    """(n, 3) the points of a LAS or LAZ [m], except those that it marks as noise (classes 7 and 18) or as withheld.

    Raises
    ------
    InputError: it is no LAS, is cut short or damaged, has no other points, or its reference system is not in metres.
    """
    content = path.read_bytes()
    try:
        if content[:4] != _MARK:
            raise InputError("is not a LAS", file=path, found=repr(content[:4]), allowed=repr(_MARK))
        minor = content[25]
        size, begin, records, form, length, count = struct.unpack_from("<HIIBHI", content, 94)
        if minor >= 4:
            (count,) = struct.unpack_from("<Q", content, 247)
        scale, offset = (np.array(struct.unpack_from("<3d", content, at)) for at in (131, 155))
        found = list(_records_of_las(content, size, records))
        _check_system_of_las(found, path)
        if length < _SMALLEST:
            raise ValueError(f"{length} bytes for a point, not {_SMALLEST} or more")
        kind = np.dtype(
            {"names": ["xyz", "marks"], "formats": [("<i4", 3), ("u1", 2)], "offsets": [0, _MARKS], "itemsize": length}
        )
        if form & _COMPRESSED:
            packing = next((data for _, number, data in found if number == _PACKING), b"")
            points = unpacked_points(content, begin, kind, count, packing)
        elif begin + count * length > len(content):
            raise ValueError(f"{len(content)} bytes, not {begin + count * length}")
        else:
            points = np.frombuffer(content, kind, count, begin)
        places = points["xyz"]
        if minor >= _FIRST_WITH_MARKS:
            counts = _counts(points["marks"], is_new=form & ~_COMPRESSED >= _FIRST_NEW)
            if count and not counts.any():
                raise InputError("marks all of its points as noise or as withheld", file=path, found=f"{count} points")
            places = places if counts.all() else places[counts]
        return np.asarray(places * scale + offset)
    except InputError:
        raise
    except (IndexError, ValueError, MemoryError, struct.error) as error:
        raise InputError(f"is a LAS that is cut short or damaged: {error}", file=path) from error


def _counts(marks: NDArray[np.uint8], *, is_new: bool) -> Flags:
    """(n,) which points of a LAS count, by the two bytes (n, 2) that mark each; `is_new` from point format 6 on."""
    first, second = marks.T
    if is_new:
        return np.asarray(~np.isin(second, _NOISE_NEW) & (first & _WITHHELD_NEW == 0))
    return np.asarray(~np.isin(first & _CLASS, _NOISE) & (first & _WITHHELD == 0))


def _records_of_las(content: bytes, at: int, count: int) -> Iterator[tuple[bytes, int, bytes]]:
    """Whose each of the records after the header is, its number, and its bytes."""
    for _ in range(count):
        user, number, length = struct.unpack_from("<16sHH", content, at + 2)
        yield user.rstrip(b"\0"), number, content[at + 54 : at + 54 + length]
        at += 54 + length


def _check_system_of_las(records: list[tuple[bytes, int, bytes]], path: Path) -> None:
    """Check that the reference system in the records, if there is one, is in metres."""
    tags: dict[int, Any] = {}
    for user, number, data in records:
        if user != _SYSTEM:
            continue
        if number == _WKT and data.strip(b"\0 \n"):
            text = data.decode("utf-8", errors="replace").strip("\0 \n")
            with _hint_for_points(path, "its WKT record"):
                check_system_in_metres(text, path, key="its WKT record")
            return  # it replaces keys
        elif number == _KEYS:
            tags[number] = struct.unpack_from(f"<{len(data) // 2}H", data)
        elif number == _NUMBERS:
            tags[number] = struct.unpack_from(f"<{len(data) // 8}d", data)
        elif number == _WORDS:
            tags[number] = data.decode("latin-1")
    if _KEYS in tags:
        with _hint_for_points(path, "its reference system"):
            GeoKeys(tags, path).check_metres()


@contextmanager
def _hint_for_points(path: Path, key: str) -> Iterator[None]:
    """What is said of a raster in other units, with the program that makes metres of points."""
    try:
        yield
    except InputError as error:
        raise InputError(
            error.problem, file=path, key=key, found=error.found, allowed=error.allowed,
            hint="filters.reprojection of pdal makes metres of it",
        ) from None  # fmt: skip
