"""Bounds of distances without measuring them: by enclosing balls, and for their change along a motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from crowds import shape_in_turn

from backhoe_planner.machine import Robot, load_robot
from backhoe_planner.native import find_compiled
from backhoe_planner.site import Proximity, build_obstacles, scene_from_dict

TWO_HINGES = """<robot name="two"><link name="base"/><link name="upper"/>
<link name="lower"><collision><origin xyz="1 0 0"/><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="b" type="{type}"><parent link="upper"/><child link="lower"/><origin xyz="1 0 0"/><axis xyz="{axis}"/>
  <limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def two_joints(folder: Path, kind: str, axis: str) -> Robot:
    """A hinge, and 1 m beyond it a joint that carries a ball of radius 1 cm another metre out."""
    path = folder / f"{kind}.urdf"
    path.write_text(TWO_HINGES.format(type=kind, axis=axis))
    return load_robot(path, tip="lower")


def crowd(robot: Robot, seed: int) -> Proximity:
    """Boxes, balls and capsules around a machine, a half-space above it, and one moving obstacle."""
    rng = np.random.default_rng(seed)
    entries: list[dict[str, Any]] = [{"name": "roof", "shape": "halfspace", "point": [0, 0, 5], "normal": [0, 0, -1]}]
    for index in range(9):
        place = (rng.normal(size=3) * [1.5, 1.5, 0.5] + [0.0, 0.0, 0.5]).tolist()
        entries.append({"name": f"o{index}", **shape_in_turn(rng, index, place, radius=0.3, height=1.0)})
    entries[-1]["velocity"] = [0.3, 0.0, 0.0]
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0, 0, 0]}}, "obstacles": entries}
    return Proximity(robot, build_obstacles(scene_from_dict(scene), robot))


@pytest.fixture(params=["planar4", "backhoe", pytest.param("panda", marks=pytest.mark.long), "slide"])
def robot(request: pytest.FixtureRequest, tmp_path: Path) -> Robot:
    """Machines of hinges, with boxes and hulls, and one with a slide."""
    if request.param == "slide":
        return two_joints(tmp_path, "prismatic", "0.6 0.8 0")
    found: Robot = request.getfixturevalue(request.param)
    return found


def test_ball_bounds_never_exceed_the_distance_and_separate_most_distant_pairs(robot: Robot) -> None:
    rng, proximity = np.random.default_rng(3), crowd(robot, 5)
    q = np.array([robot.random_q(rng) for _ in range(80)])  # more than are bounded at once
    bounds = np.array(list(proximity.bounds_unchecked(q)))
    distances = np.array([proximity.distances(row) for row in q])
    assert bounds.shape == distances.shape == (80, len(proximity.pairs))
    assert (bounds <= distances).all()
    assert ((bounds > 0.0) | (bounds == -np.inf)).all()
    stands = (proximity.speed == 0.0) & (proximity.floor == -np.inf)
    # self-collision pairs have bounds only in the compiled version
    stands &= (proximity.owner >= 0) | (find_compiled() is not None)
    assert (bounds[:, ~stands] == -np.inf).all()
    apart = stands & (distances > 0.3)
    assert np.mean(bounds[apart] > 0.0) > 0.8


def test_known_bounds_do_not_change_the_rows(robot: Robot) -> None:
    rng, proximity, plain = np.random.default_rng(4), crowd(robot, 6), crowd(robot, 6)
    q = np.array([robot.random_q(rng) for _ in range(20)])
    for row, known in zip(q, proximity.bounds_unchecked(q), strict=True):
        found, expected = proximity.at(row, margin=0.1, known=known), plain.at(row, margin=0.1)
        np.testing.assert_array_equal(found.pair, expected.pair)
        np.testing.assert_allclose(found.distance, expected.distance, atol=1e-12)


def test_no_distance_changes_faster_than_its_way_along_a_motion(robot: Robot) -> None:
    """Motions as long as one sample and longer, each measured at 33 places."""
    rng, proximity = np.random.default_rng(7), crowd(robot, 8)
    still = proximity.speed == 0.0
    part = np.linspace(0.0, 1.0, 33)
    tightened = []
    for size in (0.03, 0.3, 1.0):
        for _ in range(12):
            q_a = robot.random_q(rng)
            q_b = np.clip(q_a + size * rng.normal(size=robot.n), robot.limits.lower, robot.limits.upper)
            (way,) = proximity.ways_unchecked(np.array([q_a, q_b]))
            distances = np.array([proximity.distances_of(np.arange(len(way)), q_a + s * (q_b - q_a)) for s in part])
            changes = np.abs(np.diff(distances, axis=0))[:, still]
            assert (changes <= way[still] / 32 + 1e-9).all()
            plain = proximity.travel @ np.abs(q_b - q_a)
            assert (way <= (1.0 + 1e-12) * plain).all()
            if size < 0.1:
                tightened.append(float(np.mean((way / plain)[still & (proximity.owner >= 0) & (plain > 0.0)])))
    assert np.mean(tightened) < 0.8


def test_ways_of_two_joints_that_cancel_count_only_rotation_and_curvature(tmp_path: Path) -> None:
    """Halfway the arm is stretched: with 0.02 and -0.04 rad the ball's centre is at rest there, and turns by 0.02 rad.

    This moves the ball's points by 0.01 * 0.02. The centre's second derivative is at most r . b with
    r = (2.01, 1.01) and b = (0.02^2, 0.04 (0.04 + 2 * 0.02)). The plain bound is 0.0201 * 2 + 0.0101 * 4.
    """
    robot = two_joints(tmp_path, "revolute", "0 0 1")
    box = {"name": "box", "shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.5, 1.5, 0.0]}
    task = {"goal": {"position": [0, 0, 0]}}
    scene = scene_from_dict({"version": 1, "start": {"joints": {}}, "task": task, "obstacles": [box]})
    proximity = Proximity(robot, build_obstacles(scene, robot))
    (way,) = proximity.ways_unchecked(np.array([[-0.01, 0.02], [0.01, -0.02]]))
    assert way == pytest.approx([0.01 * 0.02 + 0.5 * (2.01 * 0.02**2 + 1.01 * 0.04 * (0.04 + 2 * 0.02))])
    assert proximity.travel @ [0.02, 0.04] == pytest.approx([0.0806])
