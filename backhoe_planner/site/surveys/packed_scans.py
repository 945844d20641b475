"""Points of a scan in files that others unpack: the points of a LAZ by lazrs, an E57 (ASTM E2807) by pye57."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.extras import need_package
from backhoe_planner.site.surveys.single_precision import rounded_error, rounding_of

if TYPE_CHECKING:
    import pye57

_AT_ONCE = 1_000_000  # points that are unpacked together; chosen, some 40 MB
_POLAR = ("Range", "Azimuth", "Elevation")
_NO_ROTATION = 1e-3  # length of a quaternion that has no direction; chosen: the standard asks for 1
_AT_THE_END = -1  # a LAZ that was written as a stream has the place of its table of chunks in its last bytes
_TABLE = struct.Struct("<II")  # the head of a table of chunks: its version, and how many there are
_PLACE = struct.Struct("<q")
_COUNT_AT, _COUNT = 32, struct.Struct("<H")  # of parts of a point, in the record that says how points are packed
_PART = struct.Struct("<HHH")  # its kind, its size and its version
_LAYERED = 3  # the first number of that record, if a chunk of points has layers, each packed by itself
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # of a part by its kind; any other kind has one for each of its bytes


def unpacked_points(content: bytes, begin: int, kind: np.dtype[np.void], count: int, key: bytes) -> NDArray[np.void]:
    """(count,) the points of a LAZ, with the fields of `kind`.

    Parameters
    ----------
    content: all bytes of the file; `begin`: where its points begin.
    kind: some fields of a point when unpacked, and how long it is.
    key: the record of the file that says how they are packed.

    Raises
    ------
    ValueError: they are damaged.
    """
    import lazrs

    length = kind.itemsize
    _check_chunks(content, begin, count)
    _check_parts(key, length)
    source = io.BytesIO(content)
    source.seek(begin)
    shorter = np.dtype([(name, kind[name]) for name in kind.names or ()])  # only what is asked for is kept
    found = np.empty(count, dtype=shorter)
    try:
        _check_layers(content, begin, length, key, lazrs.read_chunk_table(source, lazrs.LazVlr(key)))
        source.seek(begin)
        points = lazrs.LasZipDecompressor(source, key)
        for first in range(0, count, _AT_ONCE):
            some = found[first : first + _AT_ONCE]
            unpacked = np.zeros(len(some) * length, dtype=np.uint8)
            points.decompress_many(unpacked)
            for name in shorter.names or ():
                some[name] = unpacked.view(kind)[name]
    except BaseException as error:  # what lazrs raises where it panics is none of Python's own exceptions
        if not isinstance(error, lazrs.LazrsError) and type(error).__name__ != "PanicException":
            raise
        raise ValueError(f"its points cannot be unpacked, {error}") from error
    return found


def _check_chunks(content: bytes, begin: int, count: int) -> None:
    """Raise a ValueError if the table of a LAZ's chunks is damaged: lazrs makes room for all that it names."""
    (table,) = _PLACE.unpack_from(content, begin)
    if table == _AT_THE_END:
        (table,) = _PLACE.unpack_from(content, len(content) - _PLACE.size)
    if not begin + _PLACE.size <= table <= len(content) - _TABLE.size:
        raise ValueError("its table of chunks is not in the file")
    _, chunks = _TABLE.unpack_from(content, table)
    if chunks > count:
        raise ValueError(f"{chunks} chunks of {count} points")


def _parts_of(key: bytes) -> Iterator[tuple[int, ...]]:
    """The kind, the size and the version of each part of a point, by the record of a LAZ that lists them."""
    return _PART.iter_unpack(key[_COUNT_AT + _COUNT.size :])


def _check_parts(key: bytes, length: int) -> None:
    """Raise a ValueError if the parts of a point, which the record of a LAZ lists, are not `length` bytes together."""
    (count,) = _COUNT.unpack_from(key, _COUNT_AT)
    sizes = [size for _, size, _ in _parts_of(key)]
    if len(sizes) != count or sum(sizes) != length:
        raise ValueError(f"parts of {sum(sizes)} bytes, not {length}")


