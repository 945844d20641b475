"""A search for a motion to a goal, and further ones where another is likely to find a better motion.

What a search comes upon depends on the postures and ways that it draws: of two motions round different sides of an
obstacle it may know the longer one alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.goals.motion_search import MotionSearch
from backhoe_planner.planning.goals.ways import FoundMotion
from backhoe_planner.planning.search.effort import EFFORTS, Effort
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World


@dataclass(frozen=True, eq=False)
class Searched:
    """What the searches from one start found.

    Attributes
    ----------
    best: the best motion; None where none was found.
    allowed_time: how long a motion may take [s], see `MotionSearch.allowed_time`.
    looked_at: how many motions sampling looked at in vain, of ways that were not found by the first.
    ended: that time ran out, in words; else empty.
    """

    best: FoundMotion | None
    allowed_time: float | None
    looked_at: int
    ended: str


def search_motion(world: World, start: Vector, found: GoalPostures, goals: Sequence[Goal], *, time: float) -> Searched:
    """The best motion of a first search and of further ones, none longer than the first allows.

    Parameters
    ----------
    start: (n,) where the machine stands [rad or m].
    found: postures on the `goals`; further searches find others.
    time: the obstacles stand where they are at this time [s].
    """
    search = MotionSearch(world, start, found, time=time)
    ended, is_long = search.run(), search.takes_long
    best, allowed, looked_at = search.best, search.allowed_time, search.looked_at
    longest = math.inf if allowed is None else allowed
    anew, on = (0, 0) if ended or best is None else _further(search, world.work.effort)
    for number in range(1, anew + on + 1):
        again = world.anew(number, EFFORTS["normal"])
        postures = find_goal_postures(again, goals, near=start, time=time)
        if isinstance(postures, Outcome):
            continue
        before = None if number <= anew else search
        search = MotionSearch(again, start, postures, time=time, longest=longest, before=before)
        ended, other = search.run(), search.best
        if other is not None and other.motion.duration <= longest and (best is None or other.cost < best.cost):
            best = other
            world.show(best.motion, attempt=number, best=best.cost)
        if ended or (is_long and other is not None and not search.takes_long):
            break
    return Searched(best, allowed, looked_at, ended)


def _further(first: MotionSearch, effort: Effort) -> tuple[int, int]:
    """How many further searches are begun anew, and how many go on, after one that has found a motion."""
    if first.is_for_time:
        return (effort.restarts_long if first.takes_long else 0), 0
    return effort.restarts, effort.restarts_round if first.leads_round else 0
