"""How well the tip follows its task, from the samples of a motion alone.

Between two samples the tip leaves the straight line between its two positions by at most a
sagitta, see `bend_weights`. It is added to the errors at the samples; if the sum is more than the
tolerance, the errors in between are measured too, see `chords`. How far the tip turns between two
samples is bounded likewise, see `orientation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import BatchKinematics, Kinematics, TargetBatch, bend_weights, tip_travel_bound
from backhoe_planner.motion.following.chords import chord_errors
from backhoe_planner.motion.following.orientation import angle_bounds
from backhoe_planner.motion.following.spot_turns import SpotTurn, largest_spot_turn
from backhoe_planner.motion.following.waypoint_steps import WaypointStep, longest_step
from backhoe_planner.motion.goals import ANGLE_TOLERANCE, Goal
from backhoe_planner.motion.path import TURN_LEVER, TipPath, targets_along
from backhoe_planner.motion.trajectory import Trajectory
from backhoe_planner.site import Obstruction

_BEGINNING = 0.1  # part of the path; chosen: while less is done, the tip may still be approaching
_BESIDE = 10.0  # tolerances before and behind an end of a detour in which the tip swings out or in; chosen
_SAME_PLACE = 1e-6  # m: chosen, a smaller difference is rounding of a joint path
_LEAST_SHOWN = 5e-4  # m: less is printed as 0.000 m
_BETTER = 0.1  # part of the tolerances by which a later leg must fit better where a path turns; chosen
_PARTS = 8  # least number of parts of a segment that passes a waypoint, at which the tip's angle is checked; chosen
_TURN_PART = 0.25  # part of the angle's tolerance that the tip turns at most between two of them; chosen
_MOST_PARTS = 2000  # chosen to bound the work
_MARKS = 33  # places of the path that a detour leaves out, besides waypoints, measured from the detour; chosen
_AT_ONCE = 256  # samples whose distances from all legs of a path are bounded at once; chosen: a few megabytes
_LOOK_AHEAD = 0.5  # m of path within which the tip is searched while it follows; chosen


@dataclass(frozen=True)
class Detour:
    """A part of the motion that leaves the specified path and returns to it.

    Attributes
    ----------
    time_from, time_to: when it begins and ends [s].
    path_from, path_to: where the tip leaves the path and where it rejoins it [m].
    length: distance that the tip moves in between [m].
    max_deviation: largest distance of the tip from the path, or of the left-out part of the path from the tip [m].
    max_angle: largest angle from the required orientation [rad].
    obstruction: what the detour goes around, if a planner knows it; a certificate does not.
    """

    time_from: float
    time_to: float
    path_from: float
    path_to: float
    length: float
    max_deviation: float
    max_angle: float = 0.0
    obstruction: Obstruction | None = None

    @property
    def place(self) -> str:
        """The part of the path, for a sentence: ``from 1.20 m to 1.80 m``, or ``at 1.20 m``."""
        begin, end = f"{self.path_from:.2f} m", f"{self.path_to:.2f} m"
        return f"at {begin}" if begin == end else f"from {begin} to {end}"

    @property
    def size(self) -> str:
        """How far it is off the path, for a sentence: ``by up to 0.120 m``, ``by up to 12.3 deg``."""
        if self.max_deviation >= _LEAST_SHOWN:
            return f"by up to {self.max_deviation:.3f} m"
        if self.max_angle > ANGLE_TOLERANCE:
            return f"by up to {np.degrees(self.max_angle):.1f} deg"
        return f"leaving out {self.path_to - self.path_from:.2f} m of it"


@dataclass(frozen=True)
class Tracking:
    """How well the tip followed its task.

    Attributes
    ----------
    done: whether the goal was reached, or the path followed to its end.
    shortfall: what is missing, in words; empty if done.
    max_error, mean_error: of the tip's position [m]: at the goal, or over the followed parts
        of the path, where the greatest includes the bound between samples.
    max_angle_error: the same for its angle, with a bound at most 0.001 rad above the measured error [rad].
    path_length: of the specified path [m], turns of the bucket not counted; 0 for a goal.
    followed: length of the followed part [m].
    approach_time: when the tip is first on the path [s].
    detours: where the tip left the path.
    max_speed, max_speed_time: greatest speed of the tip on the followed parts [m/s], and when [s];
        10 tolerances next to a detour, where the tip swings out and in again, do not count.
    joint_step: the longest step of a joint from waypoint to waypoint; None if the joints may move freely.
    spot_turn: the largest turn of the joints while the tip stands still; None if there is none, or it is allowed.
    goal: number of the goal at which the motion ends, or of the nearest, from 1; 0 for a path.
    """

    done: bool
    shortfall: str
    max_error: float
    mean_error: float
    max_angle_error: float
    path_length: float = 0.0
    followed: float = 0.0
    approach_time: float = 0.0
    detours: tuple[Detour, ...] = ()
    max_speed: float = 0.0
    max_speed_time: float = 0.0
    joint_step: WaypointStep | None = None
    spot_turn: SpotTurn | None = None
    goal: int = 0

    @property
    def left_out(self) -> float:
        """How much of the path the detours leave out [m]. It is not proven that something blocks the path there."""
        return sum(detour.path_to - detour.path_from for detour in self.detours)


def track_goals(goals: Sequence[Goal], trajectory: Trajectory, kinematics: Kinematics) -> Tracking:
    """How close the last sample is to the first of `goals` that is reached, or else to the nearest.

    Parameters
    ----------
    goals: where the motion may end, at least one.
    trajectory, kinematics: the motion, and the machine that makes it.
    """
    at = kinematics.at(trajectory.q[-1])
    short = [goal.shortfall(at) for goal in goals]
    reached = [number for number, missing in enumerate(short) if not missing]
    misses = [float(np.linalg.norm(goal.error(at))) for goal in goals]
    number = reached[0] if reached else int(np.argmin(misses))
    position, angle = goals[number].distances(at)
    return Tracking(not short[number], short[number], position, position, angle, goal=number + 1)


def track_path(
    path: TipPath,
    tolerance: float,
    trajectory: Trajectory,
    kinematics: Kinematics,
    *,
    angle_tolerance: float = ANGLE_TOLERANCE,
    joint_steps: Vector | None = None,
    may_turn: bool = True,
) -> Tracking:
    """How the tip follows `path` at the samples, with a bound on the errors between them.

    Parameters
    ----------
    path: the path of the task.
    trajectory, kinematics: the motion, and the machine that makes it.
    tolerance, angle_tolerance: errors within which the tip counts as on the path [m], [rad].
    joint_steps: (n,) how far a joint may move from waypoint to waypoint [rad or m]; None if all may move freely.
    may_turn: whether the joints may go to another posture while the tip stands still.
    """
    station, error, angle, tips, at_begin = _follow(path, tolerance, angle_tolerance, trajectory, kinematics)
    robot = kinematics.robot
    turning = np.where(robot.prismatic, 0.0, 1.0)
    sagitta = bend_weights(np.diff(trajectory.q, axis=0), turning) @ tip_travel_bound(robot, trajectory.q) / 8.0
    bound = chord_errors(
        path, robot, q=trajectory.q, station=station, error=error, sagitta=sagitta, tips=tips, tolerance=tolerance
    )
    chord = bound - np.maximum(error[:-1], error[1:])
    between = np.maximum(np.append(chord, 0.0), np.append(0.0, chord))
    off = error + between
    near = off <= tolerance
    on = near & (angle <= angle_tolerance)
    if path.asks_orientation:
        turned = angle_bounds(
            path, robot, q=trajectory.q, station=station, angle=angle, segments=on[:-1] & on[1:],
            allowed=angle_tolerance,
        )  # fmt: skip
        angle = np.maximum(angle, np.maximum(np.append(turned, 0.0), np.append(0.0, turned)))
        on &= angle <= angle_tolerance
    if not on.any():
        nearest = int(np.argmin(np.where(near, angle, np.inf) if near.any() else error))
        metres = beside_bounds(float(off[nearest]), tolerance, places=".3f")[0]
        short = f"the tip never comes onto the path; nearest {metres} m"
        if near.any():
            degrees = _degrees(float(angle[nearest]), angle_tolerance)
            short = f"the tip is never on the path with the asked orientation; nearest {degrees} deg"
        off = float(error[nearest])
        return Tracking(False, short, off, off, float(angle[nearest]), path.arc(path.length))
    # the approach ends where the tip comes nearest to the path's beginning
    begins = np.flatnonzero(on & at_begin & (path.turns | (station <= _beginning(path, tolerance, angle_tolerance))))
    if not len(begins):
        begins = np.flatnonzero(on)[:1]
    away = np.linalg.norm(tips - path.points[0], axis=1)
    nearest = away[begins] <= np.min(away[begins]) + _SAME_PLACE
    first, last = int(begins[np.argmax(nearest)]), len(on) - 1 - int(np.argmax(on[::-1]))
    on[:first] = False  # brushing past during the approach is not following
    _close_gaps(on, first, last, station, 2.0 * tolerance)
    gaps = _gaps(on, np.array([path.arc(float(s)) for s in station]) if path.turns else station, tips, tolerance)
    detours = [_detour(path, gap, station, error, angle, tips, trajectory.time) for gap in gaps]
    skipped = sum(detour.path_to - detour.path_from for detour in detours)
    edges = np.array([station[row] for gap in gaps for row in gap])
    max_speed, max_speed_time = _max_speed(on, station, tips, trajectory, kinematics, edges, _BESIDE * tolerance)
    step = None
    if joint_steps is not None:
        rows, own = slice(first, last + 1), [(a - first, b - first) for a, b in gaps]
        step = longest_step(path, station[rows], trajectory.q[rows], joint_steps, gaps=own, slack=tolerance)
    turn = None
    if not may_turn:
        turn = largest_spot_turn(trajectory.time, trajectory.q, station, on, tolerance=tolerance)
    missing = []
    if not at_begin[first] if path.turns else station[first] > tolerance:
        missing.append(f"the path is joined at {path.describe(station[first])} instead of at its start")
    if station[last] < path.length - tolerance or last < len(on) - 1:
        missing.append(f"the path is followed to {path.describe(station[last])} of {path.describe_end()}")
    if not missing:
        left = [(station[a], station[b]) for a, b in gaps if np.max(error[a : b + 1]) > tolerance]
        missing += _missed_angles(path, tolerance, angle_tolerance, on, station, trajectory, kinematics, left)
    return Tracking(
        done=not missing,
        shortfall=" and ".join(missing),
        max_error=float(np.max(off[on])),
        mean_error=float(np.mean(error[on])),
        max_angle_error=float(np.max(angle[on])),
        path_length=path.arc(path.length),
        followed=path.arc(float(station[last])) - path.arc(float(station[first])) - skipped,
        approach_time=float(trajectory.time[first]),
        detours=tuple(detours),
        max_speed=max_speed,
        max_speed_time=max_speed_time,
        joint_step=step,
        spot_turn=turn,
    )


def _max_speed(
    on: Flags,
    station: Vector,
    tips: Matrix,
    trajectory: Trajectory,
    kinematics: Kinematics,
    edges: Vector,
    beside: float,
) -> tuple[float, float]:
    """The tip's greatest speed on the followed segments [m/s] and when [s]."""
    followed = on[:-1] & on[1:]
    for edge in edges.tolist():
        followed &= ~((station[:-1] < edge + beside) & (station[1:] > edge - beside))
    if not followed.any():
        return 0.0, 0.0
    moments = trajectory.moments()
    inside = followed[moments.segment[:-1]]
    at = np.diff(moments.segment, prepend=-1) > 0  # the samples
    places = np.zeros((len(at), 3))
    places[at] = tips
    rows = np.flatnonzero(inside & ~at[:-1])
    places[rows] = BatchKinematics(kinematics.robot).at(moments.q[rows]).tip_position
    speed = np.where(inside, np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(moments.time), 0.0)
    worst = int(np.argmax(speed))
    return float(speed[worst]), float(moments.time[worst])


