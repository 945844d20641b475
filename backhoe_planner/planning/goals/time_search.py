"""The search for the fastest motion to a goal."""

from __future__ import annotations

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.goals.goal_postures import GoalPostures
from backhoe_planner.planning.goals.motion_search import MotionSearch
from backhoe_planner.planning.multistart.incumbent import Incumbent
from backhoe_planner.planning.multistart.time_descents import LEAST_GAIN, TimeDescents, holds_end
from backhoe_planner.planning.world.world import World

_MORE_POSTURES = 4  # times the usual starting points, if more postures are looked for; chosen
# times the bound, from which there is more patience, and its factor; chosen
_PATIENCE = ((2.0, 4), (1.4, 3), (1.1, 2))
# times the least time to any posture, from which another search may find a much shorter motion; chosen: on random
# sites of backhoe, Panda and telescope one motion in fifty takes longer
_MUCH_LONGER = 1.5
_END_GAIN = 0.15  # part of the least time to a posture that may be gained if the end can move on the goal; chosen


class TimeSearch(MotionSearch):
    """A search for the fastest motion from one start.

    It ends as soon as the best takes little more than the joints need to any posture on the goals.

    Parameters
    ----------
    enough: a motion as fast as this ends the search [s].
    """

    _descents: TimeDescents

    def __init__(
        self, world: World, start: Vector, found: GoalPostures, *, time: float, enough: float = 0.0
    ) -> None:  # fmt: skip
        super().__init__(world, start, found, Incumbent(world, time=time), time=time, more=_MORE_POSTURES)
        self._descents = TimeDescents(world, start, self.ends, self._incumbent, time=time)
        self._enough = enough

    def _search(self) -> None:
        self._go_straight()
        self._go_round(0)
        if not self._is_enough():
            self._descents.refine()

    @property
    def takes_long(self) -> bool:
        """Whether the best takes much longer than the joints need to some posture."""
        return self.best is not None and not self._gap.is_within(_MUCH_LONGER)

    def _is_enough(self) -> bool:
        """Whether a motion as fast as `enough` is known."""
        return self.best is not None and self.best.motion.duration <= self._enough

    def _is_optimal(self) -> bool:
        """Whether no motion can be faster by more than `LEAST_GAIN`, or one is as fast as `enough`."""
        if self._is_enough():
            return True
        return self.best is not None and not self._hurried and self._gap.is_within(1.0 + LEAST_GAIN)

    def _is_open(self, index: int) -> bool:
        if self.best is None:
            return True
        worth = 1.0 + LEAST_GAIN if holds_end(self._problem, self.ends.goals[index]) else 1.0 - _END_GAIN
        return self.best.motion.duration > worth * self.ends.least[index]

    def _patience(self) -> int:
        """More the further the best is above the bound, and less if nothing is near it."""
        assert self.best is not None
        usual = self._world.work.effort.dull_searches
        if self._hurried:
            return 0
        if self._gap.is_near():
            return usual - self.best.free
        return usual * next((factor for part, factor in _PATIENCE if self._gap.is_above(part)), 1)
