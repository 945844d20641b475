"""Signed distances, critical points and their gradients, of all pairs that may touch.

Every pair of a piece of a link and a piece of an obstacle has one row, and so has every pair
of the machine's own pieces that may meet. The gradient of the signed distance is

    dd/dq = n . (J_2 - J_1)

with coal's own normal n (from the link to the obstacle, also inside) and the Jacobians
J_1, J_2 of the two witness points. A normal made from the witness points would change its
sign inside.

An obstacle of thousands of cells is one obstacle here, a `Cluster`: one pair with every piece of a
link. Its distances are exact within `EXACT_WITHIN` and where one is asked for; else a lower
bound is enough and takes a hundredth of the time.

Broad phase: a pair that was d apart is at least d - sum_j |dq_j| r_j apart after the joints
moved by dq, so pairs that are provably still out of reach are not measured again.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector, as_array, as_count, as_number, as_rows, as_vector
from backhoe_planner.errors import InputError, check_flag, check_kind
from backhoe_planner.machine import (
    Reading,
    Robot,
    geometry_model,
    self_pairs,
    self_pieces,
    tracking_room,
    travel_bounds,
)
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.cluster_distances import EXACT_WITHIN, ClusterDistances
from backhoe_planner.site.obstacles import Obstacle, offset_at
from backhoe_planner.site.obstruction import Obstruction, ObstructionKind


@dataclass(frozen=True)
class Pair:
    """Two convex pieces that must keep apart.

    Attributes
    ----------
    link: name of the link.
    kind: ``obstacle``, or ``machine`` where the machine must not touch itself.
    obstacle: name of the obstacle, or of the machine's other link.
    piece: index into the robot's pieces, of ``machine`` into its `self_pieces`.
    clearance: signed distance to be kept [m], with `tracking`.
    tracking: what of it is for the machine's tracking error [m].
    """

    link: str
    kind: ObstructionKind
    obstacle: str
    piece: int
    clearance: float
    tracking: float = 0.0

    def at(self, distance: float, *, time: float = 0.0) -> Obstruction:
        """The pair where it is `distance` apart [m], at `time` [s]."""
        margin = distance - self.clearance
        return Obstruction(self.kind, self.obstacle, self.link, distance, margin, time, tracking=self.tracking)


@dataclass(frozen=True)
class Nearby:
    """The pairs within a distance, one row each, in the order of `Proximity.pairs`.

    Attributes
    ----------
    pair: (K,) indices into `Proximity.pairs`.
    distance: (K,) signed distance [m], negative inside.
    margin: (K,) distance minus the clearance to be kept [m].
    normal: (K, 3) unit normal from the link to the obstacle, world.
    point_link, point_obstacle: (K, 3) critical point and its witness [m], world.
    gradient: (K, n) derivative of the distance [m/rad].
    drift: (K,) rate at which the obstacle's own motion changes the distance [m/s].
    moves: (K, n) which joints move the link.
    """

    pair: Indices
    distance: Vector
    margin: Vector
    normal: Matrix
    point_link: Matrix
    point_obstacle: Matrix
    gradient: Matrix
    drift: Vector
    moves: Flags

    def __len__(self) -> int:
        return len(self.pair)

    def only(self, rows: Flags) -> Nearby:
        """The rows for which `rows` (K,) is true."""
        if np.shape(rows) != (len(self),) or np.asarray(rows).dtype != bool:
            allowed = f"{len(self)} times True or False"
            raise InputError("is not true or false of every row", key="rows", found=reprlib.repr(rows), allowed=allowed)
        rows = np.asarray(rows)
        return Nearby(*(getattr(self, field.name)[rows] for field in fields(self)))


class Proximity:
    """All distances between one machine and a set of obstacles, and between its own parts.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    robot, obstacles: the machine and what stands around it.
    self_collision: whether the machine's own parts are measured, too.

    Raises
    ------
    InputError: an argument is not of its kind, here and in every method; names it.

    Attributes
    ----------
    pairs: the P pairs that are measured; results hold indices into them.
    clearance: (P,) of every pair [m].
    travel: (P, n) r of every pair: travel @ |dq| bounds how much the distance changes; within the
        limits, and in every posture that was measured or given to `cover`.
    speed: (P,) of the obstacle [m/s].
    owner: (P,) index of the obstacle, -1 for the machine itself.
    second: (P,) index of the other body's piece, in the obstacle's pieces or in the machine's.
    appears_at: (P,) when the obstacle appears [s]; minus infinity for the machine itself.
    plain: the first so many pairs are of two convex pieces; the others of a piece and a cluster.
    measured: how many distances `at` has measured so far.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle] = (), *, self_collision: bool = True) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        given = enumerate(check_kind(obstacles, Iterable, key="obstacles"))  # type: ignore[type-abstract]
        self.obstacles = tuple(check_kind(one, Obstacle, key=f"obstacles[{index}]") for index, one in given)
        self_collision = check_flag(self_collision, key="self_collision")
        self._n = robot.n
        self._pieces = self_pieces(robot) if self_collision else robot.pieces
        self._model = geometry_model(robot, pieces=self._pieces)
        self._data = robot.model.createData()
        pairs: list[Pair] = []
        owner: list[int] = []
        second: list[int] = []
        self._first_geometry: list[int] = []  # of each obstacle
        for index, obstacle in enumerate(self.obstacles):
            self._first_geometry.append(int(self._model.ngeoms))
            for part, piece in enumerate(obstacle.pieces):
                geometry = self._model.addGeometryObject(
                    pin.GeometryObject(f"obstacle {index}/{part}", 0, 0, piece.placement, piece.shape)
                )
                for row in robot.pieces_of(obstacle.links):
                    self._model.addCollisionPair(pin.CollisionPair(row, geometry))
                    pairs.append(Pair(robot.pieces[row].link, "obstacle", obstacle.name, row, obstacle.clearance))
                    owner.append(index)
                    second.append(part)
        for outer, inner in self_pairs(robot).kept if self_collision else ():
            self._model.addCollisionPair(pin.CollisionPair(outer, inner))
            pairs.append(Pair(self._pieces[outer].link, "machine", self._pieces[inner].link, outer, 0.0))
            owner.append(-1)
            second.append(inner)
        self.plain = len(pairs)
        self._clusters = ClusterDistances(robot, self.obstacles)
        for index, row in zip(self._clusters.owner.tolist(), self._clusters.piece.tolist(), strict=True):
            obstacle = self.obstacles[index]
            pairs.append(Pair(robot.pieces[row].link, "obstacle", obstacle.name, row, obstacle.clearance))
            owner.append(index)
            second.append(0)
        self.second = tuple(second)
        self.owner = np.array(owner, dtype=int)
        first = np.array([pair.piece for pair in pairs], dtype=int)
        joint_of = np.array([own.joint for own in self._pieces], dtype=int)
        self._other_joint = np.array(
            [0 if index >= 0 else joint_of[inner] for index, inner in zip(owner, second, strict=True)], dtype=int
        )
        self._moves = robot.support[joint_of[first]] > 0.0
        self._minus_mask_link = -robot.support[joint_of[first]]
        self._mask_other = robot.support[self._other_joint]
        self._first, self._slides = first, bool(robot.prismatic.any())
        # how far slides were run out at most; hinges do not count
        limits = robot.limits
        self._run_out = np.where(robot.prismatic, np.maximum(np.abs(limits.lower), np.abs(limits.upper)), np.inf)
        self.travel = self._travel_of_pairs()
        room = tracking_room(robot, [self._pieces[row] for row in first.tolist()], self.travel)
        self.pairs = tuple(
            replace(pair, clearance=pair.clearance + more, tracking=more) if more else pair
            for pair, more in zip(pairs, room.tolist(), strict=True)
        )
        self.clearance = np.array([pair.clearance for pair in self.pairs])
        velocity = np.array([obstacle.velocity for obstacle in self.obstacles]).reshape(-1, 3)
        self._velocity = np.vstack((velocity, np.zeros((1, 3))))[self.owner]
        self.speed = np.linalg.norm(self._velocity, axis=1)
        appears = np.array([obstacle.appears_at for obstacle in self.obstacles] + [-np.inf])
        self.appears_at = appears[self.owner]
        self._some_appear = bool(np.any(self.appears_at > 0.0))
        self._moving = [index for index, obstacle in enumerate(self.obstacles) if obstacle.moves]
        self._geometry = self._model.createData()
        for request in self._geometry.distanceRequests:
            shapes.prepare(request)
        self._time = 0.0  # for which obstacles are placed
        # from the last measurement: lower bounds of all distances, and where and when they were found
        self._bound, self._q_bound, self._bound_time = np.full(len(pairs), -np.inf), np.zeros(robot.n), 0.0
        self.measured = 0

    def cover(self, q: Matrix) -> None:
        """Let `travel` hold in postures q (..., n) outside of the limits too, and between them and these.

        Whatever is measured is covered already; only who reads `travel` before has to ask.
        """
        self.cover_unchecked(as_rows(q, self._n, key="q"))

    def cover_unchecked(self, q: Matrix) -> None:
        """The same for callers in a loop, whose arguments are right as they are made."""
        if self._slides:
            run_out = np.abs(np.reshape(q, (-1, self.robot.n))).max(axis=0)
            if np.count_nonzero(run_out > self._run_out):
                self._run_out = np.maximum(self._run_out, run_out)
                self.travel = self._travel_of_pairs()

    def _travel_of_pairs(self) -> Matrix:
        # joints that move both bodies do not change their distance
        return np.where(
            self._mask_other > 0.0, 0.0, travel_bounds(self.robot, self._run_out, pieces=self._pieces)[self._first]
        )

    @property
    def geometry(self) -> tuple[pin.GeometryModel, pin.GeometryData]:
        """Pinocchio's geometry model with all pairs, and its data; to be read only."""
        return self._model, self._geometry

    def at(self, q: Vector, *, time: float = 0.0, within: float = np.inf, margin: float | Vector = np.inf) -> Nearby:
        """The pairs that are near at configuration `q` (n,) and `time` [s].

        Obstacles that have not appeared by `time` are left out.

        Parameters
        ----------
        within: largest distance [m].
        margin: largest distance beyond the clearance to be kept, one number or (P,) [m].
        """
        q, time = self._checked(q, time)
        if not (isinstance(margin, float) and margin == margin):
            margin = as_array(margin, *np.shape(margin) and (len(self.pairs),), key="margin", finite=False)
        if not (isinstance(within, float) and within == within):
            within = as_number(within, key="within", finite=False)
        self._place(q, time)
        lower = self._lower(q, time)
        reach = self.clearance + margin
        if within < np.inf:
            reach = np.minimum(reach, within)
        self._raise_by_grids(lower, reach)
        found: list[int] = []
        results: list[Any] = []
        for index in np.flatnonzero(lower <= reach).tolist():
            self.measured += 1
            if index >= self.plain:
                reading = self._nearest(index, float(lower[index]), float(reach[index]))
                if reading is None:
                    lower[index] = reach[index]
                    continue
                lower[index] = reading.distance
                found.append(index)
                results.append(reading)
                continue
            result = shapes.measure(self._model, self._geometry, index)
            distance = result.min_distance
            lower[index] = distance
            if distance <= reach[index]:
                found.append(index)
                results.append(result)
        self._bound, self._q_bound, self._bound_time = lower, q.copy(), time
        if self._some_appear:
            kept = [k for k, index in enumerate(found) if self.appears_at[index] <= time]
            found, results = [found[k] for k in kept], [results[k] for k in kept]
        return self._rows(found, results)

    def is_at(self, q: Vector, *, time: float = 0.0) -> bool:
        """Whether the last measurement was made at `q` and `time`."""
        q, time = self._checked(q, time)
        return self.is_at_unchecked(q, time=time)

    def is_at_unchecked(self, q: Vector, *, time: float = 0.0) -> bool:
        """The same for callers in a loop, whose arguments are right as they are made."""
        return bool(self._bound_time == time and (self._q_bound == q).all())

    def stays_clear(self, q: Vector, *, time: float = 0.0) -> bool:
        """Whether the last measurement proves that every clearance holds on the straight way from there to `q`.

        False says nothing. The way ends at `time` [s].
        """
        q, time = self._checked(q, time)
        return self.stays_clear_unchecked(q, time=time)

    def stays_clear_unchecked(self, q: Vector, *, time: float = 0.0) -> bool:
        """The same for callers in a loop, whose arguments are right as they are made."""
        return bool((self._lower(q, time) >= self.clearance).all())

    def _lower(self, q: Vector, time: float) -> Vector:
        """(P,) lower bounds of the distances from the last measurement alone [m]."""
        self.cover_unchecked(q)
        lower = self._bound - self.travel @ np.abs(q - self._q_bound)
        if self._moving:
            lower -= self.speed * np.abs(_age(time, self.appears_at) - _age(self._bound_time, self.appears_at))
        return np.asarray(lower)

    def distances(self, q: Vector, *, time: float = 0.0) -> Vector:
        """(P,) signed distance of every pair at q (n,), `time` [s], in m; infinite before an obstacle appears.

        From a cluster further away than `EXACT_WITHIN` it is a lower bound.
        """
        q, time = self._checked(q, time)
        self._place(q, time)
        pin.computeDistances(self._model, self._geometry)
        found = np.full(len(self.pairs), -np.inf)
        found[: self.plain] = [result.min_distance for result in self._geometry.distanceResults]
        self._measure_clusters(range(self.plain, len(self.pairs)), found)
        for index in np.flatnonzero(shapes.in_doubt(found[: self.plain])).tolist():
            found[index] = shapes.measure_pair_again(self._model, self._geometry, index).min_distance
        if self._some_appear:
            found[self.appears_at > time] = np.inf
        return found

    def tightest(self, q: Vector, *, time: float = 0.0) -> Obstruction | None:
        """The pair with the least margin at `q` (n,) and `time` [s]; None where nothing can be touched."""
        q, time = self._checked(q, time)
        if not self.pairs:
            return None
        distances = self.distances(q, time=time)
        index = int(np.argmin(distances - self.clearance))
        exact: set[int] = set()
        while index >= self.plain and EXACT_WITHIN <= distances[index] < np.inf and index not in exact:
            exact.add(index)
            distances[index] = self.distance_of_unchecked(index, q, time=time)
            index = int(np.argmin(distances - self.clearance))
        distance = float(distances[index])
        return self.pairs[index].at(distance, time=time) if np.isfinite(distance) else None

    def lower_bounds(self, q: Vector, *, time: float, floor: Vector) -> tuple[Vector, Flags]:
        """Signed distances, measured only where they may be below `floor`.

        Parameters
        ----------
        q: (n,) joint positions [rad or m]; time: of the site [s].
        floor: (P,) a lower bound above this is good enough [m].

        Returns
        -------
        (P,) lower bound of each distance, equal to it where it was measured; and (P,)
        whether it was measured.
        """
        q, time = self._checked(q, time)
        if not isinstance(floor, np.ndarray) or floor.shape != self.clearance.shape:
            floor = as_array(floor, len(self.pairs), key="floor", finite=False)
        self._place(q, time)
        lower = self._lower(q, time)
        self._raise_by_grids(lower, floor)
        needed = lower < floor
        for index in needed.nonzero()[0].tolist():
            if index < self.plain:
                lower[index] = shapes.measure(self._model, self._geometry, index).min_distance
                continue
            reading = self._nearest(index, float(lower[index]), float(floor[index]))
            needed[index] = reading is not None
            lower[index] = floor[index] if reading is None else reading.distance
        self._bound, self._q_bound, self._bound_time = lower, q.copy(), time
        return lower.copy(), needed

    def distance_of(self, pair: int, q: Vector, *, time: float = 0.0) -> float:
        """Signed distance of one pair at q (n,), `time` [s], in m."""
        if not 0 <= as_count(pair, key="pair") < len(self.pairs):
            raise InputError("there is no such pair", key="pair", found=pair, allowed=f"less than {len(self.pairs)}")
        q, time = self._checked(q, time)
        return self.distance_of_unchecked(pair, q, time=time)

    def distance_of_unchecked(self, pair: int, q: Vector, *, time: float = 0.0) -> float:
        """The same for callers in a loop, whose arguments are right as they are made."""
        self._place(q, time)
        if pair < self.plain:
            return float(shapes.measure(self._model, self._geometry, pair).min_distance)
        reading = self._nearest(pair, -np.inf, np.inf)
        assert reading is not None
        return reading.distance

    def distances_of(self, pairs: Indices, q: Vector, *, time: float = 0.0) -> Vector:
        """(K,) signed distances [m] of `pairs` (K,) at q (n,), `time` [s], also of obstacles yet to appear.

        From a cluster further away than `EXACT_WITHIN` it is a lower bound.
        """
        pairs = self._checked_pairs(pairs)
        q, time = self._checked(q, time)
        return self.distances_of_unchecked(pairs, q, time=time)

    def distances_of_unchecked(self, pairs: Indices, q: Vector, *, time: float = 0.0) -> Vector:
        """The same for callers in a loop, whose arguments are right as they are made."""
        self._place(q, time)
        plain = pairs.tolist()
        if not len(self._clusters):
            return np.array([shapes.measure(self._model, self._geometry, index).min_distance for index in plain])
        found = np.full(len(self.pairs), -np.inf)
        self._measure_clusters([index for index in plain if index >= self.plain], found)
        for index in plain:
            if index < self.plain:
                found[index] = shapes.measure(self._model, self._geometry, index).min_distance
        return found[pairs]

    def all_at_least(self, pairs: Indices, least: Vector, q: Vector, *, time: float = 0.0) -> bool:
        """Whether the distances of `pairs` (K,) at `q` are at least `least` (K,) [m]; stops at the first less."""
        q, time = self._checked(q, time)
        pairs = self._checked_pairs(pairs)
        least = as_array(least, len(pairs), key="least", finite=False)
        return self.all_at_least_unchecked(pairs, least, q, time=time)

    def all_at_least_unchecked(self, pairs: Indices, least: Vector, q: Vector, *, time: float = 0.0) -> bool:
        """The same for callers in a loop, whose arguments are right as they are made."""
        if not len(pairs):
            return True
        self._place(q, time)
        return all(
            shapes.measure(self._model, self._geometry, pair).min_distance >= bound
            if pair < self.plain
            else self._clusters.is_at_least(pair - self.plain, self._data, self._time, bound)
            for pair, bound in zip(pairs.tolist(), least.tolist(), strict=True)
        )

    # --- clusters -------------------------------------------------------------------------

    def _raise_by_grids(self, lower: Vector, needed: Vector) -> None:
        """Raise the lower bounds (P,) of clusters, at the present placements, where one is below `needed` (P,)."""
        own = lower[self.plain :]
        if len(own) and (own < needed[self.plain :]).any():
            np.maximum(own, self._clusters.lower(self._data, self._time), out=own)

    def _measure_clusters(self, pairs: Iterable[int], found: Vector) -> None:
        """Enter distances from clusters into `found` (P,), exact within `EXACT_WITHIN`."""
        pairs = list(pairs)
        if not pairs:
            return
        self._raise_by_grids(found, np.full(len(found), EXACT_WITHIN))
        for index in pairs:
            if found[index] < EXACT_WITHIN:
                reading = self._nearest(index, float(found[index]), EXACT_WITHIN)
                found[index] = EXACT_WITHIN if reading is None else reading.distance

    def _nearest(self, pair: int, lower: float, reach: float) -> Reading | None:
        """The distance of a pair with a cluster, at the present placements; None where it is not less than `reach`.

        lower: what it is known to be at least [m].
        """
        return self._clusters.nearest(pair - self.plain, self._data, self._time, lower=lower, reach=reach)

    def obstacle_offset(self, index: int, time: float) -> Vector:
        """(3,) how far obstacle `index` has moved by `time` [m]."""
        if as_count(index, key="index") >= len(self.obstacles):
            raise InputError(
                "there is no such obstacle", key="index", found=index, allowed=f"less than {len(self.obstacles)}"
            )
        return offset_at(self.obstacles[index], as_number(time, key="time"))

    def _checked(self, q: Vector, time: float) -> tuple[Vector, float]:
        """`q` (n,) and `time`, which a caller may give as a list and an int."""
        q = as_vector(q, self._n, key="q", names=self.robot.joint_names)
        return q, time if isinstance(time, float) and time == self._time else as_number(time, key="time")

    def _checked_pairs(self, pairs: Indices) -> Indices:
        found = np.asarray(pairs)
        wrong = found.ndim != 1 or found.dtype.kind not in "iu" or ((found < 0) | (found >= len(self.pairs))).any()
        if wrong and found.shape != (0,):
            allowed = f"whole numbers from 0 to {len(self.pairs) - 1}"
            raise InputError("are not indices of pairs", key="pairs", found=reprlib.repr(pairs), allowed=allowed)
        return found

    def _place(self, q: Vector, time: float) -> None:
        if self._moving and time != self._time:
            for index in self._moving:
                shift = self.obstacle_offset(index, time)
                first = self._first_geometry[index]
                for part, piece in enumerate(self.obstacles[index].pieces):
                    moved = pin.SE3(piece.placement.rotation, piece.placement.translation + shift)
                    self._model.geometryObjects[first + part].placement = moved
            self._time = time
        pin.computeJointJacobians(self.robot.model, self._data, q)
        pin.updateGeometryPlacements(self.robot.model, self._data, self._model, self._geometry)

    def _rows(self, found: list[int], results: list[Any]) -> Nearby:
        # for a handful of rows, one list of floats costs less than several arrays per row
        flat: list[float] = []
        for result in results:
            if isinstance(result, Reading):
                distance, normal, first, second = result
            else:
                distance, normal = result.min_distance, result.normal
                first, second = result.getNearestPoint1(), result.getNearestPoint2()
            nx, ny, nz = normal.tolist()
            px, py, pz = first.tolist()
            flat += (distance, nx, ny, nz, px, py, pz)
            flat += (py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx)
            px, py, pz = second.tolist()
            flat += (px, py, pz, py * nz - pz * ny, pz * nx - px * nz, px * ny - py * nx)
        raw = np.array(flat).reshape(-1, 16)
        pair = np.array(found, dtype=np.intp)
        distances, normals = raw[:, 0], raw[:, 1:4]
        # the speed of a point p along n is n . v + (p x n) . omega
        J = self._data.J.reshape(6, self._n)  # of one joint alone it is 1-D
        along = normals @ J[:3]
        gradient = (along + raw[:, 7:10] @ J[3:]) * self._minus_mask_link[pair]
        if self._other_joint[pair].any():
            gradient += (along + raw[:, 13:] @ J[3:]) * self._mask_other[pair]
        drift = np.einsum("ki,ki->k", normals, self._velocity[pair]) if self._moving else np.zeros(len(found))
        return Nearby(
            pair, distances, margin=distances - self.clearance[pair], normal=normals, point_link=raw[:, 4:7],
            point_obstacle=raw[:, 10:13], gradient=gradient, drift=drift, moves=self._moves[pair],
        )  # fmt: skip


def _age(time: float, appears_at: Vector) -> Vector:
    """(P,) how long obstacles have been there at `time` [s]."""
    return np.maximum(time - np.maximum(appears_at, 0.0), 0.0)
