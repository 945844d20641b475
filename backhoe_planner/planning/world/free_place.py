"""The nearest place of the tip, near one where the machine collides, at which it keeps its clearances."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.planning.search.postures import POSTURE_SPARE
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_DISTANCES = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # m that are tried in turn; chosen
_WAYS = np.array([way for way in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_HALVINGS = 3  # of the last doubling of the distance: to an eighth of it; chosen
_GUESSES = 6  # starting points of inverse kinematics for a place; chosen: some tens of milliseconds in all


@dataclass(frozen=True, eq=False)
class FreePlace:
    """A place at which the machine keeps every clearance.

    Attributes
    ----------
    position: (3,) of the tip [m], world.
    moved: (3,) from where it collides [m].
    """

    position: Vector
    moved: Vector

    def __str__(self) -> str:
        place, moved = (", ".join(f"{one:{form}}" for one in (row + 0.0).tolist())
                        for row, form in ((self.position, ".2f"), (self.moved, "+.2f")))  # fmt: skip
        away = float(np.linalg.norm(self.moved))
        return f"the nearest free place that was found is {away:.2f} m away, at ({place}), by ({moved}) m"


def find_free_place(world: World, target: TipTarget, near: Vector, *, time: float) -> FreePlace | None:
    """The nearest free place for the tip in 26 directions, up to 1.6 m away, with the target's orientation.

    Parameters
    ----------
    near: (n,) a configuration from which it is searched, besides random ones [rad or m].
    time: at which the positions of the obstacles are taken [s].
    """
    robot, rng = world.problem.robot, np.random.default_rng(0)
    kinematics = BatchKinematics(robot)
    guesses = np.vstack((near, [robot.random_q(rng) for _ in range(_GUESSES - 1)]))
    screen = ClearanceScreen(world.proximity, time=time, spare=POSTURE_SPARE)
    keep = world.problem.keep

    def are_free(moves: Matrix) -> Flags:
        """(M,) which moves (M, 3) of the tip [m] lead to a free place."""
        places = [replace(target, position=target.position + move) for move in moves]
        batch = TargetBatch.of([place for place in places for _ in guesses])
        q, good = solve_batch(kinematics, batch, np.tile(guesses, (len(places), 1)))
        good[good] = screen.keeps(q[good])
        if keep is not None and good.any():
            good[good] = keep.holds_each(q[good])
        found: Flags = np.any(good.reshape(len(places), -1), axis=1)
        return found

    ways = _WAYS / np.linalg.norm(_WAYS, axis=1)[:, None]
    before = 0.0
    for distance in _DISTANCES:
        if world.work.brake.is_used_up():
            return None
        free = are_free(distance * ways)
        if free.any():
            ways = ways[free]
            for _ in range(_HALVINGS):
                middle = 0.5 * (before + distance)
                nearer = are_free(middle * ways)
                if nearer.any():
                    ways, distance = ways[nearer], middle
                else:
                    before = middle
            return FreePlace(target.position + distance * ways[0], distance * ways[0])
        before = distance
    return None
