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
from backhoe_planner.machine import Robot, bend_weights, chain_placements
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.ball_bounds import TOGETHER, placed_balls
from backhoe_planner.site.pairs.certainly_clear import covered_links

_ROUNDING = 1e-12  # m: chosen above the rounding of sums of a few products


def link_ways(robot: Robot, travel: Matrix, first: Indices, around: Flags, q: Matrix) -> Iterator[Vector]:
    """(P,) bounds on how far each pair's link moves relative to the other body [m], on each motion of `q` (N + 1, n).

    Parameters
    ----------
    travel: (P, n) r of every pair.
    first: (P,) the number of each link's piece.
    around: (P,) which pairs are with a body that does not move; for the others only the first bound is used.
    """
    links = covered_links(robot)
    chain = links.factors, links.slides, links.joint, links.starts, links.fine
    for start in range(0, len(q) - 1, TOGETHER):
        yield from ways_of_pairs(q[start : start + TOGETHER + 1], *chain, travel, first, around)


@compiled
def ways_of_pairs(
    q: Matrix, factors: Matrix, slides: Vector, joint: Indices, starts: Indices, fine: Matrix, travel: Matrix,
    first: Indices, around: Flags, /,
) -> Matrix:  # fmt: skip
    """(N, P) the bounds of `link_ways`, see there; factors to fine are those of `ball_bounds`."""
    delta = np.diff(q, axis=0)
    middle = q[:-1] + 0.5 * delta
    joints = np.ascontiguousarray(middle.T)
    axes, origins, _, _, _ = chain_placements(
        joints, np.sin(joints), 1.0 - np.cos(joints), factors, slides, np.zeros((4, 3))
    )
    axes, origins = axes.transpose(2, 0, 1), origins.transpose(2, 0, 1)
    hinges = slides == 0.0
    moments = np.where(hinges[:, None], _cross(origins, axes), axes)
    # for each joint's body, its velocity at the world's origin and its angular velocity; those of the base are 0
    motion = np.zeros((2, len(delta), len(slides) + 1, 3))
    np.cumsum(delta[:, :, None] * moments, axis=1, out=motion[0, :, 1:])
    np.cumsum((delta * hinges)[:, :, None] * axes, axis=1, out=motion[1, :, 1:])
    shift, turn = motion[:, :, joint.repeat(np.diff(starts))]
    passing = shift + _cross(turn, placed_balls(middle, factors, slides, joint, starts, fine).transpose(1, 2, 0))
    speed = np.sqrt(np.vecdot(passing, passing)) + np.sqrt(np.vecdot(turn, turn)) * fine[:, 3]
    of_pieces = np.maximum.reduceat(speed, starts[:-1], axis=1)
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
