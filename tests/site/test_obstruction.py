"""Obstructions: one record and its texts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.site import Obstacle, Obstruction, Proximity, build_obstacles


def balls(robot: bp.Robot, *records: dict[str, Any]) -> tuple[Obstacle, ...]:
    shape = {"shape": "sphere", "radius": 0.2, "clearance": 0.05}
    task = {"path": {"waypoints": [{"position": [2.0, 0.0, 0.0]}, {"position": [2.0, 0.5, 0.0]}]}}
    scene = bp.scene_from_dict({"version": 1, "task": task, "obstacles": [shape | record for record in records]})
    return build_obstacles(scene, robot)


@pytest.mark.parametrize(
    ("found", "name", "text", "described"),
    [
        (
            Obstruction("obstacle", "gas pipe", "bucket", -0.14, -0.64),
            "gas pipe",
            "gas pipe (at bucket)",
            "bucket is 0.140 m inside gas pipe",
        ),
        (
            Obstruction("obstacle", "wall", "tip", 0.03, -0.02),
            "wall",
            "wall (at tip)",
            "tip is 0.030 m from wall, 0.020 m closer than allowed",
        ),
        (
            Obstruction("machine", "boom", "bucket", 0.25, 0.25),
            "the machine itself (boom)",
            "the machine itself (boom) (at bucket)",
            "bucket is 0.250 m from the machine itself (boom), 0.250 m more than the least allowed",
        ),
        (
            Obstruction("obstacle", "floor", "bucket", 0.0002, -0.003),
            "floor",
            "floor (at bucket)",
            "bucket is 0.2 mm from floor, 0.003 m closer than allowed",
        ),
        (
            Obstruction("obstacle", "floor", "bucket", 0.0, 0.0),
            "floor",
            "floor (at bucket)",
            "bucket is 0.000 m from floor, 0.000 m more than the least allowed",
        ),
        (
            Obstruction.joint_limit("swing"),
            "the limit of joint swing",
            "the limit of joint swing",
            "swing is at its limit",
        ),
        (
            Obstruction.joint_limit("swing", -0.1),
            "the limit of joint swing",
            "the limit of joint swing",
            "swing is beyond its limit",
        ),
    ],
)
def test_the_name_and_texts_of_an_obstruction(found: Obstruction, name: str, text: str, described: str) -> None:
    assert (found.name, str(found), found.describe()) == (name, text, described)


def test_the_tightest_pair_has_the_least_margin(planar4: bp.Robot) -> None:
    """The arm is stretched along x, 4 m long; its links extend 0.04 m to either side.

    The ball with the larger clearance is farther away and has less margin.
    """
    near = {"name": "near", "position": [1.5, 0.5, 0.0]}
    demanding = {"name": "demanding", "position": [2.5, 0.7, 0.0], "clearance": 0.4}
    proximity = Proximity(planar4, balls(planar4, near, demanding), self_collision=False)
    found = proximity.tightest(np.zeros(4), time=2.0)
    assert found is not None
    assert (found.kind, found.obstacle, found.link, found.time) == ("obstacle", "demanding", "link3", 2.0)
    assert found.distance == pytest.approx(0.7 - 0.2 - 0.04, abs=1e-9)
    assert found.margin == pytest.approx(found.distance - 0.4, abs=1e-12)


def test_an_obstacle_that_has_not_appeared_is_not_an_obstruction(planar4: bp.Robot) -> None:
    late = balls(planar4, {"name": "late", "position": [1.5, 0.5, 0.0], "appears_at": 3.0})
    proximity = Proximity(planar4, late, self_collision=False)
    assert proximity.tightest(np.zeros(4), time=1.0) is None
    assert proximity.tightest(np.zeros(4), time=3.0) is not None
    assert Proximity(planar4, (), self_collision=False).tightest(np.zeros(4)) is None


def test_a_link_is_distinguished_from_an_obstacle_with_the_same_name(planar4: bp.Robot) -> None:
    far = balls(planar4, {"name": "link1", "position": [9.0, 9.0, 0.0]})
    found = Proximity(planar4, far).tightest(np.array([0.0, 2.4, 2.4, 0.0]))
    assert found is not None
    assert found.kind == "machine"
