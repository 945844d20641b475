"""Lower bounds of the distances of all pairs, from earlier measurements.

A pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints moved by dq, less the distance
that an obstacle has moved. So a pair that is provably out of reach is not measured again.

Computing these bounds for every pair at every step takes longer than measuring the few that are near.
So pairs are selected in two steps: those that some posture brings near (`within`), and among these, those that are
near at the machine's present place or a little further (`around`). The others are left alone while a single number
shows that all of them are too far away, which ends when the machine has moved that little further.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.native import compiled

_SKIN = 0.4  # m of travel after which pairs are selected anew; chosen, some ten steps of a quick motion
_NONE: Indices = np.zeros(0, dtype=np.intp)
_LONG = 1e6  # s; chosen, twelve days: no motion takes as long
_SMALL = 400  # pairs; measured: bounding this many takes as long as maintaining a selection of them


class PairSelection(NamedTuple):
    """Some of the pairs, with the data that bounds of their distances need.

    Attributes
    ----------
    margin: all other pairs stay further away than this beyond their clearance, in every posture [m].
    pairs: (M,) their numbers, ascending.
    clearance, travel, speed, appears_at: (M,), (M, n), (M,), (M,) as in `Proximity`; `travel` is column-major, as
        its product with a few joints' motion then takes half the time.
    reach: (M,) the distance within which a pair is within the margin [m].
    """

    margin: float
    pairs: Indices
    clearance: Vector
    travel: Matrix
    speed: Vector
    appears_at: Vector
    reach: Vector


class _Around(NamedTuple):
    """Those pairs of a wider selection that were near when they were selected.

    Attributes
    ----------
    some: the near pairs.
    rows: (M,) their rows in the wider selection.
    wider, lower: that selection, and lower bounds (W,) of its distances at that moment [m].
    q, time: (n,) where and when that was [rad or m, s].
    reach: they were all pairs whose bounds were within this beyond their clearance [m].
    beyond: how much further than their clearance the nearest of all others was [m].
    """

    some: PairSelection
    rows: Indices
    wider: PairSelection
    lower: Vector
    q: Vector
    time: float
    reach: float
    beyond: float


class KnownBounds:
    """Lower bounds of the distances of P pairs, from the last measurement.

    Parameters
    ----------
    clearance, speed, appears_at: (P,) see `Proximity`.
    travel, floor: (P, n), (P,) likewise; see `renew`.
    always: the number of pairs, the last ones, that belong to every selection.

    Attributes
    ----------
    every: the selection of all pairs.
    furthest: (n,) the most that a joint can change any distance [m/rad].
    """

    def __init__(
        self, clearance: Vector, speed: Vector, appears_at: Vector, *, travel: Matrix, floor: Vector, always: int
    ) -> None:
        self._clearance, self._speed, self._appears_at = clearance, speed, appears_at
        self._first_always = len(clearance) - always
        self._fastest = float(speed.max(initial=0.0))
        self._lower = np.full(len(clearance), -np.inf)
        self._q, self._time = np.zeros(travel.shape[1]), 0.0
        # if known: the pairs that were near then, their margins, and the least margin of all others
        self._near: tuple[Indices, Vector, float] | None = None
        self._take(travel, floor)

    def renew(self, travel: Matrix, floor: Vector) -> None:
        """Use `travel` and `floor` from now on, which are no tighter than before; what is known is kept."""
        self._lower = self._of_every(self._q, self._time)
        self._take(travel, floor)

    def _take(self, travel: Matrix, floor: Vector) -> None:
        self._travel, self._floor = travel, floor
        self._some_far = bool((floor > -np.inf).any())
        self.furthest: Vector = travel.max(axis=0, initial=0.0)
        self.every = self._select(np.arange(len(floor)), np.inf)
        self._known = self._within = self.every
        self._around: _Around | None = None
        # the least margin of the pairs that are not among those measured last, at the place of these
        self._others = np.inf

    @property
    def place(self) -> tuple[Vector, float]:
        """(n,) and [s] joints and time of the last measurement."""
        return self._q, self._time

    @property
    def last(self) -> Vector:
        """(M,) the lower bounds that were kept last, for the pairs of that selection [m]; to be read only."""
        return self._lower

    def is_at(self, q: Vector, time: float) -> bool:
        """Whether the last measurement was made at q (n,) and `time`."""
        return self._time == time and self._q.tolist() == q.tolist()

    def within(self, margin: float) -> PairSelection:
        """The pairs that some posture brings within `margin` [m] beyond their clearance."""
        if self._within.margin != margin:
            self._within = self._select((self._floor - self._clearance <= margin).nonzero()[0], margin)
        return self._within

    def around(self, margin: float, reach: float, q: Vector, time: float) -> PairSelection:
        """Some of the pairs `within` the margin, including all that can be near at q (n,) and `time` [s].

        Parameters
        ----------
        reach: the distance beyond the clearance that counts as near, not less than `margin` [m].
        """
        wider, known = self.within(margin), self._around
        if len(wider.pairs) <= _SMALL:
            return wider
        if known is not None and known.wider is wider and known.some is self._known:
            wasteful = known.reach > reach + 2.0 * _SKIN and len(known.rows) > _SMALL
            others = known.beyond - self._way(np.abs(q - known.q), time - known.time)
            if not wasteful and others > reach:
                self._others = others
                return known.some
        lower = self.lower(wider, q, time)
        beyond = lower - wider.clearance
        near = beyond <= reach + _SKIN
        near[np.searchsorted(wider.pairs, self._first_always) :] = True
        rows = near.nonzero()[0]
        some = self._select(wider.pairs[rows], margin)
        others = float(beyond[~near].min(initial=np.inf))
        self._around = _Around(some, rows, wider, lower, q.copy(), time, reach + _SKIN, others)
        self.keep(some, lower[rows], q, time)
        self._others = others
        return some

    def keep(self, some: PairSelection, lower: Vector, q: Vector, time: float) -> None:
        """Keep the lower bounds (M,) of the distances of `some` that were found at q (n,) and `time`.

        Pairs that are `around` a place are kept for that place.
        """
        if some is not self._known:
            self._others = np.inf
        self._known, self._lower, self._q, self._time = some, lower, q.copy(), time
        self._near = None

    def note_near(self, pairs: Indices, left: Vector, beyond: float) -> None:
        """Note that at the last kept place, `pairs` (K,) have the margins `left` (K,) [m].

        All others have at least `beyond` [m].
        """
        self._near = pairs, left, beyond

    def lower(self, some: PairSelection, q: Vector, time: float) -> Vector:
        """(M,) lower bounds of the distances of `some` at q (n,) and `time` [m]."""
        if some is self._known:
            lower = self._after(some, self._lower, self._q, self._time, q, time)
            if some is self.every and self._some_far:
                np.maximum(lower, self._floor, out=lower)
            return lower
        known = self._around
        if known is not None and known.some is self._known and known.wider is some:
            lower = self._after(some, known.lower, known.q, known.time, q, time)
            lower[known.rows] = np.maximum(lower[known.rows], self.lower(known.some, q, time))
            return lower
        every = self._of_every(q, time)
        return every if some is self.every else every[some.pairs]

    def unproven(self, q: Vector, time: float, spare: float, way: Vector | None) -> Indices:
        """The pairs that are not known to keep their clearance and `spare` [m] on a motion.

        The motion is the straight one from the last measurement to q (n,), which ends at `time` [s]. If bounds on how
        much all distances change on it are known already, they are given as `way` (P,) [m].
        """
        some = self._known
        if way is not None and some is self.every:
            return (self._lower - way < self._clearance + spare).nonzero()[0]
        if self._near is not None:
            unproven = unproven_of_near(
                *self._near, self._travel, self._speed, self.furthest, self._fastest,
                self._q, q, time - self._time, spare,
            )  # fmt: skip
            if unproven is not None:
                return unproven
        dq = np.abs(q - self._q)
        if some.margin < spare or (self._others < np.inf and self._others - self._way(dq, time - self._time) < spare):
            some = self.every
        lower = self.lower(some, q, time)
        needed = some.clearance + spare if spare else some.clearance
        return some.pairs[(lower < needed).nonzero()[0]]

    def _of_every(self, q: Vector, time: float) -> Vector:
        """(P,) lower bounds of all distances [m]."""
        if self._known is self.every:
            return self.lower(self.every, q, time)
        known = self._around
        some = known.wider if known is not None and known.some is self._known else self._known
        if some is self.every:
            return np.maximum(self.lower(some, q, time), self._floor)
        lower = self._floor.copy()
        lower[some.pairs] = np.maximum(lower[some.pairs], self.lower(some, q, time))
        return lower

    def _way(self, dq: Vector, dt: float) -> float:
        """The most that any distance changes while the joints move by dq (n,), not negative, in dt [s]."""
        return float(self.furthest.dot(dq)) + self._fastest * abs(dt)

    def _after(self, some: PairSelection, lower: Vector, q_0: Vector, time_0: float, q: Vector, time: float) -> Vector:
        """(M,) the lower bounds that remain of `lower` (M,) after the motion from q_0 (n,) to q (n,)."""
        lower = bounds_after(lower, some.travel, q_0, q)
        if self._fastest:
            lower -= some.speed * np.abs(age(time, some.appears_at) - age(time_0, some.appears_at))
        return lower

    def _select(self, pairs: Indices, margin: float) -> PairSelection:
        travel = np.asfortranarray(self._travel[pairs])
        clearance, speed, appears_at = self._clearance[pairs], self._speed[pairs], self._appears_at[pairs]
        return PairSelection(margin, pairs, clearance, travel, speed, appears_at, clearance + margin)


def age(time: float, appears_at: Vector) -> Vector:
    """(P,) how long ago obstacles appeared at `time` [s]; at most `_LONG` for the machine itself."""
    return np.maximum(time - np.maximum(appears_at, -_LONG), 0.0)


@compiled
def bounds_after(lower: Vector, travel: Matrix, q_0: Vector, q: Vector, /) -> Vector:
    """(M,) what remains of `lower` bounds (M,) [m] of pairs with `travel` (M, n) after a motion from q_0 to q (n,)."""
    return np.asarray(lower - travel.dot(np.abs(q - q_0)))


@compiled
def unproven_of_near(
    pairs: Indices, left: Vector, beyond: float, travel: Matrix, speed: Vector, furthest: Vector, fastest: float,
    q_0: Vector, q: Vector, dt: float, spare: float, /,
) -> Indices | None:  # fmt: skip
    """The pairs that may use up all but `spare` [m] of their margins on the motion from q_0 (n,) to q (n,), in dt [s].

    None if the pairs that were near are not enough to know.

    Parameters
    ----------
    pairs: (K,) those that were near; left: (K,) their margins [m].
    beyond: all other pairs have at least this margin [m].
    travel, speed: (P, n), (P,) of all pairs, as in `Proximity`.
    furthest, fastest: (n,) and the greatest travel and speed of any pair.
    """
    dq = np.abs(q - q_0)
    way = float(furthest.dot(dq)) + fastest * abs(dt) + spare
    if not beyond >= way:
        return None
    if not len(left) or left[left.argmin()] >= way:
        return _NONE
    needed = travel.take(pairs, axis=0).dot(dq)
    if fastest:
        needed += speed[pairs] * abs(dt)
    unproven: Indices = pairs.take((left < (needed + spare if spare else needed)).nonzero()[0])
    return unproven
