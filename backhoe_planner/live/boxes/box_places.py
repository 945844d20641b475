"""Where the boxes that represent clusters were found, and how far the links may move from there.

Boxes contain all cells that were within `covered` of a link where they were found. So they are valid for everything
that the machine may do in some steps followed by braking, if no point of the link moves further from where it was
then than `covered` minus the clearance.

In that time the joints stay within `spread` of a straight line, on which they go on as fast as now. The link is placed
at the ends of equal parts of that line. Between these a point is off its chord by no more than `bend_weights` says,
and off the line by no more than the spread times its radii. This bound is far smaller than the lengths of all joint
motions times these radii.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.boxes.cluster_pairs import ClusterPairs
from backhoe_planner.live.braking.braking_path import JointState, Placements, place_on_line
from backhoe_planner.live.braking.joint_bounds import JointBounds
from backhoe_planner.machine import bend_weights
from backhoe_planner.native import compiled

_OFF = 0.02  # m that points may be off their chords; chosen, small beside the travel of links in motion
MOST_PARTS = 4  # of the line; chosen, to bound the work
SLACK = 0.15  # part of the distance by which boxes may be nearer than their cells; chosen, less makes more boxes
_HOLDS_BACK = 0.05  # m of margin within which a box along the line may hold the machine back; chosen
_CLOSE = 0.2  # of the nearest distance: when a link has moved by more than this, its boxes are found again; chosen
_LEAST = 0.02  # m, least value of that travel; chosen, so that it is not done at every step at a wall
_RULES = _CLOSE, _LEAST


class Line(NamedTuple):
    """The straight line along which the joints go on, in equal parts.

    Attributes
    ----------
    ends: (S, n) of the parts, from where the joints are [rad or m].
    beside: (C,) how far points of each class may leave the chords between their places at the ends [m].
    way: (C,) how far they may move from where they are [m].
    change: (C,) how far they may move at the end of the braking path until braking begins [m].
    time: until the machine stands still [s].
    """

    ends: Matrix
    beside: Vector
    way: Vector
    change: Vector
    time: float

    @classmethod
    def ahead(
        cls, state: JointState, joints: JointBounds, steps: int, *, travel: Matrix, furthest: Vector, turning: Vector
    ) -> Line:
        """The line of `steps` and one more, followed by braking; see `Separation` for `travel` and the others."""
        return cls(*line_ahead(*line_arguments(state, joints, steps), travel, furthest, turning, _parts(joints, steps)))


def line_arguments(state: JointState, joints: JointBounds, steps: int) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """The first arguments of `line_ahead`, for `steps` and one more."""
    return *state, (steps + 1) * joints.change, joints.acceleration


def _parts(joints: JointBounds, steps: int) -> tuple[float, ...]:
    """The rules of `line_ahead`."""
    return (steps + 1) * joints.dt, _OFF, MOST_PARTS


class BoxPlaces:
    """Where the boxes of K links were found, each around one cluster, and what they cover.

    Parameters
    ----------
    clusters: the K pairs of a link with a cluster.
    joint, fat, columns: for every piece the joint, the radius [m], and the corners with a 1 below each (4, V) [m].
    counting: those of `clusters` that count now.

    Attributes
    ----------
    clusters: as above.
    counts: (K,) 1 for those that count, 0 for others.
    classes: (K,) as in `ClusterPairs`.
    """

    def __init__(
        self, clusters: Sequence[ClusterPairs], joint: Indices, fat: Vector, columns: Array,
        *, counting: Sequence[ClusterPairs],
    ) -> None:  # fmt: skip
        self.clusters = list(clusters)
        self.counts = np.array([one in counting for one in clusters], dtype=float)
        pieces = np.array([one.piece for one in clusters], dtype=np.intp)
        self._joint, self._fat, self._columns = joint[pieces], fat[pieces], np.ascontiguousarray(columns[pieces])
        self._pairs: Indices = np.array([one.pairs for one in clusters], dtype=np.intp).reshape(-1)
        self.classes = np.array([one.classes for one in clusters], dtype=np.intp)
        self._clearance = np.array([one.clearance for one in clusters], dtype=float)
        self._covered, self._nearest, self._speed = np.zeros((3, len(pieces)))
        self._found_at = np.zeros((len(pieces), 3, 4))
        self._witnesses = np.full((len(pieces), len(self._pairs) // max(len(pieces), 1), 6), np.nan)
        for one in clusters:
            self.note(one)

    def note(self, one: ClusterPairs) -> None:
        """Note that the boxes of a link were found again, or that its cluster has moved on or has another speed."""
        row = self.clusters.index(one)
        self._found_at[row], self._covered[row], self._nearest[row] = one.found_at, one.covered, one.nearest
        self._speed[row] = one.speed
        self._witnesses[row] = one.witnesses if one.speed == 0.0 else np.nan

    def moved(self, T: Array) -> Matrix:
        """(S, K) upper bound of how far any point of a link is from where it was when its boxes were found [m].

        T: (S, joints, 4, 4) see `Placements`.
        """
        return ways_of_links(T, self._joint, self._found_at, self._columns, self._fat)

    def most_urgent(
        self, state: JointState, joints: JointBounds, steps: int, at: Placements, room: Placements,
        known: KnownDistances, planes: Matrix, *, travel: Matrix, furthest: Vector, turning: Vector, near: float,
    ) -> tuple[ClusterPairs | None, float, Line]:  # fmt: skip
        """The link whose boxes must be found again first to hold for the line ahead, its urgency, and the line.

        Boxes have to be found again from urgency 1 on; below, the link is None. Infinite means that they do not hold.

        Parameters
        ----------
        state, joints, steps, travel, furthest, turning: see `Line.ahead`. There must be a link with boxes.
        at: placements whose row 0 holds the machine; room: output, the placements of the line's ends.
        planes: (P, 4) of all pairs, see `Separation`.
        near: margin within which boxes are to be exact where the machine is [m].
        """
        row, most, ends, beside, way, change, time = most_urgent_boxes(
            *line_arguments(state, joints, steps), travel, furthest, turning, _parts(joints, steps), *room.chain,
            self._joint, self._columns, self._witnesses, planes, self._pairs, self.classes, self._clearance, *known,
            (near, _HOLDS_BACK, 1.0 - SLACK), self._found_at, self._fat, self._covered, self._nearest, self._speed,
            self.counts, _RULES, at.T[0], room.T, room.J,
        )  # fmt: skip
        return (self.clusters[row] if most >= 1.0 else None), most, Line(ends, beside, way, change, time)

    def way_of(self, one: ClusterPairs, T: Array) -> float:
        """Upper bound of how far any point of a link is from where it is in the first of the placements T [m]."""
        row = slice(self.clusters.index(one), self.clusters.index(one) + 1)
        begun = T[0, self._joint[row], :3]
        return float(ways_of_links(T, self._joint[row], begun, self._columns[row], self._fat[row]).max())


class KnownDistances(NamedTuple):
    """The known bounds of the distances of all pairs, each plus its odometer's value then, and the odometers.

    Attributes
    ----------
    distance, odometer: (P,) where the machine is, and (C,) the odometers' present values [m].
    proven, path_odometer: (P,), (C,) the same over its braking path [m].
    """

    distance: Vector
    odometer: Vector
    proven: Vector
    path_odometer: Vector


@compiled
def line_ahead(
    q: Vector, v: Vector, end: Vector, gained: Vector, acceleration: Vector, travel: Matrix, furthest: Vector,
    turning: Vector, rules: tuple[float, ...], /,
) -> tuple[Matrix, Vector, Vector, Vector, float]:  # fmt: skip
    """The fields of `Line` from q, v (n,) and the `end` (n,) of the present braking path [rad or m].

    The joints move at velocities v_k that are within `gained` of v, and brake in proportion from one of them, which
    covers T_k / 2 times v_k. So after t seconds at these velocities they are within t times `gained` of q + v t, and t
    is bounded by `rules` and by braking.

    Parameters
    ----------
    gained: (n,) by how much each velocity can change until braking begins [rad/s or m/s].
    acceleration: (n,) that braking is planned with [rad/s^2 or m/s^2].
    travel, furthest, turning: (C, n), (n,), (n,) see `Separation`.
    rules: when braking begins [s], how far points may be off their chords [m], and the greatest number of parts.
    """
    begins, off, most = rules
    speed = np.abs(v)
    braking = float(((speed + gained) / acceleration).max())
    look = begins + 0.5 * braking
    delta = look * v
    spread = np.maximum(look * gained, np.abs(end - q - 0.5 * float((speed / acceleration).max()) * v))
    bend = bend_weights(delta, turning)
    parts = min(max(math.ceil(math.sqrt(float(bend.dot(furthest)) / (8.0 * off))), 1), int(most))
    ends = q + np.arange(parts + 1)[:, None] / parts * delta
    return (
        ends, travel.dot(bend / (8.0 * parts * parts) + spread), travel.dot(np.abs(delta) + spread),
        travel.dot(begins * speed + spread), begins + braking,
    )  # fmt: skip


@compiled
def most_urgent_boxes(
    q: Vector, v: Vector, end: Vector, gained: Vector, acceleration: Vector, travel: Matrix, furthest: Vector,
    turning: Vector, line_rules: tuple[float, ...], factors: Matrix, slides: Vector, joint: Indices, columns: Array,
    witnesses: Array, planes: Matrix, pairs: Indices, classes: Indices, clearance: Vector, distance: Vector,
    odometer: Vector, proven: Vector, path_odometer: Vector, exact_rules: tuple[float, ...], begun: Array, fat: Vector,
    covered: Vector, nearest: Vector, speed: Vector, counts: Vector, urgent_rules: tuple[float, ...], now: Array,
    T: Array, J: Array, /,
) -> tuple[int, float, Matrix, Vector, Vector, Vector, float]:  # fmt: skip
    """Which of K links, K > 0, has the greatest `box_urgency` for the line ahead; the urgency; and the line.

    Parameters
    ----------
    q to line_rules: see `line_ahead`; factors, slides: see `place_on_line`.
    joint to exact_rules: see `inexact_boxes`; begun, fat: see `ways_of_links`; covered to urgent_rules: `box_urgency`.
    now: (joints, 4, 4) placement of the machine.
    T, J: output: the placements of the line's ends.
    """
    line = line_ahead(q, v, end, gained, acceleration, travel, furthest, turning, line_rules)
    ends, beside, way, change, time = line
    T[0] = now
    place_on_line(q, ends[-1] - q, len(ends) - 1, 1, factors, slides, T, J)
    at = T[: len(ends)]
    inexact = inexact_boxes(
        at, joint, columns, witnesses, planes, pairs, classes, clearance, beside, way, change,
        distance, odometer, proven, path_odometer, exact_rules,
    )  # fmt: skip
    moved = ways_of_links(at, joint, begun, columns, fat)
    urgency = box_urgency(
        moved, covered, nearest, clearance, speed, counts, classes, beside, time, inexact, urgent_rules
    )
    row = int(urgency.argmax())
    return row, float(urgency[row]), *line


@compiled
def inexact_boxes(
    T: Array, joint: Indices, columns: Array, witnesses: Array, planes: Matrix, pairs: Indices, classes: Indices,
    clearance: Vector, beside: Vector, way: Vector, change: Vector, distance: Vector, odometer: Vector, proven: Vector,
    path_odometer: Vector, rules: tuple[float, ...], /,
) -> Vector:  # fmt: skip
    """(K,) 1 for links with a box that matters and may be less exact than if it were found again.

    A box matters if it is near now, so that it acts, or if it comes so near on the line that it may hold the link back.

    A box is still exact if the point of the link that was nearest to the cell at its face is hardly further away from
    that cell than the link is from the box: the cells are no further than that.

    Parameters
    ----------
    T: (S, joints, 4, 4) placements of the line's ends; the first one is where the machine is.
    joint, columns, classes, clearance: (K,), (K, 4, V), (K,), (K,) see `BoxPlaces`.
    witnesses: (K, B, 6) see `ClusterPairs`.
    planes: (P, 4) of all pairs, see `Separation`; those of clusters are in the world.
    pairs: (K B,) the pairs of the links.
    beside, way, change: see `Line`.
    distance, odometer, proven, path_odometer: see `KnownDistances`.
    rules: margin within which a box is near now, margin within which one comes near [m], and the least part of a
        cell's distance that its box must have.
    """
    near, comes_near, exact = rules
    each = pairs.reshape(len(joint), -1)
    at = T.take(joint, axis=1)[:, :, :3]
    seen = planes.take(each, axis=0)
    gaps = (np.matmul(seen[..., :3], np.matmul(at, columns)) + seen[..., 3:]).min(axis=3)
    here = distance.take(each) - odometer.take(classes)[:, None]
    over = proven.take(each) - (path_odometer + change).take(classes)[:, None]
    least = np.maximum(gaps.min(axis=0) - beside.take(classes)[:, None], here - way.take(classes)[:, None])
    matters = np.maximum(least, over) < (clearance + comes_near)[:, None]
    matters |= np.maximum(gaps[0], here) < (clearance + near)[:, None]
    points = np.matmul(witnesses[..., :3], at[0, :, :, :3].transpose(0, 2, 1)) + at[0, :, None, :, 3]
    points -= witnesses[..., 3:]
    points *= points
    is_exact = np.maximum(gaps[0], here) >= exact * np.sqrt(np.add.reduce(points, axis=2))
    return np.asarray((matters & ~is_exact).any(axis=1), dtype=float)


@compiled
def box_urgency(
    moved: Matrix, covered: Vector, nearest: Vector, clearance: Vector, speed: Vector, counts: Vector, classes: Indices,
    beside: Vector, time: float, inexact: Vector, rules: tuple[float, ...], /,
) -> Vector:  # fmt: skip
    """(K,) how urgently the boxes of K links have to be found again; infinite if they do not cover what a line needs.

    They have to be if little is left of the distance that they cover, or if one of them matters and may be inexact and
    the link has moved by a certain part of the distance to its nearest box.

    Parameters
    ----------
    moved: (S, K) how far each link is from where its boxes were found, at the ends of the line's parts [m].
    covered, nearest, clearance, speed, counts, classes: (K,) see `BoxPlaces`.
    beside, time: see `Line`.
    inexact: (K,) see `inexact_boxes`.
    rules: `_CLOSE` and `_LEAST`.
    """
    close, least = rules
    left = covered - clearance - speed * time
    left -= moved.max(axis=0)
    left -= beside.take(classes)
    aside = np.where(inexact > 0.0, moved[0] / np.maximum(least, close * nearest), 0.0)
    holds = left > 0.0
    found = np.where(holds, np.maximum(aside, least / np.where(holds, left, 1.0)), np.inf)
    return np.asarray(np.where(counts > 0.0, found, 0.0))


@compiled
def ways_of_links(T: Array, joint: Indices, begun: Array, columns: Array, fat: Vector, /) -> Matrix:
    """(S, K) upper bound of how far any point of a link is from where it was with its body at `begun` (K, 3, 4) [m].

    The displacement is affine in the point's place in the frame of the link, so no point in the hull of the corners
    moves further than a corner.

    Parameters
    ----------
    T: (S, joints, 4, 4) see `Placements`.
    joint: (K,) of each link's body.
    columns: (K, 4, V) the link's corners with a 1 below each; fat: (K,) the link is within this of their hull [m].
    """
    change = T.take(joint, axis=1)[:, :, :3] - begun
    off = np.matmul(change, columns)
    off *= off
    turn = change[..., :3]
    turn *= turn
    moved = np.sqrt(np.add.reduce(off, axis=2).max(axis=2))
    moved += fat * np.sqrt(np.add.reduce(turn, axis=(2, 3)))
    return np.asarray(moved)


@compiled
def put_planes(
    numbers: Matrix, pairs: Indices, fat: float, velocity: Matrix, shift: Vector, found_at: Matrix, far: float,
    planes: Matrix, drift: Vector, points: Matrix, faces: Matrix, witnesses: Matrix, /,
) -> Vector:  # fmt: skip
    """(K,) distances of the `pairs` (K,) of a link from boxes, `far` for a pair without a box [m].

    Parameters
    ----------
    numbers: (B, 50) of the boxes, see `boxes_of_cells`.
    fat: the link is within this of the hull of its corners [m].
    velocity: (P, 3) of all pairs' obstacles [m/s]; shift: (3,) of this one from where it was built [m].
    found_at: (3, 4) pose of the link's body when they were found [m].
    planes, drift, points: (P, 4), (P,), (P, 6) of all pairs, see `Separation`, written.
    faces: (P, 15) of all pairs, see `faces_of`, written.
    witnesses: (K, 6) see `ClusterPairs`, written.
    """
    count = len(numbers)
    distance = np.full(len(pairs), far)
    planes[pairs], drift[pairs], points[pairs], witnesses[...] = (0.0, 0.0, 0.0, far), 0.0, np.nan, np.nan
    faces[pairs] = np.nan
    faces[pairs[:count]] = np.hstack((numbers[:, 10:22], 0.5 * numbers[:, 22:25]))
    some, n, corners = pairs[:count], numbers[:, 1:4], numbers[:, 25:49].reshape(count, 8, 3)
    distance[:count] = numbers[:, 0]
    planes[some, :3] = -n
    planes[some, 3] = np.matmul(corners, n[:, :, None])[..., 0].min(axis=1) + n.dot(shift) - fat
    drift[some] = np.vecdot(n, velocity[some])
    seen = (numbers[:, 49] > 0.0).nonzero()[0]
    witnesses[seen, :3] = (numbers[seen, 4:7] + (shift - found_at[:, 3])).dot(found_at[:, :3])
    witnesses[seen, 3:] = numbers[seen, 7:10] + shift
    return distance
