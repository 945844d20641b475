"""Proof by a plane that two pieces stay apart on a short motion.

An obstacle's piece is entirely behind a plane at b = min n . y, whose normal n points to it. A link's piece reaches
as far as t = max n . x towards the plane, over its corners x. They are at least b - t apart, and exactly that far
if n is the normal of their nearest points. While the joints move straight by dq, no corner is further than
r . bend(dq) / 8 from the chord of its path (`bend_weights`), and an obstacle moves evenly. So on the whole motion they
are at least as far apart as at the nearer of its ends, less that amount. A link that slides along an obstacle is
thus proven at once, where bounds from how far the link travels have to halve the motion again and again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import pinocchio as pin

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import LinkPiece
from backhoe_planner.machine.shape import shapes

_OFF_UNIT = 1e-9  # by which the square of a normal may be off 1: far above rounding, and 5 nm in 10 m


class Plane(NamedTuple):
    """A plane behind which an obstacle is at the end of a motion.

    Attributes
    ----------
    row, pair: its row among the requested pairs, and the number of the pair.
    normal: (3,) towards the obstacle.
    most: how far the link may reach along the normal [m].
    """

    row: int
    pair: int
    normal: Vector
    most: float


class SeparatingPlanes:
    """Planes between the links' and the obstacles' convex pieces of P pairs.

    Parameters
    ----------
    links: the machine's pieces.
    bodies: the convex pieces around, at their first positions.
    data: of the robot; the reach of a link is evaluated where its joints are.
    first, second: (P,) for each pair, the numbers of the link's piece and of the other one, counted after `links`.
    velocity, appears_at: (P, 3), (P,) of the obstacles [m/s, s].
    """

    def __init__(
        self, links: Sequence[LinkPiece], bodies: Sequence[shapes.Piece], data: pin.Data,
        *, first: Indices, second: Indices, velocity: Matrix, appears_at: Vector,
    ) -> None:  # fmt: skip
        # views of Pinocchio's own memory: they always give the current joint placements
        poses = [(pose.rotation, pose.translation) for pose in data.oMi]
        self._links = [(link.piece.hull, link.piece.radius, *poses[link.joint]) for link in links]
        # lists, because single numbers of them are read
        self._first, self._second = first.tolist(), (second - len(links)).tolist()
        self._bodies, self._appears_at, self._velocity = bodies, appears_at.tolist(), velocity
        self._moves: list[bool] = [bool(one.any()) for one in velocity]

    def end_of_link(self, pair: int, normal: Vector) -> float:
        """The greatest normal . x over the link's piece [m], where the joints are."""
        hull, radius, R, t = self._links[self._first[pair]]
        along = hull.dot(normal.dot(R))
        most: float = along[along.argmax()] + radius + normal.dot(t)
        return most

    def between(
        self, pairs: Indices, least: Vector, near: Indices, normals: Matrix, begun: float, ended: float
    ) -> list[Plane]:
        """The planes of those of `pairs` (K,) whose link is `least` (K,) or more from its plane, where the joints are.

        A pair whose normal is no unit vector has no plane, since lengths along it would not be distances.

        Parameters
        ----------
        near, normals: (N,) pairs, ascending, and (N, 3) the normals at their nearest points.
        begun, ended: when the motion begins and ends [s]; it begins where the joints are.
        """
        found, rows = [], near.searchsorted(pairs).tolist()
        for index, (pair, row, needed) in enumerate(zip(pairs.tolist(), rows, least.tolist(), strict=True)):
            if row == len(near) or near[row] != pair or self._appears_at[pair] > begun or not self._is_around(pair):
                continue
            if not abs(normals[row].dot(normals[row]) - 1.0) <= _OFF_UNIT:
                continue
            normal, face = self._face(self._bodies[self._second[pair]], normals[row])
            speed = since = 0.0
            if self._moves[pair]:
                speed, since = float(normal.dot(self._velocity[pair])), self._appears_at[pair]
            if face + speed * (begun - since) - self.end_of_link(pair, normal) >= needed:
                found.append(Plane(index, pair, normal, face + speed * (ended - since) - needed))
        return found

    def _is_around(self, pair: int) -> bool:
        return pair < len(self._second) and 0 <= self._second[pair] < len(self._bodies)

    @staticmethod
    def _face(piece: shapes.Piece, normal: Vector) -> tuple[Vector, float]:
        """A normal (3,) and the least normal . y over an obstacle's piece [m], at its first position.

        The normal is the given one, unless the piece is a half-space: that is bounded only by its own face.
        """
        if len(piece.hull):
            along = piece.hull.dot(normal)
            return normal, float(along[along.argmin()]) - piece.radius
        out: Vector = piece.placement.rotation.dot(piece.shape.n)
        return -out, -float(out.dot(piece.placement.translation)) - float(piece.shape.d)
