"""The choice of the pairs to examine in a step: near ones, those without a proven braking path, the stalest one."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.native import compiled

_EMPTY = np.zeros(0)


@compiled
def near_now(
    distance: Vector, within: Vector, pairs: Indices, classes: Indices, odometer: Vector, /
) -> tuple[Indices, Vector, Vector]:
    """Those (K,) of `pairs` (M,) that may be near, their lower bounds (K,) and their odometers' values (K,) [m].

    Parameters
    ----------
    distance: (P,) lower bounds of all pairs plus the odometer's value then [m]; within: (P,) nearer ones count [m].
    classes: (M,) rows of the odometer (C,) for the `pairs`.
    """
    counted = odometer.take(classes)
    lower = distance.take(pairs)
    lower -= counted
    rows = (lower < within.take(pairs)).nonzero()[0]
    if len(rows) == 0:
        return rows, _EMPTY, _EMPTY
    return pairs.take(rows), lower.take(rows), counted.take(rows)


@compiled
def not_proven(
    proven: Vector, required: Vector, pairs: Indices, classes: Indices, odometer: Vector, budget: Vector,
    buffer: float, /,
) -> Indices:  # fmt: skip
    """Those of `pairs` (M,) for which too little of the braking path is proven if it may move by `budget` (C,) [m].

    Parameters
    ----------
    proven: (P,) of all pairs plus the odometer's value then [m]; required: (P,) the distance that must be kept [m].
    classes: (M,) rows of the odometer (C,) for the `pairs`.
    buffer: to be kept beyond the required distance [m].
    """
    left = proven.take(pairs)
    left -= required.take(pairs)
    needed = odometer + budget
    needed += buffer
    return pairs.take((left < needed.take(classes)).nonzero()[0])


@compiled
def margins_now(pairs: Indices, distance: Vector, clearance: Vector, classes: Indices, odometer: Vector, /) -> Vector:
    """(K,) lower bounds of the margins of `pairs` (K,): distance minus clearance [m].

    Parameters
    ----------
    distance: (P,) lower bounds of all pairs plus the odometer's value then [m]; clearance: (P,) of all pairs [m].
    classes: (P,) their rows of the odometer (C,).
    """
    found = distance.take(pairs)
    found -= odometer.take(classes.take(pairs))
    found -= clearance.take(pairs)
    return found


@compiled
def stalest_pair(
    pairs: Indices, distance: Vector, clearance: Vector, renewed: Vector, classes: Indices, odometer: Vector,
    nearest_first: bool, far: bool, rules: tuple[float, ...], /,
) -> int:  # fmt: skip
    """Which of `pairs` (K,) to measure again; -1 for none.

    Parameters
    ----------
    distance, clearance, classes, odometer: as for `margins_now`.
    renewed: (P,) the odometer's value when each pair was last measured [m].
    nearest_first: whether the nearest one comes first, if it is close.
    far: whether a pair is also measured if none is close.
    rules: margin within which a pair is close [m], a length added to its margin [m], and the part of that sum that it
        must have moved.
    """
    if len(pairs) == 0:
        return -1
    close, urgent, least = rules
    margin = margins_now(pairs, distance, clearance, classes, odometer)
    nearest = int(margin.argmin())
    is_close = bool(margin[nearest] <= close)
    if not (is_close or far):
        return -1
    moved = odometer.take(classes.take(pairs)) - renewed.take(pairs)
    moved /= urgent + np.maximum(margin, 0.0)
    row = nearest if is_close and nearest_first and moved[nearest] > least else int(moved.argmax())
    return int(pairs[row]) if moved[row] > least else -1


@compiled
def tightest_pair(
    pairs: Indices, distance: Vector, clearance: Vector, classes: Indices, odometer: Vector, /
) -> tuple[int, float]:
    """Which of `pairs` (K,), K > 0, has the least of `margins_now`, and that margin [m]."""
    margins = margins_now(pairs, distance, clearance, classes, odometer)
    row = int(margins.argmin())
    return int(pairs[row]), float(margins[row])
