"""From joint positions along a path to a motion from rest to rest, as fast as the limits allow.

The speed along a smooth curve through the positions is time-optimal, see `path_limits`. The
samples of the motion are checked. If they exceed a limit of the joints, the whole motion
is slowed by one factor; where they exceed a limit of the drive, it is slowed there (`retime`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics, JointLimits, Robot
from backhoe_planner.motion.path import step_lengths
from backhoe_planner.motion.smooth_way import SmoothWay
from backhoe_planner.motion.timing.drive import SLOWED_TO, Drive, drive_of
from backhoe_planner.motion.timing.path_limits import PathShape, time_path
from backhoe_planner.motion.trajectory import SAMPLE_PERIOD, Trajectory

if TYPE_CHECKING:
    from backhoe_planner.motion.problem import Problem

_MANY = 5000  # samples, 100 s at the usual period; chosen: a longer motion is thinned out
_MOST = 1_000_000  # samples of a motion before it is thinned out; chosen, 80 MB for ten joints
_LEAST_STEP = 2.5e-3  # rad or m of a joint between samples of a thinned motion: a tenth of `Trajectory.moments`
_LEAST_CHANGE = (
    0.01  # part of the velocity change allowed to a joint in a period; chosen: a thinned motion keeps its ramps
)
_LEAST_TIP_STEP = 5e-4  # m of the tip: a tenth of the usual tolerance
_FEWEST = 50  # samples of a ramp; chosen
_RAMP_ROUNDS = 4  # rounds to find how many samples a ramp needs; chosen, two are enough on a smooth path
_SPARE = 0.999  # part of every limit that a ramp uses; chosen: its samples may use a little more
_SAME_PLACE = 1e-9  # part of a path's length: corners that are closer coincide but for rounding
_PER_PIECE = 12  # intervals on every leg and corner of a path; chosen, as are the next two
_PER_WAY = 300  # intervals on a path between two stops, about; `path_limits` corrects excesses between the points
_LEAST_GRID = 1000  # intervals on a path, about
_COARSE = 1.05  # times a limit that samples of a curve may show before its grid is made denser; chosen, rarely needed
_HALVINGS = 6  # of the first and last interval, within which a slow machine may reach its full speed; chosen

_ROUNDING = 1e-7  # part of a limit of the joints
_SPEED_WITHIN = 1e-3  # part of the requested tip speed; chosen, far below the tolerance of a certificate
_SPEED_ROUNDS = 3  # of slowing down where the samples show a higher speed; one is enough except for very short paths
_SLOWEST = 50.0  # factor; chosen: a motion that even this does not help stays as it is


def time_along(
    stations: Vector,
    q: Matrix,
    limits: JointLimits,
    *,
    drive: Drive | None = None,
    intervals: int = _LEAST_GRID,
) -> Trajectory:
    """The fastest motion through samples of a joint path, from rest to rest; parameters are those of `FastestRun`."""
    return FastestRun(stations, q, limits, drive=drive, intervals=intervals).motion(SAMPLE_PERIOD)


class FastestRun:
    """The fastest motion through samples of a joint path, from rest to rest, to be sampled at any period.

    If a load cannot be held even at rest, the motion is timed as if it just could.

    Parameters
    ----------
    stations: (K,) arc lengths of the tip [m], not decreasing: the tip may stand still while the
        joints turn.
    q: (K, n) joints there [rad or m].
    limits: of the joints.
    speed: the greatest speed of the tip [m/s]; None for no such limit.
    kinematics: of the machine, from which the tip's motion follows; without it the tip is assumed at `stations`.
    drive: of the joints; None for no limits other than those of the joints.
    intervals: the approximate least number of intervals whose ends are checked for limits.
    """

    def __init__(
        self,
        stations: Vector,
        q: Matrix,
        limits: JointLimits,
        *,
        speed: float | None = None,
        kinematics: BatchKinematics | None = None,
        drive: Drive | None = None,
        intervals: int = _LEAST_GRID,
    ) -> None:
        self._q, self._limits, self._drive = q, limits, drive
        self._speed, self._kinematics = speed, kinematics
        self._still = len(stations) < 2 or float(np.max(np.abs(np.diff(q, axis=0)))) < 1e-12
        if self._still:
            return
        from scipy.interpolate import CubicSpline

        self._along = np.concatenate(([0.0], np.cumsum(step_lengths(stations, q, least=1e-6))))
        # arc length is one more coordinate, so that its rate is the tip's speed
        bc_type = "not-a-knot" if len(self._along) > 3 else "natural"
        self._curve = curve = CubicSpline(self._along, np.column_stack((q, stations)), bc_type=bc_type, axis=0)
        grid = _denser_at_ends(_refined(self._along, max(2 * (len(self._along) - 1), intervals)))
        places, slope, bend = curve(grid)[:, :-1], curve(grid, 1), curve(grid, 2)[:, :-1]
        tip_slope = slope[:, -1]
        if speed is not None and kinematics is not None:
            tip_slope = _tip_rates(kinematics, places, slope[:, :-1])
        shape = PathShape(grid, places, slope[:, :-1], bend[:-1], bend[1:], tip_slope=tip_slope)
        self._law = time_path(shape, limits, drive=drive, tip_speed=speed)

    def samples(self, period: float = SAMPLE_PERIOD) -> tuple[Vector, Matrix]:
        """Times (T,) [s] and joints (T, n) [rad or m] of the motion before it is slowed where samples exceed a limit.

        Slowing changes the times alone, so these are the joints of `motion`.
        """
        if self._still:
            return np.zeros(1), self._q[:1]
        law, curve, n = self._law, self._curve, self._q.shape[1]
        if law is None:
            return _ramp(self._along, self._q, self._limits)
        time, samples = _thin_out(
            _samples(law.duration, period),
            lambda moments: np.asarray(curve(law.at(moments))),
            np.append(np.full(n, _LEAST_STEP), _LEAST_TIP_STEP),
            np.append(_LEAST_CHANGE * SAMPLE_PERIOD * self._limits.acceleration, np.inf),
        )
        samples = samples[:, :-1]
        samples[0], samples[-1] = self._q[0], self._q[-1]
        # a spline may swing slightly beyond a limit if its samples are at that limit
        return time, np.clip(samples, self._limits.lower, self._limits.upper)

    def motion(self, period: float = SAMPLE_PERIOD) -> Trajectory:
        """The motion, slowed where its samples exceed a limit.

        Parameters
        ----------
        period: between its samples [s].
        """
        motion, limits = Trajectory.from_steps(*self.samples(period)), self._limits
        if self._still:
            return motion
        motion = _slow_to_speed(motion, limits, self._speed, self._kinematics)
        if self._law is None:
            return retime(motion, limits, drive=self._drive)
        return _slow_to_limits(motion, limits, self._drive)


def time_curve(
    curve: Callable[[Vector, int], Matrix], grid: Vector, limits: JointLimits, *, drive: Drive | None = None
) -> Trajectory | None:
    """The fastest motion along a smooth curve that is at rest at its ends in its own parameter; None if there is none.

    The parameter is like a time: dq/ds is 0 at both ends, so that a run at constant ds/dt is a
    motion from rest to rest. The result is never slower than the fastest of those runs, except for
    effects between the points of the grid.

    Parameters
    ----------
    curve: gives (K, n) the joints at (K,) values of the parameter, or their first or second
        derivatives; the second argument is the order of the derivative.
    grid: (N + 1,) increasing values of the parameter.
    limits: of the joints.
    drive: of the joints; None for no limits other than those of the joints.
    """
    motion = _over_curve(curve, grid, limits, drive)
    if motion is None:
        return None
    if _over(motion, limits) > _COARSE:  # full speed is reached within the first interval
        denser = _over_curve(curve, _denser_at_ends(grid), limits, drive)
        motion = motion if denser is None else denser
    return _slow_to_limits(motion, limits, drive)


def time_evenly(
    curve: Callable[[Vector, int], Matrix],
    duration: float,
    limits: JointLimits | None = None,
    *,
    drive: Drive | None = None,
) -> Trajectory:
    """The motion along a smooth curve at an even pace, slowed if it exceeds a limit, only there if that is enough.

    Parameters
    ----------
    curve: gives (K, n) the joints at (K,) values of its parameter from 0 to 1; see `time_curve`.
    duration: from its beginning to its end [s].
    limits: of the joints; None for no limits at all.
    drive: of the joints; None for no limits other than those of the joints.
    """
    time = _samples(duration, SAMPLE_PERIOD)
    motion = Trajectory.from_steps(time, curve(time / time[-1], 0))
    if limits is None:
        return motion
    motion = Trajectory.from_steps(time, np.clip(motion.q, limits.lower, limits.upper))
    slower = _slow_to_limits(motion, limits, drive)
    if _over(motion, limits) <= 1.0 + _ROUNDING:
        return slower
    # usually one joint is too fast for a moment
    local = _locally(motion, limits, None, 1.0)
    if local is None:
        return slower
    return min(slower, _slow_to_limits(local, limits, drive), key=lambda one: one.duration)


def _over_curve(
    curve: Callable[[Vector, int], Matrix], grid: Vector, limits: JointLimits, drive: Drive | None
) -> Trajectory | None:
    q, slope, bend = (curve(grid, derivative) for derivative in range(3))
    law = time_path(PathShape(grid, q, slope, bend[:-1], bend[1:]), limits, drive=drive, rests=False)
    if law is None:
        return None
    time, samples = _thin_out(
        _samples(law.duration, SAMPLE_PERIOD),
        lambda moments: curve(law.at(moments), 0),
        np.full(q.shape[1], _LEAST_STEP),
        _LEAST_CHANGE * SAMPLE_PERIOD * limits.acceleration,
    )
    samples[0], samples[-1] = q[0], q[-1]
    return Trajectory.from_steps(time, np.clip(samples, limits.lower, limits.upper))


def _tip_rates(kinematics: BatchKinematics, q: Matrix, rates: Matrix) -> Vector:
    """(K,) how fast the tip moves [m] at q (K, n) if the joints move at `rates` (K, n), per unit of the rates."""
    return np.asarray(np.linalg.norm(np.einsum("kin,kn->ki", kinematics.at(q).position_jacobian(), rates), axis=1))


def _tip_speeds(kinematics: BatchKinematics, trajectory: Trajectory) -> Vector:
    """(T - 1,) the tip's speed from sample to sample [m/s]."""
    moved = np.diff(kinematics.at(trajectory.q).tip_position, axis=0)
    return np.asarray(np.linalg.norm(moved, axis=1) / np.diff(trajectory.time))


