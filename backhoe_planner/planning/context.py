"""What every part of one planning run shares."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Problem
from backhoe_planner.planning.reactive.stepping import Stepper, Watcher
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.search.postures import Postures
from backhoe_planner.site import Obstacle, Proximity

__all__ = ["Context"]

Vector = NDArray[np.float64]


class Context:
    """One run of the planner: the problem, and the working memory for it.

    Attributes
    ----------
    problem: what is to be planned.
    seed: of every random choice.
    work: what may still be done.
    proximity: to all obstacles, over time.
    world: to what is taken to stand still while a way is searched; see `in_world`.
    kinematics: of the machine.
    postures: finds configurations for the tip in `world`.
    """

    def __init__(self, problem: Problem, *, seed: int, work: Work, watch: Watcher | None) -> None:
        self.problem = problem
        self.seed = seed
        self.work = work
        self.proximity = Proximity(problem.robot, problem.obstacles)
        self.kinematics = Kinematics(problem.robot)
        self._watch = watch
        self._look_at(self.proximity)

    def _look_at(self, world: Proximity) -> None:
        self.world = world
        self.postures = Postures(
            self.problem, proximity=world, kinematics=self.kinematics, rng=np.random.default_rng(self.seed)
        )

    def knowing(self, obstacles: Sequence[Obstacle]) -> Context:
        """The same run, in which there is nothing but `obstacles`."""
        other = copy.copy(self)
        other.proximity = Proximity(self.problem.robot, obstacles)
        other._look_at(other.proximity)
        return other

    def in_world(self, obstacles: Sequence[Obstacle]) -> Context:
        """The same run, with ways searched among `obstacles`, which stand still."""
        other = copy.copy(self)
        other._look_at(Proximity(self.problem.robot, obstacles))
        return other

    def stepper(self, q: Vector) -> Stepper:
        """A motion that begins at `q` (n,), at rest."""
        return Stepper(self.problem, q, proximity=self.proximity, kinematics=self.kinematics, watch=self._watch)
