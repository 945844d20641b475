"""`plan`: from a machine and a scene to a motion with a verdict.

    goal:  the least-cost motion that a search finds, else the completed law
    path:  the cheapest way through the layered graph over the redundancy, made cheaper in
           between, with detours where no layer is free

Every ending is a `Plan`: what can fail in normal use is a reason with its numbers.
"""

from __future__ import annotations

import reprlib
import time as clock
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector, as_count, as_number
from backhoe_planner.errors import InputError
from backhoe_planner.machine import Robot
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, build_problem, drive_of, limit_usage, retime
from backhoe_planner.planning.goal_planning import ToGoal
from backhoe_planner.planning.kept_path import narrow_path, waypoint_breaks_keep
from backhoe_planner.planning.moving_obstacles import plan_over_time
from backhoe_planner.planning.outcome import Outcome, at_rest, bad_start, no_posture
from backhoe_planner.planning.path_planning import AlongPath, impossible_waypoint, plan_along_path
from backhoe_planner.planning.reactive.stepping import Watcher
from backhoe_planner.planning.result.bound import measure_bound
from backhoe_planner.planning.result.metrics import measure_motion
from backhoe_planner.planning.result.plan import METHODS, Plan
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import DEFAULT_BUDGET, EFFORTS, Brake, Effort, OutOfTime, Work
from backhoe_planner.planning.world import World
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.site import Scene

_LARGEST_SEED = 2**32 - 1  # what OMPL's generator takes
_SLOWER = 3  # plans at most, each with slower joints; chosen, as each is a whole plan
_TOO_MUCH = 10.0  # times a limit: chosen, slower joints are not tried for what is so far beyond it
_BINDS = 0.95  # part of a limit from which on it binds; samples tell accelerations to some percent
_SHORT = 10.0 * SAMPLE_PERIOD  # s: what is shorter has too few samples for its limits to show; chosen
_LONG_SEARCH = 4  # times the usual starting points, for a start that is given by the tip; chosen: all else hangs on it


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
    robot, scene: machine and site; the scene says what is to be done.
    method: ``auto``, ``optimal`` (the least of the scene's objective; ``auto`` does the same, and
        falls back on the law where a search finds no motion to a goal), ``reactive`` (the
        completed law alone), or ``paper`` (the law as printed, to compare with).
    seed: of every random choice, not negative.
    effort: ``quick``, ``normal`` or ``thorough``: how much counted work every search may
        take. The same input, seed and effort give the same plan, however busy the machine.
    budget: computing time [s] after which the search is ended. A motion that was still made
        better is delivered, with a note; else the reason is ``budget``.
    watch: called with every step while the planner works.

    Returns
    -------
    A plan in any case; `Plan.verdict` is ``verified`` only where the certificate holds.

    Raises
    ------
    InputError: the scene does not fit the machine, or an argument is not allowed.
    """
    checked = next((known for known in METHODS if known == method), None)
    if checked is None:
        raise InputError.unknown_name("no such method", method, names=METHODS, key="method")
    budget, seed = as_number(budget, key="budget", above=0.0), as_count(seed, key="seed")
    if seed > _LARGEST_SEED:
        raise InputError("is too large", key="seed", found=seed, allowed=f"0 to {_LARGEST_SEED}")
    if watch is not None and not callable(watch):
        raise InputError("cannot be called", key="watch", found=reprlib.repr(watch))
    asked = next((known for known in EFFORTS if known == effort), None)
    if asked is None:
        raise InputError.unknown_name("no such effort", effort, names=EFFORTS, key="effort")
    begun = clock.monotonic()
    brake = Brake(budget)
    problem = build_problem(robot, scene)
    if checked == "paper" and (len(problem.goals) != 1 or problem.goals[0].q is not None):
        has = "list of goals, or joints" if problem.goals else "path"
        allowed = ", ".join(name for name in METHODS if name != checked)
        problem_text = f"needs a goal given by the tip's pose; this scene has a {has}"
        raise InputError(problem_text, key="method", found=checked, allowed=allowed)
    outcome, certificate = plan_motion(problem, checked, seed=seed, effort=EFFORTS[asked], brake=brake, watch=watch)
    planning_time = clock.monotonic() - begun
    note = outcome.message
    if note and not outcome.reason and not certificate.verified:
        note = "; ".join((note, *certificate.problems))
    if certificate.verified and not outcome.reason:
        note = "; ".join(filter(None, (note, _describe_unused_limits(problem, outcome.trajectory))))
    return Plan(
        problem=problem,
        method=checked,
        seed=seed,
        trajectory=outcome.trajectory,
        certificate=certificate,
        metrics=measure_motion(
            problem,
            outcome.trajectory,
            certificate,
            planning_time=planning_time,
            detours=outcome.findings.detours,
            compare=checked in ("auto", "optimal"),
        ),
        findings=outcome.findings,
        failure=outcome.reason,
        note=note,
        bound=measure_bound(problem, outcome.trajectory, certificate, boxes=EFFORTS[asked].boxes),
        effort=asked,
    )


def _describe_unused_limits(problem: Problem, motion: Trajectory) -> str:
    """That a motion to a goal comes near no limit at any time, so that a faster one exists; empty where it does."""
    if not problem.goals or problem.is_dynamic or motion.duration < _SHORT:
        return ""
    used = float(np.max(limit_usage(problem, motion).ratio))
    return "" if used >= _BINDS else f"the motion uses at most {100.0 * used:.0f} % of any limit: it could be faster"


def plan_motion(
    problem: Problem,
    method: Method = "auto",
    *,
    seed: int = 0,
    effort: Effort = EFFORTS["normal"],
    brake: Brake | None = None,
    watch: Watcher | None = None,
) -> tuple[Outcome, Certificate]:
    """A motion for a ready problem that the machine can drive, and what is proven of it.

    Where obstacles move, a motion cannot just be slowed down: it is planned anew with slower joints.

    Parameters
    ----------
    method, seed, watch: as of `plan`.
    effort: how much counted work the searches may take.
    brake: ends what takes too long; by default nothing does.
    """
    brake = brake or Brake()
    slowed = narrow_path(problem)
    for _ in range(_SLOWER):
        outcome = _find_motion(World(slowed, seed=seed, work=Work(effort, brake), watch=watch), method)
        outcome, certificate = _retime(problem, outcome)
        loads = [use for use in (certificate.effort, certificate.hydraulics) if use is not None and not use.kept]
        if not loads or not problem.is_dynamic or outcome.reason:
            break
        over = max(use.ratio for use in loads)
        if any(use.at_rest > 1.0 for use in loads) or over > _TOO_MUCH:
            break
        limits = slowed.limits
        slowed = replace(
            slowed,
            limits=replace(limits, velocity=limits.velocity / over, acceleration=limits.acceleration / over),
        )
    return outcome, certificate


def _retime(problem: Problem, outcome: Outcome) -> tuple[Outcome, Certificate]:
    """The motion, slower where the machine could not drive it, and what is proven of it.

    Where obstacles move or appear, the slower motion may meet them: then the motion stays as it was.
    """
    slower = retime(outcome.trajectory, problem.limits, drive=drive_of(problem))
    certificate = certify_problem(problem, slower)
    if slower is outcome.trajectory or not problem.is_dynamic or certificate.verified:
        return replace(outcome, trajectory=slower), certificate
    return outcome, certify_problem(problem, outcome.trajectory)


def _find_motion(world: World, method: Method) -> Outcome:
    """A motion from the scene's start; at rest there where time runs out before any is found."""
    try:
        return _plan_task(world, method)
    except OutOfTime as ended:
        return Outcome(at_rest(_begin(world)), "budget", str(ended))