def slow_tip(trajectory: Trajectory, limits: JointLimits, *, speed: float, robot: Robot, drive: Drive) -> Trajectory:
    """The motion, slowed where its tip is faster than `speed` [m/s], within the limits of joints and drive."""
    return _slow_to_limits(_slow_to_speed(trajectory, limits, speed, BatchKinematics(robot)), limits, drive)


def _slow_to_speed(
    trajectory: Trajectory, limits: JointLimits, speed: float | None, kinematics: BatchKinematics | None
) -> Trajectory:
    """The motion, slowed where the tip is faster than `speed` [m/s] from sample to sample."""
    if speed is None or kinematics is None or len(trajectory) < 3:
        return trajectory
    for _ in range(_SPEED_ROUNDS):
        tip = _tip_speeds(kinematics, trajectory)
        if float(np.max(tip)) <= (1.0 + _SPEED_WITHIN) * speed:
            return trajectory
        beside = np.maximum(np.append(tip, 0.0), np.append(0.0, tip))
        slower = _locally(trajectory, limits, None, 1.0, tip_slope=beside, tip_speed=speed)
        if slower is None:
            break
        trajectory = slower
    over = float(np.max(_tip_speeds(kinematics, trajectory))) / speed
    return Trajectory.from_steps(trajectory.time * max(over, 1.0), trajectory.q)


