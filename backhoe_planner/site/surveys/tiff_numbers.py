"""The numbers of a TIFF of one band, as they are stored: in strips or tiles, plain or deflated."""

from __future__ import annotations

import itertools
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError
from backhoe_planner.site.surveys.tiff_directory import Tags, TiffFile

# numbers of tags in the standard
WIDTH, HEIGHT, BITS, COMPRESSION, SAMPLE_FORMAT = 256, 257, 258, 259, 339
_FILL_ORDER, _ROWS_PER_STRIP, _PREDICTOR, _TILE_WIDTH, _TILE_HEIGHT = 266, 278, 317, 322, 323
_STRIPS, _TILES = (273, 279), (324, 325)  # offsets and counts of bytes
PLAIN, DEFLATED = 1, (8, 32946)
_KINDS = {1: "u", 2: "i", 3: "f", 4: "u"}  # SampleFormat; 4 is undefined
_TYPES = ("u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f2", "f4", "f8")
_DIFFERENCES, _FLOAT_DIFFERENCES = 2, 3  # predictors


def first(tags: Tags, tag: int, default: int) -> int:
    """The only or first value of a tag, as a whole number."""
    value = tags.get(tag, default)
    return int(value[0] if isinstance(value, tuple) and value else value)


def can_decode(tags: Tags) -> bool:
    """Whether `decode` reads the numbers of an image."""
    return first(tags, COMPRESSION, PLAIN) in (PLAIN, *DEFLATED) and first(tags, _FILL_ORDER, 1) == 1


def decode(tiff: TiffFile, tags: Tags, path: Path) -> Matrix:
    """(rows, columns) the numbers of an image, as its rows are stored; NaN where a strip or tile is left out.

    Raises
    ------
    InputError: the file is cut short or damaged, or has numbers of a kind that cannot be read.
    """
    rows, columns = first(tags, HEIGHT, 0), first(tags, WIDTH, 0)
    is_tiled = _TILE_WIDTH in tags
    high = first(tags, _TILE_HEIGHT, 0) if is_tiled else min(first(tags, _ROWS_PER_STRIP, rows), rows)
    wide = first(tags, _TILE_WIDTH, 0) if is_tiled else columns
    offsets, sizes = (np.atleast_1d(tags.get(tag, ())) for tag in (_TILES if is_tiled else _STRIPS))
    if min(rows, columns, high, wide) < 1:
        raise InputError("is not a TIFF that can be read: its size is not given", file=path)
    places = list(itertools.product(range(0, rows, high), range(0, columns, wide)))
    if len(offsets) != len(places) or len(sizes) != len(places):
        raise InputError("is not a TIFF that can be read: strips or tiles are missing", file=path)
    numbers = np.full((rows, columns), np.nan)
    for (row, column), offset, size in zip(places, offsets.tolist(), sizes.tolist(), strict=True):
        if size:
            shape = (high if is_tiled else min(high, rows - row), wide)
            block = _block(tiff, tags, tiff.content[offset : offset + size], shape, path)
            part = numbers[row : row + high, column : column + wide]
            with np.errstate(invalid="ignore"):  # a NaN of 32 bits may be a signalling one
                part[...] = block[: part.shape[0], : part.shape[1]]
    return numbers


def _block(tiff: TiffFile, tags: Tags, data: bytes, shape: tuple[int, int], path: Path) -> NDArray[Any]:
    """(high, wide) the numbers of one strip or tile."""
    bits, kind = first(tags, BITS, 1), _KINDS.get(first(tags, SAMPLE_FORMAT, 1), "")
    name, predictor = f"{kind}{bits // 8}", first(tags, _PREDICTOR, 1)
    is_mask = bits == 1 and predictor == 1
    row_size = -(-shape[1] * bits // 8)
    if first(tags, COMPRESSION, PLAIN) != PLAIN:
        try:
            data = zlib.decompressobj().decompress(data, shape[0] * row_size)
        except zlib.error as error:
            raise InputError(f"is not a TIFF that can be read: {error}", file=path) from error
    if len(data) < shape[0] * row_size:
        raise InputError("is not a TIFF that can be read: the file is cut short", file=path)
    table = np.frombuffer(data, dtype=np.uint8, count=shape[0] * row_size).reshape(shape[0], row_size)
    if is_mask:
        return np.unpackbits(table, axis=1)[:, : shape[1]]
    if bits % 8 or name not in _TYPES or predictor not in (1, _DIFFERENCES, _FLOAT_DIFFERENCES):
        raise InputError(
            "has numbers that cannot be read", file=path, found=f"{bits} bits, sample format "
            f"{first(tags, SAMPLE_FORMAT, 1)}, predictor {predictor}", allowed=", ".join(_TYPES),
        )  # fmt: skip
    if predictor == _FLOAT_DIFFERENCES:
        # the bytes of a row stand by their significance, the most significant of all numbers first
        planes = np.cumsum(table, axis=1, dtype=np.uint8).reshape(shape[0], bits // 8, shape[1])
        return np.ascontiguousarray(planes.transpose(0, 2, 1)).view(f">{name}").reshape(shape)
    if predictor == _DIFFERENCES:
        whole = np.dtype(f"u{bits // 8}")
        found = np.cumsum(table.view(whole.newbyteorder(tiff.order)), axis=1, dtype=whole)
        return found.view(name)
    return table.view(f"{tiff.order}{name}")
