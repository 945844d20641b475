"""A search for the best motion to a goal from many starts, each optimised by a descent.

The starts are straight lines in joint space to the nearest postures on a goal, clear or not, then a sampled route,
then different routes through roadmaps, made of configurations through which a motion can be shorter than the best,
or much shorter. Every motion that counts is proven clear.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import travel_within
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.goals.optimality_gap import OptimalityGap
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.motion_descents import FINE_ROUNDS, MotionDescents
from backhoe_planner.planning.multistart.straight_lines import StraightLines
from backhoe_planner.planning.multistart.ways import Ways
from backhoe_planner.planning.search.effort import OutOfTime
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.search.roadmap import Price
from backhoe_planner.planning.search.way_price import price_of
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_PLACES = 25  # of a known motion, given to a roadmap; chosen, about every 2 to 10 cm of the tip
_DEAREST = 1.6  # times the best cost: the highest price of a route through a roadmap; chosen
_MANY_NODES = 3_600  # at least so many in a roadmap after one that gained nothing; chosen
_FEWEST_WAYS = 2  # tries to sample a first route before the search gives up
_VAIN = 2  # a search that found no route at all counts as so many that gained nothing; chosen
_ELSEWHERE = 0.3  # s of joint time between two ends that count as different; chosen
_GAIN = 0.005  # part of the cost that counts as a gain


class MotionSearch(ABC):
    """A search from one start.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    found: postures on the goals.
    incumbent: takes the motions.
    time: at which the positions of the obstacles are taken [s].
    more: times the usual starting points, if more postures are looked for.

    Attributes
    ----------
    ends: the postures on the goals that are known.
    """

    _descents: MotionDescents

    def __init__(
        self, world: World, start: Vector, found: GoalPostures, incumbent: Incumbent, *, time: float, more: int
    ) -> None:  # fmt: skip
        self._world, self._start, self._time, self._more = world, start, time, more
        self._problem, self._hurried = world.problem, world.work.effort.is_hurried
        self._incumbent = incumbent
        self._screen = ClearanceScreen(world.proximity, time=time)
        self.ends = GoalEnds(world.problem, start)
        self.ends.take(found.clear, found.goals)
        self._lines = StraightLines(start, self.ends, self._screen, pieces=world.work.effort.pieces)
        self._ways = Ways(world, start, self.ends, time=time, hurried=self._hurried)
        self._gap = OptimalityGap(world, start, self.ends, incumbent)
        keep = world.problem.keep
        self._has_roadmaps = keep is None or not keep.cones
        self._looked_within = np.inf  # s: the last search for further postures was for those within this time

    @property
    def best(self) -> FoundMotion | None:
        """The best motion so far."""
        return self._incumbent.best

    @property
    def ended(self) -> list[FoundMotion]:
        """The motions at which descents ended, some of them not proven."""
        return self._descents.ended

    @property
    def looked_at(self) -> int:
        """How many motions were checked in samplings that found no route."""
        return self._ways.looked_at

    @property
    def routes(self) -> int:
        """How many routes were found by sampling."""
        return len(self._ways.reached)

    def run(self) -> str:
        """Search until the effort is used up or nothing is gained; the result is `best`.

        Returns
        -------
        Empty, or that time ran out, in words.
        """
        try:
            self._search()
        except OutOfTime as ended:
            return str(ended)
        return ""

    @abstractmethod
    def _search(self) -> None:
        """All steps of the search.

        Raises
        ------
        OutOfTime: the budget is used up.
        """

    # --- straight lines ---------------------------------------------------------------

    def _go_straight(self) -> None:
        """Descents from straight lines to the soonest postures, then, unless in a hurry, to more that are found."""
        self._descend_from_lines(self._lines.least_blocked() if self._hurried else self.ends.order)
        if not self._hurried and not self._is_enough():
            self._descend_from_lines(self._look_for_postures(None if self.best is None else self.best.motion.duration))

    def _descend_from_lines(self, order: Sequence[int]) -> None:
        """Descents from lines to the first postures of `order`, until one descent does not get clear."""
        work = self._world.work
        self._descents.rounds.reserve(work.descent_rounds // 2)
        for index in order[: work.effort.ways_at_once]:
            if self._is_optimal():
                return
            if not self._is_open(index):
                continue
            if not self._descents.descend(self._lines.to(index)):
                return

    def _look_for_postures(self, within: float | None) -> list[int]:
        """Look for more postures, within a time [s] or anywhere; the indices of the new ones, the soonest first."""
        self._looked_within = np.inf if within is None else within
        found = find_goal_postures(
            self._world, self._problem.goals, near=self._start, time=self._time, more=self._more,
            travel=None if within is None else travel_within(within, self._problem.limits),
        )  # fmt: skip
        return [] if isinstance(found, Outcome) else self.ends.take(found.clear, found.goals)

    # --- routes -----------------------------------------------------------------------

    def _go_round(self, turn: int) -> None:
        """Descents from a sampled route, then from further routes, until several turns in a row gain nothing.

        Parameters
        ----------
        turn: how many times routes were sampled before, by another search from the same start.
        """
        work, dull = self._world.work, 0
        turn = self._find_way(turn)
        work.add_rounds("way_rounds")
        while self.best is not None and dull < self._patience() and not self._is_optimal():
            if self._descents.rounds.left <= 0:
                return
            before = self.best.cost
            found = self._try_routes(turn, dull)
            turn += 1
            gained = self.best.cost < (1.0 - _GAIN) * before
            dull = 0 if gained else dull + (1 if found or self._has_roadmaps else _VAIN)

    def _find_way(self, turn: int) -> int:
        """Descents from sampled routes, unless or until a motion is known or the search gives up; the next turn."""
        effort = self._world.work.effort
        self._descents.rounds.reserve(FINE_ROUNDS if effort.descent_rounds > 2 * FINE_ROUNDS else 0)
        while self.best is None and self._ways.may_sample and turn < max(effort.ways_at_once, _FEWEST_WAYS):
            self._follow(self._sampled(turn))
            turn += 1
        return turn

    def _try_routes(self, turn: int, dull: int) -> bool:
        """Descents from routes, after some vain turns in a row; whether there are any routes."""
        return self._follow(self._mapped(turn, dull) if self._has_roadmaps else self._sampled(turn))

    def _follow(self, ways: Iterable[FoundMotion]) -> bool:
        """Descents from the routes that are worth one, one after the other; whether there are any routes."""
        found = False
        for way in ways:
            found = True
            if self.best is not None and (way.cost > self._gap.dearest_worth() or self._is_optimal()):
                continue
            if not self._hurried:
                self._incumbent.offer(way)
            if not self._descents.descend_if_new(way):
                continue
            if self._hurried:  # if the descent got clear, the route itself need not be proven
                self._incumbent.offer(way)
        return found

    def _sampled(self, turn: int) -> Iterator[FoundMotion]:
        """Motions along sampled routes to postures that can still give a better motion."""
        ways = self._world.work.effort.ways_at_once
        for number in (turn,) if self.best is None else range(ways * turn, ways * (turn + 1)):
            which = [index for index in self.ends.order if self._is_open(index)]
            if number % 2:
                which = self._elsewhere(which) or which
            way = self._ways.sample(which, number, again=0 if self.best is None else 1) if which else None
            if way is not None:
                yield way

    def _elsewhere(self, ends: Sequence[int]) -> list[int]:
        """Those of the postures `ends` that are far from the ends of sampled routes and descents."""
        ended = np.array([*self._ways.reached, *(one.motion.q[-1] for one in self.ended)])
        rate = self._problem.limits.velocity
        return [
            index
            for index in ends
            if not len(ended) or np.min(np.max(np.abs(self.ends.postures[index] - ended) / rate, axis=1)) > _ELSEWHERE
        ]

    def _mapped(self, turn: int, dull: int) -> Iterator[FoundMotion]:
        """Motions along different routes through a roadmap, which are mostly much shorter than the best motion."""
        longest, nodes = self._gap.longest_worth(dull), self._world.work.effort.nodes
        if longest != self._looked_within:
            self._look_for_postures(longest)
        return self._through_roadmap(turn, longest=longest, nodes=max(nodes, _MANY_NODES) if dull else nodes)

    def _through_roadmap(
        self, turn: int, *, longest: float, nodes: int, prices_alone: bool = False
    ) -> Iterator[FoundMotion]:  # fmt: skip
        """Motions along different routes through a roadmap, away from the known motions.

        Parameters
        ----------
        longest: estimated time of a route [s].
        nodes: of the roadmap.
        prices_alone: whether the price of a route counts in comparison with the price of the best, not with its cost.
        """
        assert self.best is not None
        which = [index for index in self.ends.order if self._is_open(index) and self.ends.least[index] < longest]
        if not which:
            return
        known = [
            one.motion.at(np.linspace(0.0, one.motion.duration, _PLACES)) for one in (*self.ended, self.best)
        ]  # fmt: skip
        price: Price = price_of(self._problem, self.best.motion, longest)
        own = self.best.cost
        if prices_alone:
            own = max(own, float(np.sum(price(known[-1][:-1], known[-1][1:]))))
        found = self._ways.through_roadmap(
            which, turn, nodes=nodes, longest=longest, price=price, known=known, dearest=_DEAREST * own
        )
        yield from itertools.islice(found, 2 * self._world.work.effort.ways_at_once)

    # --- what is enough ---------------------------------------------------------------

    def _is_enough(self) -> bool:
        """Whether the best is so good that nothing else is tried."""
        return False

    @abstractmethod
    def _is_optimal(self) -> bool:
        """Whether no motion can be better by much."""

    @abstractmethod
    def _is_open(self, index: int) -> bool:
        """Whether a motion to this posture can still be better than the best."""

    @abstractmethod
    def _patience(self) -> int:
        """How many turns in a row may gain nothing."""
