"""The file of a job's plan: the ground at the beginning, and every motion of every cycle.

Everything that follows from these is recomputed when the file is read, not taken from it: ground, volumes
and certificates.
"""

from __future__ import annotations

import json
import math
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field, StrictInt, ValidationError

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import InputError, PlanFileError
from backhoe_planner.files.file_kinds import refuse_other_kind
from backhoe_planner.files.numbers import LARGEST, number
from backhoe_planner.files.output_file import check_record, whole_file
from backhoe_planner.files.provenance import installed_versions, relative_path
from backhoe_planner.files.records import Figure, Record, explain
from backhoe_planner.files.text_file import read_text
from backhoe_planner.job.ground.grids import MOST_COLUMNS
from backhoe_planner.job.ground.off_ground import OffGround
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Cycle, CycleLeg, LegName
from backhoe_planner.job.result.job_plan import JobPlan, JobReason, PatternEstimate, Undug, UndugReason
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning import EffortName
from backhoe_planner.site import MOST_VOXELS, Finite

FORMAT: Literal["backhoe-planner/job"] = "backhoe-planner/job"
VERSION: Literal[1] = 1

# values that are recomputed from the motions and compared with the file: null would match any number
Amount = Annotated[float, number(ge=0.0, le=1e30)]
Number = Annotated[StrictInt, Field(ge=0)]


class OffGroundRecord(Record):
    """What stands on the ground of a point cloud."""

    edge: Annotated[float, number(gt=0.0, le=LARGEST)]
    """Edge of its voxels [m]."""
    stacks: list[tuple[StrictInt, StrictInt, StrictInt, Number]]
    """x, y, z of the lowest corner of voxels above each other, in multiples of their edge, and how many there are."""

    @classmethod
    def of(cls, found: OffGround | None) -> OffGroundRecord | None:
        """The record of what stands on the ground; None if nothing does."""
        if found is None:
            return None
        keys = found.keys
        begins = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=keys[:1] - 2) != [0, 0, 1], axis=1))
        counts = np.diff(begins, append=len(keys))
        stacks = np.column_stack((keys[begins], counts)).tolist()
        return cls(edge=found.edge, stacks=[tuple(one) for one in stacks])

    @property
    def found(self) -> OffGround:
        """What stands on the ground; raises ValueError if no voxel does, too many do, or one is too far away."""
        stacks = np.array(self.stacks, dtype=float).reshape(-1, 4)
        count, far = float(stacks[:, 3].sum()), self.edge * float(np.max(np.abs(stacks), initial=0.0))
        if not 1.0 <= count <= MOST_VOXELS:
            raise ValueError(f"off_ground has {count:g} voxels, allowed: 1 to {MOST_VOXELS}")
        if far > LARGEST:
            raise ValueError(f"off_ground has voxels {far:g} m away, allowed: up to {LARGEST:g} m")
        whole = stacks.astype(np.int64)
        keys = np.repeat(whole[:, :3], whole[:, 3], axis=0)
        keys[:, 2] += np.concatenate([np.arange(one) for one in whole[:, 3].tolist()])
        return OffGround(self.edge, keys)


class GroundRecord(Record):
    """Heights of the ground; a single number is a whole grid of that value."""

    low: tuple[Finite, Finite]
    """x, y of the first column [m]."""
    cell: Finite
    """Distance between columns [m]."""
    shape: tuple[int, int]
    """Rows and columns."""
    bank: Finite | list[list[Finite]]
    """Height z of the top of the undisturbed soil [m]."""
    loose: Finite | list[list[Finite]]
    """Thickness of the loose soil on it [m]."""
    off_ground: OffGroundRecord | None = None
    """What stands on it; null if nothing does."""

    @classmethod
    def of(cls, terrain: Terrain) -> GroundRecord:
        """The record of a terrain."""
        return cls(
            low=(float(terrain.low[0]), float(terrain.low[1])),
            cell=terrain.cell,
            shape=terrain.shape,
            bank=_briefly(terrain.bank),
            loose=_briefly(terrain.loose),
            off_ground=OffGroundRecord.of(terrain.off_ground),
        )

    def grid(self, name: Literal["bank", "loose"]) -> Matrix:
        """One of the two grids, (rows, columns); raises ValueError if it has another shape."""
        found = getattr(self, name)
        if math.prod(self.shape) > MOST_COLUMNS or min(self.shape) < 1:
            raise ValueError(f"has {self.shape[0]} x {self.shape[1]} columns, allowed: up to {MOST_COLUMNS}")
        if isinstance(found, float):
            return np.full(self.shape, found)
        values = np.array(found, dtype=float)
        if values.shape != self.shape:
            raise ValueError(f"{name} has the shape {values.shape}, allowed: {self.shape}")
        return values


