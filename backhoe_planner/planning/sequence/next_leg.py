"""What a leg needs at its end so that the leg after it can begin there.

A leg ends in any posture on its goal. If the next one keeps an orientation, a random one of them is hardly ever within
it, so the goal is narrowed by what the next leg keeps, as far as a goal can express it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from backhoe_planner.motion import Goal, Keep
from backhoe_planner.planning.sequence.leg import Leg


def ready_for_next(legs: Sequence[Leg]) -> tuple[Leg, ...]:
    """The legs, each with goals in which the next one that moves can begin; unchanged where that needs nothing."""
    found, after = [], None
    for leg in reversed(legs):
        if leg.problem.wait is None:
            found.append(_ready_for(leg, after))
            after = leg
        else:
            found.append(leg)
    return tuple(found[::-1])


def _ready_for(leg: Leg, after: Leg | None) -> Leg:
    keep = None if after is None else after.problem.keep
    if keep is None or leg.motion is not None or not leg.problem.goals:
        return leg
    goals = tuple(_narrowed(goal, keep) for goal in leg.problem.goals)
    if all(one is goal for one, goal in zip(goals, leg.problem.goals, strict=True)):
        return leg
    return replace(leg, problem=replace(leg.problem, goals=goals))


def _narrowed(goal: Goal, keep: Keep) -> Goal:
    """A goal within what is to be kept; itself if it is one posture, has its own orientation, or contradicts that."""
    if goal.q is not None or goal.target.rotation is not None or goal.target.tilt is not None:
        return goal
    target = keep.narrowed(goal.target)
    if target is None or target is goal.target:
        return goal
    turned = min((cone.usable for cone in keep.cones), default=0.0)
    return replace(goal, target=target, rotation_tolerance=turned or None)
