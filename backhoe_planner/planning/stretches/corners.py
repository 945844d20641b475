"""Corners of a tip path: rounded within its tolerance where that is clear; otherwise the tip stops there.

The tip cuts a corner along a parabola that begins and ends at the same distance from it along
the path, and is off the path by no more than a part of the tolerance.
"""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    FastestRun,
    Problem,
    TipPath,
    Trajectory,
    drive_of,
    step_lengths,
    targets_along,
)
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.planning.stretches.kept_cones import KeptCones, cones_kept_by
from backhoe_planner.planning.stretches.stretch import Stretch
from backhoe_planner.proof import path_segment_is_clear
from backhoe_planner.site import Proximity

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

SHARP = np.radians(5.0)  # chosen: at a sharper corner the joints' velocities would jump noticeably
# chosen: at the limits of usual joints, bends below do not slow the tip down noticeably
_SLIGHT = np.radians(1.0)
_SHARPEST = np.radians(120.0)  # chosen: a sharper corner nearly reverses the direction, and the tip stops at it
_PART = 0.4  # part of the tolerance for a rounded corner; chosen: the rest is for chords and curve
_CHORD = 0.3  # part of the tolerance for the joints' chords; chosen: some is left for the smooth curve
_DENSEST = 0.05  # part of the usual period between samples, at least; chosen: chords are then 400 times nearer
_REFINED = 8  # times that samples may be inserted between two; chosen: this makes 256 intervals
_FINEST = 1e-4  # m: no sample is inserted between samples nearer than this; chosen
_INTERVALS = 1000  # of a stretch, at whose ends limits are checked; chosen: more hardly make a motion faster
_FEWEST_INTERVALS = 40  # of one motion between two stops; chosen: with fewer it is noticeably slower
_LEAST_LENGTH = 1e-6  # m of a step between samples
_STILL = 1e-12  # rad or m: joints that move less count as at rest
_ON_PATH = 1e-6  # m: a sample nearer to the path than this is on it, not on a rounded corner
_LEG = 0.45  # part of a leg that a corner may use: two corners share a leg, and some of it is left
_SPACING = 0.01  # m between the samples of a rounded corner at most: as on the path itself
_FEWEST = 9  # samples of a rounded corner; chosen: four to each side of its middle
_PARTS = np.arange(1, 8) / 8  # of a straight segment, at which its distance from a corner's legs is measured; chosen
_NEAR = 0.1  # rad or m; chosen: joints further from those on the path are another posture


def round_corners(
    problem: Problem, path: TipPath, stretch: Stretch, *, proximity: Proximity, time: float = 0.0
) -> tuple[Stretch, Vector]:
    """A stretch with its corners rounded where that is clear, and (C,) the arc lengths of the other sharp corners [m].

    At slight bends that are not rounded the tip need not stop. They are left as they are if their rounding would be
    shorter than the distance between samples.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].
    """
    stations, q = stretch.stations, stretch.q
    task = problem.scene.task.path
    assert task is not None
    left: list[float] = []
    kinematics, cones = BatchKinematics(problem.robot), cones_kept_by(q, problem, path)
    sharp = set(path.corners(SHARP).tolist())
    for corner in path.corners(_SLIGHT).tolist():
        if not stations[0] < corner < stations[-1]:
            continue
        cut = _cut(path, corner, _PART * task.tolerance, float(stations[0]), float(stations[-1]))
        rounded = None
        if cut is not None and (corner in sharp or cut > _SPACING):
            at = np.linspace(corner - cut, corner + cut, max(_FEWEST, 2 * int(np.ceil(cut / _SPACING)) + 1))
            rounded = _round(kinematics, path, corner, cut, at, stations, q, cones)
            if rounded is not None and cones is not None and not cones.motion_holds(rounded):
                rounded = None
        if rounded is None or not all(path_segment_is_clear(proximity, a, b, time=time) for a, b in pairwise(rounded)):
            if corner in sharp:
                left.append(corner)
            continue
        before, after = stations < at[0] - 1e-9, stations > at[-1] + 1e-9
        stations = np.concatenate((stations[before], at, stations[after]))
        q = np.vstack((q[before], rounded, q[after]))
    return Stretch(stations, q), np.array(left)


