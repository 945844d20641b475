"""Postures in which the legs of a sequence may end, and estimated costs of the motions between them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import Goal, cost_rate
from backhoe_planner.planning.goals.goal_postures import find_goal_postures
from backhoe_planner.planning.sequence.leg import Leg
from backhoe_planner.planning.world.holding import holds_load
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import LeastTimes
from backhoe_planner.site import ClearanceScreen

_MOST_ENDS = 40  # postures at the end of a leg; chosen: 0.05 rad apart, they cover two radians of one free joint
_ENDS_A_WAY = 12  # the same for each of `Effort.ways_at_once`; chosen
_MOST_PRICED = 16  # the same if the motions between them are priced by inverse dynamics; chosen
_LONGEST = 120.0  # s: least times are computed up to this one; chosen, far above any leg
_PLACES = 8  # on a straight motion between two postures, that are checked; chosen
_BLOCKED = 0.5  # part by which a motion costs more if all of it is blocked; chosen
_BRISK = 1.15  # times the least time: the duration of a straight motion; chosen


def posture_on(world: World, target: TipTarget, near: Vector) -> tuple[Vector, ...]:
    """Clear postures on a target of a path, the nearest first."""
    found = world.postures.at(target, near=near, count=world.work.effort.starting_points)
    keep = world.problem.keep
    return tuple(q for q in found.clear if keep is None or keep.holds(q))


@dataclass(frozen=True, eq=False)
class LegEnds:
    """Where a leg may begin and end.

    Attributes
    ----------
    ends: (n,) each, postures in which it may end; at least one.
    entries: postures in which a path or a ready motion may be joined; empty for a goal.
    goals: the goal of each end; empty for a path and a ready motion.
    """

    ends: tuple[Vector, ...]
    entries: tuple[Vector, ...] = ()
    goals: tuple[Goal, ...] = ()


def find_ends(world: World, leg: Leg, near: Vector) -> LegEnds | None:
    """Postures in which a leg may end; None if there are none.

    Parameters
    ----------
    world: of the leg's problem.
    near: (n,) a posture from which it may come [rad or m].
    """
    problem = leg.problem
    most = min(_MOST_ENDS if problem.objective.is_time else _MOST_PRICED, _ENDS_A_WAY * world.work.effort.ways_at_once)
    if leg.motion is not None:
        return LegEnds((leg.motion.q[-1],), (leg.motion.q[0],))
    if problem.path is not None:
        path = problem.path
        ends, entries = (posture_on(world, path.target(s), near)[:most] for s in (path.length, 0.0))
        return LegEnds(ends, entries) if ends and entries else None
    found = find_goal_postures(world, problem.goals, near=near, time=0.0)
    if isinstance(found, Outcome):
        return None
    # in turn from every goal, so that none is left out for being further away
    turns = itertools.zip_longest(*([(q, goal) for q in ends] for goal, ends in found.by_goal()))
    chosen = [one for turn in turns for one in turn if one is not None][:most]
    return LegEnds(tuple(q for q, _ in chosen), goals=tuple(goal for _, goal in chosen))


class WayPrices:
    """Estimated costs of straight motions between postures, by the objective of one leg."""

    def __init__(self, world: World) -> None:
        self._problem, self._brake = world.problem, world.work.brake
        self._screen = ClearanceScreen(world.proximity)

    def between(self, begins: Sequence[Vector], ends: Sequence[Vector]) -> Matrix:
        """(A, B) costs from each of `begins` to each of `ends`, more if something is in the way.

        Infinite from postures in which the leg cannot begin.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        a, b = np.array(begins), np.array(ends)
        keep = self._problem.keep
        begin = self._screen.keeps(a) & holds_load(self._problem, a)
        begin &= np.array([keep is None or keep.holds(q) for q in a])
        part = np.linspace(0.0, 1.0, _PLACES)[:, None, None, None]
        lines = a[:, None] + part * (b[None, :] - a[:, None])  # (P, A, B, n)
        keeps = self._screen.keeps(lines.reshape(-1, a.shape[1])).reshape(_PLACES, len(a), len(b))
        blocked = 1.0 - np.mean(keeps, axis=0)
        time = np.array([self._least_times(q, b) for q in a])
        price = time if self._problem.objective.is_time else self._costs(lines, time)
        return np.where(begin[:, None], price * (1.0 + _BLOCKED * blocked), np.inf)

    def _least_times(self, q: Vector, ends: Matrix) -> Vector:
        """(B,) least times from `q` (n,) to `ends` (B, n) [s]; finding them takes 10 to 40 ms."""
        self._brake.check()
        return LeastTimes(self._problem, q, longest=_LONGEST).to_boxes(ends, ends)

    def _costs(self, lines: Matrix, time: Matrix) -> Matrix:
        """(A, B) costs by the objective of straight motions at an even speed."""
        duration = np.maximum(_BRISK * time, 1e-3)
        velocity = (lines[-1] - lines[0]) / duration[..., None]
        v = np.broadcast_to(velocity, lines.shape).reshape(-1, lines.shape[-1])
        rate = cost_rate(self._problem, lines.reshape(v.shape), v, np.zeros_like(v)).reshape(lines.shape[:-1])
        return np.asarray(np.trapezoid(rate, axis=0) / (_PLACES - 1) * duration)
