"""The machine's limits within one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.errors import SceneError
from backhoe_planner.machine import JointLimits, Robot
from backhoe_planner.site.scene_file import Scene, SwingSector


def scaled_limits(robot: Robot, scene: Scene) -> JointLimits:
    """The machine's limits after the scene's velocity scale, accelerations and swing sectors.

    Raises
    ------
    SceneError: a swing sector leaves the first joint no room, or the first joint slides.
    """
    own = robot.limits
    given = scene.limits.acceleration
    pairs = zip(robot.joint_names, own.acceleration.tolist(), strict=True)
    acceleration = np.array([given.get(name, value) for name, value in pairs])
    lower, upper = own.lower.copy(), own.upper.copy()
    for index, zone in enumerate(scene.zones):
        if not isinstance(zone, SwingSector):
            continue
        key = f"zones[{index}] ({zone.name})"
        name = robot.joint_names[0]
        if robot.prismatic[0]:
            raise SceneError("the first joint does not swing, it slides", file=scene.file, key=key, found=name)
        lower[0], upper[0] = max(lower[0], zone.start + zone.stop), min(upper[0], zone.end - zone.stop)
        if not lower[0] < upper[0]:
            raise SceneError(
                "leaves the first joint no room",
                file=scene.file,
                key=key,
                found=f"{zone.start:g} to {zone.end:g}, each kept off by {zone.stop:g}",
                allowed=f"{name} moves from {own.lower[0]:g} to {own.upper[0]:g}",
            )
    velocity = own.velocity * scene.limits.velocity_scale
    return replace(own, lower=lower, upper=upper, velocity=velocity, acceleration=acceleration)


def within_sectors(robot: Robot, scene: Scene) -> Robot:
    """The machine with its first joint limited to the scene's swing sectors; itself where there is none."""
    if not any(isinstance(zone, SwingSector) for zone in scene.zones):
        return robot
    limits = scaled_limits(robot, scene)
    return replace(robot, limits=replace(robot.limits, lower=limits.lower, upper=limits.upper))
