"""Two motions joined, with a stop between them or without one.

Without a stop, the second begins while the first still slows down. During the time tau in which both move, the joints
are at

    q(t) = q_1(t) + q_2(t - t_2) - q_E,        t_2 = T_1 - tau,

with q_E where the first ends and the second begins. The velocities add up, and so do the accelerations;
where the sum exceeds a joint limit, the motion is slowed down, as little as possible. The
joints do not pass through q_E: the shorter tau, the nearer they come.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion.timing.path_limits import PathShape, time_path
from backhoe_planner.motion.timing.time_optimal import TimeLaw
from backhoe_planner.motion.trajectory import SAMPLE_PERIOD, Trajectory

_CLOSE = 0.4  # part of the time between samples; chosen: of two samples that are closer, one is left out
_TIGHTER = 1.01  # factor; chosen: samples show up to some percent more than the law between them
_MOST_TIGHTER = 1.1  # the greatest such factor in one round
_ROUNDS = 12  # chosen: excesses at the edge of the slowed part appear one after the other
_ELSEWHERE = 0.999  # chosen, so that a motion at its limits counts as within them
_BESIDE = 3  # samples before and behind an excess that are slowed too; chosen
_WITHIN = 1e-7  # part of a limit: rounding
_ROUNDING = 1e-9  # s


def append_motion(first: Trajectory, second: Trajectory, *, rest: Sequence[float] | Vector = ()) -> Trajectory:
    """The first motion, then the second, with a stop between them; see `join_at_stops` for the `rest`."""
    return join_at_stops((first, second), (rest,))


def join_at_stops(motions: Sequence[Trajectory], rests: Sequence[Sequence[float] | Vector]) -> Trajectory:
    """Motions one after the other, with a stop between each two; of the first, the beginnings of legs are kept.

    Parameters
    ----------
    motions: from rest to rest; each begins where the one before ends.
    rests: for each stop, samples at which the machine rests, in time after the end of the motion before [s], ascending;
        the next motion begins at the last of them, or, without any, where the one before ends.
    """
    time, q, end, place = [motions[0].time], [motions[0].q], motions[0].time[-1], motions[0].q[-1:]
    for motion, rest in zip(motions[1:], rests, strict=True):
        stops = end + np.asarray(rest, dtype=float)
        begins, own = (stops[-1], slice(0, None)) if len(stops) else (end, slice(1, None))
        time += [stops[:-1], begins + motion.time[own]]
        q += [np.repeat(place, max(len(stops) - 1, 0), axis=0), motion.q[own]]
        end, place = begins + motion.time[-1], motion.q[-1:]
    return Trajectory.from_steps(np.concatenate(time), np.vstack(q), begins=motions[0].begins)


def overlap(first: Trajectory, second: Trajectory, duration: float) -> tuple[Trajectory, slice]:
    """The joined motion, the second begun `duration` [s] before the first ends, and the samples in which both move.

    Parameters
    ----------
    first, second: from rest to rest; the second begins where the first ends; neither is shorter than `duration`.
    """
    begins = first.duration - duration
    before = first.time < begins
    shared = first.time[~before]
    gap = _CLOSE * float(np.min(np.diff(first.time[-2:]), initial=np.inf))
    if before.any() and shared[0] - first.time[before][-1] < gap:
        before[np.count_nonzero(before) - 1] = False
        shared = first.time[~before]
    own = second.time + begins
    after = own > first.duration + gap
    q = first.q[~before] + _smooth(second, shared - begins) - second.q[0]
    time = np.concatenate((first.time[before], shared, own[after]))
    motion = Trajectory.from_steps(
        time, np.vstack((first.q[before], q, second.q[after])), begins=first.begins
    )  # fmt: skip
    return motion, slice(int(np.count_nonzero(before)), int(np.count_nonzero(before)) + len(shared))


def _smooth(motion: Trajectory, time: Vector) -> Matrix:
    """(K, n) the joints at `time` (K,) [s], by cubics between the samples; at rest before the start."""
    t, q, v = motion.time, motion.q, motion.v
    time = np.clip(time, 0.0, t[-1])
    row = np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2)
    h = (t[row + 1] - t[row])[:, None]
    s = ((time - t[row])[:, None]) / h
    cubic: Array = (
        (1.0 + 2.0 * s) * (1.0 - s) ** 2 * q[row] + s * (1.0 - s) ** 2 * h * v[row]
        + s**2 * (3.0 - 2.0 * s) * q[row + 1] + s**2 * (s - 1.0) * h * v[row + 1]
    )  # fmt: skip
    return np.asarray(cubic)


def slow_where_needed(motion: Trajectory, shared: slice, limits: JointLimits) -> tuple[Trajectory, slice] | None:
    """The motion on the same joint path, slower where joints exceed a limit among the samples `shared`.

    Returns
    -------
    The motion, and its samples that are on the same part of the path; None if no such motion is found.
    """
    if float(np.max(_use(motion, limits))) <= 1.0 + _WITHIN:
        return motion, shared
    segment, v, a = motion.segment_velocities(), motion.v.copy(), motion.accelerations()
    v[0], v[-1] = segment[0], segment[-1]
    a[0], a[-1] = a[1], a[-2]
    # a slope steeper by a factor has the effect of tighter limits; a motion just at its limits keeps its speed
    factor = np.full((len(motion), 1), _ELSEWHERE)
    factor[max(shared.start - _BESIDE, 0) : shared.stop + _BESIDE] = _TIGHTER
    for _ in range(_ROUNDS):
        shape = PathShape(motion.time, motion.q, factor * v, (factor * a)[:-1], (factor * a)[1:])
        law = time_path(shape, limits, drive=None, most=1.0, rests=False)
        if law is None:
            return None
        found = _with_law(motion, law, shared)
        over = _use(found[0], limits)
        wrong = np.flatnonzero(over > 1.0 + _WITHIN)
        if not len(wrong):
            return found
        for row in wrong.tolist():
            place = int(np.searchsorted(law.time, float(found[0].time[row])))
            beside = slice(max(place - _BESIDE, 0), place + _BESIDE + 1)
            factor[beside] = np.maximum(factor[beside], min(over[row], _MOST_TIGHTER) * _TIGHTER)
    return None


def _with_law(motion: Trajectory, law: TimeLaw, shared: slice) -> tuple[Trajectory, slice]:
    """The motion with the times of a time law, and new samples where it is slower."""
    slow = np.flatnonzero(np.diff(law.time) > np.diff(motion.time) * (1.0 + _WITHIN))
    if not len(slow):
        return motion, shared
    first, last = int(slow[0]), int(slow[-1]) + 1
    count = max(int(np.ceil((law.time[last] - law.time[first]) / SAMPLE_PERIOD)), 1)
    inner = np.linspace(law.time[first], law.time[last], count + 1)[1:-1]
    # samples before and behind keep their time steps to the last digit
    behind = law.time[last] + (motion.time[last:] - motion.time[last])
    time = np.concatenate((motion.time[: first + 1], inner, behind))
    q = np.vstack((motion.q[: first + 1], _smooth(motion, np.asarray(law.at(inner))), motion.q[last:]))
    ends = [
        int(np.searchsorted(time, float(law.time[row]) - 1e-9))
        for row in (shared.start, min(shared.stop, len(motion)) - 1)
    ]
    return Trajectory.from_steps(time, q), slice(ends[0], ends[1] + 1)


def _use(motion: Trajectory, limits: JointLimits) -> Vector:
    """(T,) the greatest use of a limit of the joints at every sample."""
    velocity = np.max(np.abs(motion.segment_velocities()) / limits.velocity, axis=1)
    acceleration = np.max(np.abs(motion.corner_accelerations()) / limits.acceleration, axis=1)
    return np.asarray(np.maximum(acceleration, np.maximum(np.append(velocity, 0.0), np.append(0.0, velocity))))
