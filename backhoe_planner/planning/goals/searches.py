"""A search for a motion to a goal, and further searches if these are likely to find a better motion.

The result of a search depends on the postures and routes that it draws: of two motions around different sides of an
obstacle it may find only the longer one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.goals.time_search import TimeSearch
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.lift import is_frugal, lift_of
from backhoe_planner.planning.search.effort import EFFORTS
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World

# postures known to a search, from which on one of the other kind follows even if it was short, because it has drawn
# only some of those that differ; chosen: for a backhoe they are a dozen or fewer
_MANY = 40
# rounds of the descents of a search, without refining, above which another one may find a much cheaper motion. One plan
# in six has more; of 50 plans of three machines with 35 to 60 rounds one costs 0.8 % less with another search, and of
# ten with 61 to 70 one 2 %
_HARD = 60
_FEWER = 3  # times fewer further searches for a cost that jumps, as each takes several times as long; chosen
# part of the cost that a search begun anew must gain for another to follow; measured on 63 sites of three machines: of
# 32 such searches three gained more than 1 %, and of nine that followed one without a gain, one did (1.1 %)
_DULL = 0.03
# kinds of searches: every other one that is begun anew begins with what descents without obstacles make of lines to
# many more postures. On an open site of the Panda six searches of the usual kind end at 3.3 to 3.6 J and two of the
# other at 2.1 J, on a site of the backhoe it is 172 J and 211 J
_KINDS = 2
# part of the cost by which the results of two searches count as equal where searches are not frugal, and so many equal
# ones end them; chosen
_ALIKE, _AGREE = 0.03, 2


@dataclass(frozen=True, eq=False)
class Searched:
    """What the searches from one start found.

    Attributes
    ----------
    best: the best motion; None if none was found.
    allowed_time: how long a motion may take [s], see `CostSearch.allowed_time`; None if the time is the cost.
    looked_at: how many motions the first search checked in samplings that found no route.
    routes: how many routes it found by sampling.
    ended: that time ran out, in words; otherwise empty.
    fast: the fast motion with which the first search for another cost than the time began; None if there is none.
    """

    best: FoundMotion | None
    allowed_time: float | None
    looked_at: int
    routes: int
    ended: str
    fast: FoundMotion | None = None


def search_motion(world: World, start: Vector, found: GoalPostures, goals: Sequence[Goal], *, time: float) -> Searched:
    """The best motion of all searches of the effort, and of those of the effort in `begins_with`.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    found: postures on the `goals`; further searches find others.
    time: at which the positions of the obstacles are taken [s].
    """
    begins_with = world.work.effort.begins_with
    usual = _begin(world.anew(0, EFFORTS[begins_with]), start, goals, time=time) if begins_with else None
    if usual is not None and usual.ended:
        return usual
    if usual is not None and usual.best is not None:
        world.show(usual.best.motion, attempt=0, best=usual.best.cost)
    searched = _search(world, start, found, goals, time=time)
    if usual is None or usual.best is None or (searched.best is not None and searched.best.cost <= usual.best.cost):
        return searched
    return replace(usual, looked_at=searched.looked_at, routes=searched.routes, ended=searched.ended)


def _begin(world: World, start: Vector, goals: Sequence[Goal], *, time: float) -> Searched | None:
    """The result of searches that first look for postures themselves; None if there is no posture."""
    found = find_goal_postures(world, goals, near=start, time=time)
    return None if isinstance(found, Outcome) else _search(world, start, found, goals, time=time)


def _search(world: World, start: Vector, found: GoalPostures, goals: Sequence[Goal], *, time: float) -> Searched:
    """The best motion of a first search, which has `found` postures, and of further ones."""
    search = _search_fastest if world.problem.objective.is_time else _search_cheapest
    return search(world, start, found, goals, time=time)


def _search_fastest(
    world: World, start: Vector, found: GoalPostures, goals: Sequence[Goal], *, time: float
) -> Searched:  # fmt: skip
    """The fastest motion; further searches follow until one finds a motion that does not take long."""
    search = TimeSearch(world, start, found, time=time)
    ended, best = search.run(), search.best
    looked_at, routes = search.looked_at, search.routes
    restarts = world.work.effort.restarts_long if search.takes_long and not ended else 0
    for number in range(1, restarts + 1):
        assert best is not None
        again = _anew(world, number)
        postures = find_goal_postures(again, goals, near=start, time=time)
        if isinstance(postures, Outcome):
            continue
        search = TimeSearch(again, start, postures, time=time)
        ended, other = search.run(), search.best
        if other is not None and other.cost < best.cost:
            best = other
            world.show(best.motion, attempt=number, best=best.cost)
        if ended or (other is not None and not search.takes_long):
            break
    return Searched(best, None, looked_at, routes, ended)


def _search_cheapest(
    world: World, start: Vector, found: GoalPostures, goals: Sequence[Goal], *, time: float
) -> Searched:  # fmt: skip
    """The cheapest motion; no further search finds one that is longer than the first search allows."""
    search = CostSearch(world, start, found, time=time)
    ended, best, allowed, fast = search.run(), search.best, search.allowed_time, search.fast
    looked_at, routes = search.looked_at, search.routes
    searches = () if ended or best is None else _further(search, world)
    # the costs of the first search with those that continue it, and of each search that was begun anew
    costs = [] if best is None else [best.cost]
    earlier: list[CostSearch] = []  # that have ended; of those that continue each other, the last
    for number, goes_on in enumerate(searches, start=1):
        assert best is not None
        assert allowed is not None  # it is known as soon as there is a motion
        if not goes_on and not _may_find_less(costs, world, start, found):
            break
        again = _anew(world, number)
        postures = find_goal_postures(again, goals, near=start, time=time)
        if isinstance(postures, Outcome):
            continue
        before = search if goes_on else None
        earlier = earlier if goes_on else [*earlier, search]
        search = CostSearch(
            again, start, postures, time=time, longest=allowed, before=before, earlier=earlier,
            freely=len(earlier) % _KINDS == 1,
        )  # fmt: skip
        ended, other = search.run(), search.best
        cost = math.inf if other is None or other.motion.duration > allowed else other.cost
        if other is not None and cost < best.cost:
            best = other
            world.show(best.motion, attempt=number, best=best.cost)
        costs = [best.cost] if goes_on else [*costs, min(costs) if search.repeats else cost]
        if ended:
            break
    return Searched(best, allowed, looked_at, routes, ended, fast)


def _anew(world: World, number: int) -> World:
    """The world of a further search: the normal effort, with random choices of its own."""
    return world.anew(number, replace(EFFORTS["normal"], frugal=world.work.effort.frugal))


def _further(first: CostSearch, world: World) -> tuple[bool, ...]:
    """The further searches after one that has found a motion: true for one that continues it, false for a new one."""
    effort = world.work.effort
    # a result that was found quickly is mostly found again, unless much depended on refining it
    is_easy = first.rounds <= _HARD and not first.refining_paid
    frugal = is_frugal(world)
    anew = effort.restarts
    if frugal and is_easy:
        anew = min(anew, 1) if first.postures >= _MANY else 0
    goes_on = effort.restarts_round if first.leads_round and not frugal else 0
    if world.problem.objective.jumps:
        anew, goes_on = -(-anew // _FEWER), -(-goes_on // _FEWER)
    return (True,) * goes_on + (False,) * anew


def _may_find_less(costs: Sequence[float], world: World, start: Vector, found: GoalPostures) -> bool:
    """Whether another search that is begun anew may find a motion that costs clearly less.

    It is unlikely if one costs little, or little more than the lift to the lowest posture. For little work, also after
    one of each kind, if the last of the `costs` of searches from the same start is not much below the others: by a few
    per cent, and what is worth another search. For another cost, if two of them are nearly equal to the least.
    """
    if not world.work.effort.frugal:
        return True
    least = min(costs)
    worth, lift = 0.0, lift_of(world.problem)
    if lift is not None:
        if least <= lift.little or lift.is_near(least, start, found.clear):
            return False
        worth = lift.worth
    if not is_frugal(world):
        return sum(cost <= max((1.0 + _ALIKE) * least, least + worth) for cost in costs) < _AGREE
    return len(costs) <= _KINDS or costs[-1] < min((1.0 - _DULL) * min(costs[:-1]), min(costs[:-1]) - worth)
