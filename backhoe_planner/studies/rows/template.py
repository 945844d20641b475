"""The template of a study: a scene or a job as plain data, and the place of every parameter in it."""

from __future__ import annotations

import copy
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from backhoe_planner.errors import InputError, RobotError, SceneError, StudyError, nearest_name
from backhoe_planner.files.files_beside import files_beside
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.job import SITE_KEYS, Job, job_from_dict, load_job
from backhoe_planner.machine import Robot
from backhoe_planner.planning import EFFORTS, METHODS
from backhoe_planner.site import Scene, leg_scene, load_machine, load_scene, scene_from_dict
from backhoe_planner.studies.rows.key_paths import Address, NoSuchKeyError, descriptions_at, find_address, put, spell
from backhoe_planner.studies.rows.metrics import DEFAULTS, Kind, Metric, find_metric
from backhoe_planner.studies.rows.units import unit_in
from backhoe_planner.studies.schema.study_file import Best, Study

SETTINGS = ("machine", "method", "effort", "seed")  # of a plan, beside its scene
_OWN: dict[str, Any] = {"method": "auto", "effort": "quick", "seed": 0}


@dataclass(frozen=True)
class Template:
    """The part that all rows share.

    Attributes
    ----------
    kind: whether a scene or a job is planned.
    content: of the scene or the job, plain data.
    machine: with a scene, as `load_robot` takes it; empty if it is a parameter, or with a job.
    addresses: the place of each parameter in the content; empty for settings of the plan.
    units: of the parameters that have one.
    metrics: the figures of each plan that are kept.
    best: the metric by which rows are compared.
    keep_plans: which plans are kept: ``none``, ``failed``, ``all``.
    folder: in which files named in the content are searched, absolute.
    site_folder: the same for the site of a job.
    machine_folder: in which a machine that is a parameter is searched, absolute.
    package_path: the folders of ROS packages in which meshes are searched.
    """

    kind: Kind
    content: dict[str, Any]
    machine: str
    addresses: Mapping[str, Address]
    units: Mapping[str, str]
    metrics: tuple[Metric, ...]
    best: Best
    keep_plans: str
    folder: str
    site_folder: str
    machine_folder: str
    package_path: tuple[str, ...]

    @property
    def best_metric(self) -> Metric:
        """The figure by which rows are compared."""
        return next(metric for metric in self.metrics if metric.name == self.best.metric)

    @property
    def column_units(self) -> dict[str, str]:
        """The units of the table's columns of parameters and metrics, as far as they have one."""
        return dict(self.units) | {metric.name: metric.unit for metric in self.metrics if metric.unit}

    def heading(self, name: str) -> str:
        """The name of a parameter with its unit, if it has one: ``clearance [m]``."""
        unit = self.units.get(name, "")
        return f"{name} [{unit}]" if unit else name

    def filled(self, values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """The content with the values of a row, and the settings of its plan: machine, method, effort, seed."""
        content, settings = copy.deepcopy(self.content), {"machine": self.machine, **_OWN}
        for name, value in values.items():
            address = self.addresses[name]
            if address:
                put(content, address, value)
            else:
                settings[name] = value
        return content, settings


@dataclass(frozen=True)
class Inputs:
    """The inputs from which the rows are planned.

    Attributes
    ----------
    robots: every machine.
    files: of machines that are not shipped with the package, of the content and of parameters; absolute.
    """

    robots: tuple[Robot, ...]
    files: tuple[Path, ...]


def build_template(study: Study) -> tuple[Template, Inputs]:
    """The template of a study and the files that it needs, checked.

    Raises
    ------
    StudyError: the scene, the job or a machine is wrong; a key path, a metric, a method or an effort does not exist;
        two parameters set the same place.
    """
    kind: Kind = "scene" if study.job is None else "job"
    template = _load(study, kind)
    content = template.to_dict()
    addresses = dict(_addresses(study, content, kind))
    _check_settings(study)
    metrics, best = _metrics(study, template)
    folder = absolute(template.folder)
    machine = "" if study.machine is None else _source(study.machine, study.folder)
    units = {name: unit for name, address in addresses.items() if (unit := _unit(address, content, kind))}
    made = Template(
        kind=kind, content=content, machine=machine, addresses=addresses, units=units, metrics=metrics, best=best,
        keep_plans=study.keep_plans, folder=folder,
        site_folder=absolute(template.site_scene.folder) if isinstance(template, Job) else folder,
        machine_folder=folder if kind == "job" else absolute(study.folder),
        package_path=tuple(filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep))),
    )  # fmt: skip
    return made, _inputs(study, template, made)


def machine_source(name: Any, folder: str | Path) -> str:
    """A machine that a study or a job names, as `load_robot` takes it; InputError if it is not text."""
    if not isinstance(name, str):
        raise InputError("is not a machine", key="machine", found=name, allowed="a URDF file, or example:NAME")
    return _source(name, folder)


