"""Proven distances between samples: whether one segment is clear, and the least distances of a whole motion.

On a segment from q_a to q_b, joints moving linearly, no point of a link moves further than some
B relative to an obstacle (its own travel added; `site.pairs.ways`), so the distance
anywhere between is at least (d_a + d_b - B) / 2. Where that bound does not decide, the
segment is halved; over a whole motion, always the segment with the lowest bound, until no
bound is below what was measured, to within `RESOLUTION` (or 2 % of the margin, where that is
more). The result is never above the true distance.
"""

from __future__ import annotations

import heapq

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.motion import Trajectory
from backhoe_planner.site import Obstruction, Proximity

RESOLUTION = 1e-4  # m: how far a proven bound may lie below the true least distance; chosen, a tenth of a millimetre
_RESOLUTION_OF_MARGIN = 0.02  # or this part of the margin, where that is more; chosen
AT_CLEARANCE = 1e-5  # m: what is measured to be too near by no more is at its clearance; chosen, far above rounding
KEPT_WITHIN = RESOLUTION + AT_CLEARANCE  # m: a motion at exactly its clearance counts as keeping it
_EFFORT = (
    200_000  # measurements per obstacle; chosen, so that the search ends on a motion along a wall at its clearance
)
_EFFORT_REFUTED = 2_000  # the same where the motion is already known not to keep its clearance; chosen
TOUCH = 0.5 * RESOLUTION  # m: between samples at exactly its clearance, a path is clear to within this
STEP_ROUNDING = (
    2e-5  # m by which the proof of a motion may fall short; chosen: far below a clearance, far above rounding
)
_TOUCHING_DEPTH = 9  # halvings: 1/512 of a step of 0.02 m moves no point by more than `TOUCH`
_FIRST_LOOKS = 16  # samples from one first look to the next; chosen
_TOGETHER = 128  # samples that are bounded together; chosen
_NEVER = 10.0  # m: an obstacle whose margin is always above this is not reported; chosen, beyond a machine's reach


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
    least = np.full(len(searches), _NEVER)

    def look(row: int, beyond: Vector | float, known: Vector) -> tuple[Vector, Flags]:
        """(P,) margins at a sample, or lower bounds that are more by `beyond` (P,) than what is to be proven.

        And (P,) which are margins.

        The distances are known to be at least `known` (P,) [m].
        """
        here = proximity.appears_at <= time[row]
        enough = np.where(least < _NEVER, _to_prove(least), least)
        floor = np.where(here, enough[owners] + proximity.clearance + beyond, -np.inf)
        lower, measured = proximity.lower_bounds(q[row], time=float(time[row]), floor=floor, known=known)
        margins = np.where(here, lower - proximity.clearance, np.inf)
        pairs = np.flatnonzero(measured & here)
        for pair in pairs[margins[pairs] < least[owners[pairs]]].tolist():
            searches[owners[pair]].note(float(margins[pair]), float(time[row]), pair)
            least[owners[pair]] = searches[owners[pair]].least
        return margins, measured

    def measure(row: int, pairs: Indices) -> None:
        """Measure some pairs at a sample, as far as each may be the nearest of its obstacle so far."""
        floor = least[owners[pairs]] + proximity.clearance[pairs]
        moment = float(time[row])
        margins = proximity.distances_below_unchecked(pairs, floor, q[row], time=moment) - proximity.clearance[pairs]
        for pair, margin in zip(pairs.tolist(), margins.tolist(), strict=True):
            owner = owners[pair]
            if proximity.appears_at[pair] <= moment and margin < least[owner]:
                searches[owner].note(margin, moment, pair)
                least[owner] = searches[owner].least

    # where an obstacle is nearest is known about after a few looks; what is further away is then hardly measured
    firsts = np.arange(0, len(time), _FIRST_LOOKS)
    nearest = _nearest_clusters(proximity, q[firsts], time[firsts])
    for row, bounds, pairs in zip(firsts.tolist(), proximity.bounds_unchecked(q[firsts]), nearest, strict=True):
        measure(row, pairs)
        look(row, 0.0, bounds)
    # row by row: samples times pairs may be more than a machine's memory holds
    steps, spans, ways = np.abs(np.diff(q, axis=0, append=q[-1:])), np.diff(time), proximity.ways_unchecked(q)
    clusters = slice(proximity.plain, None)

    def expect(first: int) -> None:
        """Bound the distances from clusters at the next samples together."""
        rows, moves = slice(first, first + _TOGETHER), slice(max(first - 1, 0), first + _TOGETHER)
        furthest = proximity.travel[clusters].dot(steps[moves].max(axis=0))
        furthest += spans[moves].max(initial=0.0) * proximity.speed[clusters]
        needed = least[owners[clusters]] + proximity.clearance[clusters] + 0.5 * furthest
        proximity.clusters.expect(q[rows], time[rows], needed=needed)

    expect(0)
    still = np.zeros(len(owners))
    travel = still if len(time) == 1 else next(ways) + spans[0] * proximity.speed
    every = proximity.bounds_unchecked(q)
    before, known_before = look(0, 0.5 * travel, next(every))
    for row, known_here in enumerate(every, start=1):
        if row % _TOGETHER == 0:
            expect(row)
        came = travel
        travel = next(ways) + spans[row] * proximity.speed if row < len(spans) else still
        margins, known = look(row, 0.5 * np.maximum(came, travel), known_here)
        bounds = 0.5 * (before + margins - came)
        for pair in np.flatnonzero(~(bounds >= _to_prove(least)[owners])).tolist():
            ends = (float(before[pair]), float(margins[pair])) if known_before[pair] and known[pair] else None
            searches[owners[pair]].open(float(bounds[pair]), row - 1, pair, float(came[pair]), ends)
        before, known_before = margins, known
    found = [clearance for search in searches if (clearance := search.finish()) is not None]
    return tuple(sorted(found, key=lambda clearance: clearance.margin))


