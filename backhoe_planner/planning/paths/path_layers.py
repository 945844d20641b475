"""The configurations that put the tip on a path, layer by layer.

The degrees of freedom that the path leaves to the joints are its redundancy, r = n - m. With
r = 1 the free parameter is on a grid: the pitch, if the machine has one and the path leaves
it free, otherwise the length along the curves of self-motion. With larger r the nodes are the
configurations nearest to a fixed set of quasi-random ones, the same set at every sample of
the path, so that neighbouring layers have neighbouring nodes. With r = 0 the nodes are the
branches of the inverse kinematics.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot, TargetBatch, TipTarget, solve_batch
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.planning.stretches.kept_cones import KeptCones

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Mask = NDArray[np.bool_]

_SAME = 0.01  # rad or m; chosen: solutions nearer than this count as one
_BRANCHES = 8  # guesses per value of the pitch in a search for branches; chosen
_SEED_EVERY = 0.4  # m of path from one search for branches to the next; chosen: between them, nodes are carried on
_CONE_PART = 0.25  # part of the half-angle of a cone that the grid has for a step at most; chosen
_SAMPLES = 256  # configurations per layer if the redundancy has several dimensions; chosen
_RANK = 1e-6  # singular values of a Jacobian [1, m] below this count as 0; chosen far above rounding
_FOLLOWED = 0.2  # rad or m; chosen: a node with another this near in the next layer counts as continued there
_FOLLOWED_STEPS = 1.2  # grid steps: the same on curves of self-motion; chosen: just above the distance of two nodes
_FOLLOWED_PART = 0.5  # part of the longest step, if steps are bounded: an upper bound for the same; chosen
_CARRIED = 0.6  # rad or m that a node may move when it is carried to the next layer; chosen: three times `_FOLLOWED`
_MOST = 500  # nodes of a layer, above which none are carried to it; chosen: twice `_SAMPLES`; steps grow as the square
_MOST_PACKED = 2**62  # different values of one integer: fewer than it has
_MANY_CLOSE = 300  # pairs for each configuration; chosen: a tree takes as long
_ROUNDING = 1e-9  # part of a distance
_SPREADS = (0.1, 0.3, 0.8)  # rad or m around a given start; chosen: near, further and far
_AROUND = 16  # guesses for each of `_SPREADS`; chosen
_ROOT_ROUNDS = 60  # iterations: each more than halves the error of the root of g^(n + 1) = g + 1
_PORTION = 1000  # configurations that are solved between two checks of the brake; chosen
_CURVE_GUESSES = 64  # for the search for branches or curves of self-motion; chosen
_CURVE_ROUNDS = 2  # of tracing: the second begins at the solutions that the first has not passed
_CURVE_FIRST = 12  # solutions traced in the first round at each station; chosen: there are some eight curves
_COARSER = 1.3  # times the distance of nodes if there are too many; chosen
_LONGEST_CURVE = 100  # grid steps in each direction; chosen: more than a turn at 5 degrees


class PathLayers:
    """Finds the nodes of the layers for one machine.

    Parameters
    ----------
    grid: step of the free parameter, if there is one [rad; m for a slide].
    longest: how far a joint may move from one waypoint to the next [rad or m]; by default freely.
    cones: within which targets without an orientation are kept; by default none.
    brake: checked between portions of the work; by default none.
    """

    def __init__(
        self, robot: Robot, *, grid: float, longest: float = np.inf, cones: KeptCones | None = None,
        brake: Brake | None = None,
    ) -> None:  # fmt: skip
        self._robot = robot
        self._kinematics = BatchKinematics(robot)
        self._cones = cones
        self._grid = grid if cones is None else min(grid, _CONE_PART * float(np.min(cones.tolerances)))
        self._followed = min(_FOLLOWED, _FOLLOWED_PART * longest)
        self._brake = brake or Brake()
        lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
        upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
        self._box = (lower, upper)

    def at(self, stations: Vector, targets: Sequence[TipTarget], *, begin: Vector | None = None) -> list[Matrix]:
        """(N_l, n) solutions within the limits for each of L targets at `stations` (L,) of a path [m].

        Parameters
        ----------
        begin: (n,) a solution for the first target; others are searched around it, and carried on from there.
        """
        if not len(targets):
            return []
        batch = self._batch(targets)
        free = freest(self._robot, targets)
        redundancy = redundancy_of(self._robot, free)
        on_grid = redundancy == 0 or (redundancy == 1 and self._cones is None and _pitch_is_free(self._robot, free))
        if self._cones is not None and redundancy >= 1:
            found = self._in_cone(batch)
        elif redundancy >= 2:
            found = self._on_samples(batch)
        elif not on_grid:
            found = self._on_curves(stations, batch)
        else:
            found = self._on_grid(stations, batch, pitch=redundancy == 1)
        self._brake.check()
        if begin is not None:
            found[0] = self._distinct(np.vstack((begin[None, :], self._around(batch, begin), found[0])))
        # two curves may be as near to each other as the nodes on each
        followed = (
            min(self._followed, _FOLLOWED_STEPS * self._grid) if redundancy == 1 and not on_grid else self._followed
        )
        self._carry(batch, found, range(1, len(found)), -1, followed)
        self._carry(batch, found, range(len(found) - 2, -1, -1), 1, followed)
        return [nodes if len(nodes) <= _MOST or on_grid else self._few(nodes) for nodes in found]

    def between(self, targets: Sequence[TipTarget], near: Matrix) -> list[Matrix]:
        """(N_l, n) solutions within the limits for each of L targets, each near one of `near` (N, n)."""
        batch = self._batch(targets)
        rows = np.repeat(np.arange(len(targets)), len(near))
        q, reached = self._solve_all(batch.take(rows), np.tile(near, (len(targets), 1)))
        return [self._few(q[reached & (rows == row)]) for row in range(len(targets))]

    def at_any_angle(self, target: TipTarget) -> Matrix:
        """(N, n) solutions within the limits for one target, outside the cones too."""
        guesses = _spread(self._box, _SAMPLES)
        q, reached = self._solve_all(TargetBatch.of([target] * len(guesses)), guesses)
        return q[reached]

    def _batch(self, targets: Sequence[TipTarget]) -> TargetBatch:
        """The targets as one batch, within the cones if there are any."""
        batch = TargetBatch.of(targets)
        return batch if self._cones is None else self._cones.narrowed(batch)

    def _around(self, batch: TargetBatch, begin: Vector) -> Matrix:
        """(N, n) solutions for the first target near and far from `begin` (n,)."""
        rng = np.random.default_rng(0)
        spread = np.repeat(_SPREADS, _AROUND)[:, None]
        guesses = begin + spread * rng.standard_normal((len(spread), self._robot.n))
        q, reached = solve_batch(self._kinematics, batch.take(np.zeros(len(guesses), dtype=int)), guesses)
        return q[reached]

    def _carry(
        self, batch: TargetBatch, found: list[Matrix], rows: Iterable[int], back: int, followed: float
    ) -> None:  # fmt: skip
        """Carry every node on to the next layer, unless a node is near it there.

        So a branch that is found anywhere is followed as far as it goes.

        Parameters
        ----------
        rows: layers to carry to, in order; `back`: offset from each of them to the layer it is carried from.
        followed: a configuration nearer than this to a node counts as the same [rad or m].
        """
        for row in rows:
            self._brake.check()
            before, here = found[row + back], found[row]
            if not len(before) or len(here) >= _MOST:
                continue
            alone = self._away(before, here, followed)
            if not alone.any():
                continue
            targets = batch.take(np.full(int(alone.sum()), row))
            q, reached = solve_batch(self._kinematics, targets, before[alone], iterations=10)
            near = np.max(np.abs(q - before[alone]), axis=1) < _CARRIED
            carried = q[reached & near]
            if followed < self._followed:
                carried = carried[self._away(carried, here, 0.5 * self._grid)]
            found[row] = self._distinct(np.vstack((here, carried)))

    # --- one parameter, or none --------------------------------------------------

    def _on_grid(self, stations: Vector, batch: TargetBatch, *, pitch: bool) -> list[Matrix]:
        seeds = _seeds(stations)
        found = dict(zip(seeds.tolist(), self._branches(batch, seeds, pitch=pitch), strict=True))
        rows, guesses, values = [], [], []
        for row in range(len(stations)):
            if row in found:
                continue
            near = np.vstack([found[int(seed)] for seed in _beside(seeds, row)])
            value = self._value_beside(batch, row, near, pitch=pitch)
            rows.append(np.full(len(value), row))
            guesses.append(near[: len(value)])
            values.append(value)
        if rows:
            between = self._solve(batch, np.concatenate(rows), np.vstack(guesses), np.concatenate(values), pitch)
            found |= between
        empty = np.zeros((0, self._robot.n))
        return [found.get(row, empty) for row in range(len(stations))]

    def _branches(self, batch: TargetBatch, seeds: NDArray[np.intp], *, pitch: bool) -> list[Matrix]:
        """All solutions at some stations, over the whole grid."""
        guesses = _spread(self._box, _BRANCHES if pitch else _CURVE_GUESSES)
        rows, values = [], []
        for row in seeds.tolist():
            value = self._values(batch, row, pitch=pitch)
            values.append(np.repeat(value, len(guesses)))
            rows.append(np.full(len(value) * len(guesses), row))
        row, value = np.concatenate(rows), np.concatenate(values)
        found = self._solve(batch, row, np.tile(guesses, (len(row) // len(guesses), 1)), value, pitch)
        return [found.get(row, np.zeros((0, self._robot.n))) for row in seeds.tolist()]

    def _value_beside(self, batch: TargetBatch, row: int, near: Matrix, *, pitch: bool) -> Vector:
        """(N,) for each node of `near`, the grid value of the free parameter at a station nearest to its own."""
        if not pitch:
            return np.zeros(len(near))
        values = self._values(batch, row, pitch=True)
        if not len(values):
            return values
        own = self._kinematics.at(near).pitch()
        off = np.abs((own[:, None] - values[None, :] + np.pi) % (2.0 * np.pi) - np.pi)
        return np.asarray(values[np.argmin(off, axis=1)])

    def _values(self, batch: TargetBatch, row: int, *, pitch: bool) -> Vector:
        """The grid of the pitch at one station [rad]; a single 0 if the pitch is not the free parameter."""
        if not pitch:
            return np.zeros(1)
        count = int(np.ceil(2.0 * np.pi / self._grid))
        values = -np.pi + 2.0 * np.pi * np.arange(count) / count
        if not batch.has_pitch[row]:
            return values
        middle, half = float(batch.pitch_middle[row]), float(batch.pitch_half[row])
        if half >= np.pi:
            return values
        off = (values - middle + np.pi) % (2.0 * np.pi) - np.pi
        inside = middle + off[np.abs(off) < half - 1e-9]
        return np.unique(np.concatenate(([middle - half], np.sort(inside), [middle + half])))

    def _solve(
        self, batch: TargetBatch, rows: NDArray[np.intp], guesses: Matrix, values: Vector, pitch: bool
    ) -> dict[int, Matrix]:
        """By row: (N, n) the solutions at the stations `rows` (B,) with `values` (B,) of the free parameter."""
        targets = batch.take(rows)
        if pitch:
            targets = targets.at_pitch(values)
        q, reached = self._solve_all(targets, guesses)
        q, rows = q[reached], rows[reached]
        return {row: self._distinct(q[rows == row]) for row in np.unique(rows).tolist()}

    # --- one parameter, along the curves of self-motion ---------------------------------

    def _on_curves(self, stations: Vector, batch: TargetBatch) -> list[Matrix]:
        """Nodes a grid step apart on every curve that is found, carried on from station to station."""
        seeds = _seeds(stations)
        rows = np.repeat(seeds, _CURVE_GUESSES)
        # other guesses at every seed: a curve missed at one is found at another, and carried on
        guesses = np.vstack([_spread(self._box, _CURVE_GUESSES, seed) for seed in range(len(seeds))])
        q, reached = self._solve_all(batch.take(rows), guesses)
        q, rows = q[reached], rows[reached]
        found = [np.zeros((0, self._robot.n))] * len(stations)
        for number in range(_CURVE_ROUNDS):
            # a solution on a curve that was traced already is not needed
            use = np.zeros(len(q), dtype=bool)
            for row in seeds.tolist():
                own = np.flatnonzero(rows == row)
                own = own if number else own[:_CURVE_FIRST]
                use[own] = self._away(q[own], found[row], self._grid)
            traces = [(q[use], rows[use]), self._trace(batch, rows[use], q[use])]
            all_q, all_rows = np.vstack([q for q, _ in traces]), np.concatenate([rows for _, rows in traces])
            for row in seeds.tolist():
                found[row] = self._few(np.vstack((found[row], all_q[all_rows == row])))
        between = np.setdiff1d(np.arange(len(stations)), seeds)
        if len(between):
            beside = [(row, found[int(seeds[np.argmin(np.abs(seeds - row))])]) for row in between.tolist()]
            rows = np.concatenate([np.full(len(nodes), row) for row, nodes in beside])
            q, reached = self._solve_all(batch.take(rows), np.vstack([nodes for _, nodes in beside]))
            for row in between.tolist():
                found[row] = self._few(q[reached & (rows == row)])
        return found

    def _trace(self, batch: TargetBatch, rows: NDArray[np.intp], q: Matrix) -> tuple[Matrix, NDArray[np.intp]]:
        """(N, n) nodes along the null space from `q` (B, n), in one direction, then the other; and (N,) their rows."""
        # both directions at once: numpy takes little longer for twice as many
        sense, rows, q = np.repeat((1.0, -1.0), len(q)), np.tile(rows, 2), np.tile(q, (2, 1))
        found, found_rows, found_sense = [q[:0]], [rows[:0]], [sense[:0]]
        begin, step = q.copy(), np.zeros_like(q)
        for number in range(_LONGEST_CURVE):
            if not len(q):
                break
            self._brake.check()
            targets = batch.take(rows)
            null = np.linalg.svd(targets.jacobians(self._kinematics.at(q)))[2][:, -1, :]
            null /= np.max(np.abs(null), axis=1, keepdims=True)
            # continue in the same direction; the first step is that in which the largest component grows
            ahead = (
                np.einsum("bn,bn->b", null, step)
                if number
                else null[np.arange(len(q)), np.argmax(np.abs(null), axis=1)]
            )
            onward = np.where(ahead < 0.0, -1.0, 1.0) * (1.0 if number else sense)
            step = self._grid * onward[:, None] * null
            after, reached = solve_batch(self._kinematics, targets, q + step, iterations=8)
            moved = np.max(np.abs(after - q), axis=1)
            closed = (number > 2) & (
                np.max(np.abs(self._robot.reduce_unchecked(after - begin)), axis=1) < 0.7 * self._grid
            )
            on = reached & (moved > 0.3 * self._grid) & (moved < 3.0 * self._grid) & ~closed
            q, rows, sense, begin, step = after[on], rows[on], sense[on], begin[on], step[on]
            found.append(q)
            found_rows.append(rows)
            found_sense.append(sense)
        order = np.argsort(-np.concatenate(found_sense), kind="stable")
        return np.vstack(found)[order], np.concatenate(found_rows)[order]

    # --- several parameters ---------------------------------------------------------

    def _on_samples(self, batch: TargetBatch) -> list[Matrix]:
        guesses = _spread(self._box, _SAMPLES)
        rows = np.repeat(np.arange(len(batch)), len(guesses))
        q, reached = self._solve_all(batch.take(rows), np.tile(guesses, (len(batch), 1)))
        q, reached = q.reshape(len(batch), len(guesses), -1), reached.reshape(len(batch), len(guesses))
        return [self._distinct(q[row][reached[row]]) for row in range(len(batch))]

    def _in_cone(self, batch: TargetBatch) -> list[Matrix]:
        """The same within a cone: each sample is searched in a smaller one, so that the nodes are spread over it.

        A smaller one may be out of reach; the whole one is searched then.
        """
        guesses = _spread(self._box, _SAMPLES)
        rows = np.repeat(np.arange(len(batch)), len(guesses))
        targets = batch.take(rows)
        parts = np.tile(_evenly(len(guesses)), len(batch))
        q, reached = self._solve_all(targets.with_smaller_cones(parts), np.tile(guesses, (len(batch), 1)))
        missed = np.flatnonzero(~reached)
        q[missed], reached[missed] = self._solve_all(targets.take(missed), q[missed])
        return [self._distinct(q[reached & (rows == row)], within=min(_SAME, self._grid)) for row in range(len(batch))]

    def _solve_all(self, targets: TargetBatch, guesses: Matrix) -> tuple[Matrix, Mask]:
        """`solve_batch` in portions, between which the brake is checked; nothing is solved for no guesses."""
        ends, reached = [guesses[:0]], [np.zeros(0, dtype=bool)]
        for first in range(0, len(guesses), _PORTION):
            self._brake.check()
            rows = np.arange(first, min(first + _PORTION, len(guesses)))
            q, arrived = solve_batch(self._kinematics, targets.take(rows), guesses[rows])
            ends.append(q)
            reached.append(arrived)
        return np.vstack(ends), np.concatenate(reached)

    # --- equal nodes --------------------------------------------------------------------

    def _distinct(self, q: Matrix, *, within: float = _SAME) -> Matrix:
        """`q` (N, n) without those `within` [rad or m] of an earlier one, sorted by the first joints.

        Continuous joints are returned within half a turn of 0.
        """
        q = self._robot.reduce_unchecked(q)
        if len(q) < 2:
            return q
        q = q[_first_rows(np.round(q / within).astype(np.int64))]
        repeated = np.zeros(len(q), dtype=bool)
        repeated[self._close_pairs(q, within)[:, 1]] = True
        q = q[~repeated]
        return np.asarray(q[np.lexsort(q.T[::-1])])

    def _few(self, q: Matrix) -> Matrix:
        """`q` (N, n) without those within half a grid step of one that is kept; within more if there are too many."""
        within = 0.5 * self._grid
        found = self._apart(self._distinct(q), within)
        while len(found) > _MOST:
            within *= _COARSER
            found = self._apart(found, within)
        return found

    def _apart(self, q: Matrix, within: float) -> Matrix:
        """Those of `q` (N, n) that are further than `within` [rad or m] from all kept before them, in order."""
        if len(q) < 2:
            return q
        pairs = self._close_pairs(q, within)
        pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
        kept = [True] * len(q)
        for row, beside in pairs.tolist():  # a pair's first row is before its second
            if kept[row]:
                kept[beside] = False
        return np.asarray(q[np.array(kept)])

    def _away(self, q: Matrix, others: Matrix, far: float) -> Mask:
        """(N,) whether each of `q` (N, n) is further than `far` [rad or m] from all `others` (M, n)."""
        if not len(q) or not len(others):
            return np.ones(len(q), dtype=bool)
        return np.asarray(self._tree(others).query(self._in_box(q), p=np.inf)[0] > far)

    def _close_pairs(self, q: Matrix, within: float) -> Indices:
        """(K, 2) the rows of `q` (N, n), the earlier one first, that are `within` [rad or m] of each other.

        They are found along the limited joint with the widest range, which takes a fifth of the time of a tree that is
        periodic. If too many are near each other along it, or no joint is limited, a tree finds them.
        """
        q, continuous = self._in_box(q), self._robot.continuous
        range_ = np.where(continuous, 0.0, np.ptp(q, axis=0))
        joint = int(np.argmax(range_))
        order = np.argsort(q[:, joint], kind="stable")
        along = q[order, joint]
        ahead = np.searchsorted(along, along + (1.0 + _ROUNDING) * within, side="right") - np.arange(1, len(q) + 1)
        if range_[joint] == 0.0 or np.sum(ahead) > _MANY_CLOSE * len(q):
            return np.asarray(self._tree(q).query_pairs(within, p=np.inf, output_type="ndarray"))
        begins = np.cumsum(ahead) - ahead
        rows = np.repeat(np.arange(len(q)), ahead)
        first, second = order[rows], order[rows + 1 + np.arange(len(rows)) - np.repeat(begins, ahead)]
        for other in np.argsort(-np.ptp(q, axis=0), kind="stable").tolist():
            apart = np.abs(q[first, other] - q[second, other])
            if continuous[other]:
                apart = np.where(apart > np.pi, np.abs(apart - 2.0 * np.pi), apart)
            near = np.flatnonzero(apart <= within)
            first, second = first[near], second[near]
        return np.column_stack((np.minimum(first, second), np.maximum(first, second)))

    def _tree(self, q: Matrix) -> cKDTree:
        """The tree of `q` (N, n), periodic in continuous joints; queried with `_in_box`."""
        from scipy.spatial import cKDTree

        continuous = self._robot.continuous
        return cKDTree(self._in_box(q), boxsize=2.0 * np.pi * continuous if continuous.any() else None)

    def _in_box(self, q: Matrix) -> Matrix:
        """(N, n) `q`, with continuous joints from 0 to less than a turn."""
        continuous = self._robot.continuous
        if not continuous.any():
            return q
        q = q.copy()
        turned = np.mod(q[:, continuous], 2.0 * np.pi)
        q[:, continuous] = np.where(turned < 2.0 * np.pi, turned, 0.0)  # rounding
        return q


def _first_rows(cells: Indices) -> Indices:
    """(K,) the first of equal rows of `cells` (N, n), in order.

    The columns are packed into few integers, because numpy takes ten times as long to sort rows.
    """
    cells = cells - np.min(cells, axis=0)
    keys, size = [np.zeros(len(cells), dtype=np.int64)], 1
    for column, count in zip(cells.T, (np.max(cells, axis=0) + 1).tolist(), strict=True):
        size *= count
        if size > _MOST_PACKED:
            keys, size = [*keys, column], count
        else:
            keys[-1] = keys[-1] * count + column
    order = np.lexsort(keys)  # stable, so that the first of equal rows stays in front
    differs = np.any([np.diff(key[order], prepend=-1) != 0 for key in keys], axis=0)
    return np.sort(order[differs])


def freest(robot: Robot, targets: Sequence[TipTarget]) -> TipTarget:
    """The first target along a path that leaves the joints most freedom: one with a free pitch, if there is one."""
    return next((target for target in targets if _pitch_is_free(robot, target)), targets[0])


def _pitch_is_free(robot: Robot, target: TipTarget) -> bool:
    is_given = target.pitch is not None and target.pitch[1] <= target.pitch[0]
    return robot.has_pitch and target.rotation is None and not is_given


def redundancy_of(robot: Robot, target: TipTarget) -> int:
    """The number of dimensions that a target leaves to the joints: n minus the rank of the task.

    A range of pitch does not count as a task.
    """
    rng = np.random.default_rng(0)
    q = np.array([robot.random_q(rng) for _ in range(8)])
    open_range = target.pitch is not None and target.rotation is None and target.pitch[1] > target.pitch[0]
    asked = TipTarget(target.position, None if open_range else target.pitch, target.rotation)
    J = TargetBatch.of([asked] * len(q)).jacobians(BatchKinematics(robot).at(q))
    return robot.n - int(np.max(np.linalg.matrix_rank(J, tol=_RANK)))


def _spread(box: tuple[Vector, Vector], count: int, seed: int = 0) -> Matrix:
    """(count, n) quasi-random configurations in `box`, always the same for one `seed`.

    The additive sequence of M. Roberts (2018): steps of 1/g, 1/g^2, ..., modulo 1, with g the root of
    g^(n + 1) = g + 1. Sobol's sequence is in scipy.stats, but loading that takes half as long as planning a path.
    """
    n = len(box[0])
    root = 2.0
    for _ in range(_ROOT_ROUNDS):
        root = (1.0 + root) ** (1.0 / (n + 1))
    begin = np.random.default_rng(seed).random(n)
    points = np.mod(begin + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, n + 1.0), 1.0)
    return np.asarray(box[0] + points * (box[1] - box[0]))


def _evenly(count: int) -> Vector:
    """(count,) parts of 1, spread evenly however many of them are used: the same sequence in one dimension."""
    return np.asarray(_spread((np.zeros(1), np.ones(1)), count)[:, 0])


def _seeds(stations: Vector) -> NDArray[np.intp]:
    """Indices of the stations at which all solutions are searched: the first, the last, and some between."""
    cells = np.floor((stations - stations[0]) / _SEED_EVERY)
    return np.unique(np.append(np.flatnonzero(np.diff(cells, prepend=-1.0)), len(stations) - 1))


def _beside(seeds: NDArray[np.intp], row: int) -> NDArray[np.intp]:
    """The seeds before and after a station that is not a seed."""
    after = int(np.searchsorted(seeds, row))
    return seeds[after - 1 : after + 1]
