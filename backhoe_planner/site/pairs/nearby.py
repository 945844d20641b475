"""The rows of the pairs that are near."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass, fields

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.errors import InputError

# columns of what is found of a pair: a distance, a normal n, and the point p of the link; (n, p x n) is made of
# products of the first with the second ones, the last three of which are taken off
_NEXT_LAST, _LAST_NEXT = np.array([5, 6, 4, 6, 4, 5]), np.array([3, 1, 2, 2, 3, 1])
_SUMS = np.zeros((9, 6))
_SUMS[:6] = np.eye(6)
_SUMS[6:, 3:] = -np.eye(3)


def distance_gradients(found: Matrix, J: Matrix) -> Matrix:
    """(K, n) n . J_1 of what was `found` (K, 10) of pairs: by the joints, how fast the link's point moves along n.

    A point p has the speed n . v + (p x n) . omega along n; so has its witness, which lies along n from it.

    Parameters
    ----------
    found: distance, normal n, nearest point p of the link, and the other one, world.
    J: (6, n) Pinocchio's joint Jacobians there.
    """
    parts = np.empty((len(found), 9))
    parts[:, :3] = found[:, 1:4]
    products = found.take(_NEXT_LAST, axis=1)
    products *= found.take(_LAST_NEXT, axis=1)
    parts[:, 3:] = products
    gradients: Matrix = parts.dot(_SUMS.dot(J))
    return gradients


@dataclass(eq=False, slots=True)
class Nearby:
    """The pairs within a distance, one row each, in the order of `Proximity.pairs`; read-only.

    Attributes
    ----------
    pair: (K,) indices into `Proximity.pairs`.
    distance: (K,) signed distance [m], negative inside.
    margin: (K,) distance minus the clearance to be kept [m].
    normal: (K, 3) unit normal from the link to the obstacle, world.
    point_link, point_obstacle: (K, 3) critical point and its witness [m], world.
    gradient: (K, n) derivative of the distance [m/rad].
    drift: (K,) rate at which the obstacle's own motion changes the distance [m/s].
    """

    pair: Indices
    distance: Vector
    margin: Vector
    normal: Matrix
    point_link: Matrix
    point_obstacle: Matrix
    gradient: Matrix
    drift: Vector

    def __len__(self) -> int:
        return len(self.pair)

    def only(self, rows: Flags) -> Nearby:
        """The rows for which `rows` (K,) is true."""
        if np.shape(rows) != (len(self),) or np.asarray(rows).dtype != bool:
            allowed = f"{len(self)} times True or False"
            raise InputError("is not true or false of every row", key="rows", found=reprlib.repr(rows), allowed=allowed)
        rows = np.asarray(rows)
        return Nearby(*(getattr(self, field.name)[rows] for field in fields(self)))
