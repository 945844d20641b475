"""Triangles for drawing: solids, their clearance shells, tubes along a line.

A solid described by a `Piece` is the convex hull of its points, grown by its radius; its shell is the same with the
clearance added to the radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import Piece
from backhoe_planner.show.drawing.palette import Rgba

_CREASE = np.radians(40.0)  # rad: a sharper edge is drawn sharp; chosen, sides of a 32-sided cylinder meet at 11 deg
_LINE = 0.03  # m: width of a line; chosen, a few pixels from 10 m away
_SPACING = 1.0  # m between lines of a grid, so that lengths can be read
_ROUND = 2  # subdivisions of the ball that grows a hull: its facets cut off 1 % of its volume
_MOST_GROWN = 300_000  # points of a grown hull: that of a finer one is moved along its normals; chosen, some 0.3 s
_FLAT = 1e-4  # m of thickness for a hull that has no volume; chosen, too little to be visible
_SIDES = 8  # of a tube; chosen, a tube is a few pixels wide


@dataclass(frozen=True)
class Facets:
    """Triangles with a normal at every vertex.

    Attributes
    ----------
    vertices, normals: (V, 3) positions [m], and unit vectors.
    faces: (F, 3) indices of vertices.
    rgba: (V, 4) colours in 0..1, or None if all vertices have one colour.
    """

    vertices: Matrix
    normals: Matrix
    faces: NDArray[np.uint32]
    rgba: Matrix | None = None


def solid(piece: Piece, *, rough: bool = False) -> trimesh.Trimesh:
    """The surface of a bounded piece, in the frame of its body; `rough` as in `fattened`."""
    return fattened(piece.hull, piece.radius, rough=rough)


def fattened(points: Matrix, radius: float, *, rough: bool = False) -> trimesh.Trimesh:
    """The convex hull of (k, 3) points [m], grown by `radius` [m] in all directions.

    Parameters
    ----------
    rough: with as few triangles as look round from far away.
    """
    if radius > 0.0:
        ball = _ball(1 if rough else _ROUND + (len(points) <= 2))
        if len(points) == 1:
            return trimesh.Trimesh(points[0] + radius * ball.vertices, ball.faces, process=False)
        hull = _hull(points) if len(points) > 4 else None
        corners = points if hull is None else hull.vertices
        if hull is not None and len(corners) * len(ball.vertices) > _MOST_GROWN:
            return trimesh.Trimesh(corners + radius * hull.vertex_normals, hull.faces, process=False)
        points = (corners[:, None, :] + radius * ball.vertices[None, :, :]).reshape(-1, 3)
    return _hull(points)


@cache
def _ball(subdivisions: int) -> trimesh.Trimesh:
    """A ball of radius 1 around the origin."""
    return trimesh.creation.icosphere(subdivisions=subdivisions)


def _hull(points: Matrix) -> trimesh.Trimesh:
    """The convex hull; a flat one is made a little thick.

    This is what `trimesh.convex.convex_hull` does, which takes ten times as long to turn the triangles outwards.
    """
    if np.linalg.matrix_rank(points - points.mean(axis=0), tol=_FLAT) < 3:
        points = (points[:, None, :] + trimesh.creation.box(extents=np.full(3, 2.0 * _FLAT)).vertices).reshape(-1, 3)
    found = ConvexHull(points, qhull_options="QbB Pp Qt")
    a, b, c = points[found.simplices].transpose(1, 0, 2)
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0.0
    faces = np.where(inwards[:, None], found.simplices[:, ::-1], found.simplices)
    corners, numbers = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[corners], numbers.reshape(-1, 3), process=False)


def facets(mesh: trimesh.Trimesh, crease: float = _CREASE) -> Facets:
    """`mesh` prepared for drawing: smooth where it is round, sharp at its edges.

    Faces that meet at less than the angle `crease` [rad] share their normals at a vertex. This is what
    `trimesh.graph.smooth_shade` does, which is five times slower for thousands of boxes.
    """
    smooth = mesh.face_adjacency[mesh.face_adjacency_angles < crease]
    patch = trimesh.graph.connected_component_labels(smooth, node_count=len(mesh.faces))
    # one number for a vertex in a patch: numpy sorts numbers in a fifth of the time that it takes for pairs
    corners = np.ravel(mesh.faces) * len(mesh.faces) + np.repeat(patch, 3)
    distinct, index = np.unique(corners, return_inverse=True)
    split = trimesh.Trimesh(mesh.vertices[distinct // len(mesh.faces)], index.reshape(-1, 3), process=False)
    return Facets(
        vertices=np.asarray(split.vertices),
        normals=np.asarray(split.vertex_normals),
        faces=np.asarray(split.faces, dtype=np.uint32),
    )


def tube(points: Matrix, radius: float, *, tolerance: float) -> trimesh.Trimesh:
    """A tube of `radius` [m] along a line through (k, 3) points [m].

    Points within `tolerance` [m] of the line between their neighbours are left out.
    """
    line = _simplified(points, tolerance)
    if len(line) < 2:
        return trimesh.creation.icosphere(subdivisions=2, radius=radius).apply_translation(points[0])
    parts = []
    rod = trimesh.creation.cylinder(radius=radius, height=1.0, sections=_SIDES)
    ball = trimesh.creation.icosphere(subdivisions=1, radius=radius)
    for a, b in pairwise(line):
        along = b - a
        length = float(np.linalg.norm(along))
        placed = rod.copy()
        placed.apply_transform(np.diag([1.0, 1.0, length, 1.0]))
        placed.apply_transform(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], along / length))
        placed.apply_translation(0.5 * (a + b))
        parts.append(placed)
    for point in line:
        joint = ball.copy()
        joint.apply_translation(point)
        parts.append(joint)
    return trimesh.util.concatenate(parts)


def _simplified(points: Matrix, tolerance: float) -> Matrix:
    """The points (k, 3) of a line that Douglas and Peucker's algorithm keeps, without repetitions."""
    points = np.asarray(points, dtype=float)
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        a, along = points[first], points[last] - points[first]
        inner = points[first + 1 : last] - a
        square = float(along @ along)
        part = np.clip(inner @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(inner))
        off = np.linalg.norm(inner - part[:, None] * along, axis=1)
        worst = int(np.argmax(off))
        if off[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            stack += [(first, middle), (middle, last)]
    line = points[keep]
    distinct = np.concatenate(([True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-6))
    return np.asarray(line[distinct])


def cells(index: NDArray[np.integer[Any]]) -> NDArray[np.uint32]:
    """Two triangles for every cell of a lattice of vertices, given by their indices (..., rows, columns)."""
    a, b, c, d = index[..., :-1, :-1], index[..., :-1, 1:], index[..., 1:, 1:], index[..., 1:, :-1]
    return np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3).astype(np.uint32)


def sheet(lattice: Matrix, normal: Matrix, rgba: Rgba, strength: Matrix) -> Facets:
    """A level surface through a lattice of points.

    Parameters
    ----------
    lattice: (..., rows, columns, 3) points [m]; there are triangles between neighbouring rows and columns.
    normal: (3,) unit vector of the surface.
    strength: (..., rows, columns) factors of the opacity of `rgba`.
    """
    vertices = lattice.reshape(-1, 3)
    return Facets(
        vertices=vertices,
        normals=np.tile(np.asarray(normal, dtype=float), (len(vertices), 1)),
        faces=cells(np.arange(len(vertices)).reshape(lattice.shape[:-1])),
        rgba=np.column_stack((np.tile(rgba[:3], (len(vertices), 1)), rgba[3] * strength.ravel())),
    )


def grid(centre: Matrix, normal: Matrix, radius: float, rgba: Rgba) -> Facets:
    """Lines in a plane normal to `normal` (3,), one metre apart, up to `radius` [m] from `centre` (3,), fading out.

    In an upright plane, the lines are level and upright.
    """
    along = np.cross([0.0, 0.0, 1.0], normal) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    along = along / np.linalg.norm(along)
    across = np.cross(normal, along)
    stations = np.linspace(-1.0, 1.0, 33)
    strips, strengths = [], []
    for first, second in ((along, across), (across, along)):
        # at multiples of the spacing on the site, so that the lines of parallel planes meet
        middle = float(second @ centre)
        first_line, last_line = np.ceil((middle - radius) / _SPACING), (middle + radius) / _SPACING
        for at in np.arange(first_line, last_line) * _SPACING - middle:
            half = np.sqrt(max(radius * radius - at * at, 0.0))
            line = centre + at * second + half * stations[:, None] * first
            strips.append(np.stack((line - 0.5 * _LINE * second, line + 0.5 * _LINE * second), axis=1))
            away = np.hypot(at, half * stations) / radius
            strengths.append(np.repeat((1.0 - np.clip(away, 0.0, 1.0))[:, None] ** 0.8, 2, axis=1))
    return sheet(np.stack(strips), normal, rgba, np.stack(strengths))


def together(*parts: Facets) -> Facets:
    """Several coloured sets of triangles combined into one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])], dtype=np.uint32)
    return Facets(
        vertices=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)]),
        rgba=np.concatenate([part.rgba for part in parts if part.rgba is not None]),
    )


def disc(centre: Matrix, normal: Matrix, radius: float, rgba: Rgba, *, fade_from: float) -> Facets:
    """A round sheet of `radius` [m] around `centre` (3,), normal to `normal` (3,), fading out towards its rim.

    It has full opacity up to the fraction `fade_from` of the radius.
    """
    rings = radius * np.array([0.0, fade_from, 0.6 * fade_from + 0.4, 0.25 * fade_from + 0.75, 1.0])
    angle = np.linspace(2.0 * np.pi, 0.0, 73)  # rows run outward: in this order the faces look along the normal
    around = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(len(angle))))
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], normal)[:3, :3]
    strength = np.repeat(np.array([1.0, 1.0, 0.6, 0.22, 0.0])[:, None], len(angle), axis=1)
    return sheet(centre + rings[:, None, None] * (around @ turn.T), normal, rgba, strength)
