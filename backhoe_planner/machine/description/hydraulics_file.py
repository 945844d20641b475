"""Reading a machine's hydraulic description, a YAML file beside its URDF.

The records below are the schema. `read_hydraulics` is the only way to read one: the linkages that it
returns close, move and have a lever in every configuration that the URDF's limits allow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError, model_validator

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import RobotError
from backhoe_planner.files.numbers import number
from backhoe_planner.files.records import Record, explain
from backhoe_planner.files.yaml_text import read_yaml
from backhoe_planner.machine.description.urdf import Urdf, axis_of
from backhoe_planner.machine.description.urdf_tree import Joint
from backhoe_planner.machine.hydraulics.hydraulics import SAME_LENGTH, Cylinder, Hydraulics
from backhoe_planner.machine.hydraulics.linkage import FourBar, Triangle

_LARGEST = 1e9  # Pa, W or m^3/s: no oil line bears such a pressure, no machine has such a power or flow
# the same units: smaller ones are mistakes, and from 1e-100 on areas, forces and ratios to limits overflow; chosen
_SMALLEST = 1e-12
_SAMPLES = 1441  # angles at which a linkage is checked: every quarter of a degree of a whole turn
_ALONG_AXIS = 1e-6  # m: a pin this near the joint's axis has no lever; chosen, far below any dimension in a drawing
_NO_LEVER = 2e-3  # part of the longest lever; from one sample to the next a lever falls by less
_SAME_END = 1e-9  # m, rad: ends of strokes and of ranges that differ by less are equal but for rounding

# the shortest is far below any diameter in a drawing
Length = Annotated[float, number(ge=1e-6, le=1e3)]
Coordinate = Annotated[float, number(ge=-1e3, le=1e3)]
Positive = Annotated[float, number(ge=_SMALLEST, le=_LARGEST)]
Part = Annotated[float, number(gt=0.0, le=1.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]


class PumpRecord(Record):
    """The pump that all cylinders share."""

    flow: Positive
    """Its greatest flow [m^3/s]."""
    pressure: Positive
    """The pressure at which relief valves open [Pa]."""


class EngineRecord(Record):
    """The engine that drives the pump."""

    power: Positive
    """[W]"""
    efficiency: Part = 1.0
    """The part of the power that reaches the oil."""


class RockerRecord(Record):
    """A rocker between cylinder and link, as on a bucket.

    Its pins are given for the joint at `drawn_at`, in the frame of the link above the joint. They
    also tell on which side the mechanism is.
    """

    pivot: Point
    """The pin about which it turns [m]."""
    cylinder: Point
    """The pin of the cylinder's rod [m]."""
    link: Point
    """The pin of the link to the body below the joint [m]."""
    drawn_at: Coordinate = 0.0
    """Position of the joint for which the two pins above are given [rad]."""


class CylinderRecord(Record):
    """A cylinder. It moves the joint below the link that carries its `parent` pin."""

    name: Annotated[str, Field(min_length=1)]
    """Unique."""
    joint: str
    """The joint that it moves."""
    bore: Length
    """Diameter of the piston [m]."""
    rod: Length
    """Diameter of the rod [m]."""
    closed: Length
    """Pin-to-pin length, retracted [m]."""
    open: Length
    """Pin-to-pin length, extended [m]."""
    parent: Point
    """Pin on the link above the joint, in that link's frame [m]."""
    child: Point
    """Pin on the link below the joint, in that link's frame [m]: of the rod or, with a rocker, of its link."""
    rocker: RockerRecord | None = None
    """The rocker between cylinder and joint; left out: the cylinder is straight across the joint."""
    flow: Positive | None = None
    """The greatest flow through its valve [m^3/s]; left out: all that the pump delivers."""

    @model_validator(mode="after")
    def _sizes_fit(self) -> CylinderRecord:
        if self.rod >= self.bore:
            raise ValueError(f"rod is not thinner than bore; found {self.rod:g}; allowed: less than {self.bore:g} m")
        if self.open <= self.closed:
            raise ValueError(f"open is not longer than closed; found {self.open:g}; allowed: over {self.closed:g} m")
        return self


