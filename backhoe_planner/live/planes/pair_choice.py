"""The choice of the pairs to examine in a step: near ones, those without a proven braking path, the stalest one.

Also how far apart the bodies of a pair are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.native import compiled

_EMPTY = np.zeros(0)


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


@compiled
def near_now(
    distance: Vector, within: Vector, pairs: Indices, classes: Indices, odometer: Vector, /
) -> tuple[Indices, Vector, Vector]:
    """Those (K,) of `pairs` (M,) that may be near, their lower bounds (K,) and their odometers' values (K,) [m].

    Parameters
    ----------
    distance: (P,) lower bounds of all pairs plus the odometer's value then [m]; within: (P,) nearer ones count [m].
    classes: (M,) rows of the odometer (C,) for the `pairs`.
    """
    counted = odometer.take(classes)
    lower = distance.take(pairs)
    lower -= counted
    rows = (lower < within.take(pairs)).nonzero()[0]
    if len(rows) == 0:
        return rows, _EMPTY, _EMPTY
    return pairs.take(rows), lower.take(rows), counted.take(rows)


@compiled
def not_proven(
    proven: Vector, required: Vector, pairs: Indices, classes: Indices, odometer: Vector, budget: Vector,
    buffer: float, /,
) -> Indices:  # fmt: skip
    """Those of `pairs` (M,) for which too little of the braking path is proven if it may move by `budget` (C,) [m].

    Parameters
    ----------
    proven: (P,) of all pairs plus the odometer's value then [m]; required: (P,) the distance that must be kept [m].
    classes: (M,) rows of the odometer (C,) for the `pairs`.
    buffer: to be kept beyond the required distance [m].
    """
    left = proven.take(pairs)
    left -= required.take(pairs)
    needed = odometer + budget
    needed += buffer
    return pairs.take((left < needed.take(classes)).nonzero()[0])


@compiled
def margins_now(pairs: Indices, distance: Vector, clearance: Vector, classes: Indices, odometer: Vector, /) -> Vector:
    """(K,) lower bounds of the margins of `pairs` (K,): distance minus clearance [m].

    Parameters
    ----------
    distance: (P,) lower bounds of all pairs plus the odometer's value then [m]; clearance: (P,) of all pairs [m].
    classes: (P,) their rows of the odometer (C,).
    """
    found = distance.take(pairs)
    found -= odometer.take(classes.take(pairs))
    found -= clearance.take(pairs)
    return found


@compiled
def stalest_pair(
    pairs: Indices, distance: Vector, clearance: Vector, renewed: Vector, classes: Indices, odometer: Vector,
    nearest_first: bool, far: bool, rules: tuple[float, ...], /,
) -> int:  # fmt: skip
    """Which of `pairs` (K,) to measure again; -1 for none.

    Parameters
    ----------
    distance, clearance, classes, odometer: as for `margins_now`.
    renewed: (P,) the odometer's value when each pair was last measured [m].
    nearest_first: whether the nearest one comes first, if it is close.
    far: whether a pair is also measured if none is close.
    rules: margin within which a pair is close [m], a length added to its margin [m], and the part of that sum that it
        must have moved.
    """
    if len(pairs) == 0:
        return -1
    close, urgent, least = rules
    margin = margins_now(pairs, distance, clearance, classes, odometer)
    nearest = int(margin.argmin())
    is_close = bool(margin[nearest] <= close)
    if not (is_close or far):
        return -1
    moved = odometer.take(classes.take(pairs)) - renewed.take(pairs)
    moved /= urgent + np.maximum(margin, 0.0)
    row = nearest if is_close and nearest_first and moved[nearest] > least else int(moved.argmax())
    return int(pairs[row]) if moved[row] > least else -1


@compiled
def tightest_pair(
    pairs: Indices, distance: Vector, clearance: Vector, classes: Indices, odometer: Vector, /
) -> tuple[int, float]:
    """Which of `pairs` (K,), K > 0, has the least of `margins_now`, and that margin [m]."""
    margins = margins_now(pairs, distance, clearance, classes, odometer)
    row = int(margins.argmin())
    return int(pairs[row]), float(margins[row])


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