def time_stretch(
    problem: Problem,
    path: TipPath,
    stretch: Stretch,
    *,
    period: float = SAMPLE_PERIOD,
    stops: Vector | None = None,
    brake: Brake | None = None,
) -> list[Trajectory]:
    """The motions, each from rest to rest, that follow a stretch of the scene's path at its speed or less.

    They share a fixed number of intervals for checking limits, in proportion to their lengths.

    Parameters
    ----------
    period: between the samples of the motions [s]; less where the tolerance of the path requires it.
    stops: (C,) arc lengths to stop at [m]; by default all sharp corners of the path.
    brake: once no time is left, the rest is timed on the fewest intervals; by default none.
    """
    brake = brake or Brake()
    task, drive, stations, q = problem.scene.task.path, drive_of(problem), stretch.stations, stretch.q
    assert task is not None
    kinematics = BatchKinematics(problem.robot)
    marks = {0, len(stations) - 1}
    for corner in (path.corners(SHARP) if stops is None else stops).tolist():
        if stations[0] < corner < stations[-1]:
            marks.add(int(np.argmin(np.abs(stations - corner))))
    lengths = step_lengths(stations, q, least=_LEAST_LENGTH)
    shared = _INTERVALS / max(float(np.sum(lengths)), _LEAST_LENGTH)  # a stretch may end where it begins
    found = []
    for first, last in pairwise(sorted(marks)):
        share = 0.0 if brake.is_used_up() else shared * float(np.sum(lengths[first:last]))
        intervals = max(int(np.ceil(share)), _FEWEST_INTERVALS)
        own = Stretch(stations[first : last + 1], q[first : last + 1])
        own = _dense_enough(problem, path, own, _CHORD * task.tolerance)

        run = FastestRun(
            own.stations, own.q, problem.limits,
            speed=task.speed, kinematics=kinematics, drive=drive, intervals=intervals,
        )  # fmt: skip
        denser = 1.0
        off = _off_chords(kinematics, run.samples(period)[1])
        if off > _CHORD * task.tolerance:  # the deviation of chords is proportional to the square of the period
            denser = max(float(np.sqrt(0.8 * _CHORD * task.tolerance / off)), _DENSEST)
        # samples further apart than the length of a rounded corner would cut it once more
        passed, allowed = _passed_waypoints(path, own), (_PART + _CHORD) * task.tolerance
        while denser > _DENSEST and _off_corners(kinematics, path, passed, run.samples(denser * period)[1]) > allowed:
            denser = max(0.5 * denser, _DENSEST)
        found.append(run.motion(denser * period))
    return found


def _dense_enough(problem: Problem, path: TipPath, stretch: Stretch, allowed: float) -> Stretch:
    """A stretch with more samples wherever a smooth curve through them is off the path by more than `allowed` [m]."""
    from scipy.interpolate import CubicSpline

    kinematics, stations, q = BatchKinematics(problem.robot), stretch.stations, stretch.q
    for _ in range(_REFINED):
        if len(stations) < 4 or float(np.max(np.abs(np.diff(q, axis=0)))) < _STILL:
            break
        along = np.concatenate(([0.0], np.cumsum(step_lengths(stations, q, least=1e-6))))
        curve = np.asarray(CubicSpline(along, q, axis=0)(0.5 * (along[1:] + along[:-1])))
        tips, ends = kinematics.at(curve).tip_position, kinematics.at(q).tip_position
        on = _on_path(ends, path, stations)
        chords = np.diff(ends, axis=0)  # between two samples on the path the chord is on one leg
        squares = np.maximum(np.sum(chords * chords, axis=1), 1e-18)
        part = np.sum((tips - ends[:-1]) * chords, axis=1) / squares
        off = np.linalg.norm(tips - ends[:-1] - part[:, None] * chords, axis=1)
        rows = np.flatnonzero((off > allowed) & on[:-1] & on[1:] & (np.diff(stations) > _FINEST))
        if not len(rows):
            break
        stations, q = _with_samples(problem, path, stations, q, rows, curve[rows])
    return Stretch(stations, q)


