"""Plans one motion, for a whole task or for one leg of a sequence.

    goal:  the least-cost motion that a search finds, otherwise the motion of the completed law
    path:  the cheapest route through the layered graph over the redundancy, then made cheaper
           between the nodes, with detours where no layer is free

A failure in normal use is returned as a reason with its numbers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import OBJECTIVES, Problem, TipPath, Trajectory, motion_cost, slowed_to_drive
from backhoe_planner.planning.goals.goal_planning import ToGoal
from backhoe_planner.planning.kept_path import in_middle_of_cone, narrow_path, waypoint_breaks_keep
from backhoe_planner.planning.moving_obstacles import plan_over_time
from backhoe_planner.planning.reactive.stepping import Watcher
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import EFFORTS, Brake, Effort, OutOfTime, Work
from backhoe_planner.planning.waypoints import path_within_reach
from backhoe_planner.planning.world.holding import holds_load
from backhoe_planner.planning.world.outcome import Outcome, at_rest, bad_start, no_posture
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import Certificate, certify_motion

if TYPE_CHECKING:
    from backhoe_planner.planning.path_planning import AlongPath

_SLOWER = 3  # at most so many plans, each with slower joints; chosen, because each is a whole plan
_TOO_MUCH = 10.0  # times a limit: chosen; slower joints are not tried for a load so far beyond its limit
_APART = (5e-4, 3e-3)  # m added to the clearance, tried in turn; chosen: a curve swings out by some tenths of a mm
_NARROWER = 2  # times that a path is planned in a narrower cone at most; chosen, because each is a whole plan
_MISSED = 2.0  # times what the tip was outside the cone, by which it is made narrower; chosen
# times the fastest motion past moving obstacles, that motions of little cost may take, each planned anew; chosen
_LONGER = (1.1, 1.4)
_AS_MUCH = 0.01  # m of a path that two motions leave out count as the same: 5 mm, the grid of detours, at either end
_LONG_SEARCH = 4  # times the usual starting points, for a start given by the tip; chosen: all else depends on it


_Planned = Callable[[Problem], tuple[Outcome, Certificate]]


def plan_motion(
    problem: Problem,
    method: Method = "auto",
    *,
    seed: int = 0,
    effort: Effort = EFFORTS["normal"],
    brake: Brake | None = None,
    watch: Watcher | None = None,
) -> tuple[Outcome, Certificate]:
    """A motion that the machine can drive for a built problem, and its certificate.

    Where obstacles move, slowing a motion down is not enough: it is planned anew with slower joints.

    Parameters
    ----------
    problem: of a whole task, or of one leg of a sequence.
    method, seed, watch: as for `plan`.
    effort: how much counted work the searches may do.
    brake: ends a search that takes too long; by default there is no time limit.
    """
    plan = functools.partial(_plan_motion, method=method, seed=seed, effort=effort, brake=brake or Brake(), watch=watch)
    outcome, certificate = plan(problem)
    if problem.is_dynamic and problem.goals and not problem.objective.is_time and method in ("auto", "optimal"):
        outcome, certificate = _best_over_time(problem, plan, outcome, certificate)
    if certificate.verified and outcome.reason:  # the machine already stands at the goal, within its tolerance
        outcome = replace(outcome, reason="", message="")
    return outcome, certificate


def _plan_motion(
    problem: Problem, method: Method, *, seed: int, effort: Effort, brake: Brake, watch: Watcher | None
) -> tuple[Outcome, Certificate]:
    """The same, without motions that take less time past moving obstacles than is allowed."""
    if problem.wait is not None:
        assert problem.start_q is not None
        rest = Trajectory.from_steps(np.array([0.0, problem.wait]), np.tile(problem.start_q, (2, 1)))
        certificate = certify_motion(problem, rest)
        return Outcome(rest, message=_met_in_wait(problem, certificate)), certificate
    plan = functools.partial(
        _plan_slowed, problem, method=method, seed=seed, effort=effort, brake=brake, watch=watch
    )  # fmt: skip
    middle = in_middle_of_cone(problem)
    if middle is None:
        return plan(narrow_path(problem))
    return _cheaper_in_cone(problem, middle, plan, method, effort, brake)


def _met_in_wait(problem: Problem, certificate: Certificate) -> str:
    """What comes too near to a machine in a leg that waits because it moves or appears, in words; empty if nothing."""
    tightest = certificate.min_clearance
    if certificate.verified or tightest is None or tightest.margin >= 0.0:
        return ""
    obstacle = next((one for one in problem.obstacles if one.name == tightest.name), None)
    if obstacle is None or not obstacle.is_dynamic:
        return ""
    when = problem.begins + obstacle.appears_at
    how = f"appears at {when:.2f} s" if obstacle.appears_at > 0.0 else "moves"
    return f"a wait does not give way to {obstacle.name}, which {how}"


def _cheaper_in_cone(
    problem: Problem, middle: Problem, plan: Callable[[Problem], tuple[Outcome, Certificate]], method: Method,
    effort: Effort, brake: Brake,
) -> tuple[Outcome, Certificate]:  # fmt: skip
    """A motion along a path in the `middle` of the cone to be kept, or one that uses the whole cone if it is better.

    In the middle there is less to choose from, so that such a motion is found soon. But there may be none, or it
    leaves more of the path, or it costs more. An effort without other ways looks for another motion only if there is
    none in the middle, or if it leaves the path; in that case for one that does not leave it.
    """
    outcome, certificate = plan(middle)
    fails, leaves = bool(outcome.reason) or not certificate.verified, bool(certificate.detours)
    if method not in ("auto", "optimal") or not (fails or leaves or effort.other_ways):
        return outcome, certificate
    other, proof = plan(narrow_path(problem if fails or effort.other_ways else _without_detours(problem)))
    if fails:
        return other, proof
    less = certificate.tracking.left_out - proof.tracking.left_out
    better = proof.verified and not other.reason
    if better and abs(less) > _AS_MUCH:
        better = less > 0.0
    elif better:
        better = motion_cost(problem, other.trajectory) < motion_cost(problem, outcome.trajectory)
    if better:
        outcome, certificate = other, proof
    return replace(outcome, message=outcome.message or brake.cut_short), certificate


def _without_detours(problem: Problem) -> Problem:
    """The problem with a path that must not be left."""
    scene = problem.scene
    assert scene.task.path is not None
    task = scene.task.model_copy(update={"path": scene.task.path.model_copy(update={"detour": False})})
    return replace(problem, scene=scene.model_copy(update={"task": task}))


def _plan_slowed(
    problem: Problem, slowed: Problem, *,
    method: Method, seed: int, effort: Effort, brake: Brake, watch: Watcher | None,
) -> tuple[Outcome, Certificate]:  # fmt: skip
    """A motion for `slowed`, and its certificate for `problem`; where obstacles move, with joints as slow as needed."""
    known: tuple[Outcome, Certificate] | None = None
    for _ in range(_SLOWER):
        outcome, certificate = _find_proven(problem, slowed, method, seed=seed, effort=effort, brake=brake, watch=watch)
        if known is not None and outcome.reason == "outside_limits":  # only with slower joints
            return known
        known = outcome, certificate
        loads = [use for use in (certificate.effort, certificate.hydraulics) if use is not None and not use.kept]
        if not loads or not problem.is_dynamic or outcome.reason or outcome.findings.reactions:
            break  # slower joints from the beginning would use that something appears
        over = max(use.ratio for use in loads)
        if not all(use.is_held for use in loads) or over > _TOO_MUCH:
            break
        limits = slowed.limits
        slowed = replace(
            slowed,
            limits=replace(limits, velocity=limits.velocity / over, acceleration=limits.acceleration / over),
        )
    return outcome, certificate


def _best_over_time(
    problem: Problem, plan: _Planned, outcome: Outcome, certificate: Certificate
) -> tuple[Outcome, Certificate]:
    """The motion that costs least past the obstacles that move from the beginning, and its proof.

    Obstacles that appear later are unknown when the motion begins: without them it is decided how long it may take.

    Parameters
    ----------
    plan: finds a motion and its certificate.
    outcome, certificate: the motion that may take all the time that is allowed, and its proof.
    """
    if len(problem.present) == len(problem.obstacles):
        best = _past_movers(problem, plan, outcome, certificate)
        return best.outcome, best.certificate
    beginning = replace(problem, obstacles=problem.present)
    if not beginning.is_dynamic:
        return outcome, certificate
    best = _past_movers(beginning, plan, *plan(beginning))
    if best.allowed is None:
        return outcome, certificate
    found, _ = plan(_allowed(problem, best.allowed))
    if not found.reason:
        found = replace(found, message="; ".join(filter(None, (found.message, best.words))))
    return found, certify_motion(problem, found.trajectory)


@dataclass(frozen=True, eq=False)
class _Best:
    """The motion that costs least past moving obstacles, its proof, and how long it may take.

    Attributes
    ----------
    allowed: the longest duration for which it was planned [s]: 0 for the fastest, None for all that is allowed.
    words: why it is the best.
    """

    outcome: Outcome
    certificate: Certificate
    allowed: float | None = None
    words: str = ""


def _allowed(problem: Problem, longest: float) -> Problem:
    """The problem of a motion that takes at most `longest` [s], or for 0 of the fastest one."""
    return replace(problem, max_duration=longest) if longest else replace(problem, objective=OBJECTIVES["time"])


def _past_movers(problem: Problem, plan: _Planned, outcome: Outcome, certificate: Certificate) -> _Best:
    """The motion that costs least past moving obstacles: a known one, or one that takes less time.

    A motion that may take long meets obstacles before which a faster one passes, and then waits or goes round. So where
    they meet the best motion, the fastest motion is planned too, and motions of little cost that may take not much
    longer.

    Parameters
    ----------
    problem: among obstacles that are all there from the beginning.
    """
    known = _Best(outcome, certificate)
    fails = bool(outcome.reason) or not certificate.verified
    if outcome.reason not in ("", "blocked") or not (fails or outcome.evades):
        return known
    fastest, _ = plan(_allowed(problem, 0.0))
    found = [] if fails else [known]
    tried = [(0.0, fastest)]
    for longer in () if fastest.reason else _LONGER:
        longest = longer * fastest.trajectory.duration
        if longest >= min(problem.max_duration, outcome.findings.allowed_time or np.inf):
            break
        tried.append((longest, plan(_allowed(problem, longest))[0]))
    for longest, one in tried:
        if one.reason:
            continue
        proof = certify_motion(problem, one.trajectory)
        if proof.verified:
            allowed = one.findings.allowed_time
            limit = f"one with at most {allowed:.2f} s" if allowed is not None else "one"
            which = limit if longest else "the fastest"
            words = f"past moving obstacles {which} costs least of the motions that were found"
            told = replace(one, message="; ".join(filter(None, (one.message, words))))
            found.append(_Best(told, proof, longest, words))
    return min(found, key=lambda one: motion_cost(problem, one.outcome.trajectory), default=known)


def _find_proven(
    problem: Problem, slowed: Problem, method: Method, *, seed: int, effort: Effort, brake: Brake, watch: Watcher | None
) -> tuple[Outcome, Certificate]:
    """A motion for `slowed`, and its certificate for `problem`.

    The motion along a path is a smooth curve near the configurations that were found for it. If the certificate says
    that a link comes too near to something, the path is planned anew with more clearance between the two; if it says
    that the tip leaves a cone to be kept a little, with narrower cones.
    """

    def planned(apart: Mapping[tuple[str, str], float], slowed: Problem = slowed) -> tuple[Outcome, Certificate]:
        world = World(slowed, seed=seed, work=Work(effort, brake), watch=watch, apart=apart)
        return _retime(problem, _find_motion(world, method))

    first = outcome, certificate = planned({})
    apart: dict[tuple[str, str], float] = {}
    once = problem.path is None or problem.is_dynamic or method == "reactive"
    for more in () if once else _APART:
        if outcome.reason or not certificate.too_near:
            break
        apart |= {(near.link, near.name): more for near in certificate.too_near}
        outcome, certificate = planned(apart)
    if outcome.reason or certificate.too_near:
        return first
    return (outcome, certificate) if once else _within_cone(slowed, outcome, certificate, lambda p: planned(apart, p))


def _within_cone(
    slowed: Problem, outcome: Outcome, certificate: Certificate, plan: Callable[[Problem], tuple[Outcome, Certificate]]
) -> tuple[Outcome, Certificate]:
    """A motion along a path, and its proof: the given one, or if it leaves a cone a little, one in a narrower cone."""
    keep, by = slowed.keep, 0.0
    found, proof = outcome, certificate
    for _ in range(_NARROWER):
        if keep is None or found.reason:
            break
        cones = [cone.name for cone in keep.cones]
        missed = max((-use.margin for use in proof.keep if use.name in cones and not use.kept), default=0.0)
        if missed == 0.0:
            break
        by += _MISSED * missed
        narrower = keep.with_narrower_cone(by)
        if narrower is None:
            return outcome, certificate
        found, proof = plan(replace(slowed, keep=narrower))
    return (outcome, certificate) if found.reason or not proof.verified else (found, proof)


def _retime(problem: Problem, outcome: Outcome) -> tuple[Outcome, Certificate]:
    """The motion, slowed down where the machine could not drive it, and its certificate.

    Where obstacles move or appear, the slower motion may meet them: then the motion stays as it was. It also stays if
    it reacts to what appears, as a slower one would be elsewhere at that moment. If the slower motion takes longer than
    the search allowed, because of the tip's speed, `allowed_time` is dropped from the findings.
    """
    motion = outcome.trajectory if problem.is_dynamic else slowed_to_drive(problem, outcome.trajectory)
    certificate = certify_motion(problem, motion)
    if problem.is_dynamic and not (certificate.verified or outcome.findings.reactions):
        slower = slowed_to_drive(problem, motion)
        proof = certificate if slower is motion else certify_motion(problem, slower)
        if proof.verified:
            motion, certificate = slower, proof
    longest = outcome.findings.allowed_time
    if longest is not None and motion.duration > longest:
        outcome = outcome.adding(allowed_time=None)
    return replace(outcome, trajectory=motion), certificate


def _find_motion(world: World, method: Method) -> Outcome:
    """A motion from the scene's start; rest at the start if time runs out before a motion is found."""
    try:
        return _plan_task(world, method)
    except OutOfTime as ended:
        return Outcome(at_rest(_begin(world)), "budget", str(ended))


