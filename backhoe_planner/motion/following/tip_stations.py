"""Where on its path the tip is at each sample of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Kinematics
from backhoe_planner.motion.goals import ANGLE_TOLERANCE
from backhoe_planner.motion.path import TURN_LEVER, TipPath, targets_along
from backhoe_planner.motion.trajectory import Trajectory

_BEGINNING = 0.1  # part of the path; chosen: while less is done, the tip may still be approaching
_BETTER = 0.1  # part of the tolerances by which a later leg must fit better where a path turns; chosen
_AT_ONCE = 256  # samples whose distances from all legs of a path are bounded at once; chosen: a few megabytes
_LOOK_AHEAD = 0.5  # m of path within which the tip is searched while it follows; chosen


@dataclass(frozen=True, eq=False)
class TipStations:
    """The tip at each of T samples, compared with its path.

    Attributes
    ----------
    station: (T,) s on the path, see `TipPath` [m].
    error: (T,) distance from the path [m].
    angle: (T,) angle from the orientation that the path asks for; 0 where it asks for none [rad].
    tips: (T, 3) positions of the tip in the base frame [m].
    at_begin: (T,) whether the tip is at the first point of the path.
    begins: (T,) whether following may begin at the sample: at the first point, with little of the path done.
    """

    station: Vector
    error: Vector
    angle: Vector
    tips: Matrix
    at_begin: Flags
    begins: Flags


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
    tip = tip_stations(path, tolerance, angle_tolerance, trajectory, kinematics)
    if not tip.at_begin.any():
        return None
    on = (tip.error <= tolerance) & (tip.angle <= angle_tolerance)
    on[: int(np.argmax(tip.at_begin))] = False
    return float(np.max(tip.station[on], initial=0.0))


def tip_stations(
    path: TipPath, tolerance: float, angle_tolerance: float, trajectory: Trajectory, kinematics: Kinematics
) -> TipStations:
    """Where on `path` the tip is at each sample; if the path turns, position and orientation are followed together.

    Parameters
    ----------
    tolerance, angle_tolerance: errors within which the tip counts as on the path [m], [rad].
    trajectory, kinematics: the motion, and the machine that makes it.
    """
    count = len(trajectory)
    station, error, angle = np.zeros(count), np.zeros(count), np.zeros(count)
    at_begin = np.zeros(count, dtype=bool)
    batch = BatchKinematics(kinematics.robot).at(trajectory.q)
    tips = np.ascontiguousarray(batch.tip_position)
    away = np.linalg.norm(tips - path.points[0], axis=1)
    reached, begun, bounds = 0.0, False, np.zeros((0, 0))
    beginning = _length_of_beginning(path, tolerance, angle_tolerance)
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
    begins = at_begin & (path.turns | (station <= beginning))
    return TipStations(station, error, angle, tips, at_begin, begins)


def _length_of_beginning(path: TipPath, tolerance: float, angle_tolerance: float) -> float:
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
