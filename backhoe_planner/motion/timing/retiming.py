"""A finished motion made slower where the machine could not drive it.

The samples stay, only their times change: the way of the joints, and with it every
distance to what stands still, is the same.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.machine import JointLimits
from backhoe_planner.motion.timing.drive import Drive
from backhoe_planner.motion.timing.path_limits import PathShape, time_path
from backhoe_planner.motion.trajectory import Trajectory

__all__ = ["DRIVEN_WITHIN", "retimed"]


DRIVEN_WITHIN = 0.01  # over a limit of the drive that a sampled motion may be: its accelerations are differences
_ENOUGH = 0.5 * DRIVEN_WITHIN
_SLOWEST = 50.0  # times slower than it was, beyond which a motion stays as it is


def retimed(trajectory: Trajectory, limits: JointLimits, *, drive: Drive | None) -> Trajectory:
    """The same way, slower where its torques, speeds, flow or power are more than the machine has.

    Where a static load cannot be held, torques are not limited: slowing down does not reduce them.
    """
    if drive is None or not drive.limited or len(trajectory) < 3:
        return trajectory
    if _over(trajectory, drive) <= 1.0 + _ENOUGH:
        return trajectory
    for part in (1.0, 0.97):
        slower = _locally(trajectory, limits, drive, part)
        if slower is not None and _over(slower, drive) <= 1.0 + _ENOUGH and _joints_kept(slower, limits):
            return slower
    return _stretched(trajectory, drive)


def _joints_kept(trajectory: Trajectory, limits: JointLimits) -> bool:
    velocity = np.abs(trajectory.segment_velocities()) / limits.velocity
    acceleration = np.abs(trajectory.accelerations()) / limits.acceleration
    return bool(max(velocity.max(), acceleration.max()) <= 1.0 + 1e-7)


def _over(trajectory: Trajectory, drive: Drive) -> float:
    """The greatest use of the drive; without torque, where a load could not be held at rest either."""
    use = drive.use_along(trajectory.moments(longest=np.inf))
    most, worst = float(np.max(use.speeds)), float(np.max(use.effort))
    if worst <= max(most, 1.0):
        return max(most, worst)
    still = np.zeros_like(trajectory.q)
    load = drive.rigid_torques(trajectory.q, still, still)
    for static in (load, load + drive.soil_torques(trajectory.q, trajectory.v)):
        if np.any(drive.effort_use(trajectory.q, static) > 1.0):
            return most
    return worst


def _locally(trajectory: Trajectory, limits: JointLimits, drive: Drive, part: float) -> Trajectory | None:
    """Slower where it must be, never faster; None where no such run is found.

    The place on the way is the time it had, so that velocity and acceleration of the
    samples are its slope and bend.
    """
    v, a = trajectory.v.copy(), trajectory.accelerations()
    segment = trajectory.segment_velocities()
    v[0], v[-1] = segment[0], segment[-1]  # in motion at once, as the samples are
    bend = a.copy()
    bend[0], bend[-1] = bend[1], bend[-2]
    shape = PathShape(trajectory.time, trajectory.q, v, bend[:-1], bend[1:])
    tight = JointLimits(
        lower=limits.lower,
        upper=limits.upper,
        velocity=limits.velocity,
        acceleration=np.maximum(limits.acceleration, 1.001 * np.max(np.abs(a), axis=0)),
        effort=limits.effort,
    )
    law = time_path(shape, tight, drive=drive, most=part, rests=False)
    if law is None:
        return None
    return Trajectory.from_steps(law.time, trajectory.q)


def _stretched(trajectory: Trajectory, drive: Drive) -> Trajectory:
    """All of it slower by one factor; as it was where even the slowest would be too much."""

    def stretched(factor: float) -> Trajectory:
        return Trajectory.from_steps(trajectory.time * factor, trajectory.q)

    high = 1.05
    while _over(stretched(high), drive) > 1.0 + _ENOUGH:
        high *= 1.5
        if high > _SLOWEST:
            return trajectory
    low = max(high / 1.5, 1.0)
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _over(stretched(middle), drive) <= 1.0 + _ENOUGH else (middle, high)
    return stretched(high)
