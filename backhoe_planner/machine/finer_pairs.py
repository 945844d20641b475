"""Pairs of a machine's own pieces that often overlap though what is written does not, as pairs of smaller pieces.

A convex piece around a mesh fills its cavities, and what stands in one, as a forearm in its fork, overlaps it in
all postures. Smaller pieces are the hulls of parts of the mesh's own triangles. Of two pieces the larger one is
halved, its halves are held against the other in turn, and so on, until hulls are apart in every posture looked at
in which the triangles are. Parts that are far from each other stay whole, so that few pairs come of it. They
hold all triangles of both: where none of them touches, no triangle does.

That a link is as a whole inside of another one, no triangle tells. So of each connected part of it one triangle is
found that comes into none of the other's convex pieces while the triangles are apart, and counts against these as
well: it would be in them if the part was inside. Where there is none, the pair of links stays as it is.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine.collision_model import geometry_model
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.shapes import Piece, convex, hull, is_flat, surface_of, thicken, transform

_POSTURES = 200  # looked at; chosen: pairs that are free in a hundredth of them are free in two
_OFTEN = 0.1  # of these postures in which two pieces overlap and their triangles do not, from which on they are divided
_NEAR_PART = 0.3  # of how far the triangles are apart: hulls that are nearer to each other are divided too; chosen
_NEAR = 1e-3  # m: or this, where that is less
_MOST = 3000  # pairs that one pair is divided into; chosen, a PR2's palm in its forearm takes a thousand
_THICKNESS = 4e-5  # m of a flat part of a surface: far below the play of links in use, far above what counts as flat
_SAME_PLACE = 1e-7  # m: corners that are nearer to each other are one; the rounding of an STL file's numbers
_JOINED = 1e-4  # m: parts of a link that are nearer to each other hang together
_WITHIN = 0.9  # of a convex solid, which may be a little larger than what is written: this part of it is within
_CLEAR = 1e-3  # m that a triangle stays away from the pieces of another link, so as to count for its part of a link
_CANDIDATES = 300  # triangles of a connected part among which that one is sought; chosen

Corners = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class FinerPiece:
    """A convex piece around a part of a surface.

    Attributes
    ----------
    parent: index into `Robot.pieces` of the piece that it is a part of.
    corners: of the piece, in the frame of the parent's shape [m].
    """

    parent: int
    corners: Corners


@dataclass(frozen=True)
class FinerPairs:
    """What some pairs of a machine's own pieces are divided into.

    Attributes
    ----------
    divided: those pairs, as indices into `Robot.pieces`.
    finer: the smaller pieces.
    pairs: what takes their place, as indices into `Robot.pieces` followed by `finer`.
    """

    divided: tuple[tuple[int, int], ...]
    finer: tuple[FinerPiece, ...]
    pairs: tuple[tuple[int, int], ...]


def pieces_with(robot: Robot, finer: Sequence[FinerPiece]) -> tuple[LinkPiece, ...]:
    """The pieces of a machine, followed by finer ones."""
    made = []
    for number, one in enumerate(finer):
        parent = robot.pieces[one.parent]
        piece = convex(np.array(one.corners), parent.piece.placement)
        made.append(LinkPiece(f"{parent.name}/{number}", parent.link, parent.joint, piece))
    return (*robot.pieces, *made)


def finer_pairs(robot: Robot, kept: Sequence[tuple[int, int]]) -> FinerPairs:
    """Of the pairs that are `kept`, as indices into `Robot.pieces`, those to be divided, and into what.

    Deterministic: the postures are seeded.
    """
    larger = [pair for pair in kept if any(robot.pieces[index].piece.make_inner for index in pair)]
    if not larger:
        return FinerPairs((), (), ())
    rng = np.random.default_rng(1)
    division = _Division(robot, [robot.random_q(rng) for _ in range(_POSTURES)])
    by_links: defaultdict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
    for pair in division.falsely_overlapping(larger):
        by_links[robot.pieces[pair[0]].link, robot.pieces[pair[1]].link].append(pair)
    for pairs in by_links.values():
        division.divide(pairs, kept)
    return division.result()


class _Part:
    """Some triangles (m, 3, 3) of a piece, or a piece that is not to be divided, in the frame of its shape [m]."""

    def __init__(self, index: int, piece: Piece, triangles: Matrix | None, *, whole: bool = True) -> None:
        self.index, self._piece, self._triangles, self.whole = index, piece, triangles, whole
        self.is_last = triangles is None or len(triangles) == 1
        self.size = 0.0 if triangles is None else float(np.linalg.norm(np.ptp(triangles.reshape(-1, 3), axis=0)))

    @cached_property
    def corners(self) -> Matrix:
        """(k, 3) [m] of the part's hull."""
        assert self._triangles is not None
        points = self._triangles.reshape(-1, 3)
        around = hull(thicken(points, thickness=_THICKNESS) if is_flat(points) else points)
        return np.asarray(around.points[around.vertices])

    @cached_property
    def piece(self) -> Piece:
        """In the frame of the parent's shape."""
        if self.whole:
            return Piece(shape=self._piece.shape, placement=pin.SE3.Identity(), hull=np.zeros((0, 3)))
        return convex(self.corners, pin.SE3.Identity())

    @cached_property
    def halves(self) -> tuple[_Part, _Part]:
        """Both halves, cut across the longest extent."""
        assert self._triangles is not None
        middles = self._triangles.mean(axis=1)
        order = np.argsort(middles[:, np.argmax(np.ptp(middles, axis=0))], kind="stable")
        half = len(order) // 2
        first, second = (
            _Part(self.index, self._piece, self._triangles[rows], whole=False)
            for rows in (order[:half], order[half:])
        )  # fmt: skip
        return first, second


