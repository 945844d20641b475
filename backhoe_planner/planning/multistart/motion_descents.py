"""Descents from the starts of one search to their ends, each to a motion that is proven clear."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import ENOUGH, ENOUGH_ROUGH, Options, Timed
from backhoe_planner.planning.descent.looks import KEPT_PART
from backhoe_planner.planning.multistart.alike import KnownCurves
from backhoe_planner.planning.multistart.counted_rounds import CountedRounds
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.search.sampled_check import SampledCheck
from backhoe_planner.planning.world.world import World

SPARE = 0.003  # m that a descent keeps beyond every clearance at the places that it checks
_MORE_SPARE = 0.002  # m that it keeps in addition after its motion could not be proven
_PROOFS = 3  # tries to prove one motion, each with more spare and twice as many places; chosen
_FEW_ROUNDS = 4  # of a descent that is continued
FIRST_BOX = 0.25  # rad or m of the fastest joint that the first step may move a control point; chosen
SMALL_BOX = 0.1  # the same for a descent that is continued
FINE_PIECES = 20  # of the best curve at the end
FINE_ROUNDS = 6  # of the best curve at the end
_SLOWER = 1.5  # times the duration of a start, that a descent from it may take while no longest time is known; chosen
_TRIED = 4  # rounds after which a descent is judged
FAR_OFF = 0.06  # m by which a clearance is missed then: hopeless if another motion is known; chosen
FURTHER_OFF = 0.1  # m: the same if none is known; chosen
_PLACES_PER_PIECE = 16  # at which a curve is checked that is proven later; chosen
NEARLY = 0.02  # m that a curve may miss at the end of a descent, which is then continued


class MotionDescents(ABC):
    """Descents from one start, with the work of one world.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    incumbent: takes the motions.
    rounds: makes and counts the rounds.
    time: at which the positions of the obstacles are taken [s].
    most_rounds: of one descent.
    looks: rounds after which it is checked whether a descent goes where another one has ended.
    no_less: factor on the other's cost in that comparison.
    uses_reserve: whether a descent that is continued may use all rounds that are left, because none follows.

    Attributes
    ----------
    ended: the motions at which descents ended, some of them not proven.
    """

    def __init__(
        self, world: World, start: Vector, incumbent: Incumbent, rounds: CountedRounds, *, time: float,
        most_rounds: int, looks: tuple[int, ...], no_less: float = 1.0, uses_reserve: bool = False,
    ) -> None:  # fmt: skip
        self._problem, self._effort = world.problem, world.work.effort
        self.incumbent, self.rounds = incumbent, rounds
        self._most_rounds, self._uses_reserve = most_rounds, uses_reserve
        self._looks, self._no_less = looks, no_less
        self._make_check = partial(
            SampledCheck, world.problem, world.proximity, [start], spare=0.0, time=time, brake=world.work.brake
        )  # fmt: skip
        self._known = KnownCurves(world.problem.limits, lambda: self._check)
        self._tried = self._known.anew()  # routes from which descents began
        self._left_blocked: list[tuple[float, Start]] = []  # starts that stayed in an obstacle, with their costs
        self.ended: list[FoundMotion] = []

    @cached_property
    def _check(self) -> SampledCheck:
        return self._make_check()

    @property
    def best(self) -> FoundMotion | None:
        """The best motion so far."""
        return self.incumbent.best

    def keeps(self, curve: JointCurve) -> bool:
        """Whether a curve keeps all clearances and `keep` at places close to each other, which is not a proof.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        q = curve.at(np.linspace(0.0, 1.0, _PLACES_PER_PIECE * curve.pieces + 1))
        self._check.proximity.cover_unchecked(q)
        return bool(self._check.keeps(q).all())

    def fitted(self, found: FoundMotion) -> Start:
        """The start whose curve is nearest to a motion."""
        curve = JointCurve.fitted(found.motion, self._effort.pieces, self._problem.limits)
        return Start(curve, found.motion.duration, found.goal, found.way)

    def descend_if_new(self, way: FoundMotion) -> bool:
        """Run `descend` from a route, unless a descent has begun from a similar one; whether it was run."""
        start = self.fitted(way)
        if self._tried.least_alike(start.curve) < np.inf:
            return False
        self._tried.add(start.curve, way.cost)
        self.descend(start)
        return True

    def descend(self, start: Start, *, hops: bool = False) -> bool:
        """Run a descent from a start, and keep its motion if it is proven and better; whether it got clear.

        Parameters
        ----------
        hops: whether the start is beside a motion at which another descent ended. It is then not given up for going the
            same way.
        """
        curve, duration, goal = start.curve, start.duration, start.goal
        rounds, box, spare, density = self._most_rounds, FIRST_BOX, SPARE, 2
        looks = () if hops else self._looks
        enough = ENOUGH_ROUGH if self._effort.rough else ENOUGH
        least = self._least_worth(curve, goal)

        def is_over(here: Timed, rounds: int) -> bool:
            return self._is_hopeless(here, rounds, looks) or (here.missed <= KEPT_PART * spare and here.cost <= least)

        for _ in range(_PROOFS):
            longest = self._longest(duration)
            options = Options(rounds, spare, density, box, is_over, longest, enough=enough)
            found = self.rounds.run(curve, duration, goal, options)
            if self._uses_reserve:
                self.rounds.reserve(0)
            if found is None or found.missed > (NEARLY if self.rounds.left_of_cost > 0 else KEPT_PART * spare):
                if found is not None:
                    self._left_blocked.append((found.cost, replace(start, curve=found.curve, duration=found.duration)))
                return False
            if self._goes_where_another_ended(found):
                return True
            free = bool((found.margins.margin > SPARE).all())
            ended = FoundMotion(found.motion, found.cost, goal, start.way, self._even_curve(found), free)
            if found.missed <= KEPT_PART * spare and self.incumbent.offer(ended):
                self.ended.append(ended)
                self._known.add(found.curve, _comparable(found))
                return True
            curve, duration, rounds, box = found.curve, found.duration, _FEW_ROUNDS, SMALL_BOX
            spare, density = spare + _MORE_SPARE, 2 * density
        return False

    def descend_finely(
        self, found: FoundMotion, curve: JointCurve, duration: float, rounds: int, *, enough: float = ENOUGH
    ) -> None:  # fmt: skip
        """Run a descent from a motion on a finer curve over a duration [s], and keep the result if it is better.

        Parameters
        ----------
        enough: see `Options`.
        """
        longest = self._longest(duration)
        options = Options(rounds, SPARE, density=2, box=SMALL_BOX, longest=longest, fine=True, enough=enough)
        fine = self.rounds.run(curve, duration, found.goal, options)
        if fine is not None and fine.missed <= SPARE:  # the proof decides: a descent may end with less spare
            self.incumbent.offer(replace(found, motion=fine.motion, cost=fine.cost, curve=self._even_curve(fine)))

    def _longest(self, duration: float) -> float:
        """The longest time for a descent from a curve with this duration [s]."""
        longest = self.incumbent.longest
        return longest if np.isfinite(longest) else _SLOWER * duration

    def _is_hopeless(self, here: Timed, rounds: int, looks: Sequence[int]) -> bool:
        """Whether a descent is given up at a curve after so many rounds; for `looks` see the class."""
        if rounds in looks and self._goes_where_another_ended(here, self._no_less):
            return True
        if rounds < _TRIED or self.best is None:
            return rounds >= _TRIED and here.missed > FURTHER_OFF
        return self._falls_behind(here, rounds, self.best)

    def _goes_where_another_ended(self, here: Timed, part: float = 1.0) -> bool:
        """Whether another descent has ended at a similar curve, and `part` of its cost is not above this one's."""
        least = part * self._known.least_alike(here.curve) if here.missed <= SPARE else np.inf
        return least <= _comparable(here)

    @abstractmethod
    def _falls_behind(self, here: Timed, rounds: int, best: FoundMotion) -> bool:
        """Whether a curve misses or costs too much after so many rounds, if another motion is known."""

    @abstractmethod
    def _least_worth(self, curve: JointCurve, goal: Goal) -> float:
        """A cost below which no round is worth it."""

    @abstractmethod
    def _even_curve(self, found: Timed) -> JointCurve | None:
        """The curve, if its motion runs along it at an even pace."""


def _comparable(found: Timed) -> float:
    return found.cost if found.own_cost is None else found.own_cost
