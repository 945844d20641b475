"""Where the heights of a GeoTIFF lie: by its tags, a world file, or the file in which GDAL notes it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.files.files_beside import world_files
from backhoe_planner.files.text_file import read_text
from backhoe_planner.site.surveys.geo_keys import GeoKeys, numbers_of
from backhoe_planner.site.surveys.tiff_directory import Tags
from backhoe_planner.site.surveys.wkt_units import check_system_in_metres

# numbers of tags in the standard
_SCALE, _TIEPOINT, _TRANSFORMATION = 33550, 33922, 34264
_SQUARE_WITHIN = 1e-6  # of the cell: the two scales of square cells differ by rounding only
_SAME_WITHIN = 0.01  # of the cell: places that differ less are the same; chosen, texts have few digits
_FINEST = 5e-4  # m: finer cells with no reference system, at a longitude and a latitude, are in degrees; chosen


class _Place(NamedTuple):
    """Where the heights lie, as one source has it.

    Attributes
    ----------
    source: of the place, in words.
    first: (2,) x, y of the north-western height [m].
    cell: (2,) from column to column along x, and from row to row along y; as a rule the second is negative [m].
    turned: (2,) from column to column along y, and from row to row along x [m].
    """

    source: str
    first: Vector
    cell: Vector
    turned: Vector


def place_of(tags: Tags, rows: int, path: Path, noted: dict[str, str]) -> tuple[Vector | None, float]:
    """(2,) x, y of the south-western height [m], and the distance between heights [m]; None and 0 if nothing says.

    Parameters
    ----------
    noted: the texts of GeoTransform and SRS in the file in which GDAL notes things, as far as it has them.

    Raises
    ------
    InputError: they are not in metres, turned, flipped or oblong; or two sources differ.
    """
    keys = GeoKeys(tags, path)
    keys.check_metres()
    is_known = keys.has_system
    if "SRS" in noted:
        check_system_in_metres(noted["SRS"], path, key="SRS in its .aux.xml")
        is_known = True
    beside = path.with_suffix(".prj")
    if not is_known and beside.is_file():
        check_system_in_metres(read_text(beside, what="projection"), beside, key=f"the system of {path.name}")
        is_known = True
    places = [_from_tags(tags, path, of_points=keys.places_are_points), _from_note(noted, path)]
    found = [place for place in (*places, *map(_from_world_file, world_files(path))) if place is not None]
    if not found:
        return None, 0.0
    for other in found[1:]:
        _check_same(found[0], other, path)
    cell = _checked_cell(found[0], path)
    low = np.array([found[0].first[0], found[0].first[1] - (rows - 1) * cell])
    if not is_known and cell < _FINEST and abs(low[0]) <= 180.0 and abs(low[1]) <= 90.0:
        raise InputError(
            "may be in degrees", file=path, found=f"cells of {cell:.3g} at {low[0]:.5g}, {low[1]:.5g}, and no "
            "reference system", allowed="metres", hint="project it, such as to UTM",
        )  # fmt: skip
    return low, cell


def _from_tags(tags: Tags, path: Path, *, of_points: bool) -> _Place | None:
    if _TRANSFORMATION in tags:
        m = numbers_of(tags, _TRANSFORMATION, 16, path, "ModelTransformation").reshape(4, 4)
        corner, cell, turned, upward = m[:2, 3], np.diag(m)[:2], np.array([m[1, 0], m[0, 1]]), (m[2, 2], m[2, 3])
    elif _SCALE in tags and _TIEPOINT in tags:
        pixel = numbers_of(tags, _SCALE, 3, path, "ModelPixelScale")
        i, j, k, x, y, z = numbers_of(tags, _TIEPOINT, 6, path, "ModelTiepoint")
        corner, upward = np.array([x - i * pixel[0], y + j * pixel[1]]), (pixel[2], z - k * pixel[2])
        cell, turned = np.array([pixel[0], -pixel[1]]), np.zeros(2)
    else:
        return None
    if upward[0] not in (0.0, 1.0) or upward[1] != 0.0:
        raise InputError(
            "its place has a scale or an offset of heights", file=path, found=f"{upward[0]:g} and {upward[1]:g} m",
            allowed="1 and 0", hint="apply them to the heights",
        )  # fmt: skip
    middle = 0.0 if of_points else 0.5  # of a cell, from the place in the tags to the height
    return _Place("its tags", corner + middle * (cell + turned[::-1]), cell, turned)


def _from_note(noted: dict[str, str], path: Path) -> _Place | None:
    """The place of GDAL's GeoTransform, which is that of the corner of the first cell."""
    if "GeoTransform" not in noted:
        return None
    x, dx, x_by_row, y, y_by_column, dy = _six(noted["GeoTransform"].split(","), path, key="GeoTransform")
    cell, turned = np.array([dx, dy]), np.array([y_by_column, x_by_row])
    return _Place("its .aux.xml", np.array([x, y]) + 0.5 * (cell + turned[::-1]), cell, turned)


def _from_world_file(file: Path) -> _Place:
    """The place of the middle of the first cell."""
    words = read_text(file, what="world", formats="six numbers").replace(",", ".").split()
    dx, y_by_column, x_by_row, dy, x, y = _six(words, file, key="its lines")
    return _Place(file.name, np.array([x, y]), np.array([dx, dy]), np.array([y_by_column, x_by_row]))


def _six(words: list[str], path: Path, *, key: str) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != 6 or not np.isfinite(found).all():
        raise InputError("is not a place", file=path, key=key, found=" ".join(words)[:60], allowed="six numbers")
    return found


def _check_same(one: _Place, other: _Place, path: Path) -> None:
    """Check that two sources agree to a hundredth of a cell."""
    finest = _SAME_WITHIN * float(np.abs(one.cell).max())
    apart = np.abs(np.concatenate((one.first - other.first, one.cell - other.cell, one.turned - other.turned)))
    if (apart > finest).any():
        said = (f"{place.first[0]:.8g}, {place.first[1]:.9g} with cells of {place.cell[0]:g}" for place in (one, other))
        found = " and ".join(f"{words} in {place.source}" for words, place in zip(said, (one, other), strict=True))
        raise InputError("says two things", file=path, key="its place", found=found, hint="delete the wrong one")


def _checked_cell(place: _Place, path: Path) -> float:
    """The distance between heights [m], of a place with square cells along x and y, from the north-west on."""
    if np.abs(place.turned).sum() > _SQUARE_WITHIN * abs(place.cell[0]):
        raise InputError("is turned against north", file=path, hint="resample it along x and y")
    across, down = float(place.cell[0]), -float(place.cell[1])
    wrong = [("columns from east to west", across), ("rows from south to north", down)]
    if flipped := [words for words, step in wrong if step < 0.0]:
        raise InputError(
            "is flipped", file=path, found=" and ".join(flipped), allowed="from west to east, north to south",
            hint="gdalwarp turns it",
        )  # fmt: skip
    if min(across, down) == 0.0 or abs(across - down) > _SQUARE_WITHIN * across:
        raise InputError("its cells are not square", file=path, found=f"{across:g} x {down:g} m", hint="resample it")
    return across
