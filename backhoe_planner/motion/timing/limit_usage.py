"""Which limit of the machine a motion uses most, moment by moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import Kinematics
from backhoe_planner.motion.between import between_samples
from backhoe_planner.motion.problem import Problem
from backhoe_planner.motion.timing.drive import drive_of
from backhoe_planner.motion.timing.retiming import use_of_drive
from backhoe_planner.motion.trajectory import Trajectory

__all__ = ["LimitUsage", "limit_usage"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LimitUsage:
    """How much of every limit a motion uses over time.

    Attributes
    ----------
    time: (T,) [s].
    names: of the L limits, a kind and what it belongs to: ``velocity boom``,
        ``acceleration swing``, ``torque stick``, ``rod speed bucket``, ``pump flow``,
        ``engine power``, ``tip speed``.
    ratio: (T, L) 1 at the limit.
    """

    time: Array
    names: tuple[str, ...]
    ratio: Array

    @property
    def binding(self) -> NDArray[np.int64]:
        """(T,) index of the limit of which most is used."""
        return np.asarray(np.argmax(self.ratio, axis=1), dtype=np.int64)

    @property
    def greatest(self) -> Array:
        """(T,) how much is used of that limit."""
        return np.asarray(np.max(self.ratio, axis=1))


def limit_usage(problem: Problem, trajectory: Trajectory, *, tip_speed: bool = True) -> LimitUsage:
    """What a motion uses of the limits of joints, drive and tip speed at every sample.

    Rates are those of the faster of the two segments beside a sample, accelerations and
    torques those of `Trajectory.accelerations`; what long segments take in between counts
    at both of their ends. The tip's speed counts where the tip is
    on the asked path and the scene asks for a speed.

    Parameters
    ----------
    tip_speed: whether it counts at all.
    """
    limits, joints = problem.limits, problem.robot.joint_names
    velocity = _beside(np.abs(trajectory.segment_velocities()), len(trajectory)) if len(trajectory) > 1 else None
    names = [f"velocity {joint}" for joint in joints]
    columns = [np.zeros_like(trajectory.q) if velocity is None else velocity / limits.velocity]
    names += [f"acceleration {joint}" for joint in joints]
    columns.append(np.abs(trajectory.accelerations()) / limits.acceleration)
    drive = drive_of(problem)
    if drive.limited:
        effort, speeds = use_of_drive(trajectory, drive)
        between = between_samples(trajectory)
        for values, more in zip((effort, speeds), drive.use_between(between), strict=True):
            for beside in (between.segment, between.segment + 1):
                np.maximum.at(values, beside, more)
        names += [f"torque {joint}" for joint in joints]
        columns.append(effort)
        if drive.hydraulics is not None:
            names += [*(f"rod speed {joint}" for joint in joints), "pump flow", "engine power"]
            columns.append(speeds)
    task = problem.scene.task.path
    if tip_speed and task is not None and task.speed is not None and problem.path is not None:
        names.append("tip speed")
        kinematics = Kinematics(problem.robot)
        tips = np.array([kinematics.at(q).tip_position for q in trajectory.q])
        near = np.array([problem.path.nearest(tip)[1] <= task.tolerance for tip in tips])
        speed = np.zeros((len(trajectory), 1))
        if len(trajectory) > 1:
            there = (near[1:] & near[:-1])[:, None]
            moved = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(trajectory.time)
            speed = _beside(np.where(there, moved[:, None], 0.0), len(trajectory))
        columns.append(speed / task.speed)
    return LimitUsage(trajectory.time, tuple(names), np.hstack(columns))


def _beside(segment: Array, count: int) -> Array:
    """(T, k) the greater of the values on the segments beside each sample."""
    found = np.zeros((count, segment.shape[1]))
    found[:-1] = segment
    found[1:] = np.maximum(found[1:], segment)
    return found
