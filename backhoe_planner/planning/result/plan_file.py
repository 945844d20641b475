"""The plan file: JSON, read with every field checked.

The records below are the schema, for reading and for writing. What a file says about its
motion (certificate, dynamics, metrics, bound, versions) is for other programs: this one computes it anew.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, StrictInt, ValidationError, model_serializer, model_validator

from backhoe_planner.errors import InputError, PlanFileError
from backhoe_planner.files.differences import SAME_FIGURE
from backhoe_planner.files.file_kinds import refuse_other_kind
from backhoe_planner.files.records import Figure, Record, explain
from backhoe_planner.files.text_file import read_text
from backhoe_planner.motion import Detour, Trajectory
from backhoe_planner.planning.result.bound import Bound
from backhoe_planner.planning.result.findings import Findings
from backhoe_planner.planning.result.metrics import Metrics
from backhoe_planner.planning.search.effort import EffortName
from backhoe_planner.proof import Certificate, LimitName
from backhoe_planner.site import Finite, Moment, Obstruction

Method = Literal["auto", "reactive", "optimal", "paper", "teleop"]
Reason = Literal[
    "",
    "unreachable",
    "start_in_collision",
    "goal_in_collision",
    "start_breaks_keep",
    "goal_breaks_keep",
    "outside_limits",
    "blocked",
    "not_done",
    "budget",
]

FORMAT: Literal["backhoe-planner/plan"] = "backhoe-planner/plan"
VERSION: Literal[1] = 1
_SHORTEST_STEP = 1e-12  # s: chosen; rates over a much shorter step overflow when they are squared


class RobotRecord(Record):
    """The machine, by its file."""

    urdf: str
    """``example:NAME``, or a path relative to the plan file."""
    sha256: str
    """Of the URDF's bytes."""
    joints: tuple[str, ...]
    """Names of the joints, in the order of the columns."""
    tip: str
    """Name of the tip link."""


class TrajectoryRecord(Record):
    """Samples of the motion; between them the joints move linearly in time."""

    time: list[Moment]
    """(T,) [s], from 0."""
    q: list[list[Finite]]
    """(T, n) joint positions [rad or m]."""
    v: list[list[Finite]]
    """(T, n) joint velocities [rad/s or m/s]."""

    def trajectory(self, n: int, *, file: Path, begins: tuple[int, ...] = ()) -> Trajectory:
        """The motion of a machine with `n` joints; PlanFileError if the samples are not a motion.

        begins: the first sample of each leg of a sequence.
        """
        for key, rows in (("q", self.q), ("v", self.v)):
            lengths = sorted({len(row) for row in rows} | {n})
            if lengths != [n]:
                raise PlanFileError(
                    "does not fit the machine", file=file, key=f"trajectory.{key}", found=f"rows of {lengths} numbers",
                    allowed=f"(T, {n})",
                )  # fmt: skip
        time = np.array(self.time)
        if len(time) > 1 and 0.0 <= np.min(np.diff(time)) < _SHORTEST_STEP:
            raise PlanFileError("samples lie too close together", file=file, key="trajectory.time")
        try:
            return Trajectory(time, np.array(self.q).reshape(-1, n), np.array(self.v).reshape(-1, n), begins=begins)
        except InputError as error:
            raise PlanFileError(str(error), file=file) from None


class DynamicsRecord(Record):
    """Torques, power and work of the motion, sample by sample."""

    torque: list[list[Figure]]
    """(T, n) [N m or N]."""
    power: list[Figure]
    """(T,) of the joints [W]."""
    work: list[Figure]
    """(T,) work of the joints so far [J]."""
    hydraulic_power: list[Figure] | None = None
    """(T,) of the pump [W], if the machine has a hydraulic description."""
    hydraulic: list[Figure] | None = None
    """(T,) energy of the oil so far [J]."""


def _without_empty(content: dict[str, Any], key: str) -> dict[str, Any]:
    """A record without a value that is empty or 0."""
    return content if content.get(key) else {name: value for name, value in content.items() if name != key}


