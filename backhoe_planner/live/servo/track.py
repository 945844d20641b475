"""A track: a motion that is proven clear, on which the machine is, and along which it can stop.

A servo that brakes all joints in proportion needs a clear straight line ahead. On a track the machine needs no such
line: slowed down, it still goes where the track was proven clear. At a constant pace s of at most 1 every acceleration
is s^2 times the track's own, so the machine can always go on at the pace that it has, to the end of the track if need
be, and everywhere it can lower the pace as far as the accelerations allow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import copy
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits, Piece
from backhoe_planner.motion import KEPT_TO, Keep

_ON_TRACK = 1e-6  # rad or m off the track within which the machine is on it; chosen, far below every tolerance
_ROUNDING = 1e-6  # part of the acceleration: a change of velocity that is larger by no more is allowed
_PARTS = (1.0, 0.98, 0.9, 0.7, 0.4, 0.1)  # of the change of pace that is expected to be allowed, which are tried
_ROUGH_STEP = 0.04  # s of a step on the way to rest, of which only about the time counts; chosen
_STEP_TO_REST = 0.005  # s of a step on the way to rest, at least; measured: shorter ones lead to the same place
_FARTHEST_REST, _PLACES_AHEAD = 3.0, 60  # s after which the machine rests, and places until then; chosen
_ALONG = np.array([[0.0], [0.33], [0.67], [1.0]])  # parts of a braking line at which conditions are looked at; chosen
_STILL = 1e-9  # rad/s or m/s: a slower machine stands still; rounding of a position, over a step


class ClockedMotion(Protocol):
    """A motion with a clock, such as a `Reference`, which says more of the methods."""

    clock: float

    @property
    def q(self) -> Vector:
        """(n,) joint positions at the clock's time [rad or m]."""

    def at(self, time: float) -> Vector:
        """(n,) joint positions at `time` [s] [rad or m]."""

    def rates(self, dt: float) -> Vector:
        """(n,) mean rates over the next `dt` [rad/s or m/s]."""

    def advance(self, by: float) -> None:
        """Advance the clock `by` [s]."""


