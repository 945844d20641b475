"""A motion of the law made as fast as the machine allows, along its own way.

The law goes step by step and asks for no more speed than it can brake from at any moment.
Its way is a curve in joint space all the same: here a smooth one is laid through places on
it, timed anew within all limits, and taken where every segment of it is proven clear.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem, Trajectory, drive_of, limit_usage, retime, time_along, time_polyline
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Proximity

# s of the slowest joint between places, tried in turn: the closer, the nearer to the law's way;
# chosen, down to the period of a motion's samples
_SPACINGS = (0.1, 0.05, 0.02)
_FEWEST = 4  # intervals between places at least; chosen: fewer do not bend a curve
_INTERVALS = 300  # of a way, at whose ends limits are looked at; chosen to be quick, the certificate looks at all
_LEAST_ITERATION = 1e-6  # s of the slowest joint: an iteration that moves less is at the same place
_MOST_HASTE = 1e3  # times as fast; chosen above what any law leaves unused, for machines without limits
_HALVINGS = 12  # of a factor of 2; chosen: what is left unused is below a thousandth
_GAIN = 0.01  # part of the time; chosen: for less a motion is left as it is


def speed_up(begun: Stepper, arrived: Stepper) -> Stepper:
    """The same way from rest to rest in less time; `arrived` itself where no faster motion is proven clear.

    Where anything moves or appears, the proof holds for these times alone: they stay.

    Parameters
    ----------
    begun: the motion up to where the law's way begins, at rest.
    arrived: the same motion with the law's way after it, at rest.
    """
    problem, motion = begun.problem, arrived.trajectory()
    first = int(np.searchsorted(motion.time, begun.time - 1e-9))
    if problem.is_dynamic or len(motion) - first < 3:
        return arrived
    limits, drive = problem.limits, drive_of(problem)
    q, took = motion.q[first:], motion.time[-1] - motion.time[first]
    for spacing in _SPACINGS:
        along, places = places_on(q, limits.velocity, spacing)
        if len(along) < 2:
            return arrived
        quick = time_along(along, places, limits, drive=drive, intervals=_INTERVALS)
        if quick.duration > (1.0 - _GAIN) * took:
            # the law runs the joints at rates that all of them together may not have
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
    """The same samples in less time throughout, as far as the limits let all of them; itself where that is no gain."""
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
    """The greatest part of any limit that is used at any time."""
    return float(np.max(limit_usage(problem, motion, tip_speed=False).ratio))


def time_iterates(problem: Problem, q: Matrix, *, proximity: Proximity) -> Trajectory:
    """The fastest motion along a smooth curve through the iterates q (K, n) of a law, from rest to rest.

    What lies between two iterates the law leaves open. Where the straight way there is clear and the curve is
    not, one that lies nearer to the straight way is taken, or that way itself in one slow ramp.
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
