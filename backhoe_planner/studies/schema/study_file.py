"""The study file: a scene or job as template, the parameters that differ by row, and the figures to keep."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, StrictInt, model_validator

from backhoe_planner.errors import StudyError, check_path
from backhoe_planner.files.file_record import FileRecord
from backhoe_planner.files.records import Record, exactly_one
from backhoe_planner.files.yaml_text import KeyPath, read_yaml
from backhoe_planner.machine import shipped_file
from backhoe_planner.site import Title
from backhoe_planner.studies.schema.values import MOST_VALUES, Values, plain, read_values


def _readable(found: Any) -> Any:
    found = plain(found)
    read_values(found)
    return found


Spec = Annotated[Any, AfterValidator(_readable)]


class Best(Record):
    """The metric by which rows are compared: exactly one of least, greatest."""

    least: str | None = None
    """The metric whose least value is best."""
    greatest: str | None = None
    """The metric whose greatest value is best."""

    _one = exactly_one("least", "greatest")

    @property
    def metric(self) -> str:
        """Its key path."""
        return self.least or self.greatest or ""

    @property
    def sign(self) -> float:
        """1 if less is better, -1 if more is better."""
        return 1.0 if self.least is not None else -1.0


def _compared(found: Any) -> Any:
    return {"least": found} if isinstance(found, str) else found


class Study(FileRecord):
    """Many plans of one scene, or of one job."""

    wrong = StudyError

    version: Literal[1]
    name: Title = ""
    machine: str | None = None
    """With a scene: a URDF file, relative to the study file, or example:NAME. A job names its own machine."""
    scene: str | dict[str, Any] | None = None
    """The scene that is the template: a file, relative to the study file, or its keys."""
    job: str | dict[str, Any] | None = None
    """The job that is the template, instead of a scene."""
    parameters: dict[str, Spec] = Field(default_factory=dict)
    """The values that differ, by key path; `machine`, `method`, `effort` and `seed` are those of the plan."""
    combine: Literal["grid", "zip", "random"] = "grid"
    """grid: every combination; zip: all first values, then all second values, ...; random: `count` random rows."""
    count: Annotated[StrictInt, Field(ge=1, le=MOST_VALUES)] | None = None
    """With `random`: the number of rows. With a grid that has a distribution: the number of draws at each point."""
    seed: Annotated[StrictInt, Field(ge=0, lt=2**63)] = 0
    """Seed of the random draws."""
    metrics: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """The figures of each plan to keep; by default the usual ones."""
    best: Annotated[Best | None, BeforeValidator(_compared, json_schema_input_type=str | Best | None)] = None
    """The metric that decides which row is best: its name if less is better, or {greatest: METRIC}."""
    keep_plans: Literal["none", "failed", "all"] = "none"
    """The plans that are also written as files."""

    _lines: Mapping[KeyPath, int] = PrivateAttr(default_factory=dict)

    _one = exactly_one("scene", "job")

    @model_validator(mode="after")
    def _consistent(self) -> Study:
        if self.scene is not None and self.machine is None and "machine" not in self.parameters:
            raise ValueError("machine is missing: a URDF file, or example:NAME")
        if self.job is not None and self.machine is not None:
            raise ValueError("machine cannot be given beside a job: set the key machine in the job")
        values = self.values
        drawn = [name for name, one in values.items() if one.draw is not None]
        if self.combine == "random":
            if self.count is None:
                raise ValueError("count is missing: how many rows are drawn")
        elif self.combine == "zip":
            lengths = {name: len(one.listed) for name, one in values.items() if len(one.listed) > 1}
            if len(set(lengths.values())) > 1:
                raise ValueError(
                    "combine: zip needs lists of equal length; found "
                    + ", ".join(f"{n}: {k}" for n, k in lengths.items())
                )
            if self.count is not None and (lengths or not drawn):
                raise ValueError("count cannot be given with combine: zip and a list: the list sets the number of rows")
            if drawn and not lengths and self.count is None:
                raise ValueError("count is missing: nothing with combine: zip says how many rows there are")
        elif self.count is not None and not drawn:
            raise ValueError(
                "count cannot be given beside a grid of lists: it is for combine: random, or with a distribution"
            )
        if self.rows > MOST_VALUES:
            raise ValueError(f"the study has {self.rows} rows; allowed: at most {MOST_VALUES}")
        return self

    @cached_property
    def values(self) -> dict[str, Values]:
        """The values of each parameter."""
        return {name: read_values(spec) for name, spec in self.parameters.items()}

    @property
    def rows(self) -> int:
        """The number of plans."""
        lengths = [len(one.listed) for one in self.values.values() if one.draw is None]
        if self.combine == "random":
            return self.count or 0
        if self.combine == "zip":
            return max([*lengths, 1]) if self.count is None else self.count
        return math.prod(lengths) * (self.count or 1)

    def place(self, *keys: str | int) -> str:
        """A key as messages name it, with its line if the file is known."""
        line = self._lines.get(keys)
        name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")
        return name if line is None else f"{name} (line {line})"

    def to_dict(self) -> dict[str, Any]:
        """The study as plain data that `study_from_dict` reads again."""
        return self.model_dump(mode="json", by_alias=True, exclude_unset=True)


def load_study(path: str | Path) -> Study:
    """Read and check a study file.

    Raises
    ------
    StudyError: names the file, the key's path, what was found, and what is allowed.
    """
    file = shipped_file(check_path(path, key="path"), "scenes/studies")
    content, lines = read_yaml(
        file, what="study", keys="version, machine, scene, parameters, ...", kind="study", error=StudyError
    )
    return study_from_dict(content, folder=file.parent, file=file, lines=lines)


def study_from_dict(
    content: Mapping[str, Any],
    *,
    folder: str | Path = ".",
    file: Path | None = None,
    lines: Mapping[KeyPath, int] | None = None,
) -> Study:
    """Check a study given as plain data.

    Parameters
    ----------
    content: keys and values as in a study file.
    folder: in which files named by the study are searched.
    file, lines: for messages: the file that the study came from, and the line of every key.

    Raises
    ------
    StudyError: names the key's path, what was found, and what is allowed.
    """
    study = Study.of_content(content, folder=folder, file=file, lines=lines)
    study._lines = lines or {}
    return study


def study_schema() -> dict[str, Any]:
    """The study file's JSON Schema; it does not check the scene or job, which may only be complete with parameters."""
    return Study.file_schema("study")
