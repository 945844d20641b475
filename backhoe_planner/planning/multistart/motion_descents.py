"""Descents from the starts of one search for the least-cost motion to a goal, and the best motion found by them.

Every motion that counts is proven clear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, Problem, Trajectory
from backhoe_planner.planning.descent.alike import KnownCurves
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Descent, Timed
from backhoe_planner.planning.descent.looks import KEPT_PART
from backhoe_planner.planning.multistart.first_rounds import Field, GivesUp, after_first_rounds
from backhoe_planner.planning.multistart.lift import lift_of
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices
from backhoe_planner.planning.multistart.straight_lines import STRAIGHT
from backhoe_planner.planning.multistart.ways import FoundMotion
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.search.sampled_check import SampledCheck
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import motion_is_clear
from backhoe_planner.site import ClearanceScreen

_FINE_PIECES = 20  # of the best curve at the end
# the same for another cost than the time, in turn, with pieces of different lengths; and the most pieces times joints,
# because the programs take ever longer; chosen
_FINER_PIECES, _MOST_FINE = (20, 28, 36, 36, 36), 200
# of a straight line in its first rounds; twice as many rounds are made then, and three of them take as long as one on
# a curve of 12 pieces. On an open site of the Panda the rank correlation of the costs after the first rounds and at
# the end is 0.60 with 6 rounds on 6 pieces, in 75 ms, and 0.20 with 3 rounds on 12 pieces, in 116 ms
_COARSE_PIECES, _COARSE_FOR_ONE, _COARSE_IN_ONE = 6, 2, 3
_SPARE = 0.003  # m that a descent keeps beyond every clearance at the places that it checks
_MORE_SPARE = 0.002  # m that it keeps in addition after its motion could not be proven
_PROOFS = 3  # tries to prove one motion, each with more spare and twice as many places; chosen
_ROUNDS = 24  # of a descent at most; chosen, half of them end after 7
_MORE_ROUNDS = 80  # the same for another cost than the time, which keeps falling for longer; chosen
_ROUNDS_IN_ONE = 3  # rounds for another cost that count as one for the time, as no curve is timed in them; measured
_SOFTENED = 2  # times more rounds for a cost that jumps, which is softened ever less in turn; measured
_FEW_ROUNDS = 4  # of a descent that is continued
FINE_ROUNDS = 6  # of the best curve at the end
# part of the cost that each refinement must gain for the next to follow; chosen: if the first gains less, the next
# mostly gain nothing, and if it gains more, they may gain a third
_MUCH_GAIN = (0.01, 0.05, 0.1, 0.1)
_MUCH_GAIN_FRUGAL = (0.04, 0.05, 0.1, 0.1)  # the same for frugal searches; measured: the next gains a quarter of a gain
_FINER = 8  # times more fine rounds for another cost than the time; chosen
# other motions that are refined if refining pays, and up to how many times the cost of the best; chosen
_OTHERS_REFINED, _NEARLY_AS_CHEAP = 2, 1.2
_FIRST_BOX = 0.25  # rad or m of the fastest joint that the first step may move a control point; chosen
_SMALL_BOX = 0.1  # the same for a descent that is continued
_TRIED = 4  # rounds after which a descent is judged
_LOOKS = (0, 4, 8)  # rounds after which it is checked whether a descent goes where another one has ended; chosen
# the same for another cost than the time, and the factor on the other's cost in the comparison; chosen: in a round the
# cost counts some percent too little, because kinks are rounded off
_LATER_LOOKS, _NO_LESS = (8, 16), 0.97
_SOON = 4  # rounds before the first such check if an earlier search is continued; chosen
_FAR_OFF = 0.06  # m by which a clearance is missed then: hopeless if another motion is known; chosen
_FURTHER_OFF = 0.1  # m: the same if none is known; chosen
_NEARLY = 0.02  # m that a curve may miss at the end of a descent, which is then continued
_DEARER = 1.3  # times the best cost: hopeless then
_TRIED_LONGER, _MUCH_DEARER = 12, 1.5  # the same two for another cost than the time; chosen
_WAYS_FOR_ONE = 2  # one descent runs to its end for so many of `Effort.ways_at_once`; measured
_WORTH_ROUNDS = 2.0  # times the least cost after the first rounds, up to which a start gets all rounds; chosen
# times the least cost after the first rounds of other searches, that a start must not exceed after its own; chosen: one
# at 1.006 times it became a motion that costs a tenth less, of those above 1.01 none did
_NO_DEARER = 1.02
_SLOWER = 1.5  # times the duration of a start, that a descent from it may take while no longest time is known; chosen
LEAST_GAIN = 0.02  # part of the least time to a posture: a smaller gain is not worth a try


class MotionDescents:
    """Descents from one start, with the work of one world.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    ends: the postures on the goals.
    time: at which the positions of the obstacles are taken [s].
    before: the descents of an earlier search from the same start among the same obstacles, which is continued here: its
        results are known, and only better ones count.

    Attributes
    ----------
    best: the best motion so far.
    ended: the motions at which descents ended, some of them not proven.
    longest: the longest time that a motion may take [s], if the time is not the cost; infinite while it is not known;
        may be set.
    blocked, early: the cost after the first rounds of the cheapest start that stays in an obstacle, and of the
        cheapest one that gets clear; infinite if there is none.
    falls_short: whether all starts cost more after their first rounds than the cheapest of other searches, and none
        descended further therefore, see `know_of`.
    is_frugal: see the function `is_frugal`.
    lift: of the problem; None if the cost does not count it.
    """

    def __init__(
        self, world: World, start: Vector, ends: GoalEnds, *, time: float, longest: float = np.inf,
        before: MotionDescents | None = None,
    ) -> None:  # fmt: skip
        self._world, self._problem, self._ends, self._time = world, world.problem, ends, time
        self._hurried = world.work.effort.is_hurried
        self.lift = lift_of(world.problem)
        self.is_frugal = is_frugal(world)
        # a cost that counts as little, in the objective's unit
        self._little = self.lift.little if self.lift is not None and self.is_frugal else 0.0
        self._descent = Descent(
            world.problem, world.proximity, world.kinematics, time=time, brake=world.work.brake,
            hurried=self._hurried,
        )  # fmt: skip
        self._known = KnownCurves(
            world.problem.limits,
            lambda: SampledCheck(world.problem, world.proximity, [start], spare=0.0, time=time, brake=world.work.brake),
        )
        self._tried = self._known.anew()  # routes from which descents began
        self._begun: list[JointCurve] = []
        objective = world.problem.objective
        self._more = _SOFTENED if objective.jumps else 1
        self._rounds_in_one = 1 if objective.is_time else _ROUNDS_IN_ONE * self._more
        self._not_counted = 0  # rounds on coarse curves, which take less time, beyond those for which they count
        self._bests = 0  # how many motions were the best so far
        self._reserved = 0  # rounds that are kept for later descents
        self.longest = longest
        self.blocked = self.early = self._to_beat = np.inf
        self.falls_short = False
        self._left_blocked: list[tuple[float, Start]] = []  # starts that stayed in an obstacle, with their costs
        self.best: FoundMotion | None = None
        self._unrefined: FoundMotion | None = None  # the best before it was refined; None until then
        self._unrefined_after: int | None = None  # rounds until then
        self.ended: list[FoundMotion] = []
        if before is not None:
            self._known, self._begun, self.longest = before._known, list(before._begun), before.longest
            self.blocked, self.early = before.blocked, before.early
            self.best, self.ended = before._unrefined or before.best, list(before.ended)
        self._known_best = self.best
        self._later_looks = _LATER_LOOKS if before is None else (_SOON, *_LATER_LOOKS)

    def reserve(self, rounds: int) -> None:
        """Keep so many rounds for later descents."""
        self._reserved = rounds

    @property
    def rounds_left(self) -> int:
        """How many rounds may be made now, without the reserved ones."""
        return self._world.work.descent_rounds - self._reserved

    @property
    def rounds_before_refining(self) -> int:
        """How many rounds were made until the best was refined, fewer for those on coarse curves."""
        rounds = self._descent.rounds if self._unrefined_after is None else self._unrefined_after
        return rounds - self._not_counted

    @property
    def unrefined_cost(self) -> float:
        """The cost of the best before it was refined; infinite if there is none."""
        found = self._unrefined or self.best
        return np.inf if found is None else found.cost

    @property
    def gained_by_refining(self) -> float:
        """The part of its cost that refining took from the best; 0 if it was not refined."""
        return 1.0 - self.best.cost / self.unrefined_cost if self.best is not None and self._unrefined else 0.0

    @property
    def costs_little(self) -> bool:
        """Whether the best costs so little that a frugal search ends."""
        return self.best is not None and self.best.cost <= self._little

    @property
    def has_gained(self) -> bool:
        """Whether the best is better than that of the earlier search."""
        return self.best is not self._known_best

    def know_of(self, others: Iterable[MotionDescents]) -> None:
        """Take the costs of starts after their first rounds from other searches too, see `early` and `falls_short`."""
        for other in others:
            self.early, self.blocked = min(self.early, other.early), min(self.blocked, other.blocked)
        self._to_beat = self.early

    def prices(self, screen: ClearanceScreen, *, alike: Vector | None = None) -> StartPrices:
        """The prices of starts among the obstacles of `screen`; for `alike` see `StartPrices`."""
        return StartPrices(self._descent, screen, longest=self.longest, alike=alike)

    @property
    def begun(self) -> tuple[JointCurve, ...]:
        """The starting curves of the descents in `descend_cheapest`."""
        return tuple(self._begun)

    def take_blocked(self) -> list[tuple[float, Start]]:
        """The starts that stayed in an obstacle since the last call, as far as they were bent; the cheapest first."""
        found, self._left_blocked = sorted(self._left_blocked, key=lambda one: one[0]), []
        return found

    def goes_straight(self, found: FoundMotion) -> bool:
        """Whether this motion came from a straight line, if the cost is not the time: it goes around nothing.

        False if a blocked start was cheaper after its first rounds, or none got clear: then a detour may be cheaper.
        """
        return found.curve is not None and found.way == STRAIGHT and self.early <= self.blocked

    def fitted(self, found: FoundMotion) -> Start:
        """The start whose curve is nearest to a motion."""
        curve = JointCurve.fitted(found.motion, self._world.work.effort.pieces, self._problem.limits)
        return Start(curve, found.motion.duration, found.goal, found.way)

    def descend_cheapest(self, chosen: Sequence[PricedStart]) -> None:
        """A few rounds of descents from these starts, then all rounds of the best of them."""
        work = self._world.work
        self._begun += [one.start.curve for one in chosen]
        if len(chosen) == 1:
            start = chosen[0].start
            self.descend(replace(start, duration=max(start.duration, self.longest)))
            return
        far_off = _FURTHER_OFF if self.best is None else _FAR_OFF
        ways, is_clear, before = work.effort.ways_at_once, False, len(self.ended)
        found = after_first_rounds(
            (one.start for one in chosen), self._few_rounds, far_off=far_off, pushed=ways // _WAYS_FOR_ONE,
            field=Field(self._little) if self.is_frugal else None,
        )  # fmt: skip
        self.blocked = min(self.blocked, found.least_blocked)
        self._left_blocked += found.blocked
        tried = found.clear
        least = tried[0][0] if tried else np.inf
        self.falls_short = least > _NO_DEARER * self._to_beat and self.early <= self.blocked
        if self.falls_short:
            return
        self._to_beat = np.inf  # ways that are sampled later are found by chance, and need not be cheaper at first
        for index, (cost, start) in enumerate(tried):
            if is_clear and (index >= ways or cost > _WORTH_ROUNDS * tried[0][0]):
                break
            if self.descend(start):
                is_clear, self.early = True, min(self.early, cost)
            else:
                self.blocked = min(self.blocked, cost)
            # a descent that goes where another one ended adds none
            if len(self.ended) - before >= ways / _WAYS_FOR_ONE:
                break

    def descend(self, start: Start) -> bool:
        """Run a descent from a start, and keep its motion if it is proven and better; whether it got clear."""
        curve, duration, goal = start.curve, start.duration, start.goal
        is_time = self._problem.objective.is_time
        rounds = _ROUNDS if is_time else _MORE_ROUNDS * self._more
        box, spare, density = _FIRST_BOX, _SPARE, 2
        least = self._least_to(curve, goal)

        def is_over(here: Timed, rounds: int) -> bool:
            return self._is_hopeless(here, rounds) or (here.missed <= KEPT_PART * spare and here.cost <= least)

        for _ in range(_PROOFS):
            found = self._bend(
                curve, duration, goal, rounds, spare=spare, density=density, box=box, is_hopeless=is_over,
                rough=self._world.work.effort.rough,
            )  # fmt: skip
            if self._hurried and not is_time:
                self._reserved = 0  # a curve that is not quite clear may use them: in a hurry no descent follows
            if found is None or found.missed > (_NEARLY if self._rounds_left_of_cost() > 0 else KEPT_PART * spare):
                if found is not None:
                    self._left_blocked.append((found.cost, replace(start, curve=found.curve, duration=found.duration)))
                return False
            if self._goes_where_another_ended(found):
                return True
            free = bool((found.margins.margin > _SPARE).all())
            ended = FoundMotion(found.motion, found.cost, goal, start.way, None if is_time else found.curve, free)
            if found.missed <= KEPT_PART * spare and self.offer(ended):
                self.ended.append(ended)
                self._known.add(found.curve, _comparable(found))
                return True
            curve, duration, rounds, box = found.curve, found.duration, _FEW_ROUNDS, _SMALL_BOX
            spare, density = spare + _MORE_SPARE, 2 * density
        return False

    def descend_if_new(self, way: FoundMotion) -> bool:
        """Run `descend` from a route, unless a descent has begun from a similar one; whether it was run."""
        start = self.fitted(way)
        if self._tried.least_alike(start.curve) < np.inf:
            return False
        self._tried.add(start.curve, way.cost)
        self.descend(start)
        return True

    def refine(self) -> None:
        """Refine the best motion on a curve of more pieces; for another cost on several in turn, unless hurried.

        If the first of these makes it clearly cheaper, motions that cost little more are refined too: the costs before
        say little about those after.
        """
        self._reserved, self._unrefined, self._unrefined_after = 0, self.best, self._descent.rounds
        is_time = self._problem.objective.is_time
        if self.best is None or (not is_time and self._hurried) or self.costs_little:
            return
        finer = [pieces for pieces in _FINER_PIECES if pieces * self._problem.robot.n <= _MOST_FINE]
        others = [] if is_time else self._nearly_as_cheap()
        for turn, pieces in enumerate((_FINE_PIECES,) if is_time else finer or _FINER_PIECES[:1]):
            before = self.best.cost
            if not self._refine(self.best, pieces) or turn == len(_MUCH_GAIN):
                return
            much = _MUCH_GAIN_FRUGAL if self.is_frugal else _MUCH_GAIN
            if self.best.cost > (1.0 - much[turn]) * before or self.costs_little:
                return
            if turn == 0 and not all(self._refine(other, pieces) for other in others):
                return

    def _nearly_as_cheap(self) -> list[FoundMotion]:
        """The cheapest other motions at which descents ended, if they cost little more than the best."""
        assert self.best is not None
        best, most = self.best, _NEARLY_AS_CHEAP * self.best.cost
        others = [one for one in self.ended if one is not best and one.curve is not None and one.cost <= most]
        return sorted(others, key=lambda one: one.cost)[:_OTHERS_REFINED]

    def _refine(self, found: FoundMotion, pieces: int) -> bool:
        """Descend from a found motion on a curve of more pieces; false if too few rounds are left for that."""
        is_time, limits = self._problem.objective.is_time, self._problem.limits
        if self._rounds_left_of_cost() < FINE_ROUNDS:
            return False
        curve, duration = found.curve, found.motion.duration
        if curve is None:
            curve = JointCurve.fitted(found.motion, _FINE_PIECES, limits)
        if not is_time:
            curve, duration = curve.finer(pieces, limits.velocity), min(duration, self.longest)
        fine = self._bend(
            curve, duration, found.goal, FINE_ROUNDS * (1 if is_time else _FINER * self._more),
            spare=_SPARE, density=2, box=_SMALL_BOX, is_hopeless=lambda here, rounds: False, fine=True,
        )  # fmt: skip
        if fine is not None and fine.missed <= _SPARE:  # the proof decides: a descent may end with less spare
            self.offer(replace(found, motion=fine.motion, cost=fine.cost, curve=None if is_time else fine.curve))
        return True

    def offer(self, found: FoundMotion) -> bool:
        """Keep a motion if it is better than the best; whether it is proven clear, or too dear to be checked."""
        if not self._is_dear(found):
            if not (self._world.keeps(found.motion) and self._is_proven(found.motion)):
                return False
            self.best = found
            self._bests += 1
            self._world.show(found.motion, attempt=self._bests, best=found.cost)
        return True

    def _few_rounds(
        self, start: Start, rounds: int, *, gives_up: GivesUp, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        """See `FewRounds`; of a straight line on a coarse curve, so that the same time shows more of its result."""
        curve, pieces = start.curve, start.curve.pieces
        coarse = start.way == STRAIGHT and pieces > _COARSE_PIECES and not clear_first and not self._hurried
        if coarse:
            curve, rounds = curve.divided_evenly(_COARSE_PIECES, self._problem.limits), _COARSE_FOR_ONE * rounds
        before, in_one = self._descent.rounds, _COARSE_FOR_ONE if coarse else 1

        def is_over(here: Timed, rounds: int) -> bool:
            return (clear_first and here.missed <= KEPT_PART * _SPARE) or gives_up(here, rounds / in_one)

        found = self._bend(
            curve, max(start.duration, self.longest), start.goal, rounds,
            spare=_SPARE, density=density, box=_FIRST_BOX, unsampled=True, clear_first=clear_first,
            is_hopeless=is_over, rough=coarse and self.is_frugal,
            in_one=_COARSE_IN_ONE if coarse else 1,
        )  # fmt: skip
        if not coarse:
            return found
        made = self._descent.rounds - before
        self._not_counted += made - -(-made // _COARSE_IN_ONE)
        return None if found is None else replace(found, curve=found.curve.divided_evenly(pieces, self._problem.limits))

    def _least_to(self, curve: JointCurve, goal: Goal) -> float:
        """A duration [s] below which no round is worth it; 0 unless hurried, for the time, and with a fixed end."""
        if not self._hurried or not self._problem.objective.is_time or not holds_end(self._problem, goal):
            return 0.0
        return (1.0 + LEAST_GAIN) * self._ends.least_to(curve.control[-1])

    def _bend(
        self, curve: JointCurve, duration: float, goal: Goal, rounds: int, *,
        spare: float, density: int, box: float, is_hopeless: Callable[[Timed, int], bool],
        unsampled: bool = False, rough: bool = False, clear_first: bool = False, fine: bool = False,
        in_one: int = 1,
    ) -> Timed | None:  # fmt: skip
        work, descent = self._world.work, self._descent
        before = descent.rounds
        rounds = min(rounds, self._rounds_left_of_cost())
        found = descent.run(
            curve, duration, goal,
            most_rounds=rounds, spare=spare, density=density, box=box, is_hopeless=is_hopeless,
            longest=self.longest if np.isfinite(self.longest) else _SLOWER * duration,
            unsampled=unsampled, rough=rough, clear_first=clear_first, fine=fine,
        )  # fmt: skip
        work.descent_rounds -= -(-(descent.rounds - before) // (self._rounds_in_one * in_one))
        return found

    def _rounds_left_of_cost(self) -> int:
        return self.rounds_left * self._rounds_in_one

    def _is_hopeless(self, here: Timed, rounds: int) -> bool:
        is_time = self._problem.objective.is_time
        looks, part = (_LOOKS, 1.0) if is_time else (self._later_looks, _NO_LESS)
        if rounds in looks and self._goes_where_another_ended(here, part):
            return True
        if rounds < _TRIED or self.best is None:
            return rounds >= _TRIED and here.missed > _FURTHER_OFF
        if is_time:
            return here.missed > _FAR_OFF or here.cost > _DEARER * self.best.cost
        if rounds < _TRIED_LONGER:
            return here.missed > _FAR_OFF
        return here.missed > _NEARLY or here.cost > _MUCH_DEARER * self.best.cost

    def _goes_where_another_ended(self, here: Timed, part: float = 1.0) -> bool:
        """Whether another descent has ended at a similar curve, and `part` of its cost is not above this one's."""
        least = part * self._known.least_alike(here.curve) if here.missed <= _SPARE else np.inf
        return least <= _comparable(here)

    def _is_dear(self, found: FoundMotion) -> bool:
        """Whether a motion is no better than the best; one beyond the longest time is worse than any within it."""
        one, best = ((each.motion.duration > self.longest, each.cost) for each in (found, self.best or found))
        return self.best is not None and one >= best

    def _is_proven(self, motion: Trajectory) -> bool:
        proximity = self._world.proximity
        proximity.cover_unchecked(motion.q)
        return motion_is_clear(proximity, np.full(len(motion), self._time), motion.q)


def is_frugal(world: World) -> bool:
    """Whether searches end where little more can be expected: with such an effort, for little work.

    What starts and searches cost at first says less about their ends for a cost that jumps, or that does not count the
    lift: with `effort` a motion of the Panda then cost 1.44 times as much.
    """
    objective = world.problem.objective
    return world.work.effort.frugal and objective.lifts and not objective.jumps


def _comparable(found: Timed) -> float:
    return found.cost if found.own_cost is None else found.own_cost


def holds_end(problem: Problem, goal: Goal) -> bool:
    """Whether a goal leaves the end of a motion no freedom."""
    if goal.q is not None:
        return True
    if goal.search_target.position_tolerance:
        return False
    pitch, turned = goal.target.pitch, goal.target.rotation is not None
    more = 3 if turned else int(pitch is not None and pitch[0] == pitch[1])
    return bool(problem.robot.n <= 3 + more)
