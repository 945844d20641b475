"""Lower bounds of all distances at the samples of a motion; what may be too near is measured.

A distance is at least what balls around the pieces leave (`Proximity.bounds_unchecked`), and what it was at the sample
before, less the way from there (`Proximity.ways_unchecked`). Where d_a and d_b are so bounded, and the way between them
is B, the distance on the motion is at least (d_a + d_b - B) / 2: it is measured where its bound is less than what is to
be proven and half of the longer way to either side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.site import Proximity

_TOGETHER = 64  # samples; chosen: what is known of them takes a few MB where there are thousands of pairs


@dataclass(frozen=True, eq=False)
class Stretch:
    """What was found at K samples that follow each other; the last one is the first of the next stretch.

    Attributes
    ----------
    first: the number of the first sample.
    margins: (K, P) of all pairs there, or lower bounds [m]; infinite where an obstacle does not count.
    measured: (K, P) which of these are margins.
    ways: (K - 1, P) how much each margin changes at most from a sample to the next [m].
    """

    first: int
    margins: Matrix
    measured: Flags
    ways: Matrix


def bound_samples(
    proximity: Proximity, time: Vector, q: Matrix, enough: Vector,
    note: Callable[[int, Indices, Vector], Vector | None], *, until: Vector,
) -> Iterator[Stretch]:  # fmt: skip
    """The margins of all pairs at samples, where they are not known to be enough.

    Parameters
    ----------
    proximity: of the machine and the obstacles; it covers the samples.
    time, q: (T,) and (T, n) of the samples [s], and where the joints are [rad or m].
    enough: (P,) the margins that are to be proven at the samples and between them [m].
    note: called with a sample, pairs (K,) that were measured there and their margins (K,) [m]; its answer is what is
        `enough` from then on, or None to end this.
    until: (T,) at a sample an obstacle does not count that has not appeared by then [s].
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
            proximity.clusters.expect(q[rows], time[rows], needed=(floor + enough)[:, clusters])
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
        yield Stretch(first, margins, measured, ways)


def measure_below(proximity: Proximity, q: Vector, time: float, lower: Vector, floor: Vector) -> Indices:
    """The pairs that were measured at q (n,) and `time` [s]: all that are not known to be at least `floor` (P,) apart.

    What is known is `lower` (P,), in which the distances are entered, and better bounds of others [m].
    """
    if not len(proximity.clusters):
        pairs: Indices = (lower < floor).nonzero()[0]
        if len(pairs):
            lower[pairs] = proximity.distances_below_unchecked(pairs, floor[pairs], q, time=time)
        return pairs
    lower[:], measured = proximity.lower_bounds(q, time=time, floor=floor, known=lower)
    return np.asarray(measured.nonzero()[0])
