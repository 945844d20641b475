"""Searches for a fast motion that come before one for another cost: they show how long a motion may take.

Their motions are starts of the search that follows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, Problem, drive_of, motion_cost
from backhoe_planner.planning.descent.descent_of_time import fastest_along
from backhoe_planner.planning.goals.allowed_time import (
    allowed_time,
    bound_behind,
    bound_for_allowed_time,
    fastest_with_room,
    has_room,
)
from backhoe_planner.planning.goals.goal_postures import find_goal_postures
from backhoe_planner.planning.goals.time_search import TimeSearch
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.search.effort import EFFORTS, Effort
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World

_LONGEST = 20.0  # times the fastest motion: chosen, more time costs samples and gains nothing
# for a motion whose duration decides how long a cheap one may take; if it finds none soon, a longer search follows
_FIRST_SEARCH = replace(EFFORTS["quick"], motions_per_search=1_000, motions=2_000)


@dataclass(frozen=True, eq=False)
class FastMotions:
    """What one search for a fast motion has found.

    Attributes
    ----------
    fastest: the fastest motion, proven clear; None if none is.
    ended: the motions at which descents ended, some of them not proven, without the fastest.
    allowed_time: how long a motion may take if this is the fastest [s]; infinite if none is.
    postures, goals: (n,) each, the postures on the goals that the search knows, and the goal of each.
    looked_at: how many motions were checked in samplings that found no route.
    routes: how many routes were found by sampling.
    """

    fastest: FoundMotion | None
    ended: Sequence[FoundMotion]
    allowed_time: float
    postures: Sequence[Vector]
    goals: Sequence[Goal]
    looked_at: int
    routes: int


def fast_motions(world: World, start: Vector, *, time: float, allowed: float | None) -> Iterator[FastMotions]:
    """The results of one or two searches, of more effort in turn, until a motion is fast enough.

    That is, a motion may take as long as the bound allows, or the scene: see `allowed_time`.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    time: at which the positions of the obstacles are taken [s].
    allowed: how long a motion may take [s], if that is known: one short search is then enough; otherwise None.
    """
    problem, effort = world.problem, world.work.effort
    efforts: tuple[Effort, ...] = (effort,) if effort.is_hurried else (_FIRST_SEARCH, effort)
    most = max(problem.max_duration - time, 0.0)  # the machine may have waited first
    if allowed is None:
        bound = _bound(world, start, most)
    else:
        efforts, bound = (_FIRST_SEARCH,), bound_behind(allowed)
    for one in efforts:
        search = _search_fastest(world, start, one, time=time, enough=fastest_with_room(bound))
        if search is None:
            return
        fastest = search.best
        yield FastMotions(
            fastest=None if fastest is None else _on_given_goal(fastest, problem),
            ended=[_on_given_goal(found, problem) for found in search.ended],
            allowed_time=np.inf if fastest is None else _allowed_time(bound, fastest.motion.duration, most),
            postures=search.ends.postures,
            goals=[_as_given(goal, problem) for goal in search.ends.goals],
            looked_at=search.looked_at,
            routes=search.routes,
        )
        if fastest is not None and has_room(bound, fastest.motion.duration):
            return


def in_least_time(found: FoundMotion, problem: Problem) -> FoundMotion:
    """The fastest motion along the curve of a motion; the same if there is none."""
    curve = found.curve
    fastest = None if curve is None else fastest_along(curve, problem.limits, drive_of(problem))
    if fastest is None or fastest.duration >= found.motion.duration:
        return found
    return replace(found, motion=fastest, cost=motion_cost(problem, fastest), curve=None)


def time_allowed(world: World, start: Vector, fastest: float, *, time: float) -> float:
    """How long a motion may take [s] if the fastest known one takes `fastest` [s]; see `fast_motions`."""
    most = max(world.problem.max_duration - time, 0.0)
    return _allowed_time(_bound(world, start, most), fastest, most)


def _bound(world: World, start: Vector, most: float) -> float:
    """The bound that decides how long a motion may take, if the scene allows at most so much [s]; 0 in a hurry."""
    if np.isfinite(most):
        return bound_behind(most)
    return 0.0 if world.work.effort.is_hurried else bound_for_allowed_time(world.problem, start)


def _allowed_time(bound: float, fastest: float, most: float) -> float:
    """How long a motion may take [s] if the scene allows at most so much.

    Of a motion for which `max_duration` is too short the certificate says so.
    """
    if np.isfinite(most):
        return max(min(most, _LONGEST * fastest), fastest)
    return allowed_time(bound, fastest)


def _search_fastest(world: World, start: Vector, effort: Effort, *, time: float, enough: float) -> TimeSearch | None:
    """A finished search for a motion as fast as `enough` [s]; None if it finds no posture on a goal.

    Unless the scene says how long a motion may take, the motion leads to the positions themselves, if possible:
    because of a tolerance a motion need not be sooner at its end, and would cost more.
    """
    goals, infinite = world.problem.goals, np.isinf(world.problem.max_duration)
    world = world.for_time(effort)
    exact = tuple(goal.exactly for goal in goals) if infinite else goals
    found = find_goal_postures(world, exact, near=start, time=time)
    if isinstance(found, Outcome) and exact != goals:
        found = find_goal_postures(world, goals, near=start, time=time)
    if isinstance(found, Outcome):
        return None
    search = TimeSearch(world, start, found, time=time, enough=enough)
    search.run()
    return search


def _on_given_goal(found: FoundMotion, problem: Problem) -> FoundMotion:
    return replace(found, goal=_as_given(found.goal, problem))


def _as_given(goal: Goal, problem: Problem) -> Goal:
    """The goal of the problem with its tolerance, if `goal` is the same without one."""
    given = next((one for one in problem.goals if one.name == goal.name), goal)
    return goal if given.exactly is given or goal.q is not None else given
