"""What a leg needs at its end so that the leg after it can begin there.

A leg ends in any posture on its goal. If the next one keeps an orientation, a random one of them is hardly ever within
it, so the goal is narrowed by what the next leg keeps, as far as a goal can express it. In which postures a payload can
be held no goal can express: where that was missed, single postures are asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, Keep
from backhoe_planner.planning.goals.goal_postures import find_goal_postures
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.sequence.leg import Leg, posture_goal
from backhoe_planner.planning.sequence.leg_planning import LegPlanner
from backhoe_planner.planning.world.holding import holding_use, is_held
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World

_MOST_POSTURES = 8  # that a leg may end in where payloads narrow the choice, at most; chosen


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


def ending_where_held(legs: Sequence[Leg], ready: Sequence[Leg], start: Vector, planner: LegPlanner) -> tuple[Leg, ...]:
    """The `ready` legs, with postures as goals where payloads up to the next motion can be held in some of them only.

    These are the half of them in which the joints have most room, as a motion must also begin there.

    Parameters
    ----------
    start: (n,) of the first leg [rad or m].

    Raises
    ------
    OutOfTime: the budget is used up.
    """
    found, near = [], start
    for index, asked in enumerate(ready):
        problem, after = asked.problem, _up_to_next_motion(legs[index + 1 :])
        if problem.goals and problem.wait is None and asked.motion is None and after:
            planner.brake.check()
            world = World(problem.beginning(near), seed=planner.seed, work=Work(planner.effort, planner.brake))
            postures = find_goal_postures(world, problem.goals, near=near, time=0.0)
            if not isinstance(postures, Outcome):
                q = np.array(postures.clear)
                use = np.max([holding_use(leg.problem, q) for leg in after], axis=0)
                held, roomiest = is_held(use), q[np.argsort(use, kind="stable")]
                if held.any() and not held.all():
                    count = -(-int(np.count_nonzero(held)) // 2)
                    goals = tuple(posture_goal(problem, one) for one in roomiest[: min(count, _MOST_POSTURES)])
                    asked = replace(asked, problem=replace(problem, goals=goals))
                near = roomiest[0]
        found.append(asked)
    return tuple(found)


def _up_to_next_motion(legs: Sequence[Leg]) -> list[Leg]:
    """The first of the legs that moves, and all before it."""
    moving = next((index for index, leg in enumerate(legs) if leg.problem.wait is None), len(legs))
    return list(legs[: moving + 1])


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
