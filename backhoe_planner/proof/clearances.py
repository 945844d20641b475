"""Proven distances between samples: whether one segment is clear, and the least distances of a whole motion.

On a segment from q_a to q_b, on which the joints move linearly, no point of a link moves further than
some B relative to an obstacle (the obstacle's own travel included; `site.pairs.ways`), so the distance
anywhere on the segment is at least (d_a + d_b - B) / 2. If that bound does not decide, the
segment is halved. Over a whole motion, the segment with the lowest bound is halved first, until no
bound is below the least measured margin by more than `RESOLUTION` (or 2 % of the margin, if that is
more). The result is never above the true distance.
"""

from __future__ import annotations

import heapq

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.motion import Trajectory
from backhoe_planner.proof.sample_bounds import bound_samples, measure_below
from backhoe_planner.site import REPORTED, Obstruction, Proximity

RESOLUTION = 1e-4  # m: how far a proven bound may be below the true least distance; chosen, a tenth of a millimetre
_RESOLUTION_OF_MARGIN = 0.02  # or this part of the margin, if that is more; chosen
AT_CLEARANCE = 1e-5  # m: a pair that is too near by no more than this is at its clearance; chosen, far above rounding
KEPT_WITHIN = RESOLUTION + AT_CLEARANCE  # m: a motion at exactly its clearance counts as keeping it
_EFFORT = (
    200_000  # measurements per obstacle; chosen, so that the search ends on a motion along a wall at its clearance
)
_EFFORT_REFUTED = 2_000  # the same if the motion is already known not to keep its clearance; chosen
TOUCH = 0.5 * RESOLUTION  # m: between samples at exactly its clearance, a path is clear to within this
STEP_ROUNDING = (
    2e-5  # m by which the proof of a motion may fall short; chosen: far below a clearance, far above rounding
)
_TOUCHING_DEPTH = 9  # halvings: 1/512 of a step of 0.02 m moves no point by more than `TOUCH`
_FIRST_LOOKS = 16  # samples between two first measurements; chosen
_STRIDE = 8  # samples to the next one from which a motion is proven clear first; chosen: 16 take as long
_Ends = tuple[float | None, float | None]  # margins at the ends of a segment, None where not measured [m]


def find_clearances(proximity: Proximity, trajectory: Trajectory) -> tuple[Obstruction, ...]:
    """The tightest spot of every obstacle that comes near, and of the machine with itself; tightest margin first.

    The distances are proven lower bounds.

    Parameters
    ----------
    proximity: of the machine and the obstacles.
    trajectory: the motion.
    """
    if not proximity.pairs:
        return ()
    time, q = _with_appearances(trajectory, proximity)
    proximity.cover_unchecked(q)
    owners = np.where(proximity.owner >= 0, proximity.owner, len(proximity.obstacles))
    searches = [_Search(proximity, time, q) for _ in range(len(proximity.obstacles) + 1)]
    least = np.full(len(searches), REPORTED)
    enough = least[owners]

    def note(row: int, pairs: Indices, margins: Vector) -> Vector:
        """(P,) the margins to be proven, after the `margins` (K,) of `pairs` (K,) were measured at a sample."""
        nonlocal enough
        nearer = (margins < least[owners[pairs]]).nonzero()[0].tolist()
        for k in nearer:
            search = searches[owners[pairs[k]]]
            search.note(float(margins[k]), float(time[row]), int(pairs[k]))
            least[owners[pairs[k]]] = search.least
        if nearer:
            enough = np.where(least < REPORTED, _to_prove(least), least)[owners]
        return enough

    # a few measurements tell roughly where each obstacle is nearest; pairs further away are then rarely measured
    firsts = np.arange(0, len(time), _FIRST_LOOKS)
    bounds = _bounds_at(proximity, q[firsts], time[firsts])
    for row, known, pairs in zip(firsts.tolist(), bounds, _nearest(owners, bounds), strict=True):
        moment = float(time[row])
        floor = least[owners[pairs]] + proximity.clearance[pairs]
        counts = (proximity.appears_at[pairs] <= moment) & (known[pairs] < floor)
        pairs, floor = pairs[counts], floor[counts]
        distances = proximity.distances_below_unchecked(pairs, floor, q[row], time=moment)
        note(row, pairs, distances - proximity.clearance[pairs])
        floor = np.where(proximity.appears_at <= moment, enough + proximity.clearance, -np.inf)
        pairs = measure_below(proximity, q[row], moment, known, floor)
        note(row, pairs, known[pairs] - proximity.clearance[pairs])
    for samples in bound_samples(proximity, time, q, enough, note, until=time):
        margins, measured = samples.margins, samples.measured
        lowest = samples.between
        for row, pair in np.argwhere(~(lowest >= enough)).tolist():
            a, b = (float(margins[k, pair]) if measured[k, pair] else None for k in (row, row + 1))
            way = float(samples.ways[row, pair])
            searches[owners[pair]].open(float(lowest[row, pair]), samples.first + row, pair, way, (a, b))
    found = [clearance for search in searches if (clearance := search.finish()) is not None]
    return tuple(sorted(found, key=lambda clearance: clearance.margin))


