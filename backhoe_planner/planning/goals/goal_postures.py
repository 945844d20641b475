"""Postures in which a motion to a goal may end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import Goal
from backhoe_planner.planning.result.plan_file import Reason
from backhoe_planner.planning.world.outcome import Outcome, bad_posture, no_posture, rest_at_start
from backhoe_planner.planning.world.world import World

_LONG_SEARCH = 8  # times the usual starting points, before a goal is reported to be in collision; chosen
# if several goals fail, the mildest reason is reported; the mildest first
_MILDEST: tuple[Reason, ...] = ("goal_breaks_keep", "goal_in_collision", "outside_limits", "unreachable")


@dataclass(frozen=True, eq=False)
class GoalPostures:
    """Clear postures on the goals of a problem, at least one; the quickest to reach first.

    Attributes
    ----------
    clear: (n,) each [rad or m].
    goals: the goal of each posture.
    left_out: why other goals have no such posture, one sentence for each.
    """

    clear: tuple[Vector, ...]
    goals: tuple[Goal, ...]
    left_out: tuple[str, ...] = ()

    def by_goal(self) -> list[tuple[Goal, tuple[Vector, ...]]]:
        """Every goal that has a posture, with its postures; the quickest goal to reach first."""
        return [
            (goal, tuple(q for q, own in zip(self.clear, self.goals, strict=True) if own is goal))
            for goal in dict.fromkeys(self.goals)
        ]


def find_goal_postures(
    world: World, goals: Sequence[Goal], *, near: Vector, time: float, more: int = 1, travel: Vector | None = None
) -> GoalPostures | Outcome:
    """Clear postures on any of `goals`; or why there is none.

    Parameters
    ----------
    near: (n,) the present joint positions [rad or m].
    time: at which the positions of the obstacles are taken [s].
    more: times the usual starting points of the inverse kinematics. Every call draws other ones.
    travel: (n,) how far starting points may be from `near` [rad or m]; None for anywhere. With it, no longer search
        is made if all postures found collide.
    """
    found: list[tuple[Vector, Goal]] = []
    failures: list[Outcome] = []
    for goal in goals:
        clear = _postures_on(world, goal, near, time, more, travel)
        if isinstance(clear, Outcome):
            failures.append(clear)
        else:
            found += [(q, goal) for q in clear]
    if not found:
        mildest = min(failures, key=lambda failure: _MILDEST.index(failure.reason))
        return Outcome(
            mildest.trajectory, mildest.reason, "; ".join(failure.message for failure in failures), mildest.findings
        )
    rate = world.problem.limits.velocity
    found.sort(key=lambda one: float(np.max(np.abs(one[0] - near) / rate)))
    return GoalPostures(
        tuple(q for q, _ in found), tuple(goal for _, goal in found), tuple(failure.message for failure in failures)
    )


def _postures_on(
    world: World, goal: Goal, near: Vector, time: float, more: int, travel: Vector | None
) -> tuple[Vector, ...] | Outcome:
    if goal.q is not None:
        return bad_posture(world, goal.q, goal.name, time=time) or (goal.q,)
    keep, target = world.problem.keep, goal.search_target
    if keep is None:
        return _on_target(world, target, goal, near, time, more, travel)
    narrowed = keep.narrowed(target)
    within = None if narrowed is None else _on_target(world, narrowed, goal, near, time, more, travel)
    kept = tuple(q for q in within if keep.holds(q)) if isinstance(within, tuple) else ()
    if kept:
        return kept
    # find out whether the goal itself fails, or `keep` at the goal
    free = _on_target(world, target, goal, near, time, more, travel)
    if isinstance(free, Outcome):
        return free
    kept = tuple(q for q in free if keep.holds(q))
    if kept:
        return kept
    if isinstance(within, Outcome) and within.reason == "goal_in_collision":
        return within
    nearest = max(free, key=lambda q: float(np.min(keep.margins(q))))
    message = f"at the {goal.name} {keep.broken(nearest)}"
    if narrowed is not None:  # the goal's own angles leave room for the kept condition
        message = f"no posture was found on the {goal.name} that keeps it: at best {keep.broken(nearest)}"
    return Outcome(rest_at_start(world, nearest), "goal_breaks_keep", message)


def _on_target(
    world: World, target: TipTarget, goal: Goal, near: Vector, time: float, more: int, travel: Vector | None
) -> tuple[Vector, ...] | Outcome:
    count = more * world.work.effort.starting_points
    hurried = world.work.effort.is_hurried
    found = world.postures.at(target, near=near, count=count, time=time, hurried=hurried, travel=travel)
    if found.best.reached and not found.clear and travel is None:
        found = world.postures.at(target, near=near, count=_LONG_SEARCH * count, time=time)
    return no_posture(world, found, target, "goal_in_collision", goal.name) or found.clear
