"""Planning one row of a study: the template is filled, and whatever happens becomes an outcome."""

from __future__ import annotations

import contextlib
import os
import socket
import time as clock
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.job import JobPlan, job_from_dict, plan_job
from backhoe_planner.machine import Robot, load_robot
from backhoe_planner.planning import Plan, plan
from backhoe_planner.site import scene_from_dict
from backhoe_planner.studies.results.outcome import Outcome
from backhoe_planner.studies.rows.drawing import StudyRow
from backhoe_planner.studies.rows.metrics import sources_of
from backhoe_planner.studies.rows.template import machine_source
from backhoe_planner.studies.work.bundle import unpacked_template

_BUDGET = 1e7  # s: a plan is only ended by its counted work, so that it is the same on every computer
_MACHINES = 8  # kept loaded; chosen, a study compares a handful


class RowPlanner:
    """Plans rows of one study, from the files of its bundle."""

    def __init__(self, root: Path) -> None:
        """`root`: the folder into which the bundle was unpacked."""
        self._root, self._template = root, unpacked_template(root)
        self._load = lru_cache(maxsize=_MACHINES)(self._load_machine)

    def plan(self, row: StudyRow) -> Outcome:
        """The outcome of a row; exceptions of the planning become outcomes too."""
        begun, begun_wall = clock.process_time(), clock.monotonic()
        outcome = self._outcome(row)
        timing = {
            "processor": clock.process_time() - begun, "wall": clock.monotonic() - begun_wall,
            "host": socket.gethostname(), "process": os.getpid(),
        }  # fmt: skip
        return replace(outcome, timing=timing)

    def _outcome(self, row: StudyRow) -> Outcome:
        template = self._template
        try:
            content, settings = template.filled(row.values)
            planned: Callable[[dict[str, Any], Mapping[str, Any]], Plan | JobPlan] = (
                self._plan_scene if template.kind == "scene" else self._plan_job
            )
            found = planned(content, settings)
            sources = sources_of(found, template.metrics)
            return Outcome(
                row=row.number,
                verdict=found.verdict,
                reason=found.reason,
                message=self._without_folders(found.note if isinstance(found, JobPlan) else found.message),
                metrics={one.name: one.value(sources, verified=found.verified) for one in template.metrics},
                plan=self._written(found),
            )
        except OutputError:
            raise  # a full disk is not a property of the row
        except InputError as error:
            return Outcome(row.number, "invalid", "invalid", self._without_folders(str(error)))
        except Exception as error:  # noqa: BLE001  a fault is a finding, not the end of the study
            return Outcome(row.number, "error", "error", self._without_folders(f"{type(error).__name__}: {error}"))

    def _plan_scene(self, content: dict[str, Any], settings: Mapping[str, Any]) -> Plan:
        scene = scene_from_dict(content, folder=self._at(self._template.folder))
        robot = self._load(self._machine(settings["machine"]), scene.tip, tuple(scene.hold.items()))
        return plan(
            robot, scene, method=settings["method"], seed=_whole(settings["seed"]), effort=settings["effort"],
            budget=_BUDGET,
        )  # fmt: skip

    def _plan_job(self, content: dict[str, Any], settings: Mapping[str, Any]) -> JobPlan:
        folder, site_folder = self._at(self._template.folder), self._at(self._template.site_folder)
        job = job_from_dict(content, folder=folder, site_folder=site_folder)
        with self._packages():
            return plan_job(job, effort=settings["effort"], seed=_whole(settings["seed"]))

    def _machine(self, name: Any) -> str:
        """The machine's path among the files of the bundle."""
        source = machine_source(name, self._template.machine_folder)
        return source if source.startswith("example:") else str(self._at(source))

    def _load_machine(self, source: str, tip: str | None, hold: tuple[tuple[str, float], ...]) -> Robot:
        with self._packages():
            return load_robot(source, tip=tip, hold=dict(hold))

    @contextlib.contextmanager
    def _packages(self) -> Iterator[None]:
        """Use the bundle's folders of ROS packages while a machine is loaded."""
        before = os.environ.get("ROS_PACKAGE_PATH")
        if not self._template.package_path:
            yield
            return
        os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join(str(self._at(one)) for one in self._template.package_path)
        try:
            yield
        finally:
            if before is None:
                del os.environ["ROS_PACKAGE_PATH"]
            else:
                os.environ["ROS_PACKAGE_PATH"] = before

    def _at(self, path: str) -> Path:
        return self._root / path.removeprefix("/")

    def _without_folders(self, message: str) -> str:
        """A message that names files as the study does, whatever the computer."""
        template = self._template
        for folder in (template.folder, template.site_folder, template.machine_folder):
            message = message.replace(f"{self._at(folder)}{os.sep}", "")
        return message.replace(str(self._root), "")

    def _written(self, found: Plan | JobPlan) -> str | None:
        """The content of the plan's file, if it is to be kept."""
        keep = self._template.keep_plans
        if keep == "none" or (keep == "failed" and found.verified):
            return None
        file = self._root / f"plan-{os.getpid()}.json"
        found.save(file)
        text = file.read_text(encoding="utf-8")
        file.unlink()
        return text


def _whole(seed: Any) -> Any:
    """A seed as an integer, if a range or a distribution gave it as a float."""
    return int(seed) if isinstance(seed, float) and seed.is_integer() else seed
