"""A motion that brakes along its own path.

The corners of the motion are rounded off by parabolas, so that q(s), with the motion's own time s, has no greater
accelerations than the motion's samples. From a moment on the clock s goes slower and slower:

    s_{k+1} = s_k + p_{k+1} h,      1 >= p_k >= p_{k+1} >= 0,

with the least pace p for which the change of the joint velocities over each step h keeps the accelerations. A pace that
stays the same always keeps them, as the accelerations are then p^2 times those of the motion; so the least pace
of one step leaves one for the next. The same holds for torques: at a pace that stays the same they are between those
of the motion and those that hold the machine still.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion.smooth_way import SmoothWay
from backhoe_planner.motion.timing.drive import SLOWED_TO, Drive
from backhoe_planner.motion.trajectory import SAMPLE_PERIOD, Trajectory

_PACES = np.linspace(0.0, 1.0, 17)  # parts of an interval of paces that are tried together; chosen
_NARROWINGS = 3  # of that interval: to 1 / 4096 of the pace before
_ROOMY = 0.9  # chosen: at a lower pace 0.19 of the accelerations are free
_FADING = (1.0, 0.85, 0.5, 0.15, 0.0)  # chosen, for each step from then on: changes use 0.025 of the accelerations
_SLOWEST = 20.0  # s; chosen: a motion that would take longer to stop is not braked
_WITHIN = 1e-7  # part of a limit: rounding


def brake_along(
    motion: Trajectory, moment: float, limits: JointLimits, *, drive: Drive | None = None
) -> Trajectory | None:
    """The motion up to `moment` [s], then braked along itself as hard as the limits of the joints allow.

    It ends at rest, at the latest where the motion ends. At the first sample at or behind `moment` the rounded path
    misses the motion by up to the `chord_sagitta`; what is braked is beside the path by as much until it is slow enough
    to come back to it.

    Parameters
    ----------
    drive: of the joints; None for no limits other than those of the joints. Where the load cannot be held at rest,
        torques are exceeded as little as possible.

    Returns
    -------
    None if the motion itself exceeds the accelerations, or if it does not come to rest within 20 s.
    """
    row = min(int(np.searchsorted(motion.time, moment - 1e-9)), len(motion) - 1)
    braked = _brake(motion, row, limits, None)
    if braked is None or drive is None or not drive.limited:
        return braked
    if _use(drive, braked.part(max(row - 1, 0), len(braked) - 1)) <= 1.0 + SLOWED_TO:
        return braked
    return _brake(motion, row, limits, drive)


def _brake(motion: Trajectory, row: int, limits: JointLimits, drive: Drive | None) -> Trajectory | None:
    """The same from the sample `row` on, whatever the use of a `drive` that is not given."""
    path, start = _rounded(motion), float(motion.time[row])
    end = float(path.stations[-2] + path.cuts[-2])  # from there on it is at rest
    step = min(start - float(motion.time[row - 1]), SAMPLE_PERIOD) if row else SAMPLE_PERIOD
    velocity = motion.segment_velocities()[row - 1] if row else np.zeros(motion.q.shape[1])
    change = limits.acceleration * step * (1.0 + _WITHIN)  # of the velocities from one step to the next
    beside = motion.q[row] - path(start)
    own, pace, slow, q = start, 1.0, 0, [motion.q[row]]
    while own < end and not _can_rest(q[-1], velocity, change, step, drive):
        lower, upper = 0.0, pace
        for _ in range(_NARROWINGS):
            paces = lower + _PACES * (upper - lower)
            places = path(np.minimum(own + paces * step, path.length)) + _FADING[slow] * beside
            after = (places - q[-1]) / step
            kept = np.all(np.abs(after - velocity) <= change, axis=1)
            if not kept.any():
                return None
            if drive is not None:
                kept = _keeping(drive, q[-1], velocity, after, step, kept)
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


def _can_rest(q: Vector, velocity: Vector, change: Vector, step: float, drive: Drive | None) -> bool:
    """Whether the joints, with `velocity` (n,) up to `q` (n,), can be at rest from there on.

    Half a change is left for a motion that begins where this one ends.
    """
    if np.any(np.abs(velocity) > 0.5 * change):
        return False
    if drive is None:
        return True
    still, held = np.zeros((1, len(q))), q[None]
    at_rest = float(np.max(drive.ratios(held, still, still)))
    stopping = float(np.max(drive.ratios(held, 0.5 * velocity[None], -2.0 * velocity[None] / step)))
    return stopping <= max(1.0 + SLOWED_TO, at_rest)


def _keeping(drive: Drive, q: Vector, before: Vector, after: Matrix, step: float, kept: Flags) -> Flags:
    """(K,) which velocities `after` (K, n) also keep the limits of the `drive`, or the one that exceeds them least."""
    uses = np.max(drive.ratios(np.tile(q, (len(after), 1)), 0.5 * (before + after), (after - before) / step), axis=1)
    return np.asarray(kept & (uses <= max(1.0 + SLOWED_TO, float(np.min(uses[kept])))))


def _use(drive: Drive, motion: Trajectory) -> float:
    """The greatest use of the drive."""
    return drive.use_along(motion.moments(longest=np.inf)).most


def _rounded(motion: Trajectory) -> SmoothWay:
    """The motion with parabolas as corners, each over at most half a segment on either side, and at rest behind it."""
    time = np.append(motion.time, motion.time[-1] + SAMPLE_PERIOD)
    steps = np.diff(time)
    cuts = np.zeros(len(time))
    cuts[1:-1] = 0.5 * np.minimum(np.minimum(steps[:-1], steps[1:]), SAMPLE_PERIOD)
    return SmoothWay(np.vstack((motion.q, motion.q[-1:])), time, cuts)
