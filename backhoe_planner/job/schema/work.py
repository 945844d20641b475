"""The part of the job file that says what is dug, in what soil, and where the soil goes."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from backhoe_planner.arrays import Vector
from backhoe_planner.files.numbers import number
from backhoe_planner.files.records import Record, exactly_one
from backhoe_planner.site import Finite, MapPoint, Slope, Soil

_LEAST_BUCKET = 0.002  # m^3; chosen: no cut is found that takes much less
_LARGEST = 1e3  # m or m^3; no bucket, trench or truck is larger
_STEEPEST = 1.0  # m per m of a trench's bottom; chosen: no bucket follows a steeper one
_Length = Annotated[float, number(gt=0.0, le=_LARGEST)]
_Point = tuple[Finite, Finite]
_WALL = 0.08  # m, thickness of the walls of a truck bed; chosen
ROUGHNESS = 0.15  # m above the ground that clods and grass reach; chosen
_THINNEST = 0.02  # m, depth of a cut that is prescribed; chosen: teeth leave furrows as deep
_ONE_POINT = 0.05  # m: a trench is at least as long as a cell of the ground


class JobSoil(Soil):
    """The soil that is dug: its resistance, and how it behaves once it is loose."""

    swell: Annotated[float, number(ge=1.0, le=2.0)] = 1.25
    """Loose volume divided by the volume in the ground; 1.25 by default, usually 1.1 (sand) to 1.4 (clay)."""
    repose: Annotated[Slope, Field(gt=0.0, le=1.5)] = 0.6
    """Slope angle at which a heap of the soil comes to rest [rad]; 0.6 by default, usually 0.5 to 0.8."""


class Trench(Record):
    """A straight trench with upright walls."""

    start: _Point = Field(alias="from")
    """x, y of the middle of one end [m]."""
    end: _Point = Field(alias="to")
    """x, y of the middle of the other end [m]."""
    width: _Length
    """Width [m]; at least that of the bucket."""
    depth: _Length
    """Depth of the bottom below the job's own ground at `from` [m]; uneven ground elsewhere does not change it."""
    slope: Annotated[float, number(ge=-_STEEPEST, le=_STEEPEST)] = 0.0
    """Fall of the bottom from `from` towards `to` [m per m]; 0 by default."""
    tolerance: Annotated[float, number(gt=0.0, le=0.5)] = 0.05
    """How far the bottom may be above or below the design [m]."""

    @model_validator(mode="after")
    def _some_length(self) -> Trench:
        if self.length < _ONE_POINT:
            raise ValueError(f"from and to are {self.length:g} m apart; allowed: at least {_ONE_POINT:g} m")
        deepest = self.depth + max(self.slope, 0.0) * self.length
        if deepest <= self.tolerance:
            raise ValueError(
                f"is at most {deepest:g} m deep, which is within the tolerance of {self.tolerance:g} m: "
                "there is nothing to dig"
            )
        if self.depth + self.slope * self.length <= 0.0:
            raise ValueError(
                f"a slope of {self.slope:g} brings the bottom above the ground at `to`: the design would lie "
                f"{-(self.depth + self.slope * self.length):.2f} m above it"
            )
        return self

    @property
    def length(self) -> float:
        """Distance from end to end [m]."""
        return math.dist(self.start, self.end)

    @property
    def ahead(self) -> Vector:
        """(2,) unit vector from `from` to `to`."""
        return np.subtract(self.end, self.start) / self.length


class Surface(Record):
    """A design surface that the ground is cut down to."""

    file: str
    """CSV of heights z [m] without header, rows along y, columns along x; empty where nothing is to be dug."""
    low: _Point
    """x, y of the first height [m]."""
    cell: Annotated[float, number(ge=0.005, le=5.0)]
    """Distance between neighbouring heights [m]."""
    tolerance: Annotated[float, number(gt=0.0, le=0.5)] = 0.05
    """How far the ground may be above or below the design [m]."""


class Dig(Record):
    """What is to be dug: exactly one of trench, surface."""

    trench: Trench | None = None
    surface: Surface | None = None

    _one = exactly_one("trench", "surface")

    @property
    def tolerance(self) -> float:
        """How far the ground may be above or below the design [m]."""
        found = self.trench if self.trench is not None else self.surface
        assert found is not None
        return found.tolerance


def _kind_of_place(value: Any) -> str:
    is_list = isinstance(value, (list, tuple)) and any(isinstance(one, (list, tuple)) for one in value)
    return "places" if is_list else "place"


class Heap(Record):
    """A heap of spoil on the ground."""

    at: Annotated[
        Annotated[_Point, Tag("place")]
        | Annotated[tuple[_Point, ...], Field(min_length=1, max_length=50), Tag("places")],
        Discriminator(_kind_of_place),
    ]
    """x, y where soil is dumped [m]; or a list of such places, from which the planner chooses for every cycle."""
    edge_distance: Annotated[float, number(ge=0.0, le=_LARGEST)] = 1.0
    """Distance between the foot of the heap and the edge of the excavation [m]; 1 by default."""

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """Every place at which soil may be dumped."""
        first = self.at[0]
        if isinstance(first, tuple):
            return self.at  # type: ignore[return-value]
        return (self.at,)  # type: ignore[return-value]


