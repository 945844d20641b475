"""A machine and a scene, brought together and checked against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector, as_number, as_vector
from backhoe_planner.errors import RobotError, SceneError
from backhoe_planner.machine import JointLimits, Kinematics, Robot, TipTarget
from backhoe_planner.motion.goals import Goal
from backhoe_planner.motion.keeping.conditions import Condition, HeightBound, PitchBand
from backhoe_planner.motion.keeping.cones import RotationCone, TiltCone
from backhoe_planner.motion.keeping.keep import Keep
from backhoe_planner.motion.objectives import Objective, find_objective
from backhoe_planner.motion.path import TipPath
from backhoe_planner.site import (
    Gains,
    Ground,
    JointsGoal,
    Obstacle,
    Pose,
    Scene,
    Waypoint,
    build_obstacles,
    check_joint_names,
    check_standing,
    joint_positions,
    leg_key,
    leg_of,
    leg_scene,
    machine_on_site,
    scaled_limits,
    with_carried,
)


@dataclass(frozen=True, eq=False)
class Problem:
    """A planning problem.

    Attributes
    ----------
    robot: the machine, with the scene's tip.
    scene: as it was given.
    limits: the machine's limits within the scene.
    objective: what the motion minimises; for a sequence, that of its moving legs if they all have the same.
    obstacles: the site, as convex pieces.
    start_q: (n,) joints at the start; None if the start is given by the tip, or
        left to the planner.
    start_target: the tip's pose at the start, if the start is given by it.
    goals: where the motion may end; any of them is enough. Empty if a path is followed.
    path: the path that the tip follows, or None.
    keep: the conditions along the whole motion, or None.
    joint_steps: (n,) how far a joint may move from waypoint to waypoint of the path [rad or m],
        infinite for a joint without this limit; None if no joint has one.
    ground: where the scene's soil is; None if it is level at the soil's `surface`.
    name: of the leg of a sequence; empty for a task of its own.
    begins: when the motion begins on the clock of the sequence [s], in which sentences give their times; 0 without one.
    wait: how long a waiting leg waits [s]; None for any other.
    tip_speed: the greatest speed of the tip on the whole motion to a goal [m/s]; None if there is no such limit.
    max_duration: the longest time that the motion to a goal may take [s]; infinite if there is no such limit.
    legs: of a sequence, each a problem of its own. Only the first has a start; see `beginning`.
        A sequence has neither goals nor a path, and its obstacles are those of all legs.
    """

    robot: Robot
    scene: Scene
    limits: JointLimits
    objective: Objective[Any]
    obstacles: tuple[Obstacle, ...]
    start_q: Vector | None
    start_target: TipTarget | None
    goals: tuple[Goal, ...]
    path: TipPath | None
    keep: Keep | None = None
    joint_steps: Vector | None = None
    ground: Ground | None = None
    name: str = ""
    begins: float = 0.0
    wait: float | None = None
    tip_speed: float | None = None
    max_duration: float = np.inf
    legs: tuple[Problem, ...] = ()

    def __repr__(self) -> str:
        """One line: machine, task and obstacles."""
        tasks = {"path": self.path, "sequence": self.legs, "wait": self.wait is not None, "goal": self.goals}
        task = next((name for name, has in tasks.items() if has), "no task")
        return f"<Problem of {self.robot.name}: {task}, obstacles: {len(self.obstacles)}>"

    def beginning(self, q: Vector, time: float = 0.0) -> Problem:
        """The same problem with the start at joints `q` (n,) [rad or m], on a clock that begins `time` later [s]."""
        q, time, goals = as_vector(q, self.robot.n, key="q"), as_number(time, key="time"), self.goals
        if self.wait is not None:
            at = Kinematics(self.robot).at(q)
            goals = (Goal(TipTarget(at.tip_position, rotation=at.tip_rotation), q=q, name="place"),)
        begins, obstacles = self.begins + time, self._obstacles_from(time)
        return replace(self, start_q=q, start_target=None, goals=goals, obstacles=obstacles, begins=begins)

    def _obstacles_from(self, time: float) -> tuple[Obstacle, ...]:
        if time == 0.0 or not self.is_dynamic:
            return self.obstacles
        return tuple(
            replace(one, appears_at=one.appears_at - time) if one.is_dynamic else one for one in self.obstacles
        )

    @property
    def is_dynamic(self) -> bool:
        """Whether any obstacle moves or appears."""
        return any(obstacle.is_dynamic for obstacle in self.obstacles)

    @property
    def present(self) -> tuple[Obstacle, ...]:
        """The obstacles that are there from the beginning, without those that appear later."""
        return tuple(obstacle for obstacle in self.obstacles if obstacle.appears_at <= 0.0)

    @property
    def begin_target(self) -> TipTarget | None:
        """Where the tip begins, if the start or a path says so: that of the start, otherwise that of the path."""
        if self.start_target is not None or self.path is None:
            return self.start_target
        return self.path.target(0.0)


def build_problem(robot: Robot, scene: Scene) -> Problem:
    """Check a scene against a machine, and build the obstacles, targets and path in it.

    Raises
    ------
    SceneError: the machine has no such joint or link, or lacks what a pitch, soil or the
        objective needs; a file of the scene cannot be used; or its base puts the machine into an obstacle.
    RobotError: the scene's tip is not a link of the machine, or no link that moves has a shape.
    """
    robot = machine_on_site(robot, scene)
    if not robot.moving_links:
        raise RobotError(
            "no link that moves has a shape, so that nothing can be proven: the URDF needs <collision> or <visual>",
            file=robot.urdf.named,
            key="link",
        )
    obstacles = build_obstacles(scene, robot)
    check_standing(robot, scene, obstacles)
    whole = _build(robot, scene, obstacles)
    if scene.task.sequence is None:
        return whole
    legs = _legs(whole)
    objectives = {leg.objective.name: leg.objective for leg in legs if leg.wait is None}
    one = next(iter(objectives.values())) if len(objectives) == 1 else whole.objective
    return replace(whole, legs=legs, objective=one)


def _legs(whole: Problem) -> tuple[Problem, ...]:
    """The legs of a sequence, each as a problem of its own."""
    scene, found = whole.scene, []
    for index, leg in enumerate(scene.task.sequence or ()):
        robot, own = with_carried(whole.robot, scene, index), leg_scene(scene, index)
        there = {one.name for one in own.obstacles} | {zone.name for zone in own.zones}
        try:
            built = _build(robot, own, tuple(one for one in whole.obstacles if one.name in there))
        except SceneError as error:
            raise _in_leg(error, scene, index) from None
        speed = leg.speed if leg.goal is not None else None
        one = replace(built, name=leg.name, wait=leg.wait, tip_speed=speed)
        if index == 0 and leg.wait is not None:
            if one.start_q is None:
                raise SceneError(
                    "a sequence that begins with a wait needs the joints at its start", file=scene.file,
                    key=f"{leg_key(scene, index)}.wait", found=leg.wait, allowed="start: {joints: {...}} in the scene",
                )  # fmt: skip
            one = one.beginning(one.start_q)
        found.append(one)
    return tuple(found)


def _in_leg(error: SceneError, scene: Scene, index: int) -> SceneError:
    """The error of a leg, with its key in the sequence."""
    leg, key = leg_of(scene, index), error.key or ""
    first, _, rest = key.partition(".")
    if first == "task":
        key = f"{leg_key(scene, index)}.{rest}"
    elif getattr(leg, first, None) is not None:
        key = f"{leg_key(scene, index)}.{key}"
    return SceneError.of(error, file=error.file, key=key or None)


def _build(robot: Robot, scene: Scene, obstacles: tuple[Obstacle, ...]) -> Problem:
    """The problem of a scene, or of one leg, for a machine that stands on its site."""
    if scene.gains != "auto":
        check_joint_names(robot, scene, scene.gains.s_k, key="gains.s_k")
    if scene.soil is not None and not robot.has_pitch:
        raise SceneError(
            "soil acts on a bucket: the axis of the last joint must stay horizontal",
            file=scene.file,
            key="soil",
            found=robot.name,
        )
    objective = find_objective(scene.objective_or_default, robot, file=scene.file)
    start_q, start_target = _start(robot, scene)
    path = None
    if scene.task.path is not None:
        waypoints = scene.waypoints()
        for index, waypoint in enumerate(waypoints):
            _target(robot, scene, waypoint, f"task.path.waypoints[{index}]")
        numbers = _without_repeats(waypoints)
        path = TipPath([waypoints[number - 1] for number in numbers], numbers=numbers)
        if path.length == 0.0:
            raise SceneError(
                "the waypoints all lie in one point, and none asks for another turn of the tip", file=scene.file,
                key="task.path", allowed="two that are more than a nanometre apart",
            )  # fmt: skip
    return Problem(
        robot, scene, limits=scaled_limits(robot, scene), objective=objective, obstacles=obstacles,
        start_q=start_q, start_target=start_target, goals=_goals(robot, scene), path=path,
        keep=keep_of(robot, scene),
        joint_steps=_joint_steps(robot, scene),
        max_duration=np.inf if scene.task.max_duration is None else scene.task.max_duration,
    )  # fmt: skip


def _joint_steps(robot: Robot, scene: Scene) -> Vector | None:
    """See `Problem`."""
    given = None if scene.task.path is None else scene.task.path.max_joint_step
    if given is None:
        return None
    if isinstance(given, float):
        return np.full(robot.n, given)
    check_joint_names(robot, scene, given, key="task.path.max_joint_step")
    return np.array([given.get(name, np.inf) for name in robot.joint_names])


def _without_repeats(waypoints: Sequence[Waypoint]) -> list[int]:
    """The numbers, from 1, of the waypoints that add something: at least two.

    A repeated waypoint adds nothing, nor does one without an angle between two with an angle at the same position.
    """
    turns = [waypoint.pitch is not None or waypoint.rotation is not None for waypoint in waypoints]
    kept = [0]
    for index in range(1, len(waypoints)):
        here = waypoints[index].position
        after = next((other for other in range(index + 1, len(waypoints)) if turns[other]), None)
        if waypoints[index] == waypoints[kept[-1]]:
            continue
        stays = after is not None and all(waypoint.position == here for waypoint in waypoints[kept[-1] : after + 1])
        if not (stays and turns[kept[-1]] and not turns[index]):
            kept.append(index)
    return [index + 1 for index in kept] if len(kept) > 1 else [1, 2]


def angles_in_degrees(problem: Problem, q: Vector) -> Vector:
    """(n,) angles [rad] of a `q` (n,) that seems to be in degrees: beyond a turn, then within limits; else nan."""
    limits = problem.limits
    turned = np.where(problem.robot.prismatic | (np.abs(q) < 2.0 * np.pi), np.nan, np.radians(q))
    return np.where((turned >= limits.lower) & (turned <= limits.upper), turned, np.nan)


def hand_set_gains(problem: Problem) -> Gains | None:
    """The gains that the scene sets by hand; None for ``auto``, which uses the law's own weights."""
    gains = problem.scene.gains
    return None if gains == "auto" else gains


