"""Close looks: the distance of one pair along a path, bounded by several planes that are measured for it.

One plane bounds the distance well only near the configuration at which it was measured. A close look measures the
pair at a few samples of the path, each where the planes so far leave the smallest gap. A part of the path is clear if
a single one of the planes clears both its ends.
"""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.live.braking.braking_path import BrakingPath, Placements
from backhoe_planner.live.planes.narrow_phase import measure_pair
from backhoe_planner.live.planes.plane_gaps import bound_along
from backhoe_planner.live.planes.separation import FAR, Separation
from backhoe_planner.machine import bend_weights

_PLANES = 4  # measured along a path that is examined closely; chosen, each costs some 20 us


def proven_along(
    separation: Separation, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float
) -> Vector:
    """(K,) the bounds of `bound_along`, with a close look at pairs that they do not prove to keep the clearance [m]."""
    bound, _ = bound_along(separation, pairs, path, at, drift_time)
    for row in (bound < separation.clearance[pairs]).nonzero()[0].tolist():
        closer, _ = look_closely(separation, int(pairs[row]), path, at, drift_time)
        bound[row] = max(bound[row], closer)
    return bound


def look_closely(
    separation: Separation, pair: int, path: BrakingPath, at: Placements, drift_time: float, *, enough: float = math.inf
) -> tuple[float, int]:
    """Lower bound of one pair's distance over the path [m], and the sample at which all planes leave the smallest gap.

    It uses the planes of the last look, and up to `_PLANES` new ones. The plane of the tightest sample is kept as the
    pair's own.

    Parameters
    ----------
    at: the placements, which must hold the path.
    drift_time: how long the obstacle moves on along the path; 0 if it stands still [s].
    enough: the bound above which no more planes are measured [m].
    """
    joint, other, piece = int(separation.joint[pair]), int(separation.other[pair]), int(separation.piece[pair])
    radius = separation.own.radius[piece]
    body = separation.body[pair]
    shift = None if body is None else body.shift.tolist()
    count = path.parts + 1
    corners = separation.own.corners[piece] @ at.T[:count, joint, :3].transpose(0, 2, 1)  # (S, V, 3)
    if other:
        corners = np.matmul(corners - at.t[:count, None, other], at.R[:count, other])
    off = float(path.off_chord(separation.travel[separation.classes[pair]][None])[0])
    drift = float(np.linalg.norm(separation.velocity[pair])) * drift_time if drift_time > 0.0 else 0.0
    normals, offsets = separation.plane_sets.of(pair, piece, body, shift)
    gaps = (offsets - radius - corners @ normals.T).min(axis=1)  # (S, planes)
    least, measured = -FAR, np.zeros(count, dtype=bool)
    for number in range(min(_PLANES, count) + 1):
        parts = np.minimum(gaps[:-1], gaps[1:]).max(axis=1, initial=-FAR)
        least = max(least, float(parts.min()) - off - drift)
        if least >= enough or number == min(_PLANES, count):
            break
        sample = 0
        if number > 0:
            ends = np.append(parts, math.inf)
            np.minimum(ends[1:], parts, out=ends[1:])
            ends[measured] = math.inf
            sample = int(ends.argmin())
        measured[sample] = True
        _, n, offset, point = measure_pair(separation, pair, at, sample)
        if number == 0:
            least = max(least, _bound_from_link(separation, pair, n, point, path, at) - drift)
        normals, offsets = np.vstack((n, normals)), np.append(offset, offsets)
        gaps = np.column_stack(((offset - radius - corners @ n).min(axis=1), gaps))
    best = gaps.max(axis=1)
    tight = int(best.argmin())
    kept = int(gaps[tight].argmax())
    separation.keep_plane(pair, normals[kept], float(offsets[kept]))
    separation.plane_sets.keep(pair, piece, body, shift, normals, offsets)
    return least, tight


def _bound_from_link(
    separation: Separation, pair: int, n: Vector, point: Vector, path: BrakingPath, at: Placements
) -> float:
    """The same bound, from the plane of normal `n` (3,) through `point` (3,) at the start, moving with the link [m]."""
    body = separation.body[pair]
    if body is None or body.corners is None:
        return -FAR
    corners = body.corners + body.shift
    joint = int(separation.joint[pair])
    local = n @ at.R[0, joint]
    start = float(local @ ((point - at.t[0, joint]) @ at.R[0, joint]))
    count = path.parts + 1
    normals = at.R[:count, joint] @ local  # (S, 3)
    base = np.einsum("si,si->s", normals, at.t[:count, joint])
    gaps = normals @ corners.T - base[:, None]
    gaps -= start + body.piece.radius
    # in the link's frame the corners turn in the opposite sense, and further out
    travel, size = separation.travel[separation.classes[pair]], np.abs(path.delta)
    far = float(np.sqrt(((corners - point) ** 2).sum(axis=1).max())) + float(size @ travel)
    size = size * np.abs(separation.mask[pair])
    radius = np.where(separation.turning > 0.0, travel + far, 1.0)
    sharp = float(radius[::-1] @ bend_weights(size[::-1], separation.turning[::-1]))
    return float(gaps.min()) - sharp / (8.0 * path.parts**2)