class ClearanceRecord(Record):
    """The smallest margin to one obstacle."""

    value: Figure
    """Proven lower bound of the distance [m]."""
    margin: Figure
    """Value minus the clearance that must be kept [m]."""
    obstacle: str
    """Its name; ``self: LINK`` for another link of the machine."""
    link: str
    time: Figure
    """[s]"""
    tracking: Figure = 0.0
    """The part of the value that the tracking error may use up; the margin excludes it [m]. Not in the file if 0."""

    @model_serializer(mode="wrap")
    def _without_zero(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_empty(serialise(self), "tracking")

    @classmethod
    def of(cls, found: Obstruction) -> ClearanceRecord:
        """The record of an obstruction."""
        return cls(
            value=found.distance,
            margin=found.margin,
            obstacle=f"self: {found.obstacle}" if found.kind == "machine" else found.obstacle,
            link=found.link,
            time=found.time,
            tracking=found.tracking,
        )


class UseRecord(Record):
    """How much of a limit is used at the moment of its largest use; see `LimitUse`."""

    ratio: Figure
    time: Figure
    """[s]"""
    joint: str | None = None
    kind: str | None = None
    needed: Figure | None = None
    available: Figure | None = None
    unit: str | None = None
    at_rest: Figure | None = None
    greatest: Figure | None = None
    asked: Figure | None = None
    """The last two in older files, of the tip's speed [m/s]."""
    leg: str = ""
    """The leg of a sequence to which it belongs. Not in the file without a sequence."""

    @model_serializer(mode="wrap")
    def _without_leg(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_empty(serialise(self), "leg")


class KeepRecord(Record):
    """The margin of a kept condition at the moment of its smallest margin; see `KeepUse`."""

    name: str
    margin: Figure
    """Proven over the whole motion; negative if the condition is not kept [unit]."""
    value: Figure
    """At that moment [unit]."""
    time: Figure
    """[s]"""
    unit: str
    leg: str = ""
    """The leg of a sequence to which it belongs. Not in the file without a sequence."""

    @model_serializer(mode="wrap")
    def _without_leg(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return _without_empty(serialise(self), "leg")


class CertificateRecord(Record):
    """What was proven when the plan was written."""

    min_clearance: ClearanceRecord | None = None
    clearances: tuple[ClearanceRecord, ...] = ()
    limits: dict[LimitName, UseRecord] = Field(default_factory=dict)
    tip_error: dict[Literal["max", "mean", "max_angle"], Figure] | None = None
    """Of the tip's position, the largest and the mean [m], and of its angle [rad]."""
    path: dict[Literal["length", "followed"], Figure] | None = None
    """Its length, and how much of it is followed [m]; 0 for a goal."""
    detours: tuple[Detour, ...] = ()
    keep: tuple[KeepRecord, ...] = ()
    """The smallest margin of every kept condition."""
    goal: int | None = None
    """Number of the goal that is reached, in the order of the scene, from 1; none along a path."""
    problems: tuple[str, ...] = ()

    @classmethod
    def of(cls, certificate: Certificate) -> CertificateRecord:
        """The record of a certificate."""
        clearances = tuple(ClearanceRecord.of(found) for found in certificate.clearances)
        tracking = certificate.tracking
        return cls(
            min_clearance=clearances[0] if clearances else None,
            clearances=clearances,
            limits={name: UseRecord(**vars(use)) for name, use in certificate.uses.items()},
            tip_error={"max": tracking.max_error, "mean": tracking.mean_error, "max_angle": tracking.max_angle_error},
            path={"length": tracking.path_length, "followed": tracking.followed},
            detours=tracking.detours,
            keep=tuple(
                KeepRecord(name=use.name, margin=use.margin, value=use.value, time=use.time, unit=use.unit, leg=use.leg)
                for use in certificate.keep
            ),
            goal=certificate.goal,
            problems=certificate.problems,
        )


class LegRecord(Record):
    """One leg of a sequence, as far as the motion has begun it."""

    name: str
    first: StrictInt
    """Its first sample."""
    last: StrictInt
    """Its last sample, the first of the next leg."""
    begins: Figure
    """When [s]."""
    certificate: CertificateRecord
    """What was proven of its part; times count from its beginning."""
    metrics: Metrics
    findings: Findings = Findings()


class PlanRecord(Record):
    """A plan file."""

    format: Literal["backhoe-planner/plan"] = FORMAT
    version: Literal[1] = VERSION
    verdict: Literal["verified", "failed"]
    reason: Reason
    """Why the plan failed; empty if verified."""
    message: str
    robot: RobotRecord
    scene: dict[str, Any]
    """The whole scene."""
    scene_folder: str = "."
    """The folder of the files that the scene names, relative to the plan file."""
    method: Method
    seed: Annotated[StrictInt, Field(ge=0)]
    effort: EffortName | None = None
    """How much was searched; None for a motion driven by hand, and in older files."""
    versions: dict[str, str] = Field(default_factory=dict)
    """Of the program and its libraries."""
    trajectory: TrajectoryRecord
    dynamics: DynamicsRecord | None = None
    certificate: CertificateRecord
    metrics: Metrics
    findings: Findings = Findings()
    bound: Bound | None = None
    """Lower bounds for any motion to the goal."""
    legs: tuple[LegRecord, ...] = ()
    """The legs of a sequence."""

    @model_validator(mode="before")
    @classmethod
    def _read_older(cls, content: Any) -> Any:
        """Take from `details` of older files the part that is still used: what a recording leaves out."""
        if not isinstance(content, Mapping) or "details" not in content:
            return content
        details = content["details"]
        recorded = details.get("recorded") if isinstance(details, Mapping) else None
        kept = {key: value for key, value in content.items() if key != "details"}
        return kept | ({"findings": {"recording": recorded}} if recorded is not None else {})

    @model_validator(mode="after")
    def _one_verdict(self) -> PlanRecord:
        if (self.verdict == "verified") != (self.reason == ""):
            allowed = "no reason" if self.verdict == "verified" else "a reason"
            raise ValueError(f"reason {self.reason!r} beside the verdict {self.verdict}; allowed: {allowed}")
        return self


def read_plan_file(file: Path) -> PlanRecord:
    """Read a plan file.

    Raises
    ------
    PlanFileError: not a plan file, or a damaged one; names the key, what was found and what is allowed.
    """
    text = read_text(file, what="plan", error=PlanFileError)
    refuse_other_kind(text, "plan", file=file, error=PlanFileError)
    try:
        content = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"is not a plan file: not JSON: {error}", file=file) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise PlanFileError("is not a plan file", file=file, key="format", found=repr(found), allowed=FORMAT)
    if content.get("version") != VERSION:
        raise PlanFileError(
            "was written in a version that is not known", file=file, key="version",
            found=repr(content.get("version")), allowed=str(VERSION),
        )  # fmt: skip
    try:
        record = PlanRecord.model_validate(content)
    except ValidationError as error:
        raise PlanFileError(explain(error, content, root=PlanRecord), file=file) from None
    _check_legs(record, file)
    return record


def _check_legs(record: PlanRecord, file: Path) -> None:
    """PlanFileError if legs do not begin and end at samples one after the other, at their times."""
    firsts, time = [leg.first for leg in record.legs], record.trajectory.time
    for index, first in enumerate(firsts):
        low, high = (0, 0) if index == 0 else (firsts[index - 1] + 1, len(time) - 1)
        if not low <= first <= high or not time:
            allowed = "0" if index == 0 else f"{low} to {high}" if low <= high else "no leg after the last sample"
            raise PlanFileError(
                "is no sample at which this leg can begin", file=file, key=f"legs[{index}].first", found=first,
                allowed=allowed,
            )  # fmt: skip
    for index, leg in enumerate(record.legs):
        following = index + 1 < len(firsts)
        last, which = (firsts[index + 1], "the first of the next leg") if following else (len(time) - 1, "the last")
        if leg.last != last:
            raise PlanFileError(
                "is not the last sample of this leg", file=file, key=f"legs[{index}].last", found=leg.last,
                allowed=f"{last}, {which}",
            )  # fmt: skip
        if not math.isclose(leg.begins, time[leg.first], rel_tol=SAME_FIGURE, abs_tol=SAME_FIGURE):
            raise PlanFileError(
                "is not when this leg begins", file=file, key=f"legs[{index}].begins", found=leg.begins,
                allowed=f"{time[leg.first]:.9g}, the time of its first sample, {leg.first}",
            )  # fmt: skip


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number of JSON")
