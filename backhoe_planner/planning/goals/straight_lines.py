"""Straight lines of the joints to the postures on a goal: what is tried first."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.starts import Start
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.site import ClearanceScreen

STRAIGHT = "straight for the joints"
_PLACES = 25  # of a line, by which it is looked at as a whole; chosen, about every 2 to 10 cm of the tip
_SOONEST = 4  # postures of which one is then chosen
_MOST_BLOCKED = 0.3  # part of the line that may then not be clear; chosen
_APART = 0.03  # part of the longest time: joint time between two postures to which lines are drawn at all; chosen


class StraightLines:
    """Straight lines from one start.

    Parameters
    ----------
    start: (n,) where the machine stands [rad or m].
    ends: the postures; what is found later counts too.
    screen: of the obstacles.
    pieces: of each curve.
    """

    def __init__(self, start: Vector, ends: GoalEnds, screen: ClearanceScreen, *, pieces: int) -> None:
        self._start, self._ends, self._screen, self._pieces = start, ends, screen, pieces

    def to(self, index: int) -> Start:
        """The line to one of the postures, in the least time to it."""
        ends = self._ends
        line = JointCurve.straight(self._start, ends.postures[index], self._pieces)
        return Start(line, ends.least[index], ends.goals[index], STRAIGHT)

    def within(self, longest: float) -> list[Start]:
        """Lines to postures that can be reached in `longest` [s], the soonest of those near each other."""
        return [self.to(index) for index in self._ends.within(longest, _APART * longest)]

    def least_blocked(self) -> list[int]:
        """The one of the soonest postures to which the line is most nearly clear, if that is enough."""
        part = np.linspace(0.0, 1.0, _PLACES)[:, None]
        blocked: list[float] = []
        for index in self._ends.order[:_SOONEST]:
            line = self._start + part * (self._ends.postures[index] - self._start)
            blocked.append(1.0 - float(np.mean(self._screen.keeps(line))))
            if not blocked[-1]:
                break
        best = int(np.argmin(blocked))
        return [self._ends.order[best]] if blocked[best] <= _MOST_BLOCKED else []