class HydraulicsRecord(Record):
    """The whole file."""

    version: Literal[1]
    pump: PumpRecord
    engine: EngineRecord
    cylinders: Annotated[tuple[CylinderRecord, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _unique_names(self) -> HydraulicsRecord:
        names = [cylinder.name for cylinder in self.cylinders]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise ValueError(f"two cylinders are named {name!r}")
        return self


def description_beside(urdf: Path) -> Path:
    """The path of a URDF's hydraulic description, if there is one: ``NAME.hydraulics.yaml`` beside it."""
    return urdf.with_name(f"{urdf.stem}.hydraulics.yaml")


def read_hydraulics(file: Path, urdf: Urdf, joint_names: Sequence[str]) -> Hydraulics:
    """Read and check a description against its URDF.

    Parameters
    ----------
    file: the description.
    urdf: the machine that it describes.
    joint_names: the joints that move the tip; cylinders of other joints are checked and left out.

    Raises
    ------
    RobotError: the URDF has no such joint, or the joint does not turn between limits; within the
        joint's limits the linkage does not close or passes a dead centre; the pins do not
        allow the stroke, or the stroke does not reach the joint's limits. The message names the
        file, the key, what was found and what is allowed.
    """
    content, lines = read_yaml(
        file, what="hydraulic description", keys="version, pump, cylinders, ...", error=RobotError
    )
    try:
        record = HydraulicsRecord.model_validate(content)
    except ValidationError as error:
        raise RobotError(explain(error, content, root=HydraulicsRecord, lines=lines), file=file) from None
    places = [_Place(file, f"cylinders[{index}]", spec.name) for index, spec in enumerate(record.cylinders)]
    cylinders = [
        Cylinder(
            **spec.model_dump(include={"name", "joint", "bore", "rod", "closed", "open"}),
            linkage=_linkage(spec, _turning_joint(spec.joint, urdf.joints, place), place),
            flow=record.pump.flow if spec.flow is None else min(spec.flow, record.pump.flow),
        )
        for spec, place in zip(record.cylinders, places, strict=True)
    ]
    ranges = {}
    for name in dict.fromkeys(cylinder.joint for cylinder in cylinders):
        mine = [(c, place) for c, place in zip(cylinders, places, strict=True) if c.joint == name]
        limit = urdf.joints[name].limit
        ranges[name] = _range_of_strokes(mine, float(limit.lower), float(limit.upper))
    kept = tuple(cylinder for cylinder in cylinders if cylinder.joint in joint_names)
    joint_ranges = np.array([ranges[cylinder.joint] for cylinder in kept]).reshape(-1, 2)
    joint_ranges.setflags(write=False)
    return Hydraulics(
        file=file,
        joint_names=tuple(joint_names),
        joint_ranges=joint_ranges,
        cylinders=kept,
        pump_flow=record.pump.flow,
        pressure=record.pump.pressure,
        engine_power=record.engine.power,
        efficiency=record.engine.efficiency,
    )


@dataclass(frozen=True)
class _Place:
    """The place of a cylinder in the file; makes its errors."""

    file: Path
    cylinder: str  # its key
    name: str

    def key(self, key: str) -> str:
        return f"{self.cylinder}{key and '.'}{key} ({self.name})"

    def wrong(self, problem: str, *, key: str = "", found: Any = None, allowed: str | None = None) -> RobotError:
        return RobotError(problem, file=self.file, key=self.key(key), found=found, allowed=allowed)


def _turning_joint(name: str, joints: Mapping[str, Joint], place: _Place) -> Joint:
    turning = [joint.name for joint in joints.values() if joint.type == "revolute"]
    if name not in joints:
        problem = "the URDF has no such joint"
        raise RobotError.unknown_name(problem, name, names=turning, file=place.file, key=place.key("joint"))
    if name not in turning:
        problem, found = "a cylinder moves a joint that turns between limits", f"{name}, {joints[name].type}"
        raise place.wrong(problem, key="joint", found=found, allowed=", ".join(turning) or "none")
    return joints[name]


# --- pins into the plane of the joint -----------------------------------------------


class _Plane:
    """The plane across a joint's axis, with the axis at the origin."""

    def __init__(self, joint: Joint) -> None:
        self._T_parent_joint = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=float)
        self._axis = axis_of(joint)
        first = np.eye(3)[int(np.argmin(np.abs(self._axis)))]
        u = first - (first @ self._axis) * self._axis
        self._u = u / np.linalg.norm(u)
        self._v = np.cross(self._axis, self._u)

    def of_parent(self, pin: Point) -> Vector:
        """(3,) a pin given in the frame of the link above: in the plane, then along the axis."""
        R, p = self._T_parent_joint[:3, :3], self._T_parent_joint[:3, 3]
        return self.of_child(R.T @ (np.array(pin) - p))

    def of_child(self, pin: Point | Vector) -> Vector:
        """(3,) a pin given in the frame of the link below, with the joint at 0."""
        point = np.asarray(pin, dtype=float)
        return np.array([point @ self._u, point @ self._v, point @ self._axis])


def _linkage(spec: CylinderRecord, joint: Joint, place: _Place) -> Triangle | FourBar:
    plane = _Plane(joint)
    base, moved = plane.of_parent(spec.parent), plane.of_child(spec.child)
    if spec.rocker is None:
        return _triangle(base, moved, place, "child")
    rocker = spec.rocker
    pivot, R, C = plane.of_parent(rocker.pivot), plane.of_parent(rocker.link), plane.of_parent(rocker.cylinder)
    drive = _triangle(base - pivot, C - pivot, place, "rocker.cylinder")
    r = R[:2] - pivot[:2]
    if np.hypot(*r) < _ALONG_AXIS:
        raise place.wrong("the link's pin lies on the rocker's pivot", key="rocker.link", found=list(rocker.link))
    if np.hypot(*moved[:2]) < _ALONG_AXIS:
        raise place.wrong("the pin lies on the joint's axis", key="child", found=list(spec.child))
    cos, sin = math.cos(rocker.drawn_at), math.sin(rocker.drawn_at)
    B = np.array([cos * moved[0] - sin * moved[1], sin * moved[0] + cos * moved[1]])
    AB = B - pivot[:2]
    return FourBar(
        pivot=(float(pivot[0]), float(pivot[1])),
        rocker=float(np.hypot(*r)),
        link=float(np.hypot(*(R[:2] - B))),
        pin=float(np.hypot(*moved[:2])),
        pin_angle=math.atan2(moved[1], moved[0]),
        side=1.0 if AB[0] * r[1] - AB[1] * r[0] >= 0.0 else -1.0,
        # the drive's own angle is measured to the cylinder's pin, theta to the link's pin
        drive=Triangle(drive.a, drive.b, drive.phi0 - math.atan2(r[1], r[0]), drive.offset),
    )


def _triangle(base: Vector, moved: Vector, place: _Place, moved_key: str) -> Triangle:
    """The triangle of a cylinder between its pin `base` (3,) on the parent, and `moved` (3,), given by `moved_key`."""
    a, b = float(np.hypot(base[0], base[1])), float(np.hypot(moved[0], moved[1]))
    for length, key in ((a, "parent"), (b, moved_key)):
        if length < _ALONG_AXIS:
            raise place.wrong("the pin has no lever: it lies on the axis about which the cylinder turns", key=key)
    phi0 = math.atan2(moved[1], moved[0]) - math.atan2(base[1], base[0])
    return Triangle(a, b, math.remainder(phi0, 2.0 * math.pi), float(moved[2] - base[2]))


# --- what the strokes allow -----------------------------------------------------------


def _range_of_strokes(cylinders: Sequence[tuple[Cylinder, _Place]], lower: float, upper: float) -> tuple[float, float]:
    """The range of a joint in which all its cylinders are within their strokes [rad]."""
    _check_linkages(cylinders, lower, upper)
    alone = len(cylinders) == 1
    middle = 0.5 * (lower + upper)
    ends: list[float] = []
    for cylinder, place in cylinders:
        shortest, longest = cylinder.linkage.length_range
        closed, opened = cylinder.closed, cylinder.open
        # if two cylinders move one joint, one of them may pass the dead centre at which it is shortest
        if alone and closed < shortest:
            allowed = f"{shortest:.4f} m or more"
            raise place.wrong(
                "is shorter than the least possible distance of the pins", key="closed", found=closed, allowed=allowed
            )
        if opened > longest:
            allowed = f"{longest:.4f} m or less"
            raise place.wrong(
                "is longer than the greatest possible distance of the pins", key="open", found=opened, allowed=allowed
            )
        at_limits = cylinder.linkage.length(np.linspace(lower, upper, _SAMPLES))
        for key, end, beyond in (
            ("closed", closed, float(np.min(at_limits))),
            ("open", opened, float(np.max(at_limits))),
        ):
            if (beyond < end - _SAME_END) if key == "closed" else (beyond > end + _SAME_END):
                raise place.wrong(
                    f"the stroke does not reach the joint's limits in the URDF, {_degrees(lower)} to {_degrees(upper)}",
                    key=key,
                    found=end,
                    allowed=f"{beyond:.4f} m or {'less' if key == 'closed' else 'more'}",
                )
            found = cylinder.linkage.angles(np.array(end))
            found = found + 2.0 * np.pi * np.round((middle - found) / (2.0 * np.pi))
            on_branch = np.abs(cylinder.linkage.length(found) - end) < SAME_LENGTH
            ends += [float(angle) for angle in found[on_branch]]
    below = [end for end in ends if end <= lower + _SAME_END]
    above = [end for end in ends if end >= upper - _SAME_END]
    if not below or not above:
        raise cylinders[0][1].wrong(
            "the strokes do not limit the joint at both ends: the linkage reaches its own limit first",
            found=f"ends at {', '.join(_degrees(end) for end in sorted(ends)) or 'no angle'}",
            allowed=f"one at {_degrees(lower)} or below, one at {_degrees(upper)} or above",
        )
    reached = (max(below), min(above))
    _check_linkages(cylinders, *reached)
    return reached


def _check_linkages(cylinders: Sequence[tuple[Cylinder, _Place]], lower: float, upper: float) -> None:
    """Check that every linkage closes from `lower` to `upper`, and that one of them always has a lever."""
    angles = np.linspace(lower, upper, _SAMPLES)
    arms = np.stack([cylinder.linkage.arm(angles) for cylinder, _ in cylinders])
    for arm, (_, place) in zip(arms, cylinders, strict=True):
        if np.any(np.isnan(arm)):
            at = float(angles[int(np.argmax(np.isnan(arm)))])
            raise place.wrong(
                f"the pins cannot close the four-bar at {_degrees(at)}",
                key="rocker",
                found=f"open at {at:.4f} rad",
                allowed=f"closed from {_degrees(lower)} to {_degrees(upper)}",
            )
    # a single cylinder is stuck where its lever changes sign; of two, one may help the other across
    alone = len(cylinders) == 1
    sense, levers = np.sign(arms[0]), np.max(np.abs(arms), axis=0)
    stuck = sense != sense[len(angles) // 2] if alone else levers < _NO_LEVER * np.max(levers)
    if np.any(stuck):
        at = float(angles[int(np.argmin(np.where(stuck, np.abs(angles - angles[len(angles) // 2]), np.inf)))])
        raise cylinders[0][1].wrong(
            f"the linkage passes a dead centre near {_degrees(at)}, where the cylinder has no lever",
            found=f"{at:.4f} rad",
            allowed=f"a lever from {_degrees(lower)} to {_degrees(upper)}",
        )


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.1f} deg"
