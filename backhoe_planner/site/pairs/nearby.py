"""The rows of the pairs that are near."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.native import compiled

# columns of a pair's result: a distance, a normal n, and the point p of the link; (n, p x n) consists of
# products of the first with the second columns, the last three of which are subtracted
_NEXT_LAST, _LAST_NEXT = np.array([5, 6, 4, 6, 4, 5]), np.array([3, 1, 2, 2, 3, 1])
_SUMS = np.zeros((9, 6))
_SUMS[:6] = np.eye(6)
_SUMS[6:, 3:] = -np.eye(3)


def as_pairs(pairs: Indices, count: int) -> Indices:
    """`pairs` (K,) if they are numbers of some of `count` pairs; raises InputError if they are not."""
    found = np.asarray(pairs)
    wrong = found.ndim != 1 or found.dtype.kind not in "iu" or ((found < 0) | (found >= count)).any()
    if wrong and found.shape != (0,):
        allowed = f"whole numbers from 0 to {count - 1}"
        raise InputError("are not indices of pairs", key="pairs", found=reprlib.repr(pairs), allowed=allowed)
    return found


def distance_gradients(found: Matrix, J: Matrix) -> Matrix:
    """(K, n) n . J_1 for the results `found` (K, 10) of pairs: how fast each joint moves the link's point along n.

    A point p has the speed n . v + (p x n) . omega along n; so does its witness, which is along n from it.

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


class Lead(NamedTuple):
    """The rule for which margins count because the machine moves: those that it could use up within a time.

    Attributes
    ----------
    v, change: (n,) the joint velocities, and how far they can change to either side next [rad/s or m/s].
    longest: the time [s].
    """

    v: Vector
    change: Vector
    longest: float


def _can_bind(margin: Vector, gradient: Matrix, drift: Vector, v: Vector, change: Vector, longest: float) -> Flags:
    """(K,) which margins (K,) [m] with these gradients (K, n) and drifts (K,) [m/s] count; see `Lead`."""
    rate = np.abs(gradient).dot(change)
    rate -= gradient.dot(v)
    rate -= drift
    rate *= longest
    return np.asarray(margin < rate)


@compiled
def reach_of_lead(
    lower: Vector, travel: Matrix, speed: Vector, clearance: Vector, least: Vector, fastest: Vector, stop: float, /
) -> tuple[Vector, int]:
    """(M,) distance within which pairs count because the machine moves [m], and how many of them may be that near.

    Parameters
    ----------
    lower: (M,) lower bounds of their distances [m].
    travel, speed, clearance: (M, n), (M,), (M,) as in `Proximity`.
    least: (M,) distance within which each counts in any case [m].
    fastest: (n,) the highest speeds that are possible next [rad/s or m/s].
    stop: time in which the machine stops from these [s].
    """
    reach = travel.dot(fastest)
    reach += speed
    reach *= stop
    reach += clearance
    np.maximum(reach, least, out=reach)
    return reach, int(np.count_nonzero(lower <= reach))


@compiled
def pairs_within(pairs: Indices, lower: Vector, reach: Vector, /) -> tuple[Indices, Indices, Vector]:
    """Rows (K,) of those of `pairs` (M,) whose bounds `lower` (M,) are within `reach` (M,), the pairs, their reach."""
    rows = (lower <= reach).nonzero()[0]
    return rows, pairs.take(rows), reach.take(rows)


@compiled
def near_rows(
    measured: Indices, found: Matrix, reach: Vector, clearance: Vector, sense: Matrix, velocity: Matrix | None,
    J: Matrix, margin: float, v: Vector | None, change: Vector | None, longest: float, /,
) -> tuple[Indices, Matrix, Indices, Matrix, Vector, Matrix, Vector]:  # fmt: skip
    """Those of the `measured` pairs (K,) that are near, and the rows of those that count.

    Parameters
    ----------
    found: (K, 10) distance, normal and nearest points of each, see `distance_gradients`.
    reach: (K,) distance within which each is near [m].
    clearance: (P,) of all pairs [m].
    sense: (P, n) +1 for joints that move only the other body, -1 for those that move only the link, 0 otherwise.
    velocity: (P, 3) of the obstacles [m/s]; None if none moves.
    J: (6, n) Pinocchio's joint Jacobians there.
    margin, v, change, longest: beyond that margin [m] only the pairs selected by `Lead` count; all if v is None.

    Returns
    -------
    The near pairs and their results; then for those that count, the pairs, their results, and the margin,
    gradient and drift of `Nearby`.
    """
    rows = (found[:, 0] <= reach).nonzero()[0]
    if len(rows) < len(measured):
        measured, found = measured.take(rows), found.take(rows, axis=0)
    gradient = distance_gradients(found, J)
    gradient *= sense.take(measured, axis=0)
    left = found[:, 0] - clearance.take(measured)
    drift = np.zeros(len(measured)) if velocity is None else np.vecdot(found[:, 1:4], velocity[measured])
    if v is None or change is None or not len(left) or left[left.argmax()] <= margin:
        return measured, found, measured, found, left, gradient, drift
    counts = left <= margin
    counts |= _can_bind(left, gradient, drift, v, change, longest)
    rows = counts.nonzero()[0]
    return (
        measured, found, measured.take(rows), found.take(rows, axis=0),
        left.take(rows), gradient.take(rows, axis=0), drift.take(rows),
    )  # fmt: skip


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