def progress(
    path: TipPath,
    tolerance: float,
    trajectory: Trajectory,
    kinematics: Kinematics,
    *,
    angle_tolerance: float = ANGLE_TOLERANCE,
) -> float | None:
    """The s, see `TipPath`, up to which a motion has followed `path` [m]; None if it has not begun to.

    Parameters
    ----------
    trajectory, kinematics: the motion, and the machine that makes it.
    tolerance, angle_tolerance: errors within which the tip counts as on the path [m], [rad].
    """
    station, error, angle, _, begun = _follow(path, tolerance, angle_tolerance, trajectory, kinematics)
    if not begun.any():
        return None
    on = (error <= tolerance) & (angle <= angle_tolerance)
    on[: int(np.argmax(begun))] = False
    return float(np.max(station[on], initial=0.0))


def _follow(
    path: TipPath, tolerance: float, angle_tolerance: float, trajectory: Trajectory, kinematics: Kinematics
) -> tuple[Vector, Vector, Vector, Matrix, Flags]:
    """Per sample: s on the path, distance from it, angle error, tip position, and whether the tip is at its beginning.

    If the path turns, position and orientation are followed together.
    """
    count = len(trajectory)
    station, error, angle = np.zeros(count), np.zeros(count), np.zeros(count)
    at_begin = np.zeros(count, dtype=bool)
    batch = BatchKinematics(kinematics.robot).at(trajectory.q)
    tips = np.ascontiguousarray(batch.tip_position)
    away = np.linalg.norm(tips - path.points[0], axis=1)
    reached, begun, bounds = 0.0, False, np.zeros((0, 0))
    beginning = _beginning(path, tolerance, angle_tolerance)
    slack = _BETTER * min(tolerance, TURN_LEVER * angle_tolerance)

    def place(low: float, high: float) -> tuple[float, float, bool]:
        """The tip's place between two s, its distance from the path there, and whether it is on the path."""
        if path.turns:
            s, distance, off = path.place(at, low=low, high=high, slack=slack)
            return s, distance, distance <= tolerance and off <= angle_tolerance
        s, distance = path.nearest_unchecked(tips[row], low, high, bounds[row % _AT_ONCE])
        return s, distance, distance <= tolerance

    for row in range(count):
        if path.turns:
            at = kinematics.at(trajectory.q[row])
        elif row % _AT_ONCE == 0:
            bounds = path.leg_bounds_unchecked(tips[row : row + _AT_ONCE])
        from_begin = float(away[row])
        at_begin[row] = from_begin <= tolerance
        if path.turns:
            at_begin[row] &= path.target(0.0).distances(at)[1] <= angle_tolerance
            at_begin[row] &= reached <= beginning
        if at_begin[row] and reached <= beginning:
            # an approach may brush along the path before it settles on its beginning
            reached, begun = 0.0, True
        if not begun:
            s, distance = 0.0, from_begin
        else:
            s, distance, fits = place(reached, min(reached + _LOOK_AHEAD, path.length))
            if not fits:  # it may rejoin further on
                further, nearer, fits = place(reached, path.length)
                s, distance = (further if fits else s), nearer
            if fits:
                reached = s
        station[row], error[row] = s, distance
    if path.asks_orientation:
        angle = np.linalg.norm(targets_along(path, station).errors(batch)[:, 3:], axis=1)
    return station, error, angle, tips, at_begin


