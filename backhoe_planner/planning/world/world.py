"""The world of a search: a problem, the obstacles that count, and the work that is left."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import OBJECTIVES, Problem, TipPath, Trajectory
from backhoe_planner.planning.paths.local_resolution import resolve_along
from backhoe_planner.planning.paths.stretch import Stretch
from backhoe_planner.planning.reactive.stepping import PlannerStep, Stepper, Watcher
from backhoe_planner.planning.search.effort import Effort, Work
from backhoe_planner.planning.search.postures import Postures
from backhoe_planner.site import Obstacle, Proximity

_SEEDS_APART = (
    7_368_787  # a prime, so that searches begun anew draw nothing that ways of this one or of the next seed draw
)
_SHOWN = 5  # samples of a motion that is shown, of which one is; ten a second


class World:
    """A problem among certain obstacles, and the work that may be done on it.

    Attributes
    ----------
    problem: what is to be planned.
    seed: of every random choice.
    work: what is left of the effort of the plan; worlds made by `among` share it.
    proximity: to the obstacles that count here.
    kinematics: of the machine.
    postures: finds configurations for the tip among these obstacles.
    apart: by the names of a link and of what it came too near to, as `Obstruction` has them: how much more than its
        clearance such a pair keeps along a path, wherever it can [m].
    """

    def __init__(
        self,
        problem: Problem,
        *,
        seed: int,
        work: Work,
        watch: Watcher | None = None,
        apart: Mapping[tuple[str, str], float] | None = None,
    ) -> None:
        self.problem = problem
        self.seed = seed
        self.work = work
        self.kinematics = Kinematics(problem.robot)
        self._watch = watch
        self.apart = dict(apart or {})
        self._put(problem.obstacles)

    def among(self, obstacles: Sequence[Obstacle]) -> World:
        """The same problem among `obstacles` alone; random choices begin anew from the seed."""
        other = copy.copy(self)
        other._put(obstacles)
        return other

    def for_time(self, effort: Effort) -> World:
        """The same problem, to be solved in the least time with this effort; nobody watches."""
        other = copy.copy(self)
        other.problem = replace(self.problem, objective=OBJECTIVES["time"])
        other.work, other._watch = Work(effort, self.work.brake), None
        other._put(self._obstacles)
        return other

    def anew(self, number: int, effort: Effort) -> World:
        """The same problem with random choices of its own by `number`, and this effort; nobody watches.

        For 0 they are those of this world, from the beginning.
        """
        other = copy.copy(self)
        other.seed = (self.seed + number * _SEEDS_APART) % 2**32
        other.work, other._watch = Work(effort, self.work.brake), None
        other._put(self._obstacles)
        return other

    def within(self, tolerance: float) -> World:
        """The same problem with a path whose tip may be off it by `tolerance` [m]."""
        other = copy.copy(self)
        scene = self.problem.scene
        assert scene.task.path is not None
        task = scene.task.model_copy(update={"path": scene.task.path.model_copy(update={"tolerance": tolerance})})
        other.problem = replace(self.problem, scene=scene.model_copy(update={"task": task}))
        return other

    def stepper(self, q: Vector) -> Stepper:
        """A motion that begins at `q` (n,), at rest."""
        return Stepper(self.problem, q, proximity=self.proximity, kinematics=self.kinematics, watch=self._watch)

    def show(self, motion: Trajectory, *, attempt: int, best: float) -> None:
        """Show whoever watches the planner the best motion to a goal so far, and what it costs."""
        if self._watch is None:
            return
        for time, q in zip(motion.time[::_SHOWN], motion.q[::_SHOWN], strict=True):
            self._watch(PlannerStep(float(time), q, attempt, best))

    def keeps(self, motion: Trajectory) -> bool:
        """Whether a motion is proven to keep what the problem asks for; true where that is nothing."""
        keep = self.problem.keep
        return keep is None or keep.motion_holds(motion.q)

    def follow_law(self, path: TipPath, s: float, q: Vector, *, time: float) -> Stretch:
        """As far as the local law goes along `path` from arc length `s` [m], with the joints at `q` (n,).

        Parameters
        ----------
        time: the obstacles stand where they are at this time [s].
        """
        return resolve_along(self.problem, path, s, q, proximity=self.proximity, kinematics=self.kinematics, time=time)

    def _put(self, obstacles: Sequence[Obstacle]) -> None:
        self._obstacles = obstacles
        self.proximity = Proximity(self.problem.robot, obstacles)
        self.postures = Postures(
            self.problem, proximity=self.proximity, kinematics=self.kinematics, rng=np.random.default_rng(self.seed)
        )
