"""Distances between a machine's links and the clusters around it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Literal

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Cluster, Distances, Reading, ResultTable, Robot, reach_ball
from backhoe_planner.site.obstacles import Obstacle, offset_at
from backhoe_planner.site.pairs.beside_solids import BesideSolids
from backhoe_planner.site.pairs.link_balls import BallLevel, LinkBalls, Poses
from backhoe_planner.site.pairs.link_corners import KEPT, NEARER
from backhoe_planner.site.pairs.one_joint_bounds import OneJointBounds
from backhoe_planner.site.pairs.over_ground import OverGround

EXACT_WITHIN = 0.5  # m: distances from clusters beyond it are lower bounds; chosen, about how far obstacles act
_MOST_BALLS = (4, 24)  # of a piece, on each level; chosen
_TOGETHER = 2_000  # links that are bounded more finely at once; chosen to bound the memory
AHEAD = 0.02  # m that distances are measured beyond what is needed; chosen, halves the queries of a swing post
_FIRST_REACH = 0.25  # m beyond the known lower bound, within which a cluster is first searched; chosen
_LEAST_REACH = 1e-3  # m within which a cell is always searched, even if only an overlap matters; chosen
_REMEMBERED = 16_000  # distances that were measured; chosen to bound the memory: some 16 MB
_Standing = tuple[int, Indices, Cluster]
"""An obstacle that does not move: its index, the pairs with it, and its cluster."""


class ClusterDistances:
    """The K pairs of a link's piece and an obstacle that is a cluster.

    Attributes
    ----------
    owner, piece: (K,) index of the obstacle, and row of the robot's pieces.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self._robot, self._obstacles = robot, obstacles
        pairs = [
            (index, row)
            for index, obstacle in enumerate(obstacles)
            if obstacle.cluster is not None
            for row in robot.pieces_of(obstacle.links)
        ]
        self.owner, self.piece = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
        pieces, self._column = np.unique(self.piece, return_inverse=True)
        own = [robot.pieces[row] for row in pieces.tolist()]
        self._balls = _balls_around(robot, tuple(pieces.tolist())) if pairs else None
        self._rows = [(index, np.flatnonzero(self.owner == index)) for index in sorted(set(self.owner.tolist()))]
        self._moving = {index for index, _ in self._rows if obstacles[index].moves}
        self._grids: dict[int, Distances] = {}
        # bounds of the configurations that are expected, and the bounds that were needed
        self._expected: dict[tuple[bytes, float], tuple[Vector, Vector]] = {}
        # measurements in these configurations, and how far was searched
        self._ahead: dict[tuple[int, bytes], tuple[Reading | None, float]] = {}
        # the measurement of a pair with its joint at a place, and how far was searched
        self._measured: dict[tuple[int, bytes, float], tuple[Reading | None, float]] = {}
        # obstacles that do not move, for which many queries are answered at once: ground, and all others
        standing = [
            (index, those, cluster)
            for index, those in self._rows
            if index not in self._moving and (cluster := obstacles[index].cluster) is not None
        ]
        self._ground = [one for one in standing if one[2].solid.ground is not None]
        self._solids = [one for one in standing if one[2].solid.ground is None]
        self._over_ground = OverGround(own, self._balls) if self._balls is not None and self._ground else None
        self._beside_solids = BesideSolids(own, self._balls) if self._balls is not None and self._solids else None
        stands = np.array([index not in self._moving for index in self.owner.tolist()], dtype=bool)
        self._one_joint = OneJointBounds(robot, self.piece, stands, self._distance_in)
        if pairs:  # most sites have none
            self._reach = reach_ball(robot)
            self._kinematics = BatchKinematics(robot)
            self._data = robot.model.createData()

    def __len__(self) -> int:
        return len(self.owner)

    def with_own_memory(self) -> ClusterDistances:
        """A copy with its own working memory; the data built to bound distances are shared."""
        other = copy.copy(self)
        other._expected, other._ahead, other._measured = {}, {}, {}
        if len(self):
            other._data = self._robot.model.createData()
        return other

    def lower(self, data: pin.Data, time: float, *, q: Vector | None = None, needed: float | Vector = np.inf) -> Vector:
        """(K,) lower bounds of the distances [m] where the joints of `data` are, or minus infinity.

        A bound that is at least `needed`, a number or (K,), may be far below the distance.

        q: (n,) where the joints are, if known; then it may have been expected.
        """
        assert self._balls is not None
        known = None if q is None else self._expected.get((q.tobytes(), time if self._moving else 0.0))
        if known is not None:
            bounds, enough = known
            if not ((bounds < needed) & (enough < needed)).any():
                return bounds
        own = None if q is None else q[None, :]
        return np.asarray(self._lower(self._balls.poses_at(data), own, np.array([time]), needed)[0])

    def expect(self, q: Matrix, time: float | Vector, *, needed: Vector | Matrix, sunk: bool = False) -> Matrix:
        """(N, K) the bounds of `lower_each` for all `q` (N, n), kept for `lower` until others are expected.

        Distances that may be less than needed are kept likewise, for `nearest`; `sunk` as for
        `OverGround.measure`.
        """
        if not len(self) or not len(q):
            return np.zeros((len(q), len(self)))
        assert self._balls is not None
        poses = self._balls.poses_of(self._kinematics.at(q))
        self._ahead = {}
        bounds = self._lower(
            poses,
            q,
            np.broadcast_to(time, len(q)),
            needed,
            measured=lambda found: self._measure_ahead(q, poses, found, needed, sunk=sunk),
        )
        times = np.broadcast_to(time if self._moving else 0.0, len(q)).tolist()
        rows = zip(q, times, bounds, np.broadcast_to(needed, bounds.shape), strict=True)
        self._expected = {(at.tobytes(), moment): (found, enough) for at, moment, found, enough in rows}
        return bounds

    def forget_expected(self) -> None:
        """Forget what was expected: depths measured as roughly as for a descent are for that descent alone."""
        self._expected, self._ahead = {}, {}

    def _measure_ahead(
        self, q: Matrix, poses: Poses, bounds: Matrix, needed: float | Array, *, sunk: bool
    ) -> None:  # fmt: skip
        """Measure pairs with standing clusters that may be nearer than needed, and raise their bounds (N, K)."""
        needed, names = np.broadcast_to(needed, bounds.shape), [at.tobytes() for at in q]
        asked = (bounds < needed) & (needed <= EXACT_WITHIN)
        ways: list[tuple[Callable[..., list[Reading | Literal["far"] | None]], list[_Standing]]] = []
        if self._over_ground is not None:
            ways.append((partial(self._over_ground.measure, sunk=sunk), self._ground))
        if self._beside_solids is not None:
            ways.append((self._beside_solids.measure, self._solids))
        for measure, standing in ways:
            for _, pairs, cluster in standing:
                rows, those = _asked_of(asked, pairs)
                if not len(rows):
                    continue
                reach = needed[rows, those] + AHEAD
                found = measure(cluster, poses, rows, self._column.take(those), reach)
                for row, pair, within, one in zip(rows.tolist(), those.tolist(), reach.tolist(), found, strict=True):
                    if isinstance(one, Reading):
                        self._ahead[pair, names[row]], bounds[row, pair] = (one, within), one.distance
                    elif one is not None:
                        self._ahead[pair, names[row]], bounds[row, pair] = (None, within), within

    def lower_each(self, q: Matrix, time: float | Vector, *, needed: float | Array = np.inf) -> Matrix:
        """(N, K) `lower` for each of `q` (N, n), `time` one or (N,) [s], `needed` a number, (K,) or (N, K)."""
        assert self._balls is not None
        if not len(q):
            return np.zeros((0, len(self)))
        return self._lower(self._balls.poses_of(self._kinematics.at(q)), q, np.broadcast_to(time, len(q)), needed)

    def _lower(
        self, poses: Poses, q: Matrix | None, time: Vector, needed: float | Array,
        *, judged: Callable[[Matrix], None] | None = None, measured: Callable[[Matrix], None] | None = None,
    ) -> Matrix:  # fmt: skip
        """(N, K) as `lower_each`. `judged` raises bounds first, and `measured` before finer balls are used."""
        assert self._balls is not None
        first, *finer = self._balls.levels
        found = np.full((len(poses), len(self)), -np.inf)
        needed = np.broadcast_to(needed, found.shape)
        if judged is not None:
            judged(found)
            if (found >= needed).all():
                return found
        solids = self._raise_beside_solids(poses, needed, found)
        centres = None
        for index, pairs in self._rows:
            if index in solids or (judged is not None and (found[:, pairs] >= needed[:, pairs]).all()):
                continue
            grid, shift = self._grid(index), self._shifts(index, time)
            centres = first.centres(poses) if centres is None else centres
            away = grid.lower(centres.reshape(3, -1), None if shift is None else shift.repeat(len(first), axis=1))
            bounds = first.least(away.reshape(len(poses), -1)).take(self._column[pairs], axis=1)
            found[:, pairs] = np.maximum(found[:, pairs], bounds)
        if q is not None:
            self._one_joint.raise_to(needed, found, q)
        if measured is not None:
            measured(found)
        for index, pairs in self._rows:
            if index in solids:
                continue
            grid, shift = self._grid(index), self._shifts(index, time)
            for level in finer:
                self._refine(level, grid, pairs, shift, poses, needed, found)
        # where a ball may touch the cluster, nothing is known of how deep the piece is inside
        found[found <= 0.0] = -np.inf
        return found

    def _raise_beside_solids(self, poses: Poses, needed: Matrix, found: Matrix) -> set[int]:
        """Raise the bounds in `found` (N, K) of pairs with standing solids that are below those needed (N, K).

        Returns the obstacles with which no pair is left to do: all that the machine can come near.
        """
        done: set[int] = set()
        for index, pairs, cluster in self._solids:
            grid = self._grid(index)
            if grid.grid is None or self._beside_solids is None:
                continue
            done.add(index)
            rows, those = _asked_of(found < needed, pairs)
            if len(rows):
                enough, pieces = needed[rows, those], self._column.take(those)
                lower = self._beside_solids.lower(cluster, poses, rows, pieces, enough, grid)
                found[rows, those] = np.maximum(found[rows, those], lower)
        return done

    def _refine(
        self, level: BallLevel, grid: Distances, pairs: Indices, shift: Matrix | None, poses: Poses, needed: Matrix,
        found: Matrix,
    ) -> None:  # fmt: skip
        """Raise the bounds in `found` (N, K) of some pairs with one cluster that are below those needed (N, K)."""
        rows, which = (found[:, pairs] < needed[:, pairs]).nonzero()
        for start in range(0, len(rows), _TOGETHER):
            few, those = rows[start : start + _TOGETHER], pairs.take(which[start : start + _TOGETHER])
            pieces = self._column.take(those)
            centres, counts = level.centres_of(poses, few, pieces)
            away = grid.lower(centres, None if shift is None else shift.take(few, axis=1).repeat(counts, axis=1))
            found[few, those] = np.maximum(found[few, those], level.least_of(away, counts, pieces))

    def measure(self, pair: int, data: pin.Data, time: float, reach: float) -> Reading | None:
        """The distance of a pair where the joints of `data` are; None if it is not less than `reach` [m]."""
        index, piece = int(self.owner[pair]), self._robot.pieces[self.piece[pair]]
        cluster = self._obstacles[index].cluster
        assert cluster is not None
        return cluster.measure(piece.piece, data.oMi[piece.joint], reach, shift=self._shift(index, time))

    def nearest(
        self, pair: int, data: pin.Data, time: float, *, lower: float, reach: float, q: Vector | None = None
    ) -> Reading | None:  # fmt: skip
        """The same as `measure`, searched further and further away from its known lower bound `lower` [m].

        Recent measurements are not repeated.

        q: (n,) where the joints are, if known; then it may have been expected.
        """
        if q is not None and self._ahead:
            found, within = self._ahead.get((pair, q.tobytes()), (None, -np.inf))
            if found is not None or within >= reach:
                return found if found is not None and found.distance < reach else None
        place = data.oMi[self._robot.pieces[self.piece[pair]].joint]
        moment = time if self._moving else 0.0
        key = pair, place.homogeneous.tobytes(), moment
        found, within = self._measured.get(key, (None, 0.0))
        far = max(reach, _LEAST_REACH)
        if found is None and within < far:
            within = min(max(lower, within, 0.0) + _FIRST_REACH, far)
            found = self.measure(pair, data, time, within)
            while found is None and within < far:
                within = min(2.0 * within, far)
                found = self.measure(pair, data, time, within)
            if len(self._measured) >= _REMEMBERED:
                self._measured.clear()
            self._measured[key] = found, within
        return found if found is not None and found.distance < reach else None

    def measure_each(
        self, pairs: Indices, data: pin.Data, time: float, *, lower: Vector, reach: Vector, q: Vector
    ) -> tuple[Matrix, list[int]]:
        """(M, 10) `nearest` of some pairs, as in a `ResultTable`, and the rows of those that are far.

        A far pair is not nearer than its `reach` (M,) [m]; instead of the distance it has a lower bound, no less.
        """
        found, far = np.zeros((len(pairs), ResultTable.COLUMNS)), []
        for row, (pair, least, enough) in enumerate(zip(pairs.tolist(), lower.tolist(), reach.tolist(), strict=True)):
            reading = self.nearest(pair, data, time, lower=least, reach=enough + AHEAD, q=q)
            if reading is not None and reading.distance < enough:
                found[row] = np.concatenate(([reading.distance], *reading[1:]))
            else:
                far.append(row)
                found[row, 0] = enough + AHEAD if reading is None else reading.distance
        return found, far

    def _distance_in(self, pair: int, q: Vector) -> float:
        """The distance of a pair with a fixed obstacle in a posture (n,), or less if beyond `EXACT_WITHIN` [m]."""
        data = self._robot.model.createData()  # not that of `self`: copies with their own memory call this too
        pin.forwardKinematics(self._robot.model, data, q)
        found = self.measure(pair, data, 0.0, EXACT_WITHIN)
        return EXACT_WITHIN if found is None else found.distance

    def make_exact(self, found: Vector, pairs: Indices, data: pin.Data, time: float) -> None:
        """Replace lower bounds `found` (K,) of some pairs by distances, exact within `EXACT_WITHIN` [m]."""
        for pair in pairs.tolist():
            if found[pair] < EXACT_WITHIN:
                reading = self.nearest(pair, data, time, lower=float(found[pair]), reach=EXACT_WITHIN)
                found[pair] = EXACT_WITHIN if reading is None else reading.distance

    def keep(self, least: Vector, data: pin.Data, time: float, *, q: Vector | None = None) -> bool:
        """Whether all distances are at least `least` (K,) [m]; `q` as for `lower`."""
        assert self._balls is not None
        if not self._ground and not self._solids:
            return self._keep(least, self.lower(data, time, q=q, needed=least), data, time)
        lower, nearer = self._judged(
            self._balls.poses_at(data), None if q is None else q[None], np.array([time]), least
        )
        return not nearer and self._keep(least, lower[0], data, time)

    def keep_each(self, least: Vector, q: Matrix, time: float) -> Iterator[bool]:
        """As `keep` at each of `q` (N, n), one after the other; the bounds of all are found at once."""
        assert self._balls is not None
        if not len(q):
            return
        lower, nearer = self._judged(self._balls.poses_of(self._kinematics.at(q)), q, np.full(len(q), time), least)
        doubtful = np.asarray((lower < least).any(axis=1))
        for row, is_doubtful in enumerate(doubtful.tolist()):
            if row in nearer:
                yield False
                continue
            if is_doubtful:
                pin.forwardKinematics(self._robot.model, self._data, q[row])
            yield not is_doubtful or self._keep(least, lower[row], self._data, time)

    def _judged(self, poses: Poses, q: Matrix | None, time: Vector, least: Vector) -> tuple[Matrix, set[int]]:
        """(N, K) lower bounds, and the configurations in which a piece is certainly nearer than `least` (K,) [m].

        The bounds of these configurations are infinite.
        """
        nearer: set[int] = set()
        lower = self._lower(
            poses, q, time, least, judged=lambda found: nearer.update(self._judge(found, least, poses))
        )  # fmt: skip
        return lower, nearer

    def _judge(self, lower: Matrix, least: Vector, poses: Poses) -> set[int]:
        """The configurations in which a piece is certainly nearer than `least` (K,) [m]; raises bounds (N, K)."""
        nearer: set[int] = set()
        for over, standing in ((self._over_ground, self._ground), (self._beside_solids, self._solids)):
            for index, pairs, cluster in standing:
                rows, those = _asked_of(lower < least, pairs)
                if over is None or not len(rows):
                    continue
                pieces, enough = self._column.take(those), least.take(those)
                verdict = over.keep(cluster, poses, rows, pieces, enough, self._grid(index))
                kept = verdict == KEPT
                lower[rows[kept], those[kept]] = enough[kept]
                found = rows[verdict == NEARER].tolist()
                lower[found] = np.inf
                nearer.update(found)
        return nearer

    def _keep(self, least: Vector, lower: Vector, data: pin.Data, time: float) -> bool:
        """Whether all distances, known to be at least `lower`, are at least `least` (K,) where the joints are."""
        doubtful = np.flatnonzero(lower < least)
        order = doubtful[np.argsort((lower - least)[doubtful], kind="stable")]
        return all(self.is_at_least(pair, data, time, float(least[pair])) for pair in order.tolist())

    def is_at_least(self, pair: int, data: pin.Data, time: float, least: float) -> bool:
        """Whether the distance of a pair is at least `least` [m]."""
        found = self.measure(pair, data, time, least)
        return found is None or found.distance >= least

    def _shift(self, index: int, time: float) -> Vector | None:
        """(3,) how far an obstacle has moved [m]; None if it does not move."""
        if index not in self._moving:
            return None
        return offset_at(self._obstacles[index], time)

    def _shifts(self, index: int, time: Vector) -> Matrix | None:
        """(3, N) the same at N times."""
        if index not in self._moving:
            return None
        return np.array([offset_at(self._obstacles[index], moment) for moment in time.tolist()]).T

    def _grid(self, index: int) -> Distances:
        if index not in self._grids:
            cluster = self._obstacles[index].cluster
            assert cluster is not None
            self._grids[index] = cluster.grid(*self._reach)
        return self._grids[index]


def _asked_of(asked: Flags, pairs: Indices) -> tuple[Indices, Indices]:
    """The configurations and pairs (M,) that are `asked` (N, K), of some pairs."""
    rows, which = asked[:, pairs].nonzero()
    return rows, pairs.take(which)


@lru_cache(maxsize=8)
def _balls_around(robot: Robot, pieces: tuple[int, ...]) -> LinkBalls:
    """Balls that cover some of the robot's pieces; computed once for a machine and its obstacles' links."""
    return LinkBalls([robot.pieces[row] for row in pieces], most=_MOST_BALLS)
