"""The search for the least-cost motion to a goal: many starts, each optimised by a descent.

The starts are straight lines in joint space to the nearest postures on a goal, clear or not, then a sampled route,
then different routes through roadmaps, made of configurations through which a motion can be shorter than the best,
or much shorter. Every motion that counts is proven clear. A search that repeats another one for another cost than the
time may begin with what descents without obstacles make of lines to many more postures, see `free_starts`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import travel_within
from backhoe_planner.motion import Goal, Trajectory, motion_cost
from backhoe_planner.planning.descent.descent import NO_COST
from backhoe_planner.planning.goals.allowed_time import (
    allowed_time,
    bound_behind,
    bound_for_allowed_time,
    fastest_with_room,
    has_room,
)
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart.free_starts import LINES_FOR_ONE, alike, free_starts
from backhoe_planner.planning.multistart.motion_descents import FINE_ROUNDS, LEAST_GAIN, MotionDescents, holds_end
from backhoe_planner.planning.multistart.start_prices import PricedStart, StartPrices
from backhoe_planner.planning.multistart.straight_lines import StraightLines
from backhoe_planner.planning.multistart.ways import FoundMotion, Ways
from backhoe_planner.planning.search.effort import EFFORTS, Effort, OutOfTime
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.search.way_price import price_of
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import least_duration
from backhoe_planner.site import ClearanceScreen

_PLACES = 25  # of a known motion, given to a roadmap; chosen, about every 2 to 10 cm of the tip
_WORTH = 1.4  # times the best cost, up to which a route is worth a descent; chosen
_WORTH_MORE = 2.0  # times the relative excess of the best over the bound: by so much a route may cost more; chosen
_DEAREST = 1.6  # times the best cost: the highest price of a route through a roadmap; chosen
# parts of the logarithmic distance from the best duration to the bound, by which a route's longest time is below the
# best, in turn; chosen
_SHORTER = (0.25, 0.5, 0.0, 0.5)
_MANY_NODES = 3_600  # at least so many in a roadmap after one that gained nothing; chosen
_FEWEST_WAYS = 2  # tries to sample a first route before the search gives up
# times the bound, from which there is more patience, and its factor; chosen
_PATIENCE = ((2.0, 4), (1.4, 3), (1.1, 2))
# the same for another cost than the time, with the cheapest blocked start in place of the bound
_PATIENCE_ROUND = ((2.0, 3), (1.3, 2))
_NEAR = 1.1  # times the least time to any posture, up to which a motion counts as near the best possible; chosen
_MORE_POSTURES = 4  # times the usual starting points, if more postures are looked for; chosen
_MORE_FOR_COST = 12  # the same for another cost than the time, which depends mostly on the end; measured
_MORE_FREELY = 36  # the same for a search that begins with descents without obstacles; chosen
_SIDES = 2  # sampled detours for a start that is blocked, which may pass it on different sides; chosen
_VAIN = 2  # a search that found no route at all counts as so many that gained nothing; chosen
_ELSEWHERE = 0.3  # s of joint time between two ends that count as different; chosen
# for another cost than the time and for each of `Effort.ways_at_once`: how many of the cheapest straight lines are
# also tried with some joints early or late, how many of all these get a few rounds, and how many of the other lines,
# because the price of a line says little about the result of its descent: on an open site of the Panda with lines to
# 509 postures, one that costs 2.2 times as much as the cheapest ends at half of its cost; chosen
_LINES_FOR_ONE, _LINES_TRIED_FOR_ONE, _LINES_SPREAD_FOR_ONE = 3, 2, 2
_STARTS_FOR_ONE = 2.5  # starts of a search that begins with descents without obstacles, likewise; chosen
_LONGEST = 20.0  # times the fastest motion: chosen, more time costs samples and gains nothing
# times the least cost that an earlier search had before refining, up to which a motion is refined; chosen
_REFINED, _REFINED_FRUGAL = 1.3, 1.0  # the second for frugal searches; chosen
_PAYS = 0.15  # part of the cost: gaining more by refining is much; chosen
_THE_SAME = 1e-6  # part of the cost by which two searches differ that have found the same motion; chosen
_GAIN = 0.005  # part of the cost that counts as a gain
# times the least time to any posture, from which another search may find a much shorter motion; chosen: on random
# sites of backhoe, Panda and telescope one motion in fifty takes longer
_MUCH_LONGER = 1.5
_FEWER_BOXES = 4  # times fewer for the bound of the search than for that of the plan; chosen
_END_GAIN = 0.15  # part of the least time to a posture that may be gained if the end can move on the goal; chosen
# for a motion whose duration decides how long a cheap one may take; if it finds none soon, a longer search follows
_FIRST_SEARCH = replace(EFFORTS["quick"], motions_per_search=1_000, motions=2_000)


class MotionSearch:
    """A search from one start.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    found: postures on the goals.
    time: at which the positions of the obstacles are taken [s].
    enough: a motion as fast as this ends the search, if the time is the cost [s].
    longest: the longest time that a motion may take, if the time is not the cost [s]; if infinite, the search finds it.
    before: an earlier search from the same start among the same obstacles, which has ended and is continued here with
        other random choices, if the time is not the cost: the same longest time holds, and only better motions count.
    freely: whether to begin with what descents without obstacles make of lines to many more postures, and without a
        search for a fast motion; only if the time is not the cost, and `longest` is finite.
    earlier: other searches from the same start among the same obstacles, which have ended, if the time is not the cost:
        what they have tried is not tried again.

    Attributes
    ----------
    repeats: whether the search would begin only where an earlier one began, or where nothing promises a cheaper motion,
        or refine what an earlier one refined, and was ended therefore.
    """

    def __init__(
        self, world: World, start: Vector, found: GoalPostures, *, time: float, enough: float = 0.0,
        longest: float = np.inf, before: MotionSearch | None = None, freely: bool = False,
        earlier: Sequence[MotionSearch] = (),
    ) -> None:  # fmt: skip
        self._world, self._start, self._time, self._enough = world, start, time, enough
        self._problem, self._hurried = world.problem, world.work.effort.is_hurried
        self._screen = ClearanceScreen(world.proximity, time=time)
        self._ends = GoalEnds(world.problem, start)
        self._ends.take(found.clear, found.goals)
        self._lines = StraightLines(start, self._ends, self._screen, pieces=world.work.effort.pieces)
        self._ways = Ways(world, start, self._ends, time=time, hurried=self._hurried)
        self._freely = freely
        self._goes_on = before is not None and before.allowed_time is not None
        known: MotionDescents | None = None if before is None else before._descents
        self._descents: MotionDescents = MotionDescents(
            world, start, self._ends, time=time, longest=longest, before=known
        )
        # what a search found on its way round obstacles depends on its random choices, not on where it began
        self._tried = [curve for one in earlier if not one.leads_round for curve in one._descents.begun]
        self._refined = [one._descents.unrefined_cost for one in earlier]
        if self._descents.is_frugal:  # the cheapest starts of earlier searches are not tried again
            self._descents.know_of(one._descents for one in earlier)
        self.repeats = False
        self._for_time = (0, 0)  # motions looked at, and routes found, by searches for a fast motion
        self._bound = 0.0  # lower bound of the duration [s]; computed if the best is not near the least time
        self._looked_within = np.inf  # s: the last search for further postures was for those within this time

    @property
    def best(self) -> FoundMotion | None:
        """The best motion so far."""
        return self._descents.best

    @property
    def ended(self) -> list[FoundMotion]:
        """The motions at which descents ended, some of them not proven."""
        return self._descents.ended

    @property
    def looked_at(self) -> int:
        """How many motions were checked in samplings that found no route."""
        return self._ways.looked_at + self._for_time[0]

    @property
    def routes(self) -> int:
        """How many routes were found by sampling."""
        return len(self._ways.reached) + self._for_time[1]

    def run(self) -> str:
        """Search until the effort is used up or nothing is gained; the result is `best`.

        Returns
        -------
        Empty, or that time ran out, in words.
        """
        try:
            if not self._problem.objective.is_time:
                self._go_freely() if self._freely else self._go_fast()
            if self.repeats:
                return ""
            if self.allowed_time is None:
                self._go_straight(self._lines.least_blocked() if self._hurried else self._ends.order)
                if not self._hurried and not self._is_enough():
                    self._go_straight(self._look_for_postures(None if self.best is None else self.best.motion.duration))
            if self.leads_round or (self.best is None and not self._freely):
                self._go_round()
            if not self._is_enough() and self._is_worth_refining:
                self.repeats = self._is_refined_already
                if not self.repeats:
                    self._descents.refine()
        except OutOfTime as ended:
            return str(ended)
        return ""

    @property
    def postures(self) -> int:
        """How many postures on the goals are known."""
        return len(self._ends.postures)

    @property
    def rounds(self) -> int:
        """How many rounds its descents have made, without those for a fast motion and those that refine the best."""
        return self._descents.rounds_before_refining

    @property
    def refining_paid(self) -> bool:
        """Whether refining took much of its cost from the best: then it may have taken more from another motion."""
        return self._descents.gained_by_refining > _PAYS

    @property
    def allowed_time(self) -> float | None:
        """How long a motion may take [s]; None if the time is the cost, or no motion is known."""
        return self._descents.longest if np.isfinite(self._descents.longest) else None

    @property
    def leads_round(self) -> bool:
        """Whether the best motion goes around an obstacle, or may cost more than one that does; see `goes_straight`."""
        return self.best is not None and not self._is_least and not self._descents.goes_straight(self.best)

    @property
    def is_for_time(self) -> bool:
        """Whether the time is the cost."""
        return self._problem.objective.is_time

    @property
    def takes_long(self) -> bool:
        """Whether the best takes much longer than the joints need to some posture, if the time is the cost."""
        return (
            self.is_for_time and self.best is not None and self.best.motion.duration > _MUCH_LONGER * self._least_time()
        )

    @property
    def _costs_nothing(self) -> bool:
        """Whether the best costs so little that nothing can be gained."""
        return self.best is not None and not self._problem.objective.is_time and self.best.cost <= NO_COST

    @property
    def _is_least(self) -> bool:
        """Whether the best costs nothing or little, or little more than the lift to the lowest posture."""
        lift = self._descents.lift
        if lift is None or self.best is None or self._descents.costs_little:
            return self._costs_nothing or self._descents.costs_little
        return lift.is_near(self.best.cost, self._start, self._ends.postures)

    @property
    def _is_worth_refining(self) -> bool:
        """Whether the best was found by this search, costs something, and not much more than that of an earlier one."""
        most = _REFINED_FRUGAL if self._descents.is_frugal else _REFINED
        has_gained = self._descents.has_gained and not self._costs_nothing
        return has_gained and self._descents.unrefined_cost <= most * min(self._refined, default=np.inf)

    @property
    def _is_refined_already(self) -> bool:
        """Whether an earlier search found what this one has found, before refining."""
        cost = self._descents.unrefined_cost
        return any(abs(cost - one) <= _THE_SAME * cost for one in self._refined)

    def _bound_above(self, known: Trajectory) -> float:
        """A lower bound on the duration of any motion [s], from fewer boxes than the plan's; `known` is one motion."""
        boxes = self._world.work.effort.boxes // _FEWER_BOXES
        return least_duration(self._problem, self._start, known=known.duration, end=known.q[-1], boxes=boxes).duration

    # --- starts -----------------------------------------------------------------------

    def _go_fast(self) -> None:
        """Descents from the results of searches for a fast motion, and from lines to many postures.

        None of these if no proven motion is known.
        """
        ended = [] if self._goes_on else self._find_fast()
        if self.allowed_time is None:
            return
        work = self._world.work
        if not self._hurried:
            self._look_for_postures(within=self._descents.longest)
        self._descents.reserve(work.descent_rounds // 3)
        ways = work.effort.ways_at_once
        prices = self._descents.prices(self._screen)
        all_lines = [] if self._hurried else self._lines.within(self._descents.longest)
        straight = prices.fair(prices.in_order(all_lines))
        lines = prices.cheapest(straight, _LINES_FOR_ONE * ways)
        both = sorted([*lines, *prices.paced(lines)], key=lambda one: one.price)
        known = prices.in_order([self._descents.fitted(one) for one in ended])
        begun = [*self._descents.begun, *(self._tried if self._descents.is_frugal else ())]
        cheap = prices.cheapest(both, _LINES_TRIED_FOR_ONE * ways, known=begun)
        chosen = [
            *prices.cheapest(known, ways, known=begun),
            *cheap,
            *prices.spread(straight, _LINES_SPREAD_FOR_ONE * ways, known=[*begun, *(one.start.curve for one in cheap)]),
        ]
        self._descend_unless_tried(prices, chosen)

    def _go_freely(self) -> None:
        """Descents from where descents without obstacles end, which begin at lines to many more postures."""
        work, longest = self._world.work, self._descents.longest
        self._look_for_postures(within=longest)
        self._descents.reserve(work.descent_rounds // 3)
        own = alike(self._problem, np.vstack((self._start, *self._ends.postures)))
        prices, ways = self._descents.prices(self._screen, alike=own), work.effort.ways_at_once
        lines = self._lines.many_within(longest, most=LINES_FOR_ONE * ways, alike=own)
        starts = free_starts(self._problem, lines, prices, longest=longest, ways=ways)
        self._descend_unless_tried(prices, prices.spaced(starts, round(_STARTS_FOR_ONE * ways), known=self._tried))

    def _descend_unless_tried(self, prices: StartPrices, chosen: Sequence[PricedStart]) -> None:
        """Descents from the `chosen` starts, unless earlier searches began with all of them."""
        self.repeats = bool(self._tried) and all(prices.repeats(one, self._tried) for one in chosen)
        if not self.repeats:
            self._descents.descend_cheapest(chosen)
            self.repeats = self._descents.falls_short

    def _find_fast(self) -> list[FoundMotion]:
        """The results of searches for a fast motion and of their descents; sets how long a motion may take.

        If that is known already, one short search is enough. It stays infinite if no search finds a proven motion.
        """
        ended: list[FoundMotion] = []
        efforts: tuple[Effort, ...] = (self._world.work.effort,)
        bound, most = 0.0, max(self._problem.max_duration - self._time, 0.0)  # the machine may have waited first
        if self.allowed_time is not None:
            efforts, bound = (_FIRST_SEARCH,), bound_behind(self.allowed_time)
        elif np.isfinite(most):
            efforts, bound = efforts if self._hurried else (_FIRST_SEARCH, *efforts), bound_behind(most)
        elif not self._hurried:
            efforts, bound = (_FIRST_SEARCH, *efforts), bound_for_allowed_time(self._problem, self._start)
        for effort in efforts:
            search = self._search_fastest(effort, enough=fastest_with_room(bound))
            if search is None:
                break
            self._ends.take(search._ends.postures, [self._as_given(goal) for goal in search._ends.goals])
            ended += [replace(one, goal=self._as_given(one.goal)) for one in search.ended]
            if search.best is not None:
                ended.append(replace(search.best, goal=self._as_given(search.best.goal)))
                fastest = search.best.motion
                # of a motion for which max_duration is too short the certificate says so
                if np.isfinite(most):
                    allowed = max(min(most, _LONGEST * fastest.duration), fastest.duration)
                else:
                    allowed = allowed_time(bound, fastest.duration)
                self._descents.longest = min(self._descents.longest, allowed)
                self._descents.offer(replace(ended[-1], cost=motion_cost(self._problem, fastest)))
                if has_room(bound, fastest.duration):
                    break
        return ended

    def _search_fastest(self, effort: Effort, *, enough: float) -> MotionSearch | None:
        """A finished search for a motion as fast as `enough` [s]; None if it finds no posture on a goal.

        Unless the scene says how long a motion may take, the motion leads to the positions themselves, if possible:
        because of a tolerance a motion need not be sooner at its end, and would cost more.
        """
        world, goals = self._world.for_time(effort), self._problem.goals
        exact = tuple(goal.exactly for goal in goals) if np.isinf(self._problem.max_duration) else goals
        found = find_goal_postures(world, exact, near=self._start, time=self._time)
        if isinstance(found, Outcome) and exact != goals:
            found = find_goal_postures(world, goals, near=self._start, time=self._time)
        if isinstance(found, Outcome):
            return None
        search = MotionSearch(world, self._start, found, time=self._time, enough=enough)
        search.run()
        looked_at, routes = self._for_time
        self._for_time = looked_at + search.looked_at, routes + search.routes
        return search

    def _as_given(self, goal: Goal) -> Goal:
        """The goal of the problem with its tolerance, if `goal` is the same without one."""
        given = next((one for one in self._problem.goals if one.name == goal.name), goal)
        return goal if given.exactly is given or goal.q is not None else given

    def _look_for_postures(self, within: float | None) -> list[int]:
        """Look for more postures, within a time [s] or anywhere; the indices of the new ones, the soonest first."""
        self._looked_within = np.inf if within is None else within
        more = _MORE_FREELY if self._freely else _MORE_POSTURES if self.is_for_time else _MORE_FOR_COST
        found = find_goal_postures(
            self._world, self._problem.goals, near=self._start, time=self._time, more=more,
            travel=None if within is None else travel_within(within, self._problem.limits),
        )  # fmt: skip
        return [] if isinstance(found, Outcome) else self._ends.take(found.clear, found.goals)

    def _go_straight(self, order: Sequence[int]) -> None:
        """Descents from straight lines to the first postures of `order`, until one descent does not get clear."""
        work = self._world.work
        self._descents.reserve(work.descent_rounds // 2)
        for index in order[: work.effort.ways_at_once]:
            if self._is_optimal():
                return
            if not self._is_open(index):
                continue
            if not self._descents.descend(self._lines.to(index)):
                return

    def _go_round(self) -> None:
        """Descents from a sampled route, then from routes through roadmaps, until several in a row gain nothing.

        For another cost than the time, every other turn uses sampled routes: the cost of a route says little about the
        result of a descent, and sampled routes differ more from each other than the cheapest through roadmaps.
        """
        work, is_time = self._world.work, self._problem.objective.is_time
        turn, dull = (0 if is_time else 1), 0  # the search for the fastest had the first routes
        self._descents.reserve(FINE_ROUNDS if work.effort.descent_rounds > 2 * FINE_ROUNDS else 0)
        while self.best is None and self._ways.may_sample and turn < max(work.effort.ways_at_once, _FEWEST_WAYS):
            self._follow(self._sampled(turn))
            turn += 1
        keep = self._problem.keep
        mapped = keep is None or not keep.cones
        work.descent_rounds, work.way_rounds = work.descent_rounds + work.way_rounds, 0
        while self.best is not None and dull < self._patience() and not self._is_optimal():
            if self._descents.rounds_left <= 0:
                return
            before = self.best.cost
            sampled = not mapped or (not is_time and turn % 2 == 1)
            if not is_time:
                self._go_around(turn)
            found = self._follow(self._sampled(turn) if sampled else self._mapped(turn, dull))
            turn += 1
            gained = self.best.cost < (1.0 - _GAIN) * before
            dull = 0 if gained else dull + (1 if found or mapped else _VAIN)

    def _go_around(self, turn: int) -> None:
        """Descents from the cheapest starts that stayed in an obstacle, with detours around it.

        Such a start is tried once, if it cost less after its first rounds than all that got clear.
        """
        ways, least = self._world.work.effort.ways_at_once, self._descents.early
        blocked = [start for cost, start in self._descents.take_blocked() if cost < least][:ways]
        tried = [self._ways.around(start, turn + number) for start in blocked for number in range(_SIDES)]
        starts = [start for start in tried if start is not None]
        if starts:
            prices = self._descents.prices(self._screen)
            self._descents.descend_cheapest(prices.cheapest(prices.in_order(starts), ways))

    def _follow(self, ways: Iterable[FoundMotion]) -> bool:
        """Descents from the routes that are worth one; whether there are any routes."""
        if self.allowed_time is not None:
            ways = list(ways)
            for way in ways:
                self._descents.offer(way)
            prices = self._descents.prices(self._screen)
            priced = prices.in_order([self._descents.fitted(way) for way in ways])
            self._descents.descend_cheapest(prices.cheapest(priced, len(ways)))
            return bool(ways)
        found = False
        for way in ways:
            found = True
            if self.best is not None and (way.cost > self._dearest_worth() or self._is_optimal()):
                continue
            if not self._hurried:
                self._descents.offer(way)
            if not self._descents.descend_if_new(way):
                continue
            if self._hurried:  # if the descent got clear, the route itself need not be proven
                self._descents.offer(way)
        return found

    def _patience(self) -> int:
        """How many times in a row the search may gain nothing."""
        usual = self._world.work.effort.dull_searches
        if self._hurried:
            return 0
        if not self._problem.objective.is_time:
            if not self._descents.has_gained:
                return usual
            best = np.inf if self.best is None else self.best.cost
            return usual * next((factor for part, factor in _PATIENCE_ROUND if best > part * self._descents.blocked), 1)
        assert self.best is not None
        if self._is_near():
            return usual - self.best.free
        return usual * next((factor for part, factor in _PATIENCE if self.best.cost > part * self._bound), 1)

    def _is_near(self) -> bool:
        """Whether the best is near the lower bound for motions to any known posture."""
        assert self.best is not None
        if self.best.motion.duration < _NEAR * self._least_time():
            return True
        if not self._bound:
            self._bound = self._bound_above(self.best.motion)
        return False

    def _least_time(self) -> float:
        """A lower bound on the duration of any motion to a known posture [s]."""
        own = np.inf if self.best is None else self._ends.least_to(self.best.motion.q[-1])
        return min(own, *self._ends.least)

    def _dearest_worth(self) -> float:
        """The highest cost of a route that is worth a descent: little above the best if little can be gained."""
        assert self.best is not None
        least = self._bound or self._least_time()
        above = self.best.cost / least - 1.0 if least else np.inf
        return self.best.cost * min(_WORTH, 1.0 + _WORTH_MORE * above)

    def _sampled(self, turn: int) -> Iterator[FoundMotion]:
        """Motions along sampled routes to postures that can still give a better motion."""
        ways = self._world.work.effort.ways_at_once
        for number in (turn,) if self.best is None else range(ways * turn, ways * (turn + 1)):
            which = [index for index in self._ends.order if self._is_open(index)]
            if number % 2:
                which = self._elsewhere(which) or which
            way = self._ways.sample(which, number, again=0 if self.best is None else 1) if which else None
            if way is not None:
                yield way

    def _mapped(self, turn: int, dull: int) -> Iterator[FoundMotion]:
        """Motions along different routes through a roadmap, away from the known motions."""
        assert self.best is not None
        longest, best, nodes = self._descents.longest, self.best, self._world.work.effort.nodes
        if not np.isfinite(longest):
            longest, nodes = self._longest_worth(dull), max(nodes, _MANY_NODES) if dull else nodes
            if longest != self._looked_within:
                self._look_for_postures(longest)
        which = [index for index in self._ends.order if self._is_open(index) and self._ends.least[index] < longest]
        if not which:
            return
        known = [one.motion.at(np.linspace(0.0, one.motion.duration, _PLACES)) for one in (*self.ended, best)]
        price, own = price_of(self._problem, best.motion, longest), best.cost
        if self.allowed_time is not None:  # compare prices with prices: a descent makes a route several times cheaper
            own = max(own, float(np.sum(price(known[-1][:-1], known[-1][1:]))))
        found = self._ways.through_roadmap(
            which, turn, nodes=nodes, longest=longest, price=price, known=known, dearest=_DEAREST * own
        )
        yield from itertools.islice(found, 2 * self._world.work.effort.ways_at_once)

    def _longest_worth(self, dull: int) -> float:
        """The longest estimated time of a route [s], after some vain turns: mostly much less than the best duration."""
        assert self.best is not None
        best = self.best.motion.duration
        if self._is_near() or not self._bound:
            return best
        return float(best * (self._bound / best) ** _SHORTER[dull % len(_SHORTER)])

    def _elsewhere(self, ends: Sequence[int]) -> list[int]:
        """Those of the postures `ends` that are far from the ends of sampled routes and descents."""
        ended = np.array([*self._ways.reached, *(one.motion.q[-1] for one in self.ended)])
        rate = self._problem.limits.velocity
        return [
            index
            for index in ends
            if not len(ended) or np.min(np.max(np.abs(self._ends.postures[index] - ended) / rate, axis=1)) > _ELSEWHERE
        ]

    def _is_enough(self) -> bool:
        """Whether a motion as fast as `enough` is known."""
        return self.best is not None and self.best.motion.duration <= self._enough

    def _is_optimal(self) -> bool:
        """Whether no motion can be better by more than `LEAST_GAIN`, or one is as fast as `enough`."""
        if self._is_enough() or self._is_least:
            return True
        if self.best is None or not self._problem.objective.is_time or self._hurried:
            return False
        return self.best.motion.duration <= (1.0 + LEAST_GAIN) * self._least_time()

    def _is_open(self, index: int) -> bool:
        """Whether a motion to this posture can still be better than the best."""
        if self.best is None or not self._problem.objective.is_time:
            return True
        worth = 1.0 + LEAST_GAIN if holds_end(self._problem, self._ends.goals[index]) else 1.0 - _END_GAIN
        return self.best.motion.duration > worth * self._ends.least[index]
