"""The closed bodies of a mesh, whichever way their triangles face, and which points are inside them.

A point is inside if the surface winds around it (Jacobson et al. 2013, "Robust Inside-Outside
Segmentation using Generalized Winding Numbers", eq. 5): w = sum of solid angles / (4 pi). Bodies
may overlap, and some of a file's bodies may be open.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector

_MOST_HOLLOWS = 50  # bodies that are examined for being a hollow of another; if there are more, all are solid; chosen
_WOUND = 0.5  # winding number from which on a point counts as inside: between 0 and 1


class ClosedBodies:
    """The closed bodies of a mesh.

    A body that faces the other way than most of the mesh and is inside others is a hollow in them. Any other
    body that faces the other way is still solid.

    Parameters
    ----------
    vertices: (k, 3) [m]. faces: (m, 3), with shared vertices.
    """

    def __init__(self, vertices: Matrix, faces: Indices) -> None:
        faces, _ = find_closed(faces)
        flipped, body = _facing_alike(faces)
        faces = np.where(flipped[:, None], faces[:, ::-1], faces)
        self.triangles = vertices[faces]
        self._face_outwards(body)

    def __len__(self) -> int:
        return len(self.triangles)

    def contain(self, points: Matrix) -> Flags:
        """(k,) which of the points (k, 3) [m] are inside the bodies; none may be on their surface."""
        return np.array([abs(winding(point, self.triangles)) > _WOUND for point in points], dtype=bool)

    def _face_outwards(self, body: Indices) -> None:
        """Make all triangles face outwards, and those of hollows inwards; `body` (m,) is the body of each."""
        if not len(body):
            return
        middle = self.triangles.reshape(-1, 3).mean(axis=0)
        a, b, c = (self.triangles[:, corner] - middle for corner in range(3))
        volume = np.bincount(body, weights=(a * np.cross(b, c)).sum(axis=1))
        inwards = volume < 0.0
        self._turn(inwards[body])
        turned = np.flatnonzero(inwards != (volume.sum() < 0.0))
        if len(turned) > _MOST_HOLLOWS:
            return
        hollow = np.zeros(len(volume), dtype=bool)
        others = self.triangles[~np.isin(body, turned)]
        for one in turned.tolist():
            corners = self.triangles[body == one].reshape(-1, 3)
            ends = corners[np.concatenate((corners.argmin(axis=0), corners.argmax(axis=0)))]
            hollow[one] = all(winding(end, others) > _WOUND for end in ends)
        self._turn(hollow[body])

    def _turn(self, those: Flags) -> None:
        """Make triangles face the other way."""
        self.triangles = np.where(those[:, None, None], self.triangles[:, ::-1], self.triangles)


def _edges(faces: Indices) -> tuple[Indices, Indices, Indices]:
    """The numbers (3 m,) of the edges of `faces` (m, 3), the face of each, and 1 if it runs upwards, otherwise 0."""
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = ends.min(axis=1), ends.max(axis=1)
    number = np.unique(low * (int(faces.max(initial=0)) + 1) + high, return_inverse=True)[1].reshape(-1)
    return number, np.repeat(np.arange(len(faces)), 3), (ends[:, 0] < ends[:, 1]).astype(np.intp)


def find_closed(faces: Indices) -> tuple[Indices, bool]:
    """The faces (c, 3) of the closed bodies of `faces` (m, 3), and whether all bodies are closed.

    In a closed body every edge belongs to an even number of faces. A face that is given with both of its sides
    counts once. If that leaves a body open, it counts as two faces of bodies that touch there, and both are left out.
    """
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces = faces[first]
    part = _parts(faces)
    closed = ~np.isin(part, part[_has_open_edge(faces)])
    outer = np.flatnonzero(~closed & (count % 2 == 1))
    touching = _parts(faces[outer])
    closes = ~np.isin(touching, touching[_has_open_edge(faces[outer])])
    is_open = np.setdiff1d(part[~closed], part[outer])  # bodies of which nothing is left
    return np.vstack((faces[closed], faces[outer[closes]])), bool(closes.all()) and not len(is_open)


def _parts(faces: Indices) -> Indices:
    """(m,) the connected part to which each of `faces` (m, 3) belongs."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs, count = faces[:, [0, 1, 1, 2]].reshape(-1, 2).T, int(faces.max(initial=0)) + 1
    graph = coo_array((np.ones(pairs.shape[1], dtype=bool), (pairs[0], pairs[1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1][faces[:, 0]], dtype=np.intp)


def _has_open_edge(faces: Indices) -> Flags:
    """(m,) which of `faces` (m, 3) have an open edge; see `open_edges`."""
    return np.asarray(open_edges(faces).reshape(-1, 3).any(axis=1))


def open_edges(faces: Indices) -> Flags:
    """(3 m,) which edges of `faces` (m, 3), three for each, belong to an odd number of faces."""
    number, _, _ = _edges(faces)
    return np.asarray((np.bincount(number) % 2 == 1)[number])


def _facing_alike(faces: Indices) -> tuple[Flags, Indices]:
    """(m,) which faces must be flipped so that neighbours face alike, and (m,) the body of each face."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(faces)
    number, face, way = _edges(faces)
    order = np.argsort(number, kind="stable")
    first = np.flatnonzero(np.diff(number[order], prepend=-1))
    first = first[np.bincount(number) == 2]
    one, other = order[first], order[first + 1]
    differ = (way[one] == way[other]).astype(np.intp)  # neighbours that face alike run along their edge both ways
    # every face is there twice, as it is and flipped, and each is joined to the neighbours that face alike
    a, b = face[one], face[other]
    start, end = np.concatenate((a, a + count)), np.concatenate((b + count * differ, b + count * (1 - differ)))
    graph = coo_array((np.ones(len(start), dtype=bool), (start, end)), shape=(2 * count, 2 * count))
    side = connected_components(graph, directed=False)[1]
    as_is, turned = side[:count], side[count:]
    body = np.unique(np.minimum(as_is, turned), return_inverse=True)[1].reshape(-1)
    flipped = as_is > turned
    most = np.bincount(body, weights=np.where(flipped, 1.0, -1.0)) > 0.0
    return np.asarray(flipped ^ most[body] if count else flipped), body


def winding(point: Vector, triangles: Array) -> float:
    """The winding number of closed `triangles` (m, 3, 3) around a point (3,) [m]."""
    away = triangles - point
    size = np.sqrt((away * away).sum(axis=2))
    a, b, c = away[:, 0], away[:, 1], away[:, 2]
    volume = (a * np.cross(b, c)).sum(axis=1)
    cosines = (a * b).sum(axis=1) * size[:, 2] + (b * c).sum(axis=1) * size[:, 0] + (c * a).sum(axis=1) * size[:, 1]
    return float(np.arctan2(volume, size.prod(axis=1) + cosines).sum() / (2.0 * np.pi))
