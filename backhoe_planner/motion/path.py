"""The path of the tip: straight from waypoint to waypoint, with the orientations that it asks for."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_count, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.machine import Configuration, TargetBatch, TipTarget, rotation_matrices, wrap_angle
from backhoe_planner.site import Waypoint

# m per rad: the length that a turn of the tip counts as. Chosen: a leg keeps its arc length unless it turns by more
# than 4 rad for each metre, 23 deg in 10 cm, which bucket paths do not
TURN_LEVER = 0.25
_JOINT_TURN_LENGTH = 0.1  # m per rad of the joints, so that a motion advances while the tip stands still; chosen
_SQUARE_ROUNDING = 1e-7  # root of the relative rounding of a square of a distance: 45 units in the last digit
_NO_LENGTH = 1e-9  # m: a shorter leg counts as having no length
_STANDING = 1e-6  # m: on a shorter leg the tip counts as standing still; chosen
_EXACT = 1e-9  # part of a leg: a range of the pitch that allows no more than this part is one angle
_ANGLE_ROUNDING = 1e-6  # rad: an angle found from its cosine is off by less
_NO_METRES, _NO_DEGREES = 0.005, 0.05  # less is printed as 0
_BESIDE = 1e-6  # m before and behind a waypoint, where the direction of travel is taken


def step_lengths(stations: Vector, q: Matrix, *, least: float) -> Vector:
    """(K-1,) lengths of the steps along a path [m]: the tip's distance, plus 0.1 m for each radian of the joints.

    Parameters
    ----------
    stations: (K,) arc lengths of the samples [m]; q: (K, n) joints there [rad or m].
    least: length of the shortest step [m].
    """
    turn = np.linalg.norm(np.diff(q, axis=0), axis=1)
    return np.asarray(np.maximum(np.diff(stations) + _JOINT_TURN_LENGTH * turn, least))


class TipPath:
    """A path of the tip, evaluated by one measure s of progress over position and orientation.

    A leg from waypoint to waypoint is max(|dp|, 0.25 m/rad * angle) long: s is the arc length of
    the tip, but where the tip turns by more than 4 rad for each metre, the turn counts
    instead. So a turn on the spot is a leg like any other.

    Parameters
    ----------
    waypoints: W of them, at least two.
    numbers: (W,) numbers of the waypoints in messages; by default from 1.

    Attributes
    ----------
    points: (W, 3) waypoints [m], world.
    stations: (W,) s at each waypoint [m].
    turning: (W - 1,) whether s counts the turn of a leg.

    Raises
    ------
    InputError: there are fewer than two waypoints, one is no `Waypoint`, or there are not as many numbers.
    """

    def __init__(self, waypoints: Sequence[Waypoint], *, numbers: Sequence[int] = ()) -> None:
        given = tuple(check_kind(waypoints, Iterable, key="waypoints"))  # type: ignore[type-abstract]
        self.waypoints = tuple(check_kind(point, Waypoint, key=f"waypoints[{i}]") for i, point in enumerate(given))
        if len(self.waypoints) < 2:
            raise InputError("are too few", key="waypoints", found=len(self.waypoints), allowed="2 or more")
        called = tuple(check_kind(numbers, Iterable, key="numbers"))  # type: ignore[type-abstract]
        if called and len(called) != len(self.waypoints):
            raise InputError(
                "are not as many as the waypoints", key="numbers", found=len(called), allowed=str(len(self.waypoints))
            )
        numbers = [as_count(number, key="numbers") for number in called]
        self.points = np.array([waypoint.position for waypoint in self.waypoints], dtype=float)
        self._numbers = tuple(numbers) or tuple(range(1, len(self.waypoints) + 1))
        self._targets = [waypoint.target for waypoint in self.waypoints]
        moved = np.array([np.linalg.norm(b - a) for a, b in pairwise(self.points)])
        moved[moved <= _NO_LENGTH] = 0.0
        self._angles = np.array([_leg_angle(a, b) for a, b in pairwise(self._targets)])
        turned = TURN_LEVER * self._angles
        turned[turned <= _NO_LENGTH] = 0.0
        self.turning: Flags = turned > moved
        self._standing: Flags = moved == 0.0
        self.stations = np.concatenate(([0.0], np.cumsum(np.maximum(moved, turned))))
        self._marks: list[float] = self.stations.tolist()
        self._has_doubles = bool(np.any(np.diff(self.stations) == 0.0))
        self._arcs = np.concatenate(([0.0], np.cumsum(moved)))

    @property
    def length(self) -> float:
        """Length of the whole path, by its measure s [m]."""
        return float(self.stations[-1])

    @cached_property
    def turns(self) -> bool:
        """Whether s counts a turn anywhere; if not, s is the arc length of the tip."""
        return bool(self.turning.any())

    @property
    def stands(self) -> bool:
        """Whether the tip stands still on some leg while the bucket turns, so that arc length does not locate it."""
        return self.turns or bool(np.any(np.diff(self._arcs) < _STANDING))

    @property
    def asks_orientation(self) -> bool:
        """Whether any waypoint requires a pitch or an orientation."""
        return any(target.rotation is not None or target.pitch is not None for target in self._targets)

    def __call__(self, s: float, order: int = 0) -> Vector:
        """(3,) position [m] (order 0) or its derivative (order 1) at `s` [m]."""
        if order not in (0, 1):
            raise InputError("is not an order", key="order", found=repr(order), allowed="0, 1")
        leg, part = self._locate(s)
        step = self.points[leg + 1] - self.points[leg]
        if order == 0:
            return np.asarray(self.points[leg] + part * step)
        length = self.stations[leg + 1] - self.stations[leg]
        return np.asarray(step / length if length > 0.0 else step)

    def target(self, s: float) -> TipTarget:
        """The target of the tip at `s` [m].

        Between a waypoint with a pitch and one without, the range widens until any pitch is
        allowed. If several waypoints have the same s, the first with an orientation counts.
        """
        for index in np.flatnonzero(self.stations == s).tolist() if self._has_doubles else ():
            if self._targets[index].rotation is not None or self._targets[index].pitch is not None:
                return self._targets[index]
        return self._target_on(*self._locate(s))

    @cached_property
    def _legs(self) -> tuple[TargetBatch, Matrix] | None:
        """The waypoints' targets, and the (W - 1, 3) rotation vectors by which the legs turn the tip, in its axes.

        None if that is incomplete: two waypoints have the same s, or some have a pitch and some a rotation.
        """
        rotations = [target.rotation for target in self._targets]
        pitches = [target.pitch for target in self._targets]
        if self._has_doubles or (any(r is not None for r in rotations) and any(p is not None for p in pitches)):
            return None
        turns = [np.zeros(3) if a is None or b is None else pin.log3(a.T @ b) for a, b in pairwise(rotations)]
        return TargetBatch.of(self._targets), np.array(turns)

    @cached_property
    def _pitch_turns(self) -> Vector:
        """(W - 1,) turn between the middles of the pitch ranges at the ends of each leg [rad]; 0 without both."""
        pitches = [target.pitch for target in self._targets]
        return np.array([0.0 if a is None or b is None else _pitch_turn(a, b) for a, b in pairwise(pitches)])

    def _target_on(self, leg: int, part: float) -> TipTarget:
        """The target of the tip at a `part` 0..1 of a leg."""
        position = (1.0 - part) * self.points[leg] + part * self.points[leg + 1]
        before, after = self._targets[leg].rotation, self._targets[leg + 1].rotation
        rotation = before if before is not None else after
        if before is not None and after is not None:
            rotation = before @ pin.exp3(part * pin.log3(before.T @ after))
        return TipTarget(position=position, pitch=self._pitch(leg, part), rotation=rotation)

    def nearest(self, point: Vector, *, low: float = 0.0, high: float | None = None) -> tuple[float, float]:
        """The s [m] of the path's point nearest to `point` (3,) [m], and its distance [m]; angles do not count.

        Parameters
        ----------
        low, high: the part of the path that is searched, by s [m]; by default all.
        """
        point, low = as_vector(point, 3, key="point"), as_number(low, key="low")
        high = self.length if high is None else as_number(high, key="high")
        return self.nearest_unchecked(point, low, high, None)

    def nearest_unchecked(self, point: Vector, low: float, high: float, bounds: Vector | None) -> tuple[float, float]:
        """`nearest` without checks of its arguments, for callers in a loop.

        Parameters
        ----------
        bounds: (W - 1,) lower bounds of the distances of the point from all legs [m], as from `leg_bounds_unchecked`.
        """
        marks = self._marks
        best, distance = low, math.dist(point.tolist(), self(low).tolist())
        first, behind = bisect_left(marks, low, 1) - 1, bisect_right(marks, high, 0, len(marks) - 1)
        at_least = self._distances_to_legs(point, first, behind) if bounds is None else bounds[first:behind]
        x, y, z = point.tolist()
        # with plain numbers: arrays of three take ten times as long
        for row in np.flatnonzero(at_least < distance).tolist():
            leg = first + row
            mark, span = marks[leg], marks[leg + 1] - marks[leg]
            s0, s1 = max(mark, low), min(marks[leg + 1], high)
            if s1 < s0 or at_least[row] >= distance:
                continue
            (ax, ay, az), (dx, dy, dz), square = self._leg_numbers[leg]
            ax, ay, az = x - ax, y - ay, z - az
            begin, end = ((s0 - mark) / span, (s1 - mark) / span) if span > 0.0 else (0.0, 0.0)
            part = min(max((ax * dx + ay * dy + az * dz) / square, begin), end)
            off = math.hypot(ax - part * dx, ay - part * dy, az - part * dz)
            if off < distance - 1e-12:
                best, distance = mark + part * span, off
        return best, distance

    def place(self, at: Configuration, *, low: float, high: float, slack: float) -> tuple[float, float, float]:
        """Where on the path the tip is, by position and orientation: s [m], and how far off the path [m], [rad].

        Parameters
        ----------
        low, high: the part of the path that is searched, by s [m].
        slack: an earlier leg is preferred if it is at most this much worse [m], a radian counted as 0.25 m:
            where a path turns there and back, the tip counts as still on the way there.
        """
        check_kind(at, Configuration, key="at")
        low, high = as_number(low, key="low"), as_number(high, key="high")
        slack = as_number(slack, key="slack", least=0.0)
        spans, nearest = np.diff(self.stations), self._least_costs(at)
        legs = np.flatnonzero((spans > 0.0) & (self.stations[1:] >= low) & (self.stations[:-1] <= high))
        if not len(legs):
            return (low, *self.target(low).distances(at))
        found: dict[int, tuple[float, float, float]] = {}
        least = np.inf
        for leg in [int(legs[np.argmin(nearest[legs])]), *legs.tolist()]:
            if leg in found or nearest[leg] > least + slack:
                continue
            begin, span = float(self.stations[leg]), float(spans[leg])
            part = self._nearest_part(leg, at, max((low - begin) / span, 0.0), min((high - begin) / span, 1.0))
            found[leg] = (float(np.clip(begin + part * span, low, high)), *self._target_on(leg, part).distances(at))
            least = min(least, _cost(found[leg]))
        return next(found[leg] for leg in sorted(found) if _cost(found[leg]) <= least + slack)

    def turn(self, a: float, b: float) -> float:
        """How far the required orientation turns from `a` to `b` [m of s], [rad]; 0 where none is required."""
        return self.target(as_number(a, key="a")).turn_to(self.target(as_number(b, key="b")))

    def corners(self, angle: float) -> Vector:
        """(C,) s [m] at which the path bends by more than `angle` [rad].

        If a leg beside it turns, the bend is that of position and orientation together: two turns
        in a row about one axis are no corner, but a turn on the spot behind a straight leg is one.
        """
        angle = as_number(angle, key="angle", least=0.0)
        return np.asarray(self.stations[1:-1][self._bend_cosines < np.cos(angle)])

    @cached_property
    def _bend_cosines(self) -> Vector:
        """(W - 2,) cosine of the bend at each waypoint between the ends; -inf where a leg beside it has no length."""
        found = []
        for mark in self.stations[1:-1].tolist():
            before, after = self._travel(mark - _BESIDE), self._travel(mark + _BESIDE)
            if not self.turning[self._locate(mark - _BESIDE)[0]] and not self.turning[self._locate(mark + _BESIDE)[0]]:
                before, after = before[:3], after[:3]
            size = float(np.linalg.norm(before) * np.linalg.norm(after))
            found.append(-np.inf if size < 1e-12 else float(before @ after) / size)
        return np.array(found)

    @property
    def turned_waypoints(self) -> NDArray[np.intp]:
        """Indices of the waypoints whose own angle counts: at an end of a turn, or at the same position as another."""
        return _ends_of(self.turning | self._standing)

    @property
    def standing_waypoints(self) -> NDArray[np.intp]:
        """Indices of the waypoints at which the tip stands still: no detour may leave them out."""
        return _ends_of(self._standing)

    @property
    def without_angles(self) -> TipPath:
        """The path of the positions alone, by arc length."""
        return TipPath([Waypoint(position=tuple(point)) for point in self.points.tolist()])

    # --- for people ---------------------------------------------------------------

    def arc(self, s: float) -> float:
        """How far the tip has moved at `s` [m], without turns."""
        s = as_number(s, key="s")
        return float(np.interp(s, self.stations, self._arcs)) if self.turns else s

    def number(self, index: int) -> int:
        """The number of a waypoint in messages."""
        if as_count(index, key="index") >= len(self._numbers):
            allowed = f"less than {len(self._numbers)}"
            raise InputError("there is no such waypoint", key="index", found=index, allowed=allowed)
        return self._numbers[index]

    def describe(self, s: float) -> str:
        """Where `s` [m] is: ``1.20 m``; on a path that turns, ``waypoint 2`` or ``12.3 deg behind waypoint 2``."""
        s = as_number(s, key="s")
        if not self.turns:
            return f"{s:.2f} m"
        leg, part = self._locate(s)
        moved, turned = part * float(np.diff(self._arcs)[leg]), part * float(np.degrees(self._angles[leg]))
        if self.turning[leg]:
            left, words, least = (1.0 - part) * float(np.degrees(self._angles[leg])), f"{turned:.1f} deg", _NO_DEGREES
            gone = turned
        else:
            left, words, least = (1.0 - part) * float(np.diff(self._arcs)[leg]), f"{moved:.2f} m", _NO_METRES
            gone = moved
        if min(gone, left) < least:
            return f"waypoint {self._numbers[leg if gone <= left else leg + 1]}"
        return f"{words} behind waypoint {self._numbers[leg]}"

    def describe_end(self) -> str:
        """The end of the path: ``3.40 m``, or the last waypoint's number on a path that turns."""
        return str(self._numbers[-1]) if self.turns else f"{self.length:.2f} m"

    # --- legs ---------------------------------------------------------------------

    def _travel(self, s: float) -> Vector:
        """(7,) how position [m], orientation and pitch [rad, times 0.25 m] change with s."""
        leg, _ = self._locate(s)
        found = np.zeros(7)
        span = float(self.stations[leg + 1] - self.stations[leg])
        if span > 0.0:
            a, b = self._targets[leg], self._targets[leg + 1]
            found[:3] = self.points[leg + 1] - self.points[leg]
            if a.rotation is not None and b.rotation is not None:
                found[3:6] = TURN_LEVER * a.rotation @ pin.log3(a.rotation.T @ b.rotation)
            elif a.pitch is not None and b.pitch is not None:
                found[6] = TURN_LEVER * _pitch_turn(a.pitch, b.pitch)
            found /= span
        return found

    def _nearest_part(self, leg: int, at: Configuration, low: float, high: float) -> float:
        """The part of a leg between `low` and `high` at which the tip is."""
        step = self.points[leg + 1] - self.points[leg]
        square = float(step @ step)
        along = float((at.tip_position - self.points[leg]) @ step) / square if square > 0.0 else high
        if self.turning[leg]:
            first, last = _turned_parts(self._targets[leg], self._targets[leg + 1], at, low, high)
            if last - first > _EXACT:  # the pitch may have a range: any pitch within it is enough
                along = float(np.clip(along, first, last))
            else:
                weight = (TURN_LEVER * float(self._angles[leg])) ** 2
                along = (square * along + weight * first) / (square + weight)
        return float(np.clip(along, low, high))

    @cached_property
    def _leg_steps(self) -> tuple[Matrix, Vector]:
        """(W - 1, 3) vectors from one end of each leg to the other [m], and (W - 1,) their squares, not 0 [m^2]."""
        steps = np.diff(self.points, axis=0)
        return steps, np.maximum(np.einsum("ki,ki->k", steps, steps), _NO_LENGTH**2)

    @cached_property
    def _leg_numbers(self) -> list[tuple[list[float], list[float], float]]:
        """Of each leg its begin [m], the vector to its end [m], and the square of that, not 0 [m^2]."""
        steps, squares = self._leg_steps
        return list(zip(self.points[:-1].tolist(), steps.tolist(), squares.tolist(), strict=True))

    def leg_bounds_unchecked(self, points: Matrix) -> Matrix:
        """(T, W - 1) lower bounds of the distances of `points` (T, 3) from all legs [m], by balls around the legs."""
        middles, halves = 0.5 * (self.points[1:] + self.points[:-1]), 0.5 * np.sqrt(self._leg_steps[1])
        middles, points = middles - self.points[0], points - self.points[0]
        at_points, at_middles = np.einsum("ti,ti->t", points, points), np.einsum("ki,ki->k", middles, middles)
        square = at_points[:, None] + at_middles - 2.0 * (points @ middles.T)
        rounding = _SQUARE_ROUNDING * float(np.sqrt(np.max(at_points)) + np.sqrt(np.max(at_middles)))
        return np.asarray(np.sqrt(np.maximum(square, 0.0)) - (halves + rounding))

    def _distances_to_legs(self, tip: Vector, first: int, behind: int) -> Vector:
        """(behind - first,) distance [m] of the tip (3,) from each of the legs from `first` to before `behind`."""
        legs, (steps, squares) = slice(first, behind), self._leg_steps
        off, along = tip - self.points[:-1][legs], steps[legs]
        part = np.minimum(np.maximum(np.einsum("ki,ki->k", off, along) / squares[legs], 0.0), 1.0)
        off -= part[:, None] * along
        return np.asarray(np.sqrt(np.einsum("ki,ki->k", off, off)))

    def _least_costs(self, at: Configuration) -> Vector:
        """(W - 1,) a lower bound on how far the tip is off each leg [m], a radian counted as 0.25 m."""
        away, (rotations, turning) = self._distances_to_legs(at.tip_position, 0, len(self.points) - 1), self._rotations
        if not turning.any():
            return away
        traces = np.einsum("wij,ij->w", rotations, at.tip_rotation)
        angles = np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0))
        # at an angle t behind its first end, a leg is at least angles[0] - t off; likewise from its other end
        least = 0.5 * (angles[:-1] + angles[1:] - self._angles) - _ANGLE_ROUNDING
        return np.hypot(away, TURN_LEVER * np.where(turning, np.maximum(least, 0.0), 0.0))

    @cached_property
    def _rotations(self) -> tuple[Array, Flags]:
        """(W, 3, 3) the required orientations, and (W - 1,) whether both ends of a leg have one."""
        asked = np.array([target.rotation is not None for target in self._targets])
        rotations = [np.eye(3) if target.rotation is None else target.rotation for target in self._targets]
        return np.array(rotations), asked[:-1] & asked[1:]

    def _locate(self, s: float) -> tuple[int, float]:
        marks = self._marks
        s = min(max(as_number(s, key="s"), 0.0), marks[-1])
        leg = min(max(bisect_right(marks, s) - 1, 0), len(marks) - 2)
        span = marks[leg + 1] - marks[leg]
        return leg, (s - marks[leg]) / span if span > 0.0 else 0.0

    def _pitch(self, leg: int, part: float) -> tuple[float, float] | None:
        before, after = self._targets[leg].pitch, self._targets[leg + 1].pitch
        if before is None or after is None:
            asked, opened = (before, part) if before is not None else (after, 1.0 - part)
            if asked is None or opened >= 1.0:
                return None
            middle, half = 0.5 * (asked[0] + asked[1]), 0.5 * (asked[1] - asked[0])
            half += opened * max(np.pi - half, 0.0)
            return (middle - half, middle + half)
        middle = 0.5 * sum(before) + part * _pitch_turn(before, after)
        half = 0.5 * ((1.0 - part) * (before[1] - before[0]) + part * (after[1] - after[0]))
        return (middle - half, middle + half)