def _bounds_at(proximity: Proximity, q: Matrix, time: Vector) -> Matrix:
    """(N, P) lower bounds of all distances in configurations q (N, n) at `time` (N,), without measuring [m]."""
    found = np.fmax(list(proximity.bounds_unchecked(q)), proximity.floor)
    if len(proximity.clusters):
        found[:, proximity.plain :] = proximity.clusters.lower_each(q, time)
    return np.asarray(found)


def _nearest(owners: Indices, bounds: Matrix) -> Indices:
    """(N, C) the pair of each obstacle that seems nearest by `bounds` (N, P) [m]."""
    found = []
    for owner in sorted(set(owners.tolist())):
        pairs = np.flatnonzero(owners == owner)
        found.append(pairs[np.argmin(bounds[:, pairs], axis=1)])
    return np.array(found, dtype=np.intp).T


def _to_prove(least: Vector) -> Vector:
    """The margins to be proven if `least` are the least measured margins [m]."""
    return np.asarray(least - np.maximum(RESOLUTION, _RESOLUTION_OF_MARGIN * least))


def _to_prove_of_one(least: float) -> float:
    """`_to_prove` for one number, in a tenth of the time of an array."""
    return least - max(RESOLUTION, _RESOLUTION_OF_MARGIN * least)


class _Search:
    """Best-first search for the least margin to one obstacle over a whole motion.

    Attributes
    ----------
    least: the least measured margin [m].
    """

    def __init__(self, proximity: Proximity, time: Vector, q: Matrix) -> None:
        self._proximity, self._time, self._q = proximity, time, q
        self.least = REPORTED
        self._where = (0.0, 0)  # moment and pair of the least margin
        # (bound, tie-breaker, segment, pair, how much the margin can change on the segment, from, to, margins there):
        # parts 0..1 of a segment
        self._open: list[tuple[float, int, int, int, float, float, float, _Ends]] = []
        self._measured = 0

    def note(self, margin: float, moment: float, pair: int) -> None:
        """Note a margin that was measured."""
        if margin < self.least:
            self.least, self._where = margin, (moment, pair)

    def open(self, bound: float, segment: int, pair: int, way: float, ends: _Ends) -> None:
        """Add a segment on which the margin may be as low as `bound` and changes by at most `way` [m].

        `ends` are the margins at its ends, None if not measured.
        """
        heapq.heappush(self._open, (bound, len(self._open), segment, pair, way, 0.0, 1.0, ends))

    def finish(self) -> Obstruction | None:
        """Halve the segment with the lowest bound until no bound is below what is to be proven.

        If the motion is refuted anyway, or the effort is used up, the result is the lower
        bound that was reached. It is None for an obstacle that never comes near.
        """
        tie = len(self._open)
        while self._open and self._open[0][0] < _to_prove_of_one(self.least):
            if self._measured > (_EFFORT_REFUTED if self.least < -KEPT_WITHIN else _EFFORT):
                break
            _, _, segment, pair, way, a, b, (m_a, m_b) = heapq.heappop(self._open)
            if m_a is None or m_b is None:
                m_a = self._measure(segment, pair, a) if m_a is None else m_a
                m_b = self._measure(segment, pair, b) if m_b is None else m_b
                tie += 1
                heapq.heappush(self._open, (0.5 * (m_a + m_b - way), tie, segment, pair, way, a, b, (m_a, m_b)))
                continue
            middle = 0.5 * (a + b)
            m_m = self._measure(segment, pair, middle)
            half = 0.5 * (b - a) * way
            for start, m_1, m_2 in ((a, m_a, m_m), (middle, m_m, m_b)):
                tie += 1
                bound = 0.5 * (m_1 + m_2 - half)
                end = start + 0.5 * (b - a)
                heapq.heappush(self._open, (bound, tie, segment, pair, way, start, end, (m_1, m_2)))
        proven = _to_prove_of_one(self.least)
        if self.least >= REPORTED and not (self._open and self._open[0][0] < proven):
            return None
        if self._open:
            proven = min(proven, self._open[0][0])
        moment, index = self._where
        tightest = self._proximity.pairs[index]
        return tightest.at(proven + tightest.clearance, time=moment)

    def _measure(self, segment: int, pair: int, part: float) -> float:
        """Margin of a pair at `part` 0..1 of a segment [m]."""
        q = (1.0 - part) * self._q[segment] + part * self._q[segment + 1]
        moment = float((1.0 - part) * self._time[segment] + part * self._time[segment + 1])
        margin = self._proximity.distance_of_unchecked(pair, q, time=moment) - float(self._proximity.clearance[pair])
        self._measured += 1
        self.note(margin, moment, pair)
        return margin


