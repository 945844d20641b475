"""The scene file: what the machine is to do, and what stands around it.

The records below are the schema; `scene_schema` gives it as JSON Schema, `load_scene` checks
a file against it. A `Scene` is valid in itself; `motion.build_problem` checks whether it fits
a machine.
"""

from __future__ import annotations

import csv
import io
import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError, field_validator, model_validator

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError, SceneError, check_kind, check_path
from backhoe_planner.files.records import Record, describe, exactly_one, explain
from backhoe_planner.files.text_file import read_text
from backhoe_planner.files.yaml_text import KeyPath, read_yaml
from backhoe_planner.machine import TipTarget, shipped_folder
from backhoe_planner.site.names import Name, check_name
from backhoe_planner.site.obstacle_shapes import Box, HalfSpace, ObstacleSpec
from backhoe_planner.site.quantities import (
    AnyLength,
    Finite,
    Length,
    NonNegative,
    PitchRange,
    Positive,
    Quaternion,
    Vector3,
    direction,
    rotation_matrix,
    unit_quaternion,
)

_SLOWEST = 1e-4  # m/s of the tip; chosen: no digging is as slow
_ONE_POINT = 1e-6  # m: two points of a wall nearer to each other give it no direction; chosen
_AT_ORIGIN = 1e-3  # m: a wall nearer to the origin runs through the machine; chosen


class Pose(Record):
    """A pose of the tip, as much of it as is specified."""

    position: Vector3
    """x, y, z of the tip [m], world."""
    pitch: Finite | PitchRange | None = None
    """Angle of the line bucket pin to tip above the horizontal [rad]: a number, or [low, high]."""
    rpy: Vector3 | None = None
    """Full orientation as roll, pitch, yaw about the fixed x, y, z axes [rad]."""
    quaternion: Quaternion | None = None
    """Full orientation [w, x, y, z]."""

    _check_quaternion = field_validator("quaternion")(unit_quaternion)

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
        """(low, high) [rad], equal for a single angle; None where free."""
        if self.pitch is None:
            return None
        return self.pitch if isinstance(self.pitch, tuple) else (self.pitch, self.pitch)

    @property
    def rotation(self) -> Matrix | None:
        """(3, 3) R_world_tip, or None where free."""
        return rotation_matrix(self.rpy, self.quaternion)

    @property
    def target(self) -> TipTarget:
        """The pose as a target of the tip."""
        return TipTarget(position=np.array(self.position), pitch=self.pitch_range, rotation=self.rotation)


class Goal(Pose):
    """Where the tip is to arrive."""


class Waypoint(Pose):
    """A point of the bucket's path."""


class Start(Record):
    """Where the machine stands at time 0: by its joints, or by its tip."""

    joints: dict[str, Finite] | None = None
    """Position of every joint by name [rad or m]."""
    tip: Pose | None = None
    """Pose of the tip; the joints are found by inverse kinematics."""

    _one = exactly_one("joints", "tip")


class PathTask(Record):
    """A path that the tip is to follow, straight from waypoint to waypoint."""

    waypoints: tuple[Waypoint, ...] | None = None
    """At least two."""
    file: str | None = None
    """CSV with a header: x,y,z, then pitch or qw,qx,qy,qz. Relative to the scene file."""
    speed: Positive | None = None
    """Of the tip [m/s]; left out: as fast as the limits allow."""
    tolerance: Positive = 0.005
    """How far the tip may be off the path where nothing is in the way [m]."""
    detour: bool = True
    """May the tip leave the path to get around an obstacle?"""

    _one = exactly_one("waypoints", "file")

    @model_validator(mode="after")
    def _some_length(self) -> PathTask:
        if self.speed is not None and self.speed < _SLOWEST:
            raise ValueError(f"a speed of {self.speed:.3g} m/s is slower than 0.1 mm/s")
        if self.waypoints is not None:
            if len(self.waypoints) < 2:
                raise ValueError(f"a path needs at least 2 waypoints, this one has {len(self.waypoints)}")
            kinds = {_orientation_kind(waypoint) for waypoint in self.waypoints} - {"position"}
            if len(kinds) > 1:
                raise ValueError("one path mixes pitch and full orientation")
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


class Task(Record):
    """What is to be done: exactly one of goal, path."""

    goal: Goal | None = None
    path: PathTask | None = None

    _one = exactly_one("goal", "path")


