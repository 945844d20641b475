"""Signed distances, critical points and their gradients, of all pairs that may touch.

Every pair of a piece of a link and a piece of an obstacle has one row, and so has every pair
of the machine's own pieces that may touch. The gradient of the signed distance is

    dd/dq = n . (J_2 - J_1)

with coal's own normal n (from the link to the obstacle, also inside) and the Jacobians
J_1, J_2 of the two witness points. A normal made from the witness points would change its
sign inside.

An obstacle of thousands of cells is one obstacle here, a `Cluster`: one pair with every piece of a
link. Its distances are exact within `EXACT_WITHIN`, and when one is requested singly; otherwise a
lower bound is enough and takes a hundredth of the time.

Broad phase: a pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints
moved by dq, so pairs that are provably still out of reach are not measured again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector, as_array, as_count, as_number, as_rows, as_vector
from backhoe_planner.errors import InputError, check_flag, check_kind
from backhoe_planner.machine import ResultTable, Robot, bend_weights, self_pieces
from backhoe_planner.native import find_compiled
from backhoe_planner.site.distances.cluster_distances import EXACT_WITHIN, ClusterDistances
from backhoe_planner.site.distances.pair_listing import ball_within, list_pairs, travel_of_pieces, with_tracking_room
from backhoe_planner.site.obstacles import Obstacle, as_obstacles, offset_at
from backhoe_planner.site.obstruction import Obstruction
from backhoe_planner.site.pairs.approach import ApproachBounds
from backhoe_planner.site.pairs.ball_bounds import BallBounds
from backhoe_planner.site.pairs.hull_distances import HullDistances, NearInEach
from backhoe_planner.site.pairs.known_bounds import KnownBounds, PairSelection, age
from backhoe_planner.site.pairs.nearby import Lead, Nearby, as_pairs, near_rows, pairs_within, reach_of_lead
from backhoe_planner.site.pairs.pair_geometry import PairGeometry
from backhoe_planner.site.pairs.planes import SeparatingPlanes
from backhoe_planner.site.pairs.reachable import distances_from_ball, measured_where_tightest
from backhoe_planner.site.pairs.ways import link_ways

_MANY = 3_000  # pairs, beyond which examining each of them takes too much memory; chosen
_NO_LEAD = None, None, 0.0
_FEW = 40  # pairs; measured: measuring this many takes as long as bounding how fast they approach


class Proximity:
    """All distances between one machine and a set of obstacles, and between its own parts.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    robot, obstacles: the machine and the obstacles around it.
    self_collision: whether pairs of the machine's own parts are measured too.

    Raises
    ------
    InputError: an argument has the wrong type or value, here and in every method; names it.

    Attributes
    ----------
    pairs: the P pairs that are measured; results have indices into them.
    clearance: (P,) of every pair [m].
    travel: (P, n) r of every pair: travel @ |dq| bounds how much the distance changes; valid within the
        limits, and in every posture that was measured or given to `cover`.
    speed: (P,) of the obstacle [m/s].
    moves: (P, n) which joints move the link.
    owner: (P,) index of the obstacle, -1 for the machine itself.
    second: (P,) index of the other body's piece, in the obstacle's pieces or in the machine's.
    appears_at: (P,) when the obstacle appears [s]; minus infinity for the machine itself.
    floor: (P,) no posture brings a pair nearer than this [m], valid as `travel`; minus infinity if not known.
    plain: the number of pairs of two convex pieces, which come first; the others are of a piece and a cluster.
    measured: how many distances `at` has measured so far.
    clusters: the pairs of a piece and a cluster.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle] = (), *, self_collision: bool = True) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        self.obstacles = as_obstacles(obstacles)
        self_collision = check_flag(self_collision, key="self_collision")
        self._n = robot.n
        self._pieces = self_pieces(robot) if self_collision else robot.pieces
        self._data = robot.model.createData()
        # a view of Pinocchio's own memory: its joint Jacobians at the present placements; of one joint alone it is 1-D
        self._J: Matrix = self._data.J.reshape(6, self._n)
        self.clusters = ClusterDistances(robot, self.obstacles)
        pairs, owner, second = list_pairs(robot, self.obstacles, self._pieces, self.clusters, own=self_collision)
        self.plain = len(pairs) - len(self.clusters)
        self.second = tuple(second)
        self.owner = np.array(owner, dtype=int)
        self._bodies = [piece for obstacle in self.obstacles for piece in obstacle.pieces]
        # the machine's pieces are numbered first, then those of the obstacles
        firsts = np.cumsum([len(self._pieces), *(len(obstacle.pieces) for obstacle in self.obstacles)])
        self._first_body = firsts[:-1] - len(self._pieces)
        self._body = np.where(self.owner >= 0, firsts[self.owner], 0) + np.array(second, dtype=int)
        first = np.array([pair.piece for pair in pairs], dtype=int)
        joint_of = np.array([own.joint for own in self._pieces], dtype=int)
        joints = np.concatenate((joint_of, np.zeros(len(self._bodies) + 1, dtype=int)))
        self._other_joint = np.where(self.owner < 0, joints[np.minimum(self._body, len(joints) - 1)], 0)
        self.moves = robot.support[joint_of[first]] > 0.0
        # +1 for joints that move the other body alone, -1 for those that move the link alone
        self._sense = robot.support[self._other_joint] - robot.support[joint_of[first]]
        self._first, self._slides = first, bool(robot.prismatic.any())
        self._turning = (~robot.prismatic).astype(float)
        # the furthest that slides were extended; hinges do not count
        limits = robot.limits
        self._run_out = np.where(robot.prismatic, np.maximum(np.abs(limits.lower), np.abs(limits.upper)), np.inf)
        self._take_travel()
        self.pairs = with_tracking_room(robot, pairs, self._pieces, self.travel)
        self.clearance = np.array([pair.clearance for pair in self.pairs])
        velocity = np.array([obstacle.velocity for obstacle in self.obstacles]).reshape(-1, 3)
        self._velocity = np.vstack((velocity, np.zeros((1, 3))))[self.owner]
        self.speed = np.linalg.norm(self._velocity, axis=1)
        self._fastest = float(self.speed.max(initial=0.0))
        appears = np.array([obstacle.appears_at for obstacle in self.obstacles] + [-np.inf])
        self.appears_at = appears[self.owner]
        self._some_appear = bool(np.any(self.appears_at > 0.0))
        self._moving = [index for index, obstacle in enumerate(self.obstacles) if obstacle.moves]
        self._take_ball()
        plain = slice(self.plain)
        self._geometry = PairGeometry(
            robot, self._pieces, self._bodies, self._away, data=self._data, first=first[plain], second=self._body[plain]
        )
        self._time, self._q = 0.0, np.zeros(robot.n)  # for which obstacles and joints are placed
        self._put_obstacles()
        self._known = KnownBounds(
            self.clearance, self.speed, self.appears_at,
            travel=self.travel, floor=self.floor, always=len(self.clusters),
        )  # fmt: skip
        self._near: tuple[Indices, Matrix] | None = None  # pairs of the last measurement, and their results
        self.measured = 0

    def cover(self, q: Matrix) -> None:
        """Make `travel` valid in postures q (..., n) outside of the limits too, and between these and the limits.

        Measured postures are covered already; call this only to read `travel` before measuring.
        """
        self.cover_unchecked(as_rows(q, self._n, key="q"))

    def cover_unchecked(self, q: Matrix) -> None:
        """`cover` without checks of its arguments, for callers in a loop."""
        if self._slides:
            run_out = np.abs(np.reshape(q, (-1, self.robot.n))).max(axis=0, initial=0.0)
            if np.count_nonzero(run_out > self._run_out):
                self._run_out = np.maximum(self._run_out, run_out)
                self._take_travel()
                self._take_ball()
                self._known.renew(self.travel, self.floor)

    def _take_travel(self) -> None:
        # joints that move both bodies do not change their distance
        shared, ever = self.robot.support[self._other_joint] > 0.0, self._run_out
        self.travel = np.where(shared, 0.0, travel_of_pieces(self.robot, tuple(ever.tolist()))[self._first])

    def _take_ball(self) -> None:
        """Find which pairs the machine can bring near, by the ball that it never leaves."""
        self._away = distances_from_ball(self._bodies, *ball_within(self.robot, tuple(self._run_out.tolist())))
        for index in self._moving:
            first = self._first_body[index]
            self._away[first : first + len(self.obstacles[index].pieces)] = -np.inf
        around = (self.owner >= 0) & (np.arange(len(self.owner)) < self.plain)
        self.floor = np.full(len(self.owner), -np.inf)
        self.floor[around] = self._away[self._body[around] - len(self._pieces)]

    @cached_property
    def _approach(self) -> ApproachBounds:
        return ApproachBounds(self._pieces, self._bodies)

    @cached_property
    def _planes(self) -> SeparatingPlanes:
        plain = slice(self.plain)
        return SeparatingPlanes(
            self._pieces, self._bodies, self._data, first=self._first[plain], second=self._body[plain],
            velocity=self._velocity, appears_at=self.appears_at,
        )  # fmt: skip

    @cached_property
    def _balls(self) -> BallBounds:
        asked = (self.floor == -np.inf) & (self.speed == 0.0) & (np.arange(len(self.pairs)) < self.plain)
        return BallBounds(
            self.robot, len(self._pieces), self._bodies, first=self._first, second=self._body, asked=asked
        )

    def bounds_unchecked(self, q: Matrix) -> Iterator[Vector]:
        """(P,) lower bounds of the distances [m] for each of `q` (N, n), found together and without coal.

        They are valid at all times, and minus infinity where nothing is known.
        """
        return self._balls.of(q)

    def near_in_each_unchecked(self, q: Matrix, margin: Vector, known: Matrix) -> NearInEach | None:
        """The plain pairs within `margin` (N,) [m] beyond their clearance at each of q (N, n), see `HullDistances`.

        None if the time matters, or without the compiled functions.
        """
        if self._moving or self._some_appear or not 0 < self.plain <= _MANY or find_compiled() is None:
            return None
        self.cover_unchecked(q)
        return self._hulls.within(q, margin, np.maximum(known, self.floor)[:, : self.plain])

    def _results_at(self, q: Vector, pairs: Indices) -> tuple[Matrix, Matrix]:
        """(K, 10) coal's results of plain `pairs` (K,) at q (n,), and (6, n) Pinocchio's joint Jacobians there."""
        self._place(q, self._time)
        self.measured += len(pairs)
        return self._geometry.measure_each(pairs), self._J

    def near_clusters_unchecked(self, q: Vector, margin: float, lower: Vector, *, time: float) -> Nearby:
        """The pairs with clusters within `margin` [m] beyond their clearance at q (n,).

        `lower` (K,) are lower bounds of the distances of all of them [m]; they are raised.
        """
        reach = self.clearance[self.plain :] + margin
        rows = (lower <= reach).nonzero()[0]
        self._place(q, time)
        pairs, reach = rows + self.plain, reach[rows]
        found, unread = self._measure(pairs, reach, lower[rows])
        lower[rows], reach[unread] = found[:, 0], -np.inf
        return self._rows(pairs, found, reach)

    @cached_property
    def _hulls(self) -> HullDistances:
        plain = slice(self.plain)
        second = self._body[plain].astype(np.intp)
        second[self.owner[plain] >= 0] += len(self_pieces(self.robot)) - len(self._pieces)
        return HullDistances(
            self.robot, self._bodies, first=self._first[plain].astype(np.intp), second=second,
            clearance=self.clearance[plain], sense=self._sense[plain], measure=self._results_at,
        )  # fmt: skip

    def ways_unchecked(self, q: Matrix) -> Iterator[Vector]:
        """(P,) the most each distance changes [m] on each straight motion through `q` (N + 1, n); see `link_ways`."""
        self.cover_unchecked(q)
        return link_ways(self.robot, self.travel, self._first, self.owner >= 0, q)

    @property
    def geometry(self) -> tuple[pin.GeometryModel, pin.GeometryData]:
        """Pinocchio's geometry model with all pairs, and its data; to be read only."""
        return self._geometry.whole()

    def geometry_parts_unchecked(self, asked: Flags) -> Iterator[tuple[Indices, pin.GeometryModel]]:
        """Pinocchio's geometry models that together have all plain pairs for which `asked` is true, and some others.

        Each comes with the indices of its pairs; to be read only.
        """
        yield from ((part.pairs, part.model) for part in self._geometry.parts_with(asked))

    def at(
        self, q: Vector, *, time: float = 0.0, within: float = np.inf, margin: float | Vector = np.inf,
        known: Vector | None = None,
    ) -> Nearby:  # fmt: skip
        """The pairs that are near at configuration `q` (n,) and `time` [s].

        Obstacles that have not appeared by `time` are left out.

        Parameters
        ----------
        within: largest distance [m].
        margin: largest distance beyond the clearance to be kept, one number or (P,) [m]; none within minus infinity.
        known: (P,) known lower bounds of the distances [m].
        """
        q, time = self._checked(q, time)
        if not (isinstance(margin, float) and margin == margin):
            margin = as_array(margin, *np.shape(margin) and (len(self.pairs),), key="margin", finite=False)
        if not (isinstance(within, float) and within == within):
            within = as_number(within, key="within", finite=False)
        reach = self.clearance + margin
        if within < np.inf:
            reach = np.minimum(reach, within)
        self._place(q, time)
        near, found, reach = self._measure_within(self._known.every, reach, self._lower_with(known, q, time), q, time)
        return self._rows(near[asked := reach > -np.inf], found[asked], reach[asked])

    def at_unchecked(
        self, q: Vector, *, time: float, margin: float, v: Vector, fastest: Vector, stop: float, longest: float
    ) -> Nearby:
        """The pairs that are near, and those that count because the machine moves, for callers in a loop.

        The rows are those of `at`. They are all pairs within `margin` beyond their clearance. Of the pairs beyond it
        that some posture brings within it (see `floor`), they are those that would use up their margin within `stop`
        if they approached as fast as they ever can, and within `longest` if they approached as fast as they can here
        at the velocities that are possible next.

        Parameters
        ----------
        margin: [m].
        v: (n,) the joint velocities [rad/s or m/s]; those possible next are in a symmetric range around each.
        fastest: (n,) the highest speeds that are possible next [rad/s or m/s].
        stop, longest: time in which the machine stops from these, and from the greatest that may be requested [s].
        """
        self._place(q, time)
        further = stop * (float(self._known.furthest.dot(fastest)) + self._fastest)
        some = self._known.around(margin, max(margin, further), q, time)
        lower = self._known.lower(some, q, time)
        if further <= margin:
            return self._rows(*self._measure_within(some, some.reach, lower, q, time), margin)
        lead = Lead(v, fastest - np.abs(v), longest)
        reach, count = reach_of_lead(lower, some.travel, some.speed, some.clearance, some.reach, fastest, stop)
        if count > _FEW:
            doubtful = ((lower <= reach) & (lower > some.reach)).nonzero()[0]
            doubtful = doubtful[: doubtful.searchsorted(len(lower) - len(self.clusters))]  # clusters have no ball
            pairs, left = some.pairs[doubtful], lower[doubtful] - some.clearance[doubtful]
            rate = self.approach_unchecked(pairs, v, time) + self.travel[pairs] @ lead.change
            reach[doubtful[left >= lead.longest * rate]] = -np.inf
        return self._rows(*self._measure_within(some, reach, lower, q, time), margin, lead)

    def approach_unchecked(self, pairs: Indices, v: Vector, time: float) -> Vector:
        """(K,) upper bounds on how fast `pairs` (K,) that are apart approach at joint velocities v (n,) [m/s].

        They are valid at the last placement of the joints, for pairs of convex pieces.
        """
        velocity = self._velocity[pairs]
        return self._approach.at(
            self._data, self._J, v, piece=self._first[pairs], body=self._body[pairs],
            shift=velocity * age(time, self.appears_at[pairs])[:, None], velocity=velocity,
        )  # fmt: skip

    def _measure_within(
        self, some: PairSelection, reach: Vector, lower: Vector, q: Vector, time: float
    ) -> tuple[Indices, Matrix, Vector]:
        """Measure those of M pairs whose lower bounds (M,) are within `reach` (M,), at the present placements.

        Returns these pairs (K,), their distances, normals and nearest points (K, 10), and the distance within which
        each counts as near (K,) [m]. The bounds of all distances are kept.
        """
        some_clusters = len(self.clusters) > 0
        if some_clusters:
            self._raise_by_grids(lower, reach)
        rows, near, reach = pairs_within(some.pairs, lower, reach)
        self.measured += len(rows)
        found, unread = self._measure(near, reach, lower[rows] if some_clusters else None)
        lower[rows] = found[:, 0]
        self._known.keep(some, lower, q, time)
        if unread:
            reach[unread] = -np.inf
        if self._some_appear:
            reach[self.appears_at[near] > time] = -np.inf
        return near, found, reach

    def _measure(self, pairs: Indices, reach: Vector, lower: Vector | None) -> tuple[Matrix, list[int]]:
        """(K, 10) distances, normals and nearest points of `pairs` (K,) at the present placements.

        Also the rows of far clusters: instead of the distance they have a lower bound, no less than their reach.

        Parameters
        ----------
        reach: (K,) distance from which on a cluster is far [m].
        lower: (K,) known lower bounds of the distances [m], if any.
        """
        if not len(self.clusters):
            return self._geometry.measure_each(pairs), []
        if lower is None:
            bounds, needed = np.full((2, len(self.pairs)), -np.inf)
            needed[pairs] = reach
            self._raise_by_grids(bounds, needed)
            lower = bounds[pairs]
        plain = pairs < self.plain
        found = np.zeros((len(pairs), ResultTable.COLUMNS))
        found[plain] = self._geometry.measure_each(pairs[plain])
        rows = (~plain).nonzero()[0]
        found[rows], far = self.clusters.measure_each(
            pairs[rows] - self.plain, self._data, self._time, lower=lower[rows], reach=reach[rows], q=self._q
        )
        return found, rows[far].tolist()

    @property
    def found_unchecked(self) -> Vector:
        """(P,) the lower bounds of all distances from the last call of `at` [m]; to be read only."""
        return self._known.last

    def is_at(self, q: Vector, *, time: float = 0.0) -> bool:
        """Whether the last measurement was made at `q` and `time`."""
        q, time = self._checked(q, time)
        return self.is_at_unchecked(q, time=time)

    def is_at_unchecked(self, q: Vector, *, time: float) -> bool:
        """`is_at` without checks of its arguments, for callers in a loop."""
        return self._known.is_at(q, time)

    def unproven_unchecked(self, q: Vector, *, time: float, spare: float = 0.0, way: Vector | None = None) -> Indices:
        """The pairs that the last measurement does not prove to keep their clearance and `spare` [m] on a motion.

        The motion is the straight one from there to `q` (n,), which ends at `time` [s]. If bounds on how much the
        distances change on it are known already, including obstacles' own motions, they are given as `way` (P,) [m].
        """
        self.cover_unchecked(q)
        return self._known.unproven(q, time, spare, way)

    def stay_apart_unchecked(self, pairs: Indices, least: Vector, q: Vector, *, time: float) -> Flags:
        """(K,) whether a plane proves that the distances of `pairs` (K,) are `least` (K,) or more on a motion [m].

        The motion is the straight one from the last measurement to `q` (n,), which ends at `time` [s]. Nothing is
        known of pairs that `at` did not find near, of the machine with itself, or of clusters. See `SeparatingPlanes`.
        """
        found = np.zeros(len(pairs), dtype=bool)
        if self._near is None:
            return found
        (near, rows), (q_a, time_a) = self._near, self._known.place
        if self._time != time_a or np.count_nonzero(self._q != q_a):
            self._place(q_a, time_a)
        sag = self.travel.take(pairs, axis=0).dot(bend_weights(q - q_a, self._turning)) / 8.0
        planes = self._planes.between(pairs, least + sag, near, rows[:, 1:4], time_a, time)
        if planes:
            self._place(q, time)
        for plane in planes:
            found[plane.row] = self._planes.end_of_link(plane.pair, plane.normal) <= plane.most
        return found

    def _lower_with(self, known: Vector | None, q: Vector, time: float) -> Vector:
        """(P,) lower bounds of all distances from the last measurement [m], raised to those `known` (P,)."""
        lower = self._known.lower(self._known.every, q, time)
        if known is None:
            return lower
        if not isinstance(known, np.ndarray) or known.shape != lower.shape:
            known = as_array(known, len(lower), key="known", finite=False)
        return np.asarray(np.fmax(lower, known, out=lower))  # nan means not known

    def distances(self, q: Vector, *, time: float = 0.0) -> Vector:
        """(P,) signed distance of every pair at q (n,), `time` [s], in m; infinite before an obstacle appears.

        For a cluster further away than `EXACT_WITHIN` it is a lower bound.
        """
        q, time = self._checked(q, time)
        self._place(q, time)
        found = np.full(len(self.pairs), -np.inf)
        found[: self.plain] = self._geometry.measure_all()
        self._measure_clusters(np.arange(self.plain, len(self.pairs)), found)
        if self._some_appear:
            found[self.appears_at > time] = np.inf
        return found

    def tightest(self, q: Vector, *, time: float = 0.0) -> Obstruction | None:
        """The pair with the least margin at `q` (n,) and `time` [s]; None if there is nothing to touch."""
        q, time = self._checked(q, time)
        if not self.pairs:
            return None
        if self._geometry.is_whole or self._some_appear:
            distances = self.distances(q, time=time)
        else:
            distances = measured_where_tightest(
                self.floor, self.clearance, lambda pairs: self.distances_of_unchecked(pairs, q, time=time)
            )
        index = int(np.argmin(distances - self.clearance))
        exact: set[int] = set()
        while index >= self.plain and EXACT_WITHIN <= distances[index] < np.inf and index not in exact:
            exact.add(index)
            distances[index] = self.distance_of_unchecked(index, q, time=time)
            index = int(np.argmin(distances - self.clearance))
        distance = float(distances[index])
        return self.pairs[index].at(distance, time=time) if np.isfinite(distance) else None

    def lower_bounds(
        self, q: Vector, *, time: float, floor: Vector, known: Vector | None = None
    ) -> tuple[Vector, Flags]:
        """Signed distances, measured only where they may be below `floor`.

        Parameters
        ----------
        q: (n,) joint positions [rad or m]; time: of the site [s].
        floor: (P,) a lower bound above this is good enough [m].
        known: (P,) known lower bounds of the distances [m].

        Returns
        -------
        (P,) lower bound of each distance, equal to the distance if it was measured; and (P,)
        whether it was measured.
        """
        q, time = self._checked(q, time)
        if not isinstance(floor, np.ndarray) or floor.shape != self.clearance.shape:
            floor = as_array(floor, len(self.pairs), key="floor", finite=False)
        self._place(q, time)
        lower = self._lower_with(known, q, time)
        self._raise_by_grids(lower, floor)
        needed = lower < floor
        pairs = needed.nonzero()[0]
        found, unread = self._measure(pairs, floor[pairs], lower[pairs])
        lower[pairs] = found[:, 0]
        needed[pairs[unread]] = False
        self._known.keep(self._known.every, lower, q, time)
        self._near = None
        return lower.copy(), needed

    def distance_of(self, pair: int, q: Vector, *, time: float = 0.0) -> float:
        """Signed distance of one pair at q (n,), `time` [s], in m."""
        if not 0 <= as_count(pair, key="pair") < len(self.pairs):
            raise InputError("there is no such pair", key="pair", found=pair, allowed=f"less than {len(self.pairs)}")
        q, time = self._checked(q, time)
        return self.distance_of_unchecked(pair, q, time=time)

    def distance_of_unchecked(self, pair: int, q: Vector, *, time: float) -> float:
        """`distance_of` without checks of its arguments, for callers in a loop."""
        self._place(q, time)
        if pair < self.plain:
            return float(self._geometry.measure(pair).min_distance)
        reading = self.clusters.nearest(
            pair - self.plain, self._data, self._time, lower=-np.inf, reach=np.inf, q=self._q
        )
        assert reading is not None
        return reading.distance

    def distances_of(self, pairs: Indices, q: Vector, *, time: float = 0.0) -> Vector:
        """(K,) signed distances [m] of `pairs` (K,) at q (n,), `time` [s], also for obstacles yet to appear.

        For a cluster further away than `EXACT_WITHIN` it is a lower bound.
        """
        pairs = as_pairs(pairs, len(self.pairs))
        q, time = self._checked(q, time)
        return self.distances_of_unchecked(pairs, q, time=time)

    def distances_of_unchecked(self, pairs: Indices, q: Vector, *, time: float) -> Vector:
        """`distances_of` without checks of its arguments, for callers in a loop."""
        self._place(q, time)
        if not len(self.clusters):
            return self._geometry.distances(pairs)
        found = np.full(len(self.pairs), -np.inf)
        plain = pairs < self.plain
        self._measure_clusters(pairs[~plain], found)
        found[pairs[plain]] = self._geometry.distances(pairs[plain])
        return found[pairs]

    def distances_below_unchecked(self, pairs: Indices, floor: Vector, q: Vector, *, time: float) -> Vector:
        """(K,) signed distances [m] of `pairs` (K,) at q (n,), `time` [s], also for obstacles yet to appear.

        A distance above `floor` (K,) may be replaced by any number between the floor and the distance.
        """
        self._place(q, time)
        if not len(self.clusters):
            return self._geometry.distances(pairs)
        return self._measure(pairs, floor, None)[0][:, 0]

    # --- clusters -------------------------------------------------------------------------

    def _raise_by_grids(self, lower: Vector, needed: Vector) -> None:
        """Raise the lower bounds of clusters, the last of (M,), at the present placements, if any is below `needed`."""
        first = len(lower) - len(self.clusters)
        own, needed = lower[first:], needed[first:]
        short = own < needed
        if short.any():
            asked = np.where(short, needed, -np.inf)
            np.maximum(own, self.clusters.lower(self._data, self._time, q=self._q, needed=asked), out=own)

    def _measure_clusters(self, pairs: Indices, found: Vector) -> None:
        """Enter distances of pairs with clusters into `found` (P,), exact within `EXACT_WITHIN`."""
        if len(pairs):
            self._raise_by_grids(found, np.full(len(found), EXACT_WITHIN))
            self.clusters.make_exact(found[self.plain :], pairs - self.plain, self._data, self._time)

    def obstacle_offset(self, index: int, time: float) -> Vector:
        """(3,) how far obstacle `index` has moved by `time` [m]."""
        if as_count(index, key="index") >= len(self.obstacles):
            allowed = f"less than {len(self.obstacles)}"
            raise InputError("there is no such obstacle", key="index", found=index, allowed=allowed)
        return offset_at(self.obstacles[index], as_number(time, key="time"))

    def _checked(self, q: Vector, time: float) -> tuple[Vector, float]:
        """`q` (n,) and `time`, which a caller may give as a list and an int."""
        q = as_vector(q, self._n, key="q", names=self.robot.joint_names)
        return q, time if isinstance(time, float) and time == self._time else as_number(time, key="time")

    def _place(self, q: Vector, time: float) -> None:
        self.cover_unchecked(q)
        if self._moving and time != self._time:
            self._time = time
            self._put_obstacles()
        pin.computeJointJacobians(self.robot.model, self._data, q)
        self._q = q
        self._geometry.place()

    def _put_obstacles(self) -> None:
        """Move the obstacles that move to where they are at the present time."""
        for index in self._moving:
            shift = self.obstacle_offset(index, self._time)
            first = int(self._first_body[index])
            for body, piece in enumerate(self.obstacles[index].pieces, start=first):
                self._geometry.move(body, pin.SE3(piece.placement.rotation, piece.placement.translation + shift))

    def _rows(
        self, measured: Indices, found: Matrix, reach: Vector, margin: float = np.inf, lead: Lead | None = None
    ) -> Nearby:
        """The rows of those of the `measured` pairs (K,) that are within `reach` (K,), see `_measure_within`.

        If there is a margin [m], all other pairs are known to be further away. If there is a lead, pairs beyond the
        margin count only if the lead selects them.
        """
        v, change, longest = _NO_LEAD if lead is None else lead
        velocity = self._velocity if self._moving else None
        near, near_found, pair, found, left, gradient, drift = near_rows(
            measured, found, reach, self.clearance, self._sense, velocity, self._J, margin, v, change, longest
        )
        self._near = near, near_found
        if margin < np.inf and not self._some_appear:
            self._known.note_near(pair, left, margin)
        return Nearby(
            pair, found[:, 0], left, normal=found[:, 1:4], point_link=found[:, 4:7], point_obstacle=found[:, 7:],
            gradient=gradient, drift=drift,
        )  # fmt: skip
