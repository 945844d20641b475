"""The scene file: the machine's task, and the site around it.

The records below, and those of `schema`, are the schema; `scene_schema` gives it as JSON Schema,
`load_scene` checks a file against it. A `Scene` is valid in itself; `motion.build_problem` checks
whether it fits a machine.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, TypeAdapter, ValidationError, model_validator

from backhoe_planner.errors import InputError, SceneError, check_path, nearest_name
from backhoe_planner.files.file_record import FileRecord
from backhoe_planner.files.records import Record, describe, explain
from backhoe_planner.files.yaml_text import KeyPath, read_yaml
from backhoe_planner.machine import shipped_file
from backhoe_planner.site.schema.digging import Soil
from backhoe_planner.site.schema.joint_limits import Limits
from backhoe_planner.site.schema.names import Title, check_name
from backhoe_planner.site.schema.obstacle_shapes import Mesh, ObstacleSpec
from backhoe_planner.site.schema.path_file import read_path_file
from backhoe_planner.site.schema.quantities import Finite, NonNegative, Positive, Turn, Vector3
from backhoe_planner.site.schema.sequence import ObjectiveName, Task, wide_tilt
from backhoe_planner.site.schema.tasks import PathTask, Start, Waypoint
from backhoe_planner.site.schema.zone_kinds import Wall, ZoneSpec


class Gains(Record):
    """Gains of equation (12), set by hand."""

    s_e: NonNegative = 1.0
    """Gain of the primary task."""
    s_o: NonNegative = 0.0
    """Gain of the obstacle term."""
    s_k: dict[str, NonNegative] = Field(default_factory=dict)
    """Gain of the directionality term, by joint name."""


class TrackingError(Record):
    """How far the machine may be off its plan at every moment; verification covers all such motions."""

    joints: Positive | dict[str, NonNegative]
    """Error of every joint [rad or m], one number or by joint name; a joint that is not named is exact."""
    tip: Positive | None = None
    """Error of the tip's position [m], if that is known to be less than the joints' errors allow."""


class StandingPlace(Record):
    """Where the machine stands on the site."""

    position: tuple[Finite, Finite] = (0.0, 0.0)
    """x, y of the URDF's root link [m], world."""
    heading: Turn = 0.0
    """The angle about the vertical from the world's x to the root link's [rad]."""


