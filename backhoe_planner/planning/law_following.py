"""Following a tip path with the completed law, and leaving it around an obstacle.

The law resolves the path as far as it can. Where the path is blocked, the machine stops. The
law moves it to the first point ahead at which it can stand on the path, as to any goal, and
goes on from there. So the path is left as late and rejoined as early as the law can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, TipPath
from backhoe_planner.planning.goals.goal_planning import describe_attempts
from backhoe_planner.planning.reactive.law_timing import speed_up
from backhoe_planner.planning.reactive.reaching import Attempt, approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.stretches.corners import time_stretch
from backhoe_planner.planning.stretches.kept_cones import open_cones
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.planning.world.outcome import Outcome, blocked_path, no_posture
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import Obstruction

_RASTER = 0.05  # m between the points of the path ahead at which it may be rejoined; chosen
_COARSE = 5.0 * _RASTER  # m to the next such point, after one that the law does not reach; chosen
_MOST_DETOURS = 8  # of one path; chosen
_MOST_REJOINS = 4  # points that are tried for one detour; chosen: each takes up to `_POSTURES` attempts
_POSTURES = 4  # configurations that are tried at one point; chosen
_GUESSES, _FEW_GUESSES = 12, 6  # starting points for rejoining, and for finding where the path is free; chosen
_LOOKS = 40  # points at most, to find where a path that may not be left is free again; chosen to be quick
_STARTS = 8  # configurations at the beginning of the path that are compared; chosen
_FREE_STARTS = 3  # of them from which the path is followed if the machine may begin in any; chosen
_ON_PATH = 1e-6  # m and rad; chosen: within this the tip counts as being at the beginning
_STUCK_WITHIN = 0.1  # rad or m; chosen: a nearer configuration counts as the one in which the law was stuck


def follow_with_law(world: World, path: TipPath, stepper: Stepper | None) -> Outcome:
    """A motion to the beginning of the path, as to a goal, then along the path.

    Parameters
    ----------
    stepper: a motion that is at rest; None if the machine may begin in any configuration
        at the beginning of the path. Then the law begins where it gets furthest.
    """
    follower = _Follower(world, path)
    target = path.target(0.0)
    if stepper is not None and max(target.distances(stepper.look()[0])) < _ON_PATH:
        return follower.follow(stepper)
    near = None if stepper is None else stepper.q
    found = world.postures.at(target, near=near, count=world.work.effort.starting_points)
    failure = no_posture(world, found, target, "goal_in_collision", "beginning of the path")
    if failure is not None:
        return failure
    clear = _within_cone(world, path, near) or found.clear
    starts = follower.furthest(stepper or world.stepper(clear[0]), 0.0, clear[:_STARTS])
    attempts: list[Attempt] = []

    def begun() -> Iterator[Stepper]:
        """Motions that end at rest at the beginning of the path."""
        if stepper is None:
            yield from map(world.stepper, starts[:_FREE_STARTS])
            return
        for attempt in approach_goal(stepper, Goal(target), starts, work=world.work, all_ways=True):
            attempts.append(attempt)
            if attempt.arrived:
                yield speed_up(stepper, attempt.stepper)

    first: Outcome | None = None
    for motion in begun():
        outcome = follower.follow(motion)
        if not outcome.reason:
            return outcome
        first = first or outcome
    return first or describe_attempts(attempts, world.work.brake)


def _within_cone(world: World, path: TipPath, near: Vector | None) -> Sequence[Vector]:
    """(n,) each, clear configurations at the beginning of a path, within the cones to be kept along it, if any.

    Parameters
    ----------
    near: (n,) which are wanted first [rad or m]; None if that does not matter.
    """
    cones, target = open_cones(world.problem, path), path.target(0.0)
    if cones is None or target.rotation is not None:
        return ()
    found = world.postures.at(cones.target(target), near=near, count=world.work.effort.starting_points)
    kept = cones.holds_each(np.array(found.clear).reshape(-1, world.problem.robot.n))
    return [q for q, holds in zip(found.clear, kept.tolist(), strict=True) if holds]


class _Follower:
    """Follows one path among the obstacles of one world."""

    def __init__(self, world: World, path: TipPath) -> None:
        self._world = world
        self._path = path
        task = world.problem.scene.task.path
        assert task is not None
        self._may_leave, self._may_turn = task.detour, task.turn_on_the_spot

    def furthest(self, stepper: Stepper, s: float, candidates: Sequence[Vector]) -> list[Vector]:
        """`candidates` (n,) at arc length `s` [m], sorted by how far the law gets from them, the furthest first."""
        return sorted(candidates, key=lambda q: -round(self._follow_law(stepper, s, q).reached, 3))

    def follow(self, stepper: Stepper) -> Outcome:
        """Follow the path from a motion that is at rest at its beginning."""
        s = 0.0
        for _ in range(_MOST_DETOURS):
            stretch = self._follow_law(stepper, s, stepper.q)
            for piece in time_stretch(self._world.problem, self._path, stretch, brake=self._world.work.brake):
                stepper.play(piece)
            if stretch.obstruction is None:
                return Outcome(stepper.trajectory())
            rejoined = self._rejoin(stepper, stretch)
            if isinstance(rejoined, Outcome):
                return rejoined
            stepper, s = rejoined
        return self._blocked(stepper, s, self._path.length, stretch.obstruction)

    def _follow_law(self, stepper: Stepper, s: float, q: Vector) -> Stretch:
        return self._world.follow_law(self._path, s, q, time=stepper.time)

    def _rejoin(self, stepper: Stepper, stretch: Stretch) -> tuple[Stepper, float] | Outcome:
        """A motion that is back on the path beyond the obstruction, and its arc length [m]; or why there is none."""
        left = stretch.reached
        marks = self._path.stations[self._path.standing_waypoints]
        end = float(np.min(marks[marks > left + _ON_PATH], initial=self._path.length))  # no turn may be left out
        if not self._may_leave:
            return self._blocked(stepper, left, self._free_again(stepper, left), stretch.obstruction)
        furthest = end
        rejoins = 0
        s = left
        while s <= end and rejoins < _MOST_REJOINS:
            self._world.work.brake.check()
            found = self._world.postures.at(self._path.target(s), near=stepper.q, count=_GUESSES, time=stepper.time)
            others = self._may_turn and [q for q in found.clear if np.max(np.abs(q - stepper.q)) > _STUCK_WITHIN]
            fresh = found.clear if s > left else others or []
            if fresh:
                furthest = s
                rejoins += 1
                for branch in self._ways(stepper, s, fresh):
                    if self._follow_law(branch, s, branch.q).reached > s + 1e-6 or s >= end - 1e-9:
                        return branch, s
            if s >= end:
                break
            s = min(s + (_COARSE if fresh else _RASTER), end)
        return self._blocked(stepper, left, furthest, stretch.obstruction)

    def _free_again(self, stepper: Stepper, left: float) -> float:
        """The first arc length beyond `left` at which the machine can stand on the path, otherwise its end [m]."""
        raster = max(_RASTER, (self._path.length - left) / _LOOKS)
        s = left + raster
        while s < self._path.length:
            self._world.work.brake.check()
            target = self._path.target(s)
            if self._world.postures.at(target, near=stepper.q, count=_FEW_GUESSES, time=stepper.time).clear:
                return s
            s += raster
        return self._path.length

    def _ways(self, stepper: Stepper, s: float, postures: Sequence[Vector]) -> Iterator[Stepper]:
        """Motions that arrive on the path at `s`."""
        ordered = self.furthest(stepper, s, postures[:_POSTURES])
        for attempt in approach_goal(stepper, Goal(self._path.target(s)), ordered, work=self._world.work):
            if attempt.arrived:
                yield attempt.stepper

    def _blocked(self, stepper: Stepper, low: float, high: float, obstruction: Obstruction | None) -> Outcome:
        """The motion so far, and what is in the way from `low` to `high` [m]."""
        assert obstruction is not None
        found = replace(obstruction, path_from=low, path_to=high)
        why = "" if self._may_leave else ", and detours are not allowed"
        return blocked_path(stepper.trajectory(), found, self._path, why)
