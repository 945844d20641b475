"""Distances and gradients of all near pairs in many configurations at once, in one compiled call.

Pairs whose balls are further apart than needed are not measured; for the others, the hulls are compared by the
iterations of Gilbert, Johnson and Keerthi. Pairs of hulls that touch are left to coal, and so are all pairs without a
compiler.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.machine.shape import shapes
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.certainly_clear import pieces_of_pairs
from backhoe_planner.site.pairs.nearby import distance_gradients


@dataclass(frozen=True, eq=False)
class NearInEach:
    """The near pairs in each of N configurations, those of one configuration after those of another.

    Attributes
    ----------
    lower: (N, P) lower bounds of all distances [m].
    row: (K,) the configuration of each near pair; it does not decrease.
    pair, distance, gradient: (K,), (K,), (K, n) as in `Nearby`.
    """

    lower: Matrix
    row: Indices
    pair: Indices
    distance: Vector
    gradient: Matrix


class HullDistances:
    """The distances of P pairs of convex pieces.

    Parameters
    ----------
    bodies: the pieces around.
    first, second: (P,) the numbers of the pieces of each pair among `self_pieces`; bodies are numbered after these.
    clearance: (P,) to be kept [m].
    sense: (P, n) +1 for joints that move only the other body, -1 for those that move only the link, 0 otherwise.
    measure: coal's results (K, 10) of pairs (K,) at q (n,), and the joint Jacobians there, see `distance_gradients`.
    """

    def __init__(
        self, robot: Robot, bodies: Sequence[shapes.Piece],
        *, first: Indices, second: Indices, clearance: Vector, sense: Matrix,
        measure: Callable[[Vector, Indices], tuple[Vector, Matrix]],
    ) -> None:  # fmt: skip
        self._clearance, self._measure, self._sense = clearance, measure, sense
        shifts = np.zeros((len(bodies), 3))
        pieces = pieces_of_pairs(robot, bodies, shifts, first, second)
        self._arguments = (*pieces, clearance, np.zeros((len(first), 3)))

    def within(self, q: Matrix, margin: Vector, known: Matrix) -> NearInEach:
        """The pairs within `margin` (N,) [m] beyond their clearance at each of q (N, n).

        Parameters
        ----------
        known: (N, P) known lower bounds of the distances [m].
        """
        found = NearInEach(*distances_within(margin, known, self._sense, q, *self._arguments))
        left = np.isnan(found.distance).nonzero()[0]
        if not len(left):
            return found
        ends = [0, *(np.flatnonzero(np.diff(found.row[left])) + 1).tolist(), len(left)]
        for first, after in pairwise(ends):
            those = left[first:after]
            row = int(found.row[those[0]])
            pairs = found.pair[those]
            results, J = self._measure(q[row], pairs)
            found.distance[those] = found.lower[row, pairs] = results[:, 0]
            found.gradient[those] = distance_gradients(results, J) * self._sense[pairs]
        near = found.distance <= self._clearance[found.pair] + margin[found.row]
        if near.all():
            return found
        return NearInEach(found.lower, found.row[near], found.pair[near], found.distance[near], found.gradient[near])


@compiled
def distances_within(
    margin: Vector, known: Matrix, sense: Matrix, q: Matrix, factors: Matrix, slides: Vector, joint: Indices,
    coarse: Matrix, starts: Indices, fine: Matrix, corner_starts: Indices, corners: Matrix, radius: Vector,
    boxes: Matrix, first: Indices, second: Indices, clearance: Vector, normals: Matrix, /,
) -> tuple[Matrix, Indices, Indices, Vector, Matrix]:  # fmt: skip
    """The near pairs in each of N configurations. This plain version leaves all to coal: only compiled it is faster.

    Returns
    -------
    As `NearInEach`, except that the distance and the gradient of a pair that is left to coal are not a number; it need
    not be near.

    Parameters
    ----------
    margin, known, sense: (N,), (N, P), (P, n) see `HullDistances`.
    clearance: (P,) of each pair [m]. The other arguments are those of `first_not_apart`.
    """
    row, pair = (~(known > clearance + margin[:, None])).nonzero()
    return known.copy(), row, pair, np.full(len(row), np.nan), np.full((len(row), q.shape[1]), np.nan)
