"""The search for a motion to a goal that costs least, if the cost is not the time.

It begins with descents from fast motions and from straight lines, or with what descents without obstacles make of
lines to many more postures, see `free_starts`. If these show that a motion around an obstacle may cost less, routes
follow, and the best of them is led to other postures. What the best becomes on finer curves is the result.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import motion_cost
from backhoe_planner.planning.descent.descent_of_cost import NO_COST
from backhoe_planner.planning.goals.fast_motions import fast_motions, in_least_time, time_allowed
from backhoe_planner.planning.goals.goal_postures import GoalPostures
from backhoe_planner.planning.goals.motion_search import MotionSearch
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.free_starts import LINES_FOR_ONE, alike, free_starts
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.lift import is_frugal, lift_of, little_cost
from backhoe_planner.planning.multistart.line_starts import line_starts
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices
from backhoe_planner.planning.refining.refining import Refining
from backhoe_planner.planning.world.world import World

# times the cost of the cheapest blocked start, from which there is more patience, and its factor
_PATIENCE_ROUND = ((2.0, 3), (1.3, 2))
# times the usual starting points, if more postures are looked for: the cost depends mostly on the end; measured
_MORE_FOR_COST = 12
_MORE_FREELY = 36  # the same for a search that begins with descents without obstacles; chosen
_SIDES = 2  # sampled detours for a start that is blocked, which may pass it on different sides; chosen
# starts of a search that begins with descents without obstacles, for each of `Effort.ways_at_once`; chosen
_STARTS_FOR_ONE = 2.5
# a way that is led to other postures: for each of `Effort.ways_at_once`, how many of these ways get a few rounds; the
# part of the cost that they must gain for the best to be led on, and how many times at most; chosen
_LED_FOR_ONE, _LED_GAIN, _LED_AT_MOST = 2, 0.03, 3
# times the least cost that an earlier search had before refining, up to which a motion is refined; chosen
_REFINED, _REFINED_FRUGAL = 1.3, 1.0  # the second for frugal searches; chosen
_PAYS = 0.15  # part of the cost: gaining more by refining is much; chosen
_THE_SAME = 1e-6  # part of the cost by which two searches differ that have found the same motion; chosen


class CostSearch(MotionSearch):
    """A search for the least cost from one start.

    Parameters
    ----------
    longest: the longest time that a motion may take [s]; if infinite, the search finds it with its first motion.
    before: an earlier search from the same start among the same obstacles, which has ended and is continued here with
        other random choices: the same longest time holds, and only better motions count.
    freely: whether to begin with what descents without obstacles make of lines to many more postures, and without a
        search for a fast motion; only if `longest` is finite.
    earlier: other searches from the same start among the same obstacles, which have ended: what they have tried is not
        tried again.

    Attributes
    ----------
    repeats: whether the search would begin only where an earlier one began, or where nothing promises a cheaper motion,
        or refine what an earlier one refined, and was ended therefore.
    fast: the fastest motion with which the search began, proven clear; None if there is none.
    """

    _descents: CostDescents
    _refining: Refining

    def __init__(
        self, world: World, start: Vector, found: GoalPostures, *, time: float, longest: float = np.inf,
        before: CostSearch | None = None, freely: bool = False, earlier: Sequence[CostSearch] = (),
    ) -> None:  # fmt: skip
        incumbent = Incumbent(
            world, time=time, longest=longest if before is None else before._incumbent.longest,
            best=None if before is None else before._refining.before or before.best,
        )  # fmt: skip
        more = _MORE_FREELY if freely else _MORE_FOR_COST
        super().__init__(world, start, found, incumbent, time=time, more=more)
        self._freely = freely
        self._goes_on = before is not None
        self._begin_descents(None if before is None else before._descents)
        self._lift, self._little, self._is_frugal = lift_of(world.problem), little_cost(world), is_frugal(world)
        # what a search found on its way round obstacles depends on its random choices, not on where it began
        self._tried = [curve for one in earlier if not one.leads_round for curve in one._descents.begun]
        self._refined = [one._refining.cost_before for one in earlier]
        if self._is_frugal:  # the cheapest starts of earlier searches are not tried again
            self._descents.know_of(one._descents for one in earlier)
        self.repeats = False
        self.fast: FoundMotion | None = None
        self._for_time = (0, 0)  # motions looked at, and routes found, by searches for a fast motion

    def _begin_descents(self, before: CostDescents | None = None) -> None:
        """Set the descents of this search, and those that refine the best; `before` of one that is continued here."""
        self._descents = CostDescents(self._world, self._start, self._incumbent, time=self._time, before=before)
        self._refining = Refining(self._world, self._descents)

    def _search(self) -> None:
        turn = 1  # the search for the fastest had the first routes
        if self._freely:
            self._go_freely()
        else:
            ended = [] if self._goes_on else self._find_fast()
            if self.allowed_time is None:
                turn = self._find_any(turn)
                ended += [] if self.best is None else [self.best]
            if self.allowed_time is not None:
                self._go_fast(ended, self.allowed_time)
        if self.repeats:
            return
        if self.leads_round or (self.best is None and not self._freely):
            self._go_round(turn)
            self._lead_elsewhere()
        if self._is_worth_refining():
            self.repeats = self._is_refined_already()
            if not self.repeats:
                self._refining.run()

    @property
    def looked_at(self) -> int:
        """How many motions were checked in samplings that found no route, for a fast motion too."""
        return super().looked_at + self._for_time[0]

    @property
    def routes(self) -> int:
        """How many routes were found by sampling, for a fast motion too."""
        return super().routes + self._for_time[1]

    @property
    def postures(self) -> int:
        """How many postures on the goals are known."""
        return len(self.ends.postures)

    @property
    def rounds(self) -> int:
        """How many rounds its descents have made, without those for a fast motion and those that refine the best."""
        return self._refining.rounds_before

    @property
    def refining_paid(self) -> bool:
        """Whether refining took much of its cost from the best: then it may have taken more from another motion."""
        return self._refining.gained > _PAYS

    @property
    def allowed_time(self) -> float | None:
        """How long a motion may take [s]; None if no motion is known that says so."""
        return self._incumbent.longest if np.isfinite(self._incumbent.longest) else None

    @property
    def leads_round(self) -> bool:
        """Whether the best motion goes around an obstacle, or may cost more than one that does."""
        return self.best is not None and not self._is_optimal() and not self._descents.goes_straight(self.best)

    # --- starts -----------------------------------------------------------------------

    def _go_fast(self, ended: Sequence[FoundMotion], longest: float) -> None:
        """Descents from the motions `ended`, and from lines to many postures that are reached within `longest` [s]."""
        work = self._world.work
        if not self._hurried:
            self._look_for_postures(within=longest)
        self._descents.rounds.reserve(work.descent_rounds // 3)
        prices = self._descents.prices(self._screen)
        lines = [] if self._hurried else self._lines.within(longest)
        known = [self._descents.fitted(one) for one in ended]
        begun = [*self._descents.begun, *(self._tried if self._is_frugal else ())]
        self._descend_unless_tried(
            prices, line_starts(lines, known, prices, ways=work.effort.ways_at_once, begun=begun)
        )  # fmt: skip

    def _go_freely(self) -> None:
        """Descents from where descents without obstacles end, which begin at lines to many more postures."""
        work, longest = self._world.work, self._incumbent.longest
        self._look_for_postures(within=longest)
        self._descents.rounds.reserve(work.descent_rounds // 3)
        (own, prices), ways = self._by_mass(), work.effort.ways_at_once
        lines = self._lines.many_within(longest, most=LINES_FOR_ONE * ways, alike=own)
        starts = free_starts(self._problem, lines, prices, longest=longest, ways=ways)
        self._descend_unless_tried(prices, prices.spaced(starts, round(_STARTS_FOR_ONE * ways), known=self._tried))

    def _by_mass(self) -> tuple[Vector, StartPrices]:
        """(n,) moves of the joints that count alike, see `alike`, and prices of starts whose distances count so."""
        own = alike(self._problem, np.vstack((self._start, *self.ends.postures)))
        return own, self._descents.prices(self._screen, alike=own)

    def _descend_unless_tried(self, prices: StartPrices, chosen: Sequence[PricedStart]) -> None:
        """Descents from the `chosen` starts, unless earlier searches began with all of them."""
        self.repeats = bool(self._tried) and all(prices.repeats(one, self._tried) for one in chosen)
        if not self.repeats:
            self._descents.descend_cheapest(chosen)
            self.repeats = self._descents.falls_short

    def _find_fast(self) -> list[FoundMotion]:
        """Motions at which searches for a fast one ended; sets how long a motion may take, and offers the fastest.

        How long that is stays infinite if no search finds a proven motion.
        """
        ended: list[FoundMotion] = []
        for found in fast_motions(self._world, self._start, time=self._time, allowed=self.allowed_time):
            looked_at, routes = self._for_time
            self._for_time = looked_at + found.looked_at, routes + found.routes
            self.ends.take(found.postures, found.goals)
            ended += found.ended
            if found.fastest is not None:
                ended.append(found.fastest)
                self._incumbent.longest = min(self._incumbent.longest, found.allowed_time)
                fast = replace(found.fastest, cost=motion_cost(self._problem, found.fastest.motion))
                self._incumbent.offer(fast)
                if self.fast is None or fast.motion.duration < self.fast.motion.duration:
                    self.fast = fast
        return ended

    def _find_any(self, turn: int) -> int:
        """Descents from lines and routes until a motion is proven, where no fast one was; the next turn of routes.

        As for a fast one, its duration says how long a motion may take; if it takes longer, so does the fastest along
        its curve, which replaces it.
        """
        self._go_straight()
        turn = self._find_way(turn)
        if self.best is not None:
            found, incumbent = self.best, self._incumbent
            for one in (in_least_time(found, self._problem), found):
                incumbent.longest = time_allowed(self._world, self._start, one.motion.duration, time=self._time)
                if incumbent.offer(one):
                    break
            # what descents without a longest time ended at is no longer to be compared with
            self._begin_descents()
        return turn

    # --- routes -----------------------------------------------------------------------

    def _try_routes(self, turn: int, dull: int) -> bool:
        """See `MotionSearch`; every other turn uses sampled routes, and the first ones lead around blocked starts.

        The cost of a route says little about the result of a descent, and sampled routes differ more from each other
        than the cheapest through roadmaps.
        """
        self._go_around(turn)
        is_sampled = turn % 2 == 1 or not self._has_roadmaps
        return self._follow(self._sampled(turn) if is_sampled else self._mapped(turn, dull))

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

    def _lead_elsewhere(self) -> None:
        """Descents from the best way around an obstacle, led to other postures, until they gain little.

        Straight lines to these postures are blocked, and a sampled route seldom leads to the best of them.
        """
        work, longest = self._world.work, self.allowed_time
        if longest is None or not work.led_rounds:
            return
        work.add_rounds("led_rounds")
        (own, prices), ways = self._by_mass(), work.effort.ways_at_once
        which = self.ends.many_within(longest, most=LINES_FOR_ONE * ways, alike=own)
        for _ in range(_LED_AT_MOST):
            best = self.best
            if best is None or best.curve is None or not self._incumbent.has_improved or not self.leads_round:
                return
            led = [
                Start(best.curve.ending_at(self.ends.postures[index]), longest, self.ends.goals[index], best.way)
                for index in which
            ]
            chosen = prices.spaced(prices.fair(prices.in_order(led)), _LED_FOR_ONE * ways, known=[best.curve])
            if chosen:
                self._descents.descend_cheapest(chosen)
            if self.best is None or self.best.cost > (1.0 - _LED_GAIN) * best.cost:
                return

    def _follow(self, ways: Iterable[FoundMotion]) -> bool:
        """Descents from the cheapest routes, by their first rounds; whether there are any routes."""
        if self.allowed_time is None:
            return super()._follow(ways)
        ways = list(ways)
        for way in ways:
            self._incumbent.offer(way)
        prices = self._descents.prices(self._screen)
        priced = prices.in_order([self._descents.fitted(way) for way in ways])
        self._descents.descend_cheapest(prices.cheapest(priced, len(ways)))
        return bool(ways)

    def _mapped(self, turn: int, dull: int) -> Iterator[FoundMotion]:
        """Motions along different routes through a roadmap, which take as long as a motion may."""
        # compare prices with prices: a descent makes a route several times cheaper
        nodes, longest = self._world.work.effort.nodes, self._incumbent.longest
        return self._through_roadmap(turn, longest=longest, nodes=nodes, prices_alone=True)

    # --- what is enough ---------------------------------------------------------------

    def _is_optimal(self) -> bool:
        """Whether the best costs nothing or little, or little more than the lift to the lowest posture."""
        if self.best is None or self.best.cost <= self._little:
            return self.best is not None
        if self._lift is None:
            return self.best.cost <= NO_COST
        return self._lift.is_near(self.best.cost, self._start, self.ends.postures)

    def _is_open(self, index: int) -> bool:
        """Always: how soon a posture is reached says nothing about the cost."""
        return True

    def _patience(self) -> int:
        """More if a blocked start was much cheaper than the best is."""
        usual = self._world.work.effort.dull_searches
        if self._hurried:
            return 0
        if not self._incumbent.has_improved:
            return usual
        best = np.inf if self.best is None else self.best.cost
        return usual * next((factor for part, factor in _PATIENCE_ROUND if best > part * self._descents.blocked), 1)

    def _is_worth_refining(self) -> bool:
        """Whether the best was found by this search, costs something, and not much more than that of an earlier one."""
        if self.best is None or not self._incumbent.has_improved or self.best.cost <= NO_COST:
            return False
        most = _REFINED_FRUGAL if self._is_frugal else _REFINED
        return self._refining.cost_before <= most * min(self._refined, default=np.inf)

    def _is_refined_already(self) -> bool:
        """Whether an earlier search found what this one has found, before refining."""
        cost = self._refining.cost_before
        return any(abs(cost - one) <= _THE_SAME * cost for one in self._refined)
