"""Heights from a GeoTIFF, with their location.

The following is read: one band of numbers, of any size in strips or tiles that are plain or deflated, and up to
32 bits in other compressions; ModelPixelScale and ModelTiepoint, or a ModelTransformation without rotation;
GDAL's tags for missing heights, and for the scale, offset and unit of numbers; its masks; and the keys for
whether a number is that of a point or of an area, and for units. `raster_place` has the place.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.files_beside import NOTED_BESIDE
from backhoe_planner.files.found_file import is_file
from backhoe_planner.site.surveys.raster_place import place_of
from backhoe_planner.site.surveys.tiff_directory import Tags, TiffFile, read_tiff
from backhoe_planner.site.surveys.tiff_numbers import (
    BITS,
    COMPRESSION,
    HEIGHT,
    PLAIN,
    SAMPLE_FORMAT,
    WIDTH,
    can_decode,
    decode,
    first,
)

# numbers of tags in the standard
_METADATA, _NO_DATA = 42112, 42113
_KIND, _OLD_KIND, _PHOTOMETRIC, _ORIENTATION, _BANDS = 254, 255, 262, 274, 277
_BYTE_COUNTS = (279, 325)  # of strips and of tiles
_REDUCED, _MASK, _OLD_REDUCED = 1, 4, 2  # kinds of image
_UNSIGNED, _SIGNED = 1, 2
_WHITE_IS_ZERO, _PALETTE, _NORTH_WEST_FIRST = 0, 3, 1
_FORMATS = ("F", "I", "L", "I;16", "I;16B", "I;16L", "I;16N")  # Pillow's names of one band of numbers
_MOST = 89_000_000  # heights: 0.7 GB; Pillow warns of more
_COMPRESSIONS = {
    5: "LZW", 7: "JPEG", 32773: "PackBits", 34887: "LERC", 34925: "LZMA", 50000: "Zstandard", 50001: "WebP",
    50002: "JPEG XL",
}  # fmt: skip
_NOTED = ("scale", "offset", "unittype", "nodatavalue")  # of what GDAL notes of a band, what changes its heights
_METRES = ("m", "metre", "meter", "metres", "meters")
_AGAIN = "gdal_translate -ot Float32 -co COMPRESS=DEFLATE makes another file of it"


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
    if not is_file(path):
        raise InputError("no such height map file", file=path)
    tiff = read_tiff(path)
    tags = tiff.images[0]
    if first(tags, _BANDS, 1) != 1 or tags.get(_PHOTOMETRIC) == _PALETTE:
        found = "a palette of colours" if first(tags, _BANDS, 1) == 1 else f"{first(tags, _BANDS, 1)} bands"
        raise InputError("is not a height map", file=path, found=found, allowed="one band of numbers")
    if first(tags, WIDTH, 0) * first(tags, HEIGHT, 0) > _MOST:
        raise InputError("is too large", file=path, allowed=f"{_MOST:,} heights", hint="cut out the site")
    if tags.get(_ORIENTATION, _NORTH_WEST_FIRST) != _NORTH_WEST_FIRST:
        raise InputError(
            "has its rows in another order", file=path, key="Orientation", found=tags[_ORIENTATION],
            allowed="1, from north to south", hint="gdal_translate writes it in that order",
        )  # fmt: skip
    numbers = decode(tiff, tags, path) if can_decode(tags) else _by_pillow(tiff, tags, path)
    heights = np.where(_is_masked(tiff, path), np.nan, numbers.astype(float))[::-1]
    said, of_place = _said_of(tags, path)
    missing = _number(said.get("nodatavalue"))
    if missing is not None:
        # the tag is decimal text, but heights are often 32-bit floats
        heights[np.isclose(heights, missing, rtol=1e-6, atol=0.0)] = np.nan
    scale, offset = _scaling(said, path)
    heights = scale * heights + offset
    return HeightTable(heights, *place_of(tags, heights.shape[0], path, of_place))


def _by_pillow(tiff: TiffFile, tags: Tags, path: Path) -> NDArray[Any]:
    """The numbers of the first image, in a compression that needs Pillow."""
    from PIL import Image, UnidentifiedImageError

    _check_readable(tags, path, is_big_endian=tiff.order == ">")
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            with Image.open(path, formats=("TIFF",)) as image:
                if image.mode not in _FORMATS:
                    raise InputError("has numbers that cannot be read", file=path, found=image.mode, hint=_AGAIN)
                return _as_stored(np.array(image), tags)
        except InputError:
            raise
        except UnidentifiedImageError:
            found, allowed = _compression(tags), "none, DEFLATE, LZW, ..."
            raise InputError(
                "is in a compression that cannot be read", file=path, found=found, allowed=allowed, hint=_AGAIN
            ) from None
        except Exception as error:  # Pillow passes on any exception of its decoders
            raise InputError(f"is not a TIFF that can be read: {error}", file=path, found=_compression(tags)) from error


def _compression(tags: Tags) -> str:
    code = first(tags, COMPRESSION, PLAIN)
    return f"compression {_COMPRESSIONS.get(code, code)}"


def _is_masked(tiff: TiffFile, path: Path) -> NDArray[Any]:
    """(rows, columns) or () which numbers a mask hides.

    Raises
    ------
    InputError: the mask cannot be read, or there is another image, which may as well be meant.
    """
    main, *others = tiff.images
    size, hidden = (main.get(WIDTH), main.get(HEIGHT)), np.array(False)
    beside = path.with_name(path.name + ".msk")
    if is_file(beside):
        hint = "gdal_translate --config GDAL_TIFF_INTERNAL_MASK YES writes it into the GeoTIFF"
        raise InputError("has a mask in another file, which is not read", file=path, found=beside.name, hint=hint)
    for tags in others:
        kind = first(tags, _KIND, 0)
        if kind & _REDUCED or first(tags, _OLD_KIND, 0) == _OLD_REDUCED:
            continue
        if not kind & _MASK:
            found = f"{len(tiff.images)} images"
            raise InputError("holds several images", file=path, found=found, allowed="one, its mask and overviews")
        if (tags.get(WIDTH), tags.get(HEIGHT)) != size or first(tags, _BANDS, 1) != 1 or not can_decode(tags):
            raise InputError("its mask cannot be read", file=path, hint=_AGAIN)
        hidden = hidden | ~(decode(tiff, tags, path) > 0.0)
    return hidden


def _as_stored(numbers: NDArray[Any], tags: Tags) -> NDArray[Any]:
    """The numbers of the file: Pillow takes those of 8 bits for shades, unsigned and brighter the greater they are."""
    kind = first(tags, SAMPLE_FORMAT, _UNSIGNED)
    if numbers.dtype == np.int32 and kind == _UNSIGNED:
        return numbers.view(np.uint32) if first(tags, BITS, 1) == 32 else numbers
    if numbers.dtype != np.uint8:
        return numbers
    if tags.get(_PHOTOMETRIC) == _WHITE_IS_ZERO:
        numbers = ~numbers
    return numbers.view(np.int8) if kind == _SIGNED else numbers


def _check_readable(tags: Tags, path: Path, *, is_big_endian: bool) -> None:
    """Refuse what Pillow reads as other numbers than are meant, or not at all."""
    bits = first(tags, BITS, 1)
    if is_big_endian:
        wrong = "is compressed in big-endian order"
    elif bits not in (8, 16, 32):
        wrong = f"has numbers of {bits} bits"
    elif any(np.any(np.array(tags.get(tag, 1)) == 0) for tag in _BYTE_COUNTS):
        wrong = "leaves out tiles (SPARSE_OK)"
    else:
        return
    allowed = "in this compression all of it, little-endian, in 8, 16 or 32 bits"
    raise InputError(wrong, file=path, found=_compression(tags), allowed=allowed, hint=_AGAIN)


def _number(text: object) -> float | None:
    try:
        return float(str(text).strip("\0 \n"))
    except ValueError:
        return None


def _said_of(tags: Tags, path: Path) -> tuple[dict[str, str], dict[str, str]]:
    """What GDAL has noted, as far as it has, as text.

    Returns
    -------
    Of the first band: scale, offset, unittype and nodatavalue, in tags or in the file of the same name that ends in
    .aux.xml; and of the place: GeoTransform and SRS, in that file.

    Raises
    ------
    InputError: they are damaged, or the tags and the other file differ.
    """
    from xml.etree import ElementTree  # only when a GeoTIFF is read

    beside = path.with_name(path.name + NOTED_BESIDE)
    said = {"nodatavalue": str(tags[_NO_DATA])} if _NO_DATA in tags else {}
    try:
        text = str(tags.get(_METADATA, "")).strip("\0 \n")
        items = ElementTree.fromstring(text).iter("Item") if text else ()
        said |= {item.get("role", ""): item.text or "" for item in items if item.get("sample", "0") == "0"}
        root = ElementTree.fromstring(beside.read_bytes()) if is_file(beside) else ElementTree.Element("none")
    except ElementTree.ParseError as error:
        raise InputError(f"scale and offset of its heights cannot be read: {error}", file=path) from None
    for element in root.iterfind("PAMRasterBand[@band='1']/*"):
        key, text = element.tag.lower(), (element.text or "").strip()
        if key in _NOTED and text and not _are_same(said.setdefault(key, text), text):
            found = f"{said[key]}, and {text} in {beside.name}"
            raise InputError("says two things", file=path, key=element.tag, found=found, hint="delete the wrong one")
    of_place = ((key, (root.findtext(key) or "").strip()) for key in ("GeoTransform", "SRS"))
    return {key: text.strip("\0 \n") for key, text in said.items()}, {key: text for key, text in of_place if text}


def _are_same(text: str, other: str) -> bool:
    """Whether two texts are the same, or the same number but for rounding."""
    one, two = _number(text), _number(other)
    if one is None or two is None:
        return text.strip("\0 \n") == other
    return bool(np.isclose(one, two, rtol=1e-6, atol=0.0, equal_nan=True))


def _scaling(said: dict[str, str], path: Path) -> tuple[float, float]:
    """The factor that turns the numbers of the first band into heights, and the offset added then [m].

    Raises
    ------
    InputError: they cannot be read, or the unit of the heights is not the metre.
    """
    try:
        scale, offset = float(said.get("scale") or 1.0), float(said.get("offset") or 0.0)
        if not (np.isfinite(scale) and np.isfinite(offset)):
            raise ValueError(f"found {scale:g} and {offset:g}")
    except ValueError as error:
        raise InputError(f"scale and offset of its heights cannot be read: {error}", file=path) from None
    unit = said.get("unittype", "")
    if unit and unit.lower() not in _METRES:
        raise InputError(
            "its heights are not in metres", file=path, key="UnitType", found=unit, allowed=", ".join(_METRES),
            hint="gdal_calc.py makes metres of them",
        )  # fmt: skip
    return scale, offset
