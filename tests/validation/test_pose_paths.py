"""The problems of full poses: their arms, their waypoints, and the measures of a motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from validation.pose_arms import ARMS, write_arm
from validation.pose_paths import KINDS, densely, draw, load_arm, waypoint_steps

STRETCHED = {  # m: height of the tip with all joints at 0, the sum of the published link lengths
    "gen3": 0.1564 + 0.1284 + 2 * 0.2104 + 0.2084 + 2 * 0.1059 + 0.0615,
    "iiwa": 0.36 + 0.42 + 0.4 + 0.126,
    "lift": 0.1 + 0.333 + 0.316 + 0.384 - 0.107,
}


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_is_as_long_as_published(name: str, tmp_path: Path) -> None:
    robot = bp.load_robot(write_arm(name, tmp_path))
    at = bp.Kinematics(robot).at(np.zeros(robot.n))
    assert at.tip_position[2] == pytest.approx(STRETCHED[name], abs=3e-4)
    assert robot.n == (8 if name == "lift" else 7)


@pytest.mark.parametrize("kind", KINDS)
def test_a_dense_path_contains_all_points_of_its_shape(kind: str) -> None:
    shape = KINDS[kind](np.random.default_rng(5))
    points, turns = densely(shape)
    assert 190 <= len(points) <= 1000
    assert len(turns) == len(points)
    off = np.linalg.norm(points[:, None] - shape.points[None], axis=2)
    assert np.max(np.min(off, axis=0)) < 1e-9


@pytest.mark.long
def test_the_same_seed_gives_the_same_problem(tmp_path: Path) -> None:
    robot = load_arm("iiwa", tmp_path)
    one, other = draw("turn", robot, "iiwa", 5), draw("turn", robot, "iiwa", 5)
    assert one.scene == other.scene
    assert one.scene != draw("turn", robot, "iiwa", 6).scene


def test_the_impossible_waypoint_is_the_first_beyond_the_arms_reach(tmp_path: Path) -> None:
    robot = load_arm("iiwa", tmp_path)
    problem = draw("beyond", robot, "iiwa", 0)
    path = problem.scene.task.path
    assert path is not None
    assert path.waypoints is not None
    shoulder = np.array([0.0, 0.0, 0.36])
    far = [np.linalg.norm(np.array(w.position) - shoulder) > 0.42 + 0.4 + 0.126 for w in path.waypoints]
    assert problem.impossible == int(np.argmax(far)) + 1


@pytest.mark.parametrize("samples", [5, 200])
def test_the_largest_step_between_waypoints_is_that_of_the_joints(tmp_path: Path, samples: int) -> None:
    """A motion through the joints of every waypoint, in known steps, with many or few samples between two."""
    robot = load_arm("iiwa", tmp_path)
    problem = draw("circle", robot, "iiwa", 0)
    path = problem.scene.task.path
    assert path is not None
    assert path.waypoints is not None
    steps = np.array([0.01, 0.03, 0.02, 0.01])
    q = np.array([0.1, 0.5, 0.2, 1.0, 0.3, 0.8, 0.0]) + np.concatenate(([0.0], np.cumsum(steps)))[:, None]
    at = [bp.Kinematics(robot).at(row) for row in q]
    waypoints = [
        path.waypoints[0].model_copy(
            update={"position": tuple(a.tip_position), "quaternion": quaternion(a.tip_rotation)}
        )
        for a in at
    ]
    scene = problem.scene.model_copy(
        update={
            "task": problem.scene.task.model_copy(
                update={"path": path.model_copy(update={"waypoints": tuple(waypoints)})}
            )
        }
    )
    finely = np.vstack([q[:-1] + part * np.diff(q, axis=0) for part in np.linspace(0, 1, samples, endpoint=False)])
    finely = np.vstack((finely[np.argsort(finely[:, 0])], q[-1:]))
    step, off = waypoint_steps(type(problem)("own", "iiwa", robot, scene), finely)
    assert step == pytest.approx(0.03, abs=3e-4)  # a waypoint counts as passed up to 0.1 mm before it
    assert off < 1.01e-4


def quaternion(rotation: np.ndarray) -> tuple[float, ...]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return (w, x, y, z)