def _with_appearances(trajectory: Trajectory, proximity: Proximity) -> tuple[Vector, Matrix]:
    """The samples of the motion, and one more at every time at which an obstacle appears."""
    moments = {float(t) for t in proximity.appears_at if trajectory.time[0] < t < trajectory.time[-1]}
    moments -= set(trajectory.time.tolist())
    if not moments:
        return trajectory.time, trajectory.q
    time = np.sort(np.concatenate((trajectory.time, list(moments))))
    return time, trajectory.at(time)


def segment_is_clear(
    proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0, dt: float = 0.0, depth: int = 6,
    spare: float = 0.0,
) -> bool:  # fmt: skip
    """Whether every clearance provably holds on one segment.

    Parameters
    ----------
    proximity: of the machine and the obstacles.
    q_a, q_b: (n,) the ends of the segment; the joints move linearly between them.
    time, dt: when the segment begins, and how long it takes [s].
    depth: how often it may be halved.
    spare: distance to be kept in addition to every clearance [m]; negative to allow less.
    """
    if proximity.is_at_unchecked(q_a, time=time):
        # one step of many: usually all but a few pairs are far away
        proximity.cover_unchecked(q_a)
        pairs = proximity.unproven_unchecked(q_b, time=time + dt, spare=spare)
        if len(pairs):
            least = proximity.clearance.take(pairs) + spare
            pairs = pairs[~proximity.stay_apart_unchecked(pairs, least, q_b, time=time + dt)]
        if not len(pairs):
            return True
        way = proximity.travel[pairs].dot(np.abs(q_b - q_a)) + dt * proximity.speed[pairs]
    else:
        proximity.cover_unchecked(np.array([q_a, q_b]))
        way = proximity.travel.dot(np.abs(q_b - q_a)) + dt * proximity.speed
        proximity.lower_bounds(q_a, time=time, floor=proximity.clearance + spare + way)
        pairs = proximity.unproven_unchecked(q_b, time=time + dt, spare=spare, way=way)
        if not len(pairs):
            return True
        way = way[pairs]
    floor = proximity.clearance[pairs] + spare + way
    d_a, d_b = (
        proximity.distances_below_unchecked(pairs, floor, q, time=moment)
        for q, moment in ((q_a, time), (q_b, time + dt))
    )
    return _keep(proximity, pairs, q_a, q_b, d_a, d_b, way, time=time, dt=dt, depth=depth, spare=spare)


