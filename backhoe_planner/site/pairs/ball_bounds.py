"""Lower bounds of the distances of pairs, in many configurations at once, without calling coal.

Every piece of a link is within a few balls. Every piece around is within a box in its own axes, rounded by its
radius; the distance of a ball from that is exact, and the distance of a link's piece is at least the least over its
balls. For a half-space it is the distance of the balls from its face, for two pieces of the machine the
least between their balls. Where balls may touch, nothing is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import Robot, chain_placements
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled, find_compiled
from backhoe_planner.site.pairs.certainly_clear import box_of, covered_links

_ROUNDING = 1e-9  # m: chosen far above the rounding of sums of a few products, and far below any clearance
TOGETHER = 64  # configurations; chosen: their bounds take a few MB if there are thousands of pairs


class BallBounds:
    """Bounds of the distances of P pairs.

    Parameters
    ----------
    own: how many pieces of the machine count: the first of `self_pieces`.
    bodies: the convex pieces around, numbered after these.
    first, second: (P,) the numbers of the pieces of each pair.
    asked: (P,) which pairs get bounds.
    """

    def __init__(
        self, robot: Robot, own: int, bodies: Sequence[shapes.Piece],
        *, first: Indices, second: Indices, asked: Flags,
    ) -> None:  # fmt: skip
        links, shift = covered_links(robot), np.zeros(3)
        if find_compiled() is None:  # for the machine's own pairs the plain version takes as long as it saves
            asked = asked & (second >= own)
        self._columns, self._count = np.flatnonzero(asked), len(asked)
        second = second[self._columns].astype(np.intp)
        second[second >= own] += len(links.joint) - own
        self._arguments = (
            links.factors, links.slides, links.joint, links.starts, links.fine,
            np.array([box_of(body, shift) for body in bodies]).reshape(-1, 15),
            np.array([body.radius for body in bodies], dtype=float), first[self._columns].astype(np.intp), second,
        )  # fmt: skip

    def of(self, q: Matrix) -> Iterator[Vector]:
        """(P,) lower bounds [m] for each of `q` (N, n), or minus infinity; obstacles are at their first positions."""
        for start in range(0, len(q), TOGETHER):
            yield from self._of(q[start : start + TOGETHER])

    def _of(self, q: Matrix) -> Matrix:
        bounds = ball_bounds(q, *self._arguments)
        bounds -= _ROUNDING
        bounds[bounds <= 0.0] = -np.inf
        if len(self._columns) == self._count:
            return bounds
        found = np.full((len(q), self._count), -np.inf)
        found[:, self._columns] = bounds
        return found


@compiled
def ball_bounds(
    q: Matrix, factors: Matrix, slides: Vector, joint: Indices, starts: Indices, fine: Matrix, boxes: Matrix,
    radius: Vector, first: Indices, second: Indices, /,
) -> Matrix:  # fmt: skip
    """(N, M) the least distances [m] of the balls around pieces `first` (M,) from the box or balls of `second` (M,).

    Parameters
    ----------
    q: (N, n) joint positions [rad or m]; factors, slides: see `chain_placements`.
    joint: (K,) that carries each of the machine's pieces; 0 for the base.
    starts, fine: (K + 1,), (S, 4) where the balls of each begin, and their centres and radii in the joint's frame [m].
    boxes, radius: (B, 15), (B,) boxes around bodies, see `first_not_apart`, and the radii that round them [m].
    second: numbers of the K pieces, or of the bodies, which are numbered after these.
    """
    balls = placed_balls(q, factors, slides, joint, starts, fine)
    found = np.zeros((len(q), len(first)))
    for other in np.unique(second).tolist():
        columns = np.flatnonzero(second == other)
        if other >= len(joint):
            away = _off_body(balls, boxes[other - len(joint)], float(radius[other - len(joint)]))
        else:
            own = slice(int(starts[other]), int(starts[other + 1]))
            away = np.linalg.norm(balls[..., None] - balls[:, :, None, own], axis=0) - fine[own, 3]
            away = away.min(axis=-1)
        least = np.minimum.reduceat(away - fine[:, 3], starts[:-1], axis=1)
        found[:, columns] = least[:, first[columns]]
    return found


def placed_balls(
    q: Matrix, factors: Matrix, slides: Vector, joint: Indices, starts: Indices, fine: Matrix
) -> Array:  # fmt: skip
    """(3, N, S) the centres of all balls [m], world."""
    joints = np.ascontiguousarray(q.T)
    _, origins, rotations, _, _ = chain_placements(
        joints, np.sin(joints), 1.0 - np.cos(joints), factors, slides, np.zeros((4, 3))
    )
    found = np.empty((3, len(q), len(fine)))
    of_balls = joint.repeat(np.diff(starts))
    for carrier in np.unique(joint).tolist():
        balls = np.flatnonzero(of_balls == carrier)
        if carrier:
            at = rotations[carrier - 1].transpose(1, 2, 0) @ fine[balls, :3].T + origins[carrier - 1][:, :, None]
        else:
            at = np.repeat(fine[balls, :3].T[:, None], len(q), axis=1)
        found[:, :, balls] = at
    return found


def _off_body(points: Array, box: Vector, radius: float) -> Matrix:
    """(N, S) distances of points (3, N, S) from a body's rounded box, or from a half-space's face [m], world."""
    axes, middle, half = box[:9].reshape(3, 3), box[9:12, None, None], box[12:, None, None]
    along = np.tensordot(axes, points, axes=1) - middle
    if half[0] < 0.0:
        return np.asarray(along[0])
    return np.asarray(np.linalg.norm(np.maximum(np.abs(along) - half, 0.0), axis=0) - radius)
