"""The potential energy gained on the way to a goal, and how much of it is worth another search."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import GRAVITY, Dynamics
from backhoe_planner.motion import Problem
from backhoe_planner.planning.world.world import World

# m: lifting all moving masses so far takes the energy that is worth another search. Chosen among 0.05 to 0.4 mm on 97
# plans: with 0.2 mm as many are within 1.1 of the best known as with 0.05 mm, in 0.80 (Panda) and 0.85 (backhoe) of the
# mean time
_WORTH = 2e-4
# m: the difference between motions that cost less than lifting all moving masses so far cannot be measured; chosen
_LITTLE = 1e-3
_NEAR = 0.05  # part of what is lifted, by which a cost may exceed it if another search is not worth its time; chosen


def lift_of(problem: Problem) -> Lift | None:
    """The lift of a problem; None if its cost does not count potential energy."""
    return Lift(problem) if problem.objective.lifts else None


class Lift:
    """The potential energy of a problem's machine with its payload.

    Attributes
    ----------
    worth: so much energy is worth another search [J].
    little: a cost that counts as little [J].
    """

    def __init__(self, problem: Problem) -> None:
        scene = problem.scene
        self._dynamics = Dynamics(problem.robot, payload=scene.payload, payload_at=scene.payload_at)
        masses, _ = self._dynamics.bodies()
        weight = float(np.sum(masses)) * GRAVITY
        self.worth, self.little = weight * _WORTH, weight * _LITTLE

    def is_near(self, cost: float, start: Vector, ends: Iterable[Vector]) -> bool:
        """Whether a motion from `start` (n,) at this cost [J] takes little more than the lift to the lowest end."""
        return cost <= (1.0 + _NEAR) * self.least(start, ends) + self.worth

    def least(self, start: Vector, ends: Iterable[Vector]) -> float:
        """By how much `start` (n,) is below the lowest of `ends`, (n,) each [J]; 0 if it is not below."""
        lowest = min(map(self._dynamics.potential_energy, ends))
        return max(lowest - self._dynamics.potential_energy(start), 0.0)


def is_frugal(world: World) -> bool:
    """Whether searches end where little more can be expected: with such an effort, for little work.

    What starts and searches cost at first says less about their ends for a cost that jumps, or that does not count the
    lift: with `effort` a motion of the Panda then cost 1.44 times as much.
    """
    objective = world.problem.objective
    return world.work.effort.frugal and objective.lifts and not objective.jumps


def little_cost(world: World) -> float:
    """A cost at which searches end, in the objective's unit; 0 if they are not frugal."""
    return Lift(world.problem).little if is_frugal(world) else 0.0
