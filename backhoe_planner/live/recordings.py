"""A motion that was driven by hand, as a plan: certified and written like any other.

A plan needs a task. The task of a recording is to bring the tip from where the motion began
to where it ended. Nobody set that goal, so it is not shown, and the tip error is meaningless.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Problem, Trajectory, build_problem
from backhoe_planner.planning import Findings, Plan, RecordingNotes, measure_motion
from backhoe_planner.proof import certify_problem
from backhoe_planner.site import Scene, Transgression, joints_on_site, scene_from_dict


def plan_from_recording(
    robot: Robot,
    scene: Scene,
    trajectory: Trajectory,
    *,
    obstacles: Sequence[Mapping[str, Any]] | None = None,
    recording: RecordingNotes | None = None,
    zones: Sequence[Transgression] = (),
) -> Plan:
    """A recorded motion as a plan.

    Parameters
    ----------
    robot, scene: the machine and the scene in which it was driven; the scene's start and task are replaced.
    trajectory: the motion; it has no legs, even if the scene's task is a sequence.
    obstacles: records as in a scene file, describing the obstacles during the recording; the scene's by default.
    recording: notes of what the recording leaves out, kept in the plan file.
    zones: visits to zones, kept in the plan file.

    Raises
    ------
    SceneError: the obstacles' records are not as in a scene file, or do not fit the machine.
    """
    robot = joints_on_site(robot, scene)
    content = scene.to_dict()
    content["start"] = {"joints": dict(zip(robot.joint_names, trajectory.q[0].tolist(), strict=True))}
    content["task"] = {"goal": {"position": Kinematics(robot).at(trajectory.q[-1]).tip_position.tolist()}}
    given = content.get("obstacles", ()) if obstacles is None else obstacles
    # driving by hand has no legs: what is present in some legs only was present all the time
    content["obstacles"] = [{key: one for key, one in dict(obstacle).items() if key != "legs"} for obstacle in given]
    done = scene_from_dict(content, folder=scene.folder, file=scene.file)
    problem = build_problem(robot, done)
    certificate = certify_problem(problem, trajectory)
    return Plan(
        problem=problem,
        method="teleop",
        seed=0,
        trajectory=trajectory,
        certificate=certificate,
        metrics=measure_motion(problem, trajectory, certificate),
        findings=Findings(recording=recording, zones=tuple(zones)),
    )


def is_recording(plan: Plan) -> bool:
    """Whether a plan is a recording of a motion driven by hand."""
    return plan.method == "teleop"


def unrecorded_changes(plan: Plan) -> tuple[str, ...]:
    """Changes of the site during a recording that a scene file cannot contain, in words; none for other plans."""
    return plan.findings.recording.notes if is_recording(plan) and plan.findings.recording is not None else ()


def problem_to_show(plan: Plan) -> Problem:
    """The problem of a plan for pictures and pages; for a recording it has no goal."""
    return replace(plan.problem, goals=(), path=None) if is_recording(plan) else plan.problem
