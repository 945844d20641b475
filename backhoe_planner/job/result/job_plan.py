"""A job's plan: its cycles from the first cut to the last, and what could not be dug."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.errors import InputError, check_path
from backhoe_planner.job.ground.off_ground import same_voxels
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Cycle
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.machine import Robot

JobReason = Literal["", "unreachable", "blocked", "too_hard", "full", "not_done", "interrupted"]
UndugReason = Literal["protected", "out_of_reach", "too_hard", "left"]
_SAME_HEIGHT = 1e-9  # m: rounding
_ROUNDING = 1e-9  # of a column's area
LITRES_PER_KWH = 0.25  # of diesel per kWh of the engine: 210 g/kWh at 0.84 kg/l, as makers state for partial load


@dataclass(frozen=True, eq=False)
class Undug:
    """Soil above the design that stays, for one reason.

    Attributes
    ----------
    reason: ``protected`` (an obstacle or zone), ``out_of_reach``, ``too_hard`` (a cylinder), ``left`` (none of these).
    by: the obstacle or zone, the joint or the cylinder; empty if there is none.
    columns: (rows, columns) which columns of the ground.
    volume: its volume, as it lies in the ground [m^3].
    low, high: (2,) least and greatest x, y [m].
    words: the same in a sentence.
    """

    reason: UndugReason
    by: str
    columns: Flags
    volume: float
    low: Vector
    high: Vector
    words: str


@dataclass(frozen=True)
class PatternEstimate:
    """The cost of one pattern of cuts, estimated by the cheap models with which patterns are compared.

    Attributes
    ----------
    name: in words: ``level layers of 0.15 m``.
    cycles: their number.
    bank: soil that the pattern digs, as it lies in the ground [m^3].
    duration: duration of all cycles [s].
    work: work of the joints [J].
    cost: the objective per bank m^3 [s/m^3 or J/m^3].
    finished: whether the pattern digs all that may be dug.
    chosen: whether this pattern is planned.
    """

    name: str
    cycles: int
    bank: float
    duration: float
    work: float
    cost: float
    finished: bool
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class JobPlan:
    """All cycles of a job, verified or not.

    Attributes
    ----------
    job: the job as it was given.
    robot: the machine on its site.
    start: the ground before the first cycle.
    design: (rows, columns) height z of the design at the columns of the ground [m]; nan where nothing is to be dug.
    share: (rows, columns) the part of each column that is within the design, 0 to 1.
    allowed: (rows, columns) the lowest height that may and can be dug [m]; at least `design`, nan where that is.
    outline: (k, 2) corners of a convex area around what is dug [m], x, y.
    cycles: the cycles, one after the other.
    undug: what stays above the design, and why.
    compared: the patterns that were compared, the best first.
    capacity: heaped volume of loose soil in the bucket [m^3].
    effort, seed: as they were given.
    surveyed: whether the ground before the first cycle was given, and is not the job's own.
    failure: why the job ended early; empty if it did not.
    note: the same in a sentence.
    planning_time: time by the clock that planning took, since it was last begun or resumed [s].
    """

    job: Job
    robot: Robot
    start: Terrain
    design: Matrix
    share: Matrix
    allowed: Matrix
    outline: Matrix
    cycles: tuple[Cycle, ...]
    undug: tuple[Undug, ...]
    compared: tuple[PatternEstimate, ...]
    capacity: float
    effort: str
    seed: int
    surveyed: bool = False
    failure: JobReason = ""
    note: str = ""
    planning_time: float = field(default=float("nan"), compare=False)

    @property
    def verified(self) -> bool:
        """Whether every cycle's certificates hold and the design is met wherever it may be dug.

        Never true if there was soil to dig and none of it is dug.
        """
        if not self.cycles and self._is_asked:
            return False
        return not self.failure and all(cycle.verified for cycle in self.cycles) and self.is_met

    @property
    def _is_asked(self) -> bool:
        """Whether there was soil to dig, and none of it had been dug before."""
        asked = (self.start.surface - self.design)[self._whole]
        return bool((asked > self.job.dig.tolerance + 1e-9).all())

    @property
    def verdict(self) -> Literal["verified", "failed"]:
        """`verified` in a word."""
        return "verified" if self.verified else "failed"

    @property
    def reason(self) -> JobReason:
        """Why the plan failed; empty if it is verified."""
        if self.verified:
            return ""
        return self.failure or ("blocked" if not all(cycle.verified for cycle in self.cycles) else "not_done")

    @property
    def refutes_failure(self) -> bool:
        """Whether all cycles hold and the design is met wherever it may be dug, although `failure` says otherwise."""
        return bool(self.failure) and replace(self, failure="").verified

    @property
    def end(self) -> Terrain:
        """The ground after the last cycle."""
        return self.cycles[-1].after if self.cycles else self.start

    @property
    def duration(self) -> float:
        """Duration of all cycles, with the exchange of trucks [s]."""
        return sum(cycle.duration for cycle in self.cycles) + self.waits

    @property
    def waits(self) -> float:
        """Time spent waiting for trucks to replace full ones [s]."""
        truck = self.job.dump.truck
        return 0.0 if truck is None or not self.cycles else truck.exchange * (self.cycles[-1].truck - 1)

    @property
    def work(self) -> float:
        """Work of the joints in all cycles [J]."""
        return sum(cycle.work for cycle in self.cycles)

    @property
    def bank(self) -> float:
        """Soil that left the ground, as it lay there [m^3]."""
        return sum(cycle.bank for cycle in self.cycles)

    @property
    def loose(self) -> float:
        """Loose soil that was dumped [m^3]."""
        return sum(cycle.held for cycle in self.cycles)

    @property
    def production(self) -> float:
        """Bank m^3 per hour, without the exchange of trucks."""
        digging = self.duration - self.waits
        return 3600.0 * self.bank / digging if digging > 0.0 else float("nan")

    @property
    def hydraulic(self) -> float:
        """Energy that the pump delivers in all cycles [J]; nan for a machine without hydraulics."""
        return sum(cycle.hydraulic for cycle in self.cycles)

    @property
    def fuel(self) -> float:
        """Diesel for the pump's energy [l], see `LITRES_PER_KWH`; nan for a machine without hydraulics."""
        hydraulics = self.robot.hydraulics
        if hydraulics is None:
            return float("nan")
        return LITRES_PER_KWH * self.hydraulic / hydraulics.efficiency / 3.6e6

    def mean_use(self, name: Literal["pump", "engine"]) -> float:
        """The mean use of the pump's flow or of the engine's power over all cycles, 0 to 1.

        Raises
        ------
        InputError: there is no such name.
        """
        if not isinstance(name, str) or name not in ("pump", "engine"):
            raise InputError.unknown_name("is not measured", name, names=("pump", "engine"), key="name")
        legs = [leg for cycle in self.cycles for leg in cycle.legs]
        whole = sum(leg.duration for leg in legs)
        return sum(getattr(leg, name) * leg.duration for leg in legs) / whole if whole > 0.0 else float("nan")

    @property
    def cost(self) -> float:
        """The objective per bank m^3 [s/m^3 or J/m^3]."""
        digging = self.job.objective_of(self.duration - self.waits, self.work)
        return digging / self.bank if self.bank > 0.0 else float("nan")

    @property
    def _whole(self) -> Flags:
        """(rows, columns) which columns are wholly within the design: of the others only the mean height is known."""
        return np.asarray(self.share > 1.0 - _ROUNDING)

    @property
    def design_volume(self) -> float:
        """Soil above the design before the first cycle, as it lies there [m^3]."""
        deep = np.where(self.share > 0.0, self.share * (self.start.surface - self.design), 0.0)
        return float(np.maximum(deep, 0.0).sum()) * self.start.cell**2

    @cached_property
    def errors(self) -> Matrix:
        """(rows, columns) height of the final ground above `allowed` [m]; nan for columns not wholly in the design."""
        return np.where(self._whole, self.end.surface - self.allowed, np.nan)

    @property
    def over(self) -> float:
        """Greatest height of ground left above what may be dug [m]: the undercut of the work."""
        return _most(self.errors)

    @property
    def under(self) -> float:
        """Greatest depth below the design [m]."""
        return _most(np.where(self._whole, self.design - self.end.surface, np.nan))

    @cached_property
    def beside(self) -> float:
        """Greatest depth of undisturbed soil that was dug away outside of the design [m].

        Only columns further from the design than the tolerance and a column's edge count: a blade may be wider than
        the design by the tolerance, and takes a part of the columns along its ends.
        """
        from scipy.ndimage import distance_transform_edt

        cell, without = self.start.cell, self.share <= 0.0
        outside = without.all() | (cell * distance_transform_edt(without) > self.job.dig.tolerance + cell)
        return _most(np.where(outside, self.start.bank - self.end.bank, np.nan))

    @property
    def is_met(self) -> bool:
        """Whether the design is met within its tolerance wherever it may be dug, and nothing is dug outside of it."""
        tolerance = self.job.dig.tolerance + 1e-9
        return bool(self._whole.any()) and max(self.over, self.under, self.beside) <= tolerance

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the job's plan file (JSON), whole or not at all.

        Raises
        ------
        OutputError: the folder does not exist or cannot be written; or the path is that of one of the job's files.
        """
        from backhoe_planner.job.result.job_plan_file import save_job_plan

        save_job_plan(self, check_path(path, key="path"))


def same_job(plan: JobPlan, job: Job) -> bool:
    """Whether a plan is one of this very job."""
    own, other = ({**one.to_dict(), "machine": _machine(one)} for one in (plan.job, job))
    return own == other


def _machine(job: Job) -> str:
    source = job.machine_source
    return source if source.startswith("example:") else str(Path(source).resolve())


def same_ground(one: Terrain, other: Terrain) -> bool:
    """Whether two grounds have the same heights in the same columns, and the same standing on them."""
    if one.shape != other.shape or one.cell != other.cell or not np.array_equal(one.low, other.low):
        return False
    if not same_voxels(one.off_ground, other.off_ground):
        return False
    pairs = ((one.bank, other.bank), (one.loose, other.loose))
    return all(bool(np.all(np.abs(a - b) <= _SAME_HEIGHT)) for a, b in pairs)


def interruption(cycles: int) -> str:
    """The message that planning was interrupted after so many cycles."""
    return f"planning was interrupted after {cycles} cycle{'' if cycles == 1 else 's'}; the same command goes on there"


def _most(values: Matrix) -> float:
    """The greatest finite number of `values`, at least 0."""
    finite = values[np.isfinite(values)]
    return max(float(finite.max()), 0.0) if finite.size else 0.0
