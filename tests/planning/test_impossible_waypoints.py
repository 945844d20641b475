"""Paths of full poses with one impossible waypoint, which is named before any other search."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pinocchio import Quaternion

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from validation.pose_paths import Problem, draw, load_arm


def problem_of(kind: str, folder: Path) -> Problem:
    return draw(kind, load_arm("iiwa", folder), "iiwa", 0)


def test_the_first_waypoint_out_of_reach_is_named(tmp_path: Path) -> None:
    """One of 500, the first of a stretch 1.6 m too far out; half of the path after it is in reach again."""
    problem = problem_of("beyond", tmp_path)
    plan = bp.plan(problem.robot, problem.scene, effort="quick")
    assert plan.reason == "unreachable"
    assert f"waypoint {problem.impossible} of the path" in plan.message


def test_a_waypoint_in_a_block_is_named_if_detours_are_not_allowed(tmp_path: Path) -> None:
    problem = problem_of("inside", tmp_path)
    plan = bp.plan(problem.robot, problem.scene, effort="quick")
    assert plan.reason == "blocked"
    assert "none of" in plan.message
    obstruction = plan.findings.obstruction
    assert obstruction is not None
    assert obstruction.obstacle == "block"
    assert problem.impossible is not None
    named = int(plan.message.split("waypoint ")[1].split()[0])
    assert named <= problem.impossible  # the flange reaches the block before the tip does
    path = problem.scene.task.path
    assert path is not None
    assert path.waypoints is not None
    assert path.waypoints[named - 1].position != path.waypoints[problem.impossible - 1].position
    apart = np.subtract(path.waypoints[named - 1].position, path.waypoints[problem.impossible - 1].position)
    assert np.linalg.norm(apart) < 0.1


def test_without_the_block_the_waypoint_is_clear(tmp_path: Path) -> None:
    problem = problem_of("inside", tmp_path)
    free = problem.scene.model_copy(update={"obstacles": ()})
    plan = bp.plan(problem.robot, free, budget=1e-9)
    assert plan.reason == "budget"  # the search began


@pytest.mark.parametrize("machine", ["iiwa"])
def test_a_corner_three_millimetres_out_of_reach_is_named(machine: str, tmp_path: Path) -> None:
    """Each of 500 waypoints is tried, since its neighbours can be reached."""
    problem = draw("corner", load_arm(machine, tmp_path), machine, 1)
    plan = bp.plan(problem.robot, problem.scene, effort="quick")
    assert plan.reason == "unreachable"
    first = "beginning" if problem.impossible == 1 else f"waypoint {problem.impossible}"
    assert f"{first} of the path" in plan.message
    assert plan.findings.nearest is not None
    assert 0.0 < plan.findings.nearest.position_error < 0.0031


def test_one_waypoint_of_a_hundred_is_named(backhoe: bp.Robot) -> None:
    """On a straight path 4 to 5 m ahead, one waypoint is 40 m up."""
    points = [[x, 0.0, 0.3] for x in np.linspace(4.0, 5.0, 100).tolist()]
    points[50][2] = 40.0
    task = {"path": {"waypoints": [{"position": point} for point in points]}}
    plan = bp.plan(backhoe, bp.scene_from_dict({"version": 1, "task": task}), effort="quick")
    assert plan.reason == "unreachable"
    assert "waypoint 51 of the path" in plan.message


@pytest.mark.parametrize("detour", [True, False])
def test_a_waypoint_given_by_position_alone_in_an_obstacle_is_not_refused_before_the_search(
    backhoe: bp.Robot, detour: bool
) -> None:
    """A path of positions may be followed at another angle, so it is resolved first."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [3.5, 0.0, 0.3]}
    task = {"path": {"waypoints": [{"position": [x, 0.0, 0.3]} for x in (3.0, 3.5, 4.0)], "detour": detour}}
    scene = bp.scene_from_dict({"version": 1, "task": task, "obstacles": [ball]})
    plan = bp.plan(backhoe, scene, effort="quick", budget=1e-9)
    assert plan.reason == "budget"


