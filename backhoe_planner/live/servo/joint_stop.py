"""Stops in which every joint slows down at a constant rate of its own, whatever path that leads along."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector

_PLACES = 25  # on the way to rest; chosen, between them it is nearly straight
_STRETCHED = (0.0, 0.25, 0.5, 1.0)  # parts of the way from each joint's own shortest time to rest to the longest of all

STRAIGHT = len(_STRETCHED) - 1  # key of the stop of all joints at once, which is straight


class JointStop:
    """A machine that stops with a constant deceleration of each joint.

    Parameters
    ----------
    slowing: (n,) decelerations [rad/s^2 or m/s^2].
    dt: length of a step [s].
    """

    def __init__(self, slowing: Vector, dt: float) -> None:
        self._slowing, self._dt = slowing, dt

    def slower(self, _: Vector, v: Vector) -> Vector:
        """(n,) the velocity of the step after v (n,) [rad/s or m/s]."""
        change = self._slowing * self._dt
        return v - np.clip(v, -change, change)

    def advance(self) -> None:
        """Do nothing: what is left of the stop follows from the velocity."""

    def way_to_rest(self, q: Vector, v: Vector) -> tuple[Matrix, Vector]:
        """(K, n) where a machine at q, v (n,) is while it stops, from the next step on, and (K,) when [s]."""
        rest = np.abs(v) / np.where(self._slowing > 0.0, self._slowing, np.inf)
        times = np.linspace(0.0, float(rest.max()), _PLACES)
        # the step that stops a joint does so at once: what is left of its time before does not move it
        since = np.minimum(times[:, None], self._dt * np.floor(rest / self._dt))
        return np.asarray(q + since * (v - 0.5 * np.sign(v) * self._slowing * (since + self._dt))), times


def stops_from(v: Vector, acceleration: Vector, dt: float) -> dict[int, JointStop]:
    """Different stops from v (n,): no joint slows down faster than its acceleration (n,), nor later than the last one.

    First all joints stop as soon as they can, then all of them later, up to all at once, then single ones later. The
    keys say which is which, also at another velocity: from 0 on for all joints, then one for each joint. The joint that
    takes longest to stop has no stop of its own.
    """
    own = np.abs(v) / acceleration
    longest = float(own.max())
    times = {number: own + part * (longest - own) for number, part in enumerate(_STRETCHED)}
    later = [joint for joint in range(len(v)) if own[joint] < longest]
    for joint in later if len(later) > 1 else ():
        times[len(_STRETCHED) + joint] = np.where(np.arange(len(v)) == joint, longest, own)
    return {key: JointStop(np.abs(v) / np.where(time > 0.0, time, 1.0), dt) for key, time in times.items()}
