"""The pose within reach that is nearest to a target out of reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Kinematics, Robot, TipTarget, solve_inverse_kinematics

# part of the longest move by which a target is moved further than needed; chosen: a stretched arm turns fast
_INSIDE = 0.02
_MOVES = 8  # moves after which a target is given up; chosen: one or two are usual


def move_within_reach(
    robot: Robot, target: TipTarget, q: Vector, *, most: float, angle_weight: float = 1.0
) -> tuple[TipTarget, Vector] | None:
    """`target` moved to where the tip can be with the required angles, and (n,) joints there; None if that is too far.

    It is moved a little further into the reach than needed, if the reach extends further.

    Parameters
    ----------
    q: (n,) joints with the tip as near to the target as possible [rad or m].
    most: how far the position may be moved [m].
    angle_weight: see `solve_inverse_kinematics`.
    """
    kinematics = Kinematics(robot)
    for _ in range(_MOVES):
        away = kinematics.at(q).tip_position - target.position
        far = float(np.linalg.norm(away))
        if not 0.0 < far <= most:
            return None
        further = min(1.0 + _INSIDE * most / far, most / far)
        moved = replace(target, position=target.position + further * away)
        found = solve_inverse_kinematics(robot, moved, start=q, angle_weight=angle_weight)
        if found.reached:
            return moved, found.q
        # a reach may be thinner than that: with a joint held it may be a surface
        touching = replace(target, position=target.position + away)
        there = solve_inverse_kinematics(robot, touching, start=q, angle_weight=angle_weight)
        if there.reached:
            return touching, there.q
        q = found.q
    return None