def absolute(path: str | Path) -> str:
    """An absolute path without ``..``; links are not resolved, since the names of files beside them may matter."""
    return os.path.normpath(Path(path).absolute())


def _source(name: str, folder: str | Path) -> str:
    if name.startswith("example:"):
        return name
    beside = absolute(Path(folder, name))
    is_shipped = Path(name).parent == Path("models") and not Path(beside).exists()
    return f"example:{Path(name).stem}" if is_shipped else beside


def digest_of(template: Template, inputs: Inputs) -> dict[str, Any]:
    """All that determines the plans of a study besides its rows: plain data, independent of where files are stored."""
    files = {}
    for file in inputs.files:
        try:
            content = file.read_bytes()
        except OSError as error:
            raise StudyError(f"cannot be read: {error.strerror}", file=file) from None
        files[os.path.relpath(file, template.folder)] = hashlib.sha256(content).hexdigest()
    machines = [[robot.urdf.path.name, robot.urdf.sha256] for robot in inputs.robots]
    return {
        template.kind: hashlib.sha256(json.dumps([template.kind, template.content]).encode()).hexdigest(),
        "machines": machines,
        "files": files,
        "metrics": [metric.name for metric in template.metrics],
        "keep_plans": template.keep_plans,
        "versions": installed_versions(),
    }


def _load(study: Study, kind: Kind) -> Scene | Job:
    """The scene or the job, from its file or its keys."""
    given = study.scene if kind == "scene" else study.job
    try:
        if isinstance(given, str):
            file = _shipped_or(study.folder, given)
            return load_scene(file) if kind == "scene" else load_job(file)
        assert given is not None
        made = scene_from_dict if kind == "scene" else job_from_dict
        return made(given, folder=study.folder)
    except SceneError as error:
        raise StudyError(str(error), file=study.file, key=study.place(kind)) from None


def _shipped_or(folder: Path, name: str) -> Path:
    """The path of a file in the study's folder, or the name itself, which may be that of a shipped file."""
    beside = folder / name
    return beside if beside.exists() or not name.startswith("scenes/") else Path(name)


def _addresses(study: Study, content: dict[str, Any], kind: Kind) -> Iterator[tuple[str, Address]]:
    """The address of every parameter; default content is written out if a parameter needs it."""
    found: dict[str, Address] = {}
    for name in study.parameters:
        if name in SETTINGS and not (kind == "job" and name == "machine"):
            if kind == "job" and name == "method":
                raise StudyError(
                    "is not a setting of a job", file=study.file, key=study.place("parameters", name),
                    allowed="effort, seed, machine, or a key of the job",
                )  # fmt: skip
            yield name, ()
            continue
        try:
            found[name] = _address(name, content, kind)
        except NoSuchKeyError as error:
            raise StudyError(str(error), file=study.file, key=study.place("parameters", name)) from None
    for name, address in found.items():
        for other, beside in found.items():
            if name != other and beside[: len(address)] == address:
                raise StudyError(
                    f"sets {spell(beside)}, which {name!r} sets too", file=study.file,
                    key=study.place("parameters", other),
                )  # fmt: skip
        yield name, address


def _address(name: str, content: dict[str, Any], kind: Kind) -> Address:
    if kind == "scene":
        try:
            return find_address(name, content, Scene)
        except NoSuchKeyError as error:
            near = nearest_name(name, SETTINGS)
            if near is not None and "did you mean" not in str(error):
                raise NoSuchKeyError(name, [*SETTINGS, *Scene.model_fields]) from None
            raise
    first, _, rest = name.partition(".")
    if first == "site" or (first in SITE_KEYS and first not in Job.model_fields):
        inner = rest if first == "site" else name
        if inner.partition(".")[0] not in SITE_KEYS:
            raise NoSuchKeyError(inner, SITE_KEYS, within=("site",))
        return ("site", *find_address(inner, content.setdefault("site", {}), Scene))
    return find_address(name, content, Job)


def _unit(address: Address, content: dict[str, Any], kind: Kind) -> str:
    """The unit of the value at an address; empty if it has none, or if that is not known."""
    if kind == "job" and address[:1] == ("site",):
        return unit_in(descriptions_at(address[1:], content["site"], Scene))
    return unit_in(descriptions_at(address, content, Scene if kind == "scene" else Job))