def _plan_task(world: World, method: Method) -> Outcome:
    problem, path = world.problem, world.problem.path
    if path is not None:
        within = waypoint_breaks_keep(world, path) or path_within_reach(world, path)
        if isinstance(within, Outcome):
            counted = within.reason == "unreachable" and problem.keep is not None
            return (
                replace(within, message=f"{within.message}, with the orientation that `keep` requires")
                if counted
                else within
            )
        world, path = within
        if problem.start_q is None and problem.start_target is None:
            return _plan_from_anywhere(world, _along(path), method)
    start = _start(world)
    failure = start if isinstance(start, Outcome) else bad_start(world, start)
    if failure is not None:
        return failure
    assert not isinstance(start, Outcome)
    stepper = world.stepper(start)
    task: ToGoal | AlongPath
    if problem.goals:
        task = ToGoal(problem.goals, search_alone=method == "optimal", law_alone=method == "reactive")
        if method == "paper":
            return task.by_paper(world, stepper)
    else:
        assert path is not None
        task = _along(path)
        if method == "reactive":
            return task.by_law(world, stepper)
    return plan_over_time(world, task, stepper)


def _along(path: TipPath) -> AlongPath:
    """The task of following a path; its module is not loaded for a goal."""
    from backhoe_planner.planning.path_planning import AlongPath

    return AlongPath(path)


