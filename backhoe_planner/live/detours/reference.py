"""The reference for following a motion: smooth between its samples, with a clock of its own.

Between the samples of a trajectory the joints move linearly, so their rates jump at every
sample. A machine cannot follow such jumps. The reference has the rate of each segment in the
middle of that segment, is at rest at both ends and where the motion rests, and its rates change linearly in between. No
acceleration is greater than the certified ones (`Trajectory.accelerations`), so a machine can
follow it exactly. At a corner it leaves the straight lines by a T^2 / 8 (`chord_sagitta`); the
position error that remains at the end is spread evenly over the motion. If the samples are too
far apart for that, the straight lines are followed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Trajectory, chord_sagitta

_LARGEST_CUT = 4.0  # times the sagitta: a corner, half a corner at both ends, and as much again for uneven samples
_ROUNDING = 1e-9  # part of the acceleration


class _Pieces(NamedTuple):
    """A motion of constant acceleration from knot to knot.

    Attributes
    ----------
    time: (K,) of the knots [s].
    q, v, a: (K, n) position and velocity at each knot, and acceleration from there on [rad or m, and per s, s^2].
    """

    time: Vector
    q: Matrix
    v: Matrix
    a: Matrix

    def at(self, time: float) -> Vector:
        """(n,) joint positions at `time` [s], not before the first knot."""
        row = int(self.time.searchsorted(time, side="right")) - 1
        since = time - float(self.time[row])
        return np.asarray(self.q[row] + since * (self.v[row] + 0.5 * since * self.a[row]))


class Clocked(ABC):
    """A motion with a clock.

    Attributes
    ----------
    clock: the time along the motion that has been reached [s]; may be set.
    end: of the motion [s].
    """

    clock: float
    end: float

    @property
    def ended(self) -> bool:
        """Whether the clock has reached the end."""
        return self.clock >= self.end

    @property
    def q(self) -> Vector:
        """(n,) joint positions at the clock's time [rad or m]."""
        return self.at(self.clock)

    @property
    @abstractmethod
    def last_q(self) -> Vector:
        """(n,) joint positions at the end [rad or m]."""

    def rates(self, dt: float) -> Vector:
        """(n,) mean rates over the next `dt` [rad/s or m/s]."""
        return (self.at(self.clock + dt) - self.at(self.clock)) / dt

    def advance(self, by: float) -> None:
        """Advance the clock `by` [s], to the end at most."""
        self.clock = min(self.clock + by, self.end)

    @abstractmethod
    def at(self, time: float) -> Vector:
        """(n,) joint positions at `time` [s] of the motion [rad or m]; those at the end from there on."""

    def lag(self, q: Vector, v: Vector, dt: float) -> float:
        """How far a machine at q, v (n,) is behind or beside the motion [rad or m]; the clock must wait for that.

        A machine that is ahead does not lag: if the clock waited for it, it would demand harder braking of a machine
        that brakes as hard as it can, which would run further ahead. As long as it still runs on along the motion,
        and going on brings the motion nearer to it, what it is beside the motion does not count either: the motion
        bends, and the machine brakes straight ahead.

        dt: length of a step [s].
        """
        missing, rates = self.q - q, self.rates(dt)
        along = float(missing @ rates)
        if along < 0.0:
            if float(v @ rates) > 0.0:
                return 0.0
            missing = missing - (along / float(rates @ rates)) * rates
        return float(np.abs(missing).max())


