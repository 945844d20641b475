"""Configurations that put the tip on a target, clear of everything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import (
    BatchKinematics,
    InverseKinematics,
    Kinematics,
    TargetBatch,
    TipTarget,
    solve_batch,
    solve_inverse_kinematics,
)
from backhoe_planner.motion import Problem
from backhoe_planner.site import ClearanceScreen, Obstruction, Proximity

POSTURE_SPARE = 0.003  # m beyond the clearance; chosen: more than the 2 mm kept by a motion that ends there
_ITERATIONS = 20  # of the inverse kinematics from one starting point; chosen, one in fifty needs more
_ITERATIONS_HURRIED = 14  # the same in a hurry; chosen among 12 to 20: some ends are then missed
_SAME = 0.05  # rad or m: chosen, configurations nearer than this count as one
# while more than so many configurations are left, others are looked for around each of so many of them first; chosen
_FEW, _HEADS = 64, 24
_ROUNDED = 1.0 + 1e-6  # times a distance: rounding then hides no neighbour


@dataclass(frozen=True, eq=False)
class PostureResult:
    """The configurations found for one target.

    Attributes
    ----------
    clear: (n,) configurations that keep every clearance [rad or m], the nearest first.
    best: the inverse kinematics' result with the least error; it says whether the target can be reached.
    contact: the mildest collision, if all configurations on the target collide.
    blocked: (K, n) those that collide, if all of them do [rad or m].
    """

    clear: tuple[Vector, ...]
    best: InverseKinematics
    contact: Obstruction | None
    blocked: Matrix


class Postures:
    """Finds configurations for one problem, with one seeded generator."""

    def __init__(
        self, problem: Problem, *, proximity: Proximity, kinematics: Kinematics, rng: np.random.Generator
    ) -> None:
        self._problem = problem
        self._proximity = proximity
        self._kinematics = kinematics
        self._rng = rng
        self._batch = BatchKinematics(problem.robot)

    def at(
        self,
        target: TipTarget,
        *,
        near: Vector | None = None,
        count: int = 24,
        time: float = 0.0,
        hurried: bool = False,
        travel: Vector | None = None,
    ) -> PostureResult:
        """Clear configurations that put the tip on `target`.

        Parameters
        ----------
        near: (n,) the present joint positions [rad or m]: the first starting point. The result is
            sorted by the time that the slowest joint takes from there. By default the middle of the limits.
        count: starting points of the inverse kinematics.
        time: at which the positions of the obstacles are taken [s].
        hurried: whether the inverse kinematics takes fewer steps from each starting point.
        travel: (n,) how far the joints of a starting point may be from `near` [rad or m]; None for anywhere.
        """
        robot = self._problem.robot
        near = robot.middle if near is None else near
        anywhere = self._rng.uniform(*robot.finite_range, (count - 1, robot.n))
        # every other one is between `near` and there: postures near the present one are few, and reached soonest
        part = np.ones(count - 1)
        part[::2] = self._rng.random(len(part[::2]))
        guesses = np.vstack((near, near + part[:, None] * (anywhere - near)))
        if travel is not None:
            low, high = np.maximum(near - travel, robot.limits.lower), np.minimum(near + travel, robot.limits.upper)
            guesses[1:] = self._rng.uniform(low, high, (count - 1, robot.n))
        iterations = _ITERATIONS_HURRIED if hurried else _ITERATIONS
        ends, reached = solve_batch(self._batch, TargetBatch.of([target] * count), guesses, iterations=iterations)
        ends = ends[reached]
        if len(ends):
            best = InverseKinematics(True, ends[0], *target.distances(self._kinematics.at(ends[0])), count)
        else:
            best = solve_inverse_kinematics(robot, target, start=near, rng=self._rng)
            ends = best.q[None, :] if best.reached else ends
        apart = ends[find_distinct(ends, _SAME)]
        keeps = ClearanceScreen(self._proximity, time=time, spare=POSTURE_SPARE).keeps(apart)
        clear = [q for q, kept in zip(apart, keeps, strict=True) if kept]
        contacts = () if clear else (self._proximity.tightest(q, time=time) for q in apart)
        mildest = max((found for found in contacts if found), key=lambda found: found.margin, default=None)
        rate = self._problem.limits.velocity
        clear.sort(key=lambda q: float(np.max(np.abs(q - near) / rate)))
        return PostureResult(tuple(clear), best, mildest, apart[:0] if clear else apart)

    def anywhere(self, target: TipTarget, *, count: int) -> Matrix:
        """(k, n) configurations that put the tip on `target`, from `count` starting points, clear or not [rad or m]."""
        guesses = self._rng.uniform(*self._problem.robot.finite_range, (count, self._problem.robot.n))
        ends, reached = solve_batch(self._batch, TargetBatch.of([target] * count), guesses, iterations=_ITERATIONS)
        return np.asarray(ends[reached])


def find_distinct(q: Matrix, within: float, known: Matrix | None = None) -> list[int]:
    """The indices of the rows of `q` (N, n) that are further than `within` [rad or m] from every row kept before them.

    The configurations `known` (K, n) count as kept before all rows.
    """
    others = q if known is None else np.vstack((known, q))
    first = len(others) - len(q)
    taken, left = np.ones(len(others), dtype=bool), np.arange(len(others))
    # mostly many are near the same few, and pairs of these are far more than what is left without them
    for _ in range(_HEADS):
        if len(left) <= _FEW:
            break
        head, left = left[0], left[1:]
        near = (np.abs(others[left] - others[head]) <= within).all(axis=1) & (left >= first)
        taken[left[near]] = False
        left = left[~near]
    for row, before in _near_before(others[left], int(np.count_nonzero(left < first)), within):
        taken[left[row]] = not taken[left[before]].any()
    return np.flatnonzero(taken[first:]).tolist()


def _near_before(q: Matrix, first: int, within: float) -> Iterator[tuple[int, Indices]]:
    """The rows of `q` (N, n) from `first` on that are not further than `within` from some before them, and those."""
    if not len(q):
        return
    # only neighbours in the column that differs most are compared
    column = q[:, np.argmax(np.ptp(q, axis=0))]
    order = np.argsort(column, kind="stable")
    low, high = (np.searchsorted(column[order], column[first:] + side * _ROUNDED * within) for side in (-1.0, 1.0))
    count = high - low
    row = np.repeat(np.arange(first, len(q)), count)
    other = order[np.arange(len(row)) - np.repeat(np.cumsum(count) - count - low, count)]
    row, other = row[other < row], other[other < row]
    near = (np.abs(q[row] - q[other]) <= within).all(axis=1)
    row, other = row[near], other[near]
    begin, end = np.flatnonzero(np.diff(row, prepend=-1)), np.flatnonzero(np.diff(row, append=-1)) + 1
    for at, after in zip(begin.tolist(), end.tolist(), strict=True):
        yield int(row[at]), other[at:after]
