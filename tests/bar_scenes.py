"""A planar arm that has to get past a bar: stretched on one side, turned on the other."""

from __future__ import annotations

from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics, Robot
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.site import Proximity

Data = dict[str, Any]

STRETCHED = np.zeros(4)
TURNED = np.array([1.5, 0.0, 0.0, 0.0])
# a bar across the arc that the stretched arm would sweep
BAR: Data = {"name": "bar", "shape": "box", "size": [2.0, 0.2, 1.0], "position": [3.2, 2.2, 0.0], "rpy": [0, 0, 0.6]}


def problem_of(robot: Robot, start: Vector, goal: Vector, obstacles: list[Data], **keys: Any) -> Problem:
    joints = dict(zip(robot.joint_names, start.tolist(), strict=True))
    tip = Kinematics(robot).at(goal).tip_position
    data: Data = {
        "version": 1,
        "start": {"joints": joints},
        "task": {"goal": {"position": tip.tolist()}},
        "obstacles": obstacles,
        "clearance": 0.02,
    }
    return build_problem(robot, bp.scene_from_dict(data | keys))


def across_bar(robot: Robot, *more: Data, **keys: Any) -> tuple[Problem, Proximity]:
    problem = problem_of(robot, STRETCHED, TURNED, [BAR, *more], **keys)
    return problem, Proximity(problem.robot, problem.obstacles)
