"""How well the tip keeps to its task, from the samples of a motion alone.

Between two samples the tip leaves the straight line between its two positions by at most a
sagitta, see `bend_weights`. It is added to the errors at the samples. How far the tip turns
between two samples is bounded likewise, see `orientation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import Kinematics, TipTarget, bend_weights, tip_travel_bound
from backhoe_planner.motion.orientation import angle_bounds
from backhoe_planner.motion.path import TipPath
from backhoe_planner.motion.trajectory import Trajectory
from backhoe_planner.site import Obstruction

GOAL_TOLERANCE = 1e-3  # m at which a goal is reached; chosen, far below what a machine's control can do
ANGLE_TOLERANCE = 1e-2  # rad at which an asked angle is reached; chosen, half a degree
_BEGINNING = 0.1  # part of the path; chosen: while less is done, the tip may still be approaching
_BESIDE = 10.0  # tolerances before and behind an end of a detour in which the tip swings out or in; chosen
_LOOK_AHEAD = 0.5  # m of path within which the tip is sought while it follows; chosen


@dataclass(frozen=True)
class Detour:
    """A part of the motion that leaves the specified path and comes back to it.

    Attributes
    ----------
    time_from, time_to: when it begins and ends [s].
    path_from, path_to: where the tip leaves the path and where it rejoins it [m].
    length: of the tip's way in between [m].
    max_deviation: largest distance from the path [m].
    obstruction: what the detour goes around, where a planner knows it; a certificate does not.
    """

    time_from: float
    time_to: float
    path_from: float
    path_to: float
    length: float
    max_deviation: float
    obstruction: Obstruction | None = None


@dataclass(frozen=True)
class Tracking:
    """How well the tip kept to its task.

    Attributes
    ----------
    done: whether the goal was reached, or the path followed to its end.
    shortfall: in words, what is missing; empty where done.
    max_error, mean_error: of the tip's position [m]: at the goal, or over the followed parts
        of the path, where the greatest includes the bound for what lies between samples.
    max_angle_error: the same of its angle, the bound at most 0.001 rad above what was measured [rad].
    path_length: of the specified path [m]; 0 for a goal.
    followed: part of it that was followed [m].
    approach_time: when the tip first is on the path [s].
    detours: where it left the path.
    max_speed, max_speed_time: of the tip on the followed parts [m/s], and when [s];
        10 tolerances next to a detour, where it swings out and in again, do not count.
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


def track_goal(goal: TipTarget, trajectory: Trajectory, kinematics: Kinematics) -> Tracking:
    """How close the tip is to `goal` at the last sample.

    Parameters
    ----------
    goal: where the tip is to arrive.
    trajectory, kinematics: the motion, and the machine that makes it.
    """
    position, angle = goal.distances(kinematics.at(trajectory.q[-1]))
    missing = []
    if position > GOAL_TOLERANCE:
        missing.append(f"the tip ends {position:.3f} m from the goal")
    if angle > ANGLE_TOLERANCE:
        missing.append(f"the bucket ends {np.degrees(angle):.1f} deg from the asked angle")
    return Tracking(not missing, " and ".join(missing), position, position, angle)


