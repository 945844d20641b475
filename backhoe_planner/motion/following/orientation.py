"""How far the tip is turned from the orientation that a path requires, between samples too.

Between two samples the joints move evenly, and the tip turns by at most the sum of |dq_j|
over the hinges. If the tip's place along the path moves evenly too, the required orientation
turns by a known amount V. So, with L the sum of both, the error between two moments with
the errors e_a and e_b is at most (e_a + e_b + L) / 2. If that bound is too large, the error
is measured halfway, and so on: L halves with every step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot, TargetBatch, rotation_vectors, wrap_angle
from backhoe_planner.motion.path import TipPath, targets_along

_RESOLUTION = 1e-3  # rad that a bound may be above the measured errors; chosen, 0.06 degrees
_FINEST = 1e-5  # rad of L at which a part is not halved again; chosen, so that errors just below the limit pass
_MOST = 200_000  # measurements for one motion; chosen, some seconds


def angle_bounds(
    path: TipPath, robot: Robot, *, q: Matrix, station: Vector, angle: Vector, segments: Flags, allowed: float
) -> Vector:
    """(T - 1,) bound on how far the tip is turned from the orientation of `path` on each of `segments` [rad].

    If an error above `allowed` was measured, that error; 0 on other segments.

    Parameters
    ----------
    q: (T, n) the samples [rad or m]; station: (T,) arc lengths of the path there [m].
    angle: (T,) the errors there [rad].
    segments: (T - 1,) which to check.
    allowed: error above which a segment is not checked further [rad].
    """
    found = np.zeros(len(q) - 1)
    measure = _Measure(path, robot, q, station)
    parts = measure.whole(np.flatnonzero(segments), angle)
    looks = 0
    while len(parts.segment):
        measured, bound = np.maximum(parts.before, parts.after), 0.5 * (parts.before + parts.after + parts.turn)
        looks += len(bound)
        # settled, as fine as it gets, or more than allowed
        ends = (bound <= allowed) & (bound <= measured + _RESOLUTION)
        ends |= (parts.turn <= _FINEST) | (measured > allowed) | (looks > _MOST)
        value = np.where(measured > allowed, measured, bound)
        np.maximum.at(found, parts.segment[ends], value[ends])
        parts = measure.halved(parts.take(~ends & (found[parts.segment] <= allowed)))
    return found


@dataclass(frozen=True, eq=False)
class _Parts:
    """P parts of segments, each on one leg of the path.

    Attributes
    ----------
    segment: (P,)
    begin, end: (P,) 0 to 1 within the segment.
    low, high: (P,) arc length at the beginning and at the end [m], on the leg.
    before, after: (P,) errors there [rad].
    turn: (P,) L, by which the error can change on the part [rad].
    """

    segment: Indices
    begin: Vector
    end: Vector
    low: Vector
    high: Vector
    before: Vector
    after: Vector
    turn: Vector

    def take(self, rows: Flags) -> _Parts:
        """The parts in some of the rows."""
        return _Parts(*(values[rows] for values in vars(self).values()))


class _Measure:
    """Errors of one motion along one path."""

    def __init__(self, path: TipPath, robot: Robot, q: Matrix, station: Vector) -> None:
        self._path, self._q, self._station = path, q, station
        self._kinematics = BatchKinematics(robot)
        self._turn = np.abs(np.diff(q, axis=0)) @ np.where(robot.prismatic, 0.0, 1.0)

    def whole(self, segments: Indices, angle: Vector) -> _Parts:
        """The parts of `segments` between the path's waypoints."""
        rows: list[tuple[int, float, float, float, float]] = []
        stations = self._path.stations
        for segment in segments.tolist():
            low, high = self._station[segment : segment + 2].tolist()
            inside = slice(
                np.searchsorted(stations, min(low, high), side="right"), np.searchsorted(stations, max(low, high))
            )
            marks = stations[inside].tolist()
            begin, here = 0.0, low
            for mark in marks if low < high else marks[::-1]:
                part = (mark - low) / (high - low)
                # the required orientation may jump there: use that of the leg that the part is on
                near, far = (np.nextafter(mark, -np.inf), mark) if low < high else (mark, np.nextafter(mark, -np.inf))
                rows.append((segment, begin, part, here, float(near)))
                begin, here = part, float(far)
            rows.append((segment, begin, 1.0, here, high))
        count, table = len(rows), np.array(rows).reshape(-1, 5)
        segment, begin, end, low, high = (table[:, 0].astype(np.intp), *table[:, 1:].T)
        errors = self._errors(np.tile(segment, 2), np.append(begin, end), np.append(low, high))
        asked = _turns(targets_along(self._path, low), targets_along(self._path, high))
        return _Parts(
            segment, begin, end, low, high,
            before=np.where(begin == 0.0, angle[segment], errors[:count]),
            after=np.where(end == 1.0, angle[segment + 1], errors[count:]),
            turn=(end - begin) * self._turn[segment] + asked,
        )  # fmt: skip

    def halved(self, parts: _Parts) -> _Parts:
        """Both halves of every part; on a leg the required orientation turns evenly."""
        middle, place = 0.5 * (parts.begin + parts.end), 0.5 * (parts.low + parts.high)
        error = self._errors(parts.segment, middle, place)
        return _Parts(
            segment=np.tile(parts.segment, 2),
            begin=np.append(parts.begin, middle), end=np.append(middle, parts.end),
            low=np.append(parts.low, place), high=np.append(place, parts.high),
            before=np.append(parts.before, error), after=np.append(error, parts.after),
            turn=np.tile(0.5 * parts.turn, 2),
        )  # fmt: skip

    def _errors(self, segment: Indices, part: Vector, place: Vector) -> Array:
        """(P,) errors at a part 0 to 1 of segments, where the path is followed to `place` [m]."""
        if len(segment) == 0:
            return np.zeros(0)
        q = (1.0 - part)[:, None] * self._q[segment] + part[:, None] * self._q[segment + 1]
        targets = targets_along(self._path, place)
        return np.asarray(np.linalg.norm(targets.errors(self._kinematics.at(q))[:, 3:], axis=1))


def _turns(a: TargetBatch, b: TargetBatch) -> Vector:
    """(P,) how much the change of target from each of `a` to `b`, on one leg of a path, can change the error [rad]."""
    # any pitch is a range of half a turn to either side
    found = np.abs(np.where(a.has_pitch, a.pitch_half, np.pi) - np.where(b.has_pitch, b.pitch_half, np.pi))
    found += np.where(a.has_pitch & b.has_pitch, np.abs(wrap_angle(a.pitch_middle - b.pitch_middle)), 0.0)
    turned = a.has_rotation & b.has_rotation
    if turned.any():
        change = np.swapaxes(a.rotation[turned], 1, 2) @ b.rotation[turned]
        found[turned] = np.linalg.norm(rotation_vectors(change), axis=1)
    return np.asarray(found)