def _refined(along: Vector, count: int) -> Vector:
    """The values in `along`, and further ones between them: about `count` intervals, nearly equal."""
    steps = np.diff(along)
    parts = np.maximum(np.ceil(count * steps / (along[-1] - along[0]) - 1e-9).astype(int), 1)
    pieces = [np.linspace(a, b, k, endpoint=False) for a, b, k in zip(along[:-1], along[1:], parts, strict=True)]
    return np.append(np.concatenate(pieces), along[-1])


def _denser_at_ends(grid: Vector) -> Vector:
    """The values in `grid`, and further ones in its first and last interval, denser towards the ends."""
    halves = 0.5 ** np.arange(_HALVINGS, 0, -1)
    first, last = grid[1] - grid[0], grid[-1] - grid[-2]
    return np.concatenate((grid[:1], grid[0] + first * halves, grid[1:-1], grid[-1] - last * halves[::-1], grid[-1:]))


def _slow_to_limits(trajectory: Trajectory, limits: JointLimits, drive: Drive | None) -> Trajectory:
    """The motion, slowed where its samples exceed a limit."""
    if len(trajectory) < 2:  # a search that failed may give its start alone
        return trajectory
    over = _over(trajectory, limits)
    if over > 1.0:
        trajectory = Trajectory.from_steps(trajectory.time * (over * (1.0 + 1e-9)), trajectory.q)
    return retime(trajectory, limits, drive=drive)


