"""The waypoints of a path, each looked at for itself before the path is planned.

One that is impossible is named at once. One that is only just so is moved, within the tolerance of the path: a
corner beyond the arm's reach to where the arm gets, a pose whose tip's link is too near to something away from it.
The certificate judges by the path as it was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch, solve_inverse_kinematics
from backhoe_planner.motion import TipPath
from backhoe_planner.planning.paths.stretch import NEARER
from backhoe_planner.planning.world.outcome import Outcome, blocked_path, out_of_reach, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_MOST_WAYPOINTS = 32  # that are tried from `_GUESSES` before a path is planned; chosen: the others hang on them
_CARRIED = 2  # configurations of a waypoint before, and of one behind, from which another is tried; chosen
_GUESSES = 24  # starting points for each of them: as many as `Postures.at` takes
_MORE_GUESSES = 192  # for one at which everything that was found collides; chosen: eight times as many
_MOVED = 0.9  # of the tolerance that a waypoint is moved at most; chosen: the rest is for chords and curve
_INSIDE = 0.02  # of the tolerance that it is moved further than it must be; chosen: a stretched arm turns fast
_MOVES = 8  # after which it is not moved further; chosen: one or two are usual


def path_within_reach(world: World, path: TipPath) -> tuple[World, TipPath] | Outcome:
    """A path as it is planned, with the world for it; or the first waypoint that is impossible.

    A waypoint that is impossible by less than the path's tolerance is moved, and what is left of the tolerance is that
    of the world. Where full poses are asked for and the path may not be left, a waypoint at which everything that is
    found collides is impossible like one that is out of reach.
    """
    waypoints = _Waypoints(world, path)
    failure = waypoints.first_impossible()
    return failure or waypoints.moved()


class _Waypoints:
    """The waypoints of a path, each looked at for itself."""

    def __init__(self, world: World, path: TipPath) -> None:
        task = world.problem.scene.task.path
        robot = world.problem.robot
        self._world = world
        self._path = path
        self._kinematics = BatchKinematics(robot)
        rng = np.random.default_rng(world.seed)
        self._guesses = np.array([robot.middle, *(robot.random_q(rng) for _ in range(_MORE_GUESSES - 1))])
        # what moves may be gone when the tip comes there
        stays = task is None or task.detour or world.problem.is_dynamic or path.target(0.0).rotation is None
        self._found: dict[int, Matrix] = {}  # of a waypoint, configurations
        self._positions: dict[int, Vector] = {}  # where waypoints are moved to
        # a tip that stands while it turns stays where it is
        self._stays_put = set(path.standing_waypoints.tolist())
        self._most = 0.0 if task is None else _MOVED * task.tolerance
        self._screen = None if stays else ClearanceScreen(world.proximity, spare=-NEARER)

    def first_impossible(self) -> Outcome | None:
        """The first waypoint that is impossible, and would be if it were moved; None where there is none."""
        count = len(self._path.stations)
        few = np.unique(np.linspace(0, count - 1, min(count, _MOST_WAYPOINTS)).astype(int))
        found = self._first_of(few)
        last = count if found is None else found[0]
        others = np.setdiff1d(np.arange(last), few)
        return (self._first_of(self._not_carried(others)) or found or (0, None))[1]

    def moved(self) -> tuple[World, TipPath]:
        """As `path_within_reach`, after all waypoints were looked at."""
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
        """Those of some waypoints that the tip is not put on from what was found for a waypoint beside."""
        known = np.array(sorted(self._found), dtype=int)
        targets = {index: self._path.target(float(self._path.stations[index])) for index in indices.tolist()}
        for number in range(2 * _CARRIED):
            if not len(indices) or not len(known):
                break
            # in turn from the waypoint before and from the one behind
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
        """The first impossible of some waypoints, and what to say of it."""
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
        """Why a waypoint is impossible, after a longer search; None where it is not, or not if it is moved."""
        world, path = self._world, self._path
        what = "beginning of the path" if index == 0 else f"waypoint {path.number(index)} of the path"
        best = solve_inverse_kinematics(world.problem.robot, target)
        within, q_within = target, best.q
        if not best.reached:
            found = None if index in self._stays_put else self._within_reach(target, best.q)
            if found is None:
                return out_of_reach(world, best, target, what)
            within, q_within = found
        if self._screen is not None:
            q, reached = self._solve([within], self._guesses)
            ends = np.vstack((q_within[None, :], q[reached]))
            if not self._screen.keeps(ends).any():
                aside = None if index in self._stays_put else self._aside(target, within, ends)
                if aside is None:
                    return self._collides(index, ends, what)
                within = aside
        if within is not target:
            self._positions[index] = within.position
        return None

    def _within_reach(self, target: TipTarget, q: Vector) -> tuple[TipTarget, Vector] | None:
        """`target` moved to where the tip can be, and (n,) joints there; None where it is too far.

        Parameters
        ----------
        q: (n,) joints with the tip as near to the target as it gets [rad or m].
        """
        robot = self._world.problem.robot
        for _ in range(_MOVES):
            away = self._world.kinematics.at(q).tip_position - target.position
            far = float(np.linalg.norm(away))
            if not 0.0 < far <= self._most:
                return None
            further = min(1.0 + _INSIDE * self._most / far, self._most / far)
            moved = replace(target, position=target.position + further * away)
            found = solve_inverse_kinematics(robot, moved, start=q)
            if found.reached:
                return moved, found.q
            q = found.q
        return None

    def _aside(self, target: TipTarget, within: TipTarget, ends: Matrix) -> TipTarget | None:
        """`within` moved on away from what touches the tip's link, so that it is clear; None where that is too far.

        Parameters
        ----------
        target: the waypoint as it is given; it is moved so far at most as the tolerance allows.
        ends: (K, n) joints with the tip there, all of which collide.
        """
        assert self._screen is not None
        proximity = self._world.proximity
        for _ in range(_MOVES):
            nearby = [proximity.at(q, margin=0.0) for q in ends]
            touching = [near for near in nearby if len(near)]
            if not touching:
                return None
            tightest = max(touching, key=lambda near: float(np.min(near.margin)))
            row = int(np.argmin(tightest.margin))
            step = float(tightest.margin[row]) - _INSIDE * self._most
            within = replace(within, position=within.position + step * tightest.normal[row])
            if float(np.linalg.norm(within.position - target.position)) > self._most:
                return None
            q, reached = solve_batch(self._kinematics, TargetBatch.of([within] * len(ends)), ends)
            ends = q[reached]
            if not len(ends):
                return None
            if self._screen.keeps(ends).any():
                return within
        return None

    def _collides(self, index: int, ends: Matrix, what: str) -> Outcome:
        """That all configurations `ends` (K, n) that were found for a waypoint collide."""
        world, path = self._world, self._path
        contacts = [contact for contact in map(world.proximity.tightest, ends) if contact is not None]
        mildest = max(contacts, key=lambda contact: contact.margin)
        station = float(path.stations[index])
        why = f": at the {what} none of {len(ends)} configurations that were found is clear; detours are not allowed"
        found = replace(mildest, path_from=station, path_to=station)
        return blocked_path(rest_at_start(world, ends[0]), found, path, why)

    def _solve(self, targets: Sequence[TipTarget], guesses: Matrix) -> tuple[Array, Flags]:
        """(T, G, n), (T, G) where the search ends from each guess for each target, and whether it arrived."""
        rows = np.repeat(np.arange(len(targets)), len(guesses))
        batch = TargetBatch.of(targets).take(rows)
        q, reached = solve_batch(self._kinematics, batch, np.tile(guesses, (len(targets), 1)))
        return q.reshape(len(targets), len(guesses), -1), reached.reshape(len(targets), len(guesses))
