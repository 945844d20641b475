"""The scene file: what the machine is to do, and what stands around it.

The records below, and those of `schema`, are the schema; `scene_schema` gives it as JSON Schema,
`load_scene` checks a file against it. A `Scene` is valid in itself; `motion.build_problem` checks
whether it fits a machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError, model_validator

from backhoe_planner.errors import InputError, SceneError, check_kind, check_path
from backhoe_planner.files.records import Record, describe, explain
from backhoe_planner.files.yaml_text import KeyPath, read_yaml
from backhoe_planner.machine import shipped_folder
from backhoe_planner.site.schema.joint_limits import Limits
from backhoe_planner.site.schema.names import check_name
from backhoe_planner.site.schema.obstacle_shapes import ObstacleSpec
from backhoe_planner.site.schema.path_file import read_path_file
from backhoe_planner.site.schema.quantities import Finite, NonNegative, Positive
from backhoe_planner.site.schema.tasks import PathTask, Start, Task, Waypoint
from backhoe_planner.site.schema.zone_kinds import ZoneSpec


class Gains(Record):
    """Gains of equation (12), set by hand."""

    s_e: NonNegative = 1.0
    """Of the primary task."""
    s_o: NonNegative = 0.0
    """Of the obstacle term."""
    s_k: dict[str, NonNegative] = Field(default_factory=dict)
    """Of the directionality term, by joint name."""


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
    cohesion: Annotated[float, Field(strict=True, ge=0.0, le=1e8, allow_inf_nan=False)] = 5000.0
    """What holds its grains together [Pa]; 5000 by default, 0 for dry sand, up to 50000 for clay, 1e6 for rock."""
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
    hold: dict[str, Finite] = Field(default_factory=dict)
    """Joints of any part of the machine by name, and where they stand [rad or m]: the planner does not move them."""
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
    objective: Literal["velocity_norm", "kinetic", "effort", "work", "hydraulic", "time"] | None = None
    """What a plan is to make small; left out: the time to a goal, the work along a path."""
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

    @property
    def files(self) -> tuple[Path, ...]:
        """From which it is read: the scene file, the path file, the files of obstacles."""
        path = self.task.path
        named = [None if path is None else path.file, *(getattr(one, "file", None) for one in self.obstacles)]
        own = () if self.file is None else (self.file,)
        return (*own, *(self.folder / name for name in named if name is not None))

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
        """What of the files that the scene names is not used, in words.

        Raises
        ------
        SceneError: the path file is missing, empty, or malformed.
        """
        path = self.task.path
        return () if path is None or path.file is None else read_path_file(self.folder / path.file).warnings

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
