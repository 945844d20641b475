"""A motion that brakes along its own path.

The corners of the motion are rounded off by parabolas, so that q(s), with the motion's own time s, has no greater
accelerations than the motion's samples. From a moment on the clock s goes slower and slower:

    s_{k+1} = s_k + p_{k+1} h,      1 >= p_k >= p_{k+1} >= 0,

with the least pace p for which the change of the joint velocities over each step h keeps the accelerations. A pace that
stays the same always keeps them, as the accelerations are then p^2 times those of the motion; so the least pace
of one step leaves one for the next.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion.trajectory import SAMPLE_PERIOD, Trajectory

_PACES = np.linspace(0.0, 1.0, 17)  # parts of an interval of paces that are tried together; chosen
_NARROWINGS = 3  # of that interval: to 1 / 4096 of the pace before
_ROOMY = 0.9  # chosen: at a lower pace 0.19 of the accelerations are free
_FADING = (1.0, 0.85, 0.5, 0.15, 0.0)  # chosen, for each step from then on: changes use 0.025 of the accelerations
_SLOWEST = 20.0  # s; chosen: a motion that would take longer to stop is not braked
_WITHIN = 1e-7  # part of a limit: rounding


def brake_along(motion: Trajectory, moment: float, limits: JointLimits) -> Trajectory | None:
    """The motion up to `moment` [s], then braked along itself as hard as the accelerations of the joints allow.

    It ends at rest, at the latest where the motion ends. At the first sample at or behind `moment` the rounded path
    misses the motion by up to the `chord_sagitta`; what is braked is beside the path by as much until it is slow enough
    to come back to it.

    Returns
    -------
    None if the motion itself exceeds the accelerations, or if it does not come to rest within 20 s. Only accelerations
    are looked at, not torques, flow and power.
    """
    path, row = _RoundedPath(motion), min(int(np.searchsorted(motion.time, moment - 1e-9)), len(motion) - 1)
    start = float(motion.time[row])
    step = min(start - float(motion.time[row - 1]), SAMPLE_PERIOD) if row else SAMPLE_PERIOD
    velocity = motion.segment_velocities()[row - 1] if row else np.zeros(motion.q.shape[1])
    change = limits.acceleration * step * (1.0 + _WITHIN)  # of the velocities from one step to the next
    beside = motion.q[row] - path.at(np.array([start]))[0]
    own, pace, slow, q = start, 1.0, 0, [motion.q[row]]
    # half a change is left for a motion that begins where this one ends
    while own < path.end and np.any(np.abs(velocity) > 0.5 * change):
        lower, upper = 0.0, pace
        for _ in range(_NARROWINGS):
            paces = lower + _PACES * (upper - lower)
            places = path.at(own + paces * step) + _FADING[slow] * beside
            kept = np.all(np.abs((places - q[-1]) / step - velocity) <= change, axis=1)
            if not kept.any():
                return None
            best = int(np.argmax(kept))
            lower, upper, place = float(paces[max(best - 1, 0)]), float(paces[best]), places[best]
        pace = upper
        if len(q) * step > _SLOWEST:
            return None
        slow += pace < _ROOMY and slow < len(_FADING) - 1
        own, velocity = own + pace * step, (place - q[-1]) / step
        q.append(place)
    time = np.concatenate((motion.time[:row], start + step * np.arange(len(q))))
    return Trajectory.from_steps(time, np.vstack((motion.q[:row], q)))


class _RoundedPath:
    """A motion with parabolas instead of corners; each extends over at most half a segment on either side."""

    def __init__(self, motion: Trajectory) -> None:
        rest = SAMPLE_PERIOD  # before the start and behind the end
        steps = np.concatenate(([rest], np.diff(motion.time), [rest]))
        self._motion = motion
        self._half = 0.5 * np.minimum(np.minimum(steps[:-1], steps[1:]), SAMPLE_PERIOD)
        self._bend = 0.25 * motion.velocity_changes() / self._half[:, None]
        self._middle = 0.5 * (motion.time[:-1] + motion.time[1:])
        self.end = float(motion.time[-1] + self._half[-1])

    def at(self, time: Vector) -> Matrix:
        """(K, n) joint positions at the motion's own times (K,) [s]."""
        corner = np.searchsorted(self._middle, time)
        inside = np.maximum(self._half[corner] - np.abs(time - self._motion.time[corner]), 0.0)
        return np.asarray(self._motion.at(time) + self._bend[corner] * inside[:, None] ** 2)
