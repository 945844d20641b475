"""Targets of the tip moved as little as is needed: into the reach of the arm, or away from an obstacle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import (
    BatchKinematics,
    Kinematics,
    Robot,
    TargetBatch,
    TipTarget,
    solve_batch,
    solve_inverse_kinematics,
)
from backhoe_planner.site import ClearanceScreen, Proximity

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


def move_aside(
    proximity: Proximity, screen: ClearanceScreen, target: TipTarget, ends: Matrix, *, given: Vector, most: float,
    spare: float = 0.0, time: float = 0.0,
) -> tuple[TipTarget, Matrix] | None:  # fmt: skip
    """`target` moved away from what the machine is too near to, and (C, n) joints clear there; None if that is too far.

    Parameters
    ----------
    screen: says which configurations are clear.
    ends: (K, n) joints with the tip on `target`, none of them clear [rad or m].
    given: (3,) the position from which the target is moved no further than `most` [m].
    spare: kept beyond every clearance [m].
    time: at which the positions of the obstacles are taken [s].
    """
    kinematics = BatchKinematics(proximity.robot)
    for _ in range(_MOVES):
        nearby = [proximity.at(q, time=time, margin=spare) for q in ends]
        touching = [near for near in nearby if len(near)]
        if not touching:
            return None
        mildest = max(touching, key=lambda near: float(np.min(near.margin)))
        row = int(np.argmin(mildest.margin))
        step = float(mildest.margin[row]) - spare - _INSIDE * most
        target = replace(target, position=target.position + step * mildest.normal[row])
        if float(np.linalg.norm(target.position - given)) > most:
            return None
        q, reached = solve_batch(kinematics, TargetBatch.of([target] * len(ends)), ends)
        ends = q[reached]
        if not len(ends):
            return None
        clear = screen.keeps(ends)
        if clear.any():
            return target, ends[clear]
    return None
