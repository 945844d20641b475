"""What a step does to the bounds of all pairs, see `pair_bounds`: points travel, planes say more, paths are proven."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.native import compiled


@compiled
def count_travel(
    travel: Matrix, moved: Vector, end_moved: Vector | None, pairs: Indices, bound: Vector, classes: Indices,
    start: Vector, path: Vector, proven: Vector, /,
) -> tuple[Vector, float, float]:  # fmt: skip
    """(C,) how far points of each class have come in a step, the most of these, and the most on the braking path [m].

    Both are added to the odometers `start` and `path` (C,), and what is proven of `pairs` is written to `proven` (P,).

    Parameters
    ----------
    travel: (C, n) see `Separation`.
    moved, end_moved: (n,) by how much the joints and the end of the braking path moved [rad or m]; without
        `end_moved` the path is the one before, and nothing is written to `path` and `proven`.
    pairs, bound: (K,) those with a new bound over that path, and the bound [m].
    classes: (P,) rows of the odometers of all pairs.
    """
    moved_by: Vector = travel.dot(np.abs(moved))
    start += moved_by
    most_on_path = 0.0
    if end_moved is not None:
        came = travel.dot(np.abs(end_moved))
        path += came
        most_on_path = float(came[came.argmax()])
        proven[pairs] = bound + path.take(classes.take(pairs))
    return moved_by, float(moved_by[moved_by.argmax()]), most_on_path


@compiled
def keep_proven(
    pairs: Indices, bound: Vector, clearance: Vector, stands: Flags, required: Vector, /,
) -> None:  # fmt: skip
    """Let `pairs` (K,) keep what is proven of them, `bound` (K,), up to their clearance [m].

    Parameters
    ----------
    clearance, stands: (P,) of all pairs. What is required of an obstacle that stands becomes no less.
    required: (P,) what they must keep, written here [m].
    """
    kept = np.maximum(required.take(pairs), bound)
    required[pairs] = np.minimum(clearance.take(pairs), np.where(stands.take(pairs), kept, bound))


@compiled
def note_gaps(
    pairs: Indices, lower: Vector, counted: Vector, least: Matrix, clearance: Vector, distance: Vector, /,
) -> tuple[Vector, Vector]:  # fmt: skip
    """(K,), (K,) lower bounds of the distances of `pairs` (K,), by their planes too, and beyond their clearance [m].

    Parameters
    ----------
    lower, counted: (K,) the bounds before, and what the odometer says [m].
    least: (K, S) the least gap of each at the samples, of which the first counts [m].
    clearance: (P,) of all pairs [m].
    distance: (P,) bounds, and what the odometer had counted, written here [m].
    """
    found = np.maximum(lower, least[:, 0])
    distance[pairs] = counted + found
    return found, found - clearance.take(pairs)
