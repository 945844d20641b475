"""Makes a motion of the law as fast as the machine allows, along the same joint-space curve.

The law goes step by step, and never faster than it can brake from at any moment. Its motion
nevertheless follows a curve in joint space: a smooth curve through places on it is timed anew
within all limits, and used if every segment of it is proven clear.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem, Trajectory, drive_of, limit_usage, retime, time_along, time_polyline
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Proximity

# s of the slowest joint between places, tried in turn: closer places stay nearer to the law's curve;
# chosen, down to the period of a motion's samples
_SPACINGS = (0.1, 0.05, 0.02)
_FEWEST = 4  # intervals between places at least; chosen: fewer do not bend a curve
_INTERVALS = 300  # of a curve, at whose ends limits are checked; chosen to be quick: the certificate checks all
_LEAST_ITERATION = 1e-6  # s of the slowest joint: an iteration that moves less counts as the same place
_MOST_HASTE = 1e3  # times as fast; chosen, above what any law leaves unused, for machines without limits
_HALVINGS = 12  # of a factor of 2; chosen: less than a thousandth is left unused
_GAIN = 0.01  # part of the time; chosen: for a smaller gain a motion is not changed


def speed_up(begun: Stepper, arrived: Stepper) -> Stepper:
    """The law's part from rest to rest in less time; `arrived` itself if no faster motion is proven clear.

    If anything moves or appears of that which `begun` is among, the proof holds only for the present times, so they
    are not changed.

    Parameters
    ----------
    begun: the motion up to where the law's part begins, at rest.
    arrived: the same motion with the law's part after it, at rest.
    """
    problem, motion = begun.problem, arrived.trajectory()
    first = int(np.searchsorted(motion.time, begun.time - 1e-9))
    is_dynamic = any(obstacle.is_dynamic for obstacle in begun.proximity.obstacles)
    if is_dynamic or len(motion) - first < 3:
        return arrived
    limits, drive = problem.limits, drive_of(problem)
    q, took = motion.q[first:], motion.time[-1] - motion.time[first]
    for spacing in _SPACINGS:
        along, places = places_on(q, limits.velocity, spacing)
        if len(along) < 2:
            return arrived
        quick = time_along(along, places, limits, drive=drive, intervals=_INTERVALS)
        if quick.duration > (1.0 - _GAIN) * took:
            # the law may run the joints at rates that the drive does not allow for all of them together
            own = Trajectory.from_steps(motion.time[first:] - motion.time[first], q)
            took = retime(own, limits, drive=drive).duration
            if quick.duration > (1.0 - _GAIN) * took:
                continue
        if all(segment_is_clear(begun.proximity, a, b, time=begun.time) for a, b in pairwise(quick.q)):
            branch = begun.branch(attempt=arrived.attempt)
            branch.play(quick)
            return branch
    return _hastened(begun, arrived, first)


def _hastened(begun: Stepper, arrived: Stepper, first: int) -> Stepper:
    """The same samples faster by one factor, as far as the limits allow; `arrived` itself if that gains nothing."""
    motion = arrived.trajectory()
    own = Trajectory.from_steps(motion.time[first:] - motion.time[first], motion.q[first:])

    def faster(factor: float) -> Trajectory:
        return Trajectory.from_steps(own.time / factor, own.q)

    kept, over = 1.0, 2.0
    while over <= _MOST_HASTE and _use(begun.problem, faster(over)) <= 1.0:
        kept, over = over, 2.0 * over
    for _ in range(_HALVINGS):
        middle = 0.5 * (kept + over)
        kept, over = (middle, over) if _use(begun.problem, faster(middle)) <= 1.0 else (kept, middle)
    if kept < 1.0 + _GAIN:
        return arrived
    branch = begun.branch(attempt=arrived.attempt)
    branch.play(faster(kept))
    return branch


def _use(problem: Problem, motion: Trajectory) -> float:
    """The largest use of any limit at any time, as a part of the limit."""
    return float(np.max(limit_usage(problem, motion, tip_speed=False).ratio))


def time_iterates(problem: Problem, q: Matrix, *, proximity: Proximity) -> Trajectory:
    """The fastest motion along a smooth curve through the iterates q (K, n) of a law, from rest to rest.

    The law does not say what happens between two iterates. If the straight line between them is clear and the curve is
    not, a curve nearer to the line is used, or the line itself in one slow ramp.
    """
    limits, drive = problem.limits, drive_of(problem)
    straight = retime(time_polyline(q, limits), limits, drive=drive)
    clear = _is_clear(proximity, q)
    moved = np.max(np.abs(np.diff(q, axis=0)) / np.where(np.isfinite(limits.velocity), limits.velocity, 1.0), axis=1)
    rows = np.concatenate(([True], moved > _LEAST_ITERATION))
    along = np.concatenate(([0.0], np.cumsum(moved)))[rows]
    for stations, places in ((along, np.vstack((q[rows][:-1], q[-1:]))), places_on(q, limits.velocity, _SPACINGS[-1])):
        if len(stations) < 2:
            break
        curved = time_along(stations, places, limits, drive=drive)
        if curved.duration < straight.duration and (not clear or _is_clear(proximity, curved.q)):
            return curved
    return straight


def _is_clear(proximity: Proximity, q: Matrix) -> bool:
    return all(segment_is_clear(proximity, a, b) for a, b in pairwise(q))


def places_on(q: Matrix, rate: Vector, spacing: float) -> tuple[Vector, Matrix]:
    """(K,) stations [s] and (K, n) places on the polyline through q (T, n), evenly along it, with both ends.

    Parameters
    ----------
    rate: (n,) velocity limits [rad/s or m/s]; a segment is as long as the slowest joint takes for it [s].
    spacing: between neighbouring places at most [s].
    """
    finite = np.where(np.isfinite(rate), rate, 1.0)
    steps = np.max(np.abs(np.diff(q, axis=0)) / finite, axis=1)
    moving = np.concatenate(([True], steps > 1e-9))
    along = np.concatenate(([0.0], np.cumsum(steps)))[moving]
    corners = np.array(q[moving])
    corners[-1] = q[-1]
    if len(along) < 2:
        return np.zeros(1), q[-1:]
    places = np.linspace(0.0, along[-1], max(int(np.ceil(along[-1] / spacing)), _FEWEST) + 1)
    return places, np.column_stack([np.interp(places, along, column) for column in corners.T])
