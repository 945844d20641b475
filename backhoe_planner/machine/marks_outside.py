"""How to rule out that a part of a link is wholly inside another link, if only triangles are measured.

As long as no triangles touch, a connected part of a link is inside another link as a whole, or not at all. One
triangle of the part, its mark, represents it. The mark is

- a triangle that stays out of all convex pieces of the other link in the configurations in which the triangles are
  apart: it forms a pair with each of these pieces. If the part were inside, its mark would be in them.
- or, such as for a part within a fork, a triangle that is proven to keep off the other link's triangles over the whole
  ranges of the joints between, and that is outside. It is then outside everywhere, and so is the part wherever it
  touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.proven_apart import proven_apart
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.closed_bodies import winding
from backhoe_planner.machine.shape.shapes import Piece, convex, hull, surface_of

_SAME_PLACE = 1e-7  # m: corners that are nearer to each other are one; the rounding of an STL file's numbers
_JOINED = 1e-4  # m: parts of a link that are nearer to each other are connected
_WITHIN = 0.9  # scale of a convex solid, which may be a little larger than as written: so scaled it is surely inside
_CLEAR = 1e-3  # m: distance of a mark from the pieces of another link, so that it blocks no configuration nearby
_CANDIDATES = 300  # triangles of a connected part among which its mark is sought; chosen
_FEW = 20  # number of these that are tested in all configurations; chosen
_FIRST_POSTURES = 10  # number of configurations that select them; chosen
_PROOFS = 3  # triangles for which the proof is tried; chosen: each takes up to a second
_WINDINGS = 20  # configurations in which the winding number of a mark is taken; chosen: an open surface shows in some
_WOUND = 0.5  # winding number from which on a point counts as inside: between 0 and 1

Triangles = list[tuple[int, Matrix]]
"""Triangles (m, 3, 3) in the frames of the shapes of pieces [m], by the pieces' indices."""


@dataclass(frozen=True, eq=False)
class Mark:
    """A triangle of a part of a link, and the pieces of another link that it stays out of.

    Attributes
    ----------
    index: of the piece it belongs to, in `Robot.pieces`.
    triangle: (3, 3) in the frame of that piece's shape [m].
    others: indices of the other link's pieces.
    is_first: whether the triangle belongs to the link that comes first in pairs.
    """

    index: int
    triangle: Matrix
    others: tuple[int, ...]
    is_first: bool


def marks_outside(
    robot: Robot, pairs: Sequence[tuple[int, int]], places: Sequence[Sequence[pin.SE3]]
) -> list[Mark] | None:
    """Marks for two links of which `pairs` of pieces are measured by their triangles; None if a part has none.

    Parameters
    ----------
    pairs: indices into `robot.pieces`, of the same two links in the same order.
    places: placements of every joint in the configurations in which the triangles of these pairs are apart.
    """
    found = []
    for side in (0, 1):
        if all(surface_of(robot.pieces[pair[1 - side]].piece) is None for pair in pairs):
            continue  # these are convex and solid: triangles inside them are noticed
        other = robot.pieces[pairs[0][1 - side]].link
        others = tuple(index for index, piece in enumerate(robot.pieces) if piece.link == other)
        for part in _connected_parts(robot, robot.pieces[pairs[0][side]].link):
            mark = _outside_pieces(robot, part, others, places)
            if mark is not None:
                found.append(Mark(*mark, others, side == 0))
            elif not _never_inside(robot, part, others, places):
                return None
    return found


def _outside_pieces(
    robot: Robot, part: Triangles, others: Sequence[int], places: Sequence[Sequence[pin.SE3]]
) -> tuple[int, Matrix] | None:
    """The triangle of a part of a link that stays furthest out of `others`, pieces of another; None if all enter."""
    best, furthest = None, _CLEAR
    planes = [(robot.pieces[other], *_planes(robot.pieces[other].piece)) for other in others]
    for index, candidates in _some_of(part, _CANDIDATES):
        own, least = robot.pieces[index], np.full(len(candidates), np.inf)
        for number, at in enumerate(places):
            if number == _FIRST_POSTURES:
                few = np.argsort(-least)[:_FEW]
                candidates, least = candidates[few], least[few]
            if not (least > furthest).any():
                break
            for other, normals, offsets in planes:
                T = at[other.joint].actInv(at[own.joint] * own.piece.placement)
                height = _placed(candidates, T) @ normals.T + offsets
                np.minimum(least, height.min(axis=1).max(axis=1), out=least)
        row = int(np.argmax(least))
        if furthest < least[row] < np.inf:
            best, furthest = (index, candidates[row]), float(least[row])
    return best


