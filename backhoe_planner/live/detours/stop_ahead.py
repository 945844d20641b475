"""A place on a plan at which its clock is to come to rest, and how the machine gets there along the plan.

At the pace p of the plan's time s, with u = p^2, a joint on the plan q(s) has the acceleration

    q'' u + q' u' / 2,    ' = d / ds

so the joint with the least room for it says how fast u may fall:

    u' >= -(2 / |q'|) (a + sgn(q') q'' u)

The plan itself keeps the accelerations a, so u need not fall where there is no room for that. Integrated back from the
place, where u = 0, this is the greatest pace at which the machine still comes to rest there; integrated forwards from
where the machine is, it leads to the first place at which it can rest. Between two knots of a `Reference` q'' is
constant. With a constant u' the acceleration is linear in s there, so it keeps its limits if it does at both ends.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.live.detours.reference import Clocked, Reference
from backhoe_planner.live.detours.track_proof import ROOM, Blockage
from backhoe_planner.machine import JointLimits

_STEP = 0.01  # s of the plan between two places at which the pace is computed, at most; chosen, as samples are apart
_PART = 0.97  # part of the accelerations that is used; chosen, the rest is for coming onto the approach
_ROOMS = (ROOM, 0.05, 0.02)  # m beyond the clearances, of which the first that a place has is enough; chosen
_LONGEST = 5.0  # s of the plan in which the machine must have come to rest; chosen, it takes 0.2 to 1 s
_STILL = 1e-6  # rad/s or m/s below which a joint is no bound for the pace


class Approach(Clocked):
    """A reference that is slowed down so that it comes to rest at a place of it.

    It has a time of its own, which is that of the reference until it is slowed down. Its clock is the reference's, in
    that time: the one moves with the other.

    Parameters
    ----------
    reference: to be slowed down.
    limits: of the machine that follows it.
    place: the time on the reference at which it rests [s], above 0.

    Attributes
    ----------
    place: as above [s].
    """

    def __init__(self, reference: Reference, limits: JointLimits, place: float) -> None:
        self.place, self._reference = place, reference
        time, squared = [place], [0.0]
        while squared[-1] < 1.0 and time[-1] > 0.0:
            knot = int(reference.knots.searchsorted(time[-1], side="left")) - 1
            before = max(float(reference.knots[knot]), time[-1] - _STEP, 0.0)
            fall = _fall(reference, limits, time[-1], before, squared[-1])
            squared.append(min(squared[-1] + (time[-1] - before) * fall, 1.0))
            time.append(before)
        self._places, self._paces = np.array(time[::-1]), np.sqrt(squared[::-1])
        spans = 2.0 * np.diff(self._places) / (self._paces[1:] + self._paces[:-1])
        self._times = self._places[0] + np.concatenate(([0.0], np.cumsum(spans)))
        self.end = float(self._times[-1])

    @property
    def clock(self) -> float:
        """The time that has been reached [s]; may be set, which sets the clock of the reference."""
        place = self._reference.clock
        if place >= self.place:
            return self.end
        row = int(self._places.searchsorted(place, side="right")) - 1
        if row < 0:
            return place
        before, change = float(self._paces[row]), self._change(row)
        along = place - float(self._places[row])
        pace = float(np.sqrt(max(before**2 + 2.0 * change * along, 0.0)))
        return float(self._times[row]) + 2.0 * along / (before + pace)

    @clock.setter
    def clock(self, time: float) -> None:
        self._reference.clock = self.place_at(time)

    @property
    def slows_at(self) -> float:
        """The time from which on it is slower than the reference [s]."""
        return float(self._times[0])

    @property
    def last_q(self) -> Vector:
        """(n,) joint positions at the place where it rests [rad or m]."""
        return self._reference.at(self.place)

    def at(self, time: float) -> Vector:
        """(n,) joint positions at `time` [s] [rad or m]; those at the end from there on."""
        return self._reference.at(self.place_at(time))

    def place_at(self, time: float) -> float:
        """The time on the reference [s] at a `time` [s]."""
        if time >= self.end:
            return self.place
        row = int(self._times.searchsorted(time, side="right")) - 1
        if row < 0:
            return time
        since = time - float(self._times[row])
        return float(self._places[row]) + since * (float(self._paces[row]) + 0.5 * since * self._change(row))

    def __copy__(self) -> Approach:
        """The same with a clock of its own."""
        found = object.__new__(Approach)
        found.__dict__.update(self.__dict__)
        found._reference = copy(self._reference)
        return found

    def _change(self, row: int) -> float:
        """Of the pace from a place to the next one [1/s]."""
        span = float(self._times[row + 1] - self._times[row])
        return float(self._paces[row + 1] - self._paces[row]) / span


def first_rest(reference: Reference, limits: JointLimits, pace: float) -> float:
    """The first time on the reference [s] at which a machine that goes along at `pace` (0 to 1) can rest.

    Infinite if that is beyond its end or more than some seconds ahead.
    """
    time, squared = reference.clock, pace**2
    knots = [*reference.knots.tolist(), np.inf]
    row = int(reference.knots.searchsorted(time, side="right"))
    while squared > 0.0:
        if time >= min(reference.clock + _LONGEST, reference.end):
            return np.inf
        after = min(knots[row], time + _STEP, reference.end)
        fall = _fall(reference, limits, time, after, squared)
        if fall * (after - time) >= squared:
            return time + squared / fall
        time, squared = after, squared - fall * (after - time)
        row += after == knots[row]
    return time


def stop_before(reference: Reference, limits: JointLimits, pace: float, blockage: Blockage) -> Approach | None:
    """The way to rest before a blockage, as far on as there is room for a detour to begin; None if there is none.

    pace: of the machine along the reference now, 0 to 1.
    """
    first = first_rest(reference, limits, pace)
    for room in _ROOMS:
        places = blockage.time[(blockage.margin >= room) & (blockage.time >= first) & (blockage.time > 0.0)]
        if len(places):
            return Approach(reference, limits, float(places[-1]))
    return None


def pace_along(reference: Reference, v: Vector, dt: float) -> float:
    """The pace of a machine at v (n,) along the reference, 0 to 1, at the rates of the next `dt` [s]."""
    rates = reference.rates(dt)
    squared = float(rates @ rates)
    return min(max(float(rates @ v) / squared, 0.0), 1.0) if squared > 0.0 else 0.0


def _fall(reference: Reference, limits: JointLimits, known: float, other: float, squared: float) -> float:
    """By how much the squared pace can fall at most along a second of the reference [1/s], between two times on it.

    known, other: the time [s] at which the pace is known, and one without a knot between the two.
    squared: the squared pace at the known time.
    """
    v, a = reference.changes_at(0.5 * (known + other))
    to = 0.5 * (other - known) * a
    # the acceleration a u + f c at both ends, where u is that at the known time and f is the fall
    c = np.array((v - to, v + to)) * -0.5
    c[1] -= 2.0 * to
    room = _PART * limits.acceleration - np.sign(c) * a * squared
    moving = np.abs(c) > _STILL
    return float(np.min(np.maximum(room[moving], 0.0) / np.abs(c[moving]), initial=1.0 / _STEP))