def bent_path(corner: list[float], **keys: object) -> bp.Scene:
    """A path from one side of the stretched planar arm to a corner ahead of it, and to its other side."""
    points = [[3.2, 0.3, 0.0], corner, [3.2, -0.3, 0.0]]
    path = {"waypoints": [{"position": point} for point in points], "tolerance": 0.005, "detour": False, **keys}
    return bp.scene_from_dict({"version": 1, "task": {"path": path}})


@pytest.mark.parametrize("beyond", [pytest.param(0.002, marks=pytest.mark.long), 0.004])
def test_a_corner_out_of_reach_by_less_than_the_tolerance_is_passed_within_it(beyond: float) -> None:
    """The planar arm is 4 m long: the tip stays off the corner by at least `beyond`."""
    robot = bp.load_robot("example:planar4")
    plan = bp.plan(robot, bent_path([4.0 + beyond, 0.0, 0.0]), effort="quick")
    assert plan.verdict == "verified", plan.message
    assert beyond <= plan.certificate.tracking.max_error <= 0.005
    tips = np.vstack([np.linspace(a, b, 20) for a, b in pairwise(plan.tip_path())])
    corner = np.linalg.norm(tips - [4.0 + beyond, 0.0, 0.0], axis=1)
    assert beyond - 1e-9 <= np.min(corner) <= 0.005


def test_a_path_beside_the_plane_of_an_arm_is_followed_in_it() -> None:
    """The planar arm moves at a height of 0, the path is 3 mm above it."""
    points = [[3.0, 0.3, 0.003], [3.0, -0.3, 0.003]]
    task = {"path": {"waypoints": [{"position": point} for point in points], "tolerance": 0.005}}
    plan = bp.plan(bp.load_robot("example:planar4"), bp.scene_from_dict({"version": 1, "task": task}), effort="quick")
    assert plan.verified, plan.message
    assert plan.certificate.tracking.max_error == pytest.approx(0.003, abs=1e-3)


def test_a_corner_out_of_reach_by_more_than_the_tolerance_is_named() -> None:
    plan = bp.plan(bp.load_robot("example:planar4"), bent_path([4.006, 0.0, 0.0]), effort="quick")
    assert plan.reason == "unreachable"
    assert "waypoint 2 of the path" in plan.message


@pytest.mark.parametrize(("too_near", "reason"), [(0.0006, ""), (0.002, "blocked")])
def test_a_pose_too_near_an_obstacle_by_less_than_the_tolerance_is_passed_within_it(
    too_near: float, reason: str
) -> None:
    """The hand approaches a ball and goes back; it is as near to the ball in all configurations."""
    robot = bp.load_robot("example:panda", tip="panda_hand_tcp")
    q = np.array([0.0, 0.0, 0.0, -1.8, 0.0, 1.8, 0.8])
    at = bp.Kinematics(robot).at(q)
    turn, beside = Quaternion(at.tip_rotation), np.array([0.1, 0.0, 0.05])
    poses = [
        {"position": (at.tip_position + off).tolist(), "quaternion": [turn.w, turn.x, turn.y, turn.z]}
        for off in np.array([[-0.05, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.05, 0.02, 0.0]])
    ]
    ball = {"name": "ball", "shape": "sphere", "radius": 0.03, "position": (at.tip_position + beside).tolist()}
    task = {"path": {"waypoints": poses, "tolerance": 0.001, "detour": False}}

    def scene(clearance: float) -> bp.Scene:
        return bp.scene_from_dict({"version": 1, "task": task, "obstacles": [{**ball, "clearance": clearance}]})

    proximity = bp.Proximity(robot, build_problem(robot, scene(0.0)).obstacles)
    of_hand = [pair.link == "panda_hand" and pair.obstacle == "ball" for pair in proximity.pairs]
    apart = float(np.min(proximity.distances(q)[of_hand]))
    plan = bp.plan(robot, scene(apart + too_near), effort="quick")
    assert plan.reason == reason, plan.message
    if not reason:
        assert plan.verdict == "verified"
        assert too_near <= plan.certificate.tracking.max_error + 1e-9 <= 0.001
