"""`plan`: from a machine and a scene to a motion with a verdict.

    goal:  where the start and the goal are free, the reactive attempts one by one
    path:  to the beginning of the path as to a goal, then along it, around what blocks it

Every ending is a `Plan`: what can fail in normal use is a reason with its numbers.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError, nearest_name
from backhoe_planner.machine.dynamics import motion_costs
from backhoe_planner.machine.inverse_kinematics import solve_inverse_kinematics
from backhoe_planner.machine.kinematics import Kinematics
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.target import TipTarget
from backhoe_planner.planning.as_printed import run_iteration
from backhoe_planner.planning.bucket_path import BucketPath
from backhoe_planner.planning.certificate import Certificate, certify_problem
from backhoe_planner.planning.following import Followed, Follower
from backhoe_planner.planning.plan import METHODS, Method, Plan, Reason
from backhoe_planner.planning.postures import Contact, Found, Postures
from backhoe_planner.planning.problem import Problem, build_problem
from backhoe_planner.planning.reactive import Attempt, approach_goal
from backhoe_planner.planning.stepping import Stepper, Watcher
from backhoe_planner.planning.timing import time_polyline
from backhoe_planner.planning.trajectory import Trajectory
from backhoe_planner.site.proximity import Proximity
from backhoe_planner.site.scene import Scene

__all__ = ["DEFAULT_BUDGET", "plan"]

Vector = NDArray[np.float64]

DEFAULT_BUDGET = 10.0  # s
_MOST_POSTURES = 8
_MOST_WAYPOINTS = 50  # of a path are tried one by one before it is planned
_SEARCH = 40  # starting points of the inverse kinematics for a goal
_LONG_SEARCH = 200  # before a goal is said to be in collision


@dataclass(frozen=True)
class _Outcome:
    """A motion, and why it is not what was asked, if it is not."""

    trajectory: Trajectory
    reason: Reason = ""
    message: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)


def plan(
    robot: Robot,
    scene: Scene,
    *,
    method: str = "auto",
    seed: int = 0,
    budget: float = DEFAULT_BUDGET,
    watch: Watcher | None = None,
) -> Plan:
    """Plan the scene's task for a machine.

    Parameters
    ----------
    method: ``auto`` (for now the same as ``reactive``), ``reactive`` (the completed
        law), or ``paper`` (the law as printed, to compare with).
    seed: of every random choice; the same input and seed give the same plan.
    budget: time to plan in [s].
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
    begun = clock.monotonic()
    problem = build_problem(robot, scene)
    if checked == "paper" and problem.goal is None:
        raise InputError(
            "the paper's law moves the tip to a goal; this scene has a path",
            key="method",
            found="paper",
            allowed="auto, reactive",
        )
    outcome = _Planning(problem, checked, seed, begun + budget, watch).run()
    certificate = certify_problem(problem, outcome.trajectory)
    reason, message = outcome.reason, outcome.message
    if not reason and not certificate.verified:
        reason, message = _judged(problem, certificate)
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
        metrics=_metrics(problem, outcome.trajectory, certificate, clock.monotonic() - begun),
        details=outcome.details,
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


def _judged(problem: Problem, certificate: Certificate) -> tuple[Reason, str]:
    """Why a finished motion is not verified, from the certificate alone."""
    limits = (certificate.position, certificate.velocity, certificate.acceleration)
    reason: Reason = "blocked" if all(use.kept for use in limits) else "outside_limits"
    return reason, "; ".join(certificate.problems)


