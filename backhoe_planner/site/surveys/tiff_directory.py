"""The directory of a TIFF: the tags of each of its images, from a classic TIFF or a BigTIFF."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Literal, NamedTuple

from backhoe_planner.errors import InputError

Tags = dict[int, Any]
"""The values of an image by the number of their tag: a number, a text, or a tuple of several numbers."""

_ORDERS: dict[bytes, Literal["<", ">"]] = {b"II": "<", b"MM": ">"}
# formats of the types of a tag's values, by their numbers in the standard
_TYPES = {
    1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 6: "b", 7: "B", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d", 13: "I",
    16: "Q", 17: "q", 18: "Q",
}  # fmt: skip
_TEXT = 2
_WHOLE = (1, 3, 4, 13, 16, 18)  # types of whole numbers of 0 or more
# tags that hold at least one of these: sizes, kinds and places of the numbers, and the keys of a GeoTIFF
_OF_WHOLE = frozenset((*range(254, 260), 262, 266, 273, 274, *range(277, 280), 317, *range(322, 326), 339, 34735))
_OF_FRACTIONS = 34736  # numbers for these keys
_MOST_IMAGES = 1_000  # in one file; chosen, so that a circle of directories ends
_MOST_VALUES = 10_000_000  # of one tag; chosen: there are as many as tiles


class TiffFile(NamedTuple):
    """A TIFF.

    Attributes
    ----------
    content: all bytes of the file.
    order: of bytes in a number, as in `struct`: little-endian or big-endian.
    images: the tags of each image.
    """

    content: bytes
    order: Literal["<", ">"]
    images: tuple[Tags, ...]


def read_tiff(path: Path) -> TiffFile:
    """The directory of a TIFF.

    Raises
    ------
    InputError: it is no TIFF, or is cut short.
    """
    content = path.read_bytes()
    order = _ORDERS.get(content[:2])
    try:
        version = struct.unpack_from(f"{order}H", content, 2)[0] if order else 0
        if order is None or version not in (42, 43):
            raise InputError("is not a TIFF that can be read", file=path)
        is_big = version == 43
        (at,) = struct.unpack_from(f"{order}Q", content, 8) if is_big else struct.unpack_from(f"{order}I", content, 4)
        images = list[Tags]()
        while at:
            if len(images) == _MOST_IMAGES:
                raise InputError(f"has more than {_MOST_IMAGES} images", file=path)
            tags, at = _read_image(content, order, at, is_big=is_big)
            images.append(tags)
    except (struct.error, OverflowError) as error:
        raise InputError("is not a TIFF that can be read: the file is cut short or damaged", file=path) from error
    if not images:
        raise InputError("is a TIFF without an image", file=path)
    return TiffFile(content, order, tuple(images))


def _read_image(content: bytes, order: str, at: int, *, is_big: bool) -> tuple[Tags, int]:
    """The tags in the directory that begins at a byte, and where the next directory begins; 0 after the last."""
    counted, entry, inline = ("Q", "HHQ", 8) if is_big else ("H", "HHI", 4)
    (count,) = struct.unpack_from(order + counted, content, at)
    at += struct.calcsize(order + counted)
    tags: Tags = {}
    head = struct.calcsize(order + entry)
    for place in range(at, at + count * (head + inline), head + inline):
        tag, kind, values = struct.unpack_from(order + entry, content, place)
        if kind not in _TYPES:
            continue  # of a later standard: it is to be skipped
        is_wrong = (kind not in _WHOLE or not values) if tag in _OF_WHOLE else tag == _OF_FRACTIONS and kind == _TEXT
        if is_wrong or values > _MOST_VALUES:
            raise OverflowError
        form = f"{order}{values}s" if kind == _TEXT else order + values * _TYPES[kind]
        where = place + head
        if struct.calcsize(form) > inline:
            (where,) = struct.unpack_from(order + counted.replace("H", "I"), content, where)
        tags[tag] = _value(struct.unpack_from(form, content, where), is_text=kind == _TEXT)
    (following,) = struct.unpack_from(order + counted.replace("H", "I"), content, at + count * (head + inline))
    return tags, following


def _value(found: tuple[Any, ...], *, is_text: bool) -> Any:
    if is_text:
        return found[0].decode("utf-8", errors="replace").rstrip("\0")
    return found[0] if len(found) == 1 else found