def _check_settings(study: Study) -> None:
    """Check that the listed methods, efforts and seeds are valid."""
    for name, allowed in (("method", tuple(METHODS)), ("effort", tuple(EFFORTS))):
        values = study.values.get(name)
        if values is None:
            continue
        if values.draw is not None and "choice" not in (study.parameters[name] or {}):
            raise StudyError(
                "is drawn from numbers", file=study.file, key=study.place("parameters", name),
                allowed=f"a list, or {{choice: [...]}}, of {', '.join(allowed)}",
            )  # fmt: skip
        for value in values.listed or study.parameters[name]["choice"]:
            if value not in allowed:
                raise StudyError.unknown_name(
                    f"there is no such {name}", value, names=allowed, file=study.file,
                    key=study.place("parameters", name),
                )  # fmt: skip
    seeds = study.values.get("seed")
    if seeds is not None and seeds.draw is not None and "choice" not in study.parameters["seed"]:
        raise StudyError(
            "is drawn from numbers that are not whole", file=study.file, key=study.place("parameters", "seed"),
            allowed="a list, a range of whole numbers, or {choice: [...]}",
        )  # fmt: skip
    for value in () if seeds is None else seeds.listed:
        if type(value) is not int or not 0 <= value < 2**32:
            raise StudyError(
                "is not a seed", file=study.file, key=study.place("parameters", "seed"), found=value,
                allowed=f"whole numbers from 0 to {2**32 - 1}",
            )  # fmt: skip


def _metrics(study: Study, template: Scene | Job) -> tuple[tuple[Metric, ...], Best]:
    """The metrics to keep, including the one by which rows are compared, and how it compares them."""
    kind: Kind = "scene" if study.job is None else "job"
    objective = _objective(study, template)
    best, key = study.best or _default_best(template, objective), ("best",)
    names = dict.fromkeys(DEFAULTS[kind] if study.metrics is None else study.metrics)
    found = {}
    for name in (*names, best.metric):
        try:
            found[name] = find_metric(name, kind, objective=objective)
        except ValueError as error:
            where = ("metrics", list(names).index(name)) if name in names else key
            raise StudyError(str(error), file=study.file, key=study.place(*where)) from None
        if name in study.parameters:
            raise StudyError(
                "is a parameter too, so that the table would have two columns of that name", file=study.file,
                key=study.place("metrics"), found=name, hint=f"write {'.'.join(found[name].keys)}",
            )  # fmt: skip
    if found[best.metric].type not in ("float", "int"):
        raise StudyError("is no number", file=study.file, key=study.place(*key), found=best.metric)
    return tuple(found.values()), best


def _objective(study: Study, template: Scene | Job) -> str | None:
    """The name of the objective of all plans of a scene; None if it differs from row to row, or from leg to leg."""
    if isinstance(template, Job) or any(name.rpartition(".")[2] == "objective" for name in study.parameters):
        return None
    if template.task.sequence is None:
        return template.objective_or_default
    legs = [index for index, leg in enumerate(template.task.sequence) if leg.wait is None]
    found = {leg_scene(template, index).objective_or_default for index in legs}
    return next(iter(found)) if len(found) == 1 else None


def _default_best(template: Scene | Job, objective: str | None) -> Best:
    """The default comparison: by the objective of all plans, or by the duration if they have no common one."""
    if isinstance(template, Job):
        return Best(greatest="production")
    return Best(least="duration" if objective is None else "cost.value")


def _inputs(study: Study, template: Scene | Job, made: Template) -> Inputs:
    """Every machine, loaded once, and every file."""
    named: list[Any] = [made.machine] if made.machine else []
    if isinstance(template, Job):
        named = [machine_source(template.machine, template.folder)]
    if "machine" in study.parameters:
        values = study.values["machine"]
        named = list(values.listed or study.parameters["machine"].get("choice", ()))
        named = [machine_source(name, made.machine_folder) for name in named]
        if not named:
            raise StudyError("is drawn from numbers", file=study.file, key=study.place("parameters", "machine"))
    robots = []
    for source in named:
        try:
            robots.append(load_machine(source, template.site_scene if isinstance(template, Job) else template))
        except RobotError as error:
            keys = ("parameters", "machine") if "machine" in study.parameters else ("machine",)
            raise StudyError(str(error), file=study.file, key=study.place(*keys)) from None
    files = {file for robot in robots if not robot.urdf.source.startswith("example:") for file in robot.files}
    own = {template.file, template.site_scene.file if isinstance(template, Job) else None}  # their content is known
    files |= {file for file in template.files if file not in own}
    for name, values in study.values.items():
        if name.rpartition(".")[2] == "file":
            site = made.kind == "job" and made.addresses[name][0] == "site"
            texts = values.listed or study.parameters[name].get("choice", ())
            found = (Path(made.site_folder if site else made.folder, text) for text in texts if isinstance(text, str))
            files |= {file for file in found if file.is_file()}  # a row whose file is missing says so
    files |= {beside for file in files for beside in files_beside(file)}
    return Inputs(tuple(robots), tuple(sorted({Path(absolute(file)) for file in files})))
