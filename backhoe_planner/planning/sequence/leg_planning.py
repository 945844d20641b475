"""The motion of one leg, from where the leg before it has ended."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.planning.planner import plan_motion
from backhoe_planner.planning.reactive.stepping import Watcher
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import Brake, Effort
from backhoe_planner.planning.sequence.leg import DoneLeg, Leg, join, posture_goal
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.proof import certify_motion

_THERE = 1e-9  # rad or m: rounding; a ready motion that begins nearer than this needs no motion to it


@dataclass(frozen=True, eq=False)
class LegPlanner:
    """Plans single legs, all with the same settings.

    Attributes
    ----------
    method, seed, effort: for every leg.
    brake: for all legs together.
    watch: called with every step while a leg is planned.
    """

    method: Method
    seed: int
    effort: Effort
    brake: Brake
    watch: Watcher | None = None

    def plan(self, leg: Leg, start: Vector | None, *, time: float = 0.0, asked: Leg | None = None) -> DoneLeg:
        """The motion of one leg.

        Parameters
        ----------
        start: (n,) where it begins [rad or m]; None for the first leg, whose problem gives its start.
        time: when it begins [s].
        asked: the same leg with more requirements, such as one posture at its end; the proof is for the leg itself.
        """
        problem = leg.problem
        if start is None and problem.wait is not None:
            start = problem.start_q  # a wait has to keep its own start
        if start is not None:
            problem = problem.beginning(start, time)
        if leg.motion is not None:
            return self._ready(leg.motion, problem)
        more = problem if asked is None else replace(problem, goals=asked.problem.goals, path=asked.problem.path)
        outcome, certificate = plan_motion(
            more, self.method, seed=self.seed, effort=self.effort, brake=self.brake, watch=self.watch
        )
        if more is not problem:
            certificate = certify_motion(problem, outcome.trajectory)
        return DoneLeg(problem, outcome, certificate)

    def _ready(self, motion: Trajectory, problem: Problem) -> DoneLeg:
        """A ready motion, after a planned motion to its beginning."""
        start = problem.start_q
        if start is None or float(np.max(np.abs(start - motion.q[0]))) <= _THERE:
            exact = motion if start is None else Trajectory.from_steps(motion.time, np.vstack((start, motion.q[1:])))
            return DoneLeg(problem, Outcome(exact), certify_motion(problem, exact), is_ready=True)
        to_it = replace(problem, goals=(posture_goal(problem, motion.q[0], "beginning of the motion"),), path=None)
        outcome, certificate = plan_motion(
            to_it, self.method, seed=self.seed, effort=self.effort, brake=self.brake, watch=self.watch
        )
        if not certificate.verified:
            return DoneLeg(problem, outcome, certificate)
        last = outcome.trajectory
        exact = Trajectory.from_steps(motion.time, np.vstack((last.q[-1], motion.q[1:])))
        whole = replace(join([last, exact]), begins=())
        certificate = certify_motion(problem, whole)
        return DoneLeg(problem, replace(outcome, trajectory=whole), certificate, is_ready=True)