class LegRecord(Record):
    """One motion."""

    name: LegName
    payload: Amount
    """Mass in the bucket [kg]."""
    time: list[Finite]
    """(T,) times [s], from 0."""
    q: list[list[Finite]]
    """(T, n) joints [rad or m]."""
    verdict: Literal["verified", "failed"]
    clearance: Figure
    """Least margin beyond any required clearance [m]; null if nothing can be touched."""
    work: Amount
    """Work of the joints [J]."""
    hydraulic: Figure
    """Energy that the pump delivers [J]."""
    pump: Figure
    """Mean use of the pump's flow, 0 to 1."""
    engine: Figure
    """Mean use of the engine's power, 0 to 1."""

    @classmethod
    def of(cls, leg: CycleLeg) -> LegRecord:
        """The record of a leg."""
        tightest = leg.certificate.min_clearance
        return cls(
            name=leg.name, payload=leg.payload, time=leg.trajectory.time.tolist(), q=leg.trajectory.q.tolist(),
            verdict="verified" if leg.certificate.verified else "failed",
            clearance=float("nan") if tightest is None else tightest.margin,
            work=leg.work, hydraulic=leg.hydraulic, pump=leg.pump, engine=leg.engine,
        )  # fmt: skip

    @property
    def trajectory(self) -> Trajectory:
        """The motion; raises InputError if the samples do not form one."""
        joints = {len(row) for row in self.q}
        if len(joints) != 1 or len(self.q) != len(self.time):
            raise InputError("is no motion", key=f"{self.name}.q", found=f"rows of {sorted(joints)} joints at "
                             f"{len(self.time)} times", allowed="one row of all joints for every time")  # fmt: skip
        return Trajectory.from_steps(np.array(self.time, dtype=float), np.array(self.q, dtype=float))


class LoadRecord(Record):
    """The load of the bucket during the cut, by the position of the teeth."""

    swing: Finite
    """Angle of the arm's plane [rad]."""
    r: list[Finite]
    """Distances of the teeth from the swing axis, not increasing [m]."""
    mass: list[Amount]
    """Mass in the bucket at these distances [kg]."""


class CycleRecord(Record):
    """One cycle."""

    step: str
    """The cycle's part of the pattern."""
    legs: tuple[LegRecord, ...]
    load: LoadRecord
    place: tuple[Finite, Finite, Finite]
    """Where the soil is dumped: the top of what is there afterwards [m]."""
    truck: Number
    """Number of the truck, from 1; 0 for a heap."""
    bank: Amount
    """Undisturbed soil that left the ground [m^3]."""
    taken: Amount
    """Loose soil taken up with it [m^3]."""
    held: Amount
    """Loose soil in the bucket [m^3]."""
    spilt: Amount
    """Loose soil that fell back [m^3]."""
    filled: Amount
    """Filled part of the bucket's capacity."""
    depth: Amount
    """Greatest depth of the teeth below the ground [m]."""
    duration: Amount
    """Duration [s]."""
    work: Amount
    """Work of the joints [J]."""


class UndugRecord(Record):
    """Soil that stays above the design."""

    reason: UndugReason
    by: str
    volume: Figure
    """Volume, as it lies in the ground [m^3]."""
    low: tuple[Finite, Finite]
    """Least x, y [m]."""
    high: tuple[Finite, Finite]
    """Greatest x, y [m]."""
    words: str


class PatternRecord(Record):
    """The estimate of a pattern."""

    name: str
    cycles: Number
    bank: Amount
    """Soil that the pattern digs, as it lies in the ground [m^3]."""
    duration: Figure
    """Duration of all cycles [s]."""
    work: Figure
    """Work of the joints [J]."""
    cost: Figure
    """The objective per bank m^3 [s/m^3 or J/m^3]."""
    finished: bool
    chosen: bool