def _keep(
    proximity: Proximity, pairs: Indices, q_a: Vector, q_b: Vector, d_a: Vector, d_b: Vector, way: Vector,
    *, time: float, dt: float, depth: int, spare: float,
) -> bool:  # fmt: skip
    """`segment_is_clear` of some pairs (K,), with distances d_a, d_b (K,) at the ends that change by `way` (K,) [m]."""
    least = proximity.clearance[pairs] + spare
    floor = least + way
    undecided = (d_a + d_b < least + floor) & (proximity.appears_at[pairs] <= time + dt)
    if not np.count_nonzero(undecided):
        return True
    pairs, d_a, d_b, least, floor = pairs[undecided], d_a[undecided], d_b[undecided], least[undecided], floor[undecided]
    if depth == 0 or np.count_nonzero(np.minimum(d_a, d_b) < least):
        return False
    half, middle, way = 0.5 * dt, 0.5 * (q_a + q_b), 0.5 * way[undecided]
    d_m = proximity.distances_below_unchecked(pairs, floor, middle, time=time + half)
    return _keep(
        proximity, pairs, q_a, middle, d_a, d_m, way, time=time, dt=half, depth=depth - 1, spare=spare
    ) and _keep(
        proximity, pairs, middle, q_b, d_m, d_b, way, time=time + half, dt=half, depth=depth - 1, spare=spare
    )  # fmt: skip


def path_segment_is_clear(proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float) -> bool:
    """Whether every clearance provably holds, to within `TOUCH`, on a segment along a bucket path.

    Such a path may run at exactly its clearance. The parameters are those of `segment_is_clear`.
    """
    return segment_is_clear(proximity, q_a, q_b, time=time, depth=_TOUCHING_DEPTH, spare=-TOUCH)


def motion_is_clear(proximity: Proximity, time: Vector, q: Matrix) -> bool:
    """Whether every clearance provably holds, to within `STEP_ROUNDING`, on straight motions through samples.

    Parameters
    ----------
    proximity: of the machine and the obstacles.
    time: (T,) of the samples, not decreasing [s]; if all are equal, obstacles stay where they are at that time.
    q: (T, n) joint positions of the samples [rad or m].
    """
    owed = np.full(len(proximity.pairs), -STEP_ROUNDING)
    refuted = False

    def note(row: int, pairs: Indices, margins: Vector) -> Vector | None:
        nonlocal refuted
        refuted = bool((margins < -STEP_ROUNDING).any())
        return None if refuted else owed

    proximity.cover_unchecked(q)
    # an obstacle that appears between two samples counts on the whole segment
    until = np.append(time[1:], time[-1])
    for samples in bound_samples(proximity, time, q, owed, note, until=until, stride=_STRIDE):
        doubtful = ~(samples.between >= owed)
        for row in np.flatnonzero(doubtful.any(axis=1)).tolist():
            pairs, k = doubtful[row].nonzero()[0], samples.first + row
            way, dt = samples.ways[row, pairs], float(time[k + 1] - time[k])
            floor = proximity.clearance[pairs] - STEP_ROUNDING + way
            d_a, d_b = (
                proximity.distances_below_unchecked(pairs, floor, q[end], time=float(time[end])) for end in (k, k + 1)
            )
            if not _keep(
                proximity, pairs, q[k], q[k + 1], d_a, d_b, way, time=float(time[k]), dt=dt,
                depth=_TOUCHING_DEPTH, spare=-STEP_ROUNDING,
            ):  # fmt: skip
                return False
    return not refuted