def time_polyline(q: Matrix, limits: JointLimits) -> Trajectory:
    """A motion straight from sample to sample of `q` (K, n), in one smooth ramp within the `limits`.

    It passes through all samples, wherever they are, and is far from time-optimal.
    """
    way = np.concatenate(([0.0], np.cumsum(np.max(np.abs(np.diff(q, axis=0)), axis=1))))
    if way[-1] < 1e-12:
        return Trajectory.from_steps(np.zeros(1), q[:1])
    time, samples = _ramp(way, q, limits)
    return Trajectory.from_steps(time, samples)


def _ramp(stations: Vector, q: Matrix, limits: JointLimits) -> tuple[Vector, Matrix]:
    count, time, samples = max(4 * len(stations), _FEWEST), np.zeros(1), q[:1]
    for _ in range(_RAMP_ROUNDS):
        part = np.linspace(0.0, 1.0, count)
        along = stations[0] + (stations[-1] - stations[0]) * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        samples = np.column_stack([np.interp(along, stations, column) for column in q.T])
        time = part * 10.0
        time = time * _over(Trajectory.from_steps(time, samples), limits) / _SPARE
        # samples too far apart turn a smooth motion into corners
        needed = len(_samples(float(time[-1]), SAMPLE_PERIOD))
        if needed <= count:
            break
        count = needed
    return time, samples


def _over(trajectory: Trajectory, limits: JointLimits) -> float:
    """The factor by which time must be stretched to keep every limit of the joints."""
    velocity = float(np.max(np.abs(trajectory.segment_velocities()) / limits.velocity))
    smooth = float(np.max(np.abs(trajectory.accelerations()) / limits.acceleration))
    # slowed by f, a change of velocity is 1 / f as large; it takes f times as long, but at most a period counts
    sharp = float(np.max(np.abs(trajectory.velocity_changes()) / limits.acceleration)) / SAMPLE_PERIOD
    return max(velocity, float(np.sqrt(smooth)), sharp)


# --- paths with round corners -----------------------------------------------------


def time_way(way: SmoothWay, limits: JointLimits, *, drive: Drive | None = None) -> Trajectory:
    """The fastest motion along a joint path, at rest at its ends and at its stops.

    The samples are on the path. Between two of them the motion is straight: on a leg it is
    on the path, on a corner at most `chord_sagitta` off it. If no time law is found, the
    motion goes into the corners and stops there.

    Parameters
    ----------
    way, limits: the path of the joints, and their limits.
    drive: of the joints; None for no limits other than those of the joints.
    """
    if way.length == 0.0:
        return Trajectory.from_steps(np.zeros(1), way.corners[:1])
    limited = drive is not None and drive.limited
    times, samples = [np.zeros(1)], [way.corners[:1]]
    for begin, end in zip(way.stops[:-1], way.stops[1:], strict=True):
        for time, q in _parts(way, float(begin), float(end), limits, drive if limited else None):
            times.append(times[-1][-1] + time[1:])
            samples.append(q[1:])
    time, q = np.concatenate(times), np.vstack(samples)
    q[-1] = way.corners[-1]
    return _slow_to_limits(Trajectory.from_steps(time, q), limits, drive)


