"""Where to stand: the answer, and all places that were compared for it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Literal

from backhoe_planner.arrays import Matrix
from backhoe_planner.errors import check_path
from backhoe_planner.job import Job, JobPlan, Terrain
from backhoe_planner.machine import Base, Robot
from backhoe_planner.standing.site_map import SiteMap

StandReason = Literal["", "unreachable", "blocked", "not_done"]


@dataclass(frozen=True, eq=False)
class RankedPlace:
    """A place that was compared with others for a `StandPlan`, with its cost as far as it was determined.

    Attributes
    ----------
    base: of the machine.
    given: whether it is the place of the job's file.
    rough: its cost by the site map [s/m^3 or J/m^3], per bank m^3 as all costs; nan if the machine cannot stand there.
    estimated: its cost by the cheap models of the patterns; nan if unknown.
    bank: soil that is dug by the plan, or by the estimate if it is not planned [m^3].
    plan: the full plan; None if it is not planned.
    note: why the machine or the job cannot be there, how much less it digs than the given place if that is too little
        for an answer, or what remains undug; empty if there is nothing to say.
    """

    base: Base
    given: bool
    rough: float
    estimated: float = math.nan
    bank: float = math.nan
    plan: JobPlan | None = None
    note: str = ""

    @property
    def planned(self) -> float:
        """Its cost by the full plan [s/m^3 or J/m^3]; nan if it was not planned."""
        return math.nan if self.plan is None else self.plan.cost


@dataclass(frozen=True, eq=False)
class Place:
    """One of the places from which a job is dug.

    Attributes
    ----------
    base: of the machine.
    plan: of what is dug from there, on the ground as the previous places leave it.
    section: (2, 2) the ends of the part of the trench that is dug from there [m], x, y; None if it is all of it.
    travel: how far the machine moves from the previous place [m]; 0 for the first. Its time is not counted.
    """

    base: Base
    plan: JobPlan
    section: Matrix | None = None
    travel: float = 0.0

    @property
    def job(self) -> Job:
        """The part of the work that is dug from there, as a job of its own."""
        return self.plan.job


@dataclass(frozen=True, eq=False)
class StandPlan:
    """The places from which a job is dug.

    Attributes
    ----------
    job: as it was given.
    places: in order; empty if there is none.
    ranking: of the places that were compared for the whole job, the best first; empty if several places are needed.
    map: the cost by position.
    footprints: (k, 2) outlines of the parts of the machine that do not move [m], in the frame of its root link.
    failure: why the job cannot be dug; empty if it can.
    note: the same in a sentence.
    planning_time: time by the clock that the search took [s].
    robot: the machine; None if it is not known.
    ground: before the first cycle, with what stands on it; None if it is not known.
    dumps: (k, 2) outlines of the areas that the places to dump take up if all soil goes there [m].
    """

    job: Job
    places: tuple[Place, ...]
    ranking: tuple[RankedPlace, ...]
    map: SiteMap
    footprints: tuple[Matrix, ...]
    failure: StandReason = ""
    note: str = ""
    planning_time: float = math.nan
    robot: Robot | None = None
    ground: Terrain | None = None
    dumps: tuple[Matrix, ...] = ()

    @property
    def verified(self) -> bool:
        """Whether the plans of all places are verified and dig all that may be dug."""
        return not self.failure and bool(self.places) and all(place.plan.verified for place in self.places)

    @property
    def verdict(self) -> Literal["verified", "failed"]:
        """`verified` in a word."""
        return "verified" if self.verified else "failed"

    @property
    def reason(self) -> StandReason:
        """Why it failed; empty if verified."""
        return "" if self.verified else self.failure or "not_done"

    @property
    def bank(self) -> float:
        """Bank volume of the soil that is dug from all places [m^3]."""
        return sum(place.plan.bank for place in self.places)

    @property
    def duration(self) -> float:
        """Duration of all cycles, without the machine's own travel [s]."""
        return sum(place.plan.duration for place in self.places)

    @property
    def work(self) -> float:
        """Work of the joints [J]."""
        return sum(place.plan.work for place in self.places)

    @property
    def travel(self) -> float:
        """How far the machine moves between the places [m]."""
        return sum(place.travel for place in self.places)

    @property
    def cost(self) -> float:
        """The objective per bank m^3 [s/m^3 or J/m^3], without the exchange of trucks and the machine's own travel."""
        waits = sum(place.plan.waits for place in self.places)
        total = self.job.objective_of(self.duration - waits, self.work)
        return total / self.bank if self.bank > 0.0 else math.nan

    @property
    def given(self) -> RankedPlace | None:
        """The place of the job's file, as it was compared; None if it was not."""
        return next((one for one in self.ranking if one.given), None)

    @property
    def stays(self) -> bool:
        """Whether the answer is the place of the job's file."""
        return bool(self.places) and bool(self.ranking) and self.ranking[0].given

    @property
    def gain(self) -> float:
        """The part by which the answer costs less than the given place; nan if that is not planned."""
        given = self.given
        return math.nan if given is None or given.plan is None else 1.0 - self.cost / given.planned

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the answer (JSON), and beside it for each place its job (YAML), its plan (JSON) and its ground (CSV).

        Their names begin with that of `path`: ``stand.json``, ``stand_1.yaml``, ``stand_1.json``,
        ``stand_1_ground.csv``, ``stand_2.yaml``, ...

        Raises
        ------
        OutputError: the folder does not exist or cannot be written; or a file is one of the job's.
        """
        from backhoe_planner.standing.stand_file import save_stand

        save_stand(self, check_path(path, key="path"))
