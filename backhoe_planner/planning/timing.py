"""When to be where: joint positions along a path made into a motion from rest to rest.

The time-optimal speed along a smooth curve through the samples comes from toppra
(Pham and Pham 2018). A curve can exceed a limit between the points where toppra looks,
so what is sampled is checked, and slowed by as much as it is over.
"""

from __future__ import annotations

import itertools
import logging

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.robot import JointLimits
from backhoe_planner.planning.blending import PERIOD, SmoothWay
from backhoe_planner.planning.trajectory import Trajectory

__all__ = ["time_along", "time_polyline", "time_way"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_PERIOD = PERIOD  # s between samples
_SPARE = 0.999
_SAME_PLACE = 1e-9
_PER_PIECE = 12  # intervals of toppra on every leg and corner of a way
_LENGTH_OF_TURN = 0.1  # m that a radian counts as, so that the curve goes on where the tip stands


def time_along(
    stations: Vector, q: Matrix, limits: JointLimits, *, speed: float | None = None, period: float = _PERIOD
) -> Trajectory:
    """The fastest motion through samples of a joint path, from rest to rest.

    Parameters
    ----------
    stations: (K,) arc lengths of the tip [m], not decreasing: it may stand while the
        joints turn; q: (K, n) joints there.
    speed: of the tip along the path at most [m/s], None for no such limit.
    period: between the samples of the result [s].
    """
    if len(stations) < 2 or float(np.max(np.abs(np.diff(q, axis=0)))) < 1e-12:
        return Trajectory.from_steps(np.zeros(1), q[:1])
    turn = np.linalg.norm(np.diff(q, axis=0), axis=1)
    along = np.concatenate(([0.0], np.cumsum(np.maximum(np.diff(stations) + _LENGTH_OF_TURN * turn, 1e-6))))
    time, samples = _time_optimal(along, stations, q, limits, speed, period)
    for _ in range(4):
        trajectory = Trajectory.from_steps(time, samples)
        over = _over(trajectory, limits)
        if over <= 1.0:
            break
        time = time * over / _SPARE
    return trajectory


def _time_optimal(
    along: Vector, stations: Vector, q: Matrix, limits: JointLimits, speed: float | None, period: float
) -> tuple[Vector, Matrix]:
    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)
    # arc length rides along as one more coordinate, so that its rate is the tip's speed
    points = np.column_stack((q, stations))
    curve = toppra.SplineInterpolator(along, points, bc_type="not-a-knot" if len(along) > 3 else "natural")
    fastest = np.append(limits.velocity, 1e3 if speed is None else speed) * _SPARE
    hardest = np.append(limits.acceleration, 1e4) * _SPARE
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.column_stack((-fastest, fastest))),
        toppra.constraint.JointAccelerationConstraint(np.column_stack((-hardest, hardest))),
    ]
    grid = np.linspace(along[0], along[-1], max(2 * len(along) + 1, 101))
    solver = toppra.algorithm.TOPPRA(constraints, curve, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    timed = solver.compute_trajectory(0.0, 0.0)
    if timed is None:
        return _ramp(along, q, limits)  # a curve that toppra cannot time
    duration = float(timed.duration)
    time = np.linspace(0.0, duration, max(int(np.ceil(duration / period)) + 1, 3))
    samples = np.asarray(timed(time))[:, :-1]
    samples[0], samples[-1] = q[0], q[-1]
    # a spline may swing a little beyond a limit at which its samples stand
    samples = np.clip(samples, limits.lower, limits.upper)
    return time, samples


def time_polyline(q: Matrix, limits: JointLimits) -> Trajectory:
    """A motion straight from sample to sample of `q` (K, n), one smooth ramp slowed to fit.

    It keeps to the samples whatever their shape, and is far from time-optimal.
    """
    way = np.concatenate(([0.0], np.cumsum(np.max(np.abs(np.diff(q, axis=0)), axis=1))))
    if way[-1] < 1e-12:
        return Trajectory.from_steps(np.zeros(1), q[:1])
    time, samples = _ramp(way, q, limits)
    return Trajectory.from_steps(time, samples)


def _ramp(stations: Vector, q: Matrix, limits: JointLimits) -> tuple[Vector, Matrix]:
    part = np.linspace(0.0, 1.0, max(4 * len(stations), 50))
    along = stations[0] + (stations[-1] - stations[0]) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    samples = np.column_stack([np.interp(along, stations, column) for column in q.T])
    time = part * 10.0
    return time * _over(Trajectory.from_steps(time, samples), limits) / _SPARE, samples


def _over(trajectory: Trajectory, limits: JointLimits) -> float:
    """By how much time must be stretched so that every limit is kept."""
    velocity = float(np.max(np.abs(trajectory.segment_velocities()) / limits.velocity))
    acceleration = float(np.max(np.abs(trajectory.accelerations()) / limits.acceleration))
    return max(velocity, float(np.sqrt(acceleration)))


# --- ways with round corners ------------------------------------------------------


def time_way(way: SmoothWay, limits: JointLimits) -> Trajectory:
    """The fastest motion along a way, at rest at its ends and wherever it stops.

    The samples lie on the way. Between two of them the motion is straight: on the way
    on a leg, off it by at most `blending.chord_sagitta` on a corner. Where toppra finds
    no answer the motion goes into the corners and stops there.
    """
    if way.length == 0.0:
        return Trajectory.from_steps(np.zeros(1), way.corners[:1])
    times, samples = [np.zeros(1)], [way.corners[:1]]
    for begin, end in zip(way.stops[:-1], way.stops[1:], strict=True):
        for time, q in _parts(way, float(begin), float(end), limits):
            times.append(times[-1][-1] + time[1:])
            samples.append(q[1:])
    time, q = np.concatenate(times), np.vstack(samples)
    q[-1] = way.corners[-1]
    return Trajectory.from_steps(time * max(_over(Trajectory.from_steps(time, q), limits), 1.0), q)


def _parts(way: SmoothWay, begin: float, end: float, limits: JointLimits) -> list[tuple[Vector, Matrix]]:
    """Motions from rest to rest, one or several, from one stop of a way to the next."""
    inside = (way.stations > begin) & (way.stations < end)
    timed = _along_smooth(way, begin, end, limits) if inside.any() else None
    if timed is not None:
        return [timed]
    corners = way.corners[(way.stations >= begin) & (way.stations <= end)]
    return [_straight(a, b, limits) for a, b in itertools.pairwise(corners)]


def _straight(q_a: Vector, q_b: Vector, limits: JointLimits) -> tuple[Vector, Matrix]:
    """Speeding up, even speed, slowing down: the fastest straight motion from rest to rest."""
    dq = np.abs(q_b - q_a)
    moving = dq > 0.0
    rate = _SPARE * float(np.min(limits.velocity[moving] / dq[moving]))
    gain = _SPARE * float(np.min(limits.acceleration[moving] / dq[moving]))
    ramp = min(rate / gain, float(np.sqrt(1.0 / gain)))
    duration = 1.0 / (gain * ramp) + ramp
    time = _samples(duration)
    early = 0.5 * gain * np.minimum(time, ramp) ** 2 + gain * ramp * np.clip(time - ramp, 0.0, duration - 2.0 * ramp)
    late = np.maximum(time - (duration - ramp), 0.0)
    part = early + late * (gain * ramp - 0.5 * gain * late)
    part[0], part[-1] = 0.0, 1.0
    return time, q_a + part[:, None] * (q_b - q_a)


def _samples(duration: float) -> Vector:
    return np.linspace(0.0, duration, max(int(np.ceil(duration / _PERIOD)) + 1, 3))


def _along_smooth(way: SmoothWay, begin: float, end: float, limits: JointLimits) -> tuple[Vector, Matrix] | None:
    """The fastest motion between two stops with round corners between; None where toppra has none."""
    import toppra
    import toppra.algorithm
    import toppra.constraint

    logging.getLogger("toppra").setLevel(logging.CRITICAL)

    class Path(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
        def __call__(self, path_positions: float | Vector, order: int = 0) -> Matrix:
            return way(path_positions, order)

        dof = way.corners.shape[1]
        path_interval = np.array([begin, end])

    knots = way.knots
    apart = _SAME_PLACE * way.length  # where corners share a leg, they may end in one place but for rounding
    knots = knots[(knots > begin + apart) & (knots < end - apart)]
    knots = np.concatenate(([begin], knots[np.diff(knots, prepend=begin) > apart], [end]))
    fractions = np.arange(_PER_PIECE) / _PER_PIECE
    grid = np.append((knots[:-1, None] + np.diff(knots)[:, None] * fractions).ravel(), knots[-1])
    fastest, hardest = limits.velocity * _SPARE, limits.acceleration * _SPARE
    constraints = [
        toppra.constraint.JointVelocityConstraint(np.column_stack((-fastest, fastest))),
        toppra.constraint.JointAccelerationConstraint(np.column_stack((-hardest, hardest))),
    ]
    solver = toppra.algorithm.TOPPRA(constraints, Path(), gridpoints=grid, solver_wrapper="seidel")
    _, speed, _ = solver.compute_parameterization(0.0, 0.0)
    if speed is None or not np.all(np.isfinite(speed)) or np.any(speed[:-1] + speed[1:] <= 0.0):
        return None
    # between the points of the grid the speed along the way changes evenly in time
    at = np.concatenate(([0.0], np.cumsum(2.0 * np.diff(grid) / (speed[:-1] + speed[1:]))))
    time = _samples(float(at[-1]))
    interval = np.clip(np.searchsorted(at, time, side="right") - 1, 0, len(grid) - 2)
    since = time - at[interval]
    gain = np.diff(speed) / np.diff(at)
    s = grid[interval] + since * (speed[interval] + 0.5 * since * gain[interval])
    q = way(np.clip(s, begin, end))
    q[0], q[-1] = way(begin), way(end)
    return time * max(_over(Trajectory.from_steps(time, q), limits) / _SPARE, 1.0), q
