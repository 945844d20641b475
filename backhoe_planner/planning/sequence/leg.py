"""A leg to be planned, and the result of planning it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.machine import Kinematics, TipTarget
from backhoe_planner.motion import SAMPLE_PERIOD, Goal, Problem, Trajectory, join_at_stops
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.proof import Certificate

_SAME_PLACE = 1e-8  # rad or m: rounding; if two motions are further apart, one does not continue the other


@dataclass(frozen=True, eq=False)
class Leg:
    """One leg of a sequence, before it is planned.

    Attributes
    ----------
    problem: of the leg; its name is the leg's. Its start counts only for the first leg: any other begins
        where the one before has ended.
    motion: a ready motion from rest to rest, such as a cut: only the motion to its beginning is planned. None if
        all is to be planned.

    Raises
    ------
    InputError: the motion is of another machine.
    """

    problem: Problem
    motion: Trajectory | None = None

    def __post_init__(self) -> None:
        problem = check_kind(self.problem, Problem, key="problem")
        if problem.legs:
            raise InputError("is a sequence itself", key="problem", found=problem.scene.name or "a sequence")
        if self.motion is None:
            return
        motion = check_kind(self.motion, Trajectory, key="motion")
        if motion.q.shape[1] != problem.robot.n:
            raise InputError("has another number of joints", key="motion", found=motion.q.shape[1])
        if not problem.goals and problem.path is None:
            object.__setattr__(self, "problem", replace(problem, goals=(posture_goal(problem, motion.q[-1]),)))

    @property
    def name(self) -> str:
        """The name of the leg."""
        return self.problem.name


def posture_goal(problem: Problem, q: Vector, name: str = "end of the motion") -> Goal:
    """The goal of being at rest at `q` (n,) [rad or m]."""
    at = Kinematics(problem.robot).at(q)
    return Goal(TipTarget(at.tip_position, rotation=at.tip_rotation), q=q, name=name)


@dataclass(frozen=True, eq=False)
class DoneLeg:
    """A leg for which a motion was planned.

    Attributes
    ----------
    problem: of the leg, with its start, on its own clock.
    outcome: the motion from rest to rest, or why there is none.
    certificate: what is proven of the motion.
    is_ready: whether it has a ready motion, which is driven unchanged.
    """

    problem: Problem
    outcome: Outcome
    certificate: Certificate
    is_ready: bool = False

    @property
    def motion(self) -> Trajectory:
        """The motion of the leg, on its own clock."""
        return self.outcome.trajectory

    @property
    def may_go_over(self) -> bool:
        """Whether it may join another leg without a stop: not if it failed, waits, or is driven unchanged."""
        return not (self.failed or self.is_ready) and self.problem.wait is None

    @property
    def failed(self) -> bool:
        """Whether the motion does not do the leg's task."""
        return not self.certificate.verified


def join(motions: Sequence[Trajectory]) -> Trajectory:
    """The motions one after the other, each beginning where and when the one before has ended.

    A motion that takes no time becomes a rest of one sample, so that every leg has a part of its own.
    """
    parts, begins, count = [Trajectory.from_steps(np.zeros(1), motions[0].q[:1])], [], 0
    for motion in motions:
        if np.max(np.abs(motion.q[0] - parts[-1].q[-1])) > _SAME_PLACE:
            raise InputError("does not begin where the motion before has ended", key="motions")
        own = motion if len(motion) > 1 else Trajectory.from_steps(np.array([0.0, SAMPLE_PERIOD]), motion.q[[0, 0]])
        begins.append(count)
        parts.append(own)
        count += len(own) - 1
    return replace(join_at_stops(parts, [()] * len(motions)), begins=tuple(begins))
