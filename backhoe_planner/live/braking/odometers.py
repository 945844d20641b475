"""How a step changes the bounds of all pairs, see `pair_bounds`: by travel, by planes and by proven paths."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.native import compiled


@compiled
def count_travel(
    travel: Matrix, moved: Vector, end_moved: Vector | None, pairs: Indices, bound: Vector, classes: Indices,
    start: Vector, path: Vector, proven: Vector, /,
) -> tuple[Vector, float, float]:  # fmt: skip
    """(C,) how far points of each class moved in a step, the maximum, and the maximum on the braking path [m].

    Both travels are added to the odometers `start` and `path` (C,), and the `bound` of `pairs` goes to `proven` (P,).

    Parameters
    ----------
    travel: (C, n) see `Separation`.
    moved, end_moved: (n,) by how much the joints and the end of the braking path moved [rad or m]; without
        `end_moved` the path is the one before, and nothing is written to `path` and `proven`.
    pairs, bound: (K,) the pairs with a new bound over that path, and the bound [m].
    classes: (P,) rows of the odometers for all pairs.
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
    """Require `pairs` (K,) to keep their proven distance `bound` (K,), up to their clearance [m].

    Parameters
    ----------
    clearance, stands: (P,) of all pairs. The requirement for a static obstacle never decreases.
    required: (P,) output: the distances that they must keep [m].
    """
    kept = np.maximum(required.take(pairs), bound)
    required[pairs] = np.minimum(clearance.take(pairs), np.where(stands.take(pairs), kept, bound))


@compiled
def note_gaps(
    pairs: Indices, lower: Vector, counted: Vector, least: Matrix, clearance: Vector, distance: Vector, /,
) -> tuple[Vector, Vector]:  # fmt: skip
    """(K,), (K,) lower bounds of the distances of `pairs` (K,), from their planes too, and those minus clearance [m].

    Parameters
    ----------
    lower, counted: (K,) the bounds before, and the odometers' present values [m].
    least: (K, S) the least gap of each pair at the samples; the first sample counts [m].
    clearance: (P,) of all pairs [m].
    distance: (P,) output: the bounds plus the odometers' present values [m].
    """
    found = np.maximum(lower, least[:, 0])
    distance[pairs] = counted + found
    return found, found - clearance.take(pairs)
