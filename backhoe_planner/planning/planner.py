"""`plan`: from a machine and a scene to a motion with a verdict.

    goal:  the completed law straight for it, else a sampled way
    path:  the cheapest way through the layered graph over the redundancy, made cheaper in
           between, with detours where no layer is free

Every ending is a `Plan`: what can fail in normal use is a reason with its numbers.
"""

from __future__ import annotations

import time as clock
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError, nearest_name
from backhoe_planner.law import run_iteration
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import (
    Problem,
    TipPath,
    Trajectory,
    build_problem,
    drive_of,
    progress,
    retimed,
    time_polyline,
    trajectory_costs,
)
from backhoe_planner.planning.context import Context
from backhoe_planner.planning.goal_planning import find_goal_postures, plan_to_goal, swerve_to_goal
from backhoe_planner.planning.law_planning import follow_with_law, follow_with_law_from_anywhere, reach_with_law
from backhoe_planner.planning.moving_obstacles import Planned, changes, plan_over_time
from backhoe_planner.planning.outcome import Outcome, bad_start, no_posture, standing
from backhoe_planner.planning.path_planning import out_of_reach, plan_along_path
from backhoe_planner.planning.reactive.stepping import Stepper, Watcher
from backhoe_planner.planning.report.asked_speed import asked_speed
from backhoe_planner.planning.report.comparison import compare_with_law
from backhoe_planner.planning.result.plan import METHODS, Method, Plan, Reason
from backhoe_planner.planning.search.effort import DEFAULT_BUDGET, Brake, Effort, OutOfTime, Work, effort_named
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.site import Scene

__all__ = ["judged", "motion_metrics", "plan"]

Vector = NDArray[np.float64]

_SLOWER = 3  # times that a motion is planned with slower joints
_TOO_MUCH = 10.0  # times a limit
_SEARCH = 4  # times the usual starting points of the inverse kinematics, for a start that is given by the tip


def plan(
    robot: Robot,
    scene: Scene,
    *,
    method: str = "auto",
    seed: int = 0,
    effort: str = "normal",
    budget: float = DEFAULT_BUDGET,
    watch: Watcher | None = None,
) -> Plan:
    """Plan the scene's task for a machine.

    Parameters
    ----------
    method: ``auto``, ``reactive`` (the completed law alone), ``optimal`` (along a path:
        the least of the scene's objective; what ``auto`` does there too), or ``paper``
        (the law as printed, to compare with).
    seed: of every random choice.
    effort: ``quick``, ``normal`` or ``thorough``: how much counted work every search may
        take. The same input, seed and effort give the same plan, however busy the machine.
    budget: [s] after which whatever still runs is ended, with the reason ``budget``.
    watch: is shown every step while the planner works.

    Returns
    -------
    A plan in any case; `Plan.verdict` is ``verified`` only where the certificate holds.

    Raises
    ------
    InputError: the scene does not fit the machine, or an argument is not allowed.
    """
    checked = _checked_method(method)
    if not budget > 0.0 or not np.isfinite(budget):
        raise InputError("must be a time greater than 0", key="budget", found=budget)
    if seed < 0:
        raise InputError("must not be negative", key="seed", found=seed)
    counts = effort_named(effort)
    begun = clock.monotonic()
    brake = Brake(budget)
    problem = build_problem(robot, scene)
    if checked == "paper" and problem.goal is None:
        raise InputError(
            "the paper's law moves the tip to a goal; this scene has a path",
            key="method",
            found="paper",
            allowed="auto, reactive, optimal",
        )
    if checked == "optimal" and problem.path is None:
        raise InputError(
            "what is made optimal is a path of the tip; this scene has a goal",
            key="method",
            found="optimal",
            allowed="auto, reactive, paper",
        )
    outcome, certificate = _drivable(problem, checked, seed=seed, effort=counts, brake=brake, watch=watch)
    planning_time = clock.monotonic() - begun
    reason, message = outcome.reason, outcome.message
    details = dict(outcome.details)
    if not reason and not certificate.verified:
        reason, message = judged(problem, certificate)
        details |= {
            kind: asdict(use)
            for kind, use in (("effort", certificate.effort), ("hydraulics", certificate.hydraulics))
            if use is not None and not use.kept
        }
    return Plan(
        verdict="failed" if reason else "verified",
        reason=reason,
        message=message,
        robot=problem.robot,
        scene=scene,
        method=checked,
        seed=seed,
        trajectory=outcome.trajectory,
        certificate=certificate,
        metrics=motion_metrics(problem, outcome.trajectory, certificate, planning_time, method=checked),
        details=details,
    )