class _Division:
    """The pairs of one machine that were divided so far.

    Parameters
    ----------
    postures: (n,) each, in which the pairs are looked at.
    """

    def __init__(self, robot: Robot, postures: Sequence[Vector]) -> None:
        self._robot, self._gauge = robot, shapes.Gauge()
        self._postures = postures
        data = robot.model.createData()
        self._places: list[list[pin.SE3]] = []  # of every joint, in each posture
        for q in postures:
            pin.forwardKinematics(robot.model, data, q)
            self._places.append([pin.SE3(place) for place in data.oMi])
        self._divided: list[tuple[int, int]] = []
        self._numbers: dict[_Part, int] = {}
        self._pairs: list[tuple[int, int]] = []
        self._wholes: dict[int, _Part] = {}

    def result(self) -> FinerPairs:
        """What was divided."""
        finer = tuple(
            FinerPiece(part.index, tuple((x, y, z) for x, y, z in part.corners.tolist())) for part in self._numbers
        )
        return FinerPairs(tuple(sorted(self._divided)), finer, tuple(self._pairs))

    def falsely_overlapping(self, pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Those of some pairs that often overlap though their triangles do not."""
        robot = self._robot
        model = geometry_model(robot)
        for a, b in pairs:
            model.addCollisionPair(pin.CollisionPair(a, b))
        data, geometry = robot.model.createData(), model.createData()
        count = np.zeros(len(pairs), dtype=int)
        for posture, q in enumerate(self._postures):
            pin.computeCollisions(robot.model, data, model, geometry, q, False)
            for row, result in enumerate(geometry.collisionResults):
                if result.isCollision():
                    first, second = (robot.pieces[index].piece for index in pairs[row])
                    T = self._relative(pairs[row], posture)
                    count[row] += not shapes.within(first, T, second, pin.SE3.Identity(), 0.0)
        return [pair for pair, times in zip(pairs, count.tolist(), strict=True) if times >= _OFTEN * len(self._postures)]

    def divide(self, pairs: Sequence[tuple[int, int]], kept: Sequence[tuple[int, int]]) -> None:
        """Divide `pairs` of pieces of two links, if that no link is inside of the other can be told all the same."""
        free = np.ones(len(self._postures), dtype=bool)
        gaps = {pair: self._gaps_as_written(pair) for pair in pairs}
        for gap in gaps.values():
            free &= gap > 0.0
        divided = {pair: self._halved(pair, gap) for pair, gap in gaps.items()}
        pairs = [pair for pair in pairs if divided[pair] is not None]
        still = set(kept).difference(pairs)
        links = {self._robot.pieces[index].link for pair in pairs for index in pair}
        marks = [] if not links else self._marks(pairs, np.flatnonzero(free), still)
        if marks is None:
            return
        self._divided += pairs
        for pair in pairs:
            for first, second in divided[pair] or ():
                self._pairs.append((self._number(first), self._number(second)))
        for first, second in marks:
            self._pairs.append((self._number(first), self._number(second)))

    def _number(self, part: _Part) -> int:
        if part.whole:
            return part.index
        return self._numbers.setdefault(part, len(self._robot.pieces) + len(self._numbers))

    def _relative(self, pair: tuple[int, int], posture: int) -> pin.SE3:
        """The place of a pair's first shape in the frame of its second one's."""
        first, second = (self._robot.pieces[index] for index in pair)
        places = self._places[posture]
        there = places[second.joint] * second.piece.placement
        return there.actInv(places[first.joint] * first.piece.placement)

    def _gaps_as_written(self, pair: tuple[int, int]) -> Vector:
        """How far apart the inner shapes of a pair are in each posture [m]; not more than 0 where they touch."""
        first, second = (self._robot.pieces[index].piece.inner for index in pair)
        found = np.full(len(self._postures), np.inf)
        if first is not None and second is not None:
            here = transform(np.eye(3), np.zeros(3))
            for posture in range(len(found)):
                T = self._relative(pair, posture)
                found[posture] = self._gauge.measure(first, transform(T.rotation, T.translation), second, here)[0]
        return found

    def _whole(self, index: int) -> _Part:
        if index not in self._wholes:
            piece = self._robot.pieces[index].piece
            self._wholes[index] = _Part(index, piece, surface_of(piece))
        return self._wholes[index]

    def _halved(self, pair: tuple[int, int], gap: Vector) -> list[tuple[_Part, _Part]] | None:
        """The pairs of parts of a pair, which are as far apart as is asked for where it is possible; None of too many.

        gap: how far apart the triangles are in each posture [m].
        """
        if not np.isfinite(gap).all():
            return []  # one of them holds no triangle
        relative = [self._relative(pair, posture) for posture in range(len(gap))]
        near = np.minimum(_NEAR_PART * gap, _NEAR)
        first, second = (self._whole(index) for index in pair)
        found = []
        todo = [(first, second, np.flatnonzero(gap > 0.0))]
        while todo:
            a, b, postures = todo.pop()
            close = postures[[self._distance(a, b, relative[k]) <= near[k] for k in postures.tolist()]]
            if not len(close) or (a.is_last and b.is_last):
                found.append((a, b))
            elif b.is_last or (not a.is_last and a.size >= b.size):
                todo += [(half, b, close) for half in a.halves]
            else:
                todo += [(a, half, close) for half in b.halves]
            if len(found) + len(todo) > _MOST:
                return None
        return found

    def _distance(self, a: _Part, b: _Part, T: pin.SE3) -> float:
        there, here = T * a.piece.placement, b.piece.placement
        return self._gauge.measure(
            a.piece.shape, transform(there.rotation, there.translation),
            b.piece.shape, transform(here.rotation, here.translation),
        )[0]  # fmt: skip

    # --- whether a link is inside of another ----------------------------------------------

    def _marks(
        self, pairs: Sequence[tuple[int, int]], postures: Indices, still: set[tuple[int, int]]
    ) -> list[tuple[_Part, _Part]] | None:
        """Pairs of a triangle of each connected part of two links and a piece of the other one; None if there are none.

        postures: those in which the triangles are apart. still: pairs of pieces that count anyway.
        """
        found: list[tuple[_Part, _Part]] = []
        for side in (0, 1):
            own = self._robot.pieces[pairs[0][side]].link
            other = self._robot.pieces[pairs[0][1 - side]].link
            if all(surface_of(self._robot.pieces[pair[1 - side]].piece) is None for pair in pairs):
                continue  # convex and solid: triangles are seen inside of them
            others = [index for index, piece in enumerate(self._robot.pieces) if piece.link == other]
            for part in self._connected_parts(own):
                mark = self._outside(part, others, postures)
                if mark is None:
                    return None
                for index in others:
                    if ((mark.index, index) if side == 0 else (index, mark.index)) not in still:
                        whole = self._whole(index)
                        found.append((mark, whole) if side == 0 else (whole, mark))
        return found

    def _connected_parts(self, link: str) -> list[list[tuple[int, Matrix]]]:
        """Of a link: for each part that hangs together the triangles of its pieces, by the indices of these."""
        bodies: list[tuple[Piece, list[tuple[int, Matrix]]]] = []
        meshes: list[tuple[int, Matrix]] = []
        for index, own in enumerate(self._robot.pieces):
            if own.link != link:
                continue
            triangles = surface_of(own.piece)
            if triangles is None:
                bodies.append((own.piece, [(index, _within_solid(own.piece))]))
            elif len(triangles):
                meshes.append((index, triangles))
        if meshes:
            placed = [_placed(triangles, self._robot.pieces[index].piece.placement) for index, triangles in meshes]
            body = _joined_by_corners(np.concatenate(placed))
            of_piece = np.split(body, np.cumsum([len(one) for one in placed])[:-1])
            for number in range(int(body.max()) + 1):
                rows = [(index, own[of == number]) for (index, own), of in zip(meshes, of_piece, strict=True)]
                here = np.concatenate([at[of == number] for at, of in zip(placed, of_piece, strict=True)])
                around = convex(here.reshape(-1, 3), pin.SE3.Identity(), surface=here)
                bodies.append((around, [(index, own) for index, own in rows if len(own)]))
        group = _joined_by_touch([piece for piece, _ in bodies])
        return [[one for row in np.flatnonzero(group == number) for one in bodies[row][1]] for number in np.unique(group)]

    def _outside(self, part: Sequence[tuple[int, Matrix]], others: Sequence[int], postures: Indices) -> _Part | None:
        """That triangle of a part of a link that stays furthest out of `others`, pieces of another; None if all are in."""
        best, furthest = None, _CLEAR
        planes = [(other, _planes(self._robot.pieces[other].piece)) for other in others]
        for index, triangles in part:
            step = max(1, len(triangles) * len(part) // _CANDIDATES)
            candidates = triangles[::step]
            own = self._robot.pieces[index].piece
            if own.radius > 0.0:
                continue
            least = np.full(len(candidates), np.inf)
            for other, (normals, offsets) in planes:
                for posture in postures.tolist():
                    T = self._robot.pieces[other].piece.placement * self._relative((index, other), posture)
                    height = (candidates @ T.rotation.T + T.translation) @ normals.T + offsets
                    np.minimum(least, height.min(axis=1).max(axis=1), out=least)
            row = int(np.argmax(least))
            if least[row] > furthest:
                furthest = float(least[row])
                best = _Part(index, own, candidates[row : row + 1], whole=False)
        return best


def _planes(piece: Piece) -> tuple[Matrix, Vector]:
    """Outward normals (f, 3) and offsets (f,) of the faces of a piece, in its body's frame; with its radius [m]."""
    equations = np.unique(np.round(hull(piece.hull).equations, 12), axis=0)
    return equations[:, :3], equations[:, 3] - piece.radius


def _placed(triangles: Matrix, place: pin.SE3) -> Matrix:
    return np.asarray(triangles @ place.rotation.T + place.translation)


def _within_solid(piece: Piece) -> Matrix:
    """(m, 3, 3) triangles within a convex solid, in the frame of its shape [m]."""
    around = hull(piece.hull)
    corners = _WITHIN * around.points[around.simplices] + (1.0 - _WITHIN) * around.points[around.vertices].mean(axis=0)
    back = piece.placement.inverse()
    return _placed(corners, back)


def _joined_by_corners(triangles: Matrix) -> Array:
    """(m,) the connected body of each of some triangles (m, 3, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    places = np.round(triangles.reshape(-1, 3) / _SAME_PLACE).astype(np.int64)
    corner = np.unique(places, axis=0, return_inverse=True)[1].reshape(-1, 3)
    one, other = corner[:, [0, 1]].reshape(-1), corner[:, [1, 2]].reshape(-1)
    count = int(corner.max()) + 1
    graph = coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(count, count))
    body = connected_components(graph, directed=False)[1][corner[:, 0]]
    return np.asarray(np.unique(body, return_inverse=True)[1].reshape(-1))


def _joined_by_touch(bodies: Sequence[Piece]) -> Array:
    """(K,) the lowest number of those bodies that each hangs together with, by their inner shapes in one frame."""
    group = np.arange(len(bodies))
    low = np.array([body.hull.min(axis=0) - body.radius - _JOINED for body in bodies])
    high = np.array([body.hull.max(axis=0) + body.radius for body in bodies])
    for a, b in combinations(range(len(bodies)), 2):
        if group[a] == group[b] or not _meet(low[a], high[a], low[b], high[b]):
            continue
        if shapes.within(bodies[a], bodies[a].placement, bodies[b], bodies[b].placement, _JOINED):
            group[group == max(group[a], group[b])] = min(group[a], group[b])
    return group


def _meet(low: Vector, high: Vector, other_low: Vector, other_high: Vector) -> bool:
    inside: Flags = (low <= other_high) & (other_low <= high)
    return bool(inside.all())