def _parts(
    way: SmoothWay, begin: float, end: float, limits: JointLimits, drive: Drive | None
) -> list[tuple[Vector, Matrix]]:
    """Motions from rest to rest, one or several, from one stop of a path to the next."""
    inside = (way.stations > begin) & (way.stations < end)
    timed = _along_smooth(way, begin, end, limits, drive) if inside.any() or drive is not None else None
    if timed is not None:
        return [timed]
    corners = way.corners[(way.stations >= begin) & (way.stations <= end)]
    return [_straight(a, b, limits) for a, b in itertools.pairwise(corners)]


def _straight(q_a: Vector, q_b: Vector, limits: JointLimits) -> tuple[Vector, Matrix]:
    """The fastest straight motion from rest to rest: speeding up, constant speed, slowing down."""
    dq = np.abs(q_b - q_a)
    moving = dq > 0.0
    rate = _SPARE * float(np.min(limits.velocity[moving] / dq[moving]))
    gain = _SPARE * float(np.min(limits.acceleration[moving] / dq[moving]))
    ramp = min(rate / gain, float(np.sqrt(1.0 / gain)))
    duration = 1.0 / (gain * ramp) + ramp
    time = _samples(duration, SAMPLE_PERIOD)
    early = 0.5 * gain * np.minimum(time, ramp) ** 2 + gain * ramp * np.clip(time - ramp, 0.0, duration - 2.0 * ramp)
    late = np.maximum(time - (duration - ramp), 0.0)
    part = early + late * (gain * ramp - 0.5 * gain * late)
    part[0], part[-1] = 0.0, 1.0
    return time, q_a + part[:, None] * (q_b - q_a)


def _samples(duration: float, period: float) -> Vector:
    return np.linspace(0.0, duration, min(max(int(np.ceil(duration / period)) + 1, 3), _MOST))


def _thin_out(
    time: Vector, place: Callable[[Vector], Matrix], least_step: Vector, least_change: Vector
) -> tuple[Vector, Matrix]:
    """Samples (T,), (T, m) of a motion; if there are very many, only those at which something has moved or changed.

    Parameters
    ----------
    time: (K,) of all samples [s].
    place: gives the coordinates (K, m) at (K,) times.
    least_step: (m,) how far some coordinate moves from sample to sample of a slow motion.
    least_change: (m,) how much its velocity changes [.../s].
    """
    samples = place(time)
    if len(time) <= _MANY:
        return time, samples
    steps = np.diff(samples, axis=0)
    velocity = steps / np.diff(time)[:, None]
    change = np.vstack((np.diff(velocity, axis=0), np.zeros(samples.shape[1])))  # at the end of each step
    some = np.maximum(np.abs(steps) / least_step, np.abs(change) / least_change)
    way = np.concatenate(([0.0], np.cumsum(np.max(some, axis=1))))
    kept = np.concatenate(([True], np.floor(way[1:-1]) > np.floor(way[:-2]), [True]))
    return time[kept], samples[kept]


def _along_smooth(
    way: SmoothWay, begin: float, end: float, limits: JointLimits, drive: Drive | None
) -> tuple[Vector, Matrix] | None:
    """The fastest motion between two stops, through the round corners between them; None if there is no time law."""
    knots = way.knots
    apart = _SAME_PLACE * way.length  # corners that share a leg may end in one place but for rounding
    knots = knots[(knots > begin + apart) & (knots < end - apart)]
    knots = np.concatenate(([begin], knots[np.diff(knots, prepend=begin) > apart], [end]))
    grid = [begin]
    for a, b in itertools.pairwise(knots):
        count = max(_PER_PIECE, int(np.ceil(_PER_WAY * (b - a) / (end - begin))))
        grid.extend(np.linspace(a, b, count + 1)[1:].tolist())
    places = _denser_at_ends(np.array(grid))
    bend = way(0.5 * (places[:-1] + places[1:]), 2)  # constant between two knots
    slope = way(places, 1)
    # at the end of the path the slope is that of the last leg
    slope[-1] = way(places[-2] + (1.0 - 1e-9) * (places[-1] - places[-2]), 1)
    law = time_path(PathShape(places, way(places), slope, bend, bend), limits, drive=drive)
    if law is None:
        return None
    time, q = _thin_out(
        _samples(law.duration, SAMPLE_PERIOD),
        lambda moments: way(np.clip(law.at(moments), begin, end)),
        np.full(way.corners.shape[1], _LEAST_STEP),
        _LEAST_CHANGE * SAMPLE_PERIOD * limits.acceleration,
    )
    q[0], q[-1] = way(begin), way(end)
    return time * max(_over(Trajectory.from_steps(time, q), limits) / _SPARE, 1.0), q


