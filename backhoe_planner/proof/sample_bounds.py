"""Lower bounds of all distances at the samples of a motion; pairs that may be too near are measured.

A distance is at least the distance of balls around the pieces (`Proximity.bounds_unchecked`), and at least the distance
at the sample before, less the travel since then (`Proximity.ways_unchecked`). If d_a and d_b are such bounds, and B is
the travel between the samples, the distance during the motion is at least (d_a + d_b - B) / 2. A pair is therefore
measured if its bound is less than what is to be proven plus half of the longer travel to either side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.site import Proximity

_TOGETHER = 64  # samples; chosen: with thousands of pairs their bounds take a few MB


@dataclass(frozen=True, eq=False)
class SampleMargins:
    """The margins at K consecutive samples; the last sample is also the first of the next ones.

    Attributes
    ----------
    first: the number of the first sample.
    margins: (K, P) margins of all pairs, or lower bounds of them [m]; infinite where an obstacle does not count.
    measured: (K, P) which of these were measured.
    ways: (K - 1, P) the greatest change of each margin from a sample to the next [m].
    """

    first: int
    margins: Matrix
    measured: Flags
    ways: Matrix


def bound_samples(
    proximity: Proximity, time: Vector, q: Matrix, enough: Vector,
    note: Callable[[int, Indices, Vector], Vector | None], *, until: Vector,
) -> Iterator[SampleMargins]:  # fmt: skip
    """The margins of all pairs at the samples; a pair is measured only if its bound is not enough.

    Parameters
    ----------
    proximity: of the machine and the obstacles; it covers the samples.
    time, q: (T,) times [s] and (T, n) joint positions [rad or m] of the samples.
    enough: (P,) the margins that are to be proven at the samples and between them [m].
    note: called with a sample, the pairs (K,) measured there and their margins (K,) [m]; it returns what is
        `enough` from then on, or None to stop.
    until: (T,) for each sample the time by which an obstacle must have appeared to count [s].
    """
    last, count, clusters = len(time) - 1, len(proximity.pairs), slice(proximity.plain, None)
    some_appear = bool(np.any(proximity.appears_at > until[0]))
    lower, known = np.full(count, -np.inf), np.zeros(count, dtype=bool)
    for first in range(0, max(last, 1), _TOGETHER):
        rows = slice(first, min(first + _TOGETHER, last) + 1)
        moments = time[rows].tolist()
        ways = np.array(list(proximity.ways_unchecked(q[rows]))).reshape(len(moments) - 1, count)
        ways += np.diff(time[rows])[:, None] * proximity.speed
        bounds = np.fmax(list(proximity.bounds_unchecked(q[rows])), proximity.floor)
        measured = np.zeros(bounds.shape, dtype=bool)
        measured[0] = known
        floor = np.zeros(bounds.shape)
        floor[:-1] = ways
        np.maximum(floor[1:], ways, out=floor[1:])
        floor *= 0.5
        floor += proximity.clearance
        if some_appear:
            floor[proximity.appears_at > until[rows, None]] = -np.inf
        if len(proximity.clusters):
            expected = proximity.clusters.expect(q[rows], time[rows], needed=(floor + enough)[:, clusters])
            np.fmax(bounds[:, clusters], expected, out=bounds[:, clusters])
        for row, moment in enumerate(moments):
            lower = np.fmax(bounds[row], lower - ways[row - 1] if row else lower)
            pairs = measure_below(proximity, q[first + row], moment, lower, floor[row] + enough)
            bounds[row] = lower
            if len(pairs):
                measured[row, pairs] = True
                lowered = note(first + row, pairs, lower[pairs] - proximity.clearance[pairs])
                if lowered is None:
                    return
                enough = lowered
        known = measured[-1]
        margins = bounds - proximity.clearance
        if some_appear:
            margins[proximity.appears_at > until[rows, None]] = np.inf
        yield SampleMargins(first, margins, measured, ways)


def measure_below(proximity: Proximity, q: Vector, time: float, lower: Vector, floor: Vector) -> Indices:
    """The pairs that were measured at q (n,) and `time` [s]: all that are not known to be at least `floor` (P,) apart.

    `lower` (P,) are the known lower bounds [m]; the measured distances, and better bounds of others, are written there.
    """
    pairs: Indices = (lower < floor).nonzero()[0]
    if not len(pairs):
        return pairs
    if not len(proximity.clusters):
        lower[pairs] = proximity.distances_below_unchecked(pairs, floor[pairs], q, time=time)
        return pairs
    lower[:], measured = proximity.lower_bounds(q, time=time, floor=floor, known=lower)
    return np.asarray(measured.nonzero()[0])
