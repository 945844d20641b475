"""How much the distances of pairs can change on straight motions of the joints.

On the motion q + s delta, 0 <= s <= 1, no point of a link's piece moves further than sum_j |delta_j| r_j
(`travel_bounds`), whatever the posture. The posture halfway gives a second bound. There the centres c of a
piece's balls move with a velocity v and the piece with an angular velocity omega, the combined effect of all
joints, and no point of the piece is faster than |v| + |omega| R. Elsewhere on the motion its velocity
differs by at most half of the greatest |x''| (`bend_weights`):

    |x'| <= max over the balls (|v| + |omega| R) + 1/2 sum_j r_j b_j

The smaller bound is used. It bounds the speed over s, so a part of the motion has that part of the bound.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine import Robot, bend_weights
from backhoe_planner.site.pairs.ball_bounds import TOGETHER, balls_of

_ROUNDING = 1e-12  # m: chosen above the rounding of sums of a few products


def link_ways(robot: Robot, travel: Matrix, first: Indices, around: Flags, q: Matrix) -> Iterator[Vector]:
    """(P,) bounds on how far each pair's link moves relative to the other body [m], on each motion of `q` (N + 1, n).

    Parameters
    ----------
    travel: (P, n) r of every pair.
    first: (P,) the number of each link's piece.
    around: (P,) which pairs are with a body that does not move; for the others only the first bound is used.
    """
    for start in range(0, len(q) - 1, TOGETHER):
        yield from _ways(robot, travel, first, around, q[start : start + TOGETHER + 1])


def _ways(robot: Robot, travel: Matrix, first: Indices, around: Flags, q: Matrix) -> Matrix:
    kinematics, balls = balls_of(robot)
    delta = np.diff(q, axis=0)
    at = kinematics.at(q[:-1] + 0.5 * delta)
    hinges = ~robot.prismatic
    moments = np.where(hinges[:, None], _cross(at.origins, at.axes), at.axes)
    # for each joint's body, its velocity at the world's origin and its angular velocity; those of the base are 0
    motion = np.zeros((2, len(delta), robot.n + 1, 3))
    np.cumsum(delta[:, :, None] * moments, axis=1, out=motion[0, :, 1:])
    np.cumsum((delta * hinges)[:, :, None] * at.axes, axis=1, out=motion[1, :, 1:])
    (level,) = balls.levels
    shift, turn = motion[:, :, level.joints]
    passing = shift + _cross(turn, level.centres(balls.poses_of(at)).transpose(1, 2, 0))
    speed = np.sqrt(np.vecdot(passing, passing)) + np.sqrt(np.vecdot(turn, turn)) * level.radii
    of_pieces = np.maximum.reduceat(speed, level.first, axis=1)
    found: Matrix = np.abs(delta) @ travel.T
    bend = bend_weights(delta, hinges.astype(float)) @ travel.T
    local = of_pieces[:, first] + 0.5 * bend + _ROUNDING
    return np.minimum(found, local, out=found, where=around)


def _cross(a: Matrix, b: Matrix) -> Matrix:
    """(..., 3) the cross products of vectors (..., 3)."""
    found = np.empty(a.shape)
    for k in range(3):  # by components: an index array would copy each factor first
        found[..., k] = a[..., k - 2] * b[..., k - 1] - a[..., k - 1] * b[..., k - 2]
    return found
