"""The parts of a task in the scene file: start, goals, path, conditions to keep."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, Discriminator, Tag, field_validator, model_validator

from backhoe_planner.arrays import Matrix
from backhoe_planner.files.records import Record, exactly_one
from backhoe_planner.machine import Tilt, TipTarget
from backhoe_planner.site.schema.quantities import (
    Angle,
    Direction,
    Finite,
    Length,
    PitchRange,
    Positive,
    Quaternion,
    RollPitchYaw,
    Vector3,
    rotation_matrix,
    unit_quaternion,
)

_UPRIGHT = 1e-12  # of a cosine: a frame whose z axis leans less counts as upright
SLOWEST = 1e-4  # m/s of the tip; chosen: no digging is as slow


def _is_place(found: object) -> bool:
    """Whether this is the place of a tip, right or wrong, without the key that says so."""
    if not isinstance(found, (list, tuple)):
        return False
    has_number = any(type(one) in (int, float) for one in found)
    return has_number and not any(isinstance(one, (list, tuple, Mapping, Record)) for one in found)


def _as_position(found: Sequence[Any]) -> str:
    """How a place without its key is written; with its own numbers, if these are a position."""
    is_position = len(found) == 3 and all(type(one) in (int, float) and math.isfinite(one) for one in found)
    return f"{{position: {list(found) if is_position else '[x, y, z]'}}}"


def _no_places(found: Any) -> Any:
    """A list of waypoints or goals, unless there are several and none of them has keys."""
    if _is_place(found):
        raise ValueError(f"is a list of numbers; allowed: [{_as_position(found)}, ...]")
    if isinstance(found, (list, tuple)) and len(found) > 1 and all(map(_is_place, found)):
        raise ValueError(f"are lists of numbers; allowed: [{_as_position(found[0])}, ...]")
    return found


class Pose(Record):
    """A pose of the tip, which may be specified in part."""

    position: Vector3
    """x, y, z of the tip [m], world."""
    pitch: Finite | PitchRange | None = None
    """Angle of the line from bucket pin to tip above the horizontal [rad]: a number, or [low, high]."""
    rpy: RollPitchYaw | None = None
    """Full orientation as roll, pitch, yaw about the fixed x, y, z axes [rad]."""
    quaternion: Quaternion | None = None
    """Full orientation [w, x, y, z]."""

    _check_quaternion = field_validator("quaternion")(unit_quaternion)

    @model_validator(mode="before")
    @classmethod
    def _has_keys(cls, found: Any) -> Any:
        if _is_place(found):
            raise ValueError(f"is a list of numbers; allowed: {_as_position(found)}")
        return found

    @model_validator(mode="after")
    def _one_orientation(self) -> Pose:
        given = [key for key in ("pitch", "rpy", "quaternion") if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"only one of pitch, rpy, quaternion may be given, here are {' and '.join(given)}")
        if self.pitch is not None and max(map(abs, np.atleast_1d(self.pitch))) > 2.0 * math.pi:
            raise ValueError(f"pitch is in radians, within one turn either way; {self.pitch} looks like degrees")
        if isinstance(self.pitch, tuple) and self.pitch[0] > self.pitch[1]:
            raise ValueError(f"pitch range [low, high] is reversed: {list(self.pitch)}")
        return self

    @property
    def pitch_range(self) -> tuple[float, float] | None:
        """(low, high) [rad], equal for a single angle; None if free."""
        if self.pitch is None:
            return None
        return self.pitch if isinstance(self.pitch, tuple) else (self.pitch, self.pitch)

    @property
    def rotation(self) -> Matrix | None:
        """(3, 3) R_world_tip, or None if free."""
        return rotation_matrix(self.rpy, self.quaternion)

    @property
    def target(self) -> TipTarget:
        """The pose as a target of the tip."""
        return TipTarget(position=np.array(self.position), pitch=self.pitch_range, rotation=self.rotation)


class KeepRotation(Record):
    """An orientation of the tip that is kept within a cone."""

    rpy: RollPitchYaw | None = None
    """Roll, pitch, yaw about the fixed x, y, z axes [rad]."""
    quaternion: Quaternion | None = None
    """[w, x, y, z]"""
    tolerance: Angle
    """How far the tip may be turned from it [rad]."""

    _check_quaternion = field_validator("quaternion")(unit_quaternion)
    _one = exactly_one("rpy", "quaternion")

    @property
    def rotation(self) -> Matrix:
        """(3, 3) R_world_tip."""
        found = rotation_matrix(self.rpy, self.quaternion)
        assert found is not None
        return found


class TiltRange(Record):
    """How far an axis of the tip may be from a direction of the world. The heading about the direction is free."""

    axis: Direction = (0.0, 0.0, 1.0)
    """x, y, z in the tip's frame, of any length but 0."""
    direction: Direction = (0.0, 0.0, 1.0)
    """x, y, z in the world, of any length but 0; up by default."""
    tolerance: Angle
    """Largest angle between the two [rad]."""

    @property
    def tilt(self) -> Tilt:
        """The same as a part of a target."""
        return Tilt(np.array(self.axis), np.array(self.direction), self.tolerance)