def _check_layers(content: bytes, begin: int, length: int, key: bytes, chunks: Sequence[tuple[int, int]]) -> None:
    """Raise a ValueError if a layer is larger than its chunk: lazrs makes room for what it is said to be.

    chunks: the number of points and of bytes of each.
    """
    if struct.unpack_from("<H", key)[0] != _LAYERED:
        return
    layers = sum(_LAYERS.get(kind, size) for kind, size, _ in _parts_of(key))
    first = begin + _PLACE.size
    for _, size in chunks:
        # a chunk begins with a point that is not packed, the number of its points, and the sizes of its layers
        sizes = struct.unpack_from(f"<{layers}I", content, first + length + 4)
        if sum(sizes) > size:
            raise ValueError(f"layers of {sum(sizes)} bytes in a chunk of {size}")
        first += size


def read_e57(path: Path) -> Matrix:
    """(n, 3) the valid points [m] of all scans of an E57, each at the pose of its scanner.

    Raises
    ------
    InputError: it is damaged or no E57, a scan has no coordinates, or floats of 32 bits that are too coarse, or pye57
        is not installed.
    """
    need_package("pye57", extra="e57", what="scans in E57")
    import pye57

    parts: list[Matrix] = [np.zeros((0, 3))]
    try:
        with pye57.E57(str(path)) as scans:
            filled = [index for index in range(scans.scan_count) if scans.get_header(index).point_count > 0]
            parts += [_points_of_scan(scans, index, path) for index in filled]
    except InputError:
        raise
    except Exception as error:  # pye57 passes on exceptions of its own, of libE57Format and of numpy
        said = str(error).strip().partition("\n")[0]
        raise InputError(f"cannot be read as an E57: {said}", file=path) from error
    return np.concatenate(parts)


def _points_of_scan(scans: pye57.E57, index: int, path: Path) -> Matrix:
    """(n, 3) the points of one scan [m], in the coordinates that all scans share.

    Raises
    ------
    InputError: the scan's own coordinates are floats of 32 bits, and too coarse; it has fewer points than it says; or
        its pose is none.
    """
    from pye57.utils import convert_spherical_to_cartesian

    header = scans.get_header(index)
    pose = _pose_of(header, index, path)
    is_polar = "sphericalRange" in header.point_fields
    names = [f"spherical{one}" for one in _POLAR] if is_polar else [f"cartesian{one}" for one in "XYZ"]
    state = "sphericalInvalidState" if is_polar else "cartesianInvalidState"
    columns: dict[str, Any]
    columns, buffers = scans.make_buffers([*names, *([state] if state in header.point_fields else [])],
                                          header.point_count)  # fmt: skip
    count = header.points.reader(buffers).read()
    if count != header.point_count:  # what it does not read is not set
        raise InputError(
            "is cut short or damaged", file=path, key=f"scan {index + 1}", found=f"{count} points",
            allowed=f"{header.point_count}, as its header says",
        )  # fmt: skip
    points = np.column_stack([columns[name] for name in names]).astype(float)
    if state in columns:
        points = points[~columns[state].astype(bool)]
    if is_polar:
        points = np.asarray(convert_spherical_to_cartesian(points))
    else:
        rounding = rounding_of(points)
        if rounding > 0.0 and np.array_equal(points, points.astype(np.float32)):
            raise rounded_error(points, rounding, path)
    return points if pose is None else np.asarray(scans.to_global(points, *pose))


def _pose_of(header: Any, index: int, path: Path) -> tuple[Vector, Vector] | None:
    """(4,) the quaternion w, x, y, z and (3,) the position [m] of a scan's scanner; None if it has no pose.

    Raises
    ------
    InputError: the quaternion is 0, or a number is not finite.
    """
    if not header.has_pose():
        return None
    pose, found = header.node["pose"], []
    for name, axes, default in (("rotation", "wxyz", (1.0, 0.0, 0.0, 0.0)), ("translation", "xyz", (0.0, 0.0, 0.0))):
        given = pose[name] if pose.isDefined(name) else None
        found.append(np.array(default if given is None else [given[axis].value() for axis in axes]))
        if not np.isfinite(found[-1]).all() or (name == "rotation" and np.linalg.norm(found[-1]) < _NO_ROTATION):
            raise InputError(
                "is no pose of a scanner", file=path, key=f"scan {index + 1}, pose, {name}", found=found[-1].tolist(),
                allowed="a unit quaternion w, x, y, z" if name == "rotation" else "finite numbers",
            )  # fmt: skip
    return found[0], found[1]
