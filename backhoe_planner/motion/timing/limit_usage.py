"""How much of every limit of the machine a motion uses, moment by moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.timing.drive import beside, drive_of
from backhoe_planner.motion.trajectory import Moments, Trajectory

__all__ = ["LimitUsage", "limit_usage"]


@dataclass(frozen=True, eq=False)
class LimitUsage:
    """How much of L limits a motion uses at M moments.

    Attributes
    ----------
    moments: the samples, and more inside long segments.
    limits: L kinds with the joint that each belongs to: ``velocity``, ``acceleration``, ``torque`` and
        ``rod speed`` of every joint; ``pump flow``, ``engine power`` and ``tip speed``, with no joint.
    ratio: (M, L) 1 at the limit.
    """

    moments: Moments
    limits: tuple[tuple[str, str], ...]
    ratio: Array

    @property
    def names(self) -> tuple[str, ...]:
        """L, such as ``velocity boom``."""
        return tuple(f"{kind} {joint}".strip() for kind, joint in self.limits)

    @property
    def binding(self) -> NDArray[np.int64]:
        """(M,) index of the limit that is used most."""
        return np.asarray(np.argmax(self.ratio, axis=1), dtype=np.int64)

    @property
    def greatest(self) -> Array:
        """(M,) how much of that limit is used."""
        return np.asarray(np.max(self.ratio, axis=1))

    def worst(self, *kinds: str) -> tuple[int, int]:
        """The moment and the limit, of these kinds, where most is used; there must be one."""
        columns = [index for index, (kind, _) in enumerate(self.limits) if kind in kinds]
        row, column = np.unravel_index(int(np.argmax(self.ratio[:, columns])), (len(self.ratio), len(columns)))
        return int(row), columns[int(column)]


def limit_usage(problem: Problem, trajectory: Trajectory, *, tip_speed: bool = True) -> LimitUsage:
    """What a motion uses of the limits of joints, drive and tip speed.

    Velocities are those of the faster of the two segments beside a sample, accelerations
    and torques those of `Trajectory.accelerations`. The tip's speed counts where the tip is
    on the path and the scene limits it.

    Parameters
    ----------
    tip_speed: whether it counts at all.
    """
    joints, moments = problem.robot.joint_names, trajectory.moments()
    velocity = np.zeros_like(trajectory.q)
    if len(trajectory) > 1:
        velocity = beside(np.abs(trajectory.segment_velocities())[moments.segment[:-1]])
    kinds = ["velocity", "acceleration"]
    columns = [velocity / problem.limits.velocity, np.abs(moments.a) / problem.limits.acceleration]
    drive = drive_of(problem)
    if drive.limited:
        use = drive.use_along(moments)
        kinds.append("torque")
        columns.append(use.effort)
        if drive.hydraulics is not None:
            kinds.append("rod speed")
            columns.append(use.speeds)
    limits = [(kind, joint) for kind in kinds for joint in joints]
    if drive.hydraulics is not None:
        limits += [("pump flow", ""), ("engine power", "")]
    task = problem.scene.task.path
    if tip_speed and task is not None and task.speed is not None and problem.path is not None:
        kinematics = Kinematics(problem.robot)
        tips = np.array([kinematics.at(q).tip_position for q in moments.q])
        near = np.array([problem.path.nearest(tip)[1] <= task.tolerance for tip in tips])
        speed = np.zeros(1)
        if len(tips) > 1:
            moved = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(moments.time)
            speed = beside(np.where(near[1:] & near[:-1], moved, 0.0))
        limits.append(("tip speed", ""))
        columns.append(speed[:, None] / task.speed)
    return LimitUsage(moments, tuple(limits), np.hstack(columns))