def targets_along(path: TipPath, s: Vector) -> TargetBatch:
    """The targets of the tip at `s` (K,) [m] of a path, the same as those of `TipPath.target`."""
    s = np.asarray(s, dtype=float)
    legs = path._legs
    if legs is None:
        return TargetBatch.of([path.target(one) for one in s.tolist()])
    ends, turns = legs
    at = np.clip(s, 0.0, path.length)
    leg = np.clip(np.searchsorted(path.stations, at, side="right") - 1, 0, len(path.stations) - 2)
    span = path.stations[leg + 1] - path.stations[leg]
    part = (at - path.stations[leg]) / np.where(span > 0.0, span, 1.0)
    before, after = ends.take(leg), ends.take(leg + 1)
    rotation = np.where(before.has_rotation[:, None, None], before.rotation, after.rotation)
    if turns.any():
        rotation = rotation @ rotation_matrices(part[:, None] * turns[leg])
    both = before.has_pitch & after.has_pitch
    near = np.where(before.has_pitch, before.pitch_half, after.pitch_half)
    opened = np.where(before.has_pitch, part, 1.0 - part)
    wider = np.where(both, part * (after.pitch_half - near), opened * np.maximum(np.pi - near, 0.0))
    middle = np.where(before.has_pitch, before.pitch_middle, after.pitch_middle)
    asked = both | ((before.has_pitch | after.has_pitch) & (opened < 1.0))
    return TargetBatch(
        position=(1.0 - part)[:, None] * path.points[leg] + part[:, None] * path.points[leg + 1],
        rotation=rotation,
        has_rotation=before.has_rotation | after.has_rotation,
        rotation_tolerance=np.zeros(len(s)),
        position_tolerance=np.zeros(len(s)),
        pitch_middle=np.where(asked, middle + np.where(both, part * path._pitch_turns[leg], 0.0), 0.0),
        pitch_half=np.where(asked, near + wider, 0.0),
        has_pitch=asked,
    )


