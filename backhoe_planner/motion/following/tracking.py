"""How well the tip follows its task, from the samples of a motion alone.

Between two samples the tip leaves the straight line between its two positions by at most a
sagitta, see `bend_weights`. It is added to the errors at the samples; if the sum is more than the
tolerance, the errors in between are measured too, see `chords`. How far the tip turns between two
samples is bounded likewise, see `orientation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import BatchKinematics, Kinematics, Robot, TargetBatch, bend_weights, tip_travel_bound
from backhoe_planner.motion.following.chords import chord_errors
from backhoe_planner.motion.following.detours import Detour, close_gaps, find_gaps, measure_detour
from backhoe_planner.motion.following.orientation import angle_bounds
from backhoe_planner.motion.following.spot_turns import SpotTurn, largest_spot_turn
from backhoe_planner.motion.following.tip_stations import TipStations, tip_stations
from backhoe_planner.motion.following.waypoint_steps import WaypointStep, longest_step
from backhoe_planner.motion.goals import Goal
from backhoe_planner.motion.path import TipPath
from backhoe_planner.motion.trajectory import Trajectory

_BESIDE = 10.0  # tolerances before and behind an end of a detour in which the tip swings out or in; chosen
_SAME_PLACE = 1e-6  # m: chosen, a smaller difference is rounding of a joint path
_PARTS = 8  # least number of parts of a segment that passes a waypoint, at which the tip's angle is checked; chosen
_TURN_PART = 0.25  # part of the angle's tolerance that the tip turns at most between two of them; chosen
_MOST_PARTS = 2000  # chosen to bound the work


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
    angle_tolerance: float,
    joint_steps: Vector | None,
    may_turn: bool,
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
    tip = tip_stations(path, tolerance, angle_tolerance, trajectory, kinematics)
    off, angle = _with_bounds(path, tip, tolerance, angle_tolerance, trajectory, kinematics.robot)
    on = (off <= tolerance) & (angle <= angle_tolerance)
    if not on.any():
        return _never_on(path, tip, off, angle, tolerance, angle_tolerance)
    first, last = _first_and_last(path, tip, on)
    on[:first] = False  # brushing past during the approach is not following
    close_gaps(on, first, last, tip.station, 2.0 * tolerance)
    station = tip.station
    arcs = np.array([path.arc(float(s)) for s in station]) if path.turns else station
    gaps = find_gaps(on, arcs, tip.tips, tolerance)
    detours = [measure_detour(path, tip, gap, angle, trajectory.time) for gap in gaps]
    skipped = sum(detour.path_to - detour.path_from for detour in detours)
    edges = np.array([station[row] for gap in gaps for row in gap])
    max_speed, max_speed_time = _max_speed(on, tip, trajectory, kinematics, edges, _BESIDE * tolerance)
    step = None
    if joint_steps is not None:
        rows, own = slice(first, last + 1), [(a - first, b - first) for a, b in gaps]
        step = longest_step(path, station[rows], trajectory.q[rows], joint_steps, gaps=own, slack=tolerance)
    turn = None
    if not may_turn:
        turn = largest_spot_turn(trajectory.time, trajectory.q, station, on, tolerance=tolerance)
    missing = _missing_ends(path, tip, first, last, tolerance)
    if not missing:
        left = [(station[a], station[b]) for a, b in gaps if np.max(tip.error[a : b + 1]) > tolerance]
        missing = _missed_angles(path, tolerance, angle_tolerance, on, station, trajectory, kinematics, left)
    return Tracking(
        done=not missing,
        shortfall=" and ".join(missing),
        max_error=float(np.max(off[on])),
        mean_error=float(np.mean(tip.error[on])),
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


def _with_bounds(
    path: TipPath, tip: TipStations, tolerance: float, angle_tolerance: float, trajectory: Trajectory, robot: Robot
) -> tuple[Vector, Vector]:
    """Bounds for the tip's distance from the path [m] and its angle error [rad] next to each sample, (T,) each."""
    turning = np.where(robot.prismatic, 0.0, 1.0)
    sagitta = bend_weights(np.diff(trajectory.q, axis=0), turning) @ tip_travel_bound(robot, trajectory.q) / 8.0
    bound = chord_errors(
        path, robot, q=trajectory.q, station=tip.station, error=tip.error, sagitta=sagitta, tips=tip.tips,
        tolerance=tolerance,
    )  # fmt: skip
    off = tip.error + _at_either_end(bound - np.maximum(tip.error[:-1], tip.error[1:]))
    if not path.asks_orientation:
        return off, tip.angle
    on = (off <= tolerance) & (tip.angle <= angle_tolerance)
    turned = angle_bounds(
        path, robot, q=trajectory.q, station=tip.station, angle=tip.angle, segments=on[:-1] & on[1:],
        allowed=angle_tolerance,
    )  # fmt: skip
    return off, np.maximum(tip.angle, _at_either_end(turned))


