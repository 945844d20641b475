"""Triangles of what is drawn: solids, their clearance shells, tubes along a line.

A solid that a `Piece` describes is the convex hull of its points, fattened by its
radius; its shell is the same with the clearance added to the radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import ConvexHull, QhullError

from backhoe_planner.machine import Piece

__all__ = ["Facets", "disc", "facets", "fattened", "grid", "solid", "together", "tube"]

Points = NDArray[np.float64]

_CREASE = np.cos(np.radians(40.0))  # a sharper edge is drawn as an edge
_LINE = 0.03  # m: width of a line
_ROUND = 2  # subdivisions of the ball that fattens
_FLAT = 1e-4  # m given to a hull that has no volume


@dataclass(frozen=True)
class Facets:
    """Triangles with a normal at every vertex.

    Attributes
    ----------
    vertices, normals: (V, 3) [m].
    faces: (F, 3) indices.
    rgba: (V, 4) in 0..1, or None where one colour serves all.
    """

    vertices: Points
    normals: Points
    faces: NDArray[np.uint32]
    rgba: Points | None = None


def solid(piece: Piece) -> trimesh.Trimesh:
    """The surface of a bounded piece, in the frame of its body."""
    return fattened(piece.hull, piece.radius)


def fattened(points: Points, radius: float) -> trimesh.Trimesh:
    """The convex hull of (k, 3) points, grown by `radius` [m] to all sides."""
    if radius > 0.0:
        ball = trimesh.creation.icosphere(subdivisions=_ROUND + (len(points) <= 2)).vertices * radius
        corners = points if len(points) < 5 else _hull_points(points)
        points = (corners[:, None, :] + ball[None, :, :]).reshape(-1, 3)
    return _hull_mesh(points)


def _hull_points(points: Points) -> Points:
    try:
        hull = ConvexHull(points)
    except QhullError:
        return points
    return np.asarray(hull.points[hull.vertices])


def _hull_mesh(points: Points) -> trimesh.Trimesh:
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat
        hull = ConvexHull(np.vstack((points - _FLAT, points + _FLAT, points + np.array([_FLAT, -_FLAT, _FLAT]))))
    faces = np.array(hull.simplices)
    corners = hull.points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", across, hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return trimesh.Trimesh(hull.points, faces, process=True)


def facets(mesh: trimesh.Trimesh, rgba: Points | None = None) -> Facets:
    """`mesh` ready to be drawn: smooth where it is round, sharp at its edges.

    Parameters
    ----------
    rgba: (V, 4) colour of every vertex, if they differ.
    """
    faces = np.asarray(mesh.faces)
    corner_vertex = faces.ravel()
    corner_face = np.repeat(np.arange(len(faces)), 3)
    flat = np.asarray(mesh.face_normals)
    weight = np.asarray(mesh.area_faces)
    incidence = csr_matrix(
        (np.ones(len(corner_vertex)), (corner_vertex, corner_face)), shape=(len(mesh.vertices), len(faces))
    )
    # for every corner the faces that share its vertex
    shared = incidence[corner_vertex].tocoo()
    alike = np.einsum("ij,ij->i", flat[corner_face[shared.row]], flat[shared.col]) > _CREASE
    row, col = shared.row[alike], shared.col[alike]
    normals = np.zeros((len(corner_vertex), 3))
    for axis in range(3):
        normals[:, axis] = np.bincount(row, weight[col] * flat[col, axis], minlength=len(corner_vertex))
    length = np.linalg.norm(normals, axis=1)
    lost = length < 1e-12
    normals[lost] = flat[corner_face[lost]]
    normals /= np.where(lost, 1.0, length)[:, None]
    key = np.column_stack((corner_vertex, np.round(normals * 64.0).astype(int)))
    _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Facets(
        vertices=np.asarray(mesh.vertices)[corner_vertex[first]],
        normals=normals[first],
        faces=index.reshape(-1, 3).astype(np.uint32),
        rgba=None if rgba is None else rgba[corner_vertex[first]],
    )


def tube(points: Points, radius: float, *, sides: int = 8, tolerance: float = 0.003) -> trimesh.Trimesh:
    """A tube of `radius` [m] along a line through (k, 3) points.

    Points nearer than `tolerance` [m] to the line between their neighbours are left out.
    """
    line = _simplified(points, tolerance)
    if len(line) < 2:
        return trimesh.creation.icosphere(subdivisions=2, radius=radius).apply_translation(points[0])
    parts = []
    rod = trimesh.creation.cylinder(radius=radius, height=1.0, sections=sides)
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


def _simplified(points: Points, tolerance: float) -> Points:
    """Douglas and Peucker's subset of a line, without repeated points."""
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


