"""`plan`: from a machine and a scene to a motion with a verdict.

The result is always a `Plan`: a failure in normal use is a reason with its numbers.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from backhoe_planner.arrays import as_count, as_number
from backhoe_planner.errors import InputError, check_callable
from backhoe_planner.machine import Robot
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, build_problem
from backhoe_planner.planning.planner import plan_motion
from backhoe_planner.planning.reactive.stepping import Watcher
from backhoe_planner.planning.result.findings import NOTHING, Findings
from backhoe_planner.planning.result.metrics import measure_motion
from backhoe_planner.planning.result.plan import METHODS, Plan, PlannedLeg, planned_legs
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import DEFAULT_BUDGETS, EFFORTS, Brake, EffortName, check_effort
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.site import Scene

if TYPE_CHECKING:
    from backhoe_planner.planning.sequence.legs_planning import LegsOutcome

_LARGEST_SEED = 2**32 - 1  # the largest that OMPL's generator accepts
_BINDS = 0.95  # part of a limit from which it counts as reached; samples give accelerations to some percent
_SHORT = 10.0 * SAMPLE_PERIOD  # s: a shorter motion has too few samples to show its use of limits; chosen


def plan(
    robot: Robot,
    scene: Scene,
    *,
    method: str = "auto",
    seed: int = 0,
    effort: str = "normal",
    budget: float | None = None,
    watch: Watcher | None = None,
) -> Plan:
    """Plan the scene's task for a machine.

    Parameters
    ----------
    robot, scene: machine and site; the scene contains the task.
    method: ``auto``, ``optimal`` (the least of the scene's objective; ``auto`` does the same, and
        falls back on the law if a search finds no motion to a goal), ``reactive`` (the
        completed law alone), or ``paper`` (the law as printed, for comparison).
    seed: of every random choice, not negative.
    effort: ``quick``, ``normal`` or ``thorough``: how much counted work every search may do.
        The same input, seed and effort give the same plan, however busy the computer is.
    budget: computing time [s] after which the search is ended, by default 60, for ``thorough`` 600.
        A motion that was still being improved is returned with a note; without a motion the reason is ``budget``.
    watch: called with every step while the planner works.

    Returns
    -------
    Always a plan; `Plan.verdict` is ``verified`` only if the certificate holds.

    Raises
    ------
    InputError: the scene does not fit the machine, or an argument is not allowed.
    """
    checked = next((known for known in METHODS if known == method), None)
    if checked is None:
        raise InputError.unknown_name("no such method", method, names=METHODS, key="method")
    seed = as_count(seed, key="seed")
    if seed > _LARGEST_SEED:
        raise InputError("is too large", key="seed", found=seed, allowed=f"0 to {_LARGEST_SEED}")
    watch, asked = check_callable(watch, key="watch"), check_effort(effort)
    longest = DEFAULT_BUDGETS[asked] if budget is None else as_number(budget, key="budget", above=0.0)
    begun = clock.monotonic()
    brake = Brake(longest)
    problem = build_problem(robot, scene)
    return plan_problem(problem, checked, seed=seed, effort=asked, brake=brake, watch=watch, begun=begun)


def plan_problem(
    problem: Problem,
    method: Method = "auto",
    *,
    seed: int = 0,
    effort: EffortName = "normal",
    brake: Brake | None = None,
    watch: Watcher | None = None,
    begun: float | None = None,
) -> Plan:
    """Like `plan`, for a problem that is built already.

    Parameters
    ----------
    method, seed, effort, watch: as for `plan`.
    brake: ends a search that takes too long; by default there is no time limit.
    begun: the clock's value from which planning time counts [s]; by default now.

    Raises
    ------
    InputError: the method is not possible for this task.
    """
    begun, brake = clock.monotonic() if begun is None else begun, brake or Brake()
    if problem.legs and method == "paper":
        allowed = ", ".join(name for name in METHODS if name != method)
        raise InputError("plans one motion; this scene has a sequence", key="method", found=method, allowed=allowed)
    if problem.legs:
        return _plan_sequence(problem, method, seed=seed, effort=effort, brake=brake, watch=watch, begun=begun)
    if method == "paper" and (len(problem.goals) != 1 or problem.goals[0].q is not None):
        has = "list of goals, or joints" if problem.goals else "path"
        allowed = ", ".join(name for name in METHODS if name != method)
        problem_text = f"needs a goal given by the tip's pose; this scene has a {has}"
        raise InputError(problem_text, key="method", found=method, allowed=allowed)
    outcome, certificate = plan_motion(problem, method, seed=seed, effort=EFFORTS[effort], brake=brake, watch=watch)
    planning_time = clock.monotonic() - begun
    note = outcome.message
    if note and not outcome.reason and not certificate.verified:
        note = "; ".join((note, *certificate.problems))
    note = "; ".join(filter(None, (note, _describe_left_out(problem, outcome.findings))))
    if certificate.verified and not outcome.reason:
        note = "; ".join(filter(None, (note, _describe_unused_limits(problem, outcome.trajectory, certificate))))
    return Plan(
        problem=problem,
        method=method,
        seed=seed,
        trajectory=outcome.trajectory,
        certificate=certificate,
        metrics=measure_motion(
            problem,
            outcome.trajectory,
            certificate,
            planning_time=planning_time,
            detours=outcome.findings.detours,
            compare=method in ("auto", "optimal"),
            law=outcome.law,
        ),
        findings=outcome.findings,
        failure=outcome.reason,
        note=brake.with_advice(note),
        effort=effort,
        boxes=EFFORTS[effort].boxes,
    )


def _describe_left_out(problem: Problem, findings: Findings) -> str:
    """Which goals of a list are left out of the search, and why, in words; empty if there are none."""
    left_out = findings.left_out
    are = "is" if len(left_out) == 1 else "are"
    return f"{len(left_out)} of {len(problem.goals)} goals {are} left out: {'; '.join(left_out)}" if left_out else ""


def _describe_unused_limits(problem: Problem, motion: Trajectory, certificate: Certificate) -> str:
    """A note if a motion to a goal is never near any limit, so that a faster one exists; empty otherwise.

    Motions for another cost than the time need not be fast.
    """
    if not problem.goals or problem.is_dynamic or motion.duration < _SHORT or not problem.objective.is_time:
        return ""
    used = max(use.ratio for name, use in certificate.uses.items() if name not in ("position", "duration"))
    return "" if used >= _BINDS else f"the motion uses at most {100.0 * used:.0f} % of any limit: it could be faster"


def _plan_sequence(
    problem: Problem, method: Method, *, seed: int, effort: EffortName, brake: Brake, watch: Watcher | None,
    begun: float,
) -> Plan:  # fmt: skip
    """The plan of a sequence; `begun` is the clock's value at its beginning [s]."""
    from backhoe_planner.planning.sequence.leg import Leg  # loaded only for sequences
    from backhoe_planner.planning.sequence.legs_planning import plan_legs

    def plan_all(legs: Iterable[Problem]) -> LegsOutcome:
        return plan_legs(
            [Leg(leg) for leg in legs],
            method=method, seed=seed, effort=EFFORTS[effort], brake=brake, watch=watch,
        )  # fmt: skip

    found = _undisturbed(problem, plan_all) or plan_all(problem.legs)
    planning_time = clock.monotonic() - begun
    motion, certificate, failed = found.trajectory, found.certificate, found.failed
    notes = []
    for leg, part in zip(found.done, certificate.legs, strict=True):
        words = "; ".join(filter(None, (leg.outcome.message, _describe_left_out(leg.problem, leg.outcome.findings))))
        notes += [f"leg {part.name!r}: {words}"] if words else []
    if notes and failed is not None and not failed.outcome.reason:
        notes += certificate.problems
    if not notes and failed is None and brake.is_used_up():
        notes.append(f"{brake.message}; the search for better motions was not finished")
    legs = planned_legs(problem, motion, certificate, [leg.outcome.findings for leg in found.done])
    findings = NOTHING if failed is None else failed.outcome.adding(allowed_time=None).findings  # it is the leg's
    return Plan(
        problem=problem,
        method=method,
        seed=seed,
        trajectory=motion,
        certificate=certificate,
        metrics=measure_motion(problem, motion, certificate, planning_time=planning_time),
        findings=findings.model_copy(update=_reactions_of(legs)),
        failure="" if failed is None else failed.outcome.reason,
        note=brake.with_advice("; ".join(notes)),
        effort=effort,
        legs=legs,
    )


def _undisturbed(problem: Problem, plan_all: Callable[[Iterable[Problem]], LegsOutcome]) -> LegsOutcome | None:
    """The sequence as if nothing appeared, if its motion is also proven clear of all that appears; otherwise None.

    None too if nothing appears, or if something moves from the beginning.
    """
    there = [replace(leg, obstacles=leg.present) for leg in problem.legs]
    if any(leg.is_dynamic for leg in there) or not any(leg.is_dynamic for leg in problem.legs):
        return None
    found = plan_all(there)
    certificate = certify_problem(problem, found.trajectory)
    return replace(found, certificate=certificate) if found.failed is None and certificate.verified else None


def _reactions_of(legs: Sequence[PlannedLeg]) -> dict[str, Any]:
    """What all legs waited, and their reactions to obstacles that appear, in the time of the whole motion."""
    reactions = [reaction.later(leg.begins) for leg in legs for reaction in leg.findings.reactions]
    return {"reactions": tuple(reactions), "waits": sum(leg.findings.waits for leg in legs)}
