"""The best motion of a search for another cost than the time is improved again, on ever finer curves."""

from __future__ import annotations

import numpy as np

from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.lift import is_frugal, little_cost
from backhoe_planner.planning.multistart.motion_descents import FINE_PIECES, FINE_ROUNDS
from backhoe_planner.planning.world.world import World

# of the best curve, in turn, with pieces of different lengths; and the most pieces times joints, because the programs
# take ever longer; chosen: 36 pieces of seven joints take 1 to 2 s, and mostly gain too little before to be tried
_FINER_PIECES, _MOST_FINE = (20, 28, 36, 36, 36), 252
# part of the cost that each refinement must gain for the next to follow; chosen: if the first gains less, the next
# mostly gain nothing, and if it gains more, they may gain a third
_MUCH_GAIN = (0.01, 0.05, 0.1, 0.1)
_MUCH_GAIN_FRUGAL = (0.04, 0.05, 0.1, 0.1)  # the same for frugal searches; measured: the next gains a quarter of a gain
_FINER = 8  # times more fine rounds for another cost than the time; chosen
# other motions that are refined if refining pays, and up to how many times the cost of the best; chosen
_OTHERS_REFINED, _NEARLY_AS_CHEAP = 2, 1.2


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
        self._problem, self._hurried = world.problem, world.work.effort.is_hurried
        self._much = _MUCH_GAIN_FRUGAL if is_frugal(world) else _MUCH_GAIN
        self._little = little_cost(world)
        self._descents = descents
        self.before: FoundMotion | None = None
        self._rounds_before: int | None = None

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
        """The part of its cost that refining took from the best; 0 if it was not refined."""
        best = self._descents.best
        return 1.0 - best.cost / self.cost_before if best is not None and self.before else 0.0

    def run(self) -> None:
        """Refine the best motion on curves of more pieces in turn, unless in a hurry.

        If the first of these makes it clearly cheaper, motions that cost little more are refined too: the costs before
        say little about those after. A cost that counts as little is refined once.
        """
        best = self._descents.best
        self._descents.rounds.reserve(0)
        self.before, self._rounds_before = best, self._descents.rounds.made
        if best is None or self._hurried:
            return
        others = [] if best.cost <= self._little else self._nearly_as_cheap(best)
        finer = [pieces for pieces in _FINER_PIECES if pieces * self._problem.robot.n <= _MOST_FINE]
        for turn, pieces in enumerate(finer or _FINER_PIECES[:1]):
            before = self._best()
            if not self._refine(before, pieces) or turn == len(self._much):
                return
            cost = self._best().cost
            if cost > (1.0 - self._much[turn]) * before.cost or cost <= self._little:
                return
            if turn == 0 and not all(self._refine(other, pieces) for other in others):
                return

    def _best(self) -> FoundMotion:
        assert self._descents.best is not None
        return self._descents.best

    def _nearly_as_cheap(self, best: FoundMotion) -> list[FoundMotion]:
        """The cheapest other motions at which descents ended, if they cost little more than the best."""
        most = _NEARLY_AS_CHEAP * best.cost
        others = [one for one in self._descents.ended if one is not best and one.curve is not None and one.cost <= most]
        return sorted(others, key=lambda one: one.cost)[:_OTHERS_REFINED]

    def _refine(self, found: FoundMotion, pieces: int) -> bool:
        """Descend from a found motion on a curve of more pieces; false if too few rounds are left for that."""
        limits, descents, curve = self._problem.limits, self._descents, found.curve
        if descents.rounds.left_of_cost < FINE_ROUNDS:
            return False
        if curve is None:
            curve = JointCurve.fitted(found.motion, FINE_PIECES, limits)
        duration = min(found.motion.duration, descents.incumbent.longest)
        rounds = FINE_ROUNDS * _FINER * descents.more
        descents.descend_finely(found, curve.finer(pieces, limits.velocity), duration, rounds)
        return True
