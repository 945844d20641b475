"""Planning to a goal: the completed law first, then sampling (`method: auto`)."""

from __future__ import annotations

import numpy as np

from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import drive_of, retimed
from backhoe_planner.planning.context import Context
from backhoe_planner.planning.law_planning import reach_with_law
from backhoe_planner.planning.law_timing import as_fast_as_allowed, shortest_time
from backhoe_planner.planning.outcome import Outcome, no_posture
from backhoe_planner.planning.reactive.reaching import Attempt, approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.search.postures import Found
from backhoe_planner.planning.transit import find_transit

__all__ = ["find_goal_postures", "plan_to_goal", "swerve_to_goal"]

_LONG_SEARCH = 8  # times as many starting points, before a goal is said to be in collision


def find_goal_postures(context: Context, stepper: Stepper, goal: TipTarget) -> Found | Outcome:
    """Clear configurations on the goal, the nearest first; or why there is none."""
    count = context.work.effort.starting_points
    found = context.postures.at(goal, near=stepper.q, count=count, time=stepper.time)
    if found.reachable and not found.clear:
        found = context.postures.at(goal, near=stepper.q, count=_LONG_SEARCH * count, time=stepper.time)
    return no_posture(context, found, goal, "goal_in_collision", "goal") or found


def plan_to_goal(context: Context, stepper: Stepper, goal: TipTarget) -> Outcome:
    """From a motion that is at rest to the goal, and be at rest there.

    The tip straight for it by the completed law, then a sampled way to any of the
    configurations on the goal, then what else the law can do.
    """
    found = find_goal_postures(context, stepper, goal)
    if isinstance(found, Outcome):
        return found
    straight = next(iter(approach_goal(stepper, goal, (), work=context.work)))
    if straight.arrived:
        return _faster(context, stepper, straight, found)
    transit = find_transit(context, stepper, found.clear)
    if transit.stepper is not None:
        return Outcome(transit.stepper.trajectory(), details={"way": "sampled"})
    outcome = reach_with_law(context, stepper, goal, found.clear)
    if outcome.reason == "blocked":
        message = f"{outcome.message}; {transit.told}"
        return Outcome(outcome.trajectory, outcome.reason, message, dict(outcome.details) | {"sampled": transit.told})
    return outcome


def _faster(context: Context, stepper: Stepper, straight: Attempt, found: Found) -> Outcome:
    """The tip's straight way or, where that is open and faster, the joints'."""
    limits, drive = context.problem.limits, drive_of(context.problem)
    direct = find_transit(context, stepper, found.clear, straight=True)
    joints = None if direct.stepper is None else direct.stepper.trajectory()
    after = np.inf if joints is None else joints.duration - stepper.time
    way = straight.stepper.trajectory()
    if joints is not None and after <= shortest_time(way.q[way.time >= stepper.time - 1e-9], limits):
        return Outcome(joints, details={"way": "straight for the joints"})
    motion = as_fast_as_allowed(context, stepper, straight.stepper).trajectory()
    # the law runs the joints at rates that all of them together may not have
    if joints is not None and joints.duration < retimed(motion, limits, drive=drive).duration:
        return Outcome(joints, details={"way": "straight for the joints"})
    return Outcome(motion, details={"way": straight.way})


def swerve_to_goal(context: Context, stepper: Stepper, goal: TipTarget) -> Outcome | None:
    """On to the goal by the completed law, from a motion that need not be at rest; None where it does not arrive."""
    attempt = next(iter(approach_goal(stepper, goal, (), work=context.work)))
    if not attempt.arrived:
        return None
    return Outcome(attempt.stepper.trajectory(), details={"way": attempt.way})
