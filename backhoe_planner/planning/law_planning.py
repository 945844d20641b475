"""Planning with the completed law alone (`method: reactive`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import TipPath
from backhoe_planner.planning.context import Context
from backhoe_planner.planning.law_timing import as_fast_as_allowed
from backhoe_planner.planning.outcome import Outcome, no_posture, obstruction_details
from backhoe_planner.planning.reactive.following import Followed, Follower
from backhoe_planner.planning.reactive.reaching import Attempt, approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper

__all__ = ["follow_with_law", "follow_with_law_from_anywhere", "reach_with_law", "stuck"]

Vector = NDArray[np.float64]

_MOST_POSTURES = 8


def reach_with_law(context: Context, stepper: Stepper, goal: TipTarget, postures: Sequence[Vector]) -> Outcome:
    """The reactive attempts at a goal one by one.

    Parameters
    ----------
    stepper: a motion that is at rest.
    postures: (n,) clear configurations on the goal, the preferred one first.
    """
    attempts = list(approach_goal(stepper, goal, postures[:_MOST_POSTURES], work=context.work))
    if attempts[-1].arrived:
        arrived = as_fast_as_allowed(context, stepper, attempts[-1].stepper)
        return Outcome(arrived.trajectory(), details=_details(attempts))
    return stuck(context, attempts)


def stuck(context: Context, attempts: Sequence[Attempt]) -> Outcome:
    """What is said where none of the attempts arrived."""
    nearest = min(attempts, key=lambda attempt: attempt.distance)
    details = _details(attempts) | {"closest_distance": nearest.distance}
    held = ""
    if nearest.obstruction is not None:
        details |= obstruction_details(nearest.obstruction)
        held = f", where {nearest.obstruction.link} is held back by {nearest.obstruction.name}"
    message = f"of {len(attempts)} attempts the closest came to {nearest.distance:.3f} m of the goal{held}"
    return Outcome(nearest.stepper.trajectory(), "blocked", message, details)


def follow_with_law(context: Context, stepper: Stepper, path: TipPath) -> Outcome:
    """To the beginning of the path as to a goal, then along it.

    Parameters
    ----------
    stepper: a motion that is at rest.
    """
    target = path.target(0.0)
    follower = _follower(context, path)
    at, _ = stepper.look()
    if max(target.distances(at)) < 1e-6:
        return _along(context, follower, path, stepper)
    found = context.postures.at(target, near=stepper.q, count=context.work.effort.starting_points)
    failure = no_posture(context, found, target, "goal_in_collision", "beginning of the path")
    if failure is not None:
        return failure
    candidates = follower.furthest(stepper, 0.0, found.clear[:_MOST_POSTURES])
    attempts = []
    outcome: Outcome | None = None
    for attempt in approach_goal(stepper, target, candidates, work=context.work, all_ways=True):
        attempts.append(attempt)
        if not attempt.arrived:
            continue
        reached = _along(context, follower, path, as_fast_as_allowed(context, stepper, attempt.stepper))
        if not reached.reason:
            return reached
        outcome = outcome or reached
    return outcome or stuck(context, attempts)


def follow_with_law_from_anywhere(context: Context, path: TipPath) -> Outcome:
    """Along the path from the configuration on its beginning from which the law gets furthest."""
    target = path.target(0.0)
    found = context.postures.at(target, count=context.work.effort.starting_points)
    failure = no_posture(context, found, target, "goal_in_collision", "beginning of the path")
    if failure is not None:
        return failure
    follower = _follower(context, path)
    starts = follower.furthest(context.stepper(found.clear[0]), 0.0, found.clear[:_MOST_POSTURES])
    outcome = _along(context, follower, path, context.stepper(starts[0]))
    for start in starts[1:3]:
        if not outcome.reason:
            break
        other = _along(context, follower, path, context.stepper(start))
        outcome = outcome if other.reason else other
    return outcome


def _along(context: Context, follower: Follower, path: TipPath, stepper: Stepper) -> Outcome:
    followed = follower.follow(stepper)
    if followed.done:
        return Outcome(followed.stepper.trajectory())
    return _blocked_on(context, path, followed)


def _blocked_on(context: Context, path: TipPath, followed: Followed) -> Outcome:
    assert context.problem.scene.task.path is not None
    details: dict[str, Any] = {"path_from": followed.blocked_from, "path_to": followed.blocked_to}
    assert followed.obstruction is not None
    details |= obstruction_details(followed.obstruction)
    message = (
        f"the path is blocked from {followed.blocked_from:.2f} m to {followed.blocked_to:.2f} m "
        f"of {path.length:.2f} m by {followed.obstruction}"
    )
    if not context.problem.scene.task.path.detour:
        message += ", and detours are not allowed"
    return Outcome(followed.stepper.trajectory(), "blocked", message, details)


def _follower(context: Context, path: TipPath) -> Follower:
    task = context.problem.scene.task.path
    assert task is not None
    return Follower(
        path,
        speed=task.speed,
        detour=task.detour,
        postures=context.postures,
        proximity=context.proximity,
        kinematics=context.kinematics,
        work=context.work,
    )


def _details(attempts: Sequence[Attempt]) -> dict[str, Any]:
    return {"attempts": len(attempts), "way": attempts[-1].way}