class Keep(Record):
    """Conditions that hold along the whole motion, so that a full bucket does not spill."""

    pitch: PitchRange | None = None
    """[low, high] of the angle of the line from bucket pin to tip above the horizontal [rad]."""
    above: Finite | None = None
    """Least height z of the tip [m], world."""
    below: Finite | None = None
    """Greatest height z of the tip [m], world."""
    rotation: KeepRotation | None = None
    """Orientation of the tip, with its heading."""
    tilt: TiltRange | None = None
    """Tilt of the tip, such as that of a cup, whatever its heading."""

    @model_validator(mode="after")
    def _something(self) -> Keep:
        if not any(one is not None for one in (self.pitch, self.above, self.below, self.rotation, self.tilt)):
            raise ValueError("at least one of pitch, above, below, rotation, tilt must be given")
        if self.pitch is not None:
            low, high = self.pitch
            if low > high:
                raise ValueError(f"pitch range [low, high] is reversed: {[low, high]}")
            if max(abs(low), abs(high)) > 2.0 * math.pi:
                raise ValueError(f"pitch is in radians, within one turn either way; {[low, high]} looks like degrees")
            if high - low >= 2.0 * math.pi:
                raise ValueError(f"a pitch range of a whole turn keeps nothing: {[low, high]}")
        if self.above is not None and self.below is not None and self.above > self.below:
            raise ValueError(f"no height is above {self.above:g} and below {self.below:g}")
        return self


class TiltedPose(Pose):
    """A pose of the tip that may have a tilt in place of an orientation."""

    tilt: TiltRange | None = None
    """Tilt of the tip, in place of pitch, rpy or quaternion: the heading is free."""

    @model_validator(mode="after")
    def _tilt_alone(self) -> TiltedPose:
        given = [key for key in ("pitch", "rpy", "quaternion") if getattr(self, key) is not None]
        if self.tilt is not None and given:
            raise ValueError(f"only one of pitch, rpy, quaternion, tilt may be given, here are {given[0]} and tilt")
        return self

    @property
    def target(self) -> TipTarget:
        """The pose as a target of the tip, with the tolerance of the tilt."""
        return replace(super().target, tilt=None if self.tilt is None else self.tilt.tilt)


class Goal(TiltedPose):
    """The pose at which the tip arrives."""

    rotation_tolerance: Angle | None = None
    """How far the orientation may be off rpy or quaternion [rad]; 0.01 by default."""
    tolerance: Length | None = None
    """How far the tip may be off the position [m]; 0.001 by default, and a search is exact. The last motion uses it to
    end where it costs least, the others of a sequence to go on without a stop."""
    keep: Keep | None = None
    """Conditions along the whole motion there; the same as `keep` beside the goal, its only place for several goals."""

    @model_validator(mode="after")
    def _something_to_be_off(self) -> Goal:
        if self.rotation_tolerance is not None and self.rotation is None:
            raise ValueError("rotation_tolerance needs rpy or quaternion; a pitch has a range: pitch: [low, high]")
        return self

    @property
    def target(self) -> TipTarget:
        """The pose as a target of the tip, with no tolerance."""
        found = super().target
        return found if found.tilt is None else replace(found, tilt=replace(found.tilt, tolerance=0.0))


class JointsGoal(Record):
    """The posture at which the joints arrive."""

    joints: dict[str, Finite]
    """Position of every joint by name [rad or m]; a joint that turns without limit turns to exactly that angle."""
    keep: Keep | None = None
    """As for a goal of the tip."""


def _kind_of_goal(found: object) -> str:
    if isinstance(found, (list, tuple)) and not _is_place(found):
        return "list"
    by_joints = "joints" in found if isinstance(found, Mapping) else isinstance(found, JointsGoal)
    return "JointsGoal" if by_joints else "Goal"