def _never_inside(robot: Robot, part: Triangles, others: Sequence[int], places: Sequence[Sequence[pin.SE3]]) -> bool:
    """Whether a triangle of a part of a link is proven to be outside another link in every configuration."""
    if not len(places):
        return False
    solid = [robot.pieces[other] for other in others]
    gauge, found = shapes.Gauge(), []
    for index, candidates in _some_of(part, _FEW):
        own = robot.pieces[index]
        for triangle in candidates:
            mark = LinkPiece(own.name, own.link, own.joint, convex(triangle, own.piece.placement))
            gap = min(_gap(gauge, mark, one, at) for at in places for one in solid)
            if gap > 0.0:
                found.append((gap, mark, own.piece.placement.act(triangle.mean(axis=0))))
    lower, upper = robot.finite_range
    for _, mark, point in sorted(found, key=lambda one: -one[0])[:_PROOFS]:
        some = places[:: -(-len(places) // _WINDINGS)]
        there = [at[solid[0].joint].actInv(at[mark.joint]).act(point) for at in some]
        pairs = [(mark, one) if mark.joint > one.joint else (one, mark) for one in solid]
        is_outside = any(not _contain(solid, one) for one in there)  # for a closed surface, then everywhere
        if is_outside and all(proven_apart(robot, pair, lower, upper) for pair in pairs):
            return True
    return False


def _gap(gauge: shapes.Gauge, mark: LinkPiece, other: LinkPiece, at: Sequence[pin.SE3]) -> float:
    """The distance of a mark from the inner shape of another piece, with the joints `at` their placements [m]."""
    if other.piece.inner is None:
        return np.inf
    T_mark, T_other = (at[one.joint] * one.piece.placement for one in (mark, other))
    return gauge.measure(
        mark.piece.shape, shapes.transform(T_mark.rotation, T_mark.translation),
        other.piece.inner, shapes.transform(T_other.rotation, T_other.translation),
    )[0]  # fmt: skip


def _contain(solid: Sequence[LinkPiece], point: Vector) -> bool:
    """Whether the triangles of a link's pieces wind around a `point` (3,) in the frame of its joint [m]."""
    surfaces = [(one.piece.placement, surface_of(one.piece)) for one in solid]
    triangles = [_placed(own, place) for place, own in surfaces if own is not None and len(own)]
    return bool(triangles) and abs(winding(point, np.concatenate(triangles))) > _WOUND


def _some_of(part: Triangles, most: int) -> Triangles:
    """At most about `most` triangles of a part of a link, and at least one of each of its pieces."""
    step = -(-sum(len(triangles) for _, triangles in part) // most)
    return [(index, triangles[::step]) for index, triangles in part]


def _connected_parts(robot: Robot, link: str) -> list[Triangles]:
    """The triangles of each connected part of a link, by pieces."""
    bodies: list[tuple[Piece, Triangles]] = []
    meshes: Triangles = []
    for index, own in enumerate(robot.pieces):
        if own.link != link:
            continue
        triangles = surface_of(own.piece)
        if triangles is None:
            bodies.append((own.piece, [(index, _within_solid(own.piece))]))
        elif len(triangles):
            meshes.append((index, triangles))
    if meshes:
        placed = [_placed(triangles, robot.pieces[index].piece.placement) for index, triangles in meshes]
        body = _joined_by_corners(np.concatenate(placed))
        of_piece = np.split(body, np.cumsum([len(one) for one in placed])[:-1])
        for number in range(int(body.max()) + 1):
            rows = [(index, own[of == number]) for (index, own), of in zip(meshes, of_piece, strict=True)]
            here = np.concatenate([at[of == number] for at, of in zip(placed, of_piece, strict=True)])
            around = convex(here.reshape(-1, 3), pin.SE3.Identity(), surface=here)
            bodies.append((around, [(index, own) for index, own in rows if len(own)]))
    group = _joined_by_touch([piece for piece, _ in bodies])
    return [[one for row in np.flatnonzero(group == number) for one in bodies[row][1]] for number in np.unique(group)]


def _planes(piece: Piece) -> tuple[Matrix, Vector]:
    """Outward normals (f, 3) and offsets (f,) of the faces of a piece, radius included, in its body's frame [m]."""
    equations = np.unique(np.round(hull(piece.hull).equations, 12), axis=0)
    return equations[:, :3], equations[:, 3] - piece.radius


def _placed(triangles: Matrix, place: pin.SE3) -> Matrix:
    return np.asarray(triangles @ place.rotation.T + place.translation)


def _within_solid(piece: Piece) -> Matrix:
    """(m, 3, 3) triangles within a convex solid, in the frame of its shape [m]."""
    around = hull(piece.hull)
    corners = around.points[around.simplices]
    middle = around.points[around.vertices].mean(axis=0)
    return _placed(_WITHIN * corners + (1.0 - _WITHIN) * middle, piece.placement.inverse())


def _joined_by_corners(triangles: Matrix) -> Indices:
    """(m,) the number of the connected body of each of the triangles (m, 3, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    places = np.round(triangles.reshape(-1, 3) / _SAME_PLACE).astype(np.int64)
    corner = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1, 3)
    one, other = corner[:, [0, 1]].reshape(-1), corner[:, [1, 2]].reshape(-1)
    count = int(corner.max()) + 1
    graph = coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(count, count))
    body = connected_components(graph, directed=False)[1][corner[:, 0]]
    return np.asarray(np.unique(body, return_inverse=True)[1].reshape(-1))


def _joined_by_touch(bodies: Sequence[Piece]) -> Indices:
    """(K,) a number for each body, the same for connected ones, judged by their inner shapes in one frame."""
    group = np.arange(len(bodies))
    low = np.array([body.hull.min(axis=0) - body.radius - _JOINED for body in bodies])
    high = np.array([body.hull.max(axis=0) + body.radius for body in bodies])
    for a, b in combinations(range(len(bodies)), 2):
        near = bool(np.all(low[a] <= high[b]) and np.all(low[b] <= high[a]))
        if group[a] == group[b] or not near:
            continue
        if shapes.within(bodies[a], bodies[a].placement, bodies[b], bodies[b].placement, _JOINED):
            group[group == max(group[a], group[b])] = min(group[a], group[b])
    return group