def _ends_of(legs: Flags) -> NDArray[np.intp]:
    """Indices of the waypoints at the ends of `legs` (W - 1,)."""
    return np.flatnonzero(np.append(legs, False) | np.append(False, legs))


def _cost(place: tuple[float, float, float]) -> float:
    """How far off the path a place is [m], a radian counted as 0.25 m."""
    return float(np.hypot(place[1], TURN_LEVER * place[2]))


def _pitch_turn(before: tuple[float, float], after: tuple[float, float]) -> float:
    """Turn from the middle of one range to that of the other, the short way [rad]; half a turn as it is written."""
    written = 0.5 * sum(after) - 0.5 * sum(before)
    turn = wrap_angle(written)
    return float(abs(turn) * np.sign(written)) if abs(abs(turn) - np.pi) < _EXACT else turn


def _leg_angle(before: TipTarget, after: TipTarget) -> float:
    """How far the orientation, or the further end of the pitch's range, turns from one waypoint to the next [rad]."""
    if before.pitch is None or after.pitch is None:
        return before.turn_to(after)
    wider = 0.5 * (after.pitch[1] - after.pitch[0]) - 0.5 * (before.pitch[1] - before.pitch[0])
    return abs(_pitch_turn(before.pitch, after.pitch)) + abs(wider)


