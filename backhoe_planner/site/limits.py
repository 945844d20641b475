"""The machine's limits within one scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import SceneError, check_kind
from backhoe_planner.machine import JointLimits, Robot, TrackingTube
from backhoe_planner.site.scene_file import Scene
from backhoe_planner.site.schema.zone_kinds import SwingSector


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
        stop = zone.stop + float(_joint_errors(robot, scene)[0])
        lower[0], upper[0] = max(lower[0], zone.start + stop), min(upper[0], zone.end - stop)
        if not lower[0] < upper[0]:
            raise SceneError(
                "leaves the first joint no room",
                file=scene.file,
                key=key,
                found=f"{zone.start:g} to {zone.end:g}, each kept off by {stop:g}",
                allowed=f"{name} moves from {own.lower[0]:g} to {own.upper[0]:g}",
            )
    velocity = own.velocity * scene.limits.velocity_scale
    return replace(own, lower=lower, upper=upper, velocity=velocity, acceleration=acceleration)


def machine_on_site(robot: Robot, scene: Scene) -> Robot:
    """The machine as a scene has it: its tip, its first joint within the swing sectors, its tracking error.

    Raises
    ------
    RobotError: the scene's tip is not a link of the machine.
    SceneError: see `scaled_limits`; or the tracking error names a joint that the machine does not have.
    """
    check_kind(robot, Robot, key="robot")
    check_kind(scene, Scene, key="scene")
    robot = robot.with_tip(scene.tip)
    if any(isinstance(zone, SwingSector) for zone in scene.zones):
        limits = scaled_limits(robot, scene)
        robot = replace(robot, limits=replace(robot.limits, lower=limits.lower, upper=limits.upper))
    if scene.tracking is None:
        return robot
    tip = np.inf if scene.tracking.tip is None else scene.tracking.tip
    return replace(robot, tube=TrackingTube(_joint_errors(robot, scene), tip))


def check_joint_names(robot: Robot, scene: Scene, names: Iterable[str], *, key: str) -> None:
    """Check names of joints that a scene has at `key`.

    Raises
    ------
    SceneError: one of `names` is none of the machine's joints.
    """
    for name in names:
        if name not in robot.joint_names:
            problem = "the machine has no such joint"
            raise SceneError.unknown_name(problem, name, names=robot.joint_names, file=scene.file, key=key)


def _joint_errors(robot: Robot, scene: Scene) -> Vector:
    """(n,) of every joint, by the scene's tracking error [rad or m]."""
    joints = 0.0 if scene.tracking is None else scene.tracking.joints
    if isinstance(joints, float):
        return np.full(robot.n, joints)
    check_joint_names(robot, scene, joints, key="tracking.joints")
    return np.array([joints.get(name, 0.0) for name in robot.joint_names])