def _checked_method(method: str) -> Method:
    for known in METHODS:
        if method == known:
            return known
    near = nearest_name(method, METHODS)
    raise InputError(
        "no such method",
        key="method",
        found=method,
        allowed=", ".join(METHODS),
        hint=f"did you mean {near!r}?" if near else None,
    )


def judged(problem: Problem, certificate: Certificate) -> tuple[Reason, str]:
    """Why a finished motion is not verified, from the certificate alone."""
    slow = certificate.tip_speed is None or certificate.tip_speed.kept
    reason: Reason = "blocked" if certificate.limits_kept and slow else "outside_limits"
    return reason, "; ".join(certificate.problems)


def _drivable(
    problem: Problem, method: Method, *, seed: int, effort: Effort, brake: Brake, watch: Watcher | None
) -> tuple[Outcome, Certificate]:
    """A motion that the machine can drive, and what is proven of it.

    Where time cannot be stretched, among what moves, it is planned anew with slower joints.
    """
    asked = problem
    for _ in range(_SLOWER):
        context = Context(asked, seed=seed, work=Work(effort, brake), watch=watch)
        try:
            outcome = _Planning(context, method).run()
        except OutOfTime as ended:
            outcome = Outcome(standing(_somewhere(context)), "budget", str(ended))
        outcome, certificate = _driven(problem, outcome)
        loads = [use for use in (certificate.effort, certificate.hydraulics) if use is not None and not use.kept]
        if not loads or not changes(problem) or outcome.reason:
            break
        over = max(use.ratio for use in loads)
        if any(use.at_rest > 1.0 for use in loads) or over > _TOO_MUCH:
            break
        limits = asked.limits
        asked = replace(
            asked,
            limits=replace(limits, velocity=limits.velocity / over, acceleration=limits.acceleration / over),
        )
    return outcome, certificate


def _driven(problem: Problem, outcome: Outcome) -> tuple[Outcome, Certificate]:
    """The motion, slower where the machine could not drive it, and what is proven of it.

    Among what moves or appears, slower is a motion at other times: it is left as it was
    where that comes too near to anything.
    """
    slower = retimed(outcome.trajectory, problem.limits, drive=drive_of(problem))
    certificate = certify_problem(problem, slower)
    if slower is outcome.trajectory or not changes(problem) or certificate.verified:
        return replace(outcome, trajectory=slower), certificate
    return outcome, certify_problem(problem, outcome.trajectory)


def _somewhere(context: Context) -> Vector:
    """(n,) where the motion would begin, clear where that is found at once."""
    problem = context.problem
    if problem.start_q is not None:
        return problem.start_q
    target = problem.start_target
    if target is None:
        assert problem.path is not None
        target = problem.path.target(0.0)
    found = context.postures.at(target)
    return found.clear[0] if found.clear else found.best.q


