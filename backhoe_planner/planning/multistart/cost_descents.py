"""Descents to motions of little cost, if that is not the time.

A few rounds of each start show which of them are worth a whole descent.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import ENOUGH, ENOUGH_ROUGH, Options, Timed
from backhoe_planner.planning.descent.descent_of_cost import DescentOfCost
from backhoe_planner.planning.descent.looks import KEPT_PART
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.multistart.counted_rounds import CountedRounds
from backhoe_planner.planning.multistart.first_rounds import Field, GivesUp, after_first_rounds
from backhoe_planner.planning.multistart.free_starts import alike
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.lift import is_frugal, little_cost
from backhoe_planner.planning.multistart.motion_descents import (
    FAR_OFF,
    FIRST_BOX,
    FURTHER_OFF,
    NEARLY,
    SPARE,
    MotionDescents,
)
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices
from backhoe_planner.planning.multistart.straight_lines import STRAIGHT
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

# of a straight line in its first rounds; twice as many rounds are made then, and three of them take as long as one on
# a curve of 12 pieces. On an open site of the Panda the rank correlation of the costs after the first rounds and at
# the end is 0.60 with 6 rounds on 6 pieces, in 75 ms, and 0.20 with 3 rounds on 12 pieces, in 116 ms
_COARSE_PIECES, _COARSE_FOR_ONE, _COARSE_IN_ONE = 6, 2, 3
_ROUNDS_IN_ONE = 3  # rounds for another cost that count as one for the time, as no curve is timed in them; measured
_SOFTENED = 2  # times more rounds for a cost that jumps, which is softened ever less in turn; measured
_MORE_ROUNDS = 80  # of a descent at most; the cost keeps falling for longer than the time; chosen
# rounds after which it is checked whether a descent goes where another one has ended, and the factor on the other's
# cost in the comparison; chosen: in a round the cost counts some percent too little, because kinks are rounded off
_LATER_LOOKS, _NO_LESS = (8, 16), 0.97
_SOON = 4  # rounds before the first such check if an earlier search is continued; chosen
# rounds after which a descent is judged by its cost, and times the best cost: hopeless then; chosen
_TRIED_LONGER, _MUCH_DEARER = 12, 1.5
_WAYS_FOR_ONE = 2  # one descent runs to its end for so many of `Effort.ways_at_once`; measured
_WORTH_ROUNDS = 2.0  # times the least cost after the first rounds, up to which a start gets all rounds; chosen
# times the least cost after the first rounds of other searches, that a start must not exceed after its own; chosen: one
# at 1.006 times it became a motion that costs a tenth less, of those above 1.01 none did
_NO_DEARER = 1.02
# part of the longest time: joint time between two ends that count as different, of which joints that move little mass
# have little, see `alike`; chosen
_ELSEWHERE = 0.15


class CostDescents(MotionDescents):
    """Descents for another cost than the time.

    Parameters
    ----------
    before: those of an earlier search from the same start among the same obstacles, which is continued here: what they
        know is known.

    Attributes
    ----------
    more: factor on the rounds of each descent, because the cost jumps.
    blocked, early: the cost after the first rounds of the cheapest start that stays in an obstacle, and of the
        cheapest one that gets clear; infinite if there is none.
    falls_short: whether all starts cost more after their first rounds than the cheapest of other searches, and none
        descended further therefore, see `know_of`.
    """

    def __init__(
        self, world: World, start: Vector, incumbent: Incumbent, *, time: float, before: CostDescents | None = None
    ) -> None:  # fmt: skip
        self._descent = DescentOfCost(
            world.problem, world.proximity, world.kinematics, time=time, brake=world.work.brake,
            hurried=world.work.effort.is_hurried,
        )  # fmt: skip
        self.more = _SOFTENED if world.problem.objective.jumps else 1
        rounds = CountedRounds(world.work, self._descent, in_one=_ROUNDS_IN_ONE * self.more)
        super().__init__(
            world, start, incumbent, rounds, time=time, most_rounds=_MORE_ROUNDS * self.more,
            looks=_LATER_LOOKS if before is None else (_SOON, *_LATER_LOOKS), no_less=_NO_LESS,
            uses_reserve=world.work.effort.is_hurried,  # in a hurry no descent follows
        )  # fmt: skip
        self._is_frugal, self._little = is_frugal(world), little_cost(world)
        self._begun: list[JointCurve] = []
        self.blocked = self.early = self._to_beat = np.inf
        self.falls_short = False
        if before is not None:
            self._known, self._begun, self.ended = before._known, list(before._begun), list(before.ended)
            self.blocked, self.early = before.blocked, before.early

    def know_of(self, others: Iterable[CostDescents]) -> None:
        """Take the costs of starts after their first rounds from other searches too, see `early` and `falls_short`."""
        for other in others:
            self.early, self.blocked = min(self.early, other.early), min(self.blocked, other.blocked)
        self._to_beat = self.early

    def prices(self, screen: ClearanceScreen, *, alike: Vector | None = None) -> StartPrices:
        """The prices of starts among the obstacles of `screen`; for `alike` see `StartPrices`."""
        return StartPrices(self._descent, screen, longest=self.incumbent.longest, alike=alike)

    @property
    def own_time(self) -> OwnTime:
        """Computes the cost of curves, as at the end of a descent."""
        return self._descent.own_time.looked_at(fine=True)

    @property
    def begun(self) -> tuple[JointCurve, ...]:
        """The starting curves of the descents in `descend_cheapest`."""
        return tuple(self._begun)

    def take_blocked(self) -> list[tuple[float, Start]]:
        """The starts that stayed in an obstacle since the last call, as far as they were bent; the cheapest first."""
        found, self._left_blocked = sorted(self._left_blocked, key=lambda one: one[0]), []
        return found

    def goes_straight(self, found: FoundMotion) -> bool:
        """Whether this motion came from a straight line: it goes around nothing.

        False if a blocked start was cheaper after its first rounds, or none got clear: then a detour may be cheaper.
        """
        return found.curve is not None and found.way == STRAIGHT and self.early <= self.blocked

    def descend_cheapest(self, chosen: Sequence[PricedStart]) -> None:
        """A few rounds of descents from these starts, then all rounds of the best of them.

        One more descent leads to another end, as costs after the first rounds say little about those of other postures.
        """
        self._begun += [one.start.curve for one in chosen]
        if len(chosen) == 1:
            start = chosen[0].start
            self.descend(replace(start, duration=max(start.duration, self.incumbent.longest)))
            return
        far_off = FURTHER_OFF if self.best is None else FAR_OFF
        ways, is_clear, before = self._effort.ways_at_once, False, len(self.ended)
        found = after_first_rounds(
            (one.start for one in chosen), self._few_rounds, far_off=far_off, pushed=ways // _WAYS_FOR_ONE,
            field=Field(self._little) if self._is_frugal else None,
        )  # fmt: skip
        self.blocked = min(self.blocked, found.least_blocked)
        self._left_blocked += found.blocked
        tried = found.clear
        least = tried[0][0] if tried else np.inf
        self.falls_short = least > _NO_DEARER * self._to_beat and self.early <= self.blocked
        if self.falls_short:
            return
        self._to_beat = np.inf  # ways that are sampled later are found by chance, and need not be cheaper at first
        descended: list[Start] = []
        for index, (cost, start) in enumerate(tried):
            if is_clear and (index >= ways or cost > _WORTH_ROUNDS * least):
                break
            descended.append(start)
            is_clear |= self._descend_judged(cost, start)
            # a descent that goes where another one ended adds none
            if len(self.ended) - before >= ways / _WAYS_FOR_ONE:
                break
        if is_clear and not self._effort.is_hurried:
            self._descend_elsewhere(tried, descended)

    def _descend_judged(self, cost: float, start: Start) -> bool:
        """A descent from a start that had a cost after its first rounds; whether it got clear."""
        is_clear = self.descend(start)
        if is_clear:
            self.early = min(self.early, cost)
        else:
            self.blocked = min(self.blocked, cost)
        return is_clear

    def _descend_elsewhere(self, tried: Sequence[tuple[float, Start]], descended: Sequence[Start]) -> None:
        """A descent from the cheapest start whose end is far from those of all other descents, if it is worth one.

        Parameters
        ----------
        tried: starts after their first rounds, with their costs, the cheapest first.
        descended: those of them from which descents have begun.
        """
        ends = np.array([*(start.curve.control[-1] for start in descended), *(one.motion.q[-1] for one in self.ended)])
        own = alike(self._problem, np.array([start.curve.control[-1] for _, start in tried]))
        apart = _ELSEWHERE * self.incumbent.longest
        for cost, start in tried:
            if cost > _WORTH_ROUNDS * tried[0][0]:
                return
            if np.min(np.max(np.abs(ends - start.curve.control[-1]) / own, axis=1)) > apart:
                self._descend_judged(cost, start)
                return

    def bent_coarsely(self, start: Start) -> Start:
        """The start after a whole descent on a coarse curve, which goes on on its own pieces."""
        options = Options(
            self._most_rounds, SPARE, density=1, box=FIRST_BOX, is_hopeless=partial(self._is_hopeless, looks=()),
            longest=self._longest(start.duration), unsampled=True, enough=ENOUGH_ROUGH,
        )  # fmt: skip
        found = self._run_coarsely(start, start.duration, options)
        return start if found is None else replace(start, curve=found.curve)

    def _few_rounds(
        self, start: Start, rounds: int, *, gives_up: GivesUp, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        """See `FewRounds`; of a straight line on a coarse curve, so that the same time shows more of its result."""
        in_a_hurry = self._effort.is_hurried
        coarse = start.way == STRAIGHT and start.curve.pieces > _COARSE_PIECES and not clear_first and not in_a_hurry
        for_one = _COARSE_FOR_ONE if coarse else 1

        def is_over(here: Timed, rounds: int) -> bool:
            return (clear_first and here.missed <= KEPT_PART * SPARE) or gives_up(here, rounds / for_one)

        duration = max(start.duration, self.incumbent.longest)
        options = Options(
            for_one * rounds, SPARE, density, FIRST_BOX, is_over, longest=self._longest(duration), unsampled=True,
            clear_first=clear_first, enough=ENOUGH_ROUGH if coarse and self._is_frugal else ENOUGH,
        )  # fmt: skip
        if coarse:
            return self._run_coarsely(start, duration, options)
        return self.rounds.run(start.curve, duration, start.goal, options)

    def _run_coarsely(self, start: Start, duration: float, options: Options) -> Timed | None:
        """A descent from a start on a coarse curve; its result has the curve on the pieces of the start."""
        limits = self._problem.limits
        coarse = start.curve.divided_evenly(_COARSE_PIECES, limits)
        found = self.rounds.run(coarse, duration, start.goal, options, coarse_in_one=_COARSE_IN_ONE)
        return None if found is None else replace(found, curve=found.curve.divided_evenly(start.curve.pieces, limits))

    def _falls_behind(self, here: Timed, rounds: int, best: FoundMotion) -> bool:
        if rounds < _TRIED_LONGER:
            return here.missed > FAR_OFF
        return here.missed > NEARLY or here.cost > _MUCH_DEARER * best.cost

    def _least_worth(self, curve: JointCurve, goal: Goal) -> float:
        return 0.0

    def _even_curve(self, found: Timed) -> JointCurve:
        return found.curve
