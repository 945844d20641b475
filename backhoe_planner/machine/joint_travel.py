"""How long joints take from rest to rest, and how far they get, by their greatest velocities and accelerations."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Vector
from backhoe_planner.machine.robot import JointLimits


def travel_times(steps: Array, limits: JointLimits) -> Array:
    """(...) the least times for `steps` (..., n) of the joints from rest to rest, of the slowest joint each [s]."""
    way = np.abs(steps)
    ramps = way * limits.acceleration < limits.velocity**2  # too short to reach the full rate
    slow = 2.0 * np.sqrt(way / limits.acceleration)
    fast = way / limits.velocity + limits.velocity / limits.acceleration
    return np.asarray(np.max(np.where(ramps, slow, fast), axis=-1))


def travel_within(time: float, limits: JointLimits) -> Vector:
    """(n,) how far each joint can move from rest to rest in a `time` [s] [rad or m]."""
    peak = np.minimum(limits.velocity, 0.5 * limits.acceleration * time)
    return np.asarray(peak * (time - peak / limits.acceleration))