class _Planning:
    """One run of the planner, from the start that the scene asks for."""

    def __init__(self, context: Context, method: Method) -> None:
        self._context = context
        self._problem = context.problem
        self._method = method

    def run(self) -> Outcome:
        path = self._problem.path
        if path is not None:
            failure = out_of_reach(self._context, path)
            if failure is not None:
                return failure
            if self._problem.start_q is None and self._problem.start_target is None:
                outcome = self._follow(path, None)
                if self._method == "reactive" or outcome.reason or not changes(self._problem):
                    return outcome
                return plan_over_time(self._context, self._asked(), self._context.stepper(outcome.trajectory.q[0]))
        start = self._start()
        if isinstance(start, Outcome):
            return start
        failure = bad_start(self._context, start)
        if failure is not None:
            return failure
        stepper = self._context.stepper(start)
        if self._method in ("auto", "optimal"):
            return plan_over_time(self._context, self._asked(), stepper)
        return self._reach(stepper) if path is None else self._follow(path, stepper)

    def _asked(self) -> Planned:
        """The task, as something that can be planned from any state of the motion."""
        goal, path, task = self._problem.goal, self._problem.path, self._problem.scene.task.path
        if goal is not None:
            return Planned(
                once=lambda context, stepper: plan_to_goal(context, stepper, goal),
                swerve=lambda context, stepper: swerve_to_goal(context, stepper, goal),
            )
        assert path is not None
        assert task is not None

        def follow_on(context: Context, stepper: Stepper) -> Outcome:
            since = progress(path, task.tolerance, stepper.trajectory(), context.kinematics)
            return plan_along_path(context, path, stepper=stepper, since=since)

        return Planned(once=follow_on, swerve=lambda context, stepper: None)

    def _start(self) -> Vector | Outcome:
        """(n,) where the joints stand at first."""
        if self._problem.start_q is not None:
            return self._problem.start_q
        target = self._problem.start_target
        assert target is not None
        found = self._context.postures.at(target, count=_SEARCH * self._context.work.effort.starting_points)
        return no_posture(self._context, found, target, "start_in_collision", "start") or found.clear[0]

    def _reach(self, stepper: Stepper) -> Outcome:
        context, goal = self._context, self._problem.goal
        assert goal is not None
        if self._method == "paper":
            steps = run_iteration(
                self._problem, stepper.q, goal, proximity=context.proximity, kinematics=context.kinematics
            )
            return Outcome(time_polyline(steps, self._problem.limits), details={"iterations": len(steps) - 1})
        if self._method == "reactive":
            found = find_goal_postures(context, stepper, goal)
            return found if isinstance(found, Outcome) else reach_with_law(context, stepper, goal, found.clear)
        return plan_to_goal(context, stepper, goal)

    def _follow(self, path: TipPath, stepper: Stepper | None) -> Outcome:
        if self._method != "reactive":
            return plan_along_path(self._context, path, stepper=stepper)
        if stepper is None:
            return follow_with_law_from_anywhere(self._context, path)
        return follow_with_law(self._context, stepper, path)


def motion_metrics(
    problem: Problem, trajectory: Trajectory, certificate: Certificate, planning_time: float, *, method: Method
) -> dict[str, Any]:
    """Duration, lengths, energies and detours of a motion, as the plan file has them."""
    kinematics = Kinematics(problem.robot)
    tips = np.array([kinematics.at(q).tip_position for q in trajectory.q])
    detours = certificate.detours
    compared = compare_with_law(problem, trajectory, certificate) if method in ("auto", "optimal") else None
    speed = None
    if problem.path is not None and certificate.tracking.done:
        speed = asked_speed(problem, trajectory, begun=certificate.tracking.approach_time)
    more: dict[str, Any] = {} if compared is None else {"objective": compared.metrics()}
    more |= {} if speed is None else {"asked_speed": speed.metrics()}
    return {
        "duration": trajectory.duration,
        "planning_time": planning_time,
        "tip_length": float(np.sum(np.linalg.norm(np.diff(tips, axis=0), axis=1))),
        "joint_length": float(np.sum(np.linalg.norm(np.diff(trajectory.q, axis=0), axis=1))),
        "energy": trajectory_costs(problem, trajectory),
        "detour": {
            "count": len(detours),
            "length": float(sum(detour.length for detour in detours)),
            "max_deviation": float(max((detour.max_deviation for detour in detours), default=0.0)),
        },
    } | more