def _start(robot: Robot, scene: Scene) -> tuple[Vector | None, TipTarget | None]:
    if scene.start is None:
        return None, None
    if scene.start.tip is not None:
        return None, _target(robot, scene, scene.start.tip, "start.tip")
    assert scene.start.joints is not None
    return joint_positions(robot, scene, scene.start.joints, key="start.joints"), None


def _goals(robot: Robot, scene: Scene) -> tuple[Goal, ...]:
    """All goals of the task, given by the tip's pose or by the joints."""
    found = []
    listed = isinstance(scene.task.goal, tuple)
    for index, spec in enumerate(scene.task.goals):
        key = f"task.goal[{index}]" if listed else "task.goal"
        name = f"goal {index + 1}" if len(scene.task.goals) > 1 else "goal"
        if isinstance(spec, JointsGoal):
            q = joint_positions(robot, scene, spec.joints, key=f"{key}.joints")
            at = Kinematics(robot).at(q)
            found.append(Goal(TipTarget(at.tip_position, rotation=at.tip_rotation), q=q, name=name))
        else:
            target = _target(robot, scene, spec, key)
            turned, off = spec.rotation_tolerance if spec.tilt is None else spec.tilt.tolerance, spec.tolerance
            found.append(Goal(target, name=name, rotation_tolerance=turned, tolerance=off))
    return tuple(found)


