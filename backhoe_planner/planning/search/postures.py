"""Configurations that put the tip on a target, clear of everything."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Vector
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
from backhoe_planner.site import Obstruction, Proximity

_SPARE = 0.003  # m beyond the clearance, so that the motion can end there
_SAME = 0.05  # rad: configurations nearer than this count as one


@dataclass(frozen=True)
class Found:
    """What was found for one target.

    Attributes
    ----------
    clear: (n,) configurations that keep every clearance, the nearest to `near` first.
    reachable: whether the tip can be put there at all.
    best: the inverse kinematics' result with the least error.
    contact: where all that reach it collide, the mildest collision.
    """

    clear: tuple[Vector, ...]
    reachable: bool
    best: InverseKinematics
    contact: Obstruction | None


class Postures:
    """Finds configurations for one problem; draws from one seeded generator."""

    def __init__(
        self, problem: Problem, *, proximity: Proximity, kinematics: Kinematics, rng: np.random.Generator
    ) -> None:
        self._problem = problem
        self._proximity = proximity
        self._kinematics = kinematics
        self._rng = rng
        self._batch = BatchKinematics(problem.robot)

    def at(self, target: TipTarget, *, near: Vector | None = None, count: int = 24, time: float = 0.0) -> Found:
        """Clear configurations that put the tip on `target`.

        Parameters
        ----------
        near: (n,) from where they are to be reached: the first to be tried, and the
            order of the result, by the time that the slowest joint takes.
        count: how many starting points of the inverse kinematics.
        """
        robot = self._problem.robot
        near = robot.middle if near is None else near
        guesses = np.array([near, *(robot.random_q(self._rng) for _ in range(count - 1))])
        batch = TargetBatch.of([target] * count)
        ends, reached = solve_batch(self._batch, batch, guesses)
        best: InverseKinematics | None = None
        clear: list[Vector] = []
        mildest: Obstruction | None = None
        for q in ends[reached]:
            best = best or InverseKinematics(True, q, *target.distances(self._kinematics.at(q)), count)
            if any(float(np.max(np.abs(q - other))) <= _SAME for other in clear):
                continue
            contact = self._proximity.tightest(q, time=time)
            if contact is None or contact.margin >= _SPARE:
                clear.append(q)
            elif mildest is None or contact.margin > mildest.margin:
                mildest = contact
        if best is None:
            best = solve_inverse_kinematics(robot, target, start=near, rng=self._rng)
            if best.reached:
                contact = self._proximity.tightest(best.q, time=time)
                if contact is None or contact.margin >= _SPARE:
                    clear.append(best.q)
                else:
                    mildest = contact
        rate = self._problem.limits.velocity
        clear.sort(key=lambda q: float(np.max(np.abs(q - near) / rate)))
        return Found(tuple(clear), best.reached, best, None if clear else mildest)
