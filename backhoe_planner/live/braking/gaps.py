"""The gaps between the corners of the machine's links and the planes of its pairs, and memory for them."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.braking.odometers import note_gaps
from backhoe_planner.native import compiled

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
_NEXT_LAST, _LAST_NEXT = np.concatenate((_NEXT, _LAST)), np.concatenate((_LAST, _NEXT))


class Memory:
    """Memory for the gaps of `gaps_at`, which are overwritten in every step and change their size."""

    def __init__(self) -> None:
        self._gaps = np.zeros(0)

    def gaps(self, pairs: int, samples: int, corners: int) -> Array:
        """Memory for the gaps (pairs, samples, corners); its previous content is lost."""
        size = pairs * samples * corners
        if size > len(self._gaps):
            self._gaps = np.zeros(2 * size)
        return self._gaps[:size].reshape(pairs, samples, corners)


class Gaps(NamedTuple):
    """The gaps between the corners of K pairs' links and their planes, at S samples.

    Attributes
    ----------
    all: (K, S, V) of every corner [m].
    nearest, least: (K, S) which corner has the least gap, and that gap [m].
    """

    all: Array
    nearest: Indices
    least: Matrix

    def put(self, rows: Indices, others: Gaps) -> None:
        """Overwrite `rows` (K,) with the gaps of `others`."""
        for own, other in zip(self, others, strict=True):
            own[rows] = other


NO_GAPS = Gaps(np.zeros((0, 1, 1)), np.zeros((0, 1), dtype=np.intp), np.zeros((0, 1)))


@compiled
def corner_gaps(
    pairs: Indices, planes: Matrix, joint: Indices, other: Indices | None, piece: Indices, corners: Array, T: Array,
    drift: Vector | None, step: float, gaps: Array, /,
) -> tuple[Indices, Matrix]:  # fmt: skip
    """Which corner of each of `pairs` (K,) has the least gap at each sample (K, S), and that gap (K, S) [m].

    Parameters
    ----------
    planes, joint, other: (P, 4), (P,), (P,) of all pairs, see `Separation`; without `other` all are fixed in the world.
    piece, corners: (P,) the piece whose corners count, and (M, 4, V) those of all pieces, with a 1 below each [m].
    T: (S, joints, 4, 4) see `Placements`.
    drift: (P,) rates at which the planes move along their normals [m/s]; only approaching planes count.
    step: the time from sample to sample [s].
    gaps: (K, S, V) output: the gaps of all corners [m].
    """
    count = len(T)
    seen = planes.take(pairs, axis=0)
    if other is not None and _some(bodies := other.take(pairs)):
        frames = T.take(bodies, axis=1)
        inside, seen = seen, np.empty((count, len(pairs), 4))
        normals = seen[..., :3] = np.matmul(frames[..., :3, :3], inside[:, :3, None])[..., 0]
        seen[..., 3] = inside[:, 3] - np.vecdot(normals, frames[..., :3, 3])
    if drift is not None:
        nearer = np.minimum(drift.take(pairs), 0.0)
        if np.count_nonzero(nearer):
            seen = np.repeat(seen[None], count, axis=0) if seen.ndim == 2 else seen
            seen[..., 3] += (step * np.arange(count))[:, None] * nearer
    # in the links' frames; the 1 below each corner multiplies the last number
    local = np.matmul(seen[..., None, :], T.take(joint.take(pairs), axis=1))[:, :, 0]
    np.matmul(local.transpose(1, 0, 2), corners.take(piece.take(pairs), axis=0), out=gaps)
    nearest = gaps.argmin(axis=2)  # several times faster than the minimum itself
    place = _firsts(*gaps.shape) + nearest
    return nearest, gaps.reshape(-1).take(place)


@compiled
def near_gaps(
    pairs: Indices, lower: Vector, counted: Vector, planes: Matrix, joint: Indices, other: Indices | None,
    piece: Indices, corners: Array, T: Array, clearance: Vector, distance: Vector, /,
) -> tuple[Array, Indices, Matrix, Vector, Vector]:  # fmt: skip
    """The gaps of near `pairs` (K,), which corners have the least ones, these least gaps, and those of `note_gaps`.

    Parameters
    ----------
    lower, counted, clearance, distance: see `note_gaps`; `distance` is written.
    planes, joint, other, piece, corners, T: see `corner_gaps`.
    """
    gaps = np.empty((len(pairs), len(T), corners.shape[2]))
    nearest, least = corner_gaps(pairs, planes, joint, other, piece, corners, T, None, 0.0, gaps)
    return gaps, nearest, least, *note_gaps(pairs, lower, counted, least, clearance, distance)


@compiled
def least_over_path(pairs: Indices, least: Matrix, classes: Indices, off: Vector, /) -> Vector:
    """(K,) the least gap of each of `pairs` (K,) over all samples, minus how far points may be off the chords [m].

    Parameters
    ----------
    least: (K, S) the least gaps at the samples [m].
    classes, off: (P,) for all pairs their row of `off` (C,) [m].
    """
    found: Vector = np.minimum.reduce(least, axis=1)
    found -= off.take(classes.take(pairs))
    return found


@compiled
def left_over_path(
    pairs: Indices, bound: Vector, required: Vector, tolerance: float, /
) -> tuple[Vector, Indices]:  # fmt: skip
    """(K,) by how much `bound` (K,) exceeds what `pairs` (K,) must keep [m], and the rows where it is below -tolerance.

    required: (P,) of all pairs [m].
    """
    left = bound - required.take(pairs)
    return left, (left < -tolerance).nonzero()[0]


@lru_cache(maxsize=64)
def _firsts(pairs: int, samples: int, corners: int) -> Indices:
    """(pairs, samples) where each row of the gaps (pairs, samples, corners) begins, read-only."""
    return np.arange(0, pairs * samples * corners, corners).reshape(pairs, samples)


@compiled
def blended_points(gaps: Array, least: Matrix, pieces: Indices, corners: Array, width: float, /) -> Matrix:
    """(K, 4) the nearest point of each pair at the first sample, in its link's frame, with a 1 appended [m].

    Corners that are less than `width` [m] further away than the nearest one contribute to it.

    Parameters
    ----------
    gaps, least: (K, S, V), (K, S), see `Gaps`.
    pieces, corners: (K,), (M, 4, V) the piece of each pair, and the corners of all pieces, see `corner_gaps`.
    """
    part = (least[:, :1] + width) - gaps[:, 0]
    np.maximum(part, 0.0, out=part)
    part *= part
    points = np.matmul(corners.take(pieces, axis=0), part[:, :, None])[..., 0]
    points /= points[:, 3:]  # the sum of the weights, from the 1 below each corner
    return np.asarray(points)


@compiled
def nearest_rows(
    pairs: Indices, gaps: Array, least: Matrix, piece: Indices, corners: Array, width: float, planes: Matrix,
    joint: Indices, other: Indices | None, mask: Matrix, T: Array, J: Array, /,
) -> Matrix:  # fmt: skip
    """(K, n) how fast the distances of `pairs` (K,) rise with the joints, at their `blended_points` [m/rad].

    Parameters
    ----------
    gaps, least, width: see `blended_points`.
    piece: (P,) the piece whose corners count; corners: (M, 4, V) those of all pieces, with a 1 below each [m].
    planes, joint, other, mask, T, J: see `plane_rows`; the first sample counts.
    """
    points = blended_points(gaps, least, piece.take(pairs), corners, width)
    return -plane_rows(pairs, 0, points, planes, joint, other, mask, T, J)


@compiled
def plane_rows(
    pairs: Indices, samples: Indices | int, points: Matrix, planes: Matrix, joint: Indices, other: Indices | None,
    mask: Matrix, T: Array, J: Array, /,
) -> Matrix:  # fmt: skip
    """(R, n) how fast the gaps of `points` (R, 4) of the links of `pairs` (R,) fall with the joints [m/rad].

    Parameters
    ----------
    samples: (R,) rows of T, or one for all.
    points: in the links' frames, with a 1 appended to each [m].
    planes, joint, other, mask: (P, 4), (P,), (P,), (P, n) of all pairs; without `other` all are fixed in the world.
    T, J: (S, joints, 4, 4), (S, 6, n) see `Placements`.
    """
    n = planes.take(pairs, axis=0)[:, :3]  # in this order: `take` copies all of an array that is not contiguous
    joints = joint.take(pairs)
    at_once = isinstance(samples, int)
    if other is not None and _some(bodies := other.take(pairs)):
        frames = T[samples].take(bodies, axis=0) if at_once else T[samples, bodies]
        n = np.matmul(frames[:, :3, :3], n[:, :, None])[..., 0]
    frames = T[samples].take(joints, axis=0) if at_once else T[samples, joints]
    x = np.matmul(frames, points[:, :, None])[..., 0]
    products = x.take(_NEXT_LAST, axis=1)
    products *= n.take(_LAST_NEXT, axis=1)
    both = np.empty((len(pairs), 6))  # -n and -(x cross n), since the planes hold minus the normals
    np.negative(n, out=both[:, :3])
    np.subtract(products[:, 3:], products[:, :3], out=both[:, 3:])
    rows: Matrix = mask.take(pairs, axis=0)
    rows *= both.dot(J[samples]) if at_once else np.matmul(both[:, None, :], J[samples])[:, 0]
    return rows


def _some(numbers: Indices) -> bool:
    """Whether any of `numbers` (K,), K > 0, none of them negative, is not 0."""
    return bool(numbers[numbers.argmax()])