class _Planning:
    """One run of the planner: the problem and the working memory it shares."""

    def __init__(self, problem: Problem, method: Method, seed: int, deadline: float, watch: Watcher | None) -> None:
        self._problem = problem
        self._method = method
        self._deadline = deadline
        self._watch = watch
        self._proximity = Proximity(problem.robot, problem.obstacles)
        self._kinematics = Kinematics(problem.robot)
        self._postures = Postures(
            problem, proximity=self._proximity, kinematics=self._kinematics, rng=np.random.default_rng(seed)
        )

    def run(self) -> _Outcome:
        problem = self._problem
        if problem.goal is not None:
            return self._from_start(lambda start: self._to_goal(start, problem.goal))  # type: ignore[arg-type]
        assert problem.path is not None
        path = problem.path
        failure = self._out_of_reach(path)
        if failure is not None:
            return failure
        if problem.start_q is None and problem.start_target is None:
            return self._from_best_start(path)
        return self._from_start(lambda start: self._to_path(start, path))

    # --- the start -------------------------------------------------------------

    def _from_start(self, go: Callable[[Vector], _Outcome]) -> _Outcome:
        problem = self._problem
        start = problem.start_q
        if start is None:
            assert problem.start_target is not None
            found = self._postures.at(problem.start_target, count=_LONG_SEARCH)
            failure = self._no_posture(found, problem.start_target, "start_in_collision", "start")
            if failure is not None:
                return failure
            start = found.clear[0]
        return self._bad_start(start) or go(start)

    def _bad_start(self, start: Vector) -> _Outcome | None:
        limits, names = self._problem.limits, self._problem.robot.joint_names
        outside = np.flatnonzero((start < limits.lower) | (start > limits.upper))
        if len(outside):
            told = "; ".join(
                f"{names[j]} starts at {start[j]:.4g}, "
                f"allowed {limits.lower[j]:.4g} to {limits.upper[j]:.4g} (radians or metres)"
                for j in outside
            )
            return _Outcome(_standing(start), "outside_limits", told, {"joints": [names[j] for j in outside]})
        contact = self._postures.contact(start)
        if contact is not None and contact.margin < 0.0:
            return _Outcome(
                _standing(start), "start_in_collision", f"at the start {_told(contact)}", _contact_details(contact)
            )
        return None

    def _from_best_start(self, path: BucketPath) -> _Outcome:
        target = path.target(0.0)
        found = self._postures.at(target, count=_SEARCH)
        failure = self._no_posture(found, target, "goal_in_collision", "beginning of the path")
        if failure is not None:
            return failure
        resting = self._stepper(found.clear[0])
        follower = self._follower(path)
        starts = follower.furthest(resting, 0.0, found.clear[:_MOST_POSTURES])
        outcome = self._along(follower, path, self._stepper(starts[0]))
        for start in starts[1:3]:
            if not outcome.reason or clock.monotonic() > self._deadline:
                break
            other = self._along(follower, path, self._stepper(start))
            outcome = outcome if other.reason else other
        return outcome

    def _no_posture(self, found: Found, target: TipTarget, reason: Reason, what: str) -> _Outcome | None:
        """Why there is no configuration for a target, None where there is one."""
        if found.clear:
            return None
        best = found.best
        standing = _standing(self._problem.start_q if self._problem.start_q is not None else best.q)
        if not found.reachable:
            tip = self._kinematics.at(best.q).tip_position
            asked = " and ".join(
                part
                for part in (
                    f"{best.position_error:.3f} m" if best.position_error > 1e-6 else "",
                    f"{np.degrees(best.angle_error):.1f} deg" if best.angle_error > 1e-6 else "",
                )
                if part
            )
            message = (
                f"the {what} ({_point(target.position)}) is out of reach: "
                f"the nearest pose is {asked} away, at ({_point(tip)})"
            )
            details = {
                "nearest_q": best.q,
                "nearest_position": tip,
                "position_error": best.position_error,
                "angle_error": best.angle_error,
            }
            return _Outcome(standing, "unreachable", message, details)
        contact = found.contact
        if contact is None:
            return _Outcome(standing, reason, f"no configuration for the {what} is free")
        return _Outcome(standing, reason, f"at the {what} {_told(contact)}", _contact_details(contact))

    # --- goals -----------------------------------------------------------------

    def _to_goal(self, start: Vector, goal: TipTarget) -> _Outcome:
        if self._method == "paper":
            steps = run_iteration(self._problem, start, goal, proximity=self._proximity, kinematics=self._kinematics)
            return _Outcome(time_polyline(steps, self._problem.limits), details={"iterations": len(steps) - 1})
        found = self._postures.at(goal, near=start, count=_SEARCH)
        if found.reachable and not found.clear:
            found = self._postures.at(goal, near=start, count=_LONG_SEARCH)
        failure = self._no_posture(found, goal, "goal_in_collision", "goal")
        if failure is not None:
            return failure
        attempts = self._attempts(self._stepper(start), goal, found)
        last = attempts[-1]
        if last.arrived:
            return _Outcome(last.stepper.trajectory(), details=_attempt_details(attempts))
        nearest = min(attempts, key=lambda attempt: attempt.distance)
        return self._stuck(nearest, attempts)

    def _attempts(self, stepper: Stepper, goal: TipTarget, found: Found) -> list[Attempt]:
        return list(approach_goal(stepper, goal, found.clear[:_MOST_POSTURES], deadline=self._deadline))

    def _stuck(self, nearest: Attempt, attempts: list[Attempt]) -> _Outcome:
        details = _attempt_details(attempts) | {"closest_distance": nearest.distance}
        if nearest.blocker is not None:
            details |= {"link": nearest.blocker[0], "obstacle": nearest.blocker[1]}
        held = f", where {nearest.blocker[0]} is held back by {nearest.blocker[1]}" if nearest.blocker else ""
        if clock.monotonic() > self._deadline:
            message = f"time ran out; the closest attempt came to {nearest.distance:.3f} m of the goal"
            return _Outcome(nearest.stepper.trajectory(), "budget", message, details)
        message = f"of {len(attempts)} attempts the closest came to {nearest.distance:.3f} m of the goal{held}"
        return _Outcome(nearest.stepper.trajectory(), "blocked", message, details)

    # --- paths -----------------------------------------------------------------

    def _to_path(self, start: Vector, path: BucketPath) -> _Outcome:
        stepper = self._stepper(start)
        target = path.target(0.0)
        follower = self._follower(path)
        at, _ = stepper.look()
        if max(target.distances(at)) < 1e-6:
            return self._along(follower, path, stepper)
        found = self._postures.at(target, near=start, count=_SEARCH)
        failure = self._no_posture(found, target, "goal_in_collision", "beginning of the path")
        if failure is not None:
            return failure
        candidates = follower.furthest(stepper, 0.0, found.clear[:_MOST_POSTURES])
        attempts = []
        outcome: _Outcome | None = None
        for attempt in approach_goal(stepper, target, candidates, deadline=self._deadline, all_ways=True):
            attempts.append(attempt)
            if not attempt.arrived:
                continue
            reached = self._along(follower, path, attempt.stepper)
            if not reached.reason:
                return reached
            outcome = outcome or reached
        return outcome or self._stuck(min(attempts, key=lambda attempt: attempt.distance), attempts)

    def _out_of_reach(self, path: BucketPath) -> _Outcome | None:
        """Says which waypoint the tip cannot be put on, None where there is none."""
        count = len(path.stations)
        for index in np.unique(np.linspace(0, count - 1, min(count, _MOST_WAYPOINTS)).astype(int)).tolist():
            target = path.target(float(path.stations[index]))
            found = solve_inverse_kinematics(self._problem.robot, target, kinematics=self._kinematics)
            if not found.reached:
                nothing = Found((), False, found, None)
                what = "beginning of the path" if index == 0 else f"waypoint {index + 1} of the path"
                return self._no_posture(nothing, target, "unreachable", what)
        return None

    def _along(self, follower: Follower, path: BucketPath, stepper: Stepper) -> _Outcome:
        followed = follower.follow(stepper)
        if followed.done:
            return _Outcome(followed.stepper.trajectory())
        return self._blocked_on(path, followed)

    def _blocked_on(self, path: BucketPath, followed: Followed) -> _Outcome:
        assert self._problem.scene.task.path is not None
        details: dict[str, Any] = {"path_from": followed.blocked_from, "path_to": followed.blocked_to}
        what = "joint limits"
        if followed.blocker is not None:
            link, obstacle = followed.blocker
            details |= {"link": link, "obstacle": obstacle}
            what = f"the limit of joint {obstacle}" if link == "joint" else f"{obstacle} (at {link})"
        message = (
            f"the path is blocked from {followed.blocked_from:.2f} m to {followed.blocked_to:.2f} m "
            f"of {path.length:.2f} m by {what}"
        )
        if not self._problem.scene.task.path.detour:
            message += ", and detours are not allowed"
        reason: Reason = "budget" if clock.monotonic() > self._deadline else "blocked"
        return _Outcome(followed.stepper.trajectory(), reason, message, details)

    # --- shared ----------------------------------------------------------------

    def _stepper(self, q: Vector) -> Stepper:
        return Stepper(self._problem, q, proximity=self._proximity, kinematics=self._kinematics, watch=self._watch)

    def _follower(self, path: BucketPath) -> Follower:
        task = self._problem.scene.task.path
        assert task is not None
        return Follower(
            path,
            speed=task.speed,
            detour=task.detour,
            postures=self._postures,
            proximity=self._proximity,
            kinematics=self._kinematics,
            deadline=self._deadline,
        )


