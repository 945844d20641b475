"""A polytope with fewer faces around a convex hull.

With its centroid as the origin a polytope is P = {x: a_i . x <= 1}. Some of these half-spaces
are kept, S = {x: a_i . x <= 1 for the i that are kept}, so that S contains P. The points a_i
span the dual of P, and the kept ones that of S. Each face m . a <= c of the dual of S is the
corner m / c of S, and P has to be enlarged by m . a_i / c to reach this corner across its
face i. Wherever that is more than 1 + excess, the a_i with the largest m . a_i is kept, too.
At the end S contains P, and P enlarged by 1 + excess about the centroid contains S.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.arrays import Matrix, Vector

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_ROUNDING = 1e-9  # S is enlarged by this part at the end, so that rounding cuts nothing off
_WAYS = np.array([way for way in np.ndindex(3, 3, 3) if way != (1, 1, 1)], dtype=float) - 1.0  # along axes, diagonals


def most_neighbours(hull: ConvexHull) -> int:
    """The largest number of edges that meet in a corner of a triangulated `hull`."""
    ends = np.sort(hull.simplices[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1).astype(np.int64)
    # as one number for each edge, which is sorted in a tenth of the time
    edges = np.unique(ends[:, 0] * len(hull.points) + ends[:, 1])
    return int(np.bincount(np.concatenate(np.divmod(edges, len(hull.points)))).max())


def enclosing_corners(hull: ConvexHull, excess: float) -> Matrix:
    """(k, 3) corners [m] of a polytope that contains `hull` and lies within it enlarged by 1 + `excess`.

    The hull is enlarged about its centroid: no point sticks out by more than `excess` times its distance from there.
    """
    from scipy.spatial import ConvexHull

    corners, centre = hull.points[hull.vertices], _centroid(hull)
    # scale all sizes along the principal axes to 1: corners and excess stay the same, and numbers become similar
    axes = np.linalg.svd(corners - centre, full_matrices=False)[2]
    sizes = np.ptp(corners @ axes.T, axis=0)
    planes = np.unique(hull.equations, axis=0)
    duals = planes[:, :3] @ axes.T * sizes / -(planes[:, :3] @ centre + planes[:, 3])[:, None]
    kept = np.unique(np.argmax(_WAYS @ duals.T, axis=1))
    while True:
        faces = ConvexHull(duals[kept]).equations
        normal, offset = faces[:, :3], -faces[:, 3]
        reach = normal @ duals.T
        furthest = np.argmax(reach, axis=1)
        beyond = reach[np.arange(len(faces)), furthest] > (1.0 + excess) * np.maximum(offset, 0.0)
        missing = np.setdiff1d(furthest[beyond], kept)
        if not len(missing):
            break
        kept = np.concatenate((kept, missing))
    found = np.unique(normal / offset[:, None], axis=0)
    return np.asarray(centre + (1.0 + _ROUNDING) * found * sizes @ axes)


def _centroid(hull: ConvexHull) -> Vector:
    """(3,) centroid of the volume [m]."""
    inside = hull.points[hull.vertices].mean(axis=0)
    legs = hull.points[hull.simplices] - inside
    volumes = np.abs(np.linalg.det(legs))
    return np.asarray(inside + 0.25 * volumes @ legs.sum(axis=1) / volumes.sum())
