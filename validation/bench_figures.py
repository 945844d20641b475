"""The figures of a bench in a file, and compared with those of an earlier run.

A time is compared as a multiple of a reference from the same run, so that a faster or a busier
machine makes no difference. Every figure states the relative difference that two runs of the same
code may have; larger differences are reported.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

import backhoe_planner as bp
from backhoe_planner.files.output_file import whole_file
from backhoe_planner.files.provenance import installed_versions
from backhoe_planner.files.records import Record, explain
from validation.tables import Row, markdown

VERSION: Literal[1] = 1
_LIBRARIES = ("scipy", "yourdfpy")  # in addition to those that a plan names

Amount = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Part = Annotated[float, Field(strict=True, ge=0.0, allow_inf_nan=False)]


class Figure(Record):
    """One figure of a bench."""

    name: Annotated[str, Field(min_length=1)]
    """Unique in a run."""
    value: Amount
    """The value in `unit`."""
    unit: str
    """Such as `s` or `us`; may be empty."""
    better: Literal["less", "more"] = "less"
    """Which way is better."""
    noise: Part
    """The relative difference that two runs of the same code may have."""
    reference: Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)] | None = None
    """A time of the same run, in the same unit, whose multiple is compared; the value itself by default."""

    @property
    def compared(self) -> float:
        """The value by which two runs are compared."""
        return self.value if self.reference is None else self.value / self.reference


class BenchRun(Record):
    """All figures of a run, with its machine and versions."""

    version: Literal[1] = VERSION
    """Version of this format."""
    setting: Literal["short", "long"]
    """How much was measured."""
    processor: str
    """Name of the processor."""
    versions: dict[str, str]
    """Versions of Python, the libraries and, where in use, the compiled functions."""
    seconds: Part
    """Total processor time [s]."""
    figures: tuple[Figure, ...]
    """The figures in the order of measurement."""


@dataclass(frozen=True)
class Change:
    """A figure of two runs.

    Attributes
    ----------
    name: of the figure.
    before, now: the figure in each run, if it has it.
    ratio: now over before, as compared; 1 if both are 0, NaN if one run does not have it.
    verdict: ``better``, ``worse``, ``same`` within the noise, ``new``, or ``gone``.
    """

    name: str
    before: Figure | None
    now: Figure | None
    ratio: float
    verdict: Literal["better", "worse", "same", "new", "gone"]


def made_here(setting: Literal["short", "long"], seconds: float, figures: Sequence[Figure]) -> BenchRun:
    """A run on this machine."""
    versions = {**installed_versions(), **{name: version(name) for name in _LIBRARIES}}
    return BenchRun(setting=setting, processor=_processor(), versions=versions, seconds=seconds, figures=tuple(figures))


def save(run: BenchRun, path: Path) -> None:
    """Write a run, whole or not at all.

    Raises
    ------
    OutputError: the file cannot be written.
    """
    with whole_file(path) as stream:
        stream.write(run.model_dump_json(indent=1) + "\n")


def load(path: Path) -> BenchRun:
    """Load a saved run.

    Raises
    ------
    InputError: the file cannot be read or was not written by `save`; the message names the fault.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise bp.InputError(f"cannot be read: {error.strerror}", file=path) from error
    except ValueError as error:
        raise bp.InputError(f"is not JSON: {error}", file=path) from error
    if not isinstance(content, dict) or content.get("version") != VERSION:
        found = content.get("version") if isinstance(content, dict) else type(content).__name__
        raise bp.InputError("is not a file of this bench", file=path, key="version", found=found, allowed=str(VERSION))
    try:
        run = BenchRun.model_validate(content)
    except ValidationError as error:
        raise bp.InputError(explain(error, content, root=BenchRun), file=path) from None
    names = [figure.name for figure in run.figures]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise bp.InputError("two figures have the same name", file=path, key="figures", found=", ".join(twice))
    return run


def compare(before: BenchRun, now: BenchRun) -> list[Change]:
    """Every figure of two runs, in the order of the later one; those of only the earlier one at the end.

    Raises
    ------
    InputError: one run is short and the other long, so that they measured different things.
    """
    if before.setting != now.setting:
        raise bp.InputError("is of another setting", key="setting", found=before.setting, allowed=now.setting)
    earlier = {figure.name: figure for figure in before.figures}
    names = {figure.name for figure in now.figures}
    return [_change(earlier.get(figure.name), figure) for figure in now.figures] + [
        Change(figure.name, figure, None, float("nan"), "gone") for figure in before.figures if figure.name not in names
    ]


def _change(before: Figure | None, now: Figure) -> Change:
    if before is None:
        return Change(now.name, None, now, float("nan"), "new")
    old, new = before.compared, now.compared
    if old == new:
        return Change(now.name, before, now, 1.0, "same")
    ratio = new / old if old != 0.0 else float("inf") if new > 0.0 else float("-inf")
    if abs(new - old) <= max(before.noise, now.noise) * max(abs(old), abs(new)):
        return Change(now.name, before, now, ratio, "same")
    return Change(now.name, before, now, ratio, "better" if (new < old) == (now.better == "less") else "worse")


def figures_table(run: BenchRun) -> str:
    """All figures of a run as a table."""
    return markdown(
        [
            {
                "figure": figure.name,
                "value": figure.value,
                "unit": figure.unit,
                "/reference": float("nan") if figure.reference is None else figure.compared,
            }
            for figure in run.figures
        ]
    )


def changes_table(changes: Sequence[Change]) -> str:
    """The figures that changed, worse ones first, or a line that none did."""
    order = ("worse", "gone", "better", "new")
    told = sorted((one for one in changes if one.verdict != "same"), key=lambda one: order.index(one.verdict))
    if not told:
        return f"all {len(changes)} figures are the same within their noise"
    rows: list[Row] = []
    for one in told:
        at = [float("nan") if figure is None else figure.compared for figure in (one.before, one.now)]
        noise = max(figure.noise for figure in (one.before, one.now) if figure is not None)
        rows.append({
            "": one.verdict, "figure": one.name, "before": at[0], "now": at[1], "now/before": one.ratio, "noise": noise,
        })  # fmt: skip
    return markdown(rows)


def differences(before: BenchRun, now: BenchRun) -> list[str]:
    """The differences in processor and versions of two runs, in words."""
    found = []
    if before.processor != now.processor:
        found.append(f"processor: {before.processor} before, {now.processor} now")
    for name in sorted({*before.versions, *now.versions}):
        old, new = before.versions.get(name, "none"), now.versions.get(name, "none")
        if old != new:
            found.append(f"{name}: {old} before, {new} now")
    return found


def _processor() -> str:
    """The processor's name."""
    described = Path("/proc/cpuinfo")
    lines = described.read_text().splitlines() if described.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