def _plan_from_anywhere(world: World, task: AlongPath, method: Method) -> Outcome:
    """A motion along a path from the best configuration at its beginning."""
    from backhoe_planner.planning.path_planning import plan_along_path

    if method == "reactive":
        return task.by_law(world, None)
    there = world.among(world.problem.present) if world.problem.is_dynamic else world
    outcome = plan_along_path(there, task.path, stepper=None)
    if outcome.message or not world.problem.is_dynamic:
        return outcome
    return plan_over_time(world, task, world.stepper(outcome.trajectory.q[0]), known=outcome)


def _start(world: World) -> Vector | Outcome:
    """(n,) the start configuration [rad or m]; or why the tip cannot start where the scene says."""
    problem = world.problem
    if problem.start_q is not None:
        return problem.start_q
    assert problem.start_target is not None
    count, keep = _LONG_SEARCH * world.work.effort.starting_points, problem.keep
    found = world.postures.at(problem.start_target, count=count)
    failure = no_posture(world, found, problem.start_target, "start_in_collision", "start")
    if failure is not None:
        return failure
    postures = found.clear
    if keep is not None:
        narrowed = keep.narrowed(problem.start_target)
        kept = () if narrowed is None else world.postures.at(narrowed, count=count).clear
        postures = tuple(q for q in (*kept, *postures) if keep.holds(q)) or postures
    return postures[int(np.argmax(holds_load(problem, np.array(postures))))]


def _begin(world: World) -> Vector:
    """(n,) where the motion would begin [rad or m]; clear of obstacles if one search finds such a configuration."""
    problem = world.problem
    if problem.start_q is not None:
        return problem.start_q
    target = problem.begin_target
    assert target is not None
    found = world.postures.at(target)
    return found.clear[0] if found.clear else found.best.q
