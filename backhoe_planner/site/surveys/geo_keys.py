"""The keys of a GeoTIFF (OGC 19-008r4, GeoTIFF Standard 1.1), and the check that they say metres."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from backhoe_planner.errors import InputError
from backhoe_planner.site.surveys.epsg_units import is_height_in_metres, is_projected_in_metres
from backhoe_planner.site.surveys.tiff_directory import Tags

# numbers of tags and keys in the standard
_KEYS, _NUMBERS, _WORDS = 34735, 34736, 34737
_MODEL, _RASTER, _GEODETIC, _PROJECTED, _UNIT, _UNIT_SIZE = 1024, 1025, 2048, 3072, 3076, 3077
_VERTICAL, _VERTICAL_UNIT = 4096, 4099
_GEOGRAPHIC, _GEOCENTRIC, _POINT, _METRE = 2, 3, 2, 9001
_OWN = 32767  # code of what is not in the registry
_NONE = (0, _OWN)  # codes that name nothing in the registry
# in the name of a projection, such as "California zone 5 (ftUS)", or in its text: UNIT["Foot_US",0.30480060960121924]
_FEET = re.compile(r"\b(?:ft|ftUS|foot|feet)\b|\bfoot_|0\.30480?\d*", re.IGNORECASE)
_REMEDY = "gdalwarp -t_srs makes metres along x and y of it, gdal_calc.py of its heights"
_SAY = "gdal_edit.py -a_srs writes another one, with the key ProjLinearUnits, which is 9001 for metres"


class GeoKeys:
    """The keys of a GeoTIFF."""

    def __init__(self, tags: Tags, path: Path) -> None:
        """Read the keys of an image.

        Raises
        ------
        InputError: they are damaged.
        """
        self._path = path
        self.words = str(tags.get(_WORDS, ""))
        keys = np.atleast_1d(np.array(tags.get(_KEYS, ()), dtype=int))
        numbers = np.atleast_1d(np.array(tags.get(_NUMBERS, ()), dtype=float))
        self._values: dict[int, float] = {}
        for key, where, _, value in keys[4 : len(keys) // 4 * 4].reshape(-1, 4).tolist():
            if where == 0:
                self._values[key] = value
            elif where == _NUMBERS and value < len(numbers):
                self._values[key] = numbers[value]

    @property
    def places_are_points(self) -> bool:
        """Whether a height is that of its place, not of the area around it."""
        return self._values.get(_RASTER) == _POINT

    @property
    def has_system(self) -> bool:
        """Whether a key names a reference system, or the unit of x and y."""
        return any(key in self._values for key in (_GEODETIC, _PROJECTED, _UNIT))

    def check_metres(self) -> None:
        """Check that x, y and heights are in metres, as far as the keys say.

        Raises
        ------
        InputError: they are in other units, or in those of a system that is not known.
        """
        model, path = self._values.get(_MODEL), self._path
        projected = self._values.get(_PROJECTED, 0)
        if model == _GEOGRAPHIC or (model in (None, *_NONE) and _GEODETIC in self._values and not projected):
            raise InputError("is in degrees", file=path, allowed="metres", hint="project it, such as to UTM")
        if model == _GEOCENTRIC:
            raise InputError("is in coordinates from the centre of the earth", file=path, hint="project it, as to UTM")
        self._check_plane(int(projected))
        self._check_heights(int(self._values.get(_VERTICAL, 0)))

    def _check_plane(self, code: int) -> None:
        unit, path = self._values.get(_UNIT), self._path
        if unit == _OWN and self._values.get(_UNIT_SIZE) == 1.0:
            unit = _METRE
        if unit not in (None, _METRE):
            found = f"unit {unit:g} of the EPSG registry"
            raise InputError("is not in metres", file=path, found=found, allowed="metres (9001)", hint=_REMEDY)
        in_metres = None if code in _NONE else is_projected_in_metres(code)
        if in_metres is False:
            found = f"EPSG {code}, which is in feet or another unit"
            raise InputError("is not in metres", file=path, found=found, allowed="metres", hint=_REMEDY)
        if unit == _METRE or in_metres:
            return
        if _FEET.search(self.words):
            found = self.words.strip("\0| \n")
            raise InputError("is not in metres", file=path, found=found, allowed="metres", hint=_REMEDY)
        if code not in _NONE:
            found = f"EPSG {code}, whose unit is not known here"
            raise InputError("does not say that it is in metres", file=path, found=found, allowed="metres", hint=_SAY)

    def _check_heights(self, code: int) -> None:
        unit, path = self._values.get(_VERTICAL_UNIT), self._path
        if unit not in (None, _METRE):
            found = f"unit {unit:g} of the EPSG registry"
            raise InputError(
                "its heights are not in metres", file=path, found=found, allowed="metres (9001)", hint=_REMEDY
            )
        in_metres = None if code in _NONE else is_height_in_metres(code)
        if in_metres is False:
            found = f"EPSG {code}, which is in feet or downwards"
            raise InputError(
                "its heights are not in metres upwards", file=path, found=found, allowed="metres", hint=_REMEDY
            )
        if code not in _NONE and in_metres is None and unit is None:
            found = f"EPSG {code}, whose unit is not known here"
            hint = "gdal_edit.py -a_srs writes another one, with the key VerticalUnits, which is 9001 for metres"
            raise InputError(
                "does not say that its heights are in metres", file=path, found=found, allowed="metres", hint=hint
            )


def numbers_of(tags: Tags, tag: int, count: int, path: Path, key: str) -> Any:
    """(count,) the numbers of a tag.

    Raises
    ------
    InputError: there are fewer, or one is not finite.
    """
    value = tags[tag]
    try:
        found = np.atleast_1d(np.array(value, dtype=float))
    except (TypeError, ValueError):
        found = np.zeros(0)
    if len(found) < count or not np.isfinite(found[:count]).all():
        raise InputError("is not what the tag holds", file=path, key=key, found=str(value), allowed=f"{count} numbers")
    return found[:count]
