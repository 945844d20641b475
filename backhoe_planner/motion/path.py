"""Paths: one of the tip, straight from waypoint to waypoint; one of the joints, with round corners.

At a corner the joints' way leaves the leg at a distance d before the corner and joins the next
leg at d behind it, on the parabola that has both legs as tangents. So the corner needs no
stop. With the length s along the legs as the parameter, dq/ds turns linearly from one leg's
direction to the other's: the way is C1, and d2q/ds2 is piecewise constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import TipTarget, wrap_angle
from backhoe_planner.site import Waypoint

_TURN_LENGTH = 0.5  # m per rad that a leg counts on which the tip only turns; chosen
_JOINT_TURN_LENGTH = 0.1  # m per rad of the joints, so that a motion goes on where the tip stands; chosen
_NO_LENGTH = 1e-9  # m: on a shorter leg the tip only turns
_BESIDE = 1e-6  # m before and behind a waypoint, where the direction of travel is taken


def step_lengths(stations: Vector, q: Matrix, *, least: float) -> Vector:
    """(K-1,) lengths of the steps along a path [m]: the tip's way, and 0.1 m for each radian of the joints.

    Parameters
    ----------
    stations: (K,) arc lengths of the samples [m]; q: (K, n) joints there [rad or m].
    least: length of the shortest step [m].
    """
    turn = np.linalg.norm(np.diff(q, axis=0), axis=1)
    return np.asarray(np.maximum(np.diff(stations) + _JOINT_TURN_LENGTH * turn, least))


class TipPath:
    """A path of the tip, evaluated by arc length.

    Parameters
    ----------
    waypoints: W of them, at least two.

    Attributes
    ----------
    points: (W, 3) waypoints [m], world.
    stations: (W,) arc length at each waypoint [m].
    """

    def __init__(self, waypoints: Sequence[Waypoint]) -> None:
        self.waypoints = tuple(waypoints)
        self.points = np.array([waypoint.position for waypoint in self.waypoints], dtype=float)
        self._targets = [waypoint.target for waypoint in self.waypoints]
        lengths = [self._leg_length(leg) for leg in range(len(self.waypoints) - 1)]
        self.stations = np.concatenate(([0.0], np.cumsum(lengths)))

    @property
    def length(self) -> float:
        """[m]"""
        return float(self.stations[-1])

    @property
    def asks_orientation(self) -> bool:
        """Whether any waypoint asks for a pitch or an orientation."""
        return any(target.rotation is not None or target.pitch is not None for target in self._targets)

    def __call__(self, s: float, order: int = 0) -> Vector:
        """(3,) position [m] (order 0) or direction of travel (order 1) at arc length `s` [m]."""
        leg, part = self._locate(s)
        step = self.points[leg + 1] - self.points[leg]
        if order == 0:
            return np.asarray(self.points[leg] + part * step)
        length = self.stations[leg + 1] - self.stations[leg]
        return np.asarray(step / length if length > 0.0 else step)

    def target(self, s: float) -> TipTarget:
        """The target of the tip at arc length `s` [m].

        Between a waypoint with a pitch and one without, the range widens until any pitch is
        allowed.
        """
        leg, part = self._locate(s)
        position = (1.0 - part) * self.points[leg] + part * self.points[leg + 1]
        before, after = self._targets[leg].rotation, self._targets[leg + 1].rotation
        rotation = before if before is not None else after
        if before is not None and after is not None:
            rotation = before @ pin.exp3(part * pin.log3(before.T @ after))
        return TipTarget(position=position, pitch=self._pitch(leg, part), rotation=rotation)

    def nearest(self, point: Vector, *, low: float = 0.0, high: float | None = None) -> tuple[float, float]:
        """Arc length [m] of the path's point nearest to `point` (3,) [m], and its distance [m].

        Parameters
        ----------
        low, high: the part of the path that is searched, by arc length [m]; by default all.
        """
        high = self.length if high is None else high
        best = (low, float(np.linalg.norm(point - self(low))))
        for leg in range(len(self.points) - 1):
            s0, s1 = max(float(self.stations[leg]), low), min(float(self.stations[leg + 1]), high)
            if s1 < s0:
                continue
            a, b = self(s0) if s0 > self.stations[leg] else self.points[leg], self.points[leg + 1]
            if s1 < self.stations[leg + 1]:
                b = self(s1)
            step = b - a
            square = float(step @ step)
            part = float(np.clip((point - a) @ step / square, 0.0, 1.0)) if square > 0.0 else 0.0
            distance = float(np.linalg.norm(point - a - part * step))
            if distance < best[1] - 1e-12:
                best = (s0 + part * (s1 - s0), distance)
        return best

    def turn(self, a: float, b: float) -> float:
        """How far the asked orientation turns from arc length `a` to `b` [rad]; 0 where none is asked."""
        return self.target(a).turn_to(self.target(b))

    def corners(self, angle: float) -> Vector:
        """(C,) arc lengths [m] at which the path bends by more than `angle` [rad]."""
        found = []
        for mark in self.stations[1:-1].tolist():
            before, after = self(mark - _BESIDE, 1), self(mark + _BESIDE, 1)
            size = float(np.linalg.norm(before) * np.linalg.norm(after))
            if size < 1e-12 or float(before @ after) / size < np.cos(angle):
                found.append(mark)
        return np.array(found)

    def _locate(self, s: float) -> tuple[int, float]:
        s = float(np.clip(s, 0.0, self.length))
        leg = int(np.clip(np.searchsorted(self.stations, s, side="right") - 1, 0, len(self.points) - 2))
        span = self.stations[leg + 1] - self.stations[leg]
        return leg, float((s - self.stations[leg]) / span) if span > 0.0 else 0.0

    def _leg_length(self, leg: int) -> float:
        length = float(np.linalg.norm(self.points[leg + 1] - self.points[leg]))
        return length if length > _NO_LENGTH else _TURN_LENGTH * self._targets[leg].turn_to(self._targets[leg + 1])

    def _pitch(self, leg: int, part: float) -> tuple[float, float] | None:
        before, after = self._targets[leg].pitch, self._targets[leg + 1].pitch
        if before is None or after is None:
            asked, opened = (before, part) if before is not None else (after, 1.0 - part)
            if asked is None or opened >= 1.0:
                return None
            middle, half = 0.5 * (asked[0] + asked[1]), 0.5 * (asked[1] - asked[0])
            half += opened * max(np.pi - half, 0.0)
            return (middle - half, middle + half)
        turn = wrap_angle(0.5 * sum(after) - 0.5 * sum(before))
        middle = 0.5 * sum(before) + part * turn
        half = 0.5 * ((1.0 - part) * (before[1] - before[0]) + part * (after[1] - after[0]))
        return (middle - half, middle + half)


@dataclass(frozen=True, eq=False)
class SmoothWay:
    """Legs and parabolic corners in joint space, `way(s)`.

    Attributes
    ----------
    corners: (K, n) where the legs meet; the way passes by those that are cut.
    stations: (K,) length along the legs up to each corner [s of joint time].
    cuts: (K,) d of each corner; 0 at the ends and at corners that are not cut, where a motion
        must stop.
    """

    corners: Matrix
    stations: Vector
    cuts: Vector

    def __post_init__(self) -> None:
        for array in (self.corners, self.stations, self.cuts):
            array.setflags(write=False)

    @property
    def length(self) -> float:
        """Length of the legs, where s ends."""
        return float(self.stations[-1])

    @property
    def knots(self) -> Vector:
        """Every s at which a leg or a round corner begins or ends, increasing, from 0 to the length."""
        return np.unique(np.concatenate((self.stations - self.cuts, self.stations + self.cuts)))

    @property
    def stops(self) -> Vector:
        """Every s at which a motion along the way must be at rest: the ends, and corners that are not cut."""
        return np.array(self.stations[self.cuts == 0.0])

    def __call__(self, s: float | Vector, order: int = 0) -> Matrix:
        """(n,) or (k, n) derivative of that order (0, 1 or 2) with respect to s, from the right."""
        at = np.atleast_1d(np.asarray(s, dtype=float))
        legs = np.diff(self.corners, axis=0)
        steps = np.diff(self.stations)
        leg = np.clip(np.searchsorted(self.stations, at, side="right") - 1, 0, len(steps) - 1)
        slope = legs / steps[:, None]
        found = np.zeros((len(at), self.corners.shape[1]))
        if order == 0:
            found = self.corners[leg] + (at - self.stations[leg])[:, None] * slope[leg]
        elif order == 1:
            found = slope[leg]
        for corner in np.flatnonzero(self.cuts > 0.0):
            d, begin = self.cuts[corner], self.stations[corner] - self.cuts[corner]
            inside = (at >= begin) & (at < begin + 2.0 * d)
            if not inside.any():
                continue
            into, turn = slope[corner - 1], (slope[corner] - slope[corner - 1]) / (2.0 * d)
            along = (at[inside] - begin)[:, None]
            if order == 0:
                found[inside] = self.corners[corner] - d * into + along * into + 0.5 * along**2 * turn
            elif order == 1:
                found[inside] = into + along * turn
            else:
                found[inside] = turn
        return found if np.ndim(s) else found[0]