class Reference(Clocked):
    """A motion with a clock, from rest to rest.

    Parameters
    ----------
    limits: of the machine that follows it.

    Attributes
    ----------
    clock: the time along the motion that has been reached [s]; may be set.
    end: of the motion [s].
    keeps_limits: whether no acceleration is greater than the machine's.
    """

    def __init__(self, motion: Trajectory, limits: JointLimits) -> None:
        self.clock, self.end = 0.0, float(motion.time[-1])
        self._motion = motion
        self._pieces = straight = _straight(motion)
        most = (1.0 + _ROUNDING) * limits.acceleration
        if len(motion) > 2:
            smooth = _smooth(motion)
            cut = np.abs([smooth.at(moment) for moment in motion.time.tolist()] - motion.q).max(axis=0)
            if (cut <= _LARGEST_CUT * chord_sagitta(limits)).all():
                self._pieces = smooth
        self.keeps_limits = self._pieces is not straight and bool((np.abs(self._pieces.a) <= most).all())

    @property
    def last_q(self) -> Vector:
        """(n,) joint positions at the end [rad or m]."""
        return np.asarray(self._motion.q[-1])

    @property
    def knots(self) -> Vector:
        """(K,) the times [s] between which the accelerations are constant, rising."""
        return self._pieces.time

    def changes_at(self, time: float) -> tuple[Vector, Vector]:
        """(n,) rates [rad/s or m/s] and (n,) accelerations [per s^2] at `time` [s], not before the first knot."""
        row = int(self._pieces.time.searchsorted(time, side="right")) - 1
        a = self._pieces.a[row]
        return self._pieces.v[row] + (time - float(self._pieces.time[row])) * a, a

    def largest_accelerations(self, since: float, until: float) -> Vector:
        """(n,) the largest accelerations between two times [s], without their signs [rad/s^2 or m/s^2]."""
        first, last = self._pieces.time.searchsorted((since, until), side="right") - 1
        return np.asarray(np.abs(self._pieces.a[max(int(first), 0) : int(last) + 1]).max(axis=0))

    def rest(self) -> Matrix:
        """(K, n) the samples after the clock's time."""
        return np.asarray(self._motion.q[int(self._motion.time.searchsorted(self.clock, side="right")) :])

    def at(self, time: float) -> Vector:
        """(n,) joint positions at `time` [s] of the motion [rad or m]; those at the end from there on."""
        return self.last_q if time >= self.end else self._pieces.at(time)


def _straight(motion: Trajectory) -> _Pieces:
    """The motion unchanged: linear between the samples."""
    still = np.zeros_like(motion.q)
    return _Pieces(motion.time, motion.q, np.vstack((motion.segment_velocities(), still[-1:])), still)


def _smooth(motion: Trajectory) -> _Pieces:
    """The motion with rates that are linear in time between the middles of the segments, at rest where it rests."""
    rates = motion.segment_velocities()
    rests = np.asarray(~rates.any(axis=1))
    changes = np.flatnonzero(np.diff(rests)) + 1
    parts = [
        _still(motion, first) if rests[first] else _moving(motion.time[first : last + 1], motion.q[first : last + 1])
        for first, last in pairwise([0, *changes.tolist(), len(rests)])
    ]
    end = _still(motion, len(rests))
    return _Pieces(*(np.concatenate(column) for column in zip(*parts, end, strict=True)))


def _still(motion: Trajectory, row: int) -> _Pieces:
    """At rest from a sample of the motion on."""
    q = motion.q[row : row + 1]
    return _Pieces(motion.time[row : row + 1], q, np.zeros_like(q), np.zeros_like(q))


def _moving(time: Vector, q: Matrix) -> _Pieces:
    """Through samples at `time` (K,) and `q` (K, n), from rest to rest, without the last knot."""
    rates, rest = np.diff(q, axis=0) / np.diff(time)[:, None], np.zeros((1, q.shape[1]))
    knots = np.concatenate((time[:1], 0.5 * (time[1:] + time[:-1]), time[-1:]))
    v, spans = np.vstack((rest, rates, rest)), np.diff(knots)[:, None]
    at = q[0] + np.vstack((rest, np.cumsum(0.5 * spans * (v[1:] + v[:-1]), axis=0)))
    missing = (q[-1] - at[-1]) / (time[-1] - time[0])
    at += (knots - time[0])[:, None] * missing
    return _Pieces(knots[:-1], at[:-1], v[:-1] + missing, np.diff(v, axis=0) / spans)