def _turned_parts(
    before: TipTarget, after: TipTarget, at: Configuration, low: float, high: float
) -> tuple[float, float]:
    """First and last part of a leg at which its orientation is the tip's; if there is none, the nearest, twice."""
    if before.rotation is not None and after.rotation is not None:
        turn = pin.log3(before.rotation.T @ after.rotation)
        angle = float(np.linalg.norm(turn))
        # the turn about the leg's axis that leaves the least angle
        now = pin.Quaternion(before.rotation.T @ at.tip_rotation)
        turned = 2.0 * float(np.arctan2(now.vec() @ turn / angle, now.w))
        part = 0.5 + wrap_angle(turned - 0.5 * angle) / angle
        return part, part
    assert before.pitch is not None
    assert after.pitch is not None
    turn, half = _pitch_turn(before.pitch, after.pitch), 0.5 * (before.pitch[1] - before.pitch[0])
    wider = 0.5 * (after.pitch[1] - after.pitch[0]) - half
    off = 0.5 * turn + wrap_angle(at.pitch - 0.5 * sum(before.pitch) - 0.5 * turn)
    # |off - part turn| <= half + part wider
    first, last = low, high
    for slope, room in ((-turn - wider, half - off), (turn - wider, half + off)):
        if slope > 0.0:
            last = min(last, room / slope)
        elif slope < 0.0:
            first = max(first, room / slope)
        elif room < 0.0:
            last = -np.inf
    if first <= last:
        return first, last
    parts = [low, high, *([float(np.clip(off / turn, low, high))] if turn != 0.0 else [])]
    part = min(parts, key=lambda one: abs(off - one * turn) - half - one * wider)
    return part, part