class TruckBed(Record):
    """The bed of a truck: a floor with a wall on every side."""

    position: tuple[Finite, Finite, Finite]
    """x, y, z of the middle of the floor [m]."""
    size: tuple[_Length, _Length, _Length]
    """Inner length along its own x, width along its own y, height of its walls [m]."""
    yaw: Annotated[float, number(ge=-2.0 * math.pi, le=2.0 * math.pi)] = 0.0
    """Rotation about z [rad]."""

    def walls(self) -> list[dict[str, Any]]:
        """The four walls as obstacles of a scene: outside of the inner size, from the floor up."""
        (x, y, z), (length, width, height) = self.position, self.size
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        found = []
        for name, off, size in (
            ("front wall of the truck", (0.5 * (length + _WALL), 0.0), (_WALL, width + 2.0 * _WALL, height)),
            ("rear wall of the truck", (-0.5 * (length + _WALL), 0.0), (_WALL, width + 2.0 * _WALL, height)),
            ("left wall of the truck", (0.0, 0.5 * (width + _WALL)), (length + 2.0 * _WALL, _WALL, height)),
            ("right wall of the truck", (0.0, -0.5 * (width + _WALL)), (length + 2.0 * _WALL, _WALL, height)),
        ):
            place = [x + cosine * off[0] - sine * off[1], y + sine * off[0] + cosine * off[1], z + 0.5 * height]
            found.append({"name": name, "shape": "box", "size": list(size), "position": place, "rpy": [0, 0, self.yaw]})
        return found


class Truck(Record):
    """Trucks that are loaded one after the other at the same place."""

    bed: TruckBed
    capacity: _Length
    """Loose soil that one truck holds [m^3]."""
    count: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    """How many trucks come."""
    exchange: Annotated[float, number(ge=0.0, le=3600.0)] = 60.0
    """Time from a full truck to the next one in its place [s]; 60 by default."""


class Dump(Record):
    """Where the soil goes: exactly one of heap, truck."""

    heap: Heap | None = None
    truck: Truck | None = None

    _one = exactly_one("heap", "truck")


class BucketSize(Record):
    """The volume that the bucket holds."""

    capacity: Annotated[float, number(ge=_LEAST_BUCKET, le=20.0)] | None = None
    """Heaped volume of loose soil [m^3]; by default that of the bucket's collision shape."""
    fill: Annotated[float, number(gt=0.0, le=1.2)] = 0.95
    """Part of the capacity that one cut fills; 0.95 by default, usually 0.8 (hard clay) to 1.0 (moist loam)."""


class Ground(Record):
    """The ground before the first cut: level, or from a survey."""

    level: Finite | None = None
    """Height z of level ground [m]; 0 if there is no file either."""
    file: str | None = None
    """Heights as CSV (rows along y, columns along x) or GeoTIFF, or a point cloud; relative to the job file."""
    map_origin: MapPoint | None = None
    """The point of the file's coordinates that is the origin of the site [m]; of a point cloud or a GeoTIFF."""
    fill: Annotated[float, number(ge=0.0, le=_LARGEST)] = 0.0
    """Holes in the file are filled from their rims up to this distance from a known column [m]; 0 by default: none."""
    roughness: Annotated[float, number(ge=0.0, le=_LARGEST)] = ROUGHNESS
    """Height above the ground up to which a point of a cloud counts as ground [m]; 0.15 by default.

    What is higher than the ground in its column and in the eight around it by more than this stands on the ground and
    is an obstacle.
    """
    cell: Annotated[float, number(ge=0.02, le=0.5)] = 0.05
    """Distance between neighbouring columns of the ground [m]; 0.05 by default."""
    low: _Point | None = None
    """Least x, y of the modelled ground [m]; by default it covers all that is dug and heaped, and 1 m around it.

    For a CSV, the place of its first height.
    """
    high: _Point | None = None
    """Greatest x, y [m]; with a file, by default that of its last height."""

    @model_validator(mode="after")
    def _one_source(self) -> Ground:
        if self.level is not None and self.file is not None:
            raise ValueError("only one of level, file may be given")
        if self.map_origin is not None and self.file is None:
            raise ValueError("map_origin is given without file")
        if self.high is not None and self.low is None:
            raise ValueError("high is given without low")
        if self.low is not None and self.high is None and self.file is None:
            raise ValueError("low is given without high")
        if self.low is not None and self.high is not None and min(
            b - a for a, b in zip(self.low, self.high, strict=True)
        ) < 2.0 * self.cell:  # fmt: skip
            raise ValueError("from low to high are less than two cells")
        return self


class Layers(Record):
    """A prescribed pattern: level layers of one depth, each from the far end to the near one."""

    layers: Annotated[float, number(ge=_THINNEST, le=2.0)]
    """Depth of a layer [m]."""


class Face(Record):
    """A prescribed pattern: the farthest part is dug down to the bottom first, then the next."""

    face: Annotated[float, number(ge=_THINNEST, le=2.0)]
    """Greatest depth of one cut below the ground, smoothed over 0.3 m [m].

    It is more where a cut passes the step that an earlier one has left.
    """


_NAMED_PATTERNS = ("auto", "plain")


def _kind_of_pattern(value: Any) -> str:
    kinds = {"layers": "Layers", "face": "Face"}
    if isinstance(value, Mapping):
        found = [kind for key, kind in kinds.items() if key in value]
        return found[0] if len(found) == 1 else ""
    return type(value).__name__


def _some_pattern(value: Any) -> Any:
    if value not in _NAMED_PATTERNS and _kind_of_pattern(value) not in ("Layers", "Face"):
        raise ValueError(
            f"is no pattern; found {reprlib.repr(value)}; allowed: auto, plain, {{layers: DEPTH}}, {{face: DEPTH}}"
        )
    return value


PatternChoice = Annotated[
    Annotated[Literal["auto", "plain"], Tag("str")] | Annotated[Layers, Tag("Layers")] | Annotated[Face, Tag("Face")],
    Discriminator(_kind_of_pattern),
    BeforeValidator(_some_pattern),
]
