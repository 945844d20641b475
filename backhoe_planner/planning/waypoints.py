"""The waypoints of a path, each checked by itself before the path is planned.

An impossible waypoint is reported at once. One that is only just impossible is moved within the tolerance of the
path: a corner beyond the arm's reach to where the arm reaches, a pose whose tip link is too near to an obstacle away
from it. The certificate judges by the path as it was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch, solve_inverse_kinematics
from backhoe_planner.motion import TipPath
from backhoe_planner.planning.search.moved_targets import move_aside, move_within_reach
from backhoe_planner.planning.stretches.stretch import NEARER
from backhoe_planner.planning.world.outcome import Outcome, blocked_path, out_of_reach, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_MOST_WAYPOINTS = 32  # tried from `_GUESSES` before a path is planned; chosen: the others start from their results
_CARRIED = 2  # configurations of the waypoint before, and of the one after, from which another is tried; chosen
_GUESSES = 24  # starting points for each of them: as many as `Postures.at` uses
_MORE_GUESSES = 192  # for a waypoint at which all configurations found collide; chosen: eight times as many
_MOVED = 0.9  # part of the tolerance by which a waypoint is moved at most; chosen: the rest is for chords and curve


def path_within_reach(world: World, path: TipPath) -> tuple[World, TipPath] | Outcome:
    """The path to be planned, with its world; or the first waypoint that is impossible.

    A waypoint that is impossible by less than the path's tolerance is moved, and the world gets the rest of the
    tolerance. If the path gives full poses and may not be left, a waypoint at which all configurations found collide
    is as impossible as one out of reach.
    """
    waypoints = _Waypoints(world, path)
    failure = waypoints.first_impossible()
    return failure or waypoints.moved()


class _Waypoints:
    """The waypoints of a path, each checked by itself."""

    def __init__(self, world: World, path: TipPath) -> None:
        task = world.problem.scene.task.path
        robot = world.problem.robot
        self._world = world
        self._path = path
        self._kinematics = BatchKinematics(robot)
        rng = np.random.default_rng(world.seed)
        self._guesses = np.array([robot.middle, *(robot.random_q(rng) for _ in range(_MORE_GUESSES - 1))])
        # a moving obstacle may be gone when the tip arrives
        stays = task is None or task.detour or world.problem.is_dynamic or path.target(0.0).rotation is None
        self._found: dict[int, Matrix] = {}  # configurations, by waypoint
        self._positions: dict[int, Vector] = {}  # the positions of moved waypoints
        # waypoints at which the tip stands while it turns are not moved
        self._stays_put = set(path.standing_waypoints.tolist())
        self._most = 0.0 if task is None else _MOVED * task.tolerance
        self._screen = None if stays else ClearanceScreen(world.proximity, spare=-NEARER)

    def first_impossible(self) -> Outcome | None:
        """The first waypoint that is impossible even if it is moved; None if there is none."""
        count = len(self._path.stations)
        few = np.unique(np.linspace(0, count - 1, min(count, _MOST_WAYPOINTS)).astype(int))
        found = self._first_of(few)
        last = count if found is None else found[0]
        others = np.setdiff1d(np.arange(last), few)
        return (self._first_of(self._not_carried(others)) or found or (0, None))[1]

    def moved(self) -> tuple[World, TipPath]:
        """The result of `path_within_reach`, after all waypoints were checked."""
        if not self._positions:
            return self._world, self._path
        waypoints = list(self._path.waypoints)
        off = 0.0
        for index, position in self._positions.items():
            off = max(off, float(np.linalg.norm(position - self._path.points[index])))
            waypoints[index] = waypoints[index].model_copy(update={"position": tuple(position.tolist())})
        numbers = [self._path.number(index) for index in range(len(waypoints))]
        task = self._world.problem.scene.task.path
        assert task is not None
        return self._world.within(task.tolerance - off), TipPath(waypoints, numbers=numbers)

    def _not_carried(self, indices: NDArray[np.intp]) -> NDArray[np.intp]:
        """The waypoints of `indices` that are not reached from the configurations found for a neighbouring waypoint."""
        known = np.array(sorted(self._found), dtype=int)
        targets = {index: self._path.target(float(self._path.stations[index])) for index in indices.tolist()}
        for number in range(2 * _CARRIED):
            if not len(indices) or not len(known):
                break
            # in turn from the waypoint before and from the one after
            behind = np.minimum(np.searchsorted(known, indices), len(known) - 1)
            beside = known[behind if number % 2 else np.maximum(behind - 1, 0)]
            guesses = np.array([self._found[other][number // 2 % len(self._found[other])] for other in beside.tolist()])
            batch = TargetBatch.of([targets[index] for index in indices.tolist()])
            q, good = solve_batch(self._kinematics, batch, guesses)
            if self._screen is not None:
                good[good] = self._screen.keeps(q[good])
            indices = indices[~good]
        return indices

    def _first_of(self, indices: NDArray[np.intp]) -> tuple[int, Outcome] | None:
        """The first impossible waypoint of `indices`, and why it is impossible; None if there is none."""
        if not len(indices):
            return None
        targets = [self._path.target(float(self._path.stations[index])) for index in indices]
        guesses = self._guesses[:_GUESSES]
        q, reached = self._solve(targets, guesses)
        good = reached if self._screen is None else reached.copy()
        if self._screen is not None:
            good[reached] = self._screen.keeps(q[reached])
        for row in np.flatnonzero(good.any(axis=1)).tolist():
            self._found[int(indices[row])] = q[row][good[row]]
        for row in np.flatnonzero(~good.any(axis=1)).tolist():
            failure = self._failure(int(indices[row]), targets[row])
            if failure is not None:
                return int(indices[row]), failure
        return None

    def _failure(self, index: int, target: TipTarget) -> Outcome | None:
        """Why a waypoint is impossible, after a longer search; None if it is possible, moved if need be."""
        world, path = self._world, self._path
        what = "beginning of the path" if index == 0 else f"waypoint {path.number(index)} of the path"
        best = solve_inverse_kinematics(world.problem.robot, target)
        within, q_within = target, best.q
        if not best.reached:
            robot, stays = world.problem.robot, index in self._stays_put
            found = None if stays else move_within_reach(robot, target, best.q, most=self._most)
            if found is None:
                return out_of_reach(world, best, target, what)
            within, q_within = found
        if self._screen is not None:
            q, reached = self._solve([within], self._guesses)
            ends = np.vstack((q_within[None, :], q[reached]))
            if not self._screen.keeps(ends).any():
                aside = None
                if index not in self._stays_put:
                    aside = move_aside(
                        world.proximity, self._screen, within, ends, given=target.position, most=self._most
                    )
                if aside is None:
                    return self._collides(index, ends, what)
                within = aside[0]
        if within is not target:
            self._positions[index] = within.position
        return None

    def _collides(self, index: int, ends: Matrix, what: str) -> Outcome:
        """The outcome if all configurations `ends` (K, n) that were found for a waypoint collide."""
        world, path = self._world, self._path
        contacts = [contact for contact in map(world.proximity.tightest, ends) if contact is not None]
        mildest = max(contacts, key=lambda contact: contact.margin)
        station = float(path.stations[index])
        why = f": at the {what} none of {len(ends)} configurations that were found is clear; detours are not allowed"
        found = replace(mildest, path_from=station, path_to=station)
        return blocked_path(rest_at_start(world, ends[0]), found, path, why)

    def _solve(self, targets: Sequence[TipTarget], guesses: Matrix) -> tuple[Array, Flags]:
        """(T, G, n), (T, G) where inverse kinematics ends from each guess for each target, and whether it converged."""
        rows = np.repeat(np.arange(len(targets)), len(guesses))
        batch = TargetBatch.of(targets).take(rows)
        q, reached = solve_batch(self._kinematics, batch, np.tile(guesses, (len(targets), 1)))
        return q.reshape(len(targets), len(guesses), -1), reached.reshape(len(targets), len(guesses))
