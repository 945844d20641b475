"""Descents from many starts at once, as if nothing were in the way.

What a straight line costs says little about the motion at which a descent from it ends: on an open site of the Panda
with lines to 297 postures, the first of those that lead to the cheapest motion is 155th by its own cost, and first
after eight such steps, which take 0.3 ms a line. They go down the slope of the cost in the metric of the squared
second derivatives of the curves (CHOMP, Zucker et al. 2013), each with a step that grows after it cost less and
shrinks otherwise. Ends move on their goals. Limits count only in the prices that follow, see `StartPrices`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Flags, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, movable_rows, solve_batch
from backhoe_planner.motion import OBJECTIVES, Problem, drive_of
from backhoe_planner.planning.descent.bend import bending
from backhoe_planner.planning.descent.curve import JointCurve, basis, divided_evenly, from_rest_to_rest
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH, suitable_width
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.multistart.start_prices import Start

_PIECES = 4  # of each curve; chosen: 6 take a third longer, and the order of the starts is as good
_PLACES = 2  # of the cost's sum, for each piece; chosen
# steps, and the part of the starts that is continued afterwards: the cheapest. Chosen: 16 or 40 steps give no better
# order than 8, and the cheapest are among these after two
_STAGES, _FEWEST = ((2, 0.3), (6, 1.0)), 24
_FIRST, _LARGEST = 0.3, 0.6  # rad or m of the fastest joint that a step moves a control point: the first, and at most
_GROW, _SHRINK = 1.5, 0.3  # factors on a step after one that cost less, and after one that did not; chosen
_ONTO_GOAL = 3  # steps of the inverse kinematics after each step; chosen
_DAMPING = 1e-9  # of the goals' rows, against rows that depend on each other
_NO_MOVE = 1e-12  # rad or m: a smaller one counts as this
_TOGETHER = 400  # starts that descend at once, to bound the memory


class FreeDescents:
    """Descents of curves that start from rest and end at rest after a given time; not if the cost is the time.

    A cost that jumps is replaced by the work, whose slope is known.

    Parameters
    ----------
    longest: the time that each motion takes [s].
    """

    def __init__(self, problem: Problem, *, longest: float) -> None:
        if problem.objective.jumps:
            problem = replace(problem, objective=OBJECTIVES["work"])
        self._own_time, self._T = OwnTime(problem, drive_of(problem)), longest
        self._ends_move = problem.keep is None or not problem.keep.cones  # else they might leave the cones
        self._limits, self._kinematics = problem.limits, BatchKinematics(problem.robot)
        rate = problem.limits.velocity
        self._unit = rate / float(np.max(rate))  # rad or m of each joint that count alike
        self._smooth = np.linalg.inv(bending(_PIECES, _PIECES))
        self._weights = [basis(_PIECES, _PLACES * _PIECES + 1, k) / longest**k for k in range(3)]

    def bent(self, starts: Sequence[Start]) -> list[Start]:
        """The cheapest of `starts` with equally many pieces, each with the curve at which its descent ends.

        Three tenths of them, or 24 if these are more, in the same order.
        """
        if not starts:
            return []
        left, pieces = list(starts), starts[0].curve.pieces
        control = divided_evenly(np.array([start.curve.control for start in starts]), _PIECES, self._limits)
        step: Vector = np.zeros(len(left))
        for steps, part in _STAGES:
            cost: Vector = np.zeros(len(left))
            for first in range(0, len(left), _TOGETHER):
                some = slice(first, first + _TOGETHER)
                ends = _Ends.of(left[some], move=self._ends_move)
                control[some], cost[some], step[some] = self._down(control[some], ends, steps, step[some])
            count = min(max(round(part * len(left)), _FEWEST), len(left))
            kept = np.sort(np.argsort(cost, kind="stable")[:count])
            left, control, step = [left[index] for index in kept.tolist()], control[kept], step[kept]
        bent = divided_evenly(control, pieces, self._limits)
        return [replace(start, curve=JointCurve(own)) for start, own in zip(left, bent, strict=True)]

    def _down(self, control: Array, ends: _Ends, steps: int, step: Vector) -> tuple[Array, Vector, Vector]:
        """The control points (B, L + 1, n) after so many steps, their costs, and the sizes of the next steps (B,).

        Parameters
        ----------
        step: (B,) of the first one, as parts of the way down the slope; 0 where none was made yet.
        """
        width = self._widths(control)
        cost, slope = self._costs(control, width)
        way = self._ways(control, slope, ends)
        step = np.where(step > 0.0, step, _FIRST / self._sizes(way))
        for _ in range(steps):
            step = np.minimum(step, _LARGEST / self._sizes(way))
            there = self._on_goals(control + step[:, None, None] * way, ends)
            cost_there, slope_there = self._costs(there, width)
            less = cost_there < cost
            step = step * np.where(less, _GROW, _SHRINK)
            if less.any():
                control[less], cost[less] = there[less], cost_there[less]
                way[less] = self._ways(there[less], slope_there[less], ends.some(less))
        return control, cost, step

    def _widths(self, control: Array) -> Vector:
        """(B,) by which the kinks of each curve's cost are rounded off."""
        curves, T = [JointCurve(each) for each in control], np.full(len(control), self._T)
        cost = self._own_time.costs(curves, T, width=LEAST_WIDTH, places=_PLACES)
        return suitable_width(cost, self._T, control.shape[2])

    def _costs(self, control: Array, width: Vector) -> tuple[Vector, Array]:
        """(B,) the costs of curves, and (B, L + 1, n) their slopes by the control points."""
        count, _, n = control.shape
        q, v, a = ((weights @ control).reshape(-1, n) for weights in self._weights)
        places = len(self._weights[0])
        rate, slopes = self._own_time.rate_slopes(q, v, a, width=np.repeat(width, places))
        share = self._T * JointCurve(control[0]).shares(places)
        each = share[:, None, None] * slopes.reshape(count, places, 3, n)
        slope = sum(weights.T @ each[:, :, k] for k, weights in enumerate(self._weights))
        return np.asarray(rate.reshape(count, places) @ share), np.asarray(slope)

    def _ways(self, control: Array, slope: Array, ends: _Ends) -> Array:
        """(B, L + 1, n) where steps go: down the slope, but starts stay, and ends stay on their goals."""
        way = np.zeros_like(control)
        way[:, 1:] = -(self._smooth @ slope[:, 1:]) * self._unit**2
        J = ends.targets.jacobians(self._kinematics.at(control[:, -1]))
        J = J[:, movable_rows(J).any(axis=0)]
        square = J @ J.transpose(0, 2, 1) + _DAMPING * np.eye(J.shape[1])
        off = J.transpose(0, 2, 1) @ np.linalg.solve(square, J @ way[:, -1, :, None])
        way[:, -1] = np.where(ends.move[:, None], way[:, -1] - off[:, :, 0], 0.0)
        return way

    def _sizes(self, way: Array) -> Vector:
        """(B,) the largest move of a control point in each step `way` (B, L + 1, n), above 0."""
        return np.asarray(np.maximum(np.max(np.abs(way) / self._unit, axis=(1, 2)), _NO_MOVE))

    def _on_goals(self, control: Array, ends: _Ends) -> Array:
        """(B, L + 1, n) the curves within limits, with the ends that move on their goals."""
        low, high = self._limits.lower, self._limits.upper
        control = np.clip(control, low, high)
        moved, _ = solve_batch(self._kinematics, ends.targets, control[:, -1], iterations=_ONTO_GOAL)
        off = np.where(ends.move[:, None], moved - control[:, -1], 0.0)
        part = from_rest_to_rest(np.linspace(0.0, 1.0, control.shape[1]))
        return np.clip(control + part[:, None] * off[:, None, :], low, high)


class _Ends(NamedTuple):
    """The targets of B ends, and (B,) which of them move."""

    targets: TargetBatch
    move: Flags

    @classmethod
    def of(cls, starts: Sequence[Start], *, move: bool) -> _Ends:
        """Those of starts; they do not `move`, or only those whose goals are not given by joints."""
        goals = [start.goal for start in starts]
        targets = TargetBatch.of([goal.search_target for goal in goals])
        return cls(targets, np.array([move and goal.q is None for goal in goals]))

    def some(self, which: Flags) -> _Ends:
        """Those of `which` (B,)."""
        return _Ends(self.targets.take(which), self.move[which])
