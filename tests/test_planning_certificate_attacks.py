"""Motions that are not what they claim to be: none of them is certified."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp

START = [0.0, 0.4, -1.6, -0.9]


def scene(**changes: Any) -> bp.Scene:
    content: dict[str, Any] = {
        "version": 1,
        "start": {"joints": dict(zip(("swing", "boom", "stick", "bucket"), START, strict=True))},
        "task": {"goal": {"position": [0.0, 0.0, 0.0]}},
    }
    return bp.scene_from_dict(content | changes)


def goal_at(robot: bp.Robot, q: list[float]) -> dict[str, Any]:
    return {"goal": {"position": bp.Kinematics(robot).at(np.array(q)).tip_position.tolist()}}


def test_time_begins_at_zero() -> None:
    """Before time 0 no obstacle would have appeared yet."""
    with pytest.raises(bp.InputError, match="does not start at 0"):
        bp.Trajectory(time=np.array([-1000.0, -999.0]), q=np.zeros((2, 4)), v=np.zeros((2, 4)))


@pytest.mark.parametrize("speed", [5.0, 5000.0])
def test_an_obstacle_that_passes_between_two_samples_is_seen(backhoe: bp.Robot, speed: float) -> None:
    """From 50 m away through the machine that stands still, and away again, unseen at both samples."""
    ball = {"name": "ball", "shape": "sphere", "radius": 1.0, "position": [50.0, 1.0, 1.0], "velocity": [-speed, 0, 0]}
    given = scene(task=goal_at(backhoe, START), obstacles=[ball])
    standing = bp.Trajectory.from_steps(np.array([0.0, 20.0]), np.array([START, START]))
    certificate = bp.certify(backhoe, given, standing)
    assert not certificate.verified
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.margin < 0.0


@pytest.mark.parametrize(
    "obstacle",
    [
        {"shape": "box", "size": [4000.0, 4000.0, 4000.0], "position": [0.0, 0.0, 0.0]},
        {"shape": "sphere", "radius": 5000.0, "position": [0.0, 0.0, 0.0]},
        {"shape": "halfspace", "point": [0.0, 0.0, 2000.0], "normal": [0.0, 0.0, 1.0]},
    ],
)
def test_deep_inside_is_inside(backhoe: bp.Robot, obstacle: dict[str, Any]) -> None:
    given = scene(task=goal_at(backhoe, START), obstacles=[{"name": "rock", "clearance": 0.0} | obstacle])
    certificate = bp.certify(backhoe, given, bp.Trajectory.from_steps(np.zeros(1), np.array([START])))
    assert certificate.min_clearance is not None
    assert certificate.min_clearance.value < -1000.0
    assert not certificate.verified


def test_a_start_given_by_the_tip_is_held_against_the_motion(backhoe: bp.Robot) -> None:
    standing = bp.Trajectory.from_steps(np.zeros(1), np.array([START]))
    tip = bp.Kinematics(backhoe).at(np.array(START)).tip_position.tolist()
    there = scene(task=goal_at(backhoe, START), start={"tip": {"position": tip}})
    assert bp.certify(backhoe, there, standing).verified
    elsewhere = scene(task=goal_at(backhoe, START), start={"tip": {"position": [4.0, -2.0, 0.5]}})
    assert "asked start" in bp.certify(backhoe, elsewhere, standing).problems[0]


def test_velocities_that_are_not_those_of_the_motion(backhoe: bp.Robot) -> None:
    given = scene(task=goal_at(backhoe, START))
    lying = bp.Trajectory(time=np.array([0.0, 1.0]), q=np.array([START, START]), v=np.full((2, 4), 1e6))
    assert any("velocities" in problem for problem in bp.certify(backhoe, given, lying).problems)


def test_a_corner_that_is_cut_between_two_samples_is_not_followed(backhoe: bp.Robot) -> None:
    """Both samples lie on the path, the chord between them passes the corner at more than the tolerance."""
    corner = [[4.6, 0.0, -0.3], [4.6, 0.4, -0.3], [4.2, 0.4, -0.3]]
    given = scene(start=None, task={"path": {"waypoints": [{"position": p} for p in corner], "speed": 0.1}})
    whole = bp.plan(backhoe, given)
    assert whole.verified
    assert not whole.certificate.detours
    tips = whole.tip_path()
    at_corner = int(np.argmin(np.linalg.norm(tips - np.array(corner[1]), axis=1)))
    kept = np.delete(np.arange(len(tips)), np.arange(at_corner - 25, at_corner + 26))
    cut = bp.Trajectory.from_steps(whole.trajectory.time[kept], whole.trajectory.q[kept])
    certificate = bp.certify(backhoe, given, cut)
    assert certificate.detours or not certificate.verified


def test_most_of_a_closed_path_left_out_is_reported(planar4: bp.Robot) -> None:
    """A few centimetres back along the last leg and home again are not the loop."""
    corners = [[2.0, 0.0, 0.0], [2.4, 0.0, 0.0], [2.4, 0.4, 0.0], [2.0, 0.4, 0.0], [2.0, 0.0, 0.0]]
    given = bp.scene_from_dict({"version": 1, "task": {"path": {"waypoints": [{"position": p} for p in corners]}}})
    q = [np.array([1.2, -1.0, -1.0, -0.5])]
    back = [*np.linspace(0.0, 0.03, 16), *np.linspace(0.03, 0.0, 16)[1:]]
    for y in back:
        target = bp.TipTarget(position=np.array([2.0, y, 0.0]))
        q.append(bp.solve_inverse_kinematics(planar4, target, start=q[-1]).q)
    steps = np.array(q[1:])
    tracking = bp.certify(planar4, given, bp.Trajectory.from_steps(np.linspace(0.0, 6.0, len(steps)), steps)).tracking
    assert tracking.followed < 0.2
