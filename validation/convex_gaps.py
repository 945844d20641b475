"""Upper bounds on the distances between convex parts, valid in spite of rounding and few iterations.

A gap is the distance between one point of each part, found by Gilbert's iteration over the
corners of their difference, with the least of every simplex by non-negative least squares.
Two points of two solids are never nearer to each other than the solids, so a claim of more
than a gap is refuted. If parts overlap, the gap is 0 or less and does not tell the depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from validation.raw_urdf import RawShape

_ITERATIONS = 80  # a round rim needs about 30, corners fewer than 15
_CONVERGED = 1e-9  # m between the upper and the lower bound
_TOUCHING = 1e-9  # m between two parts that touch
_POINTS_LOOKED_AT, _PARTS_LOOKED_AT, _PAIRS_LOOKED_AT = 12, 4, 5  # of those with the nearest points
_ALL_PAIRS = 100  # of parts, up to which all are measured
_OUTLINE = 16  # points of a link that are measured first
_ROUND = 0.98  # part of a cylinder's radius that the polygon of its points reaches
_HOLLOW = 1.001  # volume of a mesh's hull over its own, from which the mesh counts as hollow
_ONE = np.array([0.0, 0.0, 0.0, 1.0])  # corners whose weights add up to 1 meet at the origin
_SIDES = 16  # of the prism that has the points of a cylinder


@dataclass(frozen=True, eq=False)
class Part:
    """A convex set: all points within `radius` of the hull of `corners`, or of a cylinder.

    Attributes
    ----------
    corners: (k, 3) [m]; for a cylinder the middles of its ends.
    radius: [m]
    disc: radius of a cylinder about the line from end to end [m].
    points: (m, 3) on its surface, for a coarse search [m].
    """

    corners: Matrix
    radius: float
    points: Matrix
    disc: float = 0.0

    def support(self, direction: Vector) -> Vector:
        """The furthest point along `direction`, of the part without its radius."""
        corner = self.corners[int(self.corners.dot(direction).argmax())]
        if self.disc == 0.0:
            return np.asarray(corner)
        axis = self.corners[1] - self.corners[0]
        across = direction - axis * (axis.dot(direction) / axis.dot(axis))
        length = math.sqrt(across.dot(across))
        return np.asarray(corner if length < 1e-12 else corner + (self.disc / length) * across)

    @cached_property
    def middle(self) -> Vector:
        """A point inside."""
        return np.asarray(self.corners.mean(axis=0))


def gap(first: Part, second: Part, rotation: Matrix, translation: Vector) -> float:
    """The distance from `first`, placed in the frame of `second`, to `second` [m]; never below the true one."""
    apart = rotation.dot(first.middle) + translation - second.middle
    corners = [apart]
    radii = first.radius + second.radius
    for _ in range(_ITERATIONS):
        length = math.sqrt(apart.dot(apart))
        if length < _TOUCHING:
            break
        nearest = rotation.dot(first.support(-apart.dot(rotation))) + translation - second.support(apart)
        if length - float(apart.dot(nearest)) / length < _CONVERGED:
            break
        corners.append(nearest)
        system = np.ones((4, len(corners)))
        system[:3] = np.array(corners).T
        try:
            weights, _ = nnls(system, _ONE)
        except RuntimeError:  # cycles if corners nearly coincide
            break
        corners = [corner for corner, weight in zip(corners, weights.tolist(), strict=True) if weight > 0.0]
        weights = weights[weights > 0.0]
        apart = (weights / weights.sum()).dot(corners)
    length = math.sqrt(apart.dot(apart))
    return (0.0 if length < _TOUCHING else length) - radii


class Body:
    """Parts that move together, with a tree of their points."""

    def __init__(self, name: str, parts: list[Part]) -> None:
        self.name, self.parts = name, parts
        self.points = np.vstack([part.points for part in parts])
        self.owner = np.repeat(np.arange(len(parts)), [len(part.points) for part in parts])
        self.fat = np.array([part.radius for part in parts])[self.owner]
        self.tree = cKDTree(self.points)
        self.centre = 0.5 * (self.points.min(axis=0) + self.points.max(axis=0))
        self.reach = float(np.max(np.linalg.norm(self.points - self.centre, axis=1) + self.fat)) / _ROUND

    @cached_property
    def middles(self) -> Matrix:
        """(K, 3) a point of each part [m]."""
        return np.array([part.middle for part in self.parts])

    @cached_property
    def reaches(self) -> Vector:
        """(K,) how far each part reaches from its middle [m]."""
        away = [np.linalg.norm(np.vstack((p.points, p.corners)) - p.middle, axis=1).max() for p in self.parts]
        return np.asarray(np.array(away) / _ROUND + np.array([part.radius for part in self.parts]))

    @cached_property
    def outline(self) -> Body:
        """The same body with fewer points, for a coarse search over many moments."""
        found = Body(self.name, self.parts)
        rows = np.linspace(0, len(self.points) - 1, min(_OUTLINE, len(self.points))).astype(int)
        found.points, found.owner, found.fat = self.points[rows], self.owner[rows], self.fat[rows]
        return found

    def holds(self, point: Vector) -> bool:
        """Whether a point (3,) is in one of the parts."""
        if np.linalg.norm(point - self.centre) > self.reach:
            return False
        alone = Part(point[None, :], 0.0, point[None, :])
        near = [self.parts[index] for index in self.nearest_parts(point, _PARTS_LOOKED_AT)]
        return any(gap(alone, part, np.eye(3), np.zeros(3)) <= 0.0 for part in near)

    def nearest_parts(self, place: Vector, count: int) -> list[int]:
        """The parts with the points nearest to `place` (3,)."""
        found = self.tree.query(place, k=min(count, len(self.points)))[1]
        return list(dict.fromkeys(self.owner[np.atleast_1d(found)].tolist()))


def least_pair(first: Body, second: Body, rotation: Matrix, translation: Vector) -> tuple[float, tuple[int, int]]:
    """The least gap of the parts with the nearest points, and these two parts; never below the true distance."""
    if len(first.parts) * len(second.parts) <= _ALL_PAIRS:
        return _least_of_all(first, second, rotation, translation)
    placed = first.points @ rotation.T + translation
    distance, nearest = second.tree.query(placed)
    order = np.argsort(distance - first.fat - second.fat[nearest])[:_POINTS_LOOKED_AT]
    pairs: dict[tuple[int, int], None] = {}
    for row in order.tolist():
        for part in second.nearest_parts(placed[row], _PARTS_LOOKED_AT):
            pairs[int(first.owner[row]), part] = None
        if len(pairs) >= _PAIRS_LOOKED_AT:
            break
    return min((gap(first.parts[a], second.parts[b], rotation, translation), (a, b)) for a, b in pairs)


def _least_of_all(first: Body, second: Body, rotation: Matrix, translation: Vector) -> tuple[float, tuple[int, int]]:
    """The same over all parts, in the order of the distance of their balls."""
    between = (first.middles @ rotation.T + translation)[:, None] - second.middles[None]
    lower = np.linalg.norm(between, axis=2) - first.reaches[:, None] - second.reaches[None]
    best, where = np.inf, (0, 0)
    for index in np.argsort(lower, axis=None).tolist():
        a, b = divmod(index, len(second.parts))
        if lower[a, b] >= best:
            break
        found = gap(first.parts[a], second.parts[b], rotation, translation)
        if found < best:
            best, where = found, (a, b)
    return best, where


def first_look(first: Body, second: Body, rotations: Array, translations: Matrix, rows: Indices) -> Vector:
    """(K,) distance of the bodies at `rows` (K,) of T placements, to within the spacing of the points."""
    placed = np.einsum("tij,pj->tpi", rotations[rows], first.points) + translations[rows][:, None]
    distance, nearest = second.tree.query(placed.reshape(-1, 3))
    apart = (distance - second.fat[nearest]).reshape(len(rows), -1) - first.fat
    return np.asarray(apart.min(axis=1))


def parts_of(shape: RawShape, *, points: int = 30) -> list[Part]:
    """A shape of a URDF as convex parts in the frame of its link."""
    rotation, translation = shape.rotation, shape.translation
    if shape.kind == "sphere":
        return [ball(translation, shape.size[0])]
    if shape.kind == "box":
        return [block(np.array(shape.size), rotation, translation, points=points)]
    if shape.kind == "cylinder":
        return [drum(shape.size[0], shape.size[1], rotation, translation, points=points)]
    return solid_mesh(shape.vertices @ rotation.T + translation, shape.faces)


def ball(middle: Vector, radius: float) -> Part:
    """A ball."""
    corners = np.array(middle, dtype=float)[None, :]
    return Part(corners, radius, corners)


def rod(start: Vector, end: Vector, radius: float, *, points: int = 30) -> Part:
    """A capsule."""
    share = np.linspace(0.0, 1.0, points)[:, None]
    return Part(np.array([start, end], dtype=float), radius, start + share * (np.asarray(end) - start))


def block(size: Vector, rotation: Matrix, translation: Vector, *, points: int = 30) -> Part:
    """A box."""
    corners = _SIGNS * size / 2.0 @ rotation.T + translation
    return Part(corners, 0.0, np.vstack((corners, spread(corners, _BOX_FACES, points))))


def drum(radius: float, length: float, rotation: Matrix, translation: Vector, *, points: int = 30) -> Part:
    """A cylinder along z."""
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    rim = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
    rings = [np.column_stack((rim, np.full(_SIDES, z))) for z in (-length / 2.0, length / 2.0)]
    levels = np.linspace(-length / 2.0, length / 2.0, max(2, points // 8))
    side = [np.column_stack((rim[::2], np.full(_SIDES // 2, z))) for z in levels]
    ends = np.array([[0.0, 0.0, -length / 2.0], [0.0, 0.0, length / 2.0]])
    placed = np.vstack((*rings, *side, ends)) @ rotation.T + translation
    return Part(ends @ rotation.T + translation, 0.0, placed, disc=radius)


def hull_of(corners: Matrix, faces: Array, *, points: int = 30) -> Part:
    """The convex hull of corners (k, 3), with points on some of its faces (m, 3)."""
    return Part(corners, 0.0, np.vstack((corners, spread(corners, faces, points))))


def is_hollow(vertices: Matrix, faces: Array) -> bool:
    """Whether the convex hull of a mesh is larger than the mesh."""
    mesh = trimesh.Trimesh(vertices, faces)  # merges coincident corners, as in an STL
    return not mesh.is_watertight or bool(mesh.convex_hull.volume > _HOLLOW * abs(mesh.volume))


def solid_mesh(vertices: Matrix, faces: Array) -> list[Part]:
    """A mesh as one solid if it is convex, else as its triangles without the interior."""
    return triangles(vertices, faces) if is_hollow(vertices, faces) else [hull_of(vertices, faces, points=100)]


def triangles(vertices: Matrix, faces: Array, *, points: int = 400) -> list[Part]:
    """Every triangle of a mesh as its own part."""
    each = max(1, points // len(faces))
    return [Part(c, 0.0, np.vstack((c, spread(c, _ONE_FACE, each)))) for c in vertices[faces]]


def spread(corners: Matrix, faces: Array, count: int) -> Matrix:
    """(count, 3) points spread evenly over triangles."""
    a, b, c = (corners[faces[:, column]] for column in range(3))
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    number = np.arange(count) + 0.5
    row = np.searchsorted(area, area[-1] * number / count).clip(max=len(faces) - 1)
    # the generalised golden ratio fills the square evenly; its far half is folded back
    u, v = (0.7548776662 * number) % 1.0, (0.5698402910 * number) % 1.0
    beyond = u + v > 1.0
    u, v = np.where(beyond, 1.0 - u, u), np.where(beyond, 1.0 - v, v)
    return np.asarray(a[row] + u[:, None] * (b - a)[row] + v[:, None] * (c - a)[row])


_SIGNS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ONE_FACE = np.array([[0, 1, 2]])
_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