def grid(
    centre: Points, normal: Points, radius: float, rgba: tuple[float, float, float, float], *, spacing: float = 1.0
) -> Facets:
    """Lines across `normal` every `spacing` [m], level and upright where the plane is upright, fading to the rim."""
    along = np.cross([0.0, 0.0, 1.0], normal) if abs(normal[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    along = along / np.linalg.norm(along)
    across = np.cross(normal, along)
    stations = np.linspace(-1.0, 1.0, 33)
    vertices, strengths = [], []
    for first, second in ((along, across), (across, along)):
        # on round numbers of the site, so that the lines of parallel planes meet
        middle = float(second @ centre)
        for at in np.arange(np.ceil((middle - radius) / spacing), (middle + radius) / spacing) * spacing - middle:
            half = np.sqrt(max(radius * radius - at * at, 0.0))
            line = centre + at * second + half * stations[:, None] * first
            vertices.append(np.stack((line - 0.5 * _LINE * second, line + 0.5 * _LINE * second), axis=1).reshape(-1, 3))
            away = np.hypot(at, half * stations) / radius
            strengths.append(np.repeat((1.0 - np.clip(away, 0.0, 1.0)) ** 0.8, 2))
    count = 2 * len(stations)
    a = 2 * np.arange(len(stations) - 1)
    strip = np.concatenate((np.column_stack((a, a + 1, a + 3)), np.column_stack((a, a + 3, a + 2))))
    faces = np.concatenate([strip + line * count for line in range(len(vertices))])
    strength = np.concatenate(strengths)
    corners = np.concatenate(vertices)
    return Facets(
        vertices=corners,
        normals=np.broadcast_to(np.asarray(normal, dtype=float), corners.shape).copy(),
        faces=faces.astype(np.uint32),
        rgba=np.column_stack((np.tile(rgba[:3], (len(strength), 1)), rgba[3] * strength)),
    )


def together(*parts: Facets) -> Facets:
    """Several coloured sets of triangles as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    colours = [part.rgba for part in parts if part.rgba is not None]
    return Facets(
        vertices=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        faces=np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]).astype(
            np.uint32
        ),
        rgba=np.concatenate(colours),
    )


def disc(
    centre: Points, normal: Points, radius: float, rgba: tuple[float, float, float, float], *, fade_from: float = 0.45
) -> Facets:
    """A round sheet across `normal` that fades out towards its rim.

    Parameters
    ----------
    fade_from: part of the radius up to which it keeps its full opacity.
    """
    rings = np.array([0.0, fade_from, 0.6 * fade_from + 0.4, 0.25 * fade_from + 0.75, 1.0])
    strength = np.array([1.0, 1.0, 0.6, 0.22, 0.0])
    sides = 72
    angle = 2.0 * np.pi * np.arange(sides) / sides
    around = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(sides)))
    local = (rings[:, None, None] * around[None]).reshape(-1, 3) * radius
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], normal)[:3, :3]
    here, right = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = []
    for ring in range(len(rings) - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.column_stack((a + here, b + here, b + right)), np.column_stack((a + here, b + right, a + right))]
    colours = np.repeat(np.array([[*rgba[:3], rgba[3] * s] for s in strength]), sides, axis=0)
    return Facets(
        vertices=local @ turn.T + centre,
        normals=np.broadcast_to(np.asarray(normal, dtype=float), local.shape).copy(),
        faces=np.vstack(faces).astype(np.uint32),
        rgba=colours,
    )
