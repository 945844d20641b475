"""Bounds on how fast pairs can approach each other, before they are measured.

A link's piece is within a ball about c with radius R, an obstacle's within one about c_o with radius
r_o. While they are apart, their distance falls at the rate n . (x' - w), with the normal n from the
critical point x of the link to its witness on the obstacle, and w the obstacle's own velocity. With
c' and the angular velocity omega of the link,

    n . (x' - w) <= n . (c' - w) + |omega| R

and n is within asin((R + r_o) / |c_o - c|) of the line from c to c_o, so the largest value of the first
term over that cone is known. A link that passes by an obstacle, or leaves it, does not approach it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import LinkPiece, joint_poses
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled

_NO_LENGTH = 1e-9  # m: centres closer than this have no direction between them
_NEXT, _LAST, _ONES = np.array([1, 2, 0]), np.array([2, 0, 1]), np.ones(3)


class ApproachBounds:
    """Bounds on how fast pieces of a machine approach convex pieces around it, and each other.

    For two pieces of the machine, the motion of one relative to the other counts: motion that both share
    does not change their distance.

    Parameters
    ----------
    links: the machine's pieces.
    bodies: the pieces around, at their first positions. They are numbered after the machine's.
    """

    def __init__(self, links: Sequence[LinkPiece], bodies: Sequence[shapes.Piece]) -> None:
        own = [_ball(link.piece) for link in links]
        balls = own + [_ball(body) for body in bodies]
        self._size = np.array([size for _, size in balls])
        # vectors are columns here: numpy is several times faster along rows that are contiguous in memory
        self._centre = np.ascontiguousarray(np.reshape([centre for centre, _ in balls], (-1, 3)).T)
        self._joint = np.array([*(link.joint for link in links), *(0 for _ in bodies)], dtype=np.intp)
        self._own = np.array([(*centre, 1.0) for centre, _ in own]).reshape(-1, 4)
        self._poses: Array | None = None

    def at(
        self, data: pin.Data, J: Matrix, v: Vector, *, piece: Indices, body: Indices, shift: Matrix, velocity: Matrix
    ) -> Vector:
        """(K,) bounds for K pairs that are apart, where the joints of `data` are [m/s].

        Parameters
        ----------
        data: the same at every call.
        J: (6, n) Pinocchio's joint Jacobians there.
        v: (n,) joint velocities [rad/s or m/s].
        piece, body: (K,) numbers of the links' pieces that approach, and of the pieces that they approach.
        shift: (K, 3) how far the bodies have moved [m], world; velocity: (K, 3) of the bodies [m/s].
        """
        if self._poses is None:
            self._poses = joint_poses(data)
        return approach_rates(
            self._poses, self._own, self._centre, self._size, self._joint, J, v, piece, body, shift, velocity
        )


@compiled
def approach_rates(
    poses: Array, own: Matrix, centre: Matrix, size: Vector, joint: Indices, J: Matrix, v: Vector,
    piece: Indices, body: Indices, shift: Matrix, velocity: Matrix, /,
) -> Vector:  # fmt: skip
    """(K,) the bounds of `ApproachBounds.at` for K pairs [m/s].

    Parameters
    ----------
    poses: (n + 1, 3, 4) of the joints; the first is the world's.
    own: (L, 4) homogeneous centres of the balls around the machine's pieces, in their bodies' frames [m].
    centre: (3, B) centres of all balls, the machine's first, whose columns are overwritten here [m], world.
    size, joint: (B,) radii of the balls [m], and the joints that they move with.
    J, v, piece, body, shift, velocity: see `ApproachBounds.at`.
    """
    placed = np.matmul(poses.take(joint[: len(own)], axis=0), own[:, :, None])
    centre[:, : len(own)] = placed[..., 0].T
    motion = np.zeros((6, len(v) + 1))  # for each joint's body: velocity at the world's origin, angular velocity
    np.cumsum(J * v, axis=1, out=motion[:, 1:])
    here, radius = centre.take(piece, axis=1), size.take(piece)
    seen = motion.take(joint.take(piece), axis=1)
    seen -= motion.take(joint.take(body), axis=1)
    turn = seen[3:]
    passing = seen[:3] + turn.take(_NEXT, axis=0) * here.take(_LAST, axis=0)
    passing -= turn.take(_LAST, axis=0) * here.take(_NEXT, axis=0)
    passing -= velocity.T
    away = centre.take(body, axis=1)
    away -= here
    away += shift.T
    length = np.maximum(np.sqrt(_ONES.dot(away * away)), _NO_LENGTH)
    speed2 = _ONES.dot(passing * passing)
    speed = np.sqrt(speed2)
    sine = np.minimum((size.take(body) + radius) / length, 1.0)
    cosine = np.sqrt(1.0 - sine * sine)
    along = _ONES.dot(away * passing) / length
    across = np.sqrt(np.maximum(speed2 - along * along, 0.0))
    aside = (along < speed * cosine) & (sine < 1.0)
    towards = np.where(aside, along * cosine + across * sine, speed)
    return np.asarray(towards + np.sqrt(_ONES.dot(turn * turn)) * radius)


def _ball(piece: shapes.Piece) -> tuple[Vector, float]:
    """Centre (3,) and radius [m] of a ball around a piece, in its body's frame; infinite for a half-space."""
    if not len(piece.hull):
        return np.zeros(3), np.inf
    centre = 0.5 * (piece.hull.min(axis=0) + piece.hull.max(axis=0))
    return centre, float(np.linalg.norm(piece.hull - centre, axis=1).max()) + piece.radius