class _Zone(Record):
    name: Name
    """Unique among zones and obstacles; appears in reports and in the viewer."""
    stop: NonNegative = 0.0
    """Distance that is never undercut: the zone's clearance [m], for a swing sector [rad]."""
    slow: NonNegative | None = None
    """Distance from which on the servo goes slower; `stop` by default [m], for a swing sector [rad]."""
    warn: NonNegative | None = None
    """Distance from which on it is reported; `slow` by default [m], for a swing sector [rad]."""

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
        """`slow`, or what it is by default."""
        return self.stop if self.slow is None else self.slow

    @property
    def warn_distance(self) -> float:
        """`warn`, or what it is by default."""
        return self.slow_distance if self.warn is None else self.warn


class _SolidZone(_Zone):
    links: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The only links for which it holds; all of them by default."""

    @abstractmethod
    def solid(self) -> HalfSpace | Box:
        """The space that the zone forbids, as an obstacle whose clearance is the stop distance."""

    def _beyond(self, point: Vector3, normal: Vector3) -> HalfSpace:
        return HalfSpace(
            name=self.name, shape="halfspace", point=point, normal=normal, clearance=self.stop, links=self.links
        )


class Ceiling(_SolidZone):
    """Nothing of the machine above a height."""

    kind: Literal["ceiling"]
    height: Finite
    """z [m]."""

    def solid(self) -> HalfSpace:
        """All that lies above the height."""
        return self._beyond((0.0, 0.0, self.height), (0.0, 0.0, -1.0))


class Floor(_SolidZone):
    """Nothing of the machine below a height."""

    kind: Literal["floor"]
    height: Finite
    """z [m]."""

    def solid(self) -> HalfSpace:
        """All that lies below the height."""
        return self._beyond((0.0, 0.0, self.height), (0.0, 0.0, 1.0))


class Wall(_SolidZone):
    """Nothing of the machine beyond a plane: `point` and `normal`, or upright through `from` and `to`."""

    kind: Literal["wall"]
    point: Vector3 | None = None
    """On the wall [m]."""
    normal: tuple[AnyLength, AnyLength, AnyLength] | None = None
    """Towards the machine's side; any length but 0."""
    start: tuple[Finite, Finite] | None = Field(default=None, alias="from")
    """x, y of a point on an upright wall [m]; the machine's side is that of the origin."""
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
            length = math.hypot(bx - ax, by - ay)
            if length < _ONE_POINT:
                raise ValueError("from and to are one point")
            if abs(ax * (by - ay) - ay * (bx - ax)) / length < _AT_ORIGIN:
                raise ValueError(
                    "a wall through the origin, where the machine stands, has no side of the machine: "
                    "give point and normal"
                )
        return self

    @property
    def plane(self) -> tuple[Vector3, Vector3]:
        """A point on it [m], and its unit normal towards the machine's side."""
        if self.point is not None and self.normal is not None:
            return self.point, direction(self.normal)
        assert self.start is not None
        assert self.end is not None
        (ax, ay), (bx, by) = self.start, self.end
        x, y = by - ay, ax - bx
        length = math.copysign(math.hypot(x, y), -(ax * x + ay * y))
        return (ax, ay, 0.0), (x / length, y / length, 0.0)

    def solid(self) -> HalfSpace:
        """All that lies beyond the plane."""
        return self._beyond(*self.plane)


class SwingSector(_Zone):
    """The swing, which is the first joint, only within two angles."""

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
    """A block around the operator's cab that nothing of the machine may enter."""

    kind: Literal["cab"]
    size: tuple[Length, Length, Length]
    """Edge lengths along x, y, z [m]."""
    position: Vector3
    """Of the centre [m]."""
    rpy: Vector3 | None = None
    """Roll, pitch, yaw about the fixed axes [rad]."""

    def solid(self) -> Box:
        """The block."""
        return Box(
            name=self.name, shape="box", size=self.size, position=self.position, rpy=self.rpy,
            clearance=self.stop, links=self.links,
        )  # fmt: skip


ZoneSpec = Annotated[Ceiling | Floor | Wall | SwingSector | Cab, Field(discriminator="kind")]


class Gains(Record):
    """Gains of equation (12), set by hand."""

    s_e: NonNegative = 1.0
    """Of the primary task."""
    s_o: NonNegative = 0.0
    """Of the obstacle term."""
    s_k: dict[str, NonNegative] = Field(default_factory=dict)
    """Of the directionality term, by joint name."""


class Limits(Record):
    """What of the machine's limits is to be used."""

    velocity_scale: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = 1.0
    """Part of each joint's rate that may be used."""
    acceleration: dict[str, Positive] = Field(default_factory=dict)
    """By joint name [rad/s^2 or m/s^2]; else the URDF's, else full rate in 0.5 s."""