def _nearest_clusters(proximity: Proximity, q: Matrix, time: Vector) -> Indices:
    """(N, C) of each obstacle that is a cluster the pair that seems nearest in postures q (N, n) at `time` (N,)."""
    clusters, found = proximity.clusters, []
    lower = clusters.lower_each(q, time) if len(clusters) else np.zeros((len(q), 0))
    for owner in np.unique(clusters.owner).tolist():
        pairs = np.flatnonzero(clusters.owner == owner)
        found.append(proximity.plain + pairs[np.argmin(lower[:, pairs], axis=1)])
    return np.array(found, dtype=np.intp).reshape(-1, len(q)).T


def _to_prove(least: Vector) -> Vector:
    """The margins to be proven where `least` are the least margins that were measured [m]."""
    return np.asarray(least - np.maximum(RESOLUTION, _RESOLUTION_OF_MARGIN * least))


def _to_prove_of_one(least: float) -> float:
    """The same of one, at a tenth of what an array takes."""
    return least - max(RESOLUTION, _RESOLUTION_OF_MARGIN * least)


class _Search:
    """Best-first search for the least margin to one obstacle over a whole motion.

    Attributes
    ----------
    least: the least margin that was measured [m].
    """

    def __init__(self, proximity: Proximity, time: Vector, q: Matrix) -> None:
        self._proximity, self._time, self._q = proximity, time, q
        self.least = _NEVER
        self._where = (0.0, 0)  # moment and pair of the least margin
        # (bound, tie-breaker, segment, pair, how much the margin can change on the segment, from, to, margins there):
        # parts 0..1 of a segment
        self._open: list[tuple[float, int, int, int, float, float, float, tuple[float, float] | None]] = []
        self._measured = 0

    def note(self, margin: float, moment: float, pair: int) -> None:
        """A margin was measured."""
        if margin < self.least:
            self.least, self._where = margin, (moment, pair)

    def open(self, bound: float, segment: int, pair: int, way: float, ends: tuple[float, float] | None) -> None:
        """On this segment the margin may be as low as `bound`, and changes by `way` at most [m].

        `ends` are the margins at its ends, where measured.
        """
        heapq.heappush(self._open, (bound, len(self._open), segment, pair, way, 0.0, 1.0, ends))

    def finish(self) -> Obstruction | None:
        """Halve the segment with the lowest bound until no bound is below what is to be proven.

        Where the motion is refuted anyway, or the effort is used up, the result is the lower
        bound that was reached. None for an obstacle that never comes near.
        """
        tie = len(self._open)
        while self._open and self._open[0][0] < _to_prove_of_one(self.least):
            if self._measured > (_EFFORT_REFUTED if self.least < -KEPT_WITHIN else _EFFORT):
                break
            _, _, segment, pair, way, a, b, known = heapq.heappop(self._open)
            middle = 0.5 * (a + b)
            m_a, m_b = known or (self._measure(segment, pair, a), self._measure(segment, pair, b))
            m_m = self._measure(segment, pair, middle)
            half = 0.5 * (b - a) * way
            for start, m_1, m_2 in ((a, m_a, m_m), (middle, m_m, m_b)):
                tie += 1
                bound = 0.5 * (m_1 + m_2 - half)
                end = start + 0.5 * (b - a)
                heapq.heappush(self._open, (bound, tie, segment, pair, way, start, end, (m_1, m_2)))
        proven = _to_prove_of_one(self.least)
        if self.least >= _NEVER and not (self._open and self._open[0][0] < proven):
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
    """Samples of the motion, and one more at every moment at which an obstacle appears."""
    moments = {float(t) for t in proximity.appears_at if trajectory.time[0] < t < trajectory.time[-1]}
    time = np.unique(np.concatenate((trajectory.time, sorted(moments))))
    if len(time) == len(trajectory.time):
        return trajectory.time, trajectory.q
    return time, trajectory.at(time)


