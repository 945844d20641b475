"""Straight lines in joint space to the postures on a goal, which are tried first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.site import ClearanceScreen

STRAIGHT = "straight for the joints"
_PLACES = 25  # of a line, that are checked; chosen, about every 2 to 10 cm of the tip
_SOONEST = 4  # postures, of which the one with the clearest line is chosen
_MOST_BLOCKED = 0.3  # part of that line that may be blocked; chosen
_APART = 0.03  # part of the longest time: least joint time between two postures that both get a line; chosen


class StraightLines:
    """Straight lines from one start.

    Parameters
    ----------
    start: (n,) where the machine is [rad or m].
    ends: the postures; those found later count too.
    screen: of the obstacles.
    pieces: of each curve.
    """

    def __init__(self, start: Vector, ends: GoalEnds, screen: ClearanceScreen, *, pieces: int) -> None:
        self._start, self._ends, self._screen, self._pieces = start, ends, screen, pieces

    def to(self, index: int) -> Start:
        """The line to one of the postures, over the least time to it."""
        return self._to_each([index])[0]

    def _to_each(self, which: Sequence[int]) -> list[Start]:
        ends = self._ends
        lines = JointCurve.straight_to_each(self._start, ends.at(which), self._pieces)
        return [
            Start(line, ends.least[index], ends.goals[index], STRAIGHT)
            for line, index in zip(lines, which, strict=True)
        ]

    def within(self, longest: float) -> list[Start]:
        """Lines to postures that can be reached in `longest` [s]; of postures near each other only the soonest."""
        return self._to_each(self._ends.within(longest, _APART * longest))

    def many_within(self, longest: float, *, most: int, alike: Vector) -> list[Start]:
        """Lines to postures that can be reached in `longest` [s], see `GoalEnds.many_within`."""
        return self._to_each(self._ends.many_within(longest, most=most, alike=alike))

    def least_blocked(self) -> list[int]:
        """Of the soonest postures the one with the least blocked line, if that line is clear enough; otherwise none."""
        part = np.linspace(0.0, 1.0, _PLACES)[:, None]
        blocked: list[float] = []
        for index in self._ends.order[:_SOONEST]:
            line = self._start + part * (self._ends.postures[index] - self._start)
            blocked.append(1.0 - float(np.mean(self._screen.keeps(line))))
            if not blocked[-1]:
                break
        best = int(np.argmin(blocked))
        return [self._ends.order[best]] if blocked[best] <= _MOST_BLOCKED else []
