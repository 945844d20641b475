"""The proof that the shapes of two pieces as written never meet, though their convex pieces overlap.

A box of configurations is halved until, in the middle of each part, the two shapes are further apart than
they can approach each other within the part: sum_j h_j r_j, with half the width h_j of the part [rad or m]
and r_j of `travel_bounds`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector
from backhoe_planner.machine.collision_model import travel_bounds
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes

_LOOKS = 3000  # configurations that are tested at most; chosen: below a second


def proven_apart(robot: Robot, pair: tuple[LinkPiece, LinkPiece], lower: Vector, upper: Vector) -> bool:
    """Whether two pieces are proven never to meet, by shapes nowhere larger than as written.

    Parameters
    ----------
    pair: the piece further out first.
    lower, upper: (n,) finite ranges of the joints; only the joints between the two pieces matter [rad or m].
    """
    outer, inner = pair
    between = slice(inner.joint, outer.joint)
    travel = travel_bounds(robot, np.vstack((lower, upper)), pieces=[outer])[0, between]
    data, q = robot.model.createData(), robot.middle.copy()
    parts = [(lower[between], upper[between])]
    looks = 0
    while parts:
        low, high = parts.pop()
        looks += 1
        q[between] = 0.5 * (low + high)
        pin.forwardKinematics(robot.model, data, q)
        T = data.oMi[inner.joint].actInv(data.oMi[outer.joint]) * outer.piece.placement
        nearer = 0.5 * (high - low) * travel
        if not shapes.within(outer.piece, T, inner.piece, inner.piece.placement, float(nearer.sum())):
            continue
        if looks + 2 * len(parts) >= _LOOKS or shapes.within(outer.piece, T, inner.piece, inner.piece.placement, 0.0):
            return False
        widest = int(np.argmax(nearer))
        middle_high, middle_low = high.copy(), low.copy()
        middle_high[widest] = middle_low[widest] = q[between][widest]
        parts += [(low, middle_high), (middle_low, high)]
    return True
