"""The best motion of a search for another cost than the time is improved again, in up to three ways.

From beside it, on finer curves, and with standstills if the cost jumps where a rod begins to move. Little work has many
minima at the same end and on the same way: joints that go out and back let a machine swing folded, or lower one part by
what lifts another, and no small step leads there. So descents begin where it is more folded.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import Trajectory, motion_cost, time_evenly
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import ENOUGH, ENOUGH_ROUGH
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.lift import is_frugal, lift_of, little_cost
from backhoe_planner.planning.multistart.motion_descents import FINE_PIECES, FINE_ROUNDS
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.refining.standstills import with_standstills
from backhoe_planner.planning.world.world import World

# of the best curve, in turn, with pieces of different lengths; and the most pieces times joints, because the programs
# take ever longer; chosen: 36 pieces of seven joints take 1 to 2 s, and mostly gain too little before to be tried. On
# one cluttered site of the backhoe 12, 20, 28, 36, 52 and 72 pieces cost 208, 106, 66, 57, 42 and 38 J
_FINER_PIECES, _MOST_FINE = (20, 28, 36, 52, 72), 288
# part of the cost that the first refinement must gain for the next to follow, the same for frugal searches, and what
# each later one must gain; chosen: if the first gains less, the next mostly gain nothing; if more, they may
# gain a third. Measured: the next gains a quarter of a gain
_FIRST_GAIN, _FIRST_GAIN_FRUGAL, _NEXT_GAIN = 0.01, 0.04, 0.05
_FINER = 8  # times more fine rounds for another cost than the time; chosen
# other motions that are refined if refining pays, and up to how many times the cost of the best; chosen
_OTHERS_REFINED, _NEARLY_AS_CHEAP = 2, 1.2
# rounds of the descents of a search, without refining, above which it is hard and more hops may find a much cheaper
# motion; chosen: two plans in five have more. With 70 one of 60 plans costs 1.23 times as much
_HARD = 34
# basin hopping, see `_hop`: of motions that cost between so many times what counts as little, as below it finer
# curves suffice. Measured with 480 hops on 30 sites of backhoe and telescope: below 60 times 44 of 100 gain 5 % and
# more, and one at least on 11 of 13 sites, but from 40 on finer curves leave little of that; above 60 times it is one
# of 272
_HOPPED = (1.5, 40.0)
_HOPS, _HOP_GAINS = 24, 0.01  # at most, and the part of the cost that counts as a gain; chosen
# with few joints: of how many random moves aside the one that folds the machine most is made, in turn, and after how
# many hops in a row without a gain they end. Every other hop is made as it is drawn, as on one site of six the machine
# has to reach out. Measured on 63 sites with 88 random hops from each motion: 0.85 (backhoe) and 0.89 (telescope) of
# the cost is left after twelve then, 0.84 and 0.88 if all are chosen, and 0.87 and 0.93 if none is; to choose by
# moments of inertia or by potential energy gains no more. They descend on a coarse curve first: as much of the cost is
# left after half of the hops. With 4 or 8 pieces it is 1.03 and 1.00 of that. With four in a row without a gain hops
# take a third less time, but of 168 plans of the backhoe four cost 1.01, 1.07, 1.07 and 1.39 times as much
_FEW_JOINTS, _DRAWN, _DULL = 5, (8, 1), 6
# the same after a hard search, see `_HARD`: of 67 plans of backhoe and telescope, on which it was chosen, three then
# cost 0.37, 0.76 and 0.81 times as much and one 1.007 times, in 1.09 times the mean time; with 24 it is the same
_DULL_OF_HARD = 12
# the same with more joints: of 128 hops of seven joints as they are drawn none gains. On 42 plans of the Panda three
# cost 0.80 to 0.83 times as much with these, in 1.02 of the time, and with twelve without a gain it is 1.26. A coarse
# curve first gains no more, and takes longer
_DRAWN_OF_MANY, _DULL_OF_MANY = (8, 8), 4
# rad or m that the fastest joint moves aside at most, in turn, and others in proportion to their velocity limits; and
# the least part of that. Measured on six sites where some hops gain 10 % and more: with parts from 0.3 on 27 of 100 do,
# with all parts, up to 0.5 and 1 rad, 18
_ASIDE, _LEAST_ASIDE = (0.7, 1.0), 0.3
_SKEW = 0.5  # a joint moves aside most where a power of u, between e^-0.5 and e^0.5, is a half; chosen
# times the cost of the best, up to which other motions get standstills too, as many as `Effort.ways_at_once`; chosen: a
# standstill takes up to two thirds of the cost
_STILL_WORTH = 2.0
_PLACES = np.linspace(0.0, 1.0, 9)[1:-1]  # of a curve, at which it is seen how far the machine reaches out; chosen


class Refining:
    """Refines the best motion of a search, and what costs little more.

    Parameters
    ----------
    descents: of the search.

    Attributes
    ----------
    before: the best motion before it was refined; None until then.
    """

    def __init__(self, world: World, descents: CostDescents) -> None:
        self._problem, self._work, self._seed = world.problem, world.work, world.seed
        self._first_gain = _FIRST_GAIN_FRUGAL if is_frugal(world) else _FIRST_GAIN
        self._little, self._lift = little_cost(world), lift_of(world.problem)
        self._descents, self._kinematics = descents, BatchKinematics(world.problem.robot)
        self.before: FoundMotion | None = None
        self._rounds_before: int | None = None
        self._coarse: float | None = None  # the cost of the best before it had more pieces

    @property
    def rounds_before(self) -> int:
        """How many rounds the descents have made, without those of refining."""
        return self._descents.rounds.made if self._rounds_before is None else self._rounds_before

    @property
    def cost_before(self) -> float:
        """The cost of the best without refining; infinite if there is none."""
        found = self.before or self._descents.best
        return np.inf if found is None else found.cost

    @property
    def gained(self) -> float:
        """The part of its cost that curves of more pieces took from the best; 0 if it was not refined."""
        best = self._descents.best
        return 1.0 - best.cost / self._coarse if best is not None and self._coarse is not None else 0.0

    def run(self) -> None:
        """Refine the best motion, unless in a hurry."""
        best = self._descents.best
        self._descents.rounds.reserve(0)
        self.before, self._rounds_before = best, self._descents.rounds.made
        if best is None or self._work.effort.is_hurried:
            return
        self._hop()
        self._descents.rounds.reserve(0)
        self._refine_in_turn()
        self._let_stand_still()

    def _refine_in_turn(self) -> None:
        """Refine the best motion on curves of more pieces in turn.

        If the first of these makes it clearly cheaper, motions that cost little more are refined too: the costs before
        say little about those after. If its cost counts as little, only the best is refined, at most twice and not to
        the last.
        """
        best = self._best()
        self._coarse = best.cost
        others = self._others(_NEARLY_AS_CHEAP, _OTHERS_REFINED)
        most = max(_MOST_FINE // self._problem.robot.n, _FINER_PIECES[0])
        for turn, pieces in enumerate(min(each, most) for each in _FINER_PIECES):
            before = self._best()
            if not self._refine(before, pieces):
                return
            best = self._best()
            if best.cost > (1.0 - (_NEXT_GAIN if turn else self._first_gain)) * before.cost:
                return
            is_little = best.cost <= self._little
            if turn > 0 and is_little:
                return
            if turn == 0 and not is_little and not all(self._refine(other, pieces) for other in others):
                return

    def _hop(self) -> None:
        """Descents from beside the best motion, each from the best so far, until some in a row gain little.

        Basin hopping (Wales and Doye 1997) without worse motions in between. Only for little work, see `_HOPPED`.
        """
        problem, work, lift = self._problem, self._work, self._lift
        if not work.hop_rounds or lift is None or problem.objective.jumps:
            return
        if not _HOPPED[0] * lift.little < self._best().cost <= _HOPPED[1] * lift.little:
            return
        rounds = self._descents.rounds
        rounds.reserve(max(rounds.left, 0))  # hops have rounds of their own, and finer curves need theirs
        work.add_rounds("hop_rounds")
        few = problem.robot.n <= _FEW_JOINTS
        dull_of_few = _DULL_OF_HARD if self.rounds_before > _HARD else _DULL
        drawn, patience = (_DRAWN, dull_of_few) if few else (_DRAWN_OF_MANY, _DULL_OF_MANY)
        rng, dull = np.random.default_rng(self._seed), 0
        for most, count in itertools.islice(itertools.cycle(itertools.product(_ASIDE, drawn)), _HOPS):
            best = self._best()
            if best.curve is None or best.cost <= self._little or rounds.left_of_cost < FINE_ROUNDS:
                return
            beside = self._beside(best.curve, most, rng, count)
            start = Start(beside, self._descents.incumbent.longest, best.goal, best.way)
            self._descents.descend(self._descents.bent_coarsely(start) if few else start, hops=True)
            dull = 0 if self._best().cost <= (1.0 - _HOP_GAINS) * best.cost else dull + 1
            if dull == patience:
                return

    def _let_stand_still(self) -> None:
        """Put standstills into the best motion and into others that do not cost much more, if the cost jumps.

        The best of these is not always the one that was the best before.
        """
        if not self._problem.objective.jumps:
            return
        best, own_time, incumbent = self._best(), self._descents.own_time, self._descents.incumbent
        others = self._others(_STILL_WORTH, self._work.effort.ways_at_once)

        def motion_along(curve: JointCurve, duration: float) -> Trajectory:
            return time_evenly(curve, duration, self._problem.limits, drive=own_time.drive)

        def is_allowed(curve: JointCurve, duration: float) -> bool:
            if own_time.least_duration(curve, duration) > incumbent.longest or not self._descents.keeps(curve):
                return False
            return motion_along(curve, duration).duration <= incumbent.longest

        for found in (best, *others):
            if found.curve is None:
                continue
            still = with_standstills(own_time, found.curve, found.motion.duration, is_allowed, brake=self._work.brake)
            if still is not found.curve:
                motion = motion_along(still, found.motion.duration)
                incumbent.offer(replace(found, motion=motion, cost=motion_cost(self._problem, motion), curve=still))

    def _beside(self, curve: JointCurve, most: float, rng: np.random.Generator, count: int) -> JointCurve:
        """The most folded of `count` random curves beside this one, all joints up to `most` aside, see `_ASIDE`."""
        limits, drawn = self._problem.limits, []
        unit = limits.velocity / np.max(limits.velocity)
        for _ in range(count):
            side, part = rng.choice((-1.0, 1.0), len(unit)), rng.uniform(_LEAST_ASIDE, 1.0, len(unit))
            skew = np.exp(rng.uniform(-_SKEW, _SKEW, len(unit)))
            drawn.append(curve.moved_aside(most * side * part * unit, skew, limits))
        return min(drawn, key=self._reach)

    def _reach(self, curve: JointCurve) -> float:
        """How far the tip is from the first joint on the way, in the mean [m]."""
        at = self._kinematics.at(curve.at(_PLACES))
        return float(np.mean(np.linalg.norm(at.tip_position - at.origins[:, 0], axis=1)))

    def _best(self) -> FoundMotion:
        assert self._descents.best is not None
        return self._descents.best

    def _others(self, times: float, count: int) -> list[FoundMotion]:
        """At most so many other ends of descents, the cheapest first, up to so many times the cost of the best."""
        best, ended = self._best(), self._descents.ended
        others = [one for one in ended if one is not best and one.curve is not None and one.cost <= times * best.cost]
        return sorted(others, key=lambda one: one.cost)[:count]

    def _refine(self, found: FoundMotion, pieces: int) -> bool:
        """Descend from a found motion on a curve of more pieces; false if too few rounds are left for that."""
        limits, descents, curve = self._problem.limits, self._descents, found.curve
        if descents.rounds.left_of_cost < FINE_ROUNDS:
            return False
        if curve is None:
            curve = JointCurve.fitted(found.motion, FINE_PIECES, limits)
        duration = min(found.motion.duration, descents.incumbent.longest)
        rounds = FINE_ROUNDS * _FINER * descents.more
        # small gains of a cost that counts as little take half of the time of many plans
        enough = ENOUGH_ROUGH if found.cost <= self._little else ENOUGH
        descents.descend_finely(found, curve.finer(pieces, limits.velocity), duration, rounds, enough=enough)
        return True