def _beginning(path: TipPath, tolerance: float, angle_tolerance: float) -> float:
    """The s up to which a tip at the path's beginning still counts as beginning [m].

    It is less if the path itself returns to its beginning.
    """
    usual = _BEGINNING * path.length
    raster = np.arange(0.0, 2.0 * usual, max(tolerance, 1e-3, usual / 5000.0))
    places = np.column_stack([np.interp(raster, path.stations, column) for column in path.points.T])
    away = np.linalg.norm(places - path.points[0], axis=1) > 2.0 * tolerance
    if path.turns:
        away |= np.array([path.turn(0.0, float(s)) > 2.0 * angle_tolerance for s in raster], dtype=bool)
    back = np.flatnonzero(~away & (np.cumsum(away) > 0))
    return min(usual, 0.5 * float(raster[back[0]])) if len(back) else usual


def _missed_angles(
    path: TipPath,
    tolerance: float,
    angle_tolerance: float,
    on: Flags,
    station: Vector,
    trajectory: Trajectory,
    kinematics: Kinematics,
    left: Sequence[tuple[float, float]],
) -> list[str]:
    """The waypoints beside turns at which the tip never has the required angle, in words.

    Parameters
    ----------
    left: the parts of the path that the tip is away from, from s to s [m]. A waypoint there may be
        left out if the tip only passes it, but not if the tip stands still there to turn.
    """
    found = []
    rows, batch = np.flatnonzero(on), BatchKinematics(kinematics.robot)
    for index in path.turned_waypoints.tolist():
        mark = float(path.stations[index])
        if index not in path.standing_waypoints and any(begin <= mark <= end for begin, end in left):
            continue
        behind = min(int(np.searchsorted(station[rows], mark, side="right")), len(rows) - 1)
        before, after = rows[max(behind - 1, 0)], rows[behind]
        turned = float(np.sum(np.abs(trajectory.q[after] - trajectory.q[before])))
        count = max(_PARTS, min(int(np.ceil(turned / (_TURN_PART * angle_tolerance))), _MOST_PARTS))
        parts = np.linspace(0.0, 1.0, count + 1 if after - before == 1 else 2)[:, None]
        between = (1.0 - parts) * trajectory.q[before] + parts * trajectory.q[after]
        target = TargetBatch.of([path.target(mark)]).take(np.zeros(len(between), dtype=np.intp))
        errors = target.errors(batch.at(between))
        distances, angles = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
        near = angles[distances <= tolerance]
        if not len(near) or np.min(near) > angle_tolerance:
            off = _degrees(float(np.min(near)) if len(near) else float(angles[0]), angle_tolerance)
            found.append(f"waypoint {path.number(index)} is passed with the bucket {off} deg from its angle")
    return found


