"""The corners of the overlap of two convex pieces.

A corner of the overlap of two polytopes is where an edge of one enters or leaves the
other, or is a corner of one inside the other: in both cases an end of an edge of one, cut off by
the faces of the other. The furthest point of the overlap from a line or a point is such a corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.machine.shape.shapes import Piece, hull

_BALL = 100  # corners of the polytope in a ball; its faces are no nearer to the centre than 0.96 radii
_DIGITS = 9  # to which the planes of triangles of one face agree


@dataclass(frozen=True)
class Faces:
    """A convex polytope in the frame of its body.

    Attributes
    ----------
    corners: (k, 3) [m].
    edges: (E, 2) the corners that they join; lines across a face may be among them.
    planes: (F, 4) outward normal and offset of the faces: n . x + d <= 0 inside.
    """

    corners: Matrix
    edges: Array
    planes: Matrix


def faces_of(piece: Piece) -> Faces:
    """A piece as a polytope; a round piece as a polytope inside it, with at least 0.96 of its radius."""
    points = piece.hull
    if piece.prism:
        return _faces_of_prism(points)
    if piece.radius > 0.0:
        points = (points[:, None] + piece.radius * _on_unit_ball()).reshape(-1, 3)
    around = hull(points)
    edges = np.unique(np.sort(around.simplices[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    return Faces(around.points, edges, np.unique(np.round(around.equations, _DIGITS), axis=0))


def _faces_of_prism(corners: Matrix) -> Faces:
    """The polytope of a right prism from the `corners` (2 k, 3) [m] of its rims."""
    low = np.arange(len(corners) // 2)
    following, high = np.roll(low, -1), low + len(low)
    edges = [np.column_stack(ends) for ends in ((low, following), (high, high[following]), (low, high))]
    along = corners[high[0]] - corners[0]
    normals = np.vstack((np.cross(corners[following] - corners[low], along), -along, along))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    on = corners[[*low, 0, high[0]]]
    return Faces(corners, np.vstack(edges), np.column_stack((normals, -np.sum(normals * on, axis=1))))


@cache
def _on_unit_ball() -> Matrix:
    """(100, 3) points spread evenly over the unit sphere: on a spiral, at evenly spaced heights."""
    number = np.arange(_BALL) + 0.5
    height, angle = 1.0 - 2.0 * number / _BALL, np.pi * (1.0 + np.sqrt(5.0)) * number
    around = np.sqrt(1.0 - height**2)
    return np.column_stack((around * np.cos(angle), around * np.sin(angle), height))


def overlap_corners(first: Faces, second: Faces, rotation: Matrix, translation: Matrix) -> Matrix:
    """(m, 3) the corners of the overlap, in the frame of `first` [m]; (0, 3) if there is none.

    Parameters
    ----------
    rotation, translation: (3, 3) and (3,) the placement of `second` in the frame of `first`.
    """
    placed = second.corners @ rotation.T + translation
    normals = second.planes[:, :3] @ rotation.T
    planes = np.column_stack((normals, second.planes[:, 3] - normals @ translation))
    return np.vstack((_cut(first.corners, first.edges, planes), _cut(placed, second.edges, first.planes)))


def _cut(corners: Matrix, edges: Array, planes: Matrix) -> Matrix:
    """(m, 3) the ends of the edges after cutting off what is outside the planes."""
    height = corners @ planes[:, :3].T + planes[:, 3]
    outside = height > 0.0
    edges = edges[~np.any(outside[edges[:, 0]] & outside[edges[:, 1]], axis=1)]
    start, end = height[edges[:, 0]], height[edges[:, 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = start / (start - end)  # the fraction of the edge at which it crosses each plane
    enters = np.where((start > 0.0) & (end <= 0.0), crossing, 0.0).max(axis=1)
    leaves = np.where((start <= 0.0) & (end > 0.0), crossing, 1.0).min(axis=1)
    inside = enters <= leaves
    a, b = corners[edges[inside, 0]], corners[edges[inside, 1]]
    return np.vstack((a + enters[inside, None] * (b - a), a + leaves[inside, None] * (b - a)))
