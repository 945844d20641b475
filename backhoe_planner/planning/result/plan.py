"""A plan: the task, the motion that was found, and its certificate."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.digits import margin_text
from backhoe_planner.errors import PlanFileError, RobotError, SceneError, check_kind, check_path
from backhoe_planner.files.differences import differences
from backhoe_planner.files.output_file import check_record, whole_file
from backhoe_planner.files.provenance import installed_versions, relative_path
from backhoe_planner.machine import BatchKinematics, MotionEnergy, Robot
from backhoe_planner.motion import Problem, Trajectory, build_problem, leg_parts, trajectory_energy
from backhoe_planner.planning.report.comparison import describe_saving
from backhoe_planner.planning.report.quantities import describe_quantity
from backhoe_planner.planning.result.bound import Bound, measure_bound
from backhoe_planner.planning.result.findings import NOTHING, Findings
from backhoe_planner.planning.result.metrics import Metrics, measure_motion
from backhoe_planner.planning.result.plan_file import (
    CertificateRecord,
    DynamicsRecord,
    LegRecord,
    Method,
    PlanRecord,
    Reason,
    RobotRecord,
    TrajectoryRecord,
    read_plan_file,
)
from backhoe_planner.planning.search.effort import EFFORTS, EffortName
from backhoe_planner.proof import Certificate, certify_motion, certify_problem
from backhoe_planner.site import Scene, load_machine, scene_from_dict

METHODS: tuple[Method, ...] = ("auto", "reactive", "optimal", "paper")  # "teleop" is driven by hand
# % above the bound; of 24 random sites of the backhoe, the fastest known motions of nine in ten are at most 26 % above
_FAR = 25.0
_MORE_EFFORT = {"quick": "normal", "normal": "thorough"}
_COMPUTED = ("dynamics", "certificate", "metrics", "bound", "legs")  # keys of a file that follow from its motion
_SAVES = 0.99  # times the cost of a fast motion, up to which a motion counts as cheaper; chosen
_BINDS = 0.98  # part of the allowed time from which it limits a motion; chosen: timing after the search saves a little
_NOT_COMPUTED = {"metrics": {"planning_time", "objective"}, "legs": {"findings"}}


@dataclass(frozen=True, eq=False)
class PlannedLeg:
    """One leg of the plan of a sequence.

    Attributes
    ----------
    name: of the leg.
    first, last: its first and last sample in the whole motion; the last is the first of the next leg.
    begins: when the leg begins [s].
    problem: of the leg, with its start; its clock begins with the leg.
    trajectory: its part of the motion, on that clock; it may join the neighbouring legs without a stop.
    certificate: what is proven of that part.
    metrics: duration, lengths and energy of that part.
    findings: what the planner found out while it searched.
    """

    name: str
    first: int
    last: int
    begins: float
    problem: Problem
    trajectory: Trajectory
    certificate: Certificate
    metrics: Metrics
    findings: Findings = NOTHING

    def __repr__(self) -> str:
        """One line: name, verdict, and when it begins and ends."""
        verdict, ends = "verified" if self.certificate.verified else "failed", self.begins + self.trajectory.duration
        return f"<PlannedLeg {self.name!r}, {verdict}, {self.begins:.2f} to {ends:.2f} s>"

    @property
    def cost(self) -> str:
        """What it costs by its own objective, in words: ``work 11.39 kJ``.

        Empty if the objective is the time, which is its duration, for a wait, and for a leg of an older file.
        """
        cost = self.metrics.cost
        if self.problem.wait is not None or self.problem.objective.is_time or cost is None:
            return ""
        return f"{cost.objective} {describe_quantity(cost.value, cost.unit)}"

    @property
    def allowed_time(self) -> str:
        """How long it was allowed to take; see `Plan.allowed_time`."""
        return _allowed_time(self.findings, self.problem, self.trajectory.duration)

    @property
    def saving(self) -> str:
        """How much less it costs than the fast motion from which its search began; see `Plan.saving`."""
        return _saving(self.findings, self.metrics) if self.certificate.verified else ""


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """The result of planning, verified or not.

    The certificate alone decides. If it holds, the plan is verified even if the planner
    gave up or ran out of time: every clearance and limit is proven and the task is done;
    only the search for a better motion ended early. Then `reason` is empty, and `message`
    keeps the planner's message.

    Attributes
    ----------
    problem: machine and scene together.
    method, seed: as given.
    trajectory: the motion; if planning failed, the best one found, which may
        be the start alone.
    certificate: what is proven of the motion.
    metrics: duration, lengths, energy, detours, and the comparison with the local law.
    findings: what the planner found out while it searched, such as what is in the way.
    failure: why planning failed, according to the planner; empty if it did not fail.
    note: the same in a sentence, with its numbers; also that time ran out while the motion was being improved.
    effort: as given; None for a motion driven by hand and for an older file.
    legs: every leg of a sequence that the motion has begun; empty without a sequence.
    boxes: how many boxes of configurations the bound may examine; 0 if the planner made no bound.
    """

    problem: Problem
    method: Method
    seed: int
    trajectory: Trajectory
    certificate: Certificate
    metrics: Metrics
    findings: Findings = NOTHING
    failure: Reason = ""
    note: str = ""
    effort: EffortName | None = None
    legs: tuple[PlannedLeg, ...] = ()
    boxes: int = 0

    def __repr__(self) -> str:
        """One line: reason or verdict, duration, and what is nearest to the machine."""
        nearest = self.certificate.clearances[:1]
        near = [f"margin {margin_text(one.margin)} m between {one.link} and {one.name}" for one in nearest]
        return f"<Plan {', '.join([self.reason or self.verdict, f'{self.trajectory.duration:.2f} s', *near])}>"

    @cached_property
    def bound(self) -> Bound | None:
        """Lower bounds for any motion to the goal; None along a path, and if the plan is not verified.

        They are computed at the first access.
        """
        if not self.boxes:
            return None
        return measure_bound(self.problem, self.trajectory, self.certificate, boxes=self.boxes)

    @property
    def robot(self) -> Robot:
        """The machine of the plan."""
        return self.problem.robot

    @property
    def scene(self) -> Scene:
        """The scene as given."""
        return self.problem.scene

    @property
    def verified(self) -> bool:
        """Whether the certificate holds."""
        return self.certificate.verified

    @property
    def verdict(self) -> Literal["verified", "failed"]:
        """`verified` as a word."""
        return "verified" if self.verified else "failed"

    @property
    def has_motion(self) -> bool:
        """Whether there is a motion: one of 0 s on the goal counts, a configuration that came nearest does not."""
        return len(self.trajectory) > 1 or self.verified

    @property
    def reason(self) -> Reason:
        """Why the plan failed: the planner's reason, otherwise what the certificate shows; empty if verified."""
        if self.verified:
            return ""
        if self.failure:
            return self.failure
        step = self.certificate.tracking.joint_step
        if not all(use.kept for use in self.certificate.uses.values()) or (step is not None and not step.kept):
            return "outside_limits"
        return "not_done" if self.certificate.safe else "blocked"

    @property
    def message(self) -> str:
        """`reason` in a sentence, with its numbers; for a verified plan the planner's note, mostly empty."""
        return self.note or "; ".join(self.certificate.problems)

    @property
    def minimised(self) -> str:
        """The name of the objective that was minimised for the whole motion, whose value is `metrics.cost`.

        It is given for a motion to a goal, and for a sequence if all legs that move have the same objective. It is
        empty along a path, where only the part along it counts, for a motion driven by hand, and for an older file.
        """
        if self.method == "teleop" or self.metrics.cost is None:
            return ""
        parts = [leg for leg in self.problem.legs if leg.wait is None] or [self.problem] * bool(self.problem.goals)
        name = self.metrics.cost.objective
        return name if {part.objective.name for part in parts} == {name} else ""

    @property
    def excess(self) -> str:
        """How much longer the motion takes than the lower bound of the duration, in words.

        Empty for another objective than the time, for which slower is mostly cheaper, and if there is no such bound.
        """
        return self.bound.excess if self.bound is not None and self.minimised == "time" else ""

    @property
    def allowed_time(self) -> str:
        """How long the motion was allowed to take and by whom, in words, and whether it takes all of that.

        If it does, and the planner set that time, the key of the scene that may allow more is named. Empty if the time
        is minimised. Otherwise a slower motion mostly costs less, and the planner sets a limit.
        """
        return _allowed_time(self.findings, self.problem, self.trajectory.duration)

    @property
    def saving(self) -> str:
        """How much less the motion costs than the fast one from which the search began, in words.

        Empty if the time is minimised, along a path, for a plan that is not verified, and for less than 1 %.
        """
        return _saving(self.findings, self.metrics) if self.verified else ""

    @property
    def settings(self) -> str:
        """The settings of the planner in words: ``method auto, seed 0, effort normal``."""
        if self.method == "teleop":
            return "driven by hand"
        effort = "" if self.effort is None else f", effort {self.effort}"
        return f"method {self.method}, seed {self.seed}{effort}"

    @property
    def advice(self) -> str:
        """How a better motion may be found, in words: ``--effort normal may find a cheaper motion``; mostly empty.

        It is given for a verified plan with the quick effort that minimises another cost than the time, or that takes
        much longer than the lower bound; and for a plan that fails only because `max_duration` is too short for it.
        """
        if self.method not in ("auto", "optimal"):
            return ""
        if not self.verified:
            return self._advice_on_duration()
        if self.effort != "quick":
            return ""
        moving = [leg for leg in self.problem.legs if leg.wait is None] or [self.problem]
        if not all(part.objective.is_time for part in moving):
            return "--effort normal may find a cheaper motion"
        far = self.excess and self.bound is not None and self.bound.longer_percent > _FAR
        return "--effort normal may find a faster motion" if far else ""

    def _advice_on_duration(self) -> str:
        """Which `max_duration` allows the motion of a failed plan; empty if anything else is wrong with it."""
        use = self.certificate.duration
        if self.failure not in ("", "outside_limits") or len(self.certificate.problems) > 1 or use is None or use.kept:
            return ""
        longer = f"max_duration: {math.ceil(100.0 * use.needed) / 100.0:.2f} allows this motion"
        more = "another --seed may find a faster one"
        if self.effort in _MORE_EFFORT:
            more = f"--effort {_MORE_EFFORT[self.effort]} or {more}"
        return f"{f'in leg {use.leg}, ' * bool(use.leg)}{longer}; {more}"

    @property
    def input_files(self) -> tuple[Path, ...]:
        """The files from which machine and scene were read; no output may replace one of them."""
        return (*self.robot.files, *self.scene.files)

    def tip_path(self) -> NDArray[np.float64]:
        """(T, 3) positions of the tip at the samples [m], in the world frame."""
        return BatchKinematics(self.robot).tip_positions(self.trajectory.q)

    def energy(self) -> MotionEnergy:
        """Torques, power and work over the samples, with the scene's payload and soil."""
        return trajectory_energy(self.problem, self.trajectory)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan file (JSON), whole or not at all.

        Raises
        ------
        OutputError: the folder does not exist or cannot be written; or the file is one of the machine's or the scene's.
        """
        path = check_path(path, key="path")
        check_record(path, self.input_files)
        with whole_file(path) as stream:
            stream.write(_record(self, path.parent).model_dump_json() + "\n")


def _allowed_time(findings: Findings, problem: Problem, duration: float) -> str:
    """See `Plan.allowed_time`; `duration` is that of the motion [s]."""
    longest = findings.allowed_time
    if longest is None:
        return ""
    binds = duration >= _BINDS * longest
    by_scene = longest >= problem.max_duration
    by = "max_duration" if by_scene else "the planner"
    more = "" if by_scene else ": max_duration may allow more"
    return f"at most {longest:.2f} s was allowed by {by}" + f", which limits it{more}" * binds


def _saving(findings: Findings, metrics: Metrics) -> str:
    """See `Plan.saving`."""
    fast, cost = findings.fast, metrics.cost
    if fast is None or cost is None or cost.value > _SAVES * fast.cost:
        return ""
    less = describe_saving(100.0 * (1.0 - cost.value / fast.cost))
    return f"{less} than a motion of {fast.duration:.2f} s, which takes {describe_quantity(fast.cost, cost.unit)}"


def planned_legs(
    problem: Problem, trajectory: Trajectory, certificate: Certificate, found: Sequence[Findings]
) -> tuple[PlannedLeg, ...]:
    """The legs of a plan, from its motion; none if the problem is not a sequence.

    Parameters
    ----------
    certificate: of the motion.
    found: the planner's findings for every leg.
    """
    if not problem.legs:
        return ()
    legs = []
    for index, (part, of_leg) in enumerate(zip(leg_parts(problem, trajectory), certificate.legs, strict=True)):
        findings = found[index] if index < len(found) else NOTHING
        own = of_leg.certificate
        legs.append(
            PlannedLeg(
                part.name, part.first, part.last, part.begins, part.problem, part.motion, own,
                measure_motion(part.problem, part.motion, own, detours=findings.detours), findings,
            )
        )  # fmt: skip
    return tuple(legs)


def plan_to_dict(plan: Plan) -> dict[str, Any]:
    """The plan as plain data in the layout of the plan file, without the values at every sample."""
    return dict(json.loads(_record(plan, None).model_dump_json(exclude={"trajectory", "dynamics"})))


def load_plan(path: str | os.PathLike[str], *, urdf: str | os.PathLike[str] | None = None) -> Plan:
    """Read a plan file. Certificate, figures and bound are computed anew, not taken from the file.

    Only what cannot be computed without planning is taken from the file: findings, message, planning time, and the
    cost of the local law.

    Parameters
    ----------
    urdf: path of the machine's URDF, if it is no longer where the plan file says.

    Raises
    ------
    PlanFileError: not a plan file, or a damaged one; names the key.
    RobotError: the URDF is missing or has changed since the plan was made.
    SceneError: a file that the scene names is missing.
    """
    file = check_path(path, key="path")
    urdf = None if urdf is None else check_path(urdf, key="urdf")
    record = read_plan_file(file)
    robot, scene = _machine_on_site(record, file, urdf)
    problem = build_problem(robot, scene)
    begins = _begins(record, problem, file)
    trajectory = record.trajectory.trajectory(robot.n, file=file, begins=begins)
    certificate = certify_problem(problem, trajectory)
    note = record.message
    if record.verdict == "verified" and not certificate.verified:
        note = f"the file says verified, but: {'; '.join(certificate.problems)}"
    said = record.metrics
    metrics = measure_motion(
        problem, trajectory, certificate, planning_time=said.planning_time, detours=record.findings.detours
    )
    # an older file does not say what was minimised
    kept: dict[str, Any] = {"objective": said.objective} | ({"cost": None} if said.cost is None else {})
    return Plan(
        problem=problem,
        method=record.method,
        seed=record.seed,
        trajectory=trajectory,
        certificate=certificate,
        metrics=metrics.model_copy(update=kept),
        findings=record.findings,
        failure=record.reason,
        note=note,
        effort=record.effort,
        boxes=0 if record.bound is None else EFFORTS[record.effort or "normal"].boxes,
        legs=planned_legs(problem, trajectory, certificate, [leg.findings for leg in record.legs]),
    )


def plan_differences(path: str | os.PathLike[str], plan: Plan) -> list[str]:
    """The figures of a plan file that differ from those of the plan read from it, in words, with their keys.

    Other readers of the file rely on these figures; `load_plan` computes them anew. Figures that cannot be computed
    without planning are not compared.

    Parameters
    ----------
    path: the file.
    plan: as read by `load_plan`.

    Raises
    ------
    PlanFileError: not a plan file, or damaged.
    """
    said = read_plan_file(check_path(path, key="path"))
    found = _record(check_kind(plan, Plan, key="plan"), None)
    known = {key for key in _COMPUTED if getattr(said, key) is not None}  # an older file has less
    ours, theirs = (one.model_dump(mode="json", include=known) for one in (said, found))
    return differences(ours, theirs, left_out=_NOT_COMPUTED)


def plan_contradictions(path: str | os.PathLike[str], plan: Plan) -> list[str]:
    """What a plan file says of its plan although its motion shows the opposite, in words, with the keys.

    A reason that the motion neither confirms nor refutes is not among them: why a search found no motion is not in it.

    Parameters
    ----------
    path: the file.
    plan: as read by `load_plan`.

    Raises
    ------
    PlanFileError: not a plan file, or damaged.
    """
    said, certificate = read_plan_file(check_path(path, key="path")), check_kind(plan, Plan, key="plan").certificate
    if said.verdict == "verified":
        return []  # where that is wrong, the plan's message says so
    words = f"{said.reason}: {said.message}" if said.message else said.reason
    if certificate.verified:
        return [f"verdict: the file says failed ({words}), but its motion is verified"]
    problem = plan.legs[0].problem if plan.legs else plan.problem
    start = certify_motion(problem, Trajectory.from_steps(np.zeros(1), plan.trajectory.q[:1]))
    shown = {
        "start_in_collision": ("nothing is too near at its start", not start.too_near),
        "start_breaks_keep": ("its start keeps all conditions", all(use.kept for use in start.keep)),
    }
    return [
        f"reason: the file says {words}, but {finding}" for reason, (finding, holds) in shown.items()
        if reason == said.reason and holds
    ]  # fmt: skip


def _machine_on_site(record: PlanRecord, file: Path, urdf: Path | None) -> tuple[Robot, Scene]:
    """The machine and the scene of a plan file; the URDF is at `urdf`, or where the file says."""
    try:
        scene = scene_from_dict(record.scene, folder=file.parent / record.scene_folder)
        robot = load_machine(_locate(record.robot.urdf, file) if urdf is None else urdf, scene, tip=record.robot.tip)
    except SceneError as error:
        raise PlanFileError(str(error), file=file, key="scene") from None
    if robot.urdf.sha256 != record.robot.sha256:
        raise RobotError(
            "the URDF is not the one with which the plan was made",
            file=file,
            key="robot.sha256",
            found=f"{robot.urdf.source} has {robot.urdf.sha256[:12]}...",
            allowed=f"{record.robot.sha256[:12]}...",
        )
    if record.robot.joints != robot.joint_names:
        raise PlanFileError(
            "are not those that move the tip",
            file=file,
            key="robot.joints",
            found=list(record.robot.joints),
            allowed=", ".join(robot.joint_names),
        )
    return robot, scene


def _begins(record: PlanRecord, problem: Problem, file: Path) -> tuple[int, ...]:
    """The first samples of the legs of a sequence; PlanFileError if the legs are not those of the scene."""
    found, known = [leg.name for leg in record.legs], [leg.name for leg in problem.legs]
    if found != known[: len(found)] or (known and not found):
        raise PlanFileError(
            "are not those of the scene", file=file, key="legs", found=", ".join(found) or "none",
            allowed=", ".join(known) or "none",
        )  # fmt: skip
    return tuple(leg.first for leg in record.legs)


def _record(plan: Plan, folder: Path | None) -> PlanRecord:
    """The record of a plan, for a file in `folder`; if that is None, paths stay as they are."""
    energy, motion, urdf = plan.energy(), plan.trajectory, plan.robot.urdf
    return PlanRecord(
        verdict=plan.verdict,
        reason=plan.reason,
        message=plan.message,
        robot=RobotRecord(
            urdf=plan.robot.urdf.source_from(folder),
            sha256=urdf.sha256,
            joints=tuple(plan.robot.joint_names),
            tip=plan.robot.tip,
        ),
        scene=plan.scene.to_dict(),
        scene_folder=relative_path(plan.scene.folder, folder),
        method=plan.method,
        seed=plan.seed,
        effort=plan.effort,
        versions=installed_versions(),
        trajectory=TrajectoryRecord(time=motion.time.tolist(), q=motion.q.tolist(), v=motion.v.tolist()),
        dynamics=DynamicsRecord(
            **{
                name: values.tolist()
                for name in DynamicsRecord.model_fields
                if (values := getattr(energy, name)) is not None
            }
        ),
        certificate=CertificateRecord.of(plan.certificate),
        metrics=plan.metrics,
        findings=plan.findings,
        bound=plan.bound,
        legs=tuple(
            LegRecord(
                name=leg.name, first=leg.first, last=leg.last, begins=leg.begins,
                certificate=CertificateRecord.of(leg.certificate), metrics=leg.metrics, findings=leg.findings,
            )
            for leg in plan.legs
        ),
    )  # fmt: skip


def _locate(source: str, file: Path) -> str:
    """The path of a URDF that a plan file names: relative to the file, or to the working directory."""
    if source.startswith("example:"):
        return source
    for path in (file.parent / source, Path(source)):
        if path.is_file():
            return str(path)
    raise RobotError(
        "the URDF with which the plan was made was not found",
        file=file,
        key="robot.urdf",
        found=source,
        hint="give its path: --urdf FILE, in the library load_plan(..., urdf=FILE)",
    )
