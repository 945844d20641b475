"""What a scene leaves of the machine's limits."""

from __future__ import annotations

import numpy as np

from backhoe_planner.machine.robot import JointLimits, Robot
from backhoe_planner.site.scene import Scene

__all__ = ["scaled_limits"]


def scaled_limits(robot: Robot, scene: Scene) -> JointLimits:
    """The machine's limits with the scene's velocity scale and accelerations."""
    own = robot.limits
    acceleration = np.array(own.acceleration)
    for index, name in enumerate(robot.joint_names):
        acceleration[index] = scene.limits.acceleration.get(name, acceleration[index])
    return JointLimits(
        lower=own.lower.copy(),
        upper=own.upper.copy(),
        velocity=own.velocity * scene.limits.velocity_scale,
        acceleration=acceleration,
        effort=own.effort.copy(),
    )
