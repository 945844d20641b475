"""The postures in which a motion may end, and how soon each can be reached."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Goal, Problem
from backhoe_planner.planning.search.postures import find_distinct
from backhoe_planner.proof import LeastTimes

_LONGEST = 120.0  # s up to which least times are computed; chosen, above all motions between two postures
# part of the longest time that two of many postures are apart at least, and the factor on it while they are too many;
# chosen
_APART, _FURTHER = 0.005, 1.4
_SAME = 0.01  # rad or m: postures nearer than this count as one; chosen, less than a descent moves an end


class GoalEnds:
    """Postures on the goals of a problem, each with the least time to it from a start.

    Parameters
    ----------
    start: (n,) where motions begin [rad or m].

    Attributes
    ----------
    postures: (n,) each [rad or m], in the order in which they were found.
    goals: the goal of each posture.
    least: a lower bound on the duration of any motion to each posture [s].
    order: indices of the postures, the soonest first.
    """

    def __init__(self, problem: Problem, start: Vector) -> None:
        self._rate = problem.limits.velocity
        self._least_times = LeastTimes(problem, start, longest=_LONGEST)
        self.postures: list[Vector] = []
        self.goals: list[Goal] = []
        self.least: list[float] = []
        self.order: list[int] = []

    def take(self, postures: Sequence[Vector], goals: Sequence[Goal]) -> list[int]:
        """Add postures that are not known yet, each with its goal; the indices of those added, the soonest first."""
        before = len(self.postures)
        known = np.array(self.postures).reshape(-1, len(self._rate))
        for index in find_distinct(np.array(postures).reshape(-1, len(self._rate)), _SAME, known):
            self.postures.append(postures[index])
            self.goals.append(goals[index])
        if len(self.postures) > before:
            ends = np.array(self.postures[before:])
            self.least += self._least_times.to_boxes(ends, ends).tolist()
        self.order = sorted(range(len(self.postures)), key=lambda index: self.least[index])
        return [index for index in self.order if index >= before]

    def at(self, which: Sequence[int]) -> Matrix:
        """(K, n) the postures `which`."""
        return np.array([self.postures[index] for index in which]).reshape(-1, len(self._rate))

    def nearest(self, which: Sequence[int], q: Vector) -> int:
        """The index of the posture nearest to `q` (n,) among `which`."""
        return min(which, key=lambda index: float(np.max(np.abs(self.postures[index] - q))))

    def within(self, longest: float, apart: float) -> list[int]:
        """Postures reachable in `longest` [s]; of those not further than `apart` [s of joint time] only the soonest."""
        soon = self._within(longest)
        return [soon[row] for row in find_distinct(self.at(soon) / self._rate, apart)]

    def many_within(self, longest: float, *, most: int, alike: Vector) -> list[int]:
        """Postures reachable in `longest` [s], at most `most`: of those near each other only the soonest.

        Parameters
        ----------
        alike: (n,) how far each joint may turn or slide in a second that count alike [rad/s or m/s].
        """
        soon = self._within(longest)
        places, apart = self.at(soon) / alike, _APART * longest
        found = find_distinct(places, apart)
        while len(found) > most:
            apart *= _FURTHER
            found = find_distinct(places, apart)
        return [soon[row] for row in found]

    def _within(self, longest: float) -> list[int]:
        """All postures reachable in `longest` [s], the soonest first."""
        return [index for index in self.order if self.least[index] <= longest]

    def least_to(self, q: Vector) -> float:
        """A lower bound on the duration of any motion from the start to `q` (n,) [s]."""
        return float(self._least_times.to_boxes(q[None, :], q[None, :])[0])
