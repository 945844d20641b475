"""A motion that was driven by hand, as a plan: certified, and written like any other.

Its task is what was done: to bring the tip from where the motion began to where it ended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.planning import Plan, Reason, judged, motion_metrics
from backhoe_planner.proof import certify_problem
from backhoe_planner.site import Scene, scene_from_dict

__all__ = ["recorded_plan"]


def recorded_plan(
    robot: Robot,
    scene: Scene,
    trajectory: Trajectory,
    *,
    obstacles: Sequence[Mapping[str, Any]] | None = None,
    details: Mapping[str, Any] | None = None,
) -> Plan:
    """The plan that a recorded motion is.

    Parameters
    ----------
    scene: in which it was driven; its start and task are replaced.
    obstacles: as they were during the recording; the scene's by default.
    details: to be kept in the plan file.

    Raises
    ------
    SceneError: the obstacles are not as in a scene file, or do not fit the machine.
    """
    robot = robot.with_tip(scene.tip)
    content = scene.to_dict()
    content["start"] = {"joints": dict(zip(robot.joint_names, trajectory.q[0].tolist(), strict=True))}
    content["task"] = {"goal": {"position": Kinematics(robot).at(trajectory.q[-1]).tip_position.tolist()}}
    if obstacles is not None:
        content["obstacles"] = [dict(obstacle) for obstacle in obstacles]
    done = scene_from_dict(content, folder=scene.folder, file=scene.file)
    problem = build_problem(robot, done)
    certificate = certify_problem(problem, trajectory)
    reason: Reason = ""
    message = ""
    if not certificate.verified:
        reason, message = judged(problem, certificate)
    return Plan(
        verdict="verified" if certificate.verified else "failed",
        reason=reason,
        message=message,
        robot=problem.robot,
        scene=done,
        method="teleop",
        seed=0,
        trajectory=trajectory,
        certificate=certificate,
        metrics=motion_metrics(problem, trajectory, certificate, 0.0, method="teleop"),
        details={} if details is None else details,
    )
