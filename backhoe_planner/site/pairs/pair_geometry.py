"""The geometry of pairs of convex pieces as Pinocchio measures them, in parts that are built when first needed.

The more pieces a geometry model has, the longer it takes to add one, and a pair takes some
10 kB. So the pieces around a machine are divided into parts, the nearest pieces first. A
part none of whose pairs is measured is never built, and costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine import LinkPiece, ResultTable, Robot, geometry_model
from backhoe_planner.machine.shape import shapes

_PIECES = 250  # in a part; measured: 250 take 0.02 s to add, 3,000 take 11 s


class GeometryPart:
    """Some of the pairs.

    Attributes
    ----------
    pairs: (k,) their numbers, in the order in which `model` has them.
    model, data: Pinocchio's.
    results: of the pairs, numbered as in `model`.
    """

    def __init__(self, robot: Robot, own: pin.GeometryModel, bodies: Sequence[tuple[shapes.Piece, pin.SE3]]) -> None:
        self._robot, self._own = robot, own
        self.model = own.copy()
        for index, (piece, placement) in enumerate(bodies):
            self.model.addGeometryObject(pin.GeometryObject(f"obstacle {index}", 0, 0, placement, piece.shape))
        self.pairs: Indices = np.zeros(0, dtype=np.intp)
        self.data: pin.GeometryData
        self.results: ResultTable
        self._all_placed = False

    def add_pairs(self, pairs: Indices, pieces: Sequence[tuple[int, int]]) -> None:
        """Add the `pairs` (k,), each of two `pieces` of the model; to be called once."""
        self.pairs = pairs
        for first, second in pieces:
            self.model.addCollisionPair(pin.CollisionPair(first, second))
        self.data = self.model.createData()
        for request in self.data.distanceRequests:
            shapes.prepare(request)
        self.results = ResultTable(self.model, self.data)

    def move(self, piece: int, placement: pin.SE3) -> None:
        """Move a piece to another place, from the next `place` on."""
        self.model.geometryObjects[piece].placement = placement
        self._all_placed = False

    def place(self, data: pin.Data) -> None:
        """Place all pieces where the joints of `data` are; pieces that do not move are placed once."""
        model = self._own if self._all_placed else self.model
        pin.updateGeometryPlacements(self._robot.model, data, model, self.data)
        self._all_placed = True


class PairGeometry:
    """All pairs of a machine's pieces with bodies around it, and with each other.

    Parameters
    ----------
    links: the machine's pieces.
    bodies: the convex pieces around, numbered after these.
    distance: (B,) the distances by which they are sorted into parts [m].
    data: of the robot; pairs are measured where its joints are when `place` is called.
    first, second: (P,) the numbers of the pieces of each pair.
    """

    def __init__(
        self, robot: Robot, links: Sequence[LinkPiece], bodies: Sequence[shapes.Piece], distance: Vector,
        *, data: pin.Data, first: Indices, second: Indices,
    ) -> None:  # fmt: skip
        self._robot, self._data, self._bodies = robot, data, bodies
        self._placements = [body.placement for body in bodies]
        self._first, self._second = first, second
        self._own = geometry_model(robot, pieces=links)
        own, few = len(links), len(bodies) <= _PIECES
        order = np.arange(len(bodies)) if few else np.argsort(distance, kind="stable")
        self._members = [order[k : k + _PIECES] for k in range(0, len(bodies), _PIECES)] or [order]
        part_of, place_of = np.zeros(own + len(bodies), dtype=np.intp), np.arange(own + len(bodies))
        for number, members in enumerate(self._members):
            part_of[own + members], place_of[own + members] = number, own + np.arange(len(members))
        self._place_of, self._part_of_body = place_of, part_of
        self._part_of = part_of[second]
        self._pairs = [np.flatnonzero(self._part_of == number) for number in range(len(self._members))]
        slots = np.zeros(len(first), dtype=np.intp)
        for pairs in self._pairs:
            slots[pairs] = np.arange(len(pairs))
        self._slots = slots
        self._made: dict[int, GeometryPart] = {}
        self._placed: set[int] = set()
        self._only = self._part(0) if len(self._members) == 1 else None

    @property
    def is_whole(self) -> bool:
        """Whether all pairs are in one part."""
        return self._only is not None

    def parts_with(self, asked: Flags) -> Iterator[GeometryPart]:
        """The parts that have any of the pairs for which `asked` (P,) is true."""
        for number, pairs in enumerate(self._pairs):
            if asked[pairs].any():
                yield self._part(number)

    def _part(self, number: int) -> GeometryPart:
        if number not in self._made:
            members = self._members[number].tolist()
            bodies = [(self._bodies[body], self._placements[body]) for body in members]
            self._made[number] = part = GeometryPart(self._robot, self._own, bodies)
            pairs = self._pairs[number]
            pieces = zip(self._first[pairs].tolist(), self._place_of[self._second[pairs]].tolist(), strict=True)
            part.add_pairs(pairs, list(pieces))
        return self._made[number]

    def whole(self) -> tuple[pin.GeometryModel, pin.GeometryData]:
        """Pinocchio's geometry model of all pairs, and its data; slow for thousands of pieces."""
        if self._only is not None:
            return self._only.model, self._only.data
        part = GeometryPart(self._robot, self._own, list(zip(self._bodies, self._placements, strict=True)))
        part.add_pairs(np.arange(len(self._first)), list(zip(self._first.tolist(), self._second.tolist(), strict=True)))
        return part.model, part.data

    def move(self, body: int, placement: pin.SE3) -> None:
        """Move one of the bodies around to another place, from the next `place` on."""
        self._placements[body] = placement
        number = int(self._own.ngeoms) + body
        made = self._made.get(int(self._part_of_body[number]))
        if made is not None:
            made.move(int(self._place_of[number]), placement)

    def place(self) -> None:
        """Place all pieces where the joints are now."""
        if self._only is not None:
            self._only.place(self._data)
        else:
            self._placed.clear()

    def measure(self, pair: int) -> Any:
        """Coal's result for a pair."""
        part = self._only or self._placed_part(int(self._part_of[pair]))
        return shapes.measure(part.model, part.data, int(self._slots[pair]))

    def measure_each(self, pairs: Indices) -> Matrix:
        """(K, 10) signed distances, normals and nearest points of `pairs` (K,) [m], see `ResultTable.measure`."""
        if self._only is not None:
            return self._only.results.measure(pairs)
        found = np.empty((len(pairs), ResultTable.COLUMNS))
        for part, rows in self._by_part(pairs):
            found[rows] = part.results.measure(self._slots[pairs[rows]])
        return found

    def distances(self, pairs: Indices) -> Vector:
        """(K,) signed distances of `pairs` (K,) [m]; for a few pairs faster than `measure_each`."""
        if self._only is not None:
            return np.array(shapes.measure_distances(self._only.model, self._only.data, pairs.tolist()))
        return self.measure_each(pairs)[:, 0]

    def _by_part(self, pairs: Indices) -> Iterator[tuple[GeometryPart, Indices]]:
        """The parts that have some of `pairs` (K,), placed, each with the rows of its pairs."""
        numbers = self._part_of[pairs]
        for number in np.unique(numbers).tolist():
            yield self._placed_part(number), (numbers == number).nonzero()[0]

    def measure_all(self) -> Vector:
        """(P,) the signed distances of all pairs [m]."""
        found = np.zeros(len(self._first))
        for number in range(len(self._members)):
            part = self._only or self._placed_part(number)
            found[part.pairs] = part.results.measure_all()
        return found

    def _placed_part(self, number: int) -> GeometryPart:
        part = self._part(number)
        if number not in self._placed:
            part.place(self._data)
            self._placed.add(number)
        return part
