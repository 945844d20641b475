"""The machine within a scene: which of its joints move, and within which limits."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, RobotError, SceneError, check_kind
from backhoe_planner.machine import DEFAULT_VELOCITY, Base, JointLimits, Robot, TrackingTube, held_overlaps, load_robot
from backhoe_planner.site.joint_names import check_joint_names
from backhoe_planner.site.scene_file import Scene
from backhoe_planner.site.schema.zone_kinds import SwingSector

# times the machine's own acceleration, above which one of the scene is rather meant in degrees: a radian has 57; chosen
_TOO_FAST = 20.0
_TOO_LONG = 200.0  # m: chosen; the longest machines are nearer to 100 m, and an arm of 0.2 m in millimetres is there
_INERTIA_ROUNDING = 0.01  # part of the greatest moment of inertia; chosen: files give few digits


def scaled_limits(robot: Robot, scene: Scene) -> JointLimits:
    """The machine's limits, narrowed by the scene's own, its velocity scale and swing sectors.

    Parameters
    ----------
    robot: the machine, with the scene's held joints.

    Raises
    ------
    SceneError: the scene's limits name a joint that does not move, or allow more than the URDF's; a
        swing sector leaves the first joint no room, or the first joint slides or is held outside of it.
    """
    own, given = robot.limits, scene.limits
    lower, upper = _ranges(robot, scene)
    for key, zone in swing_sectors(robot, scene).items():
        name = robot.joint_names[0]
        if robot.prismatic[0]:
            raise SceneError("the first joint does not swing, it slides", file=scene.file, key=key, found=name)
        stop = zone.stop + float(_joint_errors(robot, scene)[0])
        least, most = lower[0], upper[0]
        lower[0], upper[0] = max(least, zone.start + stop), min(most, zone.end - stop)
        if not lower[0] < upper[0]:
            raise SceneError(
                "leaves the first joint no room",
                file=scene.file,
                key=key,
                found=f"{zone.start:g} to {zone.end:g}, each kept off by {stop:g}",
                allowed=f"{name} moves from {least:g} to {most:g}",
            )
    velocity = _at_most(robot, scene, "velocity", own.velocity)
    acceleration = own.acceleration.copy()
    check_joint_names(robot, scene, given.acceleration, key="limits.acceleration")
    for j, name in enumerate(robot.joint_names):
        if name in given.acceleration:
            acceleration[j] = given.acceleration[name]
        elif name in given.velocity and name not in robot.urdf.acceleration:
            acceleration[j] *= velocity[j] / own.velocity[j]  # full rate is reached in the same time as before
    return JointLimits(
        lower=lower,
        upper=upper,
        velocity=velocity * given.velocity_scale,
        acceleration=acceleration,
        effort=_at_most(robot, scene, "effort", own.effort),
    )


def base_of(scene: Scene) -> Base:
    """Where the scene's machine stands."""
    return Base(scene.base.position, scene.base.heading)


def joints_on_site(robot: Robot, scene: Scene) -> Robot:
    """The machine with the scene's tip and held joints, where it stands on the site.

    Raises
    ------
    RobotError: the scene's tip is not a link of the machine.
    SceneError: the scene holds a joint that cannot be held there.
    """
    check_kind(robot, Robot, key="robot")
    check_kind(scene, Scene, key="scene")
    with _errors_of(scene):
        return robot.with_tip(scene.tip).with_hold(scene.hold).with_base(base_of(scene))


def machine_on_site(robot: Robot, scene: Scene) -> Robot:
    """The machine as a scene has it: its place, tip and held joints, the others' ranges, its tracking error.

    Raises
    ------
    RobotError: see `joints_on_site`.
    SceneError: see `joints_on_site` and `scaled_limits`; held joints make links overlap; or the
        tracking error names a joint that does not move.
    """
    robot = joints_on_site(robot, scene)
    for link, other, depth in held_overlaps(robot):
        raise SceneError(
            f"puts {link} into {other}", file=scene.file, key="hold", found=f"an overlap of {depth:.3g} m",
            allowed="positions in which the machine does not touch itself",
        )  # fmt: skip
    if scene.limits.position or swing_sectors(robot, scene):
        limits = scaled_limits(robot, scene)
        robot = replace(robot, limits=replace(robot.limits, lower=limits.lower, upper=limits.upper))
    if scene.tracking is None:
        return robot
    tip = np.inf if scene.tracking.tip is None else scene.tracking.tip
    return replace(robot, tube=TrackingTube(_joint_errors(robot, scene), tip))


def load_machine(source: str | os.PathLike[str], scene: Scene, *, tip: str | None = None) -> Robot:
    """The machine of a URDF with the scene's tip, or `tip` if the scene gives none, held joints and place.

    Raises
    ------
    RobotError: see `load_robot`.
    SceneError: the scene holds a joint that cannot be held there.
    """
    with _errors_of(scene):
        robot = load_robot(source, tip=tip if scene.tip is None else scene.tip, hold=scene.hold)
    return robot.with_base(base_of(scene))