def _standing(q: Vector) -> Trajectory:
    return Trajectory.from_steps(np.zeros(1), np.array([q]))


def _told(contact: Contact) -> str:
    if contact.distance < 0.0:
        return f"{contact.link} is {-contact.distance:.3f} m inside {contact.obstacle}"
    return (
        f"{contact.link} is {contact.distance:.3f} m from {contact.obstacle}, "
        f"{-contact.margin:.3f} m closer than allowed"
    )


def _contact_details(contact: Contact) -> dict[str, Any]:
    return {
        "link": contact.link,
        "obstacle": contact.obstacle,
        "distance": contact.distance,
        "depth": -contact.distance,
    }


def _attempt_details(attempts: list[Attempt]) -> dict[str, Any]:
    return {"attempts": len(attempts), "way": attempts[-1].way}


def _point(position: Vector) -> str:
    return ", ".join(f"{value:.2f}" for value in position)


def _metrics(
    problem: Problem, trajectory: Trajectory, certificate: Certificate, planning_time: float
) -> dict[str, Any]:
    kinematics = Kinematics(problem.robot)
    tips = np.array([kinematics.at(q).tip_position for q in trajectory.q])
    energy = motion_costs(
        problem.robot, trajectory.time, trajectory.q, trajectory.v, trajectory.accelerations(),
        payload=problem.scene.payload,
    )  # fmt: skip
    detours = certificate.detours
    return {
        "duration": trajectory.duration,
        "planning_time": planning_time,
        "tip_length": float(np.sum(np.linalg.norm(np.diff(tips, axis=0), axis=1))),
        "joint_length": float(np.sum(np.linalg.norm(np.diff(trajectory.q, axis=0), axis=1))),
        "energy": energy,
        "detour": {
            "count": len(detours),
            "length": float(sum(detour.length for detour in detours)),
            "max_deviation": float(max((detour.max_deviation for detour in detours), default=0.0)),
        },
    }
