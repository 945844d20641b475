"""The job file: a machine, its site, what is to be dug, and where the soil goes."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, PrivateAttr

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import SceneError, check_path
from backhoe_planner.files.file_record import FileRecord
from backhoe_planner.files.numbers import number
from backhoe_planner.files.yaml_text import KeyPath, read_yaml
from backhoe_planner.job.schema.work import BucketSize, Dig, Dump, Ground, JobSoil, PatternChoice
from backhoe_planner.machine import shipped_file
from backhoe_planner.site import Scene, Title, load_scene, scene_from_dict, scene_schema

_Amount = TypeVar("_Amount", float, Vector)

SITE_KEYS = ("base", "tip", "hold", "clearance", "influence", "obstacles", "zones", "limits", "tracking")


class Job(FileRecord):
    """A job for one machine that stays in place: all cycles from the first cut to the last."""

    version: Literal[1]
    name: Title = ""
    machine: str = "example:backhoe"
    """A URDF file, relative to the job file, or example:NAME."""
    site: str | dict[str, Any] = Field(default_factory=dict)
    """A scene file, relative to the job file, or its keys: clearance, influence, obstacles, zones, limits, ..."""
    start: dict[str, Annotated[float, number()]] | None = None
    """Position of every joint by name before the first cycle [rad or m]; by default above the first cut."""
    soil: JobSoil = JobSoil()
    ground: Ground = Ground()
    dig: Dig
    dump: Dump
    bucket: BucketSize = BucketSize()
    objective: Literal["time", "work"] = "time"
    """What is minimised per cubic metre in the ground: time or work."""
    pattern: PatternChoice = "auto"
    """Order in which the soil is cut: chosen by the planner, or prescribed; `plain` is level layers of 0.15 m."""

    _site: Scene | None = PrivateAttr(default=None)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that the job is read from: job file, scene file, and those of ground, design and obstacles."""
        own = () if self.file is None else (self.file,)
        design = None if self.dig.surface is None else self.dig.surface.file
        named = (self.ground.file, design)
        return (*own, *(self.folder / name for name in named if name is not None), *self.site_scene.files)

    @property
    def machine_source(self) -> str:
        """The machine in the form that `load_robot` accepts."""
        return self.machine if self.machine.startswith("example:") else str(self.folder / self.machine)

    @property
    def site_scene(self) -> Scene:
        """The site as a scene; its task and start are not used."""
        assert self._site is not None
        return self._site

    def objective_of(self, duration: _Amount, work: _Amount) -> _Amount:
        """What the job minimises, of a duration [s] and a work [J]."""
        return duration if self.objective == "time" else work

    @property
    def cost_unit(self) -> tuple[str, float]:
        """The unit in which costs are shown, and the factor that converts costs [s/m^3 or J/m^3] to it."""
        return ("s/m^3", 1.0) if self.objective == "time" else ("kJ/m^3", 1e-3)

    def scene_dict(self) -> dict[str, Any]:
        """A scene of this site as plain data, without start and task."""
        content = self.site_scene.to_dict()
        found = {"version": 1, "name": self.name} | {key: content[key] for key in SITE_KEYS if key in content}
        truck = self.dump.truck
        if truck is not None:
            found["obstacles"] = [*content.get("obstacles", []), *truck.bed.walls()]
        return found

    def to_dict(self) -> dict[str, Any]:
        """The job as plain data that `job_from_dict` can read; its site as keys, whatever file they came from."""
        content = self.model_dump(mode="json", by_alias=True, exclude_unset=True)
        site = self.site_scene.to_dict()
        return content | {"site": {key: value for key, value in site.items() if key in SITE_KEYS}}


def load_job(path: str | Path) -> Job:
    """Read and check a job file.

    Raises
    ------
    SceneError: names the file, the key's path, what was found, and what is allowed.
    """
    file = shipped_file(check_path(path, key="path"), "scenes/jobs")
    content, lines = read_yaml(file, what="job", keys="version, dig, dump, ...", kind="job")
    return job_from_dict(content, folder=file.parent, file=file, lines=lines)


def job_from_dict(
    content: Mapping[str, Any],
    *,
    folder: str | Path = ".",
    site_folder: str | Path | None = None,
    file: Path | None = None,
    lines: Mapping[KeyPath, int] | None = None,
) -> Job:
    """Check a job given as plain data.

    Parameters
    ----------
    content: keys and values as in a job file.
    folder: folder of the files that the job names.
    site_folder: folder of the files that the keys of its site name; by default the same.
    file, lines: for messages: the file that the content came from, and the line of every key.

    Raises
    ------
    SceneError: names the key's path, what was found, and what is allowed.
    """
    job = Job.of_content(content, folder=folder, file=file, lines=lines)
    job._site = _site(job, job.folder if site_folder is None else check_path(site_folder, key="site_folder"))
    return job


def job_schema() -> dict[str, Any]:
    """The job file's JSON Schema; its site has those keys of a scene that a job accepts."""
    schema, scene = Job.file_schema("job"), scene_schema()
    keys = {key: scene["properties"][key] for key in SITE_KEYS}
    site = {"type": "object", "properties": keys, "additionalProperties": False}
    schema["properties"]["site"]["anyOf"] = [{"type": "string"}, site]
    records, named = scene["$defs"], _records_in(keys)
    while len(more := named | _records_in([records[name] for name in named])) > len(named):
        named = more
    return schema | {"$defs": schema["$defs"] | {name: records[name] for name in sorted(named)}}


def _records_in(schema: Any) -> set[str]:
    """The names of the records that a part of a schema refers to."""
    return set(re.findall(r"#/\$defs/(\w+)", json.dumps(schema)))


def _site(job: Job, folder: Path) -> Scene:
    """The scene of the site; its task and start have no meaning."""
    if isinstance(job.site, str):
        try:
            return _standing(load_scene(job.folder / job.site), job.file)
        except SceneError as error:
            raise SceneError(str(error), file=job.file, key="site") from None
    unknown = next((key for key in job.site if key not in SITE_KEYS), None)
    if unknown is not None:
        raise SceneError.unknown_name("there is no such key", unknown, names=SITE_KEYS, file=job.file, key="site")
    idle = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0.0, 0.0, 0.0]}}}
    try:
        scene = scene_from_dict({**idle, **job.site}, folder=folder, file=job.file)
    except SceneError as error:
        raise SceneError.of(error, file=job.file, key="site") from None
    return _standing(scene, job.file)


def _standing(scene: Scene, file: Path | None) -> Scene:
    """The site, if all of its obstacles stand still: every motion of a job has a clock of its own."""
    for index, one in enumerate(scene.obstacles):
        for key, moves in (("velocity", any(one.velocity)), ("appears_at", one.appears_at > 0.0)):
            if moves:
                raise SceneError(
                    "does not stand still", file=file, key=f"site.obstacles[{index}].{key}", found=getattr(one, key),
                    allowed=f"obstacles that stand from the first cycle to the last, such as {one.name} without {key}",
                )  # fmt: skip
    return scene
