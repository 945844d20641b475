"""Slow paths of a small machine: the tip has the requested speed and no more."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp

SCALE = 0.3
LENGTHS = {"origin": ["xyz"], "box": ["size"], "cylinder": ["radius", "length"], "sphere": ["radius"]}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> bp.Robot:
    """The backhoe at 0.3 of its size, with the same masses and joint limits, without cylinders."""
    tree = ET.parse(Path(__file__).parents[2] / "models" / "backhoe.urdf")
    for element in tree.iter():
        for key in LENGTHS.get(element.tag, []):
            if key in element.attrib:
                scaled = [SCALE * float(value) for value in element.attrib[key].split()]
                element.set(key, " ".join(map(repr, scaled)))
    file = tmp_path_factory.mktemp("small") / "small.urdf"
    tree.write(file)
    return bp.load_robot(file)


def test_a_slow_straight_path_is_followed_at_the_requested_speed(small: bp.Robot) -> None:
    """The joint curve swings about the path between samples: timed by arc length, the tip is 4 % too fast."""
    points, speed = np.array([[1.056, -0.022, -1.075], [0.635, -0.114, -1.1]]), 0.0754
    waypoints = [{"position": point} for point in points.tolist()]
    content = {"version": 1, "task": {"path": {"waypoints": waypoints, "speed": speed}}}
    plan = bp.plan(small, bp.scene_from_dict(content), effort="quick")
    assert plan.verified, plan.message
    motion, tips = plan.trajectory, plan.tip_path()
    tip_speed = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(motion.time)
    assert np.max(tip_speed) <= 1.001 * speed
    # and no slower than needed: at the speed itself but for the ends at rest
    assert np.median(tip_speed) >= 0.999 * speed
    length = float(np.linalg.norm(points[1] - points[0]))
    assert motion.duration <= 1.025 * length / speed
