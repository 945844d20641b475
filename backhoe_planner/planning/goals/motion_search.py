"""The search for the least-cost motion to a goal: many first ways, each brought down by a descent.

First ways are straight lines of the joints to the nearest postures on a goal, clear or not, then a sampled way,
then different ways through roadmaps, made of configurations through which a motion can be shorter than the best,
or much shorter. Every motion that counts is proven clear.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, Problem, Trajectory, motion_cost
from backhoe_planner.planning.descent.alike import KnownCurves
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Descent, Timed
from backhoe_planner.planning.descent.looks import KEPT_PART
from backhoe_planner.planning.descent.starts import PricedStart, Start, StartPrices
from backhoe_planner.planning.goals.allowed_time import (
    allowed_time,
    bound_behind,
    bound_for_allowed_time,
    fastest_with_room,
    has_room,
)
from backhoe_planner.planning.goals.first_rounds import after_first_rounds
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.goals.straight_lines import STRAIGHT, StraightLines
from backhoe_planner.planning.goals.ways import FoundMotion, Ways
from backhoe_planner.planning.search.effort import EFFORTS, Effort, OutOfTime
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.search.reach import travel_within
from backhoe_planner.planning.search.sampled_check import SampledCheck
from backhoe_planner.planning.search.way_price import price_of
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import least_duration, motion_is_clear
from backhoe_planner.site import ClearanceScreen

_FINE_PIECES = 20  # of the best curve at the end
# the same for another cost than the time, in turn, with pieces of different lengths; and pieces times joints at most,
# as the programs take ever longer; chosen
_FINER_PIECES, _MOST_FINE = (20, 28, 36, 36, 36), 200
_SPARE = 0.003  # m that a descent keeps beyond every clearance where it looks
_MORE_SPARE = 0.002  # m that it keeps beside, where its motion could not be proven
_PROOFS = 3  # tries to prove one motion, each with more spare and looked at twice as densely; chosen
_ROUNDS = 24  # of a descent at most; chosen, half of them end after 7
_MORE_ROUNDS = 80  # the same for another cost than the time, which falls for longer; chosen
_ROUNDS_IN_ONE = 3  # rounds of another cost that count as one for the time: no curve is timed in them; measured
_FEW_ROUNDS = 4  # of one that goes on
_FINE_ROUNDS = 6
_MUCH_GAIN = (0.01, 0.05, 0.1, 0.1)  # part of the cost that each of these must gain for the next; chosen
_FINER = 8  # times more of these for another cost than the time; chosen
_FIRST_BOX = 0.25  # rad or m of the fastest joint that the first step may move a control point; chosen
_SMALL_BOX = 0.1  # the same of a descent that goes on
_PLACES = 25  # of a motion, by which it is looked at as a whole; chosen, about every 2 to 10 cm of the tip
_TRIED = 4  # rounds after which a descent is judged
_LOOKS = (0, 4, 8)  # rounds after which it is looked whether a descent goes where another one has ended; chosen
_LATER_LOOKS = (8, 16)  # the same for another cost than the time; chosen
_FAR_OFF = 0.06  # m by which a clearance is then missed: hopeless where another motion is known; chosen
_FURTHER_OFF = 0.1  # m: the same where none is; chosen
_NEARLY = 0.02  # m that a curve may miss at the end of a descent, which then goes on
_DEARER = 1.3  # times the best cost: hopeless then
_TRIED_LONGER, _MUCH_DEARER = 12, 1.5  # the same two for another cost than the time; chosen
_WORTH = 1.4  # times the best cost, up to which a way is worth a descent; chosen
_WORTH_MORE = 2.0  # times the part that the best is above the bound: the part that a way may then cost more; chosen
_DEAREST = 1.6  # times the best cost: the price up to which there are ways through a roadmap; chosen
# parts of what the logarithm of the best duration is above that of the bound, which a way's longest time is below
# it, in turn; chosen
_SHORTER = (0.25, 0.5, 0.0, 0.5)
_MANY_NODES = 3_600  # of a roadmap after one that gained nothing, at least; chosen
_FEWEST_WAYS = 2  # that are sampled before none is found
# times the bound, from which on there is more patience, and by which factor; chosen
_PATIENCE = ((2.0, 4), (1.4, 3), (1.1, 2))
# the same for another cost than the time, in place of the bound with the cheapest start that stays in an obstacle
_PATIENCE_ROUND = ((2.0, 3), (1.3, 2))
_NEAR = 1.1  # times the least time to any posture, up to which a motion is near the best there is; chosen
_MORE_POSTURES = 4  # times the usual starting points, where more of them are looked for; chosen
_MORE_FOR_COST = 12  # the same for another cost than the time, of which the end decides most; measured
_VAIN = 2  # searches that gained nothing, as which one counts that found no way at all; chosen
_ELSEWHERE = 0.3  # s of joint time between two ends that count as different; chosen
# the cheapest straight lines for each of `Effort.ways_at_once`, of which some joints are made early or late as well,
# and how many of both have a few rounds, for another cost than the time; chosen
_LINES_FOR_ONE, _LINES_TRIED_FOR_ONE = 3, 2
_WAYS_FOR_ONE = 2  # of `Effort.ways_at_once`, for each of which one descent goes on until it ends; measured
_WORTH_ROUNDS = 2.0  # times the least cost after some rounds, up to which more are made; chosen
_SLOWER = 1.5  # times what a way takes, that a descent from it may take where none is allowed a time yet; chosen
_GAIN = 0.005  # part of the cost that counts as a gain
_FEWER_BOXES = 4  # times fewer for the bound of the search than for that of the plan; chosen
_END_GAIN = 0.15  # part of the least time to a posture that may be won where the end moves on the goal; chosen
_LEAST_GAIN = 0.02  # part of the least time to a posture: it is not worth a try to come nearer to it
# for a motion whose time says how long one may take that costs little; where it finds none soon, a longer search does
_FIRST_SEARCH = replace(EFFORTS["quick"], motions_per_search=1_000, motions=2_000)


class MotionSearch:
    """A search from one start.

    Parameters
    ----------
    start: (n,) where the machine stands [rad or m].
    found: postures on the goals.
    time: the obstacles stand where they are at this time [s].
    enough: a motion as fast as this ends the search, where the time is the cost [s].
    longest: that a motion may take, where the time is not the cost [s]; found out where it is infinite.

    Attributes
    ----------
    best: the best so far.
    ended: where descents ended, among them motions that are not proven.
    """

    def __init__(
        self, world: World, start: Vector, found: GoalPostures, *, time: float, enough: float = 0.0,
        longest: float = np.inf,
    ) -> None:  # fmt: skip
        self._world, self._start, self._time, self._enough = world, start, time, enough
        self._problem = world.problem
        self._descent = Descent(
            world.problem, world.proximity, world.kinematics, time=time, brake=world.work.brake,
            hurried=not self._goes_on(),
        )  # fmt: skip
        self._screen = ClearanceScreen(world.proximity, time=time)
        self._ends = GoalEnds(world.problem, start)
        self._ends.take(found.clear, found.goals)
        self._lines = StraightLines(start, self._ends, self._screen, pieces=world.work.effort.pieces)
        self._ways = Ways(world, start, self._ends, time=time, hurried=not self._goes_on())
        known = KnownCurves(
            world.problem.limits,
            lambda: SampledCheck(world.problem, world.proximity, [start], spare=0.0, time=time, brake=world.work.brake),
        )
        self._known = known  # where descents ended
        self._tried = known.anew()  # ways from which descents began
        self._bound = 0.0  # no motion is shorter [s]; worked out where the best is not near the least time
        self._looked_within = np.inf  # s, in which further postures can be reached that were looked for last
        self._longest = longest  # s that a motion may then take
        # cost after its first rounds of the cheapest start that stays in an obstacle, and of the cheapest that does not
        self._blocked = self._early = np.inf
        self._rounds_in_one = 1 if world.problem.objective.is_time else _ROUNDS_IN_ONE
        self._bests = 0  # how many motions were the best so far
        self._reserved = 0  # rounds of descents that are kept for what comes later
        self.best: FoundMotion | None = None
        self.ended: list[FoundMotion] = []

    @property
    def looked_at(self) -> int:
        """How many motions sampling looked at in vain, of ways that were not found."""
        return self._ways.looked_at

    def run(self) -> str:
        """Search until the effort is used up or nothing is gained; `best` is then what was found.

        Returns
        -------
        Empty; or that time ran out, in words.
        """
        try:
            if not self._problem.objective.is_time:
                self._go_fast()
            if not np.isfinite(self._longest):
                self._go_straight(self._ends.order if self._goes_on() else self._lines.least_blocked())
                if self._goes_on() and not self._is_enough():
                    self._go_straight(self._look_for_postures(None if self.best is None else self.best.motion.duration))
            if self.best is None or not self._goes_straight(self.best):
                self._go_round()
            if not self._is_enough():
                self._refine()
        except OutOfTime as ended:
            return str(ended)
        return ""

    @property
    def allowed_time(self) -> float | None:
        """How long a motion may take [s]; None where its time is the cost, or no motion is known."""
        return self._longest if np.isfinite(self._longest) else None

    @property
    def leads_round(self) -> bool:
        """Whether the best leads round something, or may cost more than one that does, see `_goes_straight`."""
        return self.best is not None and not self._goes_straight(self.best)

    def _bound_above(self, known: Trajectory) -> float:
        """What no motion is shorter than [s], from fewer boxes than the plan's bound; `known` is one."""
        boxes = self._world.work.effort.boxes // _FEWER_BOXES
        return least_duration(self._problem, self._start, known=known.duration, end=known.q[-1], boxes=boxes).duration

    # --- first ways -------------------------------------------------------------------

    def _go_fast(self) -> None:
        """How long a motion may take; where the searches for that end, and lines to many postures, brought down.

        Where it is given how long, one short search for a fast motion is enough.

        Nothing of that where none of the searches has a motion that is proven.
        """
        work = self._world.work
        ended: list[FoundMotion] = []
        efforts: tuple[Effort, ...] = (work.effort,)
        bound = 0.0
        if np.isfinite(self._longest):
            efforts, bound = (_FIRST_SEARCH,), bound_behind(self._longest)
        elif self._goes_on():
            efforts, bound = (_FIRST_SEARCH, work.effort), bound_for_allowed_time(self._problem, self._start)
        for effort in efforts:
            search = self._search_fastest(effort, enough=fastest_with_room(bound))
            if search is None:
                return
            self._ends.take(search._ends.postures, search._ends.goals)
            ended += search.ended
            if search.best is not None:
                ended.append(search.best)
                fastest = search.best.motion
                self._longest = min(self._longest, allowed_time(bound, fastest.duration))
                self._offer(replace(search.best, cost=motion_cost(self._problem, fastest)))
                if has_room(bound, fastest.duration):
                    break
        if not np.isfinite(self._longest):
            return
        if self._goes_on():
            self._look_for_postures(within=self._longest)
        self._reserved = work.descent_rounds // 3
        ways = work.effort.ways_at_once
        prices = StartPrices(self._descent, self._screen, longest=self._longest)
        straight = prices.in_order(self._lines.within(self._longest) if self._goes_on() else [])
        lines = prices.cheapest(straight, _LINES_FOR_ONE * ways)
        both = sorted([*lines, *prices.paced(lines)], key=lambda one: one.price)
        known = prices.in_order([self._fitted(one) for one in ended])
        self._descend_cheapest([*prices.cheapest(known, ways), *prices.cheapest(both, _LINES_TRIED_FOR_ONE * ways)])

    def _search_fastest(self, effort: Effort, *, enough: float) -> MotionSearch | None:
        """A search for a motion as fast as `enough` [s] that has ended; None where it has no posture on a goal."""
        world = self._world.for_time(effort)
        found = find_goal_postures(world, self._problem.goals, near=self._start, time=self._time)
        if isinstance(found, Outcome):
            return None
        search = MotionSearch(world, self._start, found, time=self._time, enough=enough)
        search.run()
        return search

    def _fitted(self, found: FoundMotion) -> Start:
        curve = JointCurve.fitted(found.motion, self._world.work.effort.pieces, self._problem.limits)
        return Start(curve, found.motion.duration, found.goal, found.way)

    def _goes_straight(self, found: FoundMotion) -> bool:
        """Whether a straight line has become this motion, where the cost is not the time: nothing is gone round.

        False where one is blocked that is cheaper as early, or none got clear: a way round may be cheaper too.
        """
        return found.curve is not None and found.way == STRAIGHT and self._early <= self._blocked

    def _descend_cheapest(self, chosen: Sequence[PricedStart]) -> None:
        """A few rounds of descents from these starts, then all rounds of the best."""
        work = self._world.work
        if len(chosen) == 1:
            start = chosen[0].start
            self._descend(start.curve, max(start.duration, self._longest), start.goal, start.way)
            return
        far_off = _FURTHER_OFF if self.best is None else _FAR_OFF
        ways, clear = work.effort.ways_at_once, 0
        found = after_first_rounds(
            (one.start for one in chosen), self._few_rounds, far_off=far_off, pushed=ways // _WAYS_FOR_ONE
        )
        self._blocked = min(self._blocked, found.blocked)
        tried = found.clear
        for index, (cost, start) in enumerate(tried):
            if clear and (index >= ways or cost > _WORTH_ROUNDS * tried[0][0]):
                break
            if self._descend(start.curve, start.duration, start.goal, start.way):
                clear, self._early = clear + 1, min(self._early, cost)
            else:
                self._blocked = min(self._blocked, cost)
            if clear >= ways / _WAYS_FOR_ONE:
                break

    def _few_rounds(
        self, start: Start, rounds: int, *, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        """See `FewRounds`."""
        return self._bend(
            start.curve, max(start.duration, self._longest), start.goal, rounds,
            spare=_SPARE, density=density, box=_FIRST_BOX, unsampled=True, clear_first=clear_first,
            is_hopeless=lambda here, rounds: clear_first and here.missed <= KEPT_PART * _SPARE,
        )  # fmt: skip

    def _goes_on(self) -> bool:
        """Whether the search goes on where it has found a motion."""
        return self._world.work.effort.dull_searches > 0

    def _look_for_postures(self, within: float | None) -> list[int]:
        """Look for more postures, in so much time [s] or anywhere; which they are, the soonest first."""
        self._looked_within = np.inf if within is None else within
        more = _MORE_POSTURES if self._problem.objective.is_time else _MORE_FOR_COST
        found = find_goal_postures(
            self._world, self._problem.goals, near=self._start, time=self._time, more=more,
            travel=None if within is None else travel_within(self._problem.limits, within),
        )  # fmt: skip
        return [] if isinstance(found, Outcome) else self._ends.take(found.clear, found.goals)

    def _go_straight(self, order: Sequence[int]) -> None:
        """Descents from straight lines to the first postures of `order`, until one of them does not get clear."""
        work = self._world.work
        self._reserved = work.descent_rounds // 2
        for index in order[: work.effort.ways_at_once]:
            if self._is_optimal():
                return
            if not self._is_open(index):
                continue
            line = self._lines.to(index)
            if not self._descend(line.curve, line.duration, line.goal, line.way):
                return

    def _go_round(self) -> None:
        """Descents from a sampled way, then from ways through roadmaps, until several times nothing was gained.

        For another cost than the time every other time sampled ways: what one costs says little of what a descent
        makes of it, and they differ more from each other than the cheapest through roadmaps.
        """
        work, is_time = self._world.work, self._problem.objective.is_time
        turn, dull = (0 if is_time else 1), 0  # the search for the fastest had the first ways
        self._reserved = _FINE_ROUNDS if work.effort.descent_rounds > 2 * _FINE_ROUNDS else 0
        while self.best is None and self._ways.may_sample and turn < max(work.effort.ways_at_once, _FEWEST_WAYS):
            self._follow(self._sampled(turn))
            turn += 1
        keep = self._problem.keep
        mapped = keep is None or not keep.has_cone
        work.descent_rounds, work.way_rounds = work.descent_rounds + work.way_rounds, 0
        while self.best is not None and dull < self._patience() and not self._is_optimal():
            if work.descent_rounds <= self._reserved:
                return
            before = self.best.cost
            sampled = not mapped or (not is_time and turn % 2 == 1)
            found = self._follow(self._sampled(turn) if sampled else self._mapped(turn, dull))
            turn += 1
            gained = self.best.cost < (1.0 - _GAIN) * before
            dull = 0 if gained else dull + (1 if found or mapped else _VAIN)

    def _follow(self, ways: Iterable[FoundMotion]) -> bool:
        """Descents from ways that are worth one; whether there are any."""
        if np.isfinite(self._longest):
            ways = list(ways)
            for way in ways:
                self._offer(way)
            prices = StartPrices(self._descent, self._screen, longest=self._longest)
            self._descend_cheapest(prices.cheapest(prices.in_order([self._fitted(way) for way in ways]), len(ways)))
            return bool(ways)
        found = False
        for way in ways:
            found = True
            if self.best is not None and (way.cost > self._dearest_worth() or self._is_optimal()):
                continue
            if self._goes_on():
                self._offer(way)
            curve = JointCurve.fitted(way.motion, self._world.work.effort.pieces, self._problem.limits)
            if self._tried.least_alike(curve) < np.inf:
                continue
            self._tried.add(curve, way.cost)
            self._descend(curve, way.motion.duration, way.goal, way.way)
            if not self._goes_on():  # where the descent got clear, the way itself need not be proven
                self._offer(way)
        return found

    def _patience(self) -> int:
        """How often in a row a search may gain nothing."""
        usual = self._world.work.effort.dull_searches
        if not self._goes_on():
            return 0
        if not self._problem.objective.is_time:
            best = np.inf if self.best is None else self.best.cost
            return usual * next((factor for part, factor in _PATIENCE_ROUND if best > part * self._blocked), 1)
        assert self.best is not None
        if self._is_near():
            return usual - self.best.free
        return usual * next((factor for part, factor in _PATIENCE if self.best.cost > part * self._bound), 1)

    def _is_near(self) -> bool:
        """Whether the best is near what no motion to any known posture is shorter than."""
        assert self.best is not None
        if self.best.motion.duration < _NEAR * self._least_time():
            return True
        if not self._bound:
            self._bound = self._bound_above(self.best.motion)
        return False

    def _least_time(self) -> float:
        """What no motion to any of the postures that are known is shorter than [s]."""
        own = np.inf if self.best is None else self._ends.least_to(self.best.motion.q[-1])
        return min(own, *self._ends.least)

    def _dearest_worth(self) -> float:
        """What a way costs at most from which a descent is worth its time: little more where little can be gained."""
        assert self.best is not None
        least = self._bound or self._least_time()
        above = self.best.cost / least - 1.0 if least else np.inf
        return self.best.cost * min(_WORTH, 1.0 + _WORTH_MORE * above)

    def _sampled(self, turn: int) -> Iterator[FoundMotion]:
        """Motions along sampled ways to postures that can still be better."""
        ways = self._world.work.effort.ways_at_once
        for number in (turn,) if self.best is None else range(ways * turn, ways * (turn + 1)):
            which = [index for index in self._ends.order if self._is_open(index)]
            if number % 2:
                which = self._elsewhere(which) or which
            way = self._ways.sample(which, number, again=0 if self.best is None else 1) if which else None
            if way is not None:
                yield way

    def _mapped(self, turn: int, dull: int) -> Iterator[FoundMotion]:
        """Motions along different ways through a roadmap, which pass elsewhere than those that are known."""
        assert self.best is not None
        longest, best, nodes = self._longest, self.best, self._world.work.effort.nodes
        if not np.isfinite(longest):
            longest, nodes = self._longest_worth(dull), max(nodes, _MANY_NODES) if dull else nodes
            if longest != self._looked_within:
                self._look_for_postures(longest)
        which = [index for index in self._ends.order if self._is_open(index) and self._ends.least[index] < longest]
        if not which:
            return
        known = [one.motion.at(np.linspace(0.0, one.motion.duration, _PLACES)) for one in (*self.ended, best)]
        price, own = price_of(self._problem, best.motion, longest), best.cost
        if np.isfinite(self._longest):  # a descent makes several times less of a price: prices are compared with prices
            own = max(own, float(np.sum(price(known[-1][:-1], known[-1][1:]))))
        found = self._ways.through_roadmap(
            which, turn, nodes=nodes, longest=longest, price=price, known=known, dearest=_DEAREST * own
        )
        yield from itertools.islice(found, 2 * self._world.work.effort.ways_at_once)

    def _longest_worth(self, dull: int) -> float:
        """How long a way may at most seem to take [s], after some turns in vain: mostly much less than the best."""
        assert self.best is not None
        best = self.best.motion.duration
        if self._is_near() or not self._bound:
            return best
        return float(best * (self._bound / best) ** _SHORTER[dull % len(_SHORTER)])

    def _elsewhere(self, ends: Sequence[int]) -> list[int]:
        """Those of the postures `ends` that are far from where sampled ways and descents have ended."""
        ended = np.array([*self._ways.reached, *(one.motion.q[-1] for one in self.ended)])
        rate = self._problem.limits.velocity
        return [
            index
            for index in ends
            if not len(ended) or np.min(np.max(np.abs(self._ends.postures[index] - ended) / rate, axis=1)) > _ELSEWHERE
        ]

    def _is_enough(self) -> bool:
        """Whether a motion is known that is as fast as is asked for."""
        return self.best is not None and self.best.motion.duration <= self._enough

    def _is_optimal(self) -> bool:
        """Whether no motion can be better by more than `_LEAST_GAIN`, or one is as fast as is asked for."""
        if self._is_enough():
            return True
        if self.best is None or not self._problem.objective.is_time or not self._goes_on():
            return False
        return self.best.motion.duration <= (1.0 + _LEAST_GAIN) * self._least_time()

    def _is_open(self, index: int) -> bool:
        """Whether a motion to this posture can still be better than the best."""
        if self.best is None or not self._problem.objective.is_time:
            return True
        worth = 1.0 + _LEAST_GAIN if _holds_end(self._problem, self._ends.goals[index]) else 1.0 - _END_GAIN
        return self.best.motion.duration > worth * self._ends.least[index]

    # --- descents -----------------------------------------------------------------------

    def _descend(self, curve: JointCurve, duration: float, goal: Goal, way: str) -> bool:
        """Bring a curve down, and keep its motion where it is proven and better; whether it got clear."""
        is_time = self._problem.objective.is_time
        rounds = _ROUNDS if is_time else _MORE_ROUNDS
        box, spare, density = _FIRST_BOX, _SPARE, 2
        least = self._least_to(curve, goal)

        def is_over(here: Timed, rounds: int) -> bool:
            return self._is_hopeless(here, rounds) or (here.missed <= KEPT_PART * spare and here.cost <= least)

        for _ in range(_PROOFS):
            found = self._bend(
                curve, duration, goal, rounds, spare=spare, density=density, box=box, is_hopeless=is_over,
                rough=self._world.work.effort.rough,
            )  # fmt: skip
            if found is None or found.missed > (_NEARLY if self._rounds_left() > 0 else KEPT_PART * spare):
                return False
            if self._goes_where_another_ended(found):
                return True
            free = all(float(near.margin.min()) > _SPARE for near in found.margins)
            ended = FoundMotion(found.motion, found.cost, goal, way, None if is_time else found.curve, free)
            if found.missed <= KEPT_PART * spare and self._offer(ended):
                self.ended.append(ended)
                self._known.add(found.curve, found.cost)
                return True
            curve, duration, rounds, box = found.curve, found.duration, _FEW_ROUNDS, _SMALL_BOX
            spare, density = spare + _MORE_SPARE, 2 * density
        return False

    def _least_to(self, curve: JointCurve, goal: Goal) -> float:
        """A duration [s] that is not worth a round to become less; 0 where the search goes on, or the end may move."""
        if self._goes_on() or not self._problem.objective.is_time or not _holds_end(self._problem, goal):
            return 0.0
        return (1.0 + _LEAST_GAIN) * self._ends.least_to(curve.control[-1])

    def _refine(self) -> None:
        """The best motion again on a curve of more pieces; for another cost on several in turn, if in no hurry."""
        self._reserved = 0
        is_time, limits = self._problem.objective.is_time, self._problem.limits
        if not is_time and not self._goes_on():
            return
        finer = [pieces for pieces in _FINER_PIECES if pieces * self._problem.robot.n <= _MOST_FINE]
        for turn, pieces in enumerate((_FINE_PIECES,) if is_time else finer or _FINER_PIECES[:1]):
            best = self.best
            if best is None or self._rounds_left() < _FINE_ROUNDS:
                return
            curve, duration = best.curve, best.motion.duration
            if curve is None:
                curve = JointCurve.fitted(best.motion, _FINE_PIECES, limits)
            if not is_time:
                curve, duration = curve.finer(pieces, limits.velocity), min(duration, self._longest)
            found = self._bend(
                curve, duration, best.goal, _FINE_ROUNDS * (1 if is_time else _FINER),
                spare=_SPARE, density=2, box=_SMALL_BOX, is_hopeless=lambda here, rounds: False,
            )  # fmt: skip
            if found is not None and found.missed <= KEPT_PART * _SPARE:
                self._offer(replace(best, motion=found.motion, cost=found.cost, curve=None if is_time else found.curve))
            if self.best is None or turn == len(_MUCH_GAIN):
                return
            if self.best.cost > (1.0 - _MUCH_GAIN[turn]) * best.cost:
                return

    def _bend(
        self, curve: JointCurve, duration: float, goal: Goal, rounds: int, *,
        spare: float, density: int, box: float, is_hopeless: Callable[[Timed, int], bool],
        unsampled: bool = False, rough: bool = False, clear_first: bool = False,
    ) -> Timed | None:  # fmt: skip
        work, descent = self._world.work, self._descent
        before = descent.rounds
        rounds = min(rounds, self._rounds_left())
        found = descent.run(
            curve, duration, goal,
            most_rounds=rounds, spare=spare, density=density, box=box, is_hopeless=is_hopeless,
            longest=self._longest if np.isfinite(self._longest) else _SLOWER * duration,
            unsampled=unsampled, rough=rough, clear_first=clear_first,
        )  # fmt: skip
        work.descent_rounds -= -(-(descent.rounds - before) // self._rounds_in_one)
        return found

    def _rounds_left(self) -> int:
        return (self._world.work.descent_rounds - self._reserved) * self._rounds_in_one

    def _is_hopeless(self, here: Timed, rounds: int) -> bool:
        if rounds in (_LOOKS if self._problem.objective.is_time else _LATER_LOOKS) and self._goes_where_another_ended(
            here
        ):
            return True
        if rounds < _TRIED or self.best is None:
            return rounds >= _TRIED and here.missed > _FURTHER_OFF
        if self._problem.objective.is_time:
            return here.missed > _FAR_OFF or here.cost > _DEARER * self.best.cost
        if rounds < _TRIED_LONGER:
            return here.missed > _FAR_OFF
        return here.missed > _NEARLY or here.cost > _MUCH_DEARER * self.best.cost

    def _goes_where_another_ended(self, here: Timed) -> bool:
        """Whether another descent has ended at a curve like this one, and at less cost."""
        return here.missed <= _SPARE and self._known.least_alike(here.curve) <= here.cost

    def _is_dear(self, found: FoundMotion) -> bool:
        """Whether a motion is no better than the best; one that takes longer than it may is worse than any other."""
        one, best = ((each.motion.duration > self._longest, each.cost) for each in (found, self.best or found))
        return self.best is not None and one >= best

    def _offer(self, found: FoundMotion) -> bool:
        """Keep a motion where it is better than the best; whether it is proven clear, or too dear to be looked at."""
        if not self._is_dear(found):
            if not (self._world.keeps(found.motion) and self._is_proven(found.motion)):
                return False
            self.best = found
            self._bests += 1
            self._world.show(found.motion, attempt=self._bests, best=found.cost)
        return True

    def _is_proven(self, motion: Trajectory) -> bool:
        proximity = self._world.proximity
        proximity.cover_unchecked(motion.q)
        return motion_is_clear(proximity, np.full(len(motion), self._time), motion.q)


def _holds_end(problem: Problem, goal: Goal) -> bool:
    """Whether a goal leaves the machine no way to move on it."""
    if goal.q is not None:
        return True
    pitch, turned = goal.target.pitch, goal.target.rotation is not None
    more = 3 if turned else int(pitch is not None and pitch[0] == pitch[1])
    return bool(problem.robot.n <= 3 + more)