def _at_either_end(values: Vector) -> Vector:
    """Of values (T-1,) between samples, none below 0, the greater of the two next to each sample, (T,)."""
    beside: Vector = np.maximum(np.append(values, 0.0), np.append(0.0, values))
    return beside


def _never_on(
    path: TipPath, tip: TipStations, off: Vector, angle: Vector, tolerance: float, angle_tolerance: float
) -> Tracking:
    """The tracking of a motion during which the tip is never on the path.

    Parameters
    ----------
    off, angle: (T,) bounds for the errors next to each sample [m], [rad].
    """
    near = off <= tolerance
    nearest = int(np.argmin(np.where(near, angle, np.inf) if near.any() else tip.error))
    metres = beside_bounds(float(off[nearest]), tolerance, places=".3f")[0]
    short = f"the tip never comes onto the path; nearest {metres} m"
    if near.any():
        degrees = _degrees(float(angle[nearest]), angle_tolerance)
        short = f"the tip is never on the path with the asked orientation; nearest {degrees} deg"
    error = float(tip.error[nearest])
    return Tracking(False, short, error, error, float(angle[nearest]), path.arc(path.length))


def _first_and_last(path: TipPath, tip: TipStations, on: Flags) -> tuple[int, int]:
    """The first and the last sample of following; the approach ends where the tip is nearest to the path's beginning.

    Parameters
    ----------
    on: (T,) whether the tip is on the path at a sample; at one at least.
    """
    begins = np.flatnonzero(on & tip.begins)
    if not len(begins):
        begins = np.flatnonzero(on)[:1]
    away = np.linalg.norm(tip.tips[begins] - path.points[0], axis=1)
    nearest = away <= np.min(away) + _SAME_PLACE
    return int(begins[np.argmax(nearest)]), len(on) - 1 - int(np.argmax(on[::-1]))


def _missing_ends(path: TipPath, tip: TipStations, first: int, last: int, tolerance: float) -> list[str]:
    """What is left out at the path's beginning and end, in words, if it is followed from sample to sample."""
    station, missing = tip.station, []
    if not tip.at_begin[first] if path.turns else station[first] > tolerance:
        missing.append(f"the path is joined at {path.describe(station[first])} instead of at its start")
    if station[last] < path.length - tolerance or last < len(station) - 1:
        missing.append(f"the path is followed to {path.describe(station[last])} of {path.describe_end()}")
    return missing


def _max_speed(
    on: Flags, tip: TipStations, trajectory: Trajectory, kinematics: Kinematics, edges: Vector, beside: float
) -> tuple[float, float]:
    """The tip's greatest speed on the followed segments [m/s] and when [s].

    Parameters
    ----------
    edges: s of the ends of detours [m].
    beside: how far from these ends the speed does not count [m].
    """
    followed = on[:-1] & on[1:]
    for edge in edges.tolist():
        followed &= ~((tip.station[:-1] < edge + beside) & (tip.station[1:] > edge - beside))
    if not followed.any():
        return 0.0, 0.0
    moments = trajectory.moments()
    inside = followed[moments.segment[:-1]]
    at = np.diff(moments.segment, prepend=-1) > 0  # the samples
    places = np.zeros((len(at), 3))
    places[at] = tip.tips
    rows = np.flatnonzero(inside & ~at[:-1])
    places[rows] = BatchKinematics(kinematics.robot).at(moments.q[rows]).tip_position
    speed = np.where(inside, np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(moments.time), 0.0)
    worst = int(np.argmax(speed))
    return float(speed[worst]), float(moments.time[worst])


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
