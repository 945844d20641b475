"""When to be where: joint positions along a path made into a motion from rest to rest.

The time-optimal speed along a smooth curve through the samples comes from toppra
(Pham and Pham 2018). A curve can exceed a limit between the points where toppra looks,
so what is sampled is checked, and slowed by as much as it is over.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.robot import JointLimits
from backhoe_planner.planning.trajectory import Trajectory

__all__ = ["time_along", "time_polyline"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_PERIOD = 0.02  # s between samples
_SPARE = 0.999
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