# --- motions slowed to the limits of the drive -----------------------------------------


def retime(trajectory: Trajectory, limits: JointLimits, *, drive: Drive | None) -> Trajectory:
    """The motion, slowed where its torques, speeds, flow or power exceed those of the `drive`.

    Only the times of the samples change, so all distances from obstacles at rest stay the same.
    If a static load cannot be held, torques are not limited: slowing down does not reduce them.
    """
    if drive is None or not drive.limited or len(trajectory) < 3 or _drive_use(trajectory, drive) <= 1.0 + SLOWED_TO:
        return trajectory
    for part in (1.0, 0.97):
        slower = _locally(trajectory, limits, drive, part)
        if slower is None or _over(slower, limits) > 1.0 + _ROUNDING:
            continue
        if _drive_use(slower, drive) <= 1.0 + SLOWED_TO:
            return slower
    return _stretched(trajectory, drive)


def slowed_to_drive(problem: Problem, motion: Trajectory) -> Trajectory:
    """The motion, slowed where it exceeds the problem's drive (see `retime`) or its tip the speed that is asked for."""
    drive = drive_of(problem)
    slower = retime(motion, problem.limits, drive=drive)
    if problem.tip_speed is None:
        return slower
    return slow_tip(slower, problem.limits, speed=problem.tip_speed, robot=problem.robot, drive=drive)


def _drive_use(trajectory: Trajectory, drive: Drive) -> float:
    """The greatest use of the drive; without torque if a load could not be held even at rest."""
    use = drive.use_along(trajectory.moments(longest=np.inf))
    most, worst = float(np.max(use.speeds)), float(np.max(use.effort))
    if worst <= max(most, 1.0):
        return max(most, worst)
    load = drive.gravity_torques(trajectory.q)
    for static in (load, load + drive.soil_torques(trajectory.q, trajectory.v)):
        if np.any(drive.effort_use(trajectory.q, static) > 1.0 + SLOWED_TO):
            return most
    return worst


def _locally(
    trajectory: Trajectory,
    limits: JointLimits,
    drive: Drive | None,
    part: float,
    *,
    tip_slope: Vector | None = None,
    tip_speed: float | None = None,
) -> Trajectory | None:
    """The motion, slowed where necessary and never faster; None if no such run is found.

    The path parameter is the old time, so that velocity and acceleration of the samples are
    the slope and the bend.

    Parameters
    ----------
    part: of the old speed, at most.
    tip_slope: (T,) the tip's speed at the samples [m/s]; tip_speed: the greatest that it may have [m/s].
    """
    v, a = trajectory.v.copy(), trajectory.accelerations()
    segment = trajectory.segment_velocities()
    v[0], v[-1] = segment[0], segment[-1]  # in motion at once, as the samples are
    bend = a.copy()
    bend[0], bend[-1] = bend[1], bend[-2]
    shape = PathShape(trajectory.time, trajectory.q, v, bend[:-1], bend[1:], tip_slope=tip_slope)
    wide = replace(limits, acceleration=np.maximum(limits.acceleration, 1.001 * np.max(np.abs(a), axis=0)))
    law = time_path(shape, wide, drive=drive, tip_speed=tip_speed, most=part, rests=False)
    return None if law is None else Trajectory.from_steps(law.time, trajectory.q)


def _stretched(trajectory: Trajectory, drive: Drive) -> Trajectory:
    """The whole motion slowed by one factor; unchanged if even a factor of 50 does not help."""

    def slower(factor: float) -> Trajectory:
        return Trajectory.from_steps(trajectory.time * factor, trajectory.q)

    high = 1.05
    while _drive_use(slower(high), drive) > 1.0 + SLOWED_TO:
        high *= 1.5
        if high > _SLOWEST:
            return trajectory
    low = max(high / 1.5, 1.0)
    for _ in range(8):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _drive_use(slower(middle), drive) <= 1.0 + SLOWED_TO else (middle, high)
    return slower(high)