def with_halfways(problem: Problem, path: TipPath, stretch: Stretch) -> Stretch:
    """A stretch with one more sample between any two on the path between which the joints move."""
    kinematics, stations, q = BatchKinematics(problem.robot), stretch.stations, stretch.q
    on = _on_path(kinematics.at(q).tip_position, path, stations)
    moving = np.max(np.abs(np.diff(q, axis=0)), axis=1, initial=0.0) > _STILL
    rows = np.flatnonzero(on[:-1] & on[1:] & moving)
    if not len(rows):
        return stretch
    guesses = 0.5 * (q[1:] + q[:-1])[rows]
    return Stretch(*_with_samples(problem, path, stations, q, rows, guesses, near=_NEAR), stretch.obstruction)


def _on_path(tips: Matrix, path: TipPath, stations: Vector) -> Flags:
    """(T,) whether each of the tip's positions (T, 3) is on the path at its station (T,) [m]."""
    return np.asarray(np.linalg.norm(tips - targets_along(path, stations).position, axis=1) < _ON_PATH)


def _with_samples(
    problem: Problem, path: TipPath, stations: Vector, q: Matrix, rows: Indices, guesses: Matrix,
    *, near: float = np.inf,
) -> tuple[Vector, Matrix]:  # fmt: skip
    """Stations (T,) [m] and joints (T, n) with one more sample on the path halfway after each of `rows` (K,).

    If no solution is found within `near` [rad or m] of the guess (K, n), no sample is added there.
    """
    halfway = 0.5 * (stations[rows] + stations[rows + 1])
    targets, cones = targets_along(path, halfway), cones_kept_by(q, problem, path)
    targets = targets if cones is None else cones.narrowed(targets)
    between, reached = solve_batch(BatchKinematics(problem.robot), targets, guesses, iterations=12)
    reached &= np.max(np.abs(between - guesses), axis=1) < near
    rows, halfway, between = rows[reached], halfway[reached], between[reached]
    return np.insert(stations, rows + 1, halfway), np.insert(q, rows + 1, between, axis=0)


def _off_chords(kinematics: BatchKinematics, q: Matrix) -> float:
    """How far the tip is off the straight lines between its positions at q (T, n), halfway between two of them [m]."""
    if len(q) < 2:
        return 0.0
    tips, halfway = kinematics.at(q).tip_position, kinematics.at(0.5 * (q[1:] + q[:-1])).tip_position
    chords, off = np.diff(tips, axis=0), halfway - tips[:-1]
    squares = np.maximum(np.sum(chords * chords, axis=1), 1e-18)
    along = np.sum(off * chords, axis=1) / squares
    return float(np.max(np.linalg.norm(off - along[:, None] * chords, axis=1)))


def _passed_waypoints(path: TipPath, stretch: Stretch) -> Indices:
    """(C,) indices of the waypoints between the ends of a stretch."""
    marks = path.stations[1:-1]
    return 1 + np.flatnonzero((marks > stretch.stations[0]) & (marks < stretch.stations[-1]))


