"""`plan_job` chooses the pattern of cuts, then plans one cycle after another against the ground as it then is."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import as_count
from backhoe_planner.errors import InputError, SceneError, check_callable, check_kind
from backhoe_planner.job.checked_job import CheckedJob, check_whole_job
from backhoe_planner.job.cuts.cut import NoCut
from backhoe_planner.job.cuts.digger import RESERVE
from backhoe_planner.job.cycles.cycle_planning import CyclePlanner, Failed
from backhoe_planner.job.cycles.patterns import WALLS, NextCut, next_cut, patterns_to_compare
from backhoe_planner.job.cycles.transfers import Transfer
from backhoe_planner.job.estimates import compared_patterns
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.job_estimate import JobEstimate
from backhoe_planner.job.result.cycles import Cycle
from backhoe_planner.job.result.job_plan import JobPlan, JobReason, PatternEstimate, interruption, same_ground, same_job
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.undug import find_undug
from backhoe_planner.job.worksite.worksite import build_worksite
from backhoe_planner.planning import check_effort

DEFAULT_EFFORT = "quick"  # chosen: each of the jobs in scenes/jobs is planned within a minute
_MOST_CYCLES = 5000  # of a job; chosen, it only ends what would not end
_MOST_REFUSED = 25  # cuts in a row that cannot be planned before the job is given up; chosen
_BESIDE = 0.15  # m of radius that are left out next to a cut that could not be planned; chosen
_NO_PROGRESS = 1e-3  # m^3 dug in a cycle: less is no progress
_HELD_BACK = 0.9  # of what a cylinder may hold: its force decides how deep such a cut is, found to 1 %; chosen
_NO_PLACE = ("full", "unreachable")  # parts of a failed cycle: its soil cannot be dumped anywhere
# the reasons of jobs in which not even one cut is found, by what is in its way
_END_WITHOUT_CUT: dict[str, JobReason] = {
    "cylinder": "too_hard",
    "reach": "unreachable",
    "back": "blocked",
    "nothing": "",
}


@dataclass(frozen=True, eq=False)
class JobStep:
    """A report on the progress of planning a job.

    Attributes
    ----------
    plan: the job as far as it has been planned.
    expected: estimated number of cycles of the whole job.
    """

    plan: JobPlan
    expected: int


def plan_job(
    job: Job,
    *,
    effort: str = DEFAULT_EFFORT,
    seed: int = 0,
    terrain: Terrain | None = None,
    resume: JobPlan | None = None,
    watch: Callable[[JobStep], object] | None = None,
) -> JobPlan:
    """Plan all cycles of a job.

    Parameters
    ----------
    job: machine, site, what is dug, and where the soil goes.
    effort: ``quick``, ``normal`` or ``thorough``: how much counted work the search for every motion may take.
    seed: seed of every random choice, not negative.
    terrain: the ground as it is now, such as a scan of what was really dug; by default that of the job.
    resume: the unfinished plan of the same job: its cycles are kept, and planning continues after them.
    watch: called with a `JobStep` before the first cycle and after each.

    Returns
    -------
    A plan in any case; `JobPlan.verdict` is ``verified`` only if every motion is proven and the design is met
    wherever it may be dug.

    Raises
    ------
    InputError: the job cannot be done as it is written; or an argument is not allowed.
    """
    check_kind(job, Job, key="job")
    seed = as_count(seed, key="seed")
    effort, watch = check_effort(effort), check_callable(watch, key="watch")
    if terrain is not None:
        check_kind(terrain, Terrain, key="terrain")
    if resume is not None:
        check_kind(resume, JobPlan, key="resume")
        _check_resumed(resume, job, terrain)
        terrain = resume.start
    begun = clock.monotonic()
    site = build_worksite(job, terrain=terrain)
    run = _Run(check_whole_job(site), effort, seed, begun)
    return run.all(resume, watch)


def plan_estimated(estimate: JobEstimate, *, effort: str, seed: int) -> JobPlan:
    """The plan of `plan_job` for a job some of whose patterns have been estimated: these are not estimated again.

    Parameters
    ----------
    effort, seed: as for `plan_job`, and checked.
    """
    return _Run(estimate.work, effort, seed, clock.monotonic(), estimate.estimates).all(None, None)


def _check_resumed(resume: JobPlan, job: Job, terrain: Terrain | None) -> None:
    """Raise InputError unless the plan is an interrupted one of this job."""
    if not same_job(resume, job):
        raise InputError("is the plan of another job", key="resume", found=resume.job.name)
    if resume.reason != "interrupted":
        raise InputError(
            "is not the plan of a job that was interrupted", key="resume", found=resume.note or resume.verdict,
            allowed="a plan whose reason is interrupted",
        )  # fmt: skip
    if terrain is not None and not same_ground(resume.start, terrain):
        raise InputError(
            "is not the ground on which the resumed plan began",
            key="terrain",
            allowed="the ground of that plan, or none",
        )


class _Refusals:
    """The cuts that were refused since the last cycle.

    Attributes
    ----------
    note: why the last one was refused, in words; empty if none was.
    blocked: why no motion digs one of them, or reaches the dump from it, in words; empty if none was for that.
    too_hard: why the machine is too weak for one of them, in words; empty if none was for that.
    """

    def __init__(self) -> None:
        self.note = self.blocked = self.too_hard = ""
        self._count = 0
        self._left_out: dict[int, float] = {}

    @property
    def too_many(self) -> bool:
        """Whether so many were refused that the job is given up."""
        return self._count > _MOST_REFUSED

    @property
    def left_out(self) -> tuple[tuple[int, float], ...]:
        """The numbers of lanes, each with the radius [m] beyond which nothing more is tried in it."""
        return tuple(self._left_out.items())

    def add(self, found: NextCut, lane: int, note: str) -> None:
        """Refuse a cut in a lane of that number: it is left out, and what lies beside it."""
        self._count += 1
        self.note = note
        self._left_out[lane] = min(self._left_out.get(lane, np.inf), float(found.cut.r[0])) - _BESIDE

    def add_empty(self, found: NextCut, lane: int, number: int) -> None:
        """Refuse a cut that takes nothing at the cycle of that number."""
        self.add(found, lane, f"the cut at cycle {number} takes nothing any more")
        holding = found.cut.holding
        if holding.ratio > _HELD_BACK * (1.0 - RESERVE):
            depth = 100.0 * found.cut.greatest_depth
            self.too_hard = f"this soil cannot be cut deeper than {depth:.0f} cm there: {holding.describe()}"

    def add_failed(self, found: NextCut, lane: int, failed: Failed, number: int) -> None:
        """Refuse a cut of which no cycle, of that number, could be planned."""
        self.add(found, lane, failed.words)
        if failed.part == "limits":  # a shallower cut exceeds them, too
            self.too_hard = failed.words
        elif found.step != WALLS and failed.part not in ("rules", *_NO_PLACE):
            # not by a last cut along a wall: without it most is dug
            self.blocked = f"{failed.part} of cycle {number}: {failed.words}"

    def add_no_cut(self, found: NoCut) -> None:
        """Note that nothing more is found to dig."""
        self.note = found.reason
        if found.kind == "cylinder":
            self.too_hard = found.reason


class _Run:
    """The planning of one job."""

    def __init__(
        self, work: CheckedJob, effort: str, seed: int, begun: float, known: Sequence[PatternEstimate] = ()
    ) -> None:
        self._work, self._site = work, work.site
        self._effort, self._seed, self._begun, self._known = effort, seed, begun, known
        self._patterns = patterns_to_compare(self._site)
        self._compared: tuple[PatternEstimate, ...] = ()

    def all(self, resume: JobPlan | None, watch: Callable[[JobStep], object] | None) -> JobPlan:
        """The plan of the whole job."""
        planner = CyclePlanner(self._site, self._work.dump, effort=self._effort, seed=self._seed)
        state, start = self._work.dump.first(self._site.ground, self._work.grounds), self._site.problem.start_q
        cycles = [] if resume is None else list(resume.cycles)
        # before the patterns are compared, which takes longer
        if start is not None and not cycles and (stay := planner.stay_in_something(start, state)) is not None:
            raise self._bad_start(stay)
        if resume is None:
            self._compared = compared_patterns(self._work, self._patterns, self._known)
        else:
            self._compared = resume.compared
        own = next(one for one in self._compared if one.chosen)
        pattern = next(one for one in self._patterns if one.name == own.name)
        refusals = _Refusals()
        ended: JobReason | None = None
        for cycle in cycles:
            state = planner.again(state, cycle)
        self._tell(watch, cycles, own.cycles)
        while ended is None and len(cycles) < _MOST_CYCLES:
            found = next_cut(self._site, self._work.lanes, pattern, state.ground, done=refusals.left_out)
            if found is None:
                break
            if isinstance(found, NoCut):
                refusals.add_no_cut(found)
                ended = "" if cycles else _END_WITHOUT_CUT[found.kind]
                break
            lane = self._work.lanes.index(found.lane)
            at = cycles[-1].legs[-1].trajectory.q[-1] if cycles else start
            made = planner.plan(len(cycles) + 1, at, state, found)
            if isinstance(made, Failed):
                refusals.add_failed(found, lane, made, len(cycles) + 1)
                ended = self._end_after(made, refusals, begun=bool(cycles))
            elif made[0].bank + made[0].taken < _NO_PROGRESS:
                refusals.add_empty(found, lane, made[0].number)
                ended = "" if refusals.too_many else None
            else:
                cycle, state = made
                cycles.append(cycle)
                refusals = _Refusals()
                self._tell(watch, cycles, own.cycles)
        return self._concluded(cycles, ended or "", refusals)

    def _bad_start(self, stay: Transfer) -> SceneError:
        """The error for a start from which no motion can begin."""
        return SceneError(
            f"stands in {stay.stands_in} or too near to it", file=self._site.job.file, key="start",
            found=stay.why,
            allowed=f"a posture that keeps {self._site.problem.scene.clearance:g} m from ground and obstacles",
        )  # fmt: skip

    @staticmethod
    def _end_after(failed: Failed, refusals: _Refusals, *, begun: bool) -> JobReason | None:
        """The reason with which a job ends after a cut was refused; None if others are tried."""
        if failed.part in _NO_PLACE:
            # a heap that has grown beyond reach is full
            return "full" if begun or failed.part == "full" else "unreachable"
        if refusals.too_many:
            return "blocked" if refusals.blocked else ""
        return None

    def _concluded(self, cycles: list[Cycle], ended: JobReason, refusals: _Refusals) -> JobPlan:
        """The plan after the last cycle.

        Parameters
        ----------
        ended: the reason with which the job ended.
        refusals: the cuts that were refused since the last cycle.
        """
        plan = self._plan(cycles, ended, refusals.note)
        if plan.verified:
            return replace(plan, note="")
        if refusals.blocked and ended in ("", "unreachable"):
            # there were cuts, but no motion to dig them or to reach the dump from them
            return self._plan(cycles, "blocked", refusals.blocked)
        if plan.failure or plan.is_met:
            return plan
        if refusals.too_hard:
            return self._plan(cycles, "too_hard", refusals.too_hard)
        if cycles:
            left, why = max(plan.over, plan.under, plan.beside), f": {plan.note}" if plan.note else ""
            note = f"the design is missed by {100.0 * left:.1f} cm, and no cut is found that mends it{why}"
            return replace(plan, note=note)
        return plan

    def _tell(self, watch: Callable[[JobStep], object] | None, cycles: list[Cycle], expected: int) -> None:
        if watch is not None:
            watch(
                JobStep(
                    self._plan(cycles, "interrupted", interruption(len(cycles))),
                    max(expected, len(cycles)),
                )
            )

    def _plan(self, cycles: list[Cycle], failure: JobReason, note: str) -> JobPlan:
        site, work = self._site, self._work
        end = cycles[-1].after if cycles else site.ground
        hard = note if failure == "too_hard" else ""
        heights = (work.design, work.allowed, work.lane_of)
        undug = () if failure == "interrupted" else find_undug(site, work.lanes, heights, end, hard=hard, ended=failure)
        return JobPlan(
            job=site.job, robot=site.robot, start=site.ground, design=work.design, share=site.share,
            allowed=work.allowed, outline=site.design.outline, cycles=tuple(cycles), undug=undug,
            compared=self._compared,
            capacity=site.bucket.capacity, effort=self._effort, seed=self._seed,
            surveyed=not same_ground(site.own_ground, site.ground), failure=failure, note=note,
            planning_time=clock.monotonic() - self._begun,
        )  # fmt: skip
