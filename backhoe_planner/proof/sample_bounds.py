"""Lower bounds of all distances at the samples of a motion; pairs that may be too near are measured.

A distance is at least the distance of balls around the pieces (`Proximity.bounds_unchecked`), and at least the distance
at the sample before, less the travel since then (`Proximity.ways_unchecked`). If d_a and d_b are such bounds, and B is
the travel between the samples, the distance during the motion is at least (d_a + d_b - B) / 2. A pair is therefore
measured if its bound is less than what is to be proven plus half of the longer travel to either side.

Mostly a motion is far from everything, so that it can be proven clear from some of its samples, with the travel along
all samples in between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.site import Proximity

_TOGETHER = 64  # samples; chosen: with thousands of pairs their bounds take a few MB


@dataclass(frozen=True, eq=False)
class SampleMargins:
    """The margins at K consecutive samples.

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

    @property
    def between(self) -> Matrix:
        """(K - 1, P) lower bounds of the margins from each sample to the next [m]."""
        return np.asarray(0.5 * (self.margins[:-1] + self.margins[1:] - self.ways))


def bound_samples(
    proximity: Proximity, time: Vector, q: Matrix, enough: Vector,
    note: Callable[[int, Indices, Vector], Vector | None], *, until: Vector, stride: int = 1,
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
    stride: if it is more than 1, only each so many samples are looked at first, and then those in between where a
        margin may be less than enough. The others are left out.
    """
    looks = _Looks(proximity, time, q, enough, note, until)
    known, last = looks.unknown, len(time) - 1
    for first in range(0, max(last, 1), stride * _TOGETHER):
        rows = np.arange(first, min(first + stride * _TOGETHER, last) + 1)
        parts = [(rows, known)]
        if stride > 1 and len(rows) > 2:
            at = np.append(np.arange(0, len(rows) - 1, stride), len(rows) - 1)
            some = looks.at(rows[at], looks.ways_along(rows, at), known)
            if some is None:
                return
            parts = [(rows[at[a] : at[b] + 1], some.known(a)) for a, b in _runs(looks.are_doubtful(some.samples))]
            known = some.known(-1)
        for part, at_first in parts:
            for begin in range(0, max(len(part) - 1, 1), _TOGETHER):
                own = part[begin : begin + _TOGETHER + 1]
                found = looks.at(own, looks.ways(own), at_first)
                if found is None:
                    return
                at_first = found.known(-1)
                yield found.samples


class _Known(NamedTuple):
    """What is known at one sample: (P,) lower bounds of the distances [m], and which of them were measured."""

    lower: Vector
    measured: Flags


class _Found(NamedTuple):
    """Margins at samples, and (K, P) lower bounds of all distances there, also to what does not count [m]."""

    samples: SampleMargins
    lower: Matrix

    def known(self, row: int) -> _Known:
        """What is known at a row."""
        return _Known(self.lower[row], self.samples.measured[row])


class _Looks:
    """Looks at samples of one motion; for the parameters see `bound_samples`."""

    def __init__(
        self, proximity: Proximity, time: Vector, q: Matrix, enough: Vector,
        note: Callable[[int, Indices, Vector], Vector | None], until: Vector,
    ) -> None:  # fmt: skip
        self._proximity, self._time, self._q, self._until = proximity, time, q, until
        self._enough, self._note = enough, note
        self._some_appear = bool(np.any(proximity.appears_at > until[0]))

    @property
    def unknown(self) -> _Known:
        """Nothing."""
        count = len(self._proximity.pairs)
        return _Known(np.full(count, -np.inf), np.zeros(count, dtype=bool))

    def ways(self, rows: Indices) -> Matrix:
        """(K - 1, P) the greatest change of each distance from a sample of `rows` (K,) to the next [m]."""
        proximity = self._proximity
        ways = np.array(list(proximity.ways_unchecked(self._q[rows]))).reshape(len(rows) - 1, len(proximity.pairs))
        ways += np.diff(self._time[rows])[:, None] * proximity.speed
        return np.asarray(ways)

    def ways_along(self, rows: Indices, at: Indices) -> Matrix:
        """(K - 1, P) how far each distance changes at most from one of the `rows` at the places `at` (K,) to the next.

        Along all rows in between [m]; a weaker bound than `ways`.
        """
        moved = np.add.reduceat(np.abs(np.diff(self._q[rows], axis=0)), at[:-1])
        passed = np.diff(self._time[rows[at]])
        return np.asarray(moved @ self._proximity.travel.T + passed[:, None] * self._proximity.speed)

    def at(self, rows: Indices, ways: Matrix, known: _Known) -> _Found | None:
        """The margins at the samples `rows` (K,); None if the search is to stop.

        Parameters
        ----------
        ways: (K - 1, P) the greatest change of each distance from one of these samples to the next [m].
        known: at the first of them.
        """
        proximity, time, q = self._proximity, self._time[rows], self._q[rows]
        clusters = slice(proximity.plain, None)
        bounds = np.fmax(list(proximity.bounds_unchecked(q)), proximity.floor)
        measured = np.zeros(bounds.shape, dtype=bool)
        measured[0] = known.measured
        floor = np.zeros(bounds.shape)
        floor[:-1] = ways
        np.maximum(floor[1:], ways, out=floor[1:])
        floor *= 0.5
        floor += proximity.clearance
        if self._some_appear:
            floor[proximity.appears_at > self._until[rows, None]] = -np.inf
        if len(proximity.clusters):
            expected = proximity.clusters.expect(q, time, needed=(floor + self._enough)[:, clusters])
            np.fmax(bounds[:, clusters], expected, out=bounds[:, clusters])
        lower = known.lower
        for row, (number, moment) in enumerate(zip(rows.tolist(), time.tolist(), strict=True)):
            lower = np.fmax(bounds[row], lower - ways[row - 1] if row else lower)
            pairs = measure_below(proximity, q[row], moment, lower, floor[row] + self._enough)
            bounds[row] = lower
            if len(pairs):
                measured[row, pairs] = True
                lowered = self._note(number, pairs, lower[pairs] - proximity.clearance[pairs])
                if lowered is None:
                    return None
                self._enough = lowered
        margins = bounds - proximity.clearance
        if self._some_appear:
            margins[proximity.appears_at > self._until[rows, None]] = np.inf
        return _Found(SampleMargins(int(rows[0]), margins, measured, ways), bounds)

    def are_doubtful(self, samples: SampleMargins) -> Flags:
        """(K - 1,) whether a margin may be less than enough between one of these samples and the next."""
        proven = samples.between >= self._enough
        if self._some_appear:  # something that appears in between counts from then on
            proven &= np.isfinite(samples.margins[:-1]) | ~np.isfinite(samples.margins[1:])
        return np.asarray(~proven.all(axis=1))


def _runs(flags: Flags) -> list[tuple[int, int]]:
    """The first and the one after the last index of each run of true `flags` (K,)."""
    changes = np.flatnonzero(np.diff(flags, prepend=False, append=False)).tolist()
    return list(zip(changes[::2], changes[1::2], strict=True))


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
