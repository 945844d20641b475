"""The best motion of a search so far, in the words of branch and bound its incumbent, and what replaces it.

A motion counts only if it is proven clear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.motion import Goal, Trajectory
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import motion_is_clear


@dataclass(frozen=True, eq=False)
class FoundMotion:
    """A motion to a goal.

    Attributes
    ----------
    motion: from rest to rest, its time from 0.
    cost: by the problem's objective.
    goal: where it ends.
    way: how it was found, in words.
    curve: the curve that is run over the motion's time at an even pace; None if there is none.
    free: whether it is known that nothing is near it, so that it does not go around anything.
    """

    motion: Trajectory
    cost: float
    goal: Goal
    way: str
    curve: JointCurve | None = None
    free: bool = False


class Incumbent:
    """The best motion of one search.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].

    Attributes
    ----------
    best: the best motion so far; None if there is none.
    longest: the longest time that a motion may take [s]: one that takes longer is worse than any that does not.
        Infinite if the time is the cost, or while it is not known; may be set.
    """

    def __init__(
        self, world: World, *, time: float, longest: float = np.inf, best: FoundMotion | None = None
    ) -> None:  # fmt: skip
        self._world, self._time = world, time
        self.longest, self.best = longest, best
        self._first = best
        self._bests = 0  # how many motions were the best so far

    @property
    def has_improved(self) -> bool:
        """Whether the best is another motion than at first."""
        return self.best is not self._first

    def offer(self, found: FoundMotion) -> bool:
        """Keep a motion if it is better than the best; whether it is proven clear, or too dear to be checked."""
        if not self._is_dear(found):
            if not (self._world.keeps(found.motion) and self._is_proven(found.motion)):
                return False
            self.best = found
            self._bests += 1
            self._world.show(found.motion, attempt=self._bests, best=found.cost)
        return True

    def _is_dear(self, found: FoundMotion) -> bool:
        """Whether a motion is no better than the best; one beyond the longest time is worse than any within it."""
        one, best = ((each.motion.duration > self.longest, each.cost) for each in (found, self.best or found))
        return self.best is not None and one >= best

    def _is_proven(self, motion: Trajectory) -> bool:
        proximity = self._world.proximity
        proximity.cover_unchecked(motion.q)
        return motion_is_clear(proximity, np.full(len(motion), self._time), motion.q)