@contextlib.contextmanager
def _errors_of(scene: Scene) -> Iterator[None]:
    """Turn errors about held joints into errors of the scene."""
    try:
        yield
    except RobotError:
        raise
    except InputError as error:
        raise SceneError.of(error, file=scene.file, key=error.key) from None


def swing_sectors(robot: Robot, scene: Scene) -> dict[str, SwingSector]:
    """The swing sectors that limit the machine's first joint, by their keys; none if that joint is held.

    Raises
    ------
    SceneError: the joint is held outside of a sector.
    """
    sectors = {
        f"zones[{index}] ({zone.name})": zone for index, zone in enumerate(scene.zones) if isinstance(zone, SwingSector)
    }
    held = robot.first_held_at
    if held is None:
        return sectors
    for key, zone in sectors.items():
        if not zone.start + zone.stop <= held <= zone.end - zone.stop:
            raise SceneError(
                "the first joint is held outside of it",
                file=scene.file,
                key=key,
                found=held,
                allowed=f"{zone.start + zone.stop:g} to {zone.end - zone.stop:g}",
            )
    return {}


def range_sources(robot: Robot, scene: Scene, joint: int) -> tuple[str, str]:
    """What of the scene sets the lower and the upper end of a joint's range, in words; empty where the URDF does.

    It is the narrowest: ``limits.position``, or the swing sector of a name.

    Parameters
    ----------
    joint: its index.

    Raises
    ------
    SceneError: see `swing_sectors`.
    """
    name = robot.joint_names[joint]
    limit, given = robot.urdf.joints[name].limit, scene.limits.position.get(name)
    bounded = limit is not None and robot.urdf.joints[name].type != "continuous"
    own = (limit.lower, limit.upper) if limit is not None and bounded else (-np.inf, np.inf)
    ends, words = list(own if given is None else given), ["" if given is None else "limits.position"] * 2
    if given is not None:
        words = [word if given[side] != own[side] else "" for side, word in enumerate(words)]
    error = float(_joint_errors(robot, scene)[joint])
    for zone in swing_sectors(robot, scene).values() if joint == 0 else ():
        for side, (sense, end) in enumerate(((1.0, zone.start), (-1.0, zone.end))):
            end += sense * (zone.stop + error)
            if sense * (end - ends[side]) > 0.0:
                ends[side], words[side] = end, zone.name
    return words[0], words[1]


def limit_warnings(robot: Robot, scene: Scene | None = None) -> tuple[str, ...]:
    """Warnings of limits and masses that neither URDF nor scene gives, or that no machine has, and of its length."""
    velocity, effort, position = (
        (scene.limits.velocity, scene.limits.effort, scene.limits.position) if scene is not None else ({}, {}, {})
    )
    found = []
    if names := [name for name in robot.without_velocity if name not in velocity]:
        slides = [bool(robot.prismatic[robot.joint_names.index(name)]) for name in names]
        units = " or ".join(unit for unit, used in (("rad/s", not all(slides)), ("m/s", any(slides))) if used)
        found.append(
            f"the URDF gives no velocity limit, or 0, for {', '.join(names)}: {DEFAULT_VELOCITY:g} {units} is assumed; "
            f"the scene can give it (limits: {{velocity: {{{names[0]}: ...}}}})"
        )
    if names := [name for name in robot.without_effort if name not in effort]:
        found.append(
            f"the URDF gives no effort limit, or 0, for {', '.join(names)}: torque or force is not limited; "
            f"the scene can give it (limits: {{effort: {{{names[0]}: ...}}}})"
        )
    if soft := {name: ends for name, ends in robot.soft_limits.items() if name not in position}:
        ranges = ", ".join(f"{name}: [{low!r}, {high!r}]" for name, (low, high) in soft.items())
        found.append(
            "the URDF's soft limits (safety_controller) are not used, only its limits; "
            f"the scene can narrow them (limits: {{position: {{{ranges}}}}})"
        )
    weightless = [index for index, inertia in enumerate(robot.model.inertias.tolist()) if index and not inertia.mass]
    if len(weightless) == robot.n:
        found.append(
            "no link that moves has a mass in the URDF: torque, work and energy are those of payload and soil alone, "
            "0 without them"
        )
    elif names := list(dict.fromkeys(piece.link for piece in robot.pieces if piece.joint in weightless)):
        found.append(
            f"{', '.join(names)}: no mass in the URDF, unlike other links that move: torque, work and energy are "
            "those of the others, payload and soil"
        )
    found += _impossible_inertias(robot)
    placements = [*robot.model.jointPlacements.tolist()[2:], robot.model.frames[robot.tip_frame].placement]
    length = sum(float(np.linalg.norm(placement.translation)) for placement in placements)
    if length > _TOO_LONG:
        found.append(
            f"the machine is {length:,.0f} m long from its first joint to its tip; lengths in a URDF are in metres, "
            f"{length:,.0f} mm are {length / 1000.0:.3g} m"
        )
    return tuple(found)