def track_path(path: TipPath, tolerance: float, trajectory: Trajectory, kinematics: Kinematics) -> Tracking:
    """How the tip keeps to `path` at the samples, with a bound for what lies between them.

    Parameters
    ----------
    path: what the tip is to follow.
    trajectory, kinematics: the motion, and the machine that makes it.
    tolerance: within which the tip counts as on the path [m].
    """
    station, error, angle, tips = _follow(path, tolerance, trajectory, kinematics)
    robot = kinematics.robot
    turning = np.where(robot.prismatic, 0.0, 1.0)
    sagitta = bend_weights(np.diff(trajectory.q, axis=0), turning) @ tip_travel_bound(robot, trajectory.q) / 8.0
    between = np.maximum(np.append(sagitta, 0.0), np.append(0.0, sagitta))
    between[:-1] = np.maximum(between[:-1], _cut_corners(path, station, tips))
    near = error + between <= tolerance
    on = near & (angle <= ANGLE_TOLERANCE)
    if path.asks_orientation:
        turned = angle_bounds(
            path, robot, q=trajectory.q, station=station, angle=angle, segments=on[:-1] & on[1:],
            allowed=ANGLE_TOLERANCE,
        )  # fmt: skip
        angle = np.maximum(angle, np.maximum(np.append(turned, 0.0), np.append(0.0, turned)))
        on &= angle <= ANGLE_TOLERANCE
    if not on.any():
        nearest = int(np.argmin(np.where(near, angle, np.inf) if near.any() else error))
        short = f"the tip never comes onto the path; nearest {error[nearest]:.3f} m"
        if near.any():
            degrees = np.degrees(angle[nearest])
            short = f"the tip is never on the path with the asked orientation; nearest {degrees:.1f} deg"
        off = float(error[nearest])
        return Tracking(False, short, off, off, float(angle[nearest]), path.length)
    # the approach ends where the tip comes nearest to the path's beginning
    at_begin = np.linalg.norm(tips - path.points[0], axis=1) <= tolerance
    begins = np.flatnonzero(on & at_begin & (station <= _beginning(path, tolerance)))
    if not len(begins):
        begins = np.flatnonzero(on)[:1]
    first, last = int(begins[np.argmin(error[begins])]), len(on) - 1 - int(np.argmax(on[::-1]))
    on[:first] = False  # brushing past during the approach is not following
    _close_gaps(on, first, last, station, 2.0 * tolerance)
    detours = _detours(on, station, error, tips, trajectory.time, tolerance)
    skipped = sum(detour.path_to - detour.path_from for detour in detours)
    edges = np.array([edge for detour in detours for edge in (detour.path_from, detour.path_to)])
    max_speed, max_speed_time = _max_speed(on, station, tips, trajectory, kinematics, edges, _BESIDE * tolerance)
    missing = []
    if station[first] > tolerance:
        missing.append(f"the path is joined at {station[first]:.2f} m instead of at its start")
    if station[last] < path.length - tolerance or last < len(on) - 1:
        missing.append(f"the path is followed to {station[last]:.2f} m of {path.length:.2f} m")
    return Tracking(
        done=not missing,
        shortfall=" and ".join(missing),
        max_error=float(np.max((error + between)[on])),
        mean_error=float(np.mean(error[on])),
        max_angle_error=float(np.max(angle[on])),
        path_length=path.length,
        followed=float(station[last] - station[first] - skipped),
        approach_time=float(trajectory.time[first]),
        detours=tuple(detours),
        max_speed=max_speed,
        max_speed_time=max_speed_time,
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
    for row in np.flatnonzero(inside & ~at[:-1]):
        places[row] = kinematics.at(moments.q[row]).tip_position
    speed = np.where(inside, np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(moments.time), 0.0)
    worst = int(np.argmax(speed))
    return float(speed[worst]), float(moments.time[worst])


def progress(path: TipPath, tolerance: float, trajectory: Trajectory, kinematics: Kinematics) -> float | None:
    """Arc length up to which a motion has followed `path` [m]; None where it has not begun to.

    Parameters
    ----------
    trajectory, kinematics: the motion, and the machine that makes it.
    tolerance: within which the tip counts as on the path [m].
    """
    station, error, angle, tips = _follow(path, tolerance, trajectory, kinematics)
    begun = np.linalg.norm(tips - path.points[0], axis=1) <= tolerance
    if not begun.any():
        return None
    on = (error <= tolerance) & (angle <= ANGLE_TOLERANCE)
    on[: int(np.argmax(begun))] = False
    return float(np.max(station[on], initial=0.0))


def _follow(
    path: TipPath, tolerance: float, trajectory: Trajectory, kinematics: Kinematics
) -> tuple[Vector, Vector, Vector, Matrix]:
    """Per sample: arc length, distance from the path, angle error, and tip position."""
    count = len(trajectory)
    station, error, angle, tips = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros((count, 3))
    reached, begun = 0.0, False
    beginning = _beginning(path, tolerance)
    for row in range(count):
        at = kinematics.at(trajectory.q[row])
        tips[row] = at.tip_position
        from_begin = float(np.linalg.norm(at.tip_position - path.points[0]))
        if from_begin <= tolerance and reached <= beginning:
            # an approach may brush along the path before it settles on its beginning
            reached, begun = 0.0, True
        if not begun:
            s, distance = 0.0, from_begin
        else:
            s, distance = path.nearest(at.tip_position, low=reached, high=min(reached + _LOOK_AHEAD, path.length))
            if distance > tolerance:  # it may rejoin further on
                further, nearer = path.nearest(at.tip_position, low=reached)
                s, distance = (further if nearer <= tolerance else s), nearer
            if distance <= tolerance:
                reached = s
        station[row], error[row] = s, distance
        angle[row] = path.target(s).distances(at)[1] if path.asks_orientation else 0.0
    return station, error, angle, tips


def _beginning(path: TipPath, tolerance: float) -> float:
    """Arc length up to which a tip at the path's first point still counts as beginning [m].

    It is shorter where the path itself comes back to its first point.
    """
    usual = _BEGINNING * path.length
    raster = np.arange(0.0, 2.0 * usual, max(tolerance, 1e-3, usual / 5000.0))
    places = np.column_stack([np.interp(raster, path.stations, column) for column in path.points.T])
    away = np.linalg.norm(places - path.points[0], axis=1) > 2.0 * tolerance
    back = np.flatnonzero(~away & (np.cumsum(away) > 0))
    return min(usual, 0.5 * float(raster[back[0]])) if len(back) else usual


def _cut_corners(path: TipPath, station: Vector, tips: Matrix) -> Vector:
    """(T - 1,) how far the chord from sample to sample passes from the path's corners [m]."""
    found = np.zeros(len(station) - 1)
    for mark, corner in zip(path.stations[1:-1], path.points[1:-1], strict=True):
        for row in np.flatnonzero((station[:-1] < mark) & (station[1:] > mark)):
            step = tips[row + 1] - tips[row]
            square = float(step @ step)
            part = float(np.clip((corner - tips[row]) @ step / square, 0.0, 1.0)) if square > 0.0 else 0.0
            found[row] = max(found[row], float(np.linalg.norm(tips[row] + part * step - corner)))
    return found


def _close_gaps(on: Flags, first: int, last: int, station: Vector, shortest: float) -> None:
    """Join two detours between which the tip is on the path for less than `shortest` [m]."""
    edges = np.flatnonzero(np.diff(on[first : last + 1].astype(int))) + first + 1
    for start, end in pairwise([first, *edges.tolist(), last + 1]):
        if on[start] and start > first and end <= last and station[end - 1] - station[start] < shortest:
            on[start:end] = False


def _detours(on: Flags, station: Vector, error: Vector, tips: Matrix, time: Vector, tolerance: float) -> list[Detour]:
    """The detours: where the tip is off the path, and where it advances along the path by more than it moves."""
    way = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    skips = np.diff(station) > 1.5 * way + 4.0 * tolerance
    return [
        Detour(
            time_from=float(time[a]), time_to=float(time[b]), path_from=float(station[a]), path_to=float(station[b]),
            length=float(np.sum(way[a:b])), max_deviation=float(np.max(error[a + 1 : b], initial=0.0)),
        )
        for a, b in pairwise(np.flatnonzero(on).tolist()) if b > a + 1 or skips[a]
    ]  # fmt: skip
