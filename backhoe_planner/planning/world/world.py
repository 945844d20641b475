"""The world of a search: a problem, the obstacles that count, and the remaining work."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import OBJECTIVES, Condition, Goal, Keep, Problem, TipPath, Trajectory
from backhoe_planner.planning.paths.local_resolution import resolve_along
from backhoe_planner.planning.reactive.stepping import PlannerStep, Stepper, Watcher
from backhoe_planner.planning.search.effort import Effort, Work
from backhoe_planner.planning.search.postures import Postures
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.site import Obstacle, Proximity, obstacles_in_reach

_SEEDS_APART = (
    7_368_787  # a prime, so that restarted searches share no draws with the routes of this seed or of the next one
)
_FEWER_MOTIONS = 6  # times; chosen: where a way was found with one more condition, few were sampled
_SHOWN = 5  # every fifth sample of a motion is shown; ten a second


class World:
    """A problem among certain obstacles, and the work that may still be done on it.

    Attributes
    ----------
    problem: what is to be planned.
    seed: of every random choice.
    work: the remaining effort of the plan; worlds made by `among` share it.
    proximity: to the obstacles that count here and that the machine can come near.
    kinematics: of the machine.
    postures: finds configurations for the tip among these obstacles.
    apart: how much more than its clearance a pair keeps along a path, wherever it can [m]; by the names of a link and
        of what it came too near to, as in `Obstruction`.
    aims: goals out of reach with where a search aims instead, by goal and whether its angles are narrowed by `keep`;
        worlds made from this one share it.
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
        self.aims: dict[tuple[Goal, bool], Goal] = {}
        self._put(problem.obstacles)

    def among(self, obstacles: Sequence[Obstacle]) -> World:
        """The same problem among `obstacles` alone; random choices begin anew from the seed."""
        other = copy.copy(self)
        other._put(obstacles)
        return other

    def for_time(self, effort: Effort) -> World:
        """The same problem for the least time, with this effort; no watcher is called."""
        other = copy.copy(self)
        other.problem = replace(self.problem, objective=OBJECTIVES["time"])
        other.work, other._watch = Work(effort, self.work.brake), None
        other._put(self._obstacles)
        return other

    def anew(self, number: int, effort: Effort) -> World:
        """The same problem with its own random choices, given by `number`, and this effort; no watcher is called.

        For 0 the random choices are those of this world, from the beginning.
        """
        other = copy.copy(self)
        other.seed = (self.seed + number * _SEEDS_APART) % 2**32
        other.work, other._watch = Work(effort, self.work.brake), None
        other._put(self._obstacles)
        return other

    def ending_at(self, goals: Sequence[Goal]) -> World:
        """The same problem with other `goals`, with all its effort and random choices anew; no watcher is called."""
        other = self.anew(0, self.work.effort)
        other.problem = replace(self.problem, goals=tuple(goals))
        other._put(self._obstacles)
        return other

    def keeping(self, condition: Condition) -> World:
        """The same problem with one more condition to be kept, with random choices anew and fewer motions to sample."""
        effort, kept = self.work.effort, self.problem.keep
        other = self.anew(0, replace(effort, motions=effort.motions // _FEWER_MOTIONS))
        keep = Keep(self.problem.robot, [*(() if kept is None else kept.conditions), condition])
        other.problem = replace(self.problem, keep=keep)
        other._put(self._obstacles)
        return other

    def slower(self, velocity: Vector) -> World:
        """The same problem with joints that are at most as fast as `velocity` (n,) [rad/s or m/s]."""
        other = copy.copy(self)
        limits = self.problem.limits
        other.problem = replace(
            self.problem, limits=replace(limits, velocity=np.minimum(velocity, limits.velocity))
        )  # fmt: skip
        return other

    def within(self, tolerance: float) -> World:
        """The same problem, with `tolerance` [m] as the tolerance of its path."""
        other = copy.copy(self)
        scene = self.problem.scene
        assert scene.task.path is not None
        task = scene.task.model_copy(update={"path": scene.task.path.model_copy(update={"tolerance": tolerance})})
        other.problem = replace(self.problem, scene=scene.model_copy(update={"task": task}))
        return other

    def stepper(self, q: Vector) -> Stepper:
        """A stepper for a motion that begins at rest at `q` (n,)."""
        return Stepper(self.problem, q, proximity=self.proximity, kinematics=self.kinematics, watch=self._watch)

    def show(self, motion: Trajectory, *, attempt: int, best: float) -> None:
        """Show the planner's watcher the best motion to a goal so far, and its cost."""
        if self._watch is None:
            return
        for time, q in zip(motion.time[::_SHOWN], motion.q[::_SHOWN], strict=True):
            self._watch(PlannerStep(float(time), q, attempt, best, self.problem.objective.unit))

    def keeps(self, motion: Trajectory) -> bool:
        """Whether a motion is proven to satisfy the problem's `keep`; true if there is none."""
        keep = self.problem.keep
        return keep is None or keep.motion_holds(motion.q)

    def follow_law(self, path: TipPath, s: float, q: Vector, *, time: float) -> Stretch:
        """The stretch of `path` that the local law can follow from arc length `s` [m], with the joints at `q` (n,).

        Parameters
        ----------
        time: at which the positions of the obstacles are taken [s].
        """
        return resolve_along(self.problem, path, s, q, proximity=self.proximity, kinematics=self.kinematics, time=time)

    def _put(self, obstacles: Sequence[Obstacle]) -> None:
        self._obstacles = obstacles
        self.proximity = Proximity(self.problem.robot, obstacles_in_reach(self.problem.robot, obstacles))
        self.postures = Postures(
            self.problem, proximity=self.proximity, kinematics=self.kinematics, rng=np.random.default_rng(self.seed)
        )