def _off_corners(kinematics: BatchKinematics, path: TipPath, waypoints: Indices, q: Matrix) -> float:
    """How far straight segments between tip positions at q (T, n) are off both legs at a waypoint that they pass [m].

    Parameters
    ----------
    waypoints: (C,) their indices.
    """
    if not len(waypoints) or len(q) < 2:
        return 0.0
    from scipy.spatial import cKDTree

    tips, corners = kinematics.at(q).tip_position, path.points[waypoints]
    ways = np.diff(tips, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    # a segment passes a waypoint if one of its ends is nearer to the waypoint than the segment is long
    begins, ends = (_pairs_within(cKDTree(points), corners, lengths) for points in (tips[:-1], tips[1:]))
    segment, row = np.append(begins[0], ends[0]), waypoints[np.append(begins[1], ends[1])]
    points = tips[segment] + _PARTS[:, None, None] * ways[segment]
    off = np.minimum(*(_off_legs(points, path.points[row], path.points[beside]) for beside in (row - 1, row + 1)))
    return float(np.max(off, initial=0.0))


def _pairs_within(tree: cKDTree, centres: Matrix, reach: Vector) -> tuple[Indices, Indices]:
    """The points of a tree, and the `centres` (C, 3) [m] that are nearer to each than its own `reach` (T,) [m]."""
    found = tree.query_ball_point(centres, float(np.max(reach)), return_sorted=False)
    counts = [len(points) for points in found]
    point = np.fromiter(chain.from_iterable(found), dtype=np.intp, count=sum(counts))
    centre = np.repeat(np.arange(len(centres)), counts)
    near = np.linalg.norm(tree.data[point] - centres[centre], axis=1) < reach[point]
    return point[near], centre[near]


def _off_legs(points: Array, begins: Matrix, ends: Matrix) -> Matrix:
    """(P, K) distances of points (P, K, 3) from K straight segments from `begins` to `ends` (K, 3) [m]."""
    legs = ends - begins
    squares = np.maximum(np.sum(legs * legs, axis=1), 1e-18)
    part = np.clip(np.sum((points - begins) * legs, axis=2) / squares, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - begins - part[:, :, None] * legs, axis=2))


def _cut(path: TipPath, corner: float, off: float, low: float, high: float) -> float | None:
    """How far before and after a corner to cut [m]; None if the corner is too sharp, or the tip turns on the spot.

    Parameters
    ----------
    off: allowed distance from the path [m].
    low, high: arc lengths between which the path is followed [m].
    """
    index = int(np.argmin(np.abs(path.stations - corner)))
    legs = np.diff(path.points[index - 1 : index + 2], axis=0)
    sizes = np.linalg.norm(legs, axis=1)
    if np.min(sizes) < 1e-9:
        return None
    turns = bool(np.any(path.turning[index - 1 : index + 1]))
    bend = float(np.arccos(np.clip(legs[0] @ legs[1] / (sizes[0] * sizes[1]), -1.0, 1.0)))
    if bend > _SHARPEST or (turns and bend < SHARP):  # no parabola rounds a turn of the tip
        return None
    # the parabola's middle is half of cut * sin(bend / 2) off the corner
    longest = min(_LEG * float(np.min(sizes)), 0.9 * (corner - low), 0.9 * (high - corner))
    # next to very short legs, which do not define a direction well, a corner may not bend at all
    return longest if longest * np.sin(0.5 * bend) <= 2.0 * off else 2.0 * off / float(np.sin(0.5 * bend))


def _round(
    kinematics: BatchKinematics, path: TipPath, corner: float, cut: float, at: Vector, stations: Vector, q: Matrix,
    cones: KeptCones | None,
) -> Matrix | None:  # fmt: skip
    """(M, n) joints with the tip on the parabola, within `cones`; None if none are near those on the path."""
    begin, middle, end = path(corner - cut), path(corner), path(corner + cut)
    part = (at - at[0])[:, None] / (at[-1] - at[0])
    positions = (1.0 - part) ** 2 * begin + 2.0 * part * (1.0 - part) * middle + part**2 * end
    asked = [path.target(float(s)) for s in at]
    targets = TargetBatch.of([TipTarget(p, one.pitch, one.rotation) for p, one in zip(positions, asked, strict=True)])
    targets = targets if cones is None else cones.narrowed(targets)
    guesses = np.column_stack([np.interp(at, stations, column) for column in q.T])
    found, reached = solve_batch(kinematics, targets, guesses, iterations=12)
    near = np.max(np.abs(found - guesses)) < _NEAR
    return found if reached.all() and near else None