class Scene(FileRecord):
    """A task, and the site on which it is done."""

    version: Literal[1]
    name: Title = ""
    tip: str | None = None
    """The link that is moved; by default bucket_tip, or else the only leaf frame."""
    hold: dict[str, Finite] = Field(default_factory=dict)
    """Joints that the planner does not move, of any part of the machine, by name with their positions [rad or m]."""
    base: StandingPlace = StandingPlace()
    """Where the machine stands; if left out, its root link has the world's axes."""
    start: Start | None = None
    """The machine's posture at the start; if left out with a path, the planner chooses it."""
    task: Task
    clearance: NonNegative = 0.05
    """Distance to be kept from every obstacle that has no clearance of its own [m]."""
    influence: Positive = 0.6
    """Distance within which an obstacle acts on the motion [m]."""
    obstacles: tuple[ObstacleSpec, ...] = ()
    zones: tuple[ZoneSpec, ...] = ()
    """Zones that limit where the machine may be, each with the distances at which to warn, slow down and stop."""
    gains: Literal["auto"] | Gains = "auto"
    limits: Limits = Limits()
    tracking: TrackingError | None = None
    objective: ObjectiveName | None = None
    """What a plan minimises; by default the time to a goal, and the work along a path."""
    payload: NonNegative = 0.0
    """Mass in the bucket [kg]."""
    payload_at: Vector3 | None = None
    """Centre of that mass from the tip, in the tip's axes [m]; at the tip by default."""
    soil: Soil | None = None
    """The soil that the bucket digs in; if left out, nothing resists. Keys that are left out have their defaults."""

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        in_use: dict[str, str] = {}
        for key in ("obstacles", "zones"):
            for index, one in enumerate(getattr(self, key)):
                check_name(one.name, in_use=in_use, key=f"{key}[{index}].name")
                in_use[one.name] = f"{key}[{index}]"
        for index, zone in enumerate(self.zones):
            if isinstance(zone, Wall):
                try:
                    zone.plane(self.base.position)
                except ValueError as error:
                    raise ValueError(f"zones[{index}]: {error}") from None
        if self.start is None:
            if self.task.goal is not None:
                raise ValueError("a goal needs start: where the joints or the tip are at first")
            if self.task.sequence is not None and self.task.sequence[0].path is None:
                raise ValueError(
                    "a sequence whose first leg is not a path needs start: where the joints or the tip are at first"
                )
        legs = self.task.leg_names
        for index, obstacle in enumerate(self.obstacles):
            for leg in obstacle.legs or ():
                if leg not in legs:
                    raise _unknown_leg(f"obstacles[{index}] ({obstacle.name}).legs", leg, legs)
        return self

    @property
    def title(self) -> str:
        """The name; without one that of the scene's file, without its ending."""
        return self.name or ("untitled scene" if self.file is None else self.file.stem)

    @property
    def objective_or_default(self) -> ObjectiveName:
        """The name of what a plan minimises: by default the time, along a path the work."""
        return self.objective or ("time" if self.task.path is None else "work")

    @property
    def files(self) -> tuple[Path, ...]:
        """The files from which the scene is read: the scene file, the path file, the files of obstacles."""
        named = [
            *(path.file for path in self._paths),
            *(getattr(one, "file", None) for one in self._shapes),
        ]
        own = () if self.file is None else (self.file,)
        return (*own, *(self.folder / name for name in named if name is not None))

    @property
    def _shapes(self) -> tuple[ObstacleSpec, ...]:
        """The obstacles, and what the legs of a sequence carry."""
        loads = (leg.carries for leg in self.task.sequence or () if leg.carries is not None)
        return (*self.obstacles, *loads)

    @property
    def _paths(self) -> tuple[PathTask, ...]:
        """The path of the task, or those of the legs of a sequence."""
        return tuple(path for path in (self.task.path, *(leg.path for leg in self.task.sequence or ())) if path)

    def waypoints(self) -> tuple[Waypoint, ...]:
        """The path's waypoints in the world, from the scene or from its path file.

        Raises
        ------
        SceneError: the path file is missing, empty, or malformed; the path's origin puts a waypoint too far away.
        """
        path = self.task.path
        if path is None:
            return ()
        waypoints, file = path.waypoints, self.file
        try:
            if waypoints is None:
                assert path.file is not None
                file = self.folder / path.file
                waypoints = read_path_file(file).waypoints
                PathTask.model_validate({"waypoints": waypoints, "origin": path.origin})
        except ValidationError as error:
            raise SceneError(describe(error.errors()[0]), file=file) from None
        if path.origin is None:
            return waypoints
        moved: list[Waypoint] = []
        for waypoint in waypoints:
            try:
                moved.append(path.origin.moved(waypoint))
            except ValidationError as error:
                problem = f"puts waypoint {len(moved) + 1} too far away: {describe(error.errors()[0])}"
                raise SceneError(problem, file=self.file, key="task.path.origin") from None
        return tuple(moved)

    def warnings(self) -> tuple[str, ...]:
        """What is not used of the files that the scene names, and tolerances that may be in other units, in words.

        Raises
        ------
        SceneError: the path file is missing, empty, or malformed.
        """
        files = dict.fromkeys(path.file for path in self._paths if path.file is not None)
        unused = (warning for file in files for warning in read_path_file(self.folder / file).warnings)
        begins = None if self.start is None or self.start.tip is None else self.start.tip.tilt
        return (*unused, *wide_tilt("start.tip.tilt", begins), *self.task.warnings())

    def open_meshes(self) -> dict[str, tuple[str, ...]]:
        """Files of meshes that are not closed, with the obstacles made of each; unreadable files are left out."""
        is_open: dict[str, bool] = {}
        found: dict[str, tuple[str, ...]] = {}
        for one in self._shapes:
            with contextlib.suppress(InputError):
                if not isinstance(one, Mesh):
                    continue
                if one.file not in is_open:  # neither place nor scale makes a difference
                    is_open[one.file] = one.is_open(self.folder)
                if is_open[one.file]:
                    found[one.file] = (*found.get(one.file, ()), one.name)
        return found

    def doubtful_meshes(self) -> tuple[str, ...]:
        """Of which mesh files another axis may be up, in words, with the key that says so."""
        found = list[str]()
        for one in self._shapes:
            with contextlib.suppress(InputError):
                if isinstance(one, Mesh) and (doubt := one.doubt(self.folder)):
                    found.append(f"the mesh {one.file} ({one.name}) {doubt}")
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """The scene as plain data that `scene_from_dict` reads again."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


def _unknown_leg(key: str, found: str, legs: tuple[str, ...]) -> ValueError:
    """The error for an obstacle that is present in a leg that the task does not have."""
    if not legs:
        return ValueError(f"{key}: only a sequence has legs; found {found!r}")
    near = nearest_name(found, legs)
    hint = f"; did you mean {near!r}?" if near else "."
    return ValueError(f"{key}: the sequence has no leg {found!r}{hint} Allowed: {', '.join(legs)}")


def load_scene(path: str | Path) -> Scene:
    """Read and check a scene file.

    Raises
    ------
    SceneError: names the file, the key's path, what was found, and what is allowed.
    """
    file = shipped_file(check_path(path, key="path"), "scenes")
    content, lines = read_yaml(file, kind="scene")
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
    folder: the folder to which file names in the scene are relative.
    file, lines: for messages: the file it came from, and the line of every key.

    Raises
    ------
    SceneError: names the key's path, what was found, and what is allowed.
    """
    return Scene.of_content(content, folder=folder, file=file, lines=lines)


def obstacle_from_dict(content: Mapping[str, Any]) -> ObstacleSpec:
    """Check one obstacle given as plain data, with keys and values as in a scene file.

    Raises
    ------
    InputError: names the key, what was found, and what is allowed.
    """
    try:
        spec: ObstacleSpec = _obstacle_adapter().validate_python(dict(content))
    except ValidationError as error:
        what = explain(error, content, root=Scene)
        raise InputError(f"is not an obstacle: {what}", key=str(content.get("name", "obstacle"))) from None
    return spec


def scene_schema() -> dict[str, Any]:
    """The scene file's JSON Schema."""
    return Scene.file_schema("scene")


@functools.cache
def _obstacle_adapter() -> TypeAdapter[Any]:
    """What reads an obstacle by itself; a scene does without."""
    return TypeAdapter(ObstacleSpec)
