"""Which configurations keep every distance, found in one compiled call, so that coal is hardly ever needed.

Every piece of a link is within one ball, and within a few smaller ones; every piece around is within a box in its own
axes, or behind a face. If no ball comes within the required distance, the pair keeps it. If one does, the iterations
of Gilbert, Johnson and Keerthi (GJK) continue until a plane between the two pieces proves that the pair keeps the
distance, or a point of each piece proves that it does not. The first guess is the plane across the direction of the
nearest ball, and for two pieces of the machine the last plane found, as these mostly turn little against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import Robot, box_around, chain_factors, covering_balls, self_pieces
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled

# for one piece; chosen: with 16 of them no fewer configurations are in doubt, and as bounds of distances and ways more
# leave fewer pairs to be measured, and take longer
_MOST_BALLS = 4
_ROUNDING = 1e-9  # m: chosen far above the rounding of sums of a few products, and far below any clearance
_HALF_SPACE = -1.0  # in place of the half edges of a box


class CoveredLinks(NamedTuple):
    """The pieces of a machine, as arguments of `first_not_apart`, and the corners and radius of each."""

    factors: Matrix
    slides: Vector
    joint: Indices
    coarse: Matrix
    starts: Indices
    fine: Matrix
    corners: list[Matrix]
    radius: list[float]


@lru_cache(maxsize=8)
def covered_links(robot: Robot) -> CoveredLinks:
    """The pieces of `self_pieces` with their balls; computed once for a machine."""
    pieces = [own.piece for own in self_pieces(robot)]
    balls = [[covering_balls(piece, most=most) for piece in pieces] for most in (1, _MOST_BALLS)]
    coarse, fine = ([np.column_stack((x, np.full(len(x), radius))) for x, radius in level] for level in balls)
    return CoveredLinks(
        chain_factors(robot), robot.prismatic.astype(float),
        np.array([own.joint for own in self_pieces(robot)], dtype=np.intp),
        np.vstack(coarse), _starts(fine), np.vstack(fine), [piece.hull for piece in pieces],
        [piece.radius for piece in pieces],
    )  # fmt: skip


def _starts(parts: Sequence[Matrix]) -> Indices:
    """(K + 1,) where each part begins among the rows of all, and where the last ends."""
    return np.concatenate(([0], np.cumsum([len(part) for part in parts]))).astype(np.intp)


class CertainlyClear:
    """Decides in which configurations pairs of convex pieces certainly keep their distances, or certainly do not.

    Parameters
    ----------
    bodies: the pieces around, each moved by its own row of `shifts` (B, 3) [m].
    first, second: (P,) the numbers of the pieces of each pair among `self_pieces`; bodies are numbered after these.
    least: (P,) the distance that each must keep [m].
    """

    def __init__(
        self, robot: Robot, bodies: Sequence[shapes.Piece], shifts: Matrix,
        *, first: Indices, second: Indices, least: Vector,
    ) -> None:  # fmt: skip
        pieces = pieces_of_pairs(robot, bodies, shifts, first, second)
        self._arguments = (*pieces, least + _ROUNDING, np.zeros((len(first), 3)))

    def first_not_apart(self, q: Matrix) -> tuple[int, bool]:
        """The first of the configurations `q` (N, n) that is not known to keep all, and whether it certainly does not.

        N if there is none.
        """
        return first_not_apart(q, *self._arguments)

    def pairs_not_apart(self, q: Vector) -> Indices:
        """The pairs that are not known to keep their distances in one configuration (n,), ascending."""
        return pairs_not_apart(q[None], *self._arguments)


def pieces_of_pairs(
    robot: Robot, bodies: Sequence[shapes.Piece], shifts: Matrix, first: Indices, second: Indices
) -> tuple[Any, ...]:
    """Arguments of `first_not_apart` for the machine, `bodies` moved by `shifts` (B, 3) [m], and pairs of these."""
    links = covered_links(robot)
    corners = links.corners + [piece.hull + shift for piece, shift in zip(bodies, shifts, strict=True)]
    return (
        links.factors, links.slides, links.joint, links.coarse, links.starts, links.fine, _starts(corners),
        np.ascontiguousarray(np.vstack(corners).T), np.array(links.radius + [body.radius for body in bodies]),
        np.array([box_of(body, shift) for body, shift in zip(bodies, shifts, strict=True)]).reshape(-1, 15),
        first, second,
    )  # fmt: skip


def box_of(body: shapes.Piece, shift: Vector) -> Vector:
    """(15,) the axes of the box around a body row by row, its middle along them, half edges; see `first_not_apart`."""
    box = box_around(body)
    if box is None:
        normal = body.placement.rotation @ body.shape.n
        face = float(normal @ (body.placement.translation + shift)) + float(body.shape.d)
        return np.concatenate((normal, np.zeros(6), [face, 0.0, 0.0], np.full(3, _HALF_SPACE)))
    R, middle, half, _ = box
    return np.concatenate((R.T.ravel(), R.T @ (middle + shift), half))


@compiled
def first_not_apart(
    q: Matrix, factors: Matrix, slides: Vector, joint: Indices, coarse: Matrix, starts: Indices, fine: Matrix,
    corner_starts: Indices, corners: Matrix, radius: Vector, boxes: Matrix, first: Indices, second: Indices,
    least: Vector, normals: Matrix, /,
) -> tuple[int, bool]:  # fmt: skip
    """The first of `q` (N, n) in which a pair is not known to keep its distance; N if there is none.

    Also whether one of its pairs is certainly nearer. This plain version returns the very first, with nothing
    known of it: only the compiled version is faster than calling coal.

    Parameters
    ----------
    factors, slides: of the chain, see `chain_placements`.
    joint: (K,) that carries each of the machine's pieces; 0 for the base.
    coarse: (K, 4) the centre and radius of a ball around each, in the joint's frame [m].
    starts, fine: (K + 1,), (S, 4) where the smaller balls of each begin, and these balls.
    corner_starts, corners: (K + B + 1,), (3, C) the same for the corners of all pieces; bodies in the world's frame.
    radius: (K + B,) distance from its corners' hull within which a piece is [m].
    boxes: (B, 15) around bodies: axes, middle along them, half edges [m]; if half edges are below 0, a half-space whose
        normal is the first axis and whose face is at the middle along it.
    first, second: (P,) the pieces of each pair.
    least: (P,) the distance that it must keep [m].
    normals: (P, 3) of planes between two of the machine's pieces, in the frame of the second; 0 if none is known.
        Written to.
    """
    return 0, False


@compiled
def pairs_not_apart(
    q: Matrix, factors: Matrix, slides: Vector, joint: Indices, coarse: Matrix, starts: Indices, fine: Matrix,
    corner_starts: Indices, corners: Matrix, radius: Vector, boxes: Matrix, first: Indices, second: Indices,
    least: Vector, normals: Matrix, /,
) -> Indices:  # fmt: skip
    """The pairs that are not known to keep their distances in the one row of `q` (1, n), ascending.

    This plain version returns all pairs. The other arguments are those of `first_not_apart`.
    """
    return np.arange(len(least))
