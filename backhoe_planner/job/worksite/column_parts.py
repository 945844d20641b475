"""The exact part of each column of the ground that is within the area to be dug."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector

_ROUNDING = 1e-9  # of a column


def parts_within(nodes: Array, cell: float, corners: Matrix) -> tuple[Array, Array]:
    """(...) the part of each column that is within a convex area, 0 to 1, and (..., 2) the middle of that part [m].

    Parameters
    ----------
    nodes: (..., 2) x, y of the columns, squares along x and y [m].
    cell: edge of a column [m].
    corners: (k, 2) corners of the area, counter-clockwise [m].
    """
    flat = nodes.reshape(-1, 2)
    ahead = np.roll(corners, -1, axis=0) - corners
    inward = np.column_stack((-ahead[:, 1], ahead[:, 0])) / np.linalg.norm(ahead, axis=1)[:, None]
    depth = flat @ inward.T - (corners * inward).sum(axis=1)
    reach = 0.5 * cell * np.abs(inward).sum(axis=1)  # of a square, along each normal
    share = np.where((depth >= reach * (1.0 - _ROUNDING)).all(axis=1), 1.0, 0.0)
    middle = flat.astype(float).copy()
    square = 0.5 * cell * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for index in np.flatnonzero((share == 0.0) & (depth > -reach).all(axis=1)).tolist():
        inside = flat[index] + square
        for corner, normal in zip(corners, inward, strict=True):
            inside = _clipped(inside, (inside - corner) @ normal)
        area, centre = _area(inside - flat[index])
        if area > _ROUNDING * cell**2:
            share[index], middle[index] = area / cell**2, flat[index] + centre
    return share.reshape(nodes.shape[:-1]), middle.reshape(nodes.shape)


def overlaps(low: float, cell: float, count: int, centres: Vector, edge: float) -> Matrix:
    """(n, count) the part of spans of length `edge` about `centres` (n,) that is in each of `count` spans of a row [m].

    Parameters
    ----------
    low: the middle of the first span of the row.
    cell: length of a span of the row.
    """
    middles = low + cell * np.arange(count)
    least = np.maximum(centres[:, None] - 0.5 * edge, middles - 0.5 * cell)
    most = np.minimum(centres[:, None] + 0.5 * edge, middles + 0.5 * cell)
    return np.asarray(np.maximum(most - least, 0.0) / edge)


def _clipped(corners: Matrix, height: Vector) -> Matrix:
    """(m, 2) the part of a convex polygon (k, 2) in which `height` (k,), given at its corners, is 0 or more."""
    found = []
    for a, b, at_a, at_b in zip(
        corners, np.roll(corners, -1, axis=0), height.tolist(), np.roll(height, -1).tolist(), strict=True
    ):
        if at_a >= 0.0:
            found.append(a)
        if (at_a >= 0.0) != (at_b >= 0.0):
            found.append(a + at_a / (at_a - at_b) * (b - a))
    return np.array(found).reshape(-1, 2)


def _area(corners: Matrix) -> tuple[float, Vector]:
    """The area of a polygon (k, 2) counter-clockwise, and its middle (2,)."""
    if len(corners) < 3:
        return 0.0, np.zeros(2)
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
    area = 0.5 * float(cross.sum())
    if area <= 0.0:
        return 0.0, np.zeros(2)
    return area, ((corners + following) * cross[:, None]).sum(axis=0) / (6.0 * area)
