"""The least distances of a moving machine, from its URDF as written, at many moments.

A coarse search covers points on every link at some hundred moments; the nearest few are then
measured exactly and refined in time. The distance found is never below the true least distance,
and nearly always equal to it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from validation.convex_gaps import Body, first_look, gap, least_pair, parts_of
from validation.raw_obstacles import RawObstacle
from validation.raw_urdf import Placements, RawJoint, RawMachine

Relative = Callable[[Vector], Placements]

_STEP = 0.02  # rad or m, the most that a joint moves between moments
_MOMENTS = 320  # at most, in addition to the samples
_ROUGH_MOMENTS = 80  # of the coarse search
_FINE = 65  # moments between two of the coarse search
_LOOKED_AT, _LOOKS = 10, 7  # near places that are measured, and the moments of each
_PIN = 0.35  # part of the smaller link; nearer to the joint its two links may touch by construction
_PIN_MOMENTS = 12  # at which that is checked
_CLOSED_IN = 3  # how many of these are refined


@dataclass(frozen=True)
class Least:
    """The least distance found between two bodies, and its time [m, s]."""

    link: str
    other: str
    distance: float
    time: float


@dataclass(frozen=True)
class _Place:
    """A place at which the coarse search found two bodies near each other, and the moments around it."""

    rough: float
    first: Body
    second: Body
    relative: Relative
    low: float
    high: float


def link_bodies(machine: RawMachine) -> dict[str, Body]:
    """The links that have a shape."""
    parts = {name: [part for shape in shapes for part in parts_of(shape)] for name, shapes in machine.shapes.items()}
    return {name: Body(name, found) for name, found in parts.items() if found}


class Sweep:
    """A moving machine: straight joint motions between the samples.

    Parameters
    ----------
    joints: the driven ones, in the order of the columns of q.
    time, q: (T,) [s] and (T, n) [rad or m].
    """

    def __init__(
        self, machine: RawMachine, bodies: Mapping[str, Body], joints: tuple[str, ...], time: Vector, q: Matrix
    ) -> None:
        self._machine, self._bodies, self._joints = machine, bodies, joints
        self._time, self._q = time, q
        carriers = machine.bodies(joints)
        self.moving = {name: body for name, body in bodies.items() if carriers[name]}
        steps = np.ceil(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0) / _STEP)
        steps = np.maximum(np.ceil(steps * min(1.0, _MOMENTS / max(float(steps.sum()), 1.0))), 1.0).astype(int)
        parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(time[:-1], time[1:], steps, strict=True)]
        self.times: Vector = np.concatenate([*parts, time[-1:]])
        self._placed = self.placements(self.times)

    def placements(self, times: Vector, *links: str) -> dict[str, Placements]:
        """Links at (T,) moments; all of them if none is named."""
        columns = {
            name: np.interp(times, self._time, column) for name, column in zip(self._joints, self._q.T, strict=True)
        }
        return self._machine.placements(columns, len(times), *links)

    def to_obstacle(self, obstacle: RawObstacle) -> Least | None:
        """The least distance of all links for which the obstacle counts; None if it never appears."""
        links = [body for name, body in self.moving.items() if obstacle.links is None or name in obstacle.links]
        times = self.times[self.times >= obstacle.appears_at]
        if obstacle.appears_at <= self.times[-1]:
            times = np.union1d(times, [max(obstacle.appears_at, 0.0)])
        if not links or not len(times):
            return None
        if obstacle.body is None:
            return min((self._to_plane(link, obstacle, times) for link in links), key=lambda least: least.distance)
        places: list[_Place] = []
        for link in links:
            relative = partial(self._past, link.name, obstacle)
            places += _places(link, obstacle.body, relative, times)
        return _nearest_of(places)

    def between(self, pairs: Iterable[tuple[str, str]]) -> Least | None:
        """The least distance over some pairs of links."""
        places: list[_Place] = []
        for one, other in pairs:
            relative = partial(self._past_link, one, other)
            places += _places(self._bodies[one], self._bodies[other], relative, self.times)
        return _nearest_of(places) if places else None

    def inside_beyond(self, outer: str, inner: str, joint: RawJoint) -> Least | None:
        """A point of one of the two links of `joint` that is inside the other, far from the joint.

        Far is more than `_PIN` of the smaller link from the axis of a hinge, or from the origin
        of a slide. None if no such point is found at some moments of the motion.
        """
        rows = np.unique(np.linspace(0, len(self.times) - 1, _PIN_MOMENTS).astype(int))
        rotations, translations = self._past_link(outer, inner, self.times)
        one, other = self._bodies[outer], self._bodies[inner]
        for row in rows.tolist():
            rotation, translation = rotations[row], translations[row]
            own = (other.points - translation) @ rotation  # of the other's points, in the frame of the joint's child
            sizes = ((one.points, one.fat), (own, other.fat))  # the points of a ball are its middle
            reach = min(float(np.max(np.linalg.norm(points, axis=1) + fat)) for points, fat in sizes)
            for body, points in ((other, one.points @ rotation.T + translation), (one, own)):
                frame = one.points if body is other else own
                along = (frame @ joint.axis)[:, None] * joint.axis * (joint.kind != "prismatic")
                far = np.linalg.norm(frame - along, axis=1) > _PIN * reach
                if any(body.holds(point) for point in points[far]):
                    return Least(outer, inner, 0.0, float(self.times[row]))
        return None

    def _past(self, link: str, obstacle: RawObstacle, times: Vector) -> Placements:
        rotation, translation = self._placements_of(times, link)[link]
        return rotation, translation - obstacle.shift(times)

    def _past_link(self, one: str, other: str, times: Vector) -> Placements:
        return past_link(self._placements_of(times, one, other), one, other)

    def _placements_of(self, times: Vector, *links: str) -> dict[str, Placements]:
        return self._placed if times is self.times else self.placements(times, *links)

    def _to_plane(self, link: Body, obstacle: RawObstacle, times: Vector) -> Least:
        for _ in range(3):
            heights = np.min([obstacle.below_plane(p, *self._past(link.name, obstacle, times)) for p in link.parts], 0)
            row = int(np.argmin(heights))
            found = Least(link.name, obstacle.name, float(heights[row]), float(times[row]))
            times = np.linspace(times[max(row - 1, 0)], times[min(row + 1, len(times) - 1)], _FINE)
        return found


def past_link(placed: Mapping[str, Placements], one: str, other: str) -> Placements:
    """Link `one` in the frame of link `other`."""
    (R_one, p_one), (R_other, p_other) = placed[one], placed[other]
    back = np.swapaxes(R_other, 1, 2)
    return back @ R_one, np.einsum("tij,tj->ti", back, p_one - p_other)


def _places(first: Body, second: Body, relative: Relative, times: Vector) -> list[_Place]:
    """The places where two bodies are near each other, at one or two moments."""
    rotation, translation = relative(times)
    rows = np.unique(np.linspace(0, len(times) - 1, min(_ROUGH_MOMENTS, len(times))).astype(int))
    rough = first_look(first.outline, second, rotation, translation, rows)
    padded = np.concatenate(([np.inf], rough, [np.inf]))
    valleys = np.flatnonzero((rough <= padded[:-2]) & (rough <= padded[2:]))
    found = []
    for index in valleys[np.argsort(rough[valleys])][:2].tolist():
        low, high = times[rows[max(index - 1, 0)]], times[rows[min(index + 1, len(rows) - 1)]]
        found.append(_Place(float(rough[index]), first, second, relative, float(low), float(high)))
    return found


def _nearest_of(places: list[_Place]) -> Least:
    """The least of the places that looked nearest."""
    looks: list[_Look] = []
    least = np.inf
    for place in sorted(places, key=lambda place: place.rough)[:_LOOKED_AT]:
        if place.rough - place.first.reach < least:
            looks.append(_look(place))
            least = min(least, looks[-1].distance)
    looks.sort(key=lambda look: look.distance)
    found = looks[0].least
    for look in looks[:_CLOSED_IN]:
        if found.distance <= 0.0 or look.place.low == look.place.high:
            break
        found = min(found, _close_in(look, found.distance), key=lambda least: least.distance)
    return found


@dataclass(frozen=True)
class _Look:
    """The nearest two parts of two bodies at a moment."""

    place: _Place
    time: float
    distance: float

    @property
    def least(self) -> Least:
        """The least distance known so far."""
        return Least(self.place.first.name, self.place.second.name, self.distance, self.time)


def _look(place: _Place) -> _Look:
    """Measure with all points of the bodies at a few moments around a place."""
    times = np.linspace(place.low, place.high, _LOOKS if place.high > place.low else 1)
    rotation, translation = place.relative(times)
    row = int(np.argmin(first_look(place.first, place.second, rotation, translation, np.arange(len(times)))))
    distance, _ = least_pair(place.first, place.second, rotation[row], translation[row])
    return _Look(place, float(times[row]), distance)


def _close_in(look: _Look, known: float) -> Least:
    """The least distance around a moment, by halving the time interval.

    Parameters
    ----------
    known: the least distance found elsewhere [m]; one round is enough if it is not undercut.
    """
    place, low, high = look.place, look.place.low, look.place.high
    moment, distance = look.time, look.distance
    for _ in range(2):
        times = np.union1d(np.linspace(low, high, _FINE), [moment])
        rotation, translation = place.relative(times)
        row = int(np.searchsorted(times, moment))
        distance, pair = least_pair(place.first, place.second, rotation[row], translation[row])
        row, distance = _descend(place, pair, rotation, translation, row, distance)
        moment, low, high = float(times[row]), times[max(row - 1, 0)], times[min(row + 1, len(times) - 1)]
        if distance <= 0.0 or distance > known:
            break
    return Least(place.first.name, place.second.name, distance, moment)


def _descend(
    place: _Place, pair: tuple[int, int], rotation: Array, translation: Matrix, row: int, distance: float
) -> tuple[int, float]:
    """Step from row to row, in ever smaller steps, to the least distance of two parts."""
    first, second = place.first.parts[pair[0]], place.second.parts[pair[1]]
    for step in (8, 4, 2, 1):
        for other in (row - step, row + step):
            if 0 <= other < len(translation):
                there = gap(first, second, rotation[other], translation[other])
                if there < distance:
                    row, distance = other, there
                    break
    return row, distance