class TrackingError(Record):
    """How far the machine may be off its plan, at every moment: what is verified holds for all such motions."""

    joints: Positive | dict[str, NonNegative]
    """Of every joint [rad or m], one number or by joint name; a joint that is not named is exact."""
    tip: Positive | None = None
    """Of the tip's position [m], where that is known to be less than what the joints' errors allow."""


class Soil(Record):
    """What the bucket digs in (fundamental earthmoving equation).

    Every key may be left out: the defaults are those of a soil of medium strength.
    """

    density: Positive = 1700.0
    """Of the soil [kg/m^3]; 1700 by default, usual are 1300 to 2000."""
    cohesion: NonNegative = 5000.0
    """What holds its grains together [Pa]; 5000 by default, 0 for dry sand, up to 50000 for clay."""
    friction: Annotated[float, Field(strict=True, gt=0.0, lt=math.pi / 2.0)] = 0.55
    """Internal friction angle [rad]; 0.55 by default, usual are 0.44 to 0.70 (25 to 40 degrees)."""
    adhesion: NonNegative = 0.0
    """Between soil and blade [Pa]; 0 by default."""
    tool_friction: Annotated[float, Field(strict=True, ge=0.0, lt=math.pi / 2.0)] | None = None
    """Between soil and blade [rad]; 2/3 of `friction` by default."""
    surface: Finite = 0.0
    """Height z of the ground, below which the soil resists [m], world; 0 by default."""
    surcharge: NonNegative = 0.0
    """Load on the ground beside the blade [Pa]; 0 by default."""
    width: Positive | None = None
    """Of the blade [m]; that of the bucket's collision shape by default."""


class Scene(Record):
    """A task, and the site in which it is to be done."""

    version: Literal[1]
    name: str = ""
    tip: str | None = None
    """The link that is moved; bucket_tip, else the only leaf frame."""
    start: Start | None = None
    """Where the machine stands; left out with a path: the planner chooses."""
    task: Task
    clearance: NonNegative = 0.05
    """Distance to be kept from every obstacle that has none of its own [m]."""
    influence: Positive = 0.6
    """Within this distance an obstacle acts on the motion [m]."""
    obstacles: tuple[ObstacleSpec, ...] = ()
    zones: tuple[ZoneSpec, ...] = ()
    """Where the machine must not be, each with the distances at which to warn, slow down and stop."""
    gains: Literal["auto"] | Gains = "auto"
    limits: Limits = Limits()
    tracking: TrackingError | None = None
    objective: Literal["velocity_norm", "kinetic", "effort", "work", "hydraulic", "time"] = "work"
    """What a plan along a path is to make small."""
    payload: NonNegative = 0.0
    """Mass in the bucket [kg]."""
    soil: Soil | None = None
    """What the bucket digs in; left out, nothing resists it. Keys of it that are left out have their defaults."""

    _folder: Path = PrivateAttr(default=Path())
    _file: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        in_use: dict[str, str] = {}
        for key in ("obstacles", "zones"):
            for index, one in enumerate(getattr(self, key)):
                check_name(one.name, in_use=in_use, key=f"{key}[{index}].name")
                in_use[one.name] = f"{key}[{index}]"
        if self.task.goal is not None and self.start is None:
            raise ValueError("start is needed with a goal: where the machine stands")
        return self

    @property
    def folder(self) -> Path:
        """Where files named in the scene are looked for."""
        return self._folder

    @property
    def file(self) -> Path | None:
        """The file from which it was read, if any."""
        return self._file

    def waypoints(self) -> tuple[Waypoint, ...]:
        """The path's waypoints, from the scene or from its path file.

        Raises
        ------
        SceneError: the path file is missing, empty, or malformed.
        """
        path = self.task.path
        if path is None:
            return ()
        if path.waypoints is not None:
            return path.waypoints
        assert path.file is not None
        file = self.folder / path.file
        waypoints = tuple(_read_path_file(file))
        try:
            PathTask.model_validate({"waypoints": waypoints})
        except ValidationError as error:
            raise SceneError(describe(error.errors()[0]), file=file) from None
        return waypoints

    def to_dict(self) -> dict[str, Any]:
        """The scene as plain data that `scene_from_dict` reads again."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file.

    Raises
    ------
    SceneError: names the file, the key's path, what was found, and what is allowed.
    """
    file = check_path(path, key="path")
    if (
        not file.exists()
        and file.parent in (Path("scenes"), Path())
        and (shipped_folder("scenes") / file.name).is_file()
    ):
        file = shipped_folder("scenes") / file.name
    content, lines = read_yaml(file)
    return scene_from_dict(content, folder=file.parent, file=file, lines=lines)


