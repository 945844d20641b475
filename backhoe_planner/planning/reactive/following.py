"""Following a bucket path with the completed law, and leaving it around an obstacle.

The law resolves the path as far as it can. Where it is blocked, the machine stops, and
goes on from the first point of the path ahead that it can stand on: it is brought there
as to any goal, and the law goes on. So the path is left as late and rejoined as early
as the local law can.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import TipPath, drive_of
from backhoe_planner.planning.paths.corners import time_stretch
from backhoe_planner.planning.paths.local_resolution import Resolution, resolve_along
from backhoe_planner.planning.reactive.reaching import approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.search.postures import Postures
from backhoe_planner.site import Obstruction, Proximity

__all__ = ["Followed", "Follower"]

Vector = NDArray[np.float64]

_RASTER = 0.05  # m on which the path ahead is searched for a point to rejoin at
_COARSE = 0.25  # m to the next such point, once one was found that cannot be got to
_MOST_DETOURS = 8
_MOST_REJOINS = 4
_POSTURES = 4  # tried per point


@dataclass(frozen=True)
class Followed:
    """What came of it.

    Attributes
    ----------
    done: the end of the path was reached.
    stepper: the motion.
    blocked_from, blocked_to: part of the path that could be neither followed nor
        bypassed [m].
    obstruction: what is in the way there; None where it is done.
    """

    done: bool
    stepper: Stepper
    blocked_from: float = 0.0
    blocked_to: float = 0.0
    obstruction: Obstruction | None = None


class Follower:
    """Follows one path.

    Parameters
    ----------
    speed: of the tip [m/s], None for as fast as the joints allow.
    detour: whether the path may be left.
    work: from which the steps back to the path are taken.
    """

    def __init__(
        self,
        path: TipPath,
        *,
        speed: float | None,
        detour: bool,
        postures: Postures,
        proximity: Proximity,
        kinematics: Kinematics,
        work: Work,
    ) -> None:
        self._path = path
        self._speed = speed
        self._detour = detour
        self._postures = postures
        self._proximity = proximity
        self._kinematics = kinematics
        self._work = work

    def furthest(self, stepper: Stepper, s: float, candidates: tuple[Vector, ...]) -> list[Vector]:
        """Configurations at arc length `s`, the one from which the law gets furthest first."""
        reached = [self._resolve(stepper, s, q).reached for q in candidates]
        order = sorted(range(len(candidates)), key=lambda index: (-round(reached[index], 3), index))
        return [candidates[index] for index in order]

    def follow(self, stepper: Stepper) -> Followed:
        """Go along the path from a motion that is at rest on its beginning."""
        s = 0.0
        for _ in range(_MOST_DETOURS):
            resolution = self._resolve(stepper, s, stepper.q)
            self._play(stepper, resolution)
            if resolution.complete:
                return Followed(True, stepper)
            rejoined, s = self._rejoin(stepper, resolution)
            if not rejoined.done:
                return rejoined
            stepper = rejoined.stepper
        return Followed(False, stepper, s, self._path.length, resolution.obstruction)

    def _resolve(self, stepper: Stepper, s: float, q: Vector) -> Resolution:
        return resolve_along(
            stepper.problem, self._path, s, q, proximity=self._proximity, kinematics=self._kinematics,
            time=stepper.time,
        )  # fmt: skip

    def _play(self, stepper: Stepper, resolution: Resolution) -> None:
        for piece in time_stretch(
            self._path,
            resolution.stations,
            resolution.q,
            stepper.problem.limits,
            speed=self._speed,
            drive=drive_of(stepper.problem),
        ):
            stepper.play(piece)

    def _rejoin(self, stepper: Stepper, resolution: Resolution) -> tuple[Followed, float]:
        """Get back onto the path behind what blocks it; and where that was [m]."""
        left = resolution.reached
        if not self._detour:
            return Followed(False, stepper, left, self._free_again(stepper, left), resolution.obstruction), left
        furthest = self._path.length
        rejoins = 0
        s = left
        while s <= self._path.length and rejoins < _MOST_REJOINS:
            self._work.brake.check()
            target = self._path.target(s)
            found = self._postures.at(target, near=stepper.q, count=12, time=stepper.time)
            # where it stands it has just been stuck
            fresh = tuple(q for q in found.clear if s > left or np.max(np.abs(q - stepper.q)) > 0.1)
            if fresh:
                furthest = s
                rejoins += 1
                for branch in self._ways(stepper, s, fresh):
                    if self._resolve(branch, s, branch.q).reached > s + 1e-6 or s >= self._path.length - 1e-9:
                        return Followed(True, branch), s
            if s >= self._path.length:
                break
            s = min(s + (_COARSE if fresh else _RASTER), self._path.length)
        return Followed(False, stepper, left, furthest, resolution.obstruction), left

    def _free_again(self, stepper: Stepper, left: float) -> float:
        """The first point of the path behind `left` that the machine can stand on, else its end [m]."""
        s = left + _RASTER
        while s < self._path.length:
            self._work.brake.check()
            if self._postures.at(self._path.target(s), near=stepper.q, count=6, time=stepper.time).clear:
                return s
            s += _RASTER
        return self._path.length

    def _ways(self, stepper: Stepper, s: float, postures: tuple[Vector, ...]) -> Iterator[Stepper]:
        """Motions that arrive on the path at `s`."""
        ordered = self.furthest(stepper, s, postures[:_POSTURES])
        for attempt in approach_goal(stepper, self._path.target(s), ordered, work=self._work):
            if attempt.arrived:
                yield attempt.stepper