class JobFigures(Record):
    """The figures of the whole job."""

    cycles: StrictInt
    design: Figure = float("nan")
    """Soil above the design before the first cycle, as it lies there [m^3]."""
    bank: Figure
    """Soil that left the ground, as it lay there [m^3]."""
    loose: Figure
    """Loose soil that was dumped [m^3]."""
    duration: Figure
    """Duration of all cycles, with the exchange of trucks [s]."""
    waits: Figure
    """The part of the duration for the exchange of trucks [s]."""
    seconds_per_cycle: Figure
    joules_per_cycle: Figure
    """Work of the joints [J]."""
    production: Figure
    """Bank m^3 per hour, without the exchange of trucks."""
    work: Figure
    """Work of the joints [J]."""
    hydraulic: Figure
    """Energy that the pump delivers [J]."""
    kwh_per_m3: Figure
    """Energy that the pump delivers per bank m^3; for a machine without hydraulics, the work of the joints."""
    litres: Figure
    """Diesel, at 0.25 l per kWh of the engine."""
    pump: Figure
    """Mean use of the pump's flow, 0 to 1."""
    engine: Figure
    """Mean use of the engine's power, 0 to 1."""
    undug: Figure
    """Soil that stays above the design by more than its tolerance [m^3]."""
    left: Figure
    """Greatest height left above what may be dug [m]."""
    below: Figure
    """Greatest depth below the design [m]."""

    @classmethod
    def of(cls, plan: JobPlan) -> JobFigures:
        """The figures of a plan."""
        count = len(plan.cycles)
        digging = plan.duration - plan.waits
        oil = plan.hydraulic if plan.robot.hydraulics is not None else plan.work
        nothing = float("nan")
        return cls(
            cycles=count, design=plan.design_volume, bank=plan.bank, loose=plan.loose,
            duration=plan.duration, waits=plan.waits,
            seconds_per_cycle=digging / count if count else nothing,
            joules_per_cycle=plan.work / count if count else nothing,
            production=plan.production, work=plan.work, hydraulic=plan.hydraulic if count else nothing,
            kwh_per_m3=oil / 3.6e6 / plan.bank if plan.bank > 0.0 else nothing, litres=plan.fuel,
            pump=plan.mean_use("pump"), engine=plan.mean_use("engine"),
            undug=sum(one.volume for one in plan.undug), left=plan.over, below=plan.under,
        )  # fmt: skip


class JobPlanRecord(Record):
    """A job's plan file."""

    format: Literal["backhoe-planner/job"] = FORMAT
    version: Literal[1] = VERSION
    verdict: Literal["verified", "failed"]
    reason: JobReason
    message: str
    machine: str
    """``example:NAME``, or a path relative to the file."""
    sha256: str
    """Digest of the URDF's bytes."""
    job: dict[str, Any]
    """The whole job."""
    folder: str = "."
    """Folder of the files that the job names, relative to this file."""
    site_folder: str = "."
    """Folder of the files that the site names, relative to this file."""
    effort: EffortName
    seed: Number
    surveyed: bool = False
    """Whether `ground` was given, and is not the job's own."""
    choices: str = ""
    """The sha256 of effort, seed, compared patterns and the cycles' steps: what no motion shows."""
    versions: dict[str, str] = Field(default_factory=dict)
    """Versions of the program and its libraries."""
    figures: JobFigures
    compared: tuple[PatternRecord, ...]
    """Patterns of cuts; the first is the one that is planned."""
    undug: tuple[UndugRecord, ...]
    ground: GroundRecord
    """The ground before the first cycle."""
    cycles: tuple[CycleRecord, ...]
    planning_time: Figure = float("nan")
    """Processor time [s]."""

    @property
    def choices_digest(self) -> str:
        """The value that `choices` must have."""
        content = self.model_dump(mode="json", include={"effort", "seed", "compared"})
        content["steps"] = [cycle.step for cycle in self.cycles]
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def job_plan_record(plan: JobPlan, folder: Path | None) -> JobPlanRecord:
    """The record of a plan, for a file in `folder`; None leaves the paths as they are."""
    record = JobPlanRecord(
        verdict=plan.verdict,
        reason=plan.reason,
        message=plan.note,
        machine=plan.robot.urdf.source_from(folder),
        sha256=plan.robot.urdf.sha256,
        job=plan.job.to_dict(),
        folder=relative_path(plan.job.folder, folder),
        site_folder=relative_path(plan.job.site_scene.folder, folder),
        effort=cast(EffortName, plan.effort),
        seed=plan.seed,
        surveyed=plan.surveyed,
        versions=installed_versions(),
        figures=JobFigures.of(plan),
        compared=tuple(_pattern(one) for one in plan.compared),
        undug=tuple(_undug(one) for one in plan.undug),
        ground=GroundRecord.of(plan.start),
        cycles=tuple(_cycle(one) for one in plan.cycles),
        planning_time=plan.planning_time,
    )
    return record.model_copy(update={"choices": record.choices_digest})


