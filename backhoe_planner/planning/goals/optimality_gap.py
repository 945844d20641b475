"""How much shorter than the best motion another one may be: the gap between its duration and lower bounds."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import least_duration

_WORTH = 1.4  # times the best cost, up to which a route is worth a descent; chosen
_WORTH_MORE = 2.0  # times the relative excess of the best over the bound: by so much a route may cost more; chosen
# parts of the logarithmic distance from the best duration to the bound, by which a route's longest time is below the
# best, in turn; chosen
_SHORTER = (0.25, 0.5, 0.0, 0.5)
_NEAR = 1.1  # times the least time to any posture, up to which a motion counts as near the best possible; chosen
_FEWER_BOXES = 4  # times fewer for the bound of the search than for that of the plan; chosen


class OptimalityGap:
    """The best motion of a search in comparison with what no motion falls short of.

    Parameters
    ----------
    start: (n,) where motions begin [rad or m].
    ends: the postures; those found later count too.
    incumbent: has the best motion.
    """

    def __init__(self, world: World, start: Vector, ends: GoalEnds, incumbent: Incumbent) -> None:
        self._problem, self._boxes = world.problem, world.work.effort.boxes // _FEWER_BOXES
        self._start, self._ends, self._incumbent = start, ends, incumbent
        self._bound = 0.0  # lower bound of the duration [s]; computed if the best is not near the least time

    def least_time(self) -> float:
        """A lower bound on the duration of any motion to a known posture [s]."""
        best = self._incumbent.best
        own = np.inf if best is None else self._ends.least_to(best.motion.q[-1])
        return min(own, *self._ends.least)

    def is_within(self, factor: float) -> bool:
        """Whether the best takes at most `factor` times the least time to any known posture."""
        return self._best.motion.duration <= factor * self.least_time()

    def is_near(self) -> bool:
        """Whether the best is near the least time to any known posture; if not, a bound for all motions is proven."""
        best = self._best.motion
        if best.duration < _NEAR * self.least_time():
            return True
        if not self._bound:
            self._bound = self._bound_above(best)
        return False

    def is_above(self, factor: float) -> bool:
        """Whether the best costs more than `factor` times the bound that was proven, or 0."""
        return self._best.cost > factor * self._bound

    def dearest_worth(self) -> float:
        """The highest cost of a route that is worth a descent: little above the best if little can be gained."""
        best, least = self._best, self._bound or self.least_time()
        above = best.cost / least - 1.0 if least else np.inf
        return best.cost * min(_WORTH, 1.0 + _WORTH_MORE * above)

    def longest_worth(self, dull: int) -> float:
        """The longest estimated time of a route [s], after some vain turns: mostly much less than the best duration."""
        best = self._best.motion.duration
        if self.is_near() or not self._bound:
            return best
        return float(best * (self._bound / best) ** _SHORTER[dull % len(_SHORTER)])

    @property
    def _best(self) -> FoundMotion:
        assert self._incumbent.best is not None
        return self._incumbent.best

    def _bound_above(self, known: Trajectory) -> float:
        """A lower bound on the duration of any motion [s], from fewer boxes than the plan's; `known` is one motion."""
        return least_duration(
            self._problem, self._start, known=known.duration, end=known.q[-1], boxes=self._boxes
        ).duration
