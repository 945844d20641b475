"""Heights from a GeoTIFF, with their location.

The following is read: one band of numbers; ModelPixelScale and ModelTiepoint, or a ModelTransformation
without rotation; GDAL's tags for missing heights, and for the scale and offset of numbers; and the
keys for whether a number is that of a point or of an area, and for the horizontal and vertical units
(OGC 19-008r4, GeoTIFF Standard 1.1).
"""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.found_file import is_file

# numbers of tags and keys in the standard
_SCALE, _TIEPOINT, _TRANSFORMATION, _KEYS, _WORDS, _METADATA, _NO_DATA = 33550, 33922, 34264, 34735, 34737, 42112, 42113
_BITS, _COMPRESSION, _PHOTOMETRIC, _ORIENTATION, _SAMPLE_FORMAT = 258, 259, 262, 274, 339
_BYTE_COUNTS = (279, 325)  # of strips and of tiles
_UNCOMPRESSED, _UNSIGNED = 1, 1
_WHITE_IS_ZERO, _NORTH_WEST_FIRST, _SIGNED = 0, 1, 2
_MODEL, _RASTER, _UNIT, _UPRIGHT_UNIT = 1024, 1025, 3076, 4099
_GEOGRAPHIC, _POINT, _METRE = 2, 2, 9001
# in the name of a projection, such as "California zone 5 (ftUS)"
_FEET = re.compile(r"\b(?:ft|ftUS|foot|feet)\b", re.IGNORECASE)
_SQUARE_WITHIN = 1e-6  # of the cell: the two scales of square cells differ by rounding only
_FORMATS = ("F", "I", "L", "I;16", "I;16B", "I;16L", "I;16N")  # Pillow's names of one band of numbers


class HeightTable(NamedTuple):
    """Heights of a file.

    Attributes
    ----------
    heights: (rows, columns) [m]; rows run along y, columns along x, both ascending; NaN where there is none.
    low: (2,) x, y of the first height [m]; None if the file does not say.
    cell: distance between heights [m]; 0 if the file does not say.
    """

    heights: Matrix
    low: Vector | None = None
    cell: float = 0.0


def read_geotiff(path: Path) -> HeightTable:
    """The heights in a GeoTIFF. If it has no location, it counts as heights alone; its last row has the least y.

    Raises
    ------
    InputError: missing, no TIFF of one band of numbers, in degrees or feet, turned, or with oblong cells.
    """
    from PIL import Image, UnidentifiedImageError

    if not is_file(path):
        raise InputError("no such height map file", file=path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(path, formats=("TIFF",)) as image:
                directory: Any = getattr(image, "tag_v2", {})
                tags: dict[int, Any] = dict(directory)
                if image.mode not in _FORMATS:
                    raise InputError(
                        "is not a height map", file=path, found=f"an image of mode {image.mode}",
                        allowed="one band of numbers",
                    )  # fmt: skip
                _check_readable(tags, path, is_big_endian=directory.prefix == b"MM")
                numbers = np.array(image)
        except InputError:
            raise
        except UnidentifiedImageError:
            hint = "such as 64-bit floats: gdal_translate -ot Float32 makes 32-bit floats of them"
            raise InputError(
                "is not a TIFF that can be read, or has numbers that cannot", file=path, hint=hint
            ) from None
        except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
            raise InputError("is too large", file=path, hint="cut out the site") from error
        except Exception as error:  # Pillow passes on any exception of its decoders
            raise InputError(f"is not a TIFF that can be read: {error}", file=path) from error
    if tags.get(_ORIENTATION, _NORTH_WEST_FIRST) != _NORTH_WEST_FIRST:
        raise InputError(
            "has its rows in another order", file=path, key="Orientation", found=tags[_ORIENTATION],
            allowed="1, from north to south", hint="gdal_translate writes it in that order",
        )  # fmt: skip
    heights = _as_stored(numbers, tags).astype(float)[::-1]
    missing = _number(tags.get(_NO_DATA))
    if missing is not None:
        # the tag is decimal text, but heights are often 32-bit floats
        heights[np.isclose(heights, missing, rtol=1e-6, atol=0.0)] = np.nan
    scale, offset = _scaling(tags, path)
    heights = scale * heights + offset
    return HeightTable(heights, *_place(tags, heights.shape[0], path))


def _as_stored(numbers: NDArray[Any], tags: dict[int, Any]) -> NDArray[Any]:
    """The numbers of the file: Pillow takes those of 8 bits for shades, unsigned and brighter the greater they are."""
    if numbers.dtype == np.int32 and _first(tags.get(_SAMPLE_FORMAT, _UNSIGNED)) == _UNSIGNED:
        return numbers.view(np.uint32) if _first(tags.get(_BITS)) == 32 else numbers
    if numbers.dtype != np.uint8:
        return numbers
    if tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
        numbers = ~numbers
    return numbers.view(np.int8) if _first(tags.get(_SAMPLE_FORMAT)) == _SIGNED else numbers


def _check_readable(tags: dict[int, Any], path: Path, *, is_big_endian: bool) -> None:
    """Refuse what Pillow reads as other numbers than are meant."""
    if is_big_endian and tags.get(_COMPRESSION, _UNCOMPRESSED) != _UNCOMPRESSED:
        wrong = "is compressed in big-endian order"
    elif _first(tags.get(_BITS, 8)) < 8:
        wrong = f"has numbers of {_first(tags[_BITS])} bits"
    elif any(np.any(np.array(tags.get(tag, 1)) == 0) for tag in _BYTE_COUNTS):
        wrong = "leaves out tiles (SPARSE_OK)"
    else:
        return
    hint = "gdal_translate -co COMPRESS=LZW makes another file of it"
    raise InputError(wrong, file=path, allowed="all of it, little-endian, in 8 bits or more", hint=hint)


def _first(value: Any) -> Any:
    """A tag's only or first value."""
    return value[0] if isinstance(value, tuple) and value else value


def _numbers(tags: dict[int, Any], tag: int, count: int, path: Path, key: str) -> Vector:
    """(count,) the numbers of a tag.

    Raises
    ------
    InputError: there are fewer, or one is not finite.
    """
    value = tags[tag]
    found = np.atleast_1d(np.array(value, dtype=float))
    if len(found) < count or not np.isfinite(found[:count]).all():
        raise InputError("is not what the tag holds", file=path, key=key, found=str(value), allowed=f"{count} numbers")
    return found[:count]


def _number(text: object) -> float | None:
    try:
        return float(str(text).strip("\0 \n"))
    except ValueError:
        return None


def _scaling(tags: dict[int, Any], path: Path) -> tuple[float, float]:
    """The factor that turns the numbers of the first band into heights, and the offset added then [m]."""
    from xml.etree import ElementTree  # only when a GeoTIFF is read

    text = str(tags.get(_METADATA, "")).strip("\0 \n")
    try:
        items = ElementTree.fromstring(text).iter("Item") if text else ()
        said = {item.get("role"): item.text for item in items if item.get("sample", "0") == "0"}
        scale, offset = float(said.get("scale") or 1.0), float(said.get("offset") or 0.0)
        if not (np.isfinite(scale) and np.isfinite(offset)):
            raise ValueError(f"found {scale:g} and {offset:g}")
        return scale, offset
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"scale and offset of its heights cannot be read: {error}", file=path) from None