class Track:
    """A motion from rest to rest that keeps all limits, with a clock.

    Parameters
    ----------
    reference: the motion; its clock is moved on by each step on the track.
    limits: of the joints.
    dt: length of a step [s].

    Attributes
    ----------
    dt: length of a step [s].
    keep: the conditions that hold along the motion, and where the machine stops; None if there are none. May be set.
    revision: the `Servo.revision` for whose obstacles the rest of the motion is proven clear; None if it is for none.
    carried: the load, `Robot.carried`, for which it is.
    """

    def __init__(self, reference: ClockedMotion, limits: JointLimits, dt: float) -> None:
        self.reference = reference
        self.keep: Keep | None = None
        self.revision: int | None = None
        self.carried: tuple[str, tuple[Piece, ...]] | None = None
        self._limits, self.dt = limits, dt
        self._change = (1.0 + _ROUNDING) * limits.acceleration * dt
        self._pace = 0.0

    @property
    def pace(self) -> float:
        """Of the step whose velocity was found last, 0 to 1."""
        return self._pace

    def is_joined_by(self, q: Vector, v: Vector) -> bool:
        """Whether a machine at q (n,) is on the track at its clock, and its v (n,) is that of some pace up to 1."""
        if float(np.abs(self.reference.q - q).max()) > _ON_TRACK:
            return False
        if self._allows(self._pace, q, v):  # the pace of the step before, if it was on the track
            return True
        rates = self.reference.rates(self.dt)
        squared = float(rates @ rates)
        self._pace = min(max(float(rates @ v) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
        return self._allows(self._pace, q, v)

    def may_be_left(self, q: Vector, end: Vector) -> bool:
        """Whether a machine at q (n,) that brakes straight ahead to `end` (n,) keeps what is kept along the track.

        A curve that keeps a cup upright leaves it where it bends, so that the straight line ahead tips the cup.
        """
        if self.keep is None:
            return True
        margins = self.keep.rows_each(q + _ALONG * (end - q))[0]
        return bool((margins[1:] >= np.minimum(margins[0], 0.0) - KEPT_TO).all())

    def faster(self, q: Vector, v: Vector, most: float) -> Vector:
        """(n,) the velocity of the next step at the greatest pace up to `most` that the accelerations allow.

        If even the present pace is more than `most`, the least pace that they allow. The next `advance` is for it.
        """
        if self._allows(most, q, v):
            self._pace = most
        elif most < self._pace:
            return self.slower(q, v, least=most)
        else:
            self._pace = self._between(self._pace, most, q, v)
        return self._velocity(self._pace, q)

    def slower(self, q: Vector, v: Vector, least: float = 0.0) -> Vector:
        """(n,) the velocity of the next step at the least pace, from `least` on, that the accelerations allow."""
        self._pace = least if self._allows(least, q, v) else self._between(self._pace, least, q, v)
        return np.clip(self._velocity(self._pace, q), v - self._change, v + self._change)

    def advance(self) -> None:
        """Move the clock on by the step whose velocity was found last."""
        self.reference.advance(self._pace * self.dt)

    def ahead(self, time: float) -> tuple[Matrix, Vector]:
        """(K, n) places on the track for a `time` [s] from the clock on, and (K,) when they are due [s]."""
        return self.places_within(time, _PLACES_AHEAD), np.linspace(0.0, time, _PLACES_AHEAD)

    def places_within(self, time: float, count: int) -> Matrix:
        """(count, n) places on the track for a `time` [s] from the clock on."""
        moments = self.reference.clock + np.linspace(0.0, time, count)
        return np.array([self.reference.at(moment) for moment in moments.tolist()])

    def time_to_rest(self, q: Vector, v: Vector) -> float:
        """About how far the clock advances while a machine at q, v (n,) slows down along the track [s]."""
        alone = self._copy(max(self.dt, _ROUGH_STEP))
        for _ in alone.places_to_rest(q, v):
            pass
        return alone.reference.clock - self.reference.clock

    def looking_ahead(self) -> Track:
        """The same track with a clock of its own, for a look ahead at how a machine slows down along it."""
        return self._copy(max(self.dt, _STEP_TO_REST))

    def places_to_rest(self, q: Vector, v: Vector) -> Iterator[Vector]:
        """(n,) where a machine at q, v (n,) on the track is after each of its steps until it rests.

        Each is computed when it is asked for, and moves the clock on. While a joint of the track itself slows down as
        fast as it can, the pace cannot be lowered.
        """
        steps = 1
        while v.any() and self.dt * steps < _FARTHEST_REST:
            v = self.slower(q, v)
            q = q + self.dt * v
            self.advance()
            steps += 1
            yield q

    def _copy(self, dt: float) -> Track:
        alone = Track(copy(self.reference), self._limits, dt)
        alone._pace = self._pace
        return alone

    def _between(self, kept: float, wanted: float, q: Vector, v: Vector) -> float:
        """The pace nearest to `wanted` that the accelerations allow, from the pace `kept`, which they do."""
        rates, beyond = self.reference.rates(self.dt), self._velocity(kept, q) - v
        towards = rates if wanted > kept else -rates
        room = np.where(towards > 0.0, self._change - beyond, self._change + beyond)
        moving = np.abs(rates) > _STILL
        most = float(np.min(room[moving] / np.abs(rates[moving]), initial=abs(wanted - kept)))
        for part in _PARTS:  # velocities are nearly linear in the pace
            pace = kept + math.copysign(part * max(most, 0.0), wanted - kept)
            if self._allows(pace, q, v):
                return pace
        return kept

    def _allows(self, pace: float, q: Vector, v: Vector) -> bool:
        return bool((np.abs(self._velocity(pace, q) - v) <= self._change).all())

    def _velocity(self, pace: float, q: Vector) -> Vector:
        """(n,) from q (n,) to the place on the track that is a step further at a pace [rad/s or m/s]."""
        limits = self._limits
        ahead = self.reference.at(self.reference.clock + pace * self.dt)
        # as np.clip, which takes three times as long for a few joints
        found = (np.minimum(np.maximum(ahead, limits.lower), limits.upper) - q) / self.dt
        found = np.minimum(np.maximum(found, -limits.velocity), limits.velocity)
        return found if float(np.abs(found).max()) > _STILL else np.zeros_like(found)
