"""Smaller pieces for pairs of a machine's own pieces that often overlap though their shapes as written do not.

A convex piece around a mesh fills its cavities, so a link inside a cavity, such as a forearm in its fork, overlaps
the piece in all configurations. The smaller pieces are the hulls of parts of the mesh's own triangles. The larger of
two pieces is halved, its halves are compared with the other in turn, and so on, until the hulls are apart in every
tested configuration in which the triangles are. Parts that are far from each other stay whole, so that the number of
pairs stays small. The parts contain all triangles of both pieces: if no parts touch, no triangles do.

Triangles cannot show that one link is wholly inside another: `marks_outside` finds triangles that rule this out. If
it finds none, the pair of links stays as it is.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine.collision_model import geometry_model
from backhoe_planner.machine.description.link_shapes import LinkPiece
from backhoe_planner.machine.marks_outside import marks_outside
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.machine.shape.shapes import Piece, convex, hull, is_flat, surface_of, thicken, transform

_POSTURES = 200  # configurations tested; chosen: pairs that are free in a hundredth of them are free in two
_COMMONLY = 0.33  # part of them in which the pieces of two links must overlap; chosen: otherwise there is room enough
_OFTEN = 0.1  # part of them in which only the pieces of these links must overlap for pairs to be divided; chosen
_SOMETIMES = 0.05  # the same for each pair of pieces of these links; chosen
_NEAR_PART = 0.3  # part of the distance of the triangles: hulls that are nearer to each other are divided; chosen
_NEAR = 1e-3  # m: or this, if that is less
_MOST = 3000  # pairs that one pair is divided into; chosen, a PR2's palm in its forearm takes a thousand
_THICKNESS = 4e-5  # m of a flat part of a surface: far below the play of links in use, far above what counts as flat

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
    """The division of some pairs of a machine's own pieces into pairs of smaller pieces.

    Attributes
    ----------
    divided: those pairs, as indices into `Robot.pieces`.
    finer: the smaller pieces.
    pairs: the pairs that replace them, as indices into `Robot.pieces` followed by `finer`.
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
    """The pairs of `kept`, as indices into `Robot.pieces`, that are divided, and what they are divided into.

    Deterministic: the random configurations are seeded.
    """
    larger = [pair for pair in kept if any(robot.pieces[index].piece.make_inner for index in pair)]
    if not larger:
        return FinerPairs((), (), ())
    rng = np.random.default_rng(1)
    division = _Division(robot, [robot.random_q(rng) for _ in range(_POSTURES)])
    for pairs in division.falsely_overlapping(larger):
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
    postures: configurations (n,) in which the pairs are tested.
    """

    def __init__(self, robot: Robot, postures: Sequence[Vector]) -> None:
        self._robot, self._gauge = robot, shapes.Gauge()
        self._postures = postures
        self._divided: list[tuple[int, int]] = []
        self._numbers: dict[_Part, int] = {}
        self._pairs: list[tuple[int, int]] = []
        self._wholes: dict[int, _Part] = {}

    @cached_property
    def _places(self) -> list[list[pin.SE3]]:
        """The placement of every joint in each configuration."""
        model, found = self._robot.model, []
        data = model.createData()
        for q in self._postures:
            pin.forwardKinematics(model, data, q)
            found.append([pin.SE3(place) for place in data.oMi])
        return found

    def result(self) -> FinerPairs:
        """The pairs that were divided, and their smaller pieces."""
        finer = tuple(
            FinerPiece(part.index, tuple((x, y, z) for x, y, z in part.corners.tolist())) for part in self._numbers
        )
        return FinerPairs(tuple(sorted(self._divided)), finer, tuple(self._pairs))

    def falsely_overlapping(self, pairs: Sequence[tuple[int, int]]) -> list[list[tuple[int, int]]]:
        """The pairs of pieces, by links, that overlap while their triangles do not, if their links often do so."""
        robot = self._robot
        model = geometry_model(robot)
        for a, b in pairs:
            model.addCollisionPair(pin.CollisionPair(a, b))
        data, geometry = robot.model.createData(), model.createData()
        of_pairs: Counter[tuple[int, int]] = Counter()
        of_links: Counter[tuple[str, str]] = Counter()
        overlapping: Counter[tuple[str, str]] = Counter()
        for posture, q in enumerate(self._postures):
            if not pin.computeCollisions(robot.model, data, model, geometry, q, False):
                continue
            hit = [pair for pair, result in zip(pairs, geometry.collisionResults, strict=True) if result.isCollision()]
            overlapping.update({self._links(pair) for pair in hit})
            falsely = [pair for pair in hit if not self._touches(pair, posture)]
            of_pairs.update(falsely)
            of_links.update({self._links(pair) for pair in falsely})
        count = len(self._postures)
        found: defaultdict[tuple[str, str], list[tuple[int, int]]] = defaultdict(list)
        for pair in sorted(of_pairs):
            links = self._links(pair)
            is_mended = overlapping[links] >= _COMMONLY * count and of_links[links] >= _OFTEN * count
            if is_mended and of_pairs[pair] >= _SOMETIMES * count:
                found[links].append(pair)
        return list(found.values())

    def _links(self, pair: tuple[int, int]) -> tuple[str, str]:
        return self._robot.pieces[pair[0]].link, self._robot.pieces[pair[1]].link

    def _touches(self, pair: tuple[int, int], posture: int) -> bool:
        """Whether two pieces touch as they are written."""
        first, second = (self._robot.pieces[index].piece for index in pair)
        return shapes.within(first, self._relative(pair, posture), second, pin.SE3.Identity(), 0.0)

    def divide(self, pairs: Sequence[tuple[int, int]], kept: Sequence[tuple[int, int]]) -> None:
        """Divide `pairs` of pieces of two links, if it can still be ruled out that one link is inside the other."""
        free = np.ones(len(self._postures), dtype=bool)
        gaps = {pair: self._gaps_as_written(pair) for pair in pairs}
        for gap in gaps.values():
            free &= gap > 0.0
        divided = {pair: self._halved(pair, gap) for pair, gap in gaps.items()}
        pairs = [pair for pair in pairs if divided[pair] is not None]
        marks = marks_outside(self._robot, pairs, [self._places[posture] for posture in np.flatnonzero(free)])
        if marks is None:
            return
        anyway = set(kept).difference(pairs)
        self._divided += pairs
        for pair in pairs:
            for first, second in divided[pair] or ():
                self._pairs.append((self._number(first), self._number(second)))
        for mark in marks:
            part = _Part(mark.index, self._robot.pieces[mark.index].piece, mark.triangle[None], whole=False)
            for other in mark.others:
                if (mark.index, other) not in anyway and (other, mark.index) not in anyway:
                    numbers = self._number(part), other
                    self._pairs.append(numbers if mark.is_first else numbers[::-1])

    def _number(self, part: _Part) -> int:
        if part.whole:
            return part.index
        return self._numbers.setdefault(part, len(self._robot.pieces) + len(self._numbers))

    def _relative(self, pair: tuple[int, int], posture: int) -> pin.SE3:
        """The placement of a pair's first shape in the frame of its second."""
        first, second = (self._robot.pieces[index] for index in pair)
        places = self._places[posture]
        there = places[second.joint] * second.piece.placement
        return there.actInv(places[first.joint] * first.piece.placement)

    def _gaps_as_written(self, pair: tuple[int, int]) -> Vector:
        """The distance of the inner shapes of a pair in each configuration [m]; 0 or less where they touch."""
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
        """The pairs of parts of a pair, divided until they are far enough apart where possible; None if too many.

        gap: the distance of the triangles in each configuration [m].
        """
        if not np.isfinite(gap).all():
            return []  # one of the pieces has no triangles
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
