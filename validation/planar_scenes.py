"""Random scenes for a planar arm: one to six solid obstacles, free configurations at start and goal."""

from __future__ import annotations

from typing import Any

import numpy as np

import backhoe_planner as bp
from validation.obstacles import name_all, planar_obstacle
from validation.scenes import scene_of

_ROOM: dict[str, Any] = {"clearance": 0.02, "influence": 0.4}  # m
_SPARE = 0.01  # m that start and goal configuration keep beyond every clearance, so that neither is on the edge
_POSTURES = 100  # tried among the same obstacles before others are drawn


def random_planar_scene(robot: bp.Robot, rng: np.random.Generator) -> bp.Scene:
    """A scene for a planar arm with 1 to 6 balls, blocks and capsules anywhere in its workspace.

    Start and goal come from two random free configurations; whether a motion leads from
    one to the other is not known.
    """
    kinematics = bp.Kinematics(robot)
    while True:
        obstacles = name_all([planar_obstacle(rng) for _ in range(int(rng.integers(1, 7)))])
        scene = scene_of(robot, obstacles, start=np.zeros(robot.n), **_ROOM)
        proximity = bp.Proximity(robot, bp.build_obstacles(scene, robot))
        drawn = [robot.random_q(rng) for _ in range(_POSTURES)]
        free = (q for q in drawn if np.all(proximity.distances(q) > proximity.clearance + _SPARE))
        start, goal = next(free, None), next(free, None)
        if start is not None and goal is not None:
            task = {"goal": {"position": kinematics.at(goal).tip_position.tolist()}}
            return scene_of(robot, obstacles, start=start, task=task, **_ROOM)
