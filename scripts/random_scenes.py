"""Seeded random scenes for studies and tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.planning.problem import build_problem

__all__ = ["random_planar_scene"]


def random_planar_scene(robot: bp.Robot, rng: np.random.Generator) -> tuple[bp.Scene, NDArray[np.float64]]:
    """A scene for a planar arm with 1 to 6 obstacles, and a free configuration at its goal.

    Start and goal configuration are drawn until both keep every clearance by a
    centimetre, so that each of them is free; whether a way leads from one to the other
    is not known.
    """
    kinematics = bp.Kinematics(robot)
    while True:
        content: dict[str, Any] = {
            "version": 1,
            "start": {"joints": dict.fromkeys(robot.joint_names, 0.0)},
            "task": {"goal": {"position": [1.0, 1.0, 0.0]}},
            "obstacles": [_obstacle(index, rng) for index in range(int(rng.integers(1, 7)))],
            "clearance": 0.02,
            "influence": 0.4,
        }
        problem = build_problem(robot, bp.scene_from_dict(content))
        proximity = bp.Proximity(robot, problem.obstacles)
        free: list[NDArray[np.float64]] = []
        for _ in range(100):
            q = robot.random_q(rng)
            if np.all(proximity.distances(q) > proximity.clearance + 0.01):
                free.append(q)
            if len(free) == 2:
                break
        if len(free) < 2:
            continue
        content["start"] = {"joints": dict(zip(robot.joint_names, free[0].tolist(), strict=True))}
        content["task"] = {"goal": {"position": kinematics.at(free[1]).tip_position.tolist()}}
        return bp.scene_from_dict(content), free[1]


def _obstacle(index: int, rng: np.random.Generator) -> dict[str, Any]:
    place = rng.uniform(-3.5, 3.5, 2)
    kind = int(rng.integers(3))
    name = f"obstacle {index}"
    if kind == 0:
        return {
            "name": name,
            "shape": "sphere",
            "radius": float(rng.uniform(0.1, 0.5)),
            "position": [*place.tolist(), 0.0],
        }
    if kind == 1:
        size = [*rng.uniform(0.2, 1.0, 2).tolist(), 0.5]
        turn = [0.0, 0.0, float(rng.uniform(0.0, 3.0))]
        return {"name": name, "shape": "box", "size": size, "position": [*place.tolist(), 0.0], "rpy": turn}
    half = rng.uniform(-0.7, 0.7, 2)
    ends = [[*(place - half).tolist(), 0.0], [*(place + half).tolist(), 0.0]]
    return {"name": name, "shape": "capsule", "radius": float(rng.uniform(0.05, 0.2)), "from": ends[0], "to": ends[1]}