def scene_from_dict(
    content: Mapping[str, Any],
    *,
    folder: str | Path = ".",
    file: Path | None = None,
    lines: Mapping[KeyPath, int] | None = None,
) -> Scene:
    """Check a scene given as plain data.

    Parameters
    ----------
    content: keys and values as in a scene file.
    folder: where files that the scene names are looked for.
    file, lines: for messages: the file it came from, and the line of every key.

    Raises
    ------
    SceneError: names the key's path, what was found, and what is allowed.
    """
    check_kind(content, Mapping, key="content")  # type: ignore[type-abstract]
    folder = check_path(folder, key="folder")
    file = None if file is None else check_path(file, key="file")
    try:
        scene = Scene.model_validate(content)
    except ValidationError as error:
        raise SceneError(explain(error, content, root=Scene, lines=lines), file=file) from None
    scene._folder = folder
    scene._file = file
    return scene


def obstacle_from_dict(content: Mapping[str, Any]) -> ObstacleSpec:
    """Check one obstacle given as plain data, with keys and values as in a scene file.

    Raises
    ------
    InputError: names the key, what was found, and what is allowed.
    """
    try:
        spec: ObstacleSpec = _OBSTACLE.validate_python(dict(content))
    except ValidationError as error:
        what = explain(error, content, root=Scene)
        raise InputError(f"is not an obstacle: {what}", key=str(content.get("name", "obstacle"))) from None
    return spec


def scene_schema() -> dict[str, Any]:
    """The scene file's JSON Schema."""
    schema = Scene.model_json_schema(by_alias=True)
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "backhoe_planner scene"
    return schema


_OBSTACLE: TypeAdapter[Any] = TypeAdapter(ObstacleSpec)

# --- the path file ------------------------------------------------------------

_POSITION, _QUATERNION = ("x", "y", "z"), ("qw", "qx", "qy", "qz")
_COLUMNS = (*_POSITION, "pitch", *_QUATERNION)


def _read_path_file(path: Path) -> Iterator[Waypoint]:
    """The waypoints of a CSV with a header.

    Raises
    ------
    SceneError: no such file, no header, an unknown or a missing column, a cell that is not a
        finite number, a row that is no waypoint, fewer than two rows.
    """
    text = read_text(path, what="path", error=SceneError)
    try:
        rows = [(f"line {number}", row) for number, row in enumerate(csv.reader(io.StringIO(text)), start=1)]
    except csv.Error as error:
        raise SceneError(f"cannot be read: {error}", file=path) from error
    (_, header), *rows = [(line, [cell.strip() for cell in row]) for line, row in rows if any(map(str.strip, row))]
    for column in header:
        if column not in _COLUMNS:
            raise SceneError.unknown_name("unknown column", column, names=_COLUMNS, file=path, key="header")
    turned = any(column in header for column in _QUATERNION)
    missing = [column for column in (*_POSITION, *(_QUATERNION if turned else ())) if column not in header]
    if missing:
        raise SceneError(f"a column is missing: {', '.join(missing)}", file=path, key="header", found=",".join(header))
    twice = [column for column in _COLUMNS if header.count(column) > 1]
    if twice:
        raise SceneError("a column stands twice", file=path, key="header", found=", ".join(twice))
    if len(rows) < 2:
        raise SceneError("a path needs at least 2 waypoints", file=path, found=str(len(rows)))
    for line, row in rows:
        if len(row) != len(header):
            raise SceneError(f"has {len(row)} cells, the header {len(header)}", file=path, key=line)
        values = {column: _number(cell, path, f"{line}, {column}") for column, cell in zip(header, row, strict=True)}
        quaternion = tuple(values[key] for key in _QUATERNION) if turned else None
        position = tuple(values[key] for key in _POSITION)
        try:
            yield Waypoint.model_validate(
                {"position": position, "pitch": values.get("pitch"), "quaternion": quaternion}
            )
        except ValidationError as error:
            raise SceneError(describe(error.errors()[0]), file=path, key=line) from None


def _number(cell: str, path: Path, key: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise SceneError("is not a number", file=path, key=key, found=repr(cell)) from None
    if not math.isfinite(value):
        raise SceneError("is not finite", file=path, key=key, found=cell)
    return value
