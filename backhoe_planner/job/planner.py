"""`plan_job` chooses the pattern of cuts, then plans one cycle after another against the ground as it then is."""

from __future__ import annotations

import reprlib
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import as_count
from backhoe_planner.errors import InputError, SceneError, check_kind
from backhoe_planner.job.checked_job import check_whole_job
from backhoe_planner.job.cuts.cut import NoCut
from backhoe_planner.job.cycles.cycle_planning import CyclePlanner, Failed
from backhoe_planner.job.cycles.patterns import WALLS, NextCut, next_cut, patterns_to_compare
from backhoe_planner.job.estimates import compared_patterns
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Cycle
from backhoe_planner.job.result.job_plan import JobPlan, JobReason, PatternEstimate, interruption, same_ground, same_job
from backhoe_planner.job.schema.job_file import Job
from backhoe_planner.job.undug import find_undug
from backhoe_planner.job.worksite.worksite import Worksite, build_worksite
from backhoe_planner.planning import EFFORTS

DEFAULT_EFFORT = "quick"  # chosen: each of the jobs in scenes/jobs is planned within a minute
_MOST_CYCLES = 5000
_MOST_REFUSED = 25  # cuts in a row that cannot be planned before the job is given up; chosen
_BESIDE = 0.15  # m of radius that are left out next to a cut that could not be planned; chosen
_NO_PROGRESS = 1e-3  # m^3 dug in a cycle: less is no progress


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
    if not isinstance(effort, str) or effort not in EFFORTS:
        raise InputError.unknown_name("no such effort", effort, names=EFFORTS, key="effort")
    if watch is not None and not callable(watch):
        raise InputError("cannot be called", key="watch", found=reprlib.repr(watch))
    if terrain is not None:
        check_kind(terrain, Terrain, key="terrain")
    if resume is not None:
        check_kind(resume, JobPlan, key="resume")
        _check_resumed(resume, job, terrain)
        terrain = resume.start
    begun = clock.monotonic()
    site = build_worksite(job, terrain=terrain)
    run = _Run(site, effort, seed, begun)
    return run.all(resume, watch)


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


class _Run:
    """The planning of one job."""

    def __init__(self, site: Worksite, effort: str, seed: int, begun: float) -> None:
        self._site, self._effort, self._seed, self._begun = site, effort, seed, begun
        self._work = check_whole_job(site)
        self._patterns = patterns_to_compare(site)
        self._compared: tuple[PatternEstimate, ...] = ()

    def all(self, resume: JobPlan | None, watch: Callable[[JobStep], object] | None) -> JobPlan:
        """The plan of the whole job."""
        site = self._site
        self._compared = compared_patterns(self._work, self._patterns) if resume is None else resume.compared
        names = [one.name for one in self._patterns]
        own = next(one for one in self._compared if one.chosen)
        pattern = self._patterns[names.index(own.name)]
        planner = CyclePlanner(site, self._work.dump, effort=self._effort, seed=self._seed)
        cycles = [] if resume is None else list(resume.cycles)
        state = planner.first(site.ground)
        for cycle in cycles:
            state = planner.again(state, cycle)
        at = cycles[-1].legs[-1].trajectory.q[-1] if cycles else site.problem.start_q
        done: dict[int, float] = {}
        failure, note, stopped, too_hard, refused = "", "", "", "", 0

        def leave_out(cut: NextCut) -> None:
            number = self._work.lanes.index(cut.lane)
            done[number] = min(done.get(number, np.inf), float(cut.cut.r[0])) - _BESIDE

        self._tell(watch, cycles, own.cycles)
        while len(cycles) < _MOST_CYCLES:
            found = next_cut(site, self._work.lanes, pattern, state.ground, done=tuple(done.items()))
            if not isinstance(found, NextCut):
                if isinstance(found, NoCut):
                    note = found.reason
                    failure = "" if cycles else _of_no_cut(found)
                    too_hard = note if found.kind == "cylinder" else too_hard
                break
            made = planner.plan(len(cycles) + 1, at, state, found)
            if isinstance(made, Failed):
                note, refused = made.words, refused + 1
                if made.part == "approach" and not cycles and made.words.startswith("at the start "):
                    where = "the ground" if "the ground" in made.words else "what is there"
                    raise SceneError(
                        f"stands in {where} or too near to it", file=site.job.file, key="start", found=made.words,
                        allowed=f"a posture that keeps {site.problem.scene.clearance:g} m from ground and obstacles",
                    )  # fmt: skip
                if made.part in ("full", "unreachable"):
                    # a heap that has grown beyond reach is full
                    failure = "full" if cycles else made.part
                    break
                if made.part == "limits":  # a shallower cut exceeds them, too
                    too_hard = made.words
                elif found.step != WALLS and made.part != "rules":  # without a last cut along a wall most is dug
                    stopped = made.words
                leave_out(found)
                if refused > _MOST_REFUSED:
                    failure = "blocked" if stopped else ""
                    break
                continue
            cycle, after = made
            if cycle.bank + cycle.taken < _NO_PROGRESS:
                note, refused = f"the cut at cycle {cycle.number} takes nothing any more", refused + 1
                if refused > _MOST_REFUSED:
                    break
                leave_out(found)
                continue
            cycles.append(cycle)
            state = after
            at, refused, note = cycle.legs[-1].trajectory.q[-1], 0, ""
            done, stopped, too_hard = {}, "", ""
            self._tell(watch, cycles, own.cycles)
        plan = self._plan(cycles, failure, note)  # type: ignore[arg-type]
        if plan.verified:
            return replace(plan, note="")
        if stopped and failure in ("", "unreachable"):
            # there were cuts, but no motion to dig them or to reach the dump from them
            return self._plan(cycles, "blocked", stopped)
        if too_hard and not plan.failure and not plan.is_met:
            return self._plan(cycles, "too_hard", too_hard)
        if not plan.failure and not plan.is_met and cycles:
            left, why = max(plan.over, plan.under, plan.beside), f": {plan.note}" if plan.note else ""
            return replace(
                plan, note=f"the design is missed by {100.0 * left:.1f} cm, and no cut is found that mends it{why}"
            )
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


def _of_no_cut(found: NoCut) -> JobReason:
    return {"cylinder": "too_hard", "reach": "unreachable", "back": "blocked", "nothing": ""}[found.kind]  # type: ignore[return-value]