def _impossible_inertias(robot: Robot) -> list[str]:
    """Moments of inertia that no body has, one of them more than the two others together, in words.

    Links that are fixed to each other count as one body.
    """
    found = []
    for joint, name in enumerate(robot.joint_names, start=1):
        least, middle, greatest = np.linalg.eigvalsh(robot.model.inertias[joint].inertia).tolist()
        if least + middle < (1.0 - _INERTIA_ROUNDING) * greatest:
            found.append(
                f"{robot.urdf.joints[name].child} with what is fixed to it has the principal moments of inertia "
                f"{least:.3g}, {middle:.3g} and {greatest:.3g} kg m^2: no body has one that is more than the other two "
                "together; torques of fast motions may be wrong"
            )
    return found


def input_warnings(
    robot: Robot, scene: Scene | None = None, *, with_task: bool = True, is_planned: bool = False
) -> tuple[str, ...]:
    """Warnings for every command: what is assumed of a machine and its site, and what is not used or not proven.

    Parameters
    ----------
    with_task: whether the scene's task is used.
    is_planned: whether machine and scene are those of a plan. Then what the scene may have meant otherwise is left out,
        such as an angle in degrees: it was said before the plan was made.

    Raises
    ------
    SceneError: a path file is missing, empty, or malformed.
    """
    found = [*robot.warnings, *limit_warnings(robot, scene)]
    if scene is not None:
        found += scene.warnings() if with_task and not is_planned else ()
        found += [
            f"the mesh {file} ({', '.join(names)}) is not closed: nothing touches its triangles, but what lies between "
            "them may count as free; where it is solid, fill its holes (in MeshLab: Close Holes)"
            for file, names in scene.open_meshes().items()
        ]
        found += () if is_planned else (*_doubtful_accelerations(robot, scene), *scene.doubtful_meshes())
    return tuple(found)


def _doubtful_accelerations(robot: Robot, scene: Scene) -> list[str]:
    """Accelerations of hinges that the scene may have meant in degrees, in words."""
    found = []
    for j, name in enumerate(robot.joint_names):
        given, own = scene.limits.acceleration.get(name, 0.0), float(robot.limits.acceleration[j])
        if given > _TOO_FAST * own and not robot.prismatic[j]:
            found.append(
                f"limits.acceleration.{name}: {given:g} rad/s^2 are {given / own:.0f} times the {own:g} of the machine"
                f"; {given:g} deg/s^2 are {math.radians(given):.4g} rad/s^2"
            )
    return found


def _ranges(robot: Robot, scene: Scene) -> tuple[Vector, Vector]:
    """(n,), (n,) lower and upper limits of the joints, by the scene's own limits [rad or m]."""
    given = scene.limits.position
    check_joint_names(robot, scene, given, key="limits.position")
    lower, upper = robot.limits.lower.copy(), robot.limits.upper.copy()
    for j, name in enumerate(robot.joint_names):
        if name not in given:
            continue
        joint = robot.urdf.joints[name]
        if joint.type != "continuous" and not joint.limit.lower <= given[name][0] < given[name][1] <= joint.limit.upper:
            raise SceneError(
                "is wider than the URDF's range",
                file=scene.file,
                key=f"limits.position.{name}",
                found=list(given[name]),
                allowed=f"within {joint.limit.lower:.8g} to {joint.limit.upper:.8g}",
            )
        lower[j], upper[j] = given[name]
    return lower, upper


def _at_most(robot: Robot, scene: Scene, key: str, own: Vector) -> Vector:
    """(n,) limits that the scene gives at `key`, otherwise the machine's `own`."""
    given = getattr(scene.limits, key)
    check_joint_names(robot, scene, given, key=f"limits.{key}")
    found = own.copy()
    for j, name in enumerate(robot.joint_names):
        if name not in given:
            continue
        limit = robot.urdf.joints[name].limit
        most = getattr(limit, key) if limit is not None else None
        if most and given[name] > most:
            raise SceneError(
                "is more than the URDF allows",
                file=scene.file,
                key=f"limits.{key}.{name}",
                found=given[name],
                allowed=f"at most {most:.8g}",
            )
        found[j] = given[name]
    return found


def _joint_errors(robot: Robot, scene: Scene) -> Vector:
    """(n,) tracking error of every joint, by the scene [rad or m]."""
    joints = 0.0 if scene.tracking is None else scene.tracking.joints
    if isinstance(joints, float):
        return np.full(robot.n, joints)
    check_joint_names(robot, scene, joints, key="tracking.joints")
    return np.array([joints.get(name, 0.0) for name in robot.joint_names])