def _plan_task(world: World, method: Method) -> Outcome:
    problem = world.problem
    if problem.path is not None:
        failure = waypoint_breaks_keep(world, problem.path) or impossible_waypoint(world, problem.path)
        if failure is not None:
            counted = failure.reason == "unreachable" and problem.keep is not None
            return replace(failure, message=f"{failure.message}, as `keep` has it") if counted else failure
        if problem.start_q is None and problem.start_target is None:
            return _plan_from_anywhere(world, AlongPath(problem.path), method)
    start = _start(world)
    failure = start if isinstance(start, Outcome) else bad_start(world, start)
    if failure is not None:
        return failure
    assert not isinstance(start, Outcome)
    stepper = world.stepper(start)
    task: ToGoal | AlongPath
    if problem.goals:
        task = ToGoal(problem.goals, search_alone=method == "optimal")
        if method == "paper":
            return task.by_paper(world, stepper)
    else:
        assert problem.path is not None
        task = AlongPath(problem.path)
    return task.by_law(world, stepper) if method == "reactive" else plan_over_time(world, task, stepper)


def _plan_from_anywhere(world: World, task: AlongPath, method: Method) -> Outcome:
    """Along a path, from the best configuration on its beginning."""
    if method == "reactive":
        return task.by_law(world, None)
    outcome = plan_along_path(world, task.path, stepper=None)
    if outcome.message or not world.problem.is_dynamic:
        return outcome
    return plan_over_time(world, task, world.stepper(outcome.trajectory.q[0]))


def _start(world: World) -> Vector | Outcome:
    """(n,) where the joints stand at first [rad or m]; or why the tip cannot start where the scene says."""
    problem = world.problem
    if problem.start_q is not None:
        return problem.start_q
    assert problem.start_target is not None
    count, keep = _LONG_SEARCH * world.work.effort.starting_points, problem.keep
    found = world.postures.at(problem.start_target, count=count)
    failure = no_posture(world, found, problem.start_target, "start_in_collision", "start")
    if failure is not None or keep is None:
        return failure or found.clear[0]
    narrowed = keep.narrowed(problem.start_target)
    kept = () if narrowed is None else world.postures.at(narrowed, count=count).clear
    return next((q for q in (*kept, *found.clear) if keep.holds(q)), found.clear[0])


def _begin(world: World) -> Vector:
    """(n,) where the motion would begin [rad or m]; clear where one search finds such a place."""
    problem = world.problem
    if problem.start_q is not None:
        return problem.start_q
    target = problem.start_target
    if target is None:
        assert problem.path is not None
        target = problem.path.target(0.0)
    found = world.postures.at(target)
    return found.clear[0] if found.clear else found.best.q
