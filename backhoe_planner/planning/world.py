"""What a search works in."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import Problem
from backhoe_planner.planning.reactive.stepping import Stepper, Watcher
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.search.postures import Postures
from backhoe_planner.site import Obstacle, Proximity


class World:
    """A problem among certain obstacles, and the work that may be done on it.

    Attributes
    ----------
    problem: what is to be planned.
    seed: of every random choice.
    work: what is left of the effort of the plan; shared with the worlds that come `among`.
    proximity: to the obstacles that count here.
    kinematics: of the machine.
    postures: finds configurations for the tip among these obstacles.
    """

    def __init__(self, problem: Problem, *, seed: int, work: Work, watch: Watcher | None = None) -> None:
        self.problem = problem
        self.seed = seed
        self.work = work
        self.kinematics = Kinematics(problem.robot)
        self._watch = watch
        self._put(problem.obstacles)

    def among(self, obstacles: Sequence[Obstacle]) -> World:
        """The same with nothing but `obstacles`; random choices begin anew from the seed."""
        other = copy.copy(self)
        other._put(obstacles)
        return other

    def stepper(self, q: Vector) -> Stepper:
        """A motion that begins at `q` (n,), at rest."""
        return Stepper(self.problem, q, proximity=self.proximity, kinematics=self.kinematics, watch=self._watch)

    def _put(self, obstacles: Sequence[Obstacle]) -> None:
        self.proximity = Proximity(self.problem.robot, obstacles)
        self.postures = Postures(
            self.problem, proximity=self.proximity, kinematics=self.kinematics, rng=np.random.default_rng(self.seed)
        )