def segment_is_clear(
    proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0, dt: float = 0.0, depth: int = 6,
    spare: float = 0.0, known: Vector | None = None, way: Vector | None = None,
) -> bool:  # fmt: skip
    """Whether every clearance provably holds on one segment.

    Parameters
    ----------
    proximity: of the machine and the obstacles.
    q_a, q_b: (n,) the ends of the segment; the joints move linearly between them.
    time, dt: when the segment begins, and how long it takes [s].
    depth: how often it may be halved.
    spare: distance to be kept in addition to every clearance [m]; negative to allow less.
    known: (P,) what the distances at `q_a` are known to be at least [m].
    way: (P,) how much the distances can change on the segment, obstacles' own motions apart, see
        `Proximity.ways_unchecked`; by default it is bounded anew.
    """
    if way is None and proximity.is_at_unchecked(q_a, time=time):
        # one step of many: all but a few pairs are mostly far away
        proximity.cover_unchecked(q_a)
        pairs = proximity.unproven_unchecked(q_b, time=time + dt, spare=spare)
        if len(pairs):
            least = proximity.clearance.take(pairs) + spare
            pairs = pairs[~proximity.stay_apart_unchecked(pairs, least, q_b, time=time + dt)]
        if not len(pairs):
            return True
        way = proximity.travel[pairs].dot(np.abs(q_b - q_a)) + dt * proximity.speed[pairs]
    else:
        if way is None:
            proximity.cover_unchecked(np.array([q_a, q_b]))
            way = proximity.travel.dot(np.abs(q_b - q_a))
        way = way + dt * proximity.speed
        if not proximity.is_at_unchecked(q_a, time=time):
            proximity.lower_bounds(q_a, time=time, floor=proximity.clearance + spare + way, known=known)
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


def path_segment_is_clear(proximity: Proximity, q_a: Vector, q_b: Vector, *, time: float = 0.0) -> bool:
    """Whether every clearance provably holds, to within `TOUCH`, on a segment along a bucket path.

    Such a path may run at exactly its clearance. Parameters are those of `segment_is_clear`.
    """
    return segment_is_clear(proximity, q_a, q_b, time=time, depth=_TOUCHING_DEPTH, spare=-TOUCH)


def motion_is_clear(proximity: Proximity, time: Vector, q: Matrix) -> bool:
    """Whether every clearance provably holds, to within `STEP_ROUNDING`, on straight motions through samples.

    Parameters
    ----------
    proximity: of the machine and the obstacles.
    time: (T,) of the samples, not decreasing [s]; where all are equal, obstacles stand as they are then.
    q: (T, n) joints there [rad or m].
    """
    if len(proximity.clusters):
        own = slice(proximity.plain, None)
        reach = np.abs(np.diff(q, axis=0, append=q[-1:])) @ proximity.travel[own].T
        reach += np.diff(time, append=time[-1])[:, None] * proximity.speed[own]
        proximity.clusters.expect(q, time, needed=reach + proximity.clearance[own] - STEP_ROUNDING)
    return all(
        segment_is_clear(
            proximity, q[k], q[k + 1], time=float(time[k]), dt=float(time[k + 1] - time[k]),
            depth=_TOUCHING_DEPTH, spare=-STEP_ROUNDING, known=known, way=way,
        )
        for k, (known, way) in enumerate(
            zip(proximity.bounds_unchecked(q[:-1]), proximity.ways_unchecked(q), strict=True)
        )
    )  # fmt: skip
