"""Joints that a scene names: each must exist and move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import SceneError
from backhoe_planner.machine import Robot
from backhoe_planner.site.scene_file import Scene

_SAME = 1e-6  # rad, m: the rounding of a held joint's position as a person or a file writes it


def check_joint_names(robot: Robot, scene: Scene, names: Iterable[str], *, key: str) -> None:
    """Check names of joints that a scene has at `key`.

    Raises
    ------
    SceneError: one of `names` is none of the joints that move the machine.
    """
    standing = {joint.name: joint.position for joint in robot.held}
    for name in names:
        if name in standing:
            raise SceneError(
                f"the joint stands still at {standing[name]:g}, the planner does not move it",
                file=scene.file,
                key=key,
                found=name,
                allowed=", ".join(robot.joint_names),
            )
        if name not in robot.joint_names:
            problem = "the machine has no such joint"
            raise SceneError.unknown_name(problem, name, names=robot.joint_names, file=scene.file, key=key)


def joint_positions(robot: Robot, scene: Scene, joints: Mapping[str, float], *, key: str) -> Vector:
    """(n,) the position of every joint [rad or m], as a scene gives them at `key`.

    A joint that stands still may be named too, with the position at which it stands.

    Raises
    ------
    SceneError: a joint is missing, is none of the machine's, or stands still at another position.
    """
    standing = {joint.name: joint.position for joint in robot.held}
    for name, position in joints.items():
        if name in standing and abs(position - standing[name]) > _SAME:
            held = "is held" if name in robot.hold else "stands still, as no joint that moves the tip,"
            raise SceneError(
                f"{held} at {standing[name]:g}",
                file=scene.file,
                key=f"{key}.{name}",
                found=position,
                allowed=f"{standing[name]:g}, or leave it out",
                hint=None if name in robot.hold else f"`hold: {{{name}: ...}}` puts it elsewhere",
            )
    check_joint_names(robot, scene, (name for name in joints if name not in standing), key=key)
    missing = [name for name in robot.joint_names if name not in joints]
    if missing:
        raise SceneError(f"joints are missing: {', '.join(missing)}", file=scene.file, key=key)
    return robot.check_q([joints[name] for name in robot.joint_names], what=key)