def _degrees(angle: float, allowed: float) -> str:
    """An angle in degrees, in words; if it is more than is `allowed`, it shows that [rad]."""
    return beside_bounds(float(np.degrees(angle)), float(np.degrees(allowed)), places=".1f")[0]


def _close_gaps(on: Flags, first: int, last: int, station: Vector, shortest: float) -> None:
    """Join two detours between which the tip is on the path for less than `shortest` [m]."""
    edges = np.flatnonzero(np.diff(on[first : last + 1].astype(int))) + first + 1
    for start, end in pairwise([first, *edges.tolist(), last + 1]):
        if on[start] and start > first and end <= last and station[end - 1] - station[start] < shortest:
            on[start:end] = False


def _gaps(on: Flags, arcs: Vector, tips: Matrix, tolerance: float) -> list[tuple[int, int]]:
    """The samples before and behind each detour: the tip is off the path, or advances on it by more than it moves.

    Parameters
    ----------
    arcs: (T,) how far along the path the tip is [m], turns not counted.
    """
    way = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    skips = np.diff(arcs) > 1.5 * way + 4.0 * tolerance
    return [(a, b) for a, b in pairwise(np.flatnonzero(on).tolist()) if b > a + 1 or skips[a]]


def _detour(
    path: TipPath, gap: tuple[int, int], station: Vector, error: Vector, angle: Vector, tips: Matrix, time: Vector
) -> Detour:
    """The detour between two samples at which the tip is on the path."""
    a, b = gap
    left_out = _farthest_left_out(path, float(station[a]), float(station[b]), tips[a : b + 1])
    return Detour(
        time_from=float(time[a]), time_to=float(time[b]),
        path_from=path.arc(float(station[a])), path_to=path.arc(float(station[b])),
        length=float(np.sum(np.linalg.norm(np.diff(tips[a : b + 1], axis=0), axis=1))),
        max_deviation=max(float(np.max(error[a + 1 : b], initial=0.0)), left_out),
        max_angle=float(np.max(angle[a + 1 : b], initial=0.0)),
    )  # fmt: skip


def _farthest_left_out(path: TipPath, begin: float, end: float, tips: Matrix) -> float:
    """The farthest that the path from one s to another [m] is from the tip's track (K, 3), at waypoints and between.

    A spike of the path may be left out by a track that is near the path everywhere.
    """
    stations = path.stations[(path.stations > begin) & (path.stations < end)]
    marks = np.union1d(np.linspace(begin, end, _MARKS), stations)
    way = np.diff(tips, axis=0)
    size = np.maximum(np.sum(way * way, axis=1), np.finfo(float).tiny)
    farthest = 0.0
    for place in map(path, marks.tolist()):
        off = place - tips[:-1]
        part = np.clip(np.sum(off * way, axis=1) / size, 0.0, 1.0)
        farthest = max(farthest, float(np.min(np.linalg.norm(off - part[:, None] * way, axis=1))))
    return farthest
