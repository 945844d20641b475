"""Distances and gradients of all near pairs in many configurations at once, in one compiled call.

Pairs whose balls are further apart than needed are not measured; for the others, the hulls are compared by the
iterations of Gilbert, Johnson and Keerthi. Hulls that touch are left to coal, and so is everything without a compiler.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.certainly_clear import pieces_of_pairs


class HullDistances:
    """The distances of P pairs of convex pieces.

    Parameters
    ----------
    bodies: the pieces around.
    first, second: (P,) the numbers of the pieces of each pair among `self_pieces`; bodies are numbered after these.
    clearance: (P,) to be kept [m].
    sense: (P, n) +1 for joints that move only the other body, -1 for those that move only the link, 0 otherwise.
    """

    def __init__(
        self, robot: Robot, bodies: Sequence[shapes.Piece],
        *, first: Indices, second: Indices, clearance: Vector, sense: Matrix,
    ) -> None:  # fmt: skip
        shifts = np.zeros((len(bodies), 3))
        pieces = pieces_of_pairs(robot, bodies, shifts, first, second)
        self._arguments, self._sense = (*pieces, clearance, np.zeros((len(first), 3))), sense

    def within(self, q: Matrix, margin: Vector, known: Matrix) -> tuple[Matrix, Indices, Indices, Vector, Matrix]:
        """The pairs within `margin` (N,) [m] beyond their clearance at each of q (N, n); see `distances_within`.

        Parameters
        ----------
        known: (N, P) known lower bounds of the distances [m].
        """
        return distances_within(margin, known, self._sense, q, *self._arguments)


@compiled
def distances_within(
    margin: Vector, known: Matrix, sense: Matrix, q: Matrix, factors: Matrix, slides: Vector, joint: Indices,
    coarse: Matrix, starts: Indices, fine: Matrix, corner_starts: Indices, corners: Matrix, radius: Vector,
    boxes: Matrix, first: Indices, second: Indices, clearance: Vector, normals: Matrix, /,
) -> tuple[Matrix, Indices, Indices, Vector, Matrix]:  # fmt: skip
    """The near pairs in each of N configurations. This plain version leaves all to coal: only compiled it is faster.

    Returns
    -------
    lower: (N, P) lower bounds of all distances [m].
    ends: (N,) for each configuration the end of its rows in the next arrays; -1 if it is left to coal, without rows.
    pair, distance, gradient: (K,), (K,), (K, n) as in `Nearby`, one configuration after the other.

    Parameters
    ----------
    margin, known, sense: (N,), (N, P), (P, n) see `HullDistances`.
    clearance: (P,) of each pair [m]. The other arguments are those of `first_not_apart`.
    """
    none: Indices = np.zeros(0, dtype=np.intp)
    return known.copy(), np.full(len(q), -1, dtype=np.intp), none, np.zeros(0), np.zeros((0, q.shape[1]))