# the tags are the names of the records: messages find the allowed keys by them
AnyGoal = Annotated[
    Annotated[Goal, Tag("Goal")] | Annotated[JointsGoal, Tag("JointsGoal")], Discriminator(_kind_of_goal)
]
Goals = Annotated[
    Annotated[Goal, Tag("Goal")]
    | Annotated[JointsGoal, Tag("JointsGoal")]
    | Annotated[tuple[AnyGoal, ...], BeforeValidator(_no_places), Tag("list")],
    Discriminator(_kind_of_goal),
]


class Waypoint(Pose):
    """A point of the bucket's path."""


class Start(Record):
    """The machine's posture at time 0, given by its joints or by its tip."""

    joints: dict[str, Finite] | None = None
    """Position of every joint by name [rad or m]."""
    tip: TiltedPose | None = None
    """Pose of the tip; the joints are found by inverse kinematics."""

    _one = exactly_one("joints", "tip")


class Origin(Record):
    """The frame in which a path is given: turned by `rpy`, then moved by `position`."""

    position: Vector3 = (0.0, 0.0, 0.0)
    """x, y, z of its origin [m], world."""
    rpy: RollPitchYaw = (0.0, 0.0, 0.0)
    """Its roll, pitch, yaw about the fixed x, y, z axes [rad]."""

    @model_validator(mode="after")
    def _some(self) -> Origin:
        if not self.model_fields_set:
            raise ValueError("an origin has position, rpy or both; found neither")
        return self

    @property
    def is_upright(self) -> bool:
        """Whether the frame is turned about z alone."""
        return bool(pin.rpy.rpyToMatrix(*self.rpy)[2, 2] > 1.0 - _UPRIGHT)

    def moved(self, waypoint: Waypoint) -> Waypoint:
        """A waypoint given in this frame, in the world."""
        turn = pin.rpy.rpyToMatrix(*self.rpy)
        content: dict[str, Any] = {"position": (turn @ waypoint.position + self.position).tolist()}
        if waypoint.pitch is not None:
            content["pitch"] = waypoint.pitch
        if waypoint.rotation is not None:
            turned = pin.Quaternion(turn @ waypoint.rotation).normalized()
            content["quaternion"] = [turned.w, turned.x, turned.y, turned.z]
        return Waypoint.model_validate(content)


class PathTask(Record):
    """A path that the tip follows, straight from waypoint to waypoint."""

    waypoints: Annotated[tuple[Waypoint, ...] | None, BeforeValidator(_no_places)] = None
    """At least two."""
    file: str | None = None
    """CSV with a header: x,y,z, then pitch or qw,qx,qy,qz; other columns are ignored. Relative to the scene file."""
    origin: Origin | None = None
    """The frame in which the waypoints are given; the world's by default."""
    speed: Positive | None = None
    """Speed of the tip [m/s]; by default as fast as the limits allow."""
    tolerance: Length = 0.005
    """How far the tip may be off the path where nothing is in the way [m]."""
    rotation_tolerance: Angle = 0.01
    """How far the bucket may be turned from the waypoints' angles [rad]."""
    detour: bool = True
    """May the tip leave the path to get around an obstacle?"""
    turn_on_the_spot: bool = True
    """May the joints go to another posture while the tip stands still, where the path itself has no turn there?"""
    max_joint_step: Positive | dict[str, Positive] | None = None
    """How far a joint may move from waypoint to waypoint [rad or m], one number or by joint name; default: no limit."""

    _one = exactly_one("waypoints", "file")

    @model_validator(mode="after")
    def _some_length(self) -> PathTask:
        if self.speed is not None and self.speed < SLOWEST:
            raise ValueError(f"a speed of {self.speed:.3g} m/s is slower than 0.1 mm/s")
        if self.waypoints is not None:
            if len(self.waypoints) < 2:
                raise ValueError(f"a path needs at least 2 waypoints, this one has {len(self.waypoints)}")
            kinds = {_orientation_kind(waypoint) for waypoint in self.waypoints} - {"position"}
            if len(kinds) > 1:
                raise ValueError("one path mixes pitch and full orientation")
            if "pitch" in kinds and self.origin is not None and not self.origin.is_upright:
                raise ValueError(
                    "a path whose waypoints ask for a pitch may turn about z alone; "
                    f"found origin.rpy {list(self.origin.rpy)}; allowed: [0, 0, yaw]"
                )
            length = sum(
                math.dist(a.position, b.position) for a, b in zip(self.waypoints, self.waypoints[1:], strict=False)
            )
            if length == 0.0 and not kinds:
                raise ValueError("the waypoints all lie in one point")
        return self


def _orientation_kind(pose: Pose) -> str:
    if pose.pitch is not None:
        return "pitch"
    return "position" if pose.rotation is None else "orientation"