def keep_of(robot: Robot, scene: Scene) -> Keep | None:
    """The conditions that hold along the whole motion."""
    asked = scene.task.kept
    if asked is None:
        return None
    conditions: list[Condition] = []
    if asked.pitch is not None:
        _check_pitch(
            robot,
            scene,
            "task.keep.pitch" if scene.task.keep else "task.goal.keep.pitch",
            "above, below, rotation, tilt",
        )
        conditions.append(PitchBand(robot, *asked.pitch))
    if asked.above is not None:
        conditions.append(HeightBound(robot, asked.above, 1.0))
    if asked.below is not None:
        conditions.append(HeightBound(robot, asked.below, -1.0))
    if asked.rotation is not None:
        conditions.append(RotationCone(robot, asked.rotation.rotation, asked.rotation.tolerance))
    if asked.tilt is not None:
        conditions.append(TiltCone(robot, asked.tilt.tilt))
    return Keep(robot, conditions)


def _target(robot: Robot, scene: Scene, pose: Pose, key: str) -> TipTarget:
    target = pose.target
    if target.pitch is not None:
        _check_pitch(robot, scene, f"{key}.pitch", "rpy, quaternion, or the position alone")
    return target


def _check_pitch(robot: Robot, scene: Scene, key: str, allowed: str) -> None:
    """Raise a SceneError if pitch is not defined for the machine."""
    if not robot.has_pitch:
        raise SceneError(
            "pitch is not defined for this arm: the axis of its last joint does not stay horizontal",
            file=scene.file,
            key=key,
            allowed=allowed,
        )
