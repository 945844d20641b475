"""The gaps that the planes of pairs leave: bounds of their distances, and how fast they fall with the joints.

The gap between a pair's plane and the corners of the link is a lower bound of its distance, see `separation`. It is
found at the samples of a path; between two of them a corner leaves its chord by no more than `BrakingPath.off_chord`.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.braking.braking_path import BrakingPath, Placements
from backhoe_planner.live.braking.gaps import (
    Gaps,
    Memory,
    corner_gaps,
    least_over_path,
    near_gaps,
    nearest_rows,
    plane_rows,
)
from backhoe_planner.live.planes.path_rows import gaps_along_path
from backhoe_planner.live.planes.separation import Separation

_BLENDED = 0.1  # m: chosen, corners that are this much further away do not contribute to the nearest point

# --- bounds ------------------------------------------------------------------------------


def gaps_at(
    separation: Separation, pairs: Indices, at: Placements, samples: int | slice,
    *, drift_time: float = 0.0, memory: Memory | None = None,
) -> Gaps:  # fmt: skip
    """The gaps from every corner of the links to the planes of `pairs` (K,).

    Parameters
    ----------
    samples: rows of the placements, as a slice or as a number of first rows.
    drift_time: how long the planes of approaching obstacles move on, from the first sample to the last [s].
    memory: to which the gaps are written; new arrays without it.
    """
    T = at.T[samples if isinstance(samples, slice) else slice(samples)]
    count, columns = len(T), separation.own.columns
    memory = Memory() if memory is None else memory
    gaps = memory.gaps(len(pairs), count, columns.shape[2])
    drift = separation.drift if drift_time > 0.0 else None
    nearest, least = corner_gaps(
        pairs, separation.planes, separation.joint, separation.relative_to, separation.piece, columns, T, drift,
        drift_time / max(count - 1, 1), gaps,
    )  # fmt: skip
    return Gaps(gaps, nearest, least)


def least_gaps_at(separation: Separation, pairs: Indices, at: Placements, sample: int) -> Vector:
    """(K,) lower bounds of the distances of `pairs` (K,) at one sample [m]."""
    return np.asarray(gaps_at(separation, pairs, at, slice(sample, sample + 1)).least[:, 0])


def gaps_here(
    separation: Separation, pairs: Indices, lower: Vector, counted: Vector, at: Placements, distance: Vector
) -> tuple[Gaps, Vector, Vector]:
    """The gaps of `pairs` (K,) at the placements' row 0, and the results of `note_gaps`."""
    gaps, nearest, least, found, margin = near_gaps(
        pairs, lower, counted, separation.planes, separation.joint, separation.relative_to, separation.piece,
        separation.own.columns, at.T[:1], separation.clearance, distance,
    )  # fmt: skip
    return Gaps(gaps, nearest, least), found, margin


def gaps_along(
    separation: Separation, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float,
    *, required: Vector, tolerance: float, memory: Memory,
) -> tuple[Gaps, Vector, Vector, Indices]:  # fmt: skip
    """Place the bodies along a path; the gaps of `pairs` (K,), and the last three results of `gaps_along_path`.

    For `drift_time` see `bound_along`; for `required` and `tolerance` see `left_over_path`.
    """
    parts, bend, columns, travel = path.parts, path.bend, separation.own.columns, separation.travel
    gaps = memory.gaps(len(pairs), parts + 1, columns.shape[2])
    drift = separation.drift if drift_time > 0.0 else None
    off, nearest, least, bound, left, short = gaps_along_path(
        path.q, path.delta, parts, bend, *at.chain, travel, pairs, separation.planes, separation.joint,
        separation.relative_to, separation.piece, columns, drift, drift_time / parts, separation.classes, required,
        tolerance, at.T, at.J, gaps,
    )  # fmt: skip
    path.keep_off_chord(travel, off)
    return Gaps(gaps, nearest, least), bound, left, short


def bound_along(
    separation: Separation, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float,
    *, memory: Memory | None = None,
) -> tuple[Vector, Gaps]:  # fmt: skip
    """(K,) proven lower bounds of the distances of `pairs` (K,) over a whole path, and the gaps at its samples [m].

    The placements must hold the path. `drift_time` is how long the obstacles move on along it; 0 if none moves [s].
    """
    gaps = gaps_at(separation, pairs, at, path.parts + 1, drift_time=drift_time, memory=memory)
    return least_over_path(pairs, gaps.least, separation.classes, path.off_chord(separation.travel)), gaps


# --- derivatives -------------------------------------------------------------------------


def corner_rows(
    separation: Separation, pairs: Indices, samples: Indices | int, corners: Indices, at: Placements
) -> Matrix:
    """(R, n) how fast the gaps of these `corners` (R,) of `pairs` (R,) fall with the joints [m/rad]."""
    points = separation.own.corners[separation.piece[pairs], corners]
    return plane_rows(
        pairs, samples, points, separation.planes, separation.joint, separation.relative_to, separation.mask, at.T, at.J
    )


def path_row_arguments(
    separation: Separation, at: Placements
) -> tuple[Matrix, Indices, Indices | None, Indices, Array, Matrix, Array, Array, Vector]:
    """The arguments of `rows_of_path` that describe all pairs and the placements of the bodies."""
    return (
        separation.planes, separation.joint, separation.relative_to, separation.piece, separation.own.corners,
        separation.mask, at.T, at.J, separation.drift,
    )  # fmt: skip


def nearest_point_rows(separation: Separation, pairs: Indices, gaps: Gaps, at: Placements) -> Matrix:
    """(K, n) how fast the distance rises at the first sample, at the nearest point of each pair [m/rad].

    The point is blended from the corners by their `gaps` there: corners that are almost as near
    contribute to it, so that it does not jump from edge to edge when a flat end passes a wall.
    """
    return nearest_rows(
        pairs, gaps.all, gaps.least, separation.piece, separation.own.columns, _BLENDED, separation.planes,
        separation.joint, separation.relative_to, separation.mask, at.T, at.J,
    )  # fmt: skip


def world_normal(separation: Separation, pair: int, at: Placements) -> Vector:
    """(3,) the normal of a pair's plane at the first sample, world."""
    other = separation.other[pair]
    normal: Vector = -separation.planes[pair, :3]
    return at.R[0, other].dot(normal) if other else normal
