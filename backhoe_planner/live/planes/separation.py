"""Planes between the machine and what it must not touch.

The signed distance of two convex bodies is the largest gap that any plane leaves
between them: with unit normal n from the link to the obstacle,

    d = max_n  (min over the obstacle of n . z) - (max over the link of n . x)

The maximum is reached by coal's normal, also in penetration. So the plane of one measurement
bounds the distance at all other configurations as well, without calling coal: as long as the
obstacle stands still, it stays on its side of the plane, and the gap between the plane and
the corners of the link, wherever they are, is a lower bound of the distance. The same holds
for a plane that moves with the link, and the corners of the obstacle.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from itertools import zip_longest

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.live.boxes.box_places import BoxPlaces, put_planes
from backhoe_planner.live.boxes.cluster_pairs import SLOTS, BoxSearch, ClusterPairs, KeptBoxes
from backhoe_planner.live.boxes.placed_piece import PlacedPiece
from backhoe_planner.live.braking.braking_path import BrakingPath, Placements
from backhoe_planner.live.braking.gaps import (
    Gaps,
    Memory,
    corner_gaps,
    least_over_path,
    near_gaps,
    nearest_rows,
    plane_rows,
)
from backhoe_planner.live.planes.own_pieces import NO_LOAD, own_pieces, rows_on
from backhoe_planner.live.planes.pair_choice import Measured, hulls_apart, known_apart
from backhoe_planner.live.planes.path_rows import gaps_along_path
from backhoe_planner.live.planes.plane_sets import PlaneSets
from backhoe_planner.machine import (
    Cluster,
    Part,
    Robot,
    bend_weights,
    covering_balls,
    reach_ball,
    tracking_room,
    travel_bounds,
)
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle

MACHINE = -1  # owner of the pairs of the machine with itself
FAR = 1e3  # m: beyond any site; the bound -FAR is no information
_NOT_COUNTING = -1e9  # m: clearance of the pairs of loads that are not carried now; far below any bound of a distance
_PLANES = 4  # measured along a path that is examined closely; chosen, each costs some 20 us
_BLENDED = 0.1  # m: chosen, corners that are this much further away do not contribute to the nearest point
_NO_FACES, _NO_SHIFT = np.full(15, np.nan), np.zeros(3)
_NO_BOXES = np.zeros((0, 50))


class Separation:
    """All pairs of a machine's links with each other and with a changing set of obstacles, with a plane each.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    robot: the machine.
    q: (n,) its initial configuration. It may be outside the joint limits; from there the machine only comes back.
    self_collision: whether the machine is also kept clear of itself.
    laden: the same machine with each load that it may carry. None of them counts until `carry`.

    Attributes
    ----------
    own_pieces: the robot's `self_pieces`, or `Robot.pieces` if it is not kept clear of itself; then the pieces of its
        loads.
    owner: (P,) number that the obstacle was added with; `MACHINE` for pairs of the machine with itself.
    clearance: (P,) distance to be kept, including the machine's tracking error [m]; for a load that is not carried
        now it is so small that the pair never counts.
    full_clearance: (P,) the same, but with every load as if it were carried [m].
    load: (P,) number of the load that the pair belongs to, `NO_LOAD` for the machine's own pairs.
    piece, other_piece: (P,) rows of `own_pieces`: the one that comes near, and, for a pair of the
        machine with itself, the one that must not be touched, otherwise -1.
    classes: (P,) row of `travel` that applies to the pair.
    velocity: (P, 3) of the obstacle [m/s], world.
    drift: (P,) rate at which the obstacle's own motion moves its plane along the normal [m/s].
    planes: (P, 4) minus the normal, and how far along the normal a link without radius may come, in the
        frame of the other body: the product with a corner and a 1 is the gap between them [m].
    travel: (C, n) how far a point of the link can travel per joint, see `travel_bounds`.
    furthest: (n,) the largest of `travel` for each joint.
    turning: (n,) 1 for revolute joints, 0 for prismatic ones.
    clusters: the links' pairs with obstacles of thousands of cells; `counting_clusters` without those of loads that
        are not carried now, and `places` for where their boxes were found.
    measured: how many distances were measured so far.
    """

    def __init__(
        self, robot: Robot, q: Vector | None = None, *, self_collision: bool = True, laden: Sequence[Robot] = ()
    ) -> None:
        self.robot, self._laden, self._carried = robot, tuple(laden), NO_LOAD
        self.measured = 0
        self._gauge = shapes.Gauge()
        posture = None
        if q is not None and np.any((q < robot.limits.lower) | (q > robot.limits.upper)):
            posture = tuple(q.tolist())
        self._own = own_pieces(robot, self._laden, posture, self_collision=self_collision)
        own, pairs = self._own.pieces, self._own.pairs
        self.own_pieces = own
        moving = self._rows_on(None)
        self._corners4 = self._own.corners()
        self._columns4 = np.ascontiguousarray(self._corners4.transpose(0, 2, 1))
        self._fat = np.array([piece.piece.radius for piece in own])
        self._joint_of = np.array([piece.joint for piece in own], dtype=np.intp)
        self._own_shapes = [(piece.piece.shape, np.array(piece.piece.placement.homogeneous)) for piece in own]
        radii = travel_bounds(robot, q, pieces=own)
        rows = [*radii[moving], *self._own.radii_of_pairs(robot, radii)]
        self.travel, classes = np.unique(np.array(rows).reshape(-1, robot.n), axis=0, return_inverse=True)
        classes = classes.reshape(-1)
        self._class_of_piece = np.zeros(len(own), dtype=np.intp)
        self._class_of_piece[moving] = classes[: len(moving)]
        self.furthest: Vector = self.travel.max(axis=0, initial=0.0)
        self.turning = np.where(robot.prismatic, 0.0, 1.0)
        self.owner = np.full(len(pairs), MACHINE, dtype=np.intp)
        self.classes = np.asarray(classes[len(moving) :], dtype=np.intp)
        self.piece = np.array([outer for outer, _ in pairs], dtype=np.intp)
        self._room_of_piece = tracking_room(robot, own, radii)
        own_rows = [own[row] for row in self.piece.tolist()]
        self.full_clearance = tracking_room(robot, own_rows, self.travel[self.classes])
        self.load = np.array(self._own.load_of_pair, dtype=np.intp)
        self._load_of_piece = np.full(len(own), NO_LOAD, dtype=np.intp)
        for row, load in self._own.load_of_rows().items():
            self._load_of_piece[row] = load
        self.other_piece = np.array([inner for _, inner in pairs], dtype=np.intp)
        self._body: list[PlacedPiece | None] = [None] * len(pairs)
        self._bodies_of: dict[int, list[PlacedPiece]] = {}
        self.planes = _no_planes(len(pairs))
        self.velocity = np.zeros((len(pairs), 3))
        self.drift = np.zeros(len(pairs))
        self._faces = np.full((len(pairs), 15), np.nan)  # of boxes and half-spaces, see `faces_of`
        self._points = np.full((len(pairs), 6), np.nan)  # between which it was renewed, each in its body's frame
        self.clusters: list[ClusterPairs] = []
        self._shifts: dict[int, Vector] = {}
        self._planes_of = PlaneSets()
        self._ball = max((reach_ball(one, q) for one in (robot, *self._laden)), key=lambda ball: ball[1])
        self._refresh()

    def __len__(self) -> int:
        return len(self.owner)

    # --- what there is ---------------------------------------------------------------

    def add(self, number: int, obstacle: Obstacle) -> Indices:
        """Add an obstacle under a number, and return the indices of its pairs. They have no plane yet."""
        return self.add_all({number: obstacle})

    def add_all(self, obstacles: Mapping[int, Obstacle]) -> Indices:
        """Add several obstacles by their numbers at once: the work does not grow with the square of their count."""
        owner, clearance, piece, velocity = [self.owner], [self.full_clearance], [self.piece], [self.velocity]
        first, faces = len(self), list(self._faces)
        for number, obstacle in obstacles.items():
            links = self._rows_on(obstacle.links)
            places = len(obstacle.pieces) if obstacle.cluster is None else SLOTS
            count = len(links) * places
            pieces = np.array(links * places, dtype=np.intp)
            owner.append(np.full(count, number, dtype=np.intp))
            clearance.append(obstacle.clearance + self._room_of_piece[pieces])
            piece.append(pieces)
            velocity.append(np.repeat(obstacle.velocity[None], count, axis=0))
            self._bodies_of[number] = [PlacedPiece(piece) for piece in obstacle.pieces]
            for body in self._bodies_of[number]:
                self._body.extend([body] * len(links))
                faces.extend([shapes.faces_of(body.piece)] * len(links))
            if obstacle.cluster is not None:
                self._body.extend([None] * count)
                faces.extend([_NO_FACES] * count)
                self._add_cluster(number, obstacle, obstacle.cluster, links)
        self.owner, self.full_clearance = np.concatenate(owner), np.concatenate(clearance)
        self.piece, self.velocity = np.concatenate(piece), np.concatenate(velocity)
        added = len(self) - first
        self.classes = np.append(self.classes, self._class_of_piece[self.piece[first:]])
        self.load = np.append(self.load, self._load_of_piece[self.piece[first:]])
        self.other_piece = np.append(self.other_piece, np.full(added, -1, dtype=np.intp))
        self.planes = np.concatenate((self.planes, _no_planes(added)))
        self.drift = np.append(self.drift, np.zeros(added))
        self._points = np.concatenate((self._points, np.full((added, 6), np.nan)))
        self._faces = np.array(faces).reshape(-1, 15)
        self._refresh()
        return np.arange(first, first + added, dtype=np.intp)

    def remove(self, number: int) -> Flags:
        """Remove an obstacle by its number, and return which pairs are left, (P,)."""
        kept = self.owner != number
        for name in (
            "owner", "full_clearance", "load", "classes", "piece", "other_piece", "planes", "velocity", "drift",
            "_points", "_faces",
        ):  # fmt: skip
            setattr(self, name, getattr(self, name)[kept])
        del self._bodies_of[number]
        self._shifts.pop(number, None)
        self._body = [body for body, keep in zip(self._body, kept.tolist(), strict=True) if keep]
        self.clusters = [one for one in self.clusters if one.number != number]
        self._refresh()
        return np.asarray(kept)

    def carry(self, load: int) -> None:
        """Let the pairs of the load with this number count, and those of no other load; `NO_LOAD` for none."""
        self._carried = load
        self._count()

    def pairs_of_load(self, load: int) -> tuple[Indices, Indices]:
        """The indices of a load's pairs, none for `NO_LOAD`: pairs with one plane each, and pairs of clusters."""
        if load == NO_LOAD:
            return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
        of_load, of_cluster = self.load == load, np.isin(self.owner, [one.number for one in self.clusters])
        return (of_load & ~of_cluster).nonzero()[0], (of_load & of_cluster).nonzero()[0]

    def _count(self) -> None:
        """Update which pairs count."""
        counts = (self.load == NO_LOAD) | (self.load == self._carried)
        self.clearance = np.where(counts, self.full_clearance, _NOT_COUNTING)
        self.counting_clusters = [
            one for one in self.clusters if self._load_of_piece[one.piece] in (NO_LOAD, self._carried)
        ]
        self.places = BoxPlaces(
            self.clusters, self._joint_of, self._fat, self._columns4, counting=self.counting_clusters
        )

    def _rows_on(self, links: Collection[str] | None) -> list[int]:
        return rows_on(self.robot, self._laden, self._own, links)

    def place_at(self, number: int, shift: Vector) -> None:
        """Place an obstacle for coal at `shift` (3,) from where it was built [m]; planes stay where they are.

        The array is kept and not copied: a measurement uses its content at that time.
        """
        for body in self._bodies_of[number]:
            body.shift = shift
        self._shifts[number] = shift

    def _add_cluster(self, number: int, obstacle: Obstacle, cluster: Cluster, links: Sequence[int]) -> None:
        speed = float(np.linalg.norm(obstacle.velocity))
        cluster.prepare_boxes(self._ball)  # this takes longer than a step may
        for link in links:
            own = self.own_pieces[link].piece
            classes = int(self._class_of_piece[link])
            kept = float(obstacle.clearance + self._room_of_piece[link])
            one = ClusterPairs(number, cluster, link, own, classes, kept, self._ball, covering_balls(own), speed)
            self.clusters.append(one)

    def find_boxes(
        self, one: ClusterPairs, at: Placements, sample: int,
        *, reach: float, exact: float, slack: float, is_new: bool,
    ) -> Vector | None:  # fmt: skip
        """Find again the boxes that represent a cluster around a link; return the distance of each of its pairs [m].

        None if there are no boxes now and before: all that is known about its pairs remains true.

        Parameters
        ----------
        reach: distance within which its cells count [m].
        exact: distance up to which boxes are to be as exact as cells [m].
        is_new: whether nothing is known about it from the step before.
        slack: see `ClusterPairs.find`.
        """
        shift = self._shifts[one.number]
        pose = at.T[sample, self._joint_of[one.piece]]
        parts = one.find(pose, shift, reach, exact=exact, slack=slack, is_new=is_new)
        one.found_at = pose[:3].copy()
        if not (parts or one.boxes or is_new):
            self.places.note(one)
            return None
        return self.put_boxes(one, parts)

    def search_boxes(
        self, one: ClusterPairs, at: Placements, sample: int, *, reach: float, exact: float, slack: float
    ) -> BoxSearch | None:
        """Begin to find these boxes bit by bit; None if they have to be found at once."""
        pose = at.T[sample, self._joint_of[one.piece]]
        return one.search(pose, self._shifts[one.number], reach, exact=exact, slack=slack)

    def put_boxes(self, one: ClusterPairs, parts: Sequence[Part]) -> Vector:
        """Let these boxes represent a cluster around a link; return the distance of each of its pairs by them [m]."""
        shift = self._shifts[one.number]
        one.boxes = len(parts)
        one.witnesses = np.empty((len(one.pairs), 6))
        self.measured += len(parts)
        numbers = np.array([part.numbers for part in parts]) if parts else _NO_BOXES
        distance: Vector = put_planes(
            numbers, one.pairs, float(self._fat[one.piece]), self.velocity, shift, one.found_at, FAR,
            self.planes, self.drift, self._points, self._faces, one.witnesses,
        )  # fmt: skip
        self._put_bodies(one, [PlacedPiece(part, shift) for part in parts])
        return distance

    def _put_bodies(self, one: ClusterPairs, bodies: Sequence[PlacedPiece | None]) -> None:
        """Let these bodies belong to the first pairs of a link, and none to its other pairs."""
        known = self._bodies_of[one.number]
        for pair, body in zip_longest(one.pairs.tolist(), bodies):
            if (before := self._body[pair]) is not None:
                known.remove(before)
            self._body[pair] = body
            if body is not None:
                known.append(body)
        self.places.note(one)

    @property
    def of_boxes(self) -> tuple[Array, ...]:
        """The data of all pairs that change with the boxes that are found."""
        return self.planes, self.drift, self._points, self._faces

    def keep_boxes(self, one: ClusterPairs, known: Sequence[Array]) -> KeptBoxes:
        """Store the boxes of a link for `put_back`; `known` are arrays of all pairs that change with them."""
        pairs = one.pairs
        return KeptBoxes(
            one.fields, [self._body[pair] for pair in pairs.tolist()], [each.take(pairs, axis=0) for each in known]
        )

    def put_back(self, one: ClusterPairs, kept: KeptBoxes, known: Sequence[Array]) -> None:
        """Restore the boxes of a link that were kept."""
        vars(one).update(kept.fields)
        for each, values in zip(known, kept.known, strict=True):
            each[one.pairs] = values
        self._put_bodies(one, kept.bodies)

    def _refresh(self) -> None:
        for one in self.clusters:
            one.pairs = ((self.owner == one.number) & (self.piece == one.piece)).nonzero()[0]
        self.joint = self._joint_of[self.piece]
        self.other = np.where(self.other_piece >= 0, self._joint_of[self.other_piece], 0)
        self.mask = self.robot.support[self.joint] - self.robot.support[self.other]
        self.some_relative = bool(self.other.any())
        self._fat_of_pair = self._fat[self.piece]
        self._count()

    # --- measuring -------------------------------------------------------------------

    def measure(self, pair: int, at: Placements, sample: int) -> Measured:
        """Measure a pair at one configuration."""
        self.measured += 1
        piece, other, second = int(self.piece[pair]), int(self.other[pair]), int(self.other_piece[pair])
        T, body, shift = at.T[sample], self._body[pair], _NO_SHIFT
        if second >= 0:
            corners, fat = self._corners4[second], float(self._fat[second])
        elif body is None:  # a pair of a cluster without a box
            return Measured(FAR, np.zeros(3), FAR, np.zeros(3))
        else:
            corners, fat, shift = body.piece.hull, body.piece.radius, body.shift
        own = T[self.joint[pair]]
        found = hulls_apart(self._corners4[piece], float(self._fat[piece]), own, corners, fat, shift, T[other])
        return self._measure_by_coal(piece, own, second, body, T[other]) if found is None else Measured(*found)

    def _measure_by_coal(
        self, piece: int, T_own: Matrix, second: int, body: PlacedPiece | None, T_other: Matrix
    ) -> Measured:
        """Measure a piece of a body at T_own against the piece `second` of a body at T_other, or against `body`."""
        shape, own = self._own_shapes[piece]
        here = T_own.dot(own)
        if body is None:
            other_shape, own = self._own_shapes[second]
            other = T_other.dot(own)
            there = shapes.transform(other[:3, :3], other[:3, 3])
        else:
            other_shape, there = body.piece.shape, body.place()
        distance, n, x, z = self._gauge.measure(shape, shapes.transform(here[:3, :3], here[:3, 3]), other_shape, there)
        n, z = n.dot(T_other[:3, :3]), (z - T_other[:3, 3]).dot(T_other[:3, :3])
        return Measured(distance, n, float(n.dot(z)), x)

    def renew(self, pair: int, at: Placements, sample: int) -> float:
        """Measure a pair, keep its plane, and return the signed distance [m]."""
        distance, n, offset, x = self.measure(pair, at, sample)
        self._keep_plane(pair, n, offset)
        T, other, points = at.T[sample], int(self.other[pair]), self._points[pair]
        own, there = T[self.joint[pair]], x
        if other:
            there = (x - T[other, :3, 3]).dot(T[other, :3, :3])
        points[:3], points[3:] = (x - own[:3, 3]).dot(own[:3, :3]), there + distance * n
        return distance

    def is_exact(self, pair: int, at: Placements, sample: int, distance: float, tolerance: float) -> bool:
        """Whether a lower bound of a pair's `distance` is below the true one by no more than a tolerance [m].

        This follows from the points of its last measurement: the true distance is at most that between these points,
        and at most that of the link's point from a box or a half-space. False if these do not prove it, or if the
        obstacle moves.
        """
        body = self._body[pair]
        apart = known_apart(
            pair, self.joint, self.other, self.velocity, self._points, self._faces,
            _NO_SHIFT if body is None else body.shift, at.T[sample],
        )  # fmt: skip
        return apart < math.inf and apart <= distance + tolerance

    def gradients(self, pairs: Indices, at: Placements, sample: int, *, keep: bool = False) -> tuple[Vector, Matrix]:
        """(K,) measured signed distances [m], and (K, n) how fast they fall with the joints [m/rad].

        keep: whether to keep the planes.
        """
        distance, n, x = np.zeros(len(pairs)), np.zeros((len(pairs), 3)), np.zeros((len(pairs), 3))
        for row, pair in enumerate(pairs.tolist()):
            distance[row], normal, offset, x[row] = self.measure(pair, at, sample)
            if keep:
                self._keep_plane(pair, normal, offset)
            other = int(self.other[pair])
            n[row] = at.R[sample, other] @ normal if other else normal
        both = np.concatenate((n, np.cross(x, n)), axis=1)
        return distance, np.asarray((both @ at.J[sample]) * self.mask[pairs])

    def least_gaps(self, pairs: Indices, at: Placements, sample: int) -> Vector:
        """(K,) lower bounds of the distances at one sample, from the planes alone [m]."""
        return np.asarray(self.gaps(pairs, at, slice(sample, sample + 1)).least[:, 0])

    def _keep_plane(self, pair: int, n: Vector, offset: float) -> None:
        self.planes[pair, :3] = -n
        self.planes[pair, 3] = offset - self._fat_of_pair[pair]
        self.drift[pair] = n.dot(self.velocity[pair])

    # --- gaps ------------------------------------------------------------------------

    def gaps(
        self, pairs: Indices, at: Placements, samples: int | slice,
        *, drift_time: float = 0.0, memory: Memory | None = None,
    ) -> Gaps:  # fmt: skip
        """The gaps from every corner of the links to the planes of `pairs` (K,).

        Parameters
        ----------
        samples: rows of the placements, as a slice or as a number of first rows.
        drift_time: how long the planes of approaching obstacles move on, from the first sample to the last [s].
        memory: to which the gaps are written; new arrays without it.
        """
        T = at.T[samples if isinstance(samples, slice) else slice(samples)]
        count = len(T)
        memory = Memory() if memory is None else memory
        gaps = memory.gaps(len(pairs), count, self._columns4.shape[2])
        other, drift = self.other if self.some_relative else None, self.drift if drift_time > 0.0 else None
        step = drift_time / max(count - 1, 1)
        nearest, least = corner_gaps(
            pairs, self.planes, self.joint, other, self.piece, self._columns4, T, drift, step, gaps
        )
        return Gaps(gaps, nearest, least)

    def near_gaps(
        self, pairs: Indices, lower: Vector, counted: Vector, at: Placements, distance: Vector
    ) -> tuple[Gaps, Vector, Vector]:
        """The gaps of `pairs` (K,) at the placements' row 0, and the results of `note_gaps`."""
        other = self.other if self.some_relative else None
        gaps, nearest, least, found, margin = near_gaps(
            pairs, lower, counted, self.planes, self.joint, other, self.piece, self._columns4, at.T[:1],
            self.clearance, distance,
        )  # fmt: skip
        return Gaps(gaps, nearest, least), found, margin

    def look_along(
        self, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float,
        *, required: Vector, tolerance: float, memory: Memory,
    ) -> tuple[Gaps, Vector, Vector, Indices]:  # fmt: skip
        """Place the bodies along a path, and find the clearance of `pairs` (K,); see `gaps_along_path`, `least_on`."""
        parts, bend = path.parts, path.bend
        gaps = memory.gaps(len(pairs), parts + 1, self._columns4.shape[2])
        other, drift = self.other if self.some_relative else None, self.drift if drift_time > 0.0 else None
        off, nearest, least, bound, left, short = gaps_along_path(
            path.q, path.delta, parts, bend, *at.chain, self.travel, pairs, self.planes, self.joint, other,
            self.piece, self._columns4, drift, drift_time / parts, self.classes, required, tolerance, at.T, at.J, gaps,
        )  # fmt: skip
        path.keep_off_chord(self.travel, off)
        return Gaps(gaps, nearest, least), bound, left, short

    def least_on(
        self, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float, *, memory: Memory | None = None
    ) -> tuple[Vector, Gaps]:
        """(K,) proven lower bound of the distance over the whole path, and the gaps at its samples.

        Between the samples a corner leaves its chord by no more than `BrakingPath.off_chord`.
        `drift_time` [s] is how long the obstacles move on along the path; 0 if none moves.
        """
        gaps = self.gaps(pairs, at, path.parts + 1, drift_time=drift_time, memory=memory)
        return least_over_path(pairs, gaps.least, self.classes, path.off_chord(self.travel)), gaps

    def proven_on(self, pairs: Indices, path: BrakingPath, at: Placements, drift_time: float) -> Vector:
        """(K,) the bound of `least_on`, with a closer look if it is below the clearance [m]."""
        bound, _ = self.least_on(pairs, path, at, drift_time)
        for row in (bound < self.clearance[pairs]).nonzero()[0].tolist():
            bound[row] = max(bound[row], self.closer_look(int(pairs[row]), path, at, drift_time))
        return bound

    def closer_look(self, pair: int, path: BrakingPath, at: Placements, drift_time: float) -> float:
        """Lower bound of one pair's distance over the path, with the best of several planes for each part [m].

        It uses the planes of the last look, and up to `_PLANES` that are measured along the path, each where the
        planes so far leave the smallest gap. The plane of the tightest sample is kept.
        """
        return self.look_closely(pair, path, at, drift_time)[0]

    def look_closely(
        self, pair: int, path: BrakingPath, at: Placements, drift_time: float, *, enough: float = math.inf
    ) -> tuple[float, int]:
        """The bound of `closer_look`, and the sample at which all planes together leave the smallest gap.

        enough: the bound above which no more planes are measured [m].
        """
        joint, other, piece = int(self.joint[pair]), int(self.other[pair]), int(self.piece[pair])
        body = self._body[pair]
        shift = None if body is None else body.shift.tolist()
        count = path.parts + 1
        corners = self._corners4[piece] @ at.T[:count, joint, :3].transpose(0, 2, 1)  # (S, V, 3)
        if other:
            corners = np.matmul(corners - at.t[:count, None, other], at.R[:count, other])
        off = float(path.off_chord(self.travel[self.classes[pair]][None])[0])
        drift = float(np.linalg.norm(self.velocity[pair])) * drift_time if drift_time > 0.0 else 0.0
        normals, offsets = self._planes_of.of(pair, piece, body, shift)
        gaps = (offsets - self._fat[piece] - corners @ normals.T).min(axis=1)  # (S, planes)
        least, measured = -FAR, np.zeros(count, dtype=bool)
        for number in range(min(_PLANES, count) + 1):
            # a part is clear if a single plane clears both its ends
            parts = np.minimum(gaps[:-1], gaps[1:]).max(axis=1, initial=-FAR)
            least = max(least, float(parts.min()) - off - drift)
            if least >= enough or number == min(_PLANES, count):
                break
            sample = 0
            if number > 0:
                ends = np.append(parts, math.inf)
                np.minimum(ends[1:], parts, out=ends[1:])
                ends[measured] = math.inf
                sample = int(ends.argmin())
            measured[sample] = True
            _, n, offset, point = self.measure(pair, at, sample)
            if number == 0:
                least = max(least, self._from_link(pair, n, point, path, at) - drift)
            normals, offsets = np.vstack((n, normals)), np.append(offset, offsets)
            gaps = np.column_stack(((offset - self._fat[piece] - corners @ n).min(axis=1), gaps))
        best = gaps.max(axis=1)
        tight = int(best.argmin())
        kept = int(gaps[tight].argmax())
        self._keep_plane(pair, normals[kept], float(offsets[kept]))
        self._planes_of.keep(pair, piece, body, shift, normals, offsets)
        return least, tight

    def _from_link(self, pair: int, n: Vector, point: Vector, path: BrakingPath, at: Placements) -> float:
        """The same bound, with the plane of normal `n` (3,) through `point` (3,) at the start, moving with the link."""
        body = self._body[pair]
        if body is None or body.corners is None:
            return -FAR
        corners = body.corners + body.shift
        joint = int(self.joint[pair])
        local = n @ at.R[0, joint]
        start = float(local @ ((point - at.t[0, joint]) @ at.R[0, joint]))
        count = path.parts + 1
        normals = at.R[:count, joint] @ local  # (S, 3)
        base = np.einsum("si,si->s", normals, at.t[:count, joint])
        gaps = normals @ corners.T - base[:, None]
        gaps -= start + body.piece.radius
        # in the link's frame the corners turn in the opposite sense, and further out
        size = np.abs(path.delta)
        far = float(np.sqrt(((corners - point) ** 2).sum(axis=1).max())) + float(size @ self.travel[self.classes[pair]])
        mask = np.abs(self.mask[pair])
        size = size * mask
        radius = np.where(self.turning > 0.0, self.travel[self.classes[pair]] + far, 1.0)
        sharp = float(radius[::-1] @ bend_weights(size[::-1], self.turning[::-1]))
        return float(gaps.min()) - sharp / (8.0 * path.parts**2)

    # --- rows ------------------------------------------------------------------------

    def rows(self, pairs: Indices, samples: Indices | int, corners: Indices, at: Placements) -> Matrix:
        """(R, n) how fast the gaps of these `corners` fall with the joints [m/rad]."""
        other, points = self.other if self.some_relative else None, self._corners4[self.piece[pairs], corners]
        return plane_rows(pairs, samples, points, self.planes, self.joint, other, self.mask, at.T, at.J)

    def of_rows(
        self, at: Placements
    ) -> tuple[Matrix, Indices, Indices | None, Indices, Array, Matrix, Array, Array, Vector]:
        """The arguments of `rows_of_path` that describe all pairs and the placements of the bodies."""
        other = self.other if self.some_relative else None
        return self.planes, self.joint, other, self.piece, self._corners4, self.mask, at.T, at.J, self.drift

    def nearest_rows(self, pairs: Indices, gaps: Gaps, at: Placements) -> Matrix:
        """(K, n) how fast the distance rises at the first sample, at the nearest point of each pair [m/rad].

        The point is blended from the corners by their `gaps` there: corners that are almost as near
        contribute to it, so that it does not jump from edge to edge when a flat end passes a wall.
        """
        other = self.other if self.some_relative else None
        return nearest_rows(
            pairs, gaps.all, gaps.least, self.piece, self._columns4, _BLENDED,
            self.planes, self.joint, other, self.mask, at.T, at.J,
        )  # fmt: skip

    def world_normal(self, pair: int, at: Placements) -> Vector:
        """(3,) the normal of a pair's plane at the first sample, world."""
        other = self.other[pair]
        normal: Vector = -self.planes[pair, :3]
        return at.R[0, other].dot(normal) if other else normal


def _no_planes(count: int) -> Matrix:
    """(count, 4) unknown planes, with the bound -FAR, which is no information."""
    planes = np.zeros((count, 4))
    planes[:, 3] = -FAR
    return planes