def _place(tags: dict[int, Any], rows: int, path: Path) -> tuple[Vector | None, float]:
    """(2,) x, y of the south-western height [m], and the distance between heights [m]."""
    keys = [int(value) for value in tags.get(_KEYS, ())]
    values = {keys[at]: keys[at + 3] for at in range(4, len(keys) - 3, 4) if keys[at + 1] == 0}
    if values.get(_MODEL) == _GEOGRAPHIC:
        raise InputError("is in degrees", file=path, allowed="metres", hint="project it, such as to UTM")
    if values.get(_UNIT, _METRE) != _METRE:
        found = f"unit {values[_UNIT]} of the EPSG registry"
        raise InputError("is not in metres", file=path, found=found, allowed="metres (9001)")
    words = str(tags.get(_WORDS, ""))
    if _UNIT not in values and _FEET.search(words):
        raise InputError("is not in metres", file=path, found=words.strip("\0| \n"), allowed="metres")
    if values.get(_UPRIGHT_UNIT, _METRE) != _METRE:
        found = f"unit {values[_UPRIGHT_UNIT]} of the EPSG registry"
        raise InputError("its heights are not in metres", file=path, found=found, allowed="metres (9001)")
    if _TRANSFORMATION in tags:
        m = _numbers(tags, _TRANSFORMATION, 16, path, "ModelTransformation").reshape(4, 4)
        if abs(m[0, 1]) + abs(m[1, 0]) > _SQUARE_WITHIN * abs(m[0, 0]):
            raise InputError("is turned against north", file=path, hint="resample it along x and y")
        corner, scale, upward = m[:2, 3], np.array([m[0, 0], -m[1, 1]]), (m[2, 2], m[2, 3])
    elif _SCALE in tags and _TIEPOINT in tags:
        pixel = _numbers(tags, _SCALE, 3, path, "ModelPixelScale")
        scale, of_heights = pixel[:2], pixel[2]
        i, j, k, x, y, z = _numbers(tags, _TIEPOINT, 6, path, "ModelTiepoint")
        corner, upward = np.array([x - i * scale[0], y + j * scale[1]]), (of_heights, z - k * of_heights)
    else:
        return None, 0.0
    if upward[0] not in (0.0, 1.0) or upward[1] != 0.0:
        raise InputError(
            "its place has a scale or an offset of heights", file=path, found=f"{upward[0]:g} and {upward[1]:g} m",
            allowed="1 and 0", hint="apply them to the heights",
        )  # fmt: skip
    if min(scale) < 0.0:
        found = " and ".join(
            words for of, words in zip(scale, ("columns from east to west", "rows from south to north"), strict=True)
            if of < 0.0
        )  # fmt: skip
        hint = "gdalwarp turns it"
        raise InputError("is flipped", file=path, found=found, allowed="from west to east, north to south", hint=hint)
    if min(scale) == 0.0 or abs(scale[0] - scale[1]) > _SQUARE_WITHIN * scale[0]:
        found = f"{scale[0]:g} x {scale[1]:g} m"
        raise InputError("its cells are not square", file=path, found=found, hint="resample it")
    cell = float(scale[0])
    middle = 0.0 if values.get(_RASTER) == _POINT else 0.5  # of a cell, from the place in the tags to the height
    return np.array([corner[0] + middle * cell, corner[1] - (rows - 1 + middle) * cell]), cell
