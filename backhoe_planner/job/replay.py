"""Reading a job's plan file: ground, volumes and certificates are recomputed from the motions."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from backhoe_planner.errors import InputError, PlanFileError, RobotError, check_path
from backhoe_planner.job.cuts.cut_rules import broken_rules
from backhoe_planner.job.cuts.profile import Profile
from backhoe_planner.job.cycles.cut_leg import cut_problem, load_of
from backhoe_planner.job.cycles.cycle_planning import CyclePlanner, Dug, dig_and_spill
from backhoe_planner.job.cycles.dump_rules import broken_dump_rules
from backhoe_planner.job.cycles.dumping import SiteState, dump_of
from backhoe_planner.job.cycles.patterns import patterns_to_compare
from backhoe_planner.job.cycles.transfers import make_leg
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.result.cycles import Cycle, CycleLeg, Digging, LegName, Load
from backhoe_planner.job.result.file_differences import job_differences
from backhoe_planner.job.result.job_plan import JobPlan, PatternEstimate, interruption, same_ground
from backhoe_planner.job.result.job_plan_file import (
    CycleRecord,
    JobPlanRecord,
    LegRecord,
    job_plan_record,
    read_job_plan_file,
)
from backhoe_planner.job.schema.job_file import Job, job_from_dict
from backhoe_planner.job.undug import find_undug
from backhoe_planner.job.worksite.checks import in_its_place
from backhoe_planner.job.worksite.lanes import allowed_heights, lanes_of
from backhoe_planner.job.worksite.worksite import Worksite, build_worksite, plain_soil

_SAME_MASS = 1e-6  # kg; volumes that are the same agree to 1e-9 m^3
_SAME_LOAD = 0.02  # of a full bucket: the load is that of the swept columns, apart from rounding; chosen
_OVERFULL = 1.05  # times the bucket's volume; chosen: sweeps take up to 1 % more than the volume wanted of a cut


def load_job_plan(path: str | os.PathLike[str], *, urdf: str | os.PathLike[str] | None = None) -> JobPlan:
    """Read the plan of a job. Ground, volumes and certificates are recomputed, not taken from the file.

    Parameters
    ----------
    path: the file.
    urdf: path of the machine's URDF, if it is no longer where the file says.

    Raises
    ------
    PlanFileError: the file is damaged or not the plan of a job, or a file that its job names is missing; names the key.
    RobotError: the URDF is missing or has changed since the plan was made.
    """
    file = check_path(path, key="path")
    urdf = None if urdf is None else check_path(urdf, key="urdf")
    record = read_job_plan_file(file)
    with _errors_of(file, "job"):
        job = _job(record, file, urdf)
    _check_trucks(record, job, file)
    with _errors_of(file, "ground"):
        stands = record.ground.off_ground
        terrain = Terrain(
            np.array(record.ground.low), record.ground.cell, record.ground.grid("bank"), record.ground.grid("loose"),
            plain_soil(job), job.soil.swell, job.soil.repose, None if stands is None else stands.found,
        )  # fmt: skip
    with _errors_of(file, "job"):
        site = build_worksite(job, terrain=terrain)
    if site.robot.urdf.sha256 != record.sha256:
        raise RobotError(
            "the URDF is not the one with which the job was planned", file=file, key="sha256",
            found=f"{site.robot.urdf.source} has {site.robot.urdf.sha256[:12]}...", allowed=f"{record.sha256[:12]}...",
        )  # fmt: skip
    _check_pattern(record, site, file)
    with _errors_of(file, "job"):
        lanes = lanes_of(site)
        design = site.design_heights()
        allowed, by = allowed_heights(site, lanes, design)
        replay = _Replay(CyclePlanner(site, dump_of(site), effort="quick", seed=record.seed), file)
    cycles = tuple(replay.cycle(number, one) for number, one in enumerate(record.cycles, start=1))
    end = cycles[-1].after if cycles else site.ground
    interrupted = record.reason == "interrupted"
    hard = record.message if record.reason == "too_hard" else ""
    plan = JobPlan(
        job=job, robot=site.robot, start=site.ground, design=design, share=site.share, allowed=allowed,
        outline=site.design.outline,
        cycles=cycles,
        undug=() if interrupted else find_undug(
            site, lanes, (design, allowed, by), end, hard=hard, ended=record.reason
        ),
        compared=tuple(PatternEstimate(**one.model_dump()) for one in record.compared),
        capacity=site.bucket.capacity, effort=record.effort, seed=record.seed, surveyed=record.surveyed,
        failure=record.reason if record.reason not in ("blocked", "not_done") else "",
        note=interruption(len(cycles)) if interrupted else record.message, planning_time=record.planning_time,
    )  # fmt: skip
    problems = replay.problems + _file_problems(record, plan, site)
    return replace(plan, failure="not_done", note="; ".join(problems)) if problems else plan


@contextlib.contextmanager
def _errors_of(file: Path, key: str) -> Iterator[None]:
    """Errors in one part of a plan file are raised with the file and the key."""
    try:
        yield
    except (RobotError, PlanFileError):
        raise
    except (InputError, ValueError) as error:
        raise PlanFileError(str(error), file=file, key=key) from None


def _file_problems(record: JobPlanRecord, plan: JobPlan, site: Worksite) -> list[str]:
    """Other claims of a file that do not hold: the ground at the beginning, the choices, and all figures."""
    found = []
    is_own = same_ground(site.own_ground, plan.start)
    if not plan.surveyed and not is_own:
        found.append("the ground before the first cycle is not that of the job")
    if plan.surveyed and is_own:
        found.append("the file says that the ground was surveyed, which is that of the job")
    if record.choices != record.choices_digest:
        found.append("effort, seed, compared patterns or steps were changed after the job was planned")
    stands = in_its_place(site)
    if stands is not None:
        found.append(f"{stands.link} of the machine is in {stands.obstacle}")
    if plan.beside > plan.job.dig.tolerance:
        found.append(f"the cuts go {plan.beside:.2f} m deep beside what is to be dug")
    return found + job_differences(record, job_plan_record(plan, None))


def _job(record: JobPlanRecord, file: Path, urdf: Path | None) -> Job:
    content: Mapping[str, object] = record.job
    machine = record.machine if urdf is None else str(urdf)
    if urdf is None and not machine.startswith("example:"):
        beside = [path for path in (file.parent / machine, Path(machine)) if path.is_file()]
        if not beside:
            raise RobotError(
                "the URDF with which the job was planned was not found", file=file, key="machine", found=machine,
                hint="give its path: --urdf FILE, in the library load_job_plan(..., urdf=FILE)",
            )  # fmt: skip
        machine = str(beside[0].resolve())
    elif not machine.startswith("example:"):
        machine = str(Path(machine).resolve())
    return job_from_dict(
        {**content, "machine": machine},
        folder=file.parent / record.folder,
        site_folder=file.parent / record.site_folder,
    )


def _check_pattern(record: JobPlanRecord, site: Worksite, file: Path) -> None:
    """Check that the job has the compared patterns, and that exactly one is chosen."""
    names = [one.name for one in patterns_to_compare(site)]
    for index, one in enumerate(record.compared):
        if one.name not in names:
            raise PlanFileError.unknown_name(
                "is no pattern of this job", one.name, names=names, file=file, key=f"compared[{index}].name"
            )
    chosen = sum(one.chosen for one in record.compared)
    if chosen != 1:
        raise PlanFileError(
            "does not say which pattern is planned", file=file, key="compared",
            found=f"{chosen} of {len(record.compared)} are chosen", allowed="one that is chosen",
        )  # fmt: skip


def _check_trucks(record: JobPlanRecord, job: Job, file: Path) -> None:
    """Check that a cycle has the number of a truck if and only if the job loads trucks."""
    for index, cycle in enumerate(record.cycles):
        if (cycle.truck == 0) != (job.dump.truck is None):
            raise PlanFileError(
                "is not where the job dumps", file=file, key=f"cycles[{index}].truck", found=cycle.truck,
                allowed="0 for a heap" if job.dump.truck is None else "the number of a truck, from 1",
            )  # fmt: skip


class _Replay:
    """Rebuilds cycles from their motions, one after the other."""

    def __init__(self, planner: CyclePlanner, file: Path) -> None:
        self._planner, self._site, self._file = planner, planner.site, file
        self._state = planner.first(planner.site.ground)
        self._at = planner.site.problem.start_q
        self.problems: list[str] = []

    def cycle(self, number: int, record: CycleRecord) -> Cycle:
        """The cycle of a record, on the ground that the earlier cycles leave."""
        site, planner, before = self._site, self._planner, self._state
        key = f"cycles[{number - 1}]"
        motions = {leg.name: leg for leg in record.legs}
        self._check_names([leg.name for leg in record.legs], key)
        self._check_motions(record, key)
        load = self._load(record, key)
        with _errors_of(self._file, key):
            dug = dig_and_spill(site, motions["cut"].trajectory, load.swing, before.ground)
            after_cut = planner.after_cut(dug.ground, before)
            after = planner.dumped(after_cut, np.array(record.place[:2]), dug.held, record.truck)
        if isinstance(after, str):
            self.problems.append(f"cycle {number}: {after}")
            after = after_cut
        self._check_soil(number, record, load, dug, before.ground)
        legs = []
        for one in record.legs:
            state = {"approach": before, "cut": before, "swing": after_cut}.get(one.name, after)
            legs.append(self._leg(number, one, load, dug.digging, state))
        self._state = after
        return Cycle(
            number, tuple(legs), dug.digging, load, before=before.ground, dug=dug.ground, after=after.ground,
            bank=dug.bank, taken=dug.taken, held=dug.held, spilt=dug.spilt, place=np.array(record.place),
            truck=record.truck, truck_load=after.truck_load, step=record.step, filled=dug.held / site.bucket.capacity,
            depth=dug.depth,
        )  # fmt: skip

    def _check_names(self, names: list[LegName], key: str) -> None:
        """Check that a cycle cuts, swings and dumps, in this order."""
        if names[names[:1] == ["approach"] :] != ["cut", "swing", "dump"]:
            allowed = "cut, swing, dump, with an approach before them"
            raise PlanFileError("are not those of a cycle", file=self._file, key=f"{key}.legs", found=names,
                                allowed=allowed)  # fmt: skip

    def _check_motions(self, record: CycleRecord, key: str) -> None:
        """Check that every leg is a motion of this machine's joints."""
        n = self._site.robot.n
        for index, leg in enumerate(record.legs):
            with _errors_of(self._file, f"{key}.legs[{index}]"):
                found = leg.trajectory.q.shape[1]
            if found != n:
                raise PlanFileError("has other joints than the machine", file=self._file, key=f"{key}.legs[{index}].q",
                                    found=f"{found} in a row", allowed=f"{n} in a row")  # fmt: skip

    def _load(self, record: CycleRecord, key: str) -> Load:
        r, mass = np.array(record.load.r), np.array(record.load.mass)
        if len(r) != len(mass) or len(r) == 0 or np.any(np.diff(r) > 0.0):
            raise PlanFileError("is not the load along a cut", file=self._file, key=f"{key}.load",
                                found=f"{len(r)} distances and {len(mass)} masses",
                                allowed="one mass for every distance, these not increasing")  # fmt: skip
        return Load(record.load.swing, r, mass)

    def _check_soil(self, number: int, record: CycleRecord, load: Load, dug: Dug, before: Terrain) -> None:
        """Check that the motions dig and dump properly, and that the legs carry what the cut has dug."""
        site, digger, capacity = self._site, self._site.digger, self._site.bucket.capacity
        motions = {leg.name: leg.trajectory for leg in record.legs}
        profile = Profile.of_terrain(before, site.plane, load.swing, width=site.bucket.width)
        broken = broken_rules(digger, profile, motions["cut"].q, swing=load.swing)
        broken += [f"the dump: {one}" for one in broken_dump_rules(site, motions["dump"].q, np.array(record.place[:2]))]
        volume = dug.held + dug.spilt
        if volume > _OVERFULL * max(capacity, site.volume):
            broken.append(f"the cut takes {volume:.2f} m^3 of loose soil, the bucket holds {capacity:.2f} m^3")
        self.problems += [f"cycle {number}: {one}" for one in broken]
        per_volume = digger.soil.density / site.job.soil.swell
        swept = load_of(site, load.swing, dug.digging)
        # compared at the distances of both: between those of one, the other may differ by anything
        r = np.concatenate((swept.r, load.r))
        holds, said = (np.interp(r, one.r[::-1], one.mass[::-1]) for one in (swept, load))
        off = np.abs(holds - said)
        if np.any(off > _SAME_LOAD * per_volume * capacity):
            at = int(np.argmax(off))
            where = f"with the teeth at r {r[at]:.2f} m"
            words = f"{said[at]:.0f} kg in the bucket {where}, it holds {holds[at]:.0f} kg"
            self.problems.append(f"cycle {number}: during the cut the file says {words}")
        full = per_volume * dug.held
        for leg in record.legs:
            if leg.name in ("cut", "swing", "dump") and abs(leg.payload - full) > _SAME_MASS:
                words = f"the file says {leg.payload:.3f} kg in the bucket, the cut has dug {full:.3f} kg"
                self.problems.append(f"cycle {number}, {leg.name}: {words}")
            elif leg.name == "approach" and leg.payload != 0.0:
                self.problems.append(f"cycle {number}, {leg.name}: the bucket is empty, not with {leg.payload:g} kg")

    def _leg(self, number: int, record: LegRecord, load: Load, digging: Digging, state: SiteState) -> CycleLeg:
        motion = record.trajectory
        problem = self._planner.leg_problem(record.name, motion, state, record.payload)
        if record.name == "cut":
            problem = cut_problem(self._site, load, digging, problem, state.ground)
        if self._at is not None and float(np.max(np.abs(motion.q[0] - self._at))) > 1e-9:
            self.problems.append(f"cycle {number}: the {record.name} does not begin where the machine stands")
        self._at = motion.q[-1]
        leg = make_leg(record.name, problem, motion)
        if not leg.certificate.verified:
            self.problems.append(f"cycle {number}, {record.name}: {'; '.join(leg.certificate.problems)}")
        return replace(leg, payload=record.payload)
