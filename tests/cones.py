"""Narrow cones, and configurations at their edge."""

from __future__ import annotations

from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.motion import Keep, build_problem

Data = dict[str, Any]

CONES: list[Data] = [
    {"tilt": {"axis": [0, 0.1, -1], "direction": [0.1, 0, 1], "tolerance": 0.05}},
    {"rotation": {"rpy": [3.0, 0.1, 0.4], "tolerance": 0.05}},
]


def keep_of(robot: bp.Robot, keep: Data) -> Keep:
    start = dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start}, "keep": keep}}
    found = build_problem(robot, bp.scene_from_dict(content)).keep
    assert found is not None
    return found


def within(robot: bp.Robot, keep: Keep, count: int) -> list[Any]:
    """Random configurations at the edge of a cone."""
    rng, limits = np.random.default_rng(3), robot.limits
    tried = (keep.project(robot.random_q(rng), limits.lower, limits.upper) for _ in range(10 * count))
    return [q for q in tried if q is not None][:count]
