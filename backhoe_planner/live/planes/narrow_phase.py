"""The narrow phase: exact signed distances of single pairs, and the planes that follow from them.

Two bodies that are apart are measured by a compiled function if both are hulls of corners; all others by coal.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.boxes.placed_piece import PlacedPiece
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.planes.separation import FAR, Separation
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled

_NO_SHIFT = np.zeros(3)


class Measured(NamedTuple):
    """The measurement of a pair.

    Attributes
    ----------
    distance: signed [m].
    normal, offset: (3,) and [m] of the plane, in the frame of the other body.
    point: (3,) the nearest point of the link [m], world.
    """

    distance: float
    normal: Vector
    offset: float
    point: Vector


def measure_pair(separation: Separation, pair: int, at: Placements, sample: int) -> Measured:
    """Measure a pair at one configuration, row `sample` of the placements; its plane stays as it is."""
    separation.measured += 1
    own = separation.own
    piece, other = int(separation.piece[pair]), int(separation.other[pair])
    second, body = int(separation.other_piece[pair]), separation.body[pair]
    T, shift = at.T[sample], _NO_SHIFT
    if second >= 0:
        corners, fat = own.corners[second], float(own.radius[second])
    elif body is None:  # a pair of a cluster without a box
        return Measured(FAR, np.zeros(3), FAR, np.zeros(3))
    else:
        corners, fat, shift = body.piece.hull, body.piece.radius, body.shift
    T_own = T[separation.joint[pair]]
    found = hulls_apart(own.corners[piece], float(own.radius[piece]), T_own, corners, fat, shift, T[other])
    return _measure_by_coal(separation, piece, T_own, second, body, T[other]) if found is None else Measured(*found)


def _measure_by_coal(
    separation: Separation, piece: int, T_own: Matrix, second: int, body: PlacedPiece | None, T_other: Matrix
) -> Measured:
    """Measure a piece of a body at T_own against the piece `second` of a body at T_other, or against `body`."""
    shape, own = separation.own.shapes[piece]
    here = T_own.dot(own)
    if body is None:
        other_shape, own = separation.own.shapes[second]
        other = T_other.dot(own)
        there = shapes.transform(other[:3, :3], other[:3, 3])
    else:
        other_shape, there = body.piece.shape, body.place()
    distance, n, x, z = separation.gauge.measure(shape, shapes.transform(here[:3, :3], here[:3, 3]), other_shape, there)
    n, z = n.dot(T_other[:3, :3]), (z - T_other[:3, 3]).dot(T_other[:3, :3])
    return Measured(distance, n, float(n.dot(z)), x)


def renew_plane(separation: Separation, pair: int, at: Placements, sample: int) -> float:
    """Measure a pair, keep its plane, and return the signed distance [m]."""
    distance, n, offset, x = measure_pair(separation, pair, at, sample)
    separation.keep_plane(pair, n, offset)
    T, other, points = at.T[sample], int(separation.other[pair]), separation.points[pair]
    own, there = T[separation.joint[pair]], x
    if other:
        there = (x - T[other, :3, 3]).dot(T[other, :3, :3])
    points[:3], points[3:] = (x - own[:3, 3]).dot(own[:3, :3]), there + distance * n
    return distance


def is_exact_bound(
    separation: Separation, pair: int, at: Placements, sample: int, bound: float, tolerance: float
) -> bool:
    """Whether a lower `bound` of a pair's distance is below the true one by no more than a tolerance [m].

    This follows from the points of its last measurement: the true distance is at most that between these points,
    and at most that of the link's point from a box or a half-space. False if these do not prove it, or if the
    obstacle moves.
    """
    body = separation.body[pair]
    apart = known_apart(
        pair, separation.joint, separation.other, separation.velocity, separation.points, separation.faces,
        _NO_SHIFT if body is None else body.shift, at.T[sample],
    )  # fmt: skip
    return apart < math.inf and apart <= bound + tolerance


def measure_gradients(
    separation: Separation, pairs: Indices, at: Placements, sample: int, *, keep: bool = False
) -> tuple[Vector, Matrix]:
    """(K,) measured signed distances [m], and (K, n) how fast they fall with the joints [m/rad].

    keep: whether to keep the planes.
    """
    distance, n, x = np.zeros(len(pairs)), np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3))
    for row, pair in enumerate(pairs.tolist()):
        distance[row], normal, offset, x[row] = measure_pair(separation, pair, at, sample)
        if keep:
            separation.keep_plane(pair, normal, offset)
        other = int(separation.other[pair])
        n[row] = at.R[sample, other] @ normal if other else normal
    both = np.concatenate((n, np.cross(x, n)), axis=1)
    return distance, np.asarray((both @ at.J[sample]) * separation.mask[pairs])


@compiled
def known_apart(
    pair: int,
    joint: Indices,
    other: Indices,
    velocity: Matrix,
    points: Matrix,
    faces: Matrix,
    shift: Vector,
    T: Array,
    /,
) -> float:
    """Upper bound of the distance of a pair's bodies, from the last measurement [m]; infinite if unknown.

    It follows from the two points of that measurement, and from the distance of the link's point from the obstacle's
    piece, if that is a box or a half-space.

    Parameters
    ----------
    joint, other, velocity: (P,), (P,), (P, 3) of all pairs, see `Separation`. For a moving obstacle nothing is known.
    points: (P, 6) the points of the link and of the other body, each in the frame of its body [m]; nan if unknown.
    faces: (P, 15) see `faces_of`; shift: (3,) of the obstacle from where these are [m].
    T: (joints, 4, 4) poses of all bodies.
    """
    if velocity[pair].any():
        return np.inf
    own, there = T[joint[pair]], T[other[pair]]
    point = own[:3, :3].dot(points[pair, :3]) + own[:3, 3]
    apart = point - there[:3, :3].dot(points[pair, 3:]) - there[:3, 3]
    axes, middle, half = faces[pair, :9].reshape(3, 3), faces[pair, 9:12], faces[pair, 12:]
    off = np.maximum(np.abs((point - shift - middle).dot(axes)) - half, 0.0)
    return float(np.fmin(np.fmin(np.sqrt(apart.dot(apart)), np.sqrt(off.dot(off))), np.inf))


@compiled
def hulls_apart(
    corners: Matrix, fat: float, T: Matrix, other: Matrix, other_fat: float, shift: Vector, T_other: Matrix, /
) -> tuple[float, Vector, float, Vector] | None:
    """The distance of two bodies that are hulls of corners with a radius each, and the rest of `Measured`.

    None if coal is needed: if they touch or nearly do, if one has no corners, and always in plain Python.

    Parameters
    ----------
    corners: (V, 4) of the link, in the frame of its body; only the first three numbers count [m].
    fat, other_fat: the radii [m].
    T, T_other: (4, 4) poses of the bodies.
    other: (W, 3) or (W, 4) corners of the other body in its frame, before a `shift` (3,) is added [m].
    """
    return None