def job_figures(plan: JobPlan) -> JobFigures:
    """The figures of a plan."""
    return JobFigures.of(plan)


def job_plan_to_dict(plan: JobPlan) -> dict[str, Any]:
    """The plan as plain data in the layout of its file, without the motions and the ground."""
    left_out: Any = {"ground": True, "cycles": {"__all__": {"legs": {"__all__": {"time", "q"}}, "load": True}}}
    return dict(json.loads(job_plan_record(plan, None).model_dump_json(exclude=left_out)))


def save_job_plan(plan: JobPlan, path: Path) -> None:
    """Write a job's plan file, whole or not at all.

    Raises
    ------
    OutputError: the folder does not exist or cannot be written; or the path is that of one of the job's files.
    """
    check_record(path, (*plan.job.files, *plan.robot.files))
    with whole_file(path) as stream:
        stream.write(job_plan_record(plan, path.parent).model_dump_json() + "\n")


def read_job_plan_file(file: Path) -> JobPlanRecord:
    """Read a job's plan file.

    Raises
    ------
    PlanFileError: the file is damaged or not a job's plan; names the key, what was found and what is allowed.
    """
    text = read_text(file, what="plan", error=PlanFileError)
    refuse_other_kind(text, "job plan", file=file, error=PlanFileError)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PlanFileError(f"is not a plan file: not JSON: {error}", file=file) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = content.get("format") if isinstance(content, dict) else type(content).__name__
        raise PlanFileError("is not the plan of a job", file=file, key="format", found=repr(found), allowed=FORMAT)
    try:
        return JobPlanRecord.model_validate(content)
    except ValidationError as error:
        raise PlanFileError(explain(error, content, root=JobPlanRecord), file=file) from None


def is_job_plan(file: Path) -> bool:
    """Whether a file begins like the plan of a job; false if it cannot be read."""
    try:
        with file.open(encoding="utf-8") as stream:
            return FORMAT in stream.read(200)
    except (OSError, UnicodeDecodeError):
        return False


def _briefly(values: Matrix) -> float | list[list[float]]:
    first = float(values.flat[0])
    return first if (values == first).all() else values.tolist()


def _cycle(cycle: Cycle) -> CycleRecord:
    return CycleRecord(
        step=cycle.step, legs=tuple(LegRecord.of(leg) for leg in cycle.legs),
        load=LoadRecord(swing=cycle.load.swing, r=cycle.load.r.tolist(), mass=cycle.load.mass.tolist()),
        place=tuple(cycle.place.tolist()), truck=cycle.truck, bank=cycle.bank, taken=cycle.taken, held=cycle.held,
        spilt=cycle.spilt, filled=cycle.filled, depth=cycle.depth, duration=cycle.duration, work=cycle.work,
    )  # fmt: skip


def _pattern(one: PatternEstimate) -> PatternRecord:
    # infinite if nothing is dug; a file has neither that nor nan, and `choices` is computed anew from what it has
    cost = one.cost if math.isfinite(one.cost) else math.nan
    return PatternRecord(
        name=one.name, cycles=one.cycles, bank=one.bank, duration=one.duration, work=one.work, cost=cost,
        finished=one.finished, chosen=one.chosen,
    )  # fmt: skip


def _undug(one: Undug) -> UndugRecord:
    low, high = one.low.tolist(), one.high.tolist()
    return UndugRecord(
        reason=one.reason, by=one.by, volume=one.volume, low=(low[0], low[1]), high=(high[0], high[1]), words=one.words
    )
