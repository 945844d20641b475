"""The configurations that put the tip on a bucket path, layer by layer.

What the path leaves free of the joints is its redundancy, r = n - m. With r = 1 the one
free parameter is laid out on a grid: the pitch, where the machine has one and the path
leaves it free, else the joint that moves most in the null space. With more the
configurations nearest to a fixed set of quasi-random ones (Sobol) are taken, the same
set at every sample of the path, so that neighbouring layers hold neighbouring nodes.
With none there are the branches of the inverse kinematics.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import qmc

from backhoe_planner.machine.batch_inverse_kinematics import TargetBatch, solve_batch
from backhoe_planner.machine.batch_kinematics import BatchKinematics
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.target import TipTarget
from backhoe_planner.planning.deadline import check_deadline

__all__ = ["PathLayers", "redundancy_of"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SAME = 0.01  # rad or m: solutions nearer than this are one
_BRANCHES = 8  # guesses per grid value where branches are looked for
_SEED_EVERY = 0.4  # m of path from one search for branches to the next
_SAMPLES = 256  # of the redundancy, where it has several dimensions
_RANK = 1e-6
_FOLLOWED = 0.2  # rad or m: a node with another this near in the next layer is followed there
_CARRIED = 0.6  # rad or m that a node may move when it is carried to the next layer
_MOST = 500  # nodes in a layer to which no more are added
_SPREADS = (0.1, 0.3, 0.8)  # rad or m around a given beginning
_PORTION = 4000  # configurations that are solved for at once
_AROUND = 16  # guesses for each


class PathLayers:
    """Finds the nodes of the layers for one machine.

    Parameters
    ----------
    grid: step of the free parameter, where there is one [rad, or 1/50 of a slide's range].
    samples: configurations per layer where the redundancy has several dimensions.
    deadline: on `time.monotonic`.
    """

    def __init__(self, robot: Robot, *, grid: float, samples: int = _SAMPLES, deadline: float = np.inf) -> None:
        self._robot = robot
        self._kinematics = BatchKinematics(robot)
        self._grid = grid
        self._samples = samples
        self._deadline = deadline
        lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
        upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
        self._box = (lower, upper)

    def at(self, stations: Vector, targets: Sequence[TipTarget], *, begin: Vector | None = None) -> list[Matrix]:
        """(N_l, n) solutions for each of L targets at `stations` (L,) of a path, within the limits.

        Parameters
        ----------
        begin: (n,) a solution for the first target, around which and from which on more are looked for.
        """
        if not len(targets):
            return []
        batch = TargetBatch.of(targets)
        redundancy = redundancy_of(self._robot, targets[0])
        if redundancy >= 2:
            found = self._sampled(batch)
            free = np.ones(self._robot.n, dtype=bool)
        else:
            pitch = redundancy == 1 and self._pitch_is_free(targets)
            joint = self._freest_joint(targets) if redundancy == 1 and not pitch else None
            found = self._on_grid(stations, batch, pitch=pitch, joint=joint)
            free = np.arange(self._robot.n) != (-1 if joint is None else joint)
        check_deadline(self._deadline)
        if begin is not None:
            found[0] = _distinct(np.vstack((begin[None, :], self._around(batch, begin), found[0])))
        self._carry(batch, found, range(1, len(found)), -1, free)
        self._carry(batch, found, range(len(found) - 2, -1, -1), 1, free)
        return found

    def _around(self, batch: TargetBatch, begin: Vector) -> Matrix:
        """(N, n) solutions for the first target near and far from `begin` (n,)."""
        rng = np.random.default_rng(0)
        spread = np.repeat(_SPREADS, _AROUND)[:, None]
        guesses = begin + spread * rng.standard_normal((len(spread), self._robot.n))
        q, reached = solve_batch(self._kinematics, batch.take(np.zeros(len(guesses), dtype=int)), guesses)
        return q[reached]

    def _carry(self, batch: TargetBatch, found: list[Matrix], rows: Iterable[int], back: int, free: Mask) -> None:
        """Carry every node on to the next layer, where no node is near it already.

        So a branch that was found anywhere is followed as far as it goes.
        """
        for row in rows:
            check_deadline(self._deadline)
            before, here = found[row + back], found[row]
            if not len(before) or len(here) >= _MOST:
                continue
            alone = np.ones(len(before), dtype=bool)
            if len(here):
                alone = cKDTree(here).query(before, p=np.inf)[0] > _FOLLOWED
            if not alone.any():
                continue
            targets = batch.take(np.full(int(alone.sum()), row))
            held = None if free.all() else ~free
            q, reached = solve_batch(self._kinematics, targets, before[alone], held=held, iterations=10)
            if held is not None and not reached.all():
                # where the held joint stands in the way all of them may move
                missed = np.flatnonzero(~reached)
                again, found_again = solve_batch(
                    self._kinematics, targets.take(missed), before[alone][missed], iterations=10
                )
                q[missed], reached[missed] = again, found_again
            near = np.max(np.abs(q - before[alone]), axis=1) < _CARRIED
            found[row] = _distinct(np.vstack((here, q[reached & near])))

    def _pitch_is_free(self, targets: Sequence[TipTarget]) -> bool:
        return self._robot.has_pitch and all(target.rotation is None for target in targets)

    # --- one parameter, or none --------------------------------------------------

    def _on_grid(self, stations: Vector, batch: TargetBatch, *, pitch: bool, joint: int | None = None) -> list[Matrix]:
        cells = np.floor(stations / _SEED_EVERY)
        seeds = np.unique(np.append(np.flatnonzero(np.diff(cells, prepend=-1.0)), len(stations) - 1))
        found = dict(zip(seeds.tolist(), self._branches(batch, seeds, pitch=pitch, joint=joint), strict=True))
        rows, guesses, values = [], [], []
        for row in range(len(stations)):
            if row in found:
                continue
            after = int(np.searchsorted(seeds, row))
            near = np.vstack([found[int(seeds[k])] for k in (after - 1, after)])
            value = self._value_beside(batch, row, near, pitch=pitch, joint=joint)
            rows.append(np.full(len(value), row))
            guesses.append(near[: len(value)])
            values.append(value)
        if rows:
            between = self._solve(batch, np.concatenate(rows), np.vstack(guesses), np.concatenate(values), pitch, joint)
            found |= between
        empty = np.zeros((0, self._robot.n))
        return [found.get(row, empty) for row in range(len(stations))]

    def _branches(self, batch: TargetBatch, seeds: NDArray[np.intp], *, pitch: bool, joint: int | None) -> list[Matrix]:
        """All solutions at some stations, over the whole grid."""
        guesses = _sobol(self._box, _BRANCHES)
        rows, values = [], []
        for row in seeds.tolist():
            value = self._values(batch, row, pitch=pitch, joint=joint)
            values.append(np.repeat(value, len(guesses)))
            rows.append(np.full(len(value) * len(guesses), row))
        row, value = np.concatenate(rows), np.concatenate(values)
        found = self._solve(batch, row, np.tile(guesses, (len(row) // len(guesses), 1)), value, pitch, joint)
        return [found.get(row, np.zeros((0, self._robot.n))) for row in seeds.tolist()]

    def _value_beside(self, batch: TargetBatch, row: int, near: Matrix, *, pitch: bool, joint: int | None) -> Vector:
        """(N,) the value of the free parameter at one station that each of the nodes `near` it belongs to."""
        if joint is not None:
            return near[:, joint]
        if not pitch:
            return np.zeros(len(near))
        values = self._values(batch, row, pitch=True, joint=None)
        if not len(values):
            return values
        own = self._kinematics.at(near).pitch()
        off = np.abs((own[:, None] - values[None, :] + np.pi) % (2.0 * np.pi) - np.pi)
        return np.asarray(values[np.argmin(off, axis=1)])

    def _values(self, batch: TargetBatch, row: int, *, pitch: bool, joint: int | None) -> Vector:
        """The grid of the free parameter at one station."""
        if joint is not None:
            low, high = self._box[0][joint], self._box[1][joint]
            step = (high - low) / 50.0 if self._robot.prismatic[joint] else self._grid
            return np.linspace(low, high, max(int(np.ceil((high - low) / step)) + 1, 2))
        if not pitch:
            return np.zeros(1)
        count = int(np.ceil(2.0 * np.pi / self._grid))
        values = -np.pi + 2.0 * np.pi * np.arange(count) / count
        if not batch.pitched[row]:
            return values
        middle, half = float(batch.pitch_middle[row]), float(batch.pitch_half[row])
        if half >= np.pi:
            return values
        off = (values - middle + np.pi) % (2.0 * np.pi) - np.pi
        inside = middle + off[np.abs(off) < half - 1e-9]
        return np.unique(np.concatenate(([middle - half], np.sort(inside), [middle + half])))

    def _solve(
        self,
        batch: TargetBatch,
        rows: NDArray[np.intp],
        guesses: Matrix,
        values: Vector,
        pitch: bool,
        joint: int | None,
    ) -> dict[int, Matrix]:
        """The solutions at the stations `rows` (B,) with their `values` (B,) of the free parameter."""
        targets = batch.take(rows)
        held = None
        if joint is not None:
            guesses = guesses.copy()
            guesses[:, joint] = values
            held = np.arange(self._robot.n) == joint
        elif pitch:
            targets = targets.at_pitch(values)
        q, reached = self._solve_all(targets, guesses, held)
        q, rows = q[reached], rows[reached]
        return {row: _distinct(q[rows == row]) for row in np.unique(rows).tolist()}

    def _freest_joint(self, targets: Sequence[TipTarget]) -> int:
        """The joint that moves most in the null space, over seeded postures."""
        rng = np.random.default_rng(0)
        q = np.array([self._robot.random_q(rng) for _ in range(64)])
        batch = TargetBatch.of([targets[0]] * len(q))
        J = batch.jacobians(self._kinematics.at(q))
        null = np.linalg.svd(J)[2][:, -1, :]
        return int(np.argmax(np.min(np.abs(null), axis=0) + np.mean(np.abs(null), axis=0)))

    # --- several parameters ---------------------------------------------------------

    def _sampled(self, batch: TargetBatch) -> list[Matrix]:
        guesses = _sobol(self._box, self._samples)
        rows = np.repeat(np.arange(len(batch)), len(guesses))
        q, reached = self._solve_all(batch.take(rows), np.tile(guesses, (len(batch), 1)), None)
        q, reached = q.reshape(len(batch), len(guesses), -1), reached.reshape(len(batch), len(guesses))
        return [_distinct(q[row][reached[row]]) for row in range(len(batch))]

    def _solve_all(self, targets: TargetBatch, guesses: Matrix, held: Mask | None) -> tuple[Matrix, Mask]:
        """`solve_batch` in portions, which can be ended by the deadline."""
        ends, reached = [], []
        for first in range(0, len(guesses), _PORTION):
            check_deadline(self._deadline)
            rows = np.arange(first, min(first + _PORTION, len(guesses)))
            q, arrived = solve_batch(self._kinematics, targets.take(rows), guesses[rows], held=held)
            ends.append(q)
            reached.append(arrived)
        return np.vstack(ends), np.concatenate(reached)


def redundancy_of(robot: Robot, target: TipTarget) -> int:
    """How many dimensions a target leaves to the joints: n minus the rank of the task.

    A pitch range that is open counts as no task.
    """
    rng = np.random.default_rng(0)
    q = np.array([robot.random_q(rng) for _ in range(8)])
    open_range = target.pitch is not None and target.rotation is None and target.pitch[1] > target.pitch[0]
    asked = TipTarget(target.position, None if open_range else target.pitch, target.rotation)
    J = TargetBatch.of([asked] * len(q)).jacobians(BatchKinematics(robot).at(q))
    return robot.n - int(np.max(np.linalg.matrix_rank(J, tol=_RANK)))


def _sobol(box: tuple[Vector, Vector], count: int) -> Matrix:
    """(count, n) quasi-random configurations, always the same."""
    points = qmc.Sobol(len(box[0]), scramble=True, seed=0).random_base2(int(np.ceil(np.log2(count))))
    return np.asarray(box[0] + points * (box[1] - box[0]))


def _distinct(q: Matrix) -> Matrix:
    """`q` (N, n) without those that another one is within `_SAME` of, in the order of the first joints."""
    if len(q) < 2:
        return q
    cells = np.round(q / _SAME).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    q = q[np.sort(first)]
    repeated = np.zeros(len(q), dtype=bool)
    pairs = cKDTree(q).query_pairs(_SAME, p=np.inf, output_type="ndarray")
    repeated[pairs[:, 1]] = True
    q = q[~repeated]
    return np.asarray(q[np.lexsort(q.T[::-1])])
