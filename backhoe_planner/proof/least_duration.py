"""A lower bound of the duration of every motion to a goal: branch and bound over boxes of configurations.

The bound of a box is the least time in which the joints get to any of its configurations from rest to
rest (`least_times`). A box is dropped if none of its configurations is on the goal (`box_tests`).
Its bound rises to t if none of its configurations that can be reached in the time t is on the goal. The
bound of all motions is the least bound of the boxes that are left; the box with the least bound is halved.

Obstacles and the limits of torque and engine power are not considered: they can only make
motions slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.proof.box_tests import DirectionTest, bends, best_directions, contracted, missed_up_to
from backhoe_planner.proof.goal_features import GoalRegion, goal_regions
from backhoe_planner.proof.least_times import LeastTimes

_NEAR = 0.01  # part of a known duration: a bound nearer to it than this is near enough; chosen
_AT_ONCE = 128  # boxes that are halved together; chosen: more are cheaper each, but fewer of them have the least bound
_SHORTEST, _LONGEST = 0.25, 120.0  # s: the shortest and longest times up to which a bound is sought; chosen
_FURTHER = 2.0  # factor to the next such time if no motion is that short: a shorter time gives a finer bound; chosen
# s: such times for a first rough bound; chosen: without 4, all takes a fifteenth longer
_ROUGHLY = (4.0, 16.0, 128.0)
_REACHED = 0.98  # part of such a time above which the true bound may be larger; a search ends at 0.99
_LEVELS = 256  # times at which boxes are tested; chosen: they are two fifths of a percent apart
_INNERMOST = 26  # least number of levels that the first box covers; chosen, a tenth
_NEXT_SHELL = 1.25  # ratio of the levels at which a shell ends and begins; chosen among 1.1 to 3 on random sites

_KNOWN: WeakKeyDictionary[Problem, dict[tuple[bytes, int], float]] = WeakKeyDictionary()  # bounds of all motions


@dataclass(frozen=True)
class LeastDuration:
    """A lower bound on the duration of every motion to the goal.

    Attributes
    ----------
    duration: the lower bound [s].
    settled: whether the search ended because the bound is near the known duration.
    boxes: number of boxes that were examined.
    """

    duration: float
    settled: bool
    boxes: int


def least_duration(
    problem: Problem, start: Vector, *, known: float, end: Vector | None = None, boxes: int
) -> LeastDuration:
    """A lower bound of the duration of every motion from rest at `start` to rest on the goal.

    It holds for every motion that the certificate would accept, including its tolerances for sampled motions.

    Parameters
    ----------
    problem: a problem with a goal.
    start: (n,) the configuration at rest at the start [rad or m].
    known: the duration of one motion [s]; the search stops within 1 % of it.
    end: (n,) the end of that motion [rad or m]; the search also stops within 1 % of the least
        time in which the joints get there without obstacles.
    boxes: the greatest number of boxes to examine.
    """
    if known <= 0.0:
        return LeastDuration(0.0, True, 0)
    times = LeastTimes(problem, start, longest=known)
    if end is not None:
        known = float(times.to_boxes(end[None], end[None])[0])
    return _least_of(times, goal_regions(problem), (1.0 - _NEAR) * known, boxes=boxes)


def least_duration_of_all(problem: Problem, start: Vector, *, boxes: int) -> float:
    """A lower bound on the duration of every motion from rest at `start` (n,) to the goal [s], if no motion is known.

    A bound is finer if it is sought up to a shorter time: a known slow motion makes that of `least_duration` weaker.
    A search with the effort `normal` and its plan need the same bound, so it is kept as long as the problem.

    Parameters
    ----------
    boxes: the greatest number of boxes to examine in each search.
    """
    known = _KNOWN.setdefault(problem, {})
    key = start.tobytes(), boxes
    if key not in known:
        known[key] = _least_of_all(problem, start, boxes)
    return known[key]


def _least_of_all(problem: Problem, start: Vector, boxes: int) -> float:
    goals = goal_regions(problem)
    most, above = _SHORTEST, _about(problem, start, goals)
    while most < above:
        most *= _FURTHER
    while True:
        times, target = LeastTimes(problem, start, longest=most), (1.0 - _NEAR) * most
        bound = _least_of(times, goals, target, boxes=boxes).duration
        if bound < _REACHED * most or most >= _LONGEST:
            return bound
        most *= _FURTHER


def _about(problem: Problem, start: Vector, goals: Sequence[GoalRegion]) -> float:
    """A weak lower bound for all motions to `goals` [s], from the first boxes alone."""
    found = 0.0
    for longest in _ROUGHLY:
        times = LeastTimes(problem, start, longest=longest)
        found = _least_of(times, goals, (1.0 - _NEAR) * longest, boxes=0).duration
        if found < _REACHED * longest:
            break
    return found


def _least_of(times: LeastTimes, goals: Sequence[GoalRegion], target: float, *, boxes: int) -> LeastDuration:
    """The least bound for any of `goals`, at most `target` [s], from at most about `boxes` boxes."""
    searches = [_Search(times, goal, target) for goal in goals]
    looked = sum(search.looked for search in searches)
    while looked < boxes and any(len(search.open) for search in searches):
        lowest = min(searches, key=lambda search: search.least)
        before = lowest.looked
        lowest.run(before + 1)
        looked += lowest.looked - before
    least = min((search.least for search in searches), default=target)
    return LeastDuration(least, not any(len(search.open) for search in searches), looked)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """B boxes.

    Attributes
    ----------
    lower, upper: (B, n) [rad or m].
    bound: (B,) lower bound of the time to any configuration on the goal in each box [s].
    joint: (B,) the joint in which each box is to be halved.
    """

    lower: Matrix
    upper: Matrix
    bound: Vector
    joint: Indices

    def __len__(self) -> int:
        return len(self.bound)

    def take(self, rows: Indices) -> _Boxes:
        """The boxes at `rows`."""
        return _Boxes(self.lower[rows], self.upper[rows], self.bound[rows], self.joint[rows])

    def with_others(self, other: _Boxes) -> _Boxes:
        """These boxes and the others."""
        return _Boxes(
            np.vstack((self.lower, other.lower)), np.vstack((self.upper, other.upper)),
            np.append(self.bound, other.bound), np.append(self.joint, other.joint),
        )  # fmt: skip

    def halved(self) -> tuple[Matrix, Matrix]:
        """(2 B, n), (2 B, n) the lower halves, then the upper ones."""
        rows = np.arange(len(self))
        middle = 0.5 * (self.lower[rows, self.joint] + self.upper[rows, self.joint])
        below, above = self.upper.copy(), self.lower.copy()
        below[rows, self.joint] = above[rows, self.joint] = middle
        return np.vstack((self.lower, above)), np.vstack((below, self.upper))


class _Search:
    """The search for one goal, below the time `target` [s].

    Attributes
    ----------
    open: the boxes that may contain a configuration on the goal that is reached in less than the target.
    looked: number of boxes that were examined.
    """

    def __init__(self, times: LeastTimes, goal: GoalRegion, target: float) -> None:
        self._times, self._goal, self._target = times, goal, target
        self._level = np.linspace(0.0, target, _LEVELS + 1)
        down, up = times.reach(self._level)
        self._from, self._to = times.start - down, times.start + up
        lower, upper = self._shells()
        self.open = self._look(lower, upper, np.zeros(len(lower)))
        self.looked = len(self._level) + len(lower)

    @property
    def least(self) -> float:
        """The lower bound for this goal, at most the target [s]."""
        return float(np.min(self.open.bound, initial=self._target))

    def run(self, most: int) -> None:
        """Halve boxes until none is left, or `most` have been examined."""
        while len(self.open) and self.looked < most:
            count = min(_AT_ONCE, len(self.open))
            order = np.argpartition(self.open.bound, count - 1)
            lowest = self.open.take(order[:count])
            found = self._look(*lowest.halved(), np.tile(lowest.bound, 2))
            self.looked += 2 * count
            self.open = self.open.take(order[count:]).with_others(found)

    def _shells(self) -> tuple[Matrix, Matrix]:
        """(B, n), (B, n) boxes that cover all that is reached within the target, in nested shells.

        Inner levels that miss the goal are left out. In each box of a shell one joint is far from the
        start, so that the box has a bound from the beginning.
        """
        features = self._goal.features(self._from, self._to)
        low, high = self._from - features.middle, self._to - features.middle
        missed = DirectionTest(features, best_directions(features, low, high)).misses(low, high)
        inner = int(np.max(np.flatnonzero(missed), initial=0))
        lower, upper = [], []
        if inner < _INNERMOST:
            inner = _INNERMOST
            lower.append(self._from[inner])
            upper.append(self._to[inner])
        while inner < _LEVELS:
            outer = int(_NEXT_SHELL * inner) if _NEXT_SHELL**2 * inner < _LEVELS else _LEVELS
            (a, b), (c, d) = self._from[[outer, inner]], self._to[[inner, outer]]
            for joint in range(len(a)):
                for least, most in ((a[joint], b[joint]), (c[joint], d[joint])):
                    if least == most:  # the joint is at its limit
                        continue
                    lower.append(np.concatenate((b[:joint], [least], a[joint + 1 :])))
                    upper.append(np.concatenate((c[:joint], [most], d[joint + 1 :])))
            inner = outer
        return np.reshape(lower, (-1, len(self._times.start))), np.reshape(upper, (-1, len(self._times.start)))

    def _look(self, lower: Matrix, upper: Matrix, bound: Vector) -> _Boxes:
        """The boxes that remain of those with these bounds, each contracted."""
        if not len(lower) or self._target <= 0.0:
            return _Boxes(lower[:0], upper[:0], bound[:0], np.zeros(0, dtype=np.intp))
        features = self._goal.features(lower, upper)
        half = 0.5 * (upper - lower)
        known = np.minimum((bound / self._target * _LEVELS).astype(np.intp), _LEVELS - 1)
        missed = missed_up_to(*features.tests, features.middle, lower, upper, self._from, self._to, known)
        bound = np.maximum(bound, self._level[missed])
        least, most = contracted(*features.tests, half)
        rows = np.flatnonzero((bound < self._target) & (least <= most).all(axis=1))
        lower, upper = (features.middle + least)[rows], (features.middle + most)[rows]
        bound = np.maximum(bound[rows], self._times.to_boxes(lower, upper))
        joint = np.argmax(bends(features, 0.5 * (most - least))[rows], axis=1)
        found = _Boxes(lower, upper, bound, joint)
        return found.take(np.flatnonzero(bound < self._target))
