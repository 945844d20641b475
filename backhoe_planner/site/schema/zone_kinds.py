"""The part of the scene file that limits where the machine may be: zones, by their kind."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from backhoe_planner.files.records import Record
from backhoe_planner.site.schema.names import Name
from backhoe_planner.site.schema.obstacle_shapes import Box, HalfSpace
from backhoe_planner.site.schema.quantities import (
    AnyLength,
    Finite,
    Length,
    NonNegative,
    RollPitchYaw,
    Vector3,
    direction,
)

_ONE_POINT = 1e-6  # m: two points of a wall that are closer give it no direction; chosen
_THROUGH = 1e-3  # m: a wall closer to the machine's root counts as going through it; chosen


class _Zone(Record):
    name: Name
    """Unique among zones and obstacles; appears in reports and in the viewer."""
    stop: NonNegative = 0.0
    """Least distance allowed, which is the zone's clearance [m], for a swing sector [rad]."""
    slow: NonNegative | None = None
    """Distance below which the servo goes slower; `stop` by default [m], for a swing sector [rad]."""
    warn: NonNegative | None = None
    """Distance below which the zone is reported; `slow` by default [m], for a swing sector [rad]."""

    @model_validator(mode="after")
    def _outward(self) -> _Zone:
        if not self.stop <= self.slow_distance <= self.warn_distance:
            raise ValueError(
                "stop, slow and warn must not fall from one to the next, "
                f"here they are {self.stop:g}, {self.slow_distance:g}, {self.warn_distance:g}"
            )
        return self

    @property
    def slow_distance(self) -> float:
        """`slow`, or its default."""
        return self.stop if self.slow is None else self.slow

    @property
    def warn_distance(self) -> float:
        """`warn`, or its default."""
        return self.slow_distance if self.warn is None else self.warn


class _SolidZone(_Zone):
    links: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The only links to which it applies; all of them by default."""

    @abstractmethod
    def solid(self, stand: tuple[float, float]) -> HalfSpace | Box:
        """The space that the zone forbids, as an obstacle whose clearance is the stop distance.

        Parameters
        ----------
        stand: x, y of the machine's root link [m].

        Raises
        ------
        ValueError: the zone is a wall on neither side of which the machine stands.
        """

    def _beyond(self, point: Vector3, normal: Vector3) -> HalfSpace:
        return HalfSpace(
            name=self.name, shape="halfspace", point=point, normal=normal, clearance=self.stop, links=self.links
        )


class Ceiling(_SolidZone):
    """No part of the machine may be above a height."""

    kind: Literal["ceiling"]
    height: Finite
    """z [m]."""

    def solid(self, stand: tuple[float, float]) -> HalfSpace:
        """The space above the height."""
        return self._beyond((0.0, 0.0, self.height), (0.0, 0.0, -1.0))


class Floor(_SolidZone):
    """No part of the machine may be below a height."""

    kind: Literal["floor"]
    height: Finite
    """z [m]."""

    def solid(self, stand: tuple[float, float]) -> HalfSpace:
        """The space below the height."""
        return self._beyond((0.0, 0.0, self.height), (0.0, 0.0, 1.0))


class Wall(_SolidZone):
    """No part of the machine may be beyond a plane: `point` and `normal`, or upright through `from` and `to`."""

    kind: Literal["wall"]
    point: Vector3 | None = None
    """A point on the wall [m]."""
    normal: tuple[AnyLength, AnyLength, AnyLength] | None = None
    """Normal of the wall, towards the machine's side; any length but 0."""
    start: tuple[Finite, Finite] | None = Field(default=None, alias="from")
    """x, y of a point on an upright wall [m]; the machine's side is that of its root link."""
    end: tuple[Finite, Finite] | None = Field(default=None, alias="to")
    """x, y of another point on it [m]."""

    @field_validator("start", "end", mode="before")
    @classmethod
    def _upright(cls, point: object) -> object:
        if isinstance(point, (list, tuple)) and len(point) == 3:
            raise ValueError(
                f"has three coordinates, allowed: two, x and y, of an upright wall; found {list(point)!r} "
                "(a wall that leans is given by point and normal)"
            )
        return point

    @model_validator(mode="after")
    def _one_of_two(self) -> Wall:
        by_normal = [self.point is not None, self.normal is not None]
        by_points = [self.start is not None, self.end is not None]
        if not ((all(by_normal) and not any(by_points)) or (all(by_points) and not any(by_normal))):
            raise ValueError("either point and normal, or from and to must be given")
        if self.normal is not None:
            direction(self.normal)
        if self.start is not None and self.end is not None:
            (ax, ay), (bx, by) = self.start, self.end
            if math.hypot(bx - ax, by - ay) < _ONE_POINT:
                raise ValueError("from and to are one point")
        return self

    def plane(self, stand: tuple[float, float]) -> tuple[Vector3, Vector3]:
        """A point on the wall [m], and its unit normal towards the machine's side; see `solid`."""
        if self.point is not None and self.normal is not None:
            return self.point, direction(self.normal)
        assert self.start is not None
        assert self.end is not None
        (ax, ay), (bx, by) = self.start, self.end
        length = math.hypot(bx - ax, by - ay)
        x, y = (by - ay) / length, (ax - bx) / length
        away = (stand[0] - ax) * x + (stand[1] - ay) * y
        if abs(away) < _THROUGH:
            raise ValueError(
                f"a wall through x {stand[0]:g}, y {stand[1]:g}, where the machine stands, has no side of the machine: "
                "give point and normal"
            )
        sense = math.copysign(1.0, away)
        return (ax, ay, 0.0), (sense * x, sense * y, 0.0)

    def solid(self, stand: tuple[float, float]) -> HalfSpace:
        """The space beyond the plane."""
        return self._beyond(*self.plane(stand))


class SwingSector(_Zone):
    """The swing, which is the first joint, must stay between two angles."""

    kind: Literal["swing_sector"]
    start: Finite = Field(alias="from")
    """Least allowed angle [rad]."""
    end: Finite = Field(alias="to")
    """Greatest allowed angle [rad]."""

    @model_validator(mode="after")
    def _some_room(self) -> SwingSector:
        if max(abs(self.start), abs(self.end)) > 4.0 * math.pi:
            raise ValueError(f"angles are in radians; {self.start:g} to {self.end:g} look like degrees")
        if self.start + self.stop >= self.end - self.stop:
            raise ValueError(
                f"from {self.start:g} to {self.end:g}, each kept off by {self.stop:g}, there is no room left"
            )
        return self


class Cab(_SolidZone):
    """A box around the operator's cab that no part of the machine may enter."""

    kind: Literal["cab"]
    size: tuple[Length, Length, Length]
    """Edge lengths along x, y, z [m]."""
    position: Vector3
    """Position of the centre [m]."""
    rpy: RollPitchYaw | None = None
    """Roll, pitch, yaw about the fixed axes [rad]."""

    def solid(self, stand: tuple[float, float]) -> Box:
        """The box."""
        return Box(
            name=self.name, shape="box", size=self.size, position=self.position, rpy=self.rpy,
            clearance=self.stop, links=self.links,
        )  # fmt: skip


ZoneSpec = Annotated[Ceiling | Floor | Wall | SwingSector | Cab, Field(discriminator="kind")]
