"""Whether the configurations of a path are connected, by dense samples: does a path without a plan have a solution?

At closely spaced places along the path, enough configurations are drawn to cover the joints' freedom there. Two are
neighbours if no joint differs much between them, at one place or at successive places. Nothing of the planner's search
is used. A solution that is missed would have to pass through a gap in the samples.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch
from backhoe_planner.motion import TipPath, build_problem
from backhoe_planner.site import ClearanceScreen

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SPACING = 0.02  # m of path between places
_DRAWN = 5000  # configurations at each place
_WANDER = 0.15  # rad or m by which as many more are moved, to fill the gaps
_NEAR = 0.15  # rad or m between neighbours at one place; a third more between two places
_THINNED = 0.4  # part of `_NEAR`; nearer ones count as one


class DenseLayers:
    """Configurations at places along the path of a scene.

    Parameters
    ----------
    drawn: configurations drawn at each place.
    seed: of the draws.
    """

    def __init__(self, robot: bp.Robot, scene: bp.Scene, *, drawn: int = _DRAWN, seed: int = 0) -> None:
        problem = build_problem(robot, scene)
        assert problem.path is not None
        self._robot, self._path = robot, problem.path
        self._kinematics = BatchKinematics(robot)
        self._screen = ClearanceScreen(bp.Proximity(robot, problem.obstacles))
        self._rng = np.random.default_rng(seed)
        places = np.linspace(0.0, problem.path.length, int(np.ceil(problem.path.length / _SPACING)) + 1)
        self.layers: list[Matrix] = []
        for place in places.tolist():
            before = self.layers[-1] if self.layers else np.zeros((0, robot.n))
            self.layers.append(self._at(self._path, place, before, drawn))

    @property
    def hang_together(self) -> bool:
        """Whether steps from neighbour to neighbour lead from the first place to the last."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        firsts = np.cumsum([0, *(len(nodes) for nodes in self.layers)])
        rows, columns = [], []
        for one, other, near in (
            *((row, row, _NEAR) for row in range(len(self.layers))),
            *((row, after, 4.0 / 3.0 * _NEAR) for row, after in pairwise(range(len(self.layers)))),
        ):
            if len(self.layers[one]) and len(self.layers[other]):
                pairs = self._tree(self.layers[one]).sparse_distance_matrix(
                    self._tree(self.layers[other]), near, p=np.inf, output_type="ndarray"
                )
                rows.append(pairs["i"] + firsts[one])
                columns.append(pairs["j"] + firsts[other])
        if not rows:
            return False
        row, column = np.concatenate(rows), np.concatenate(columns)
        graph = coo_matrix((np.ones(len(row)), (row, column)), shape=(firsts[-1], firsts[-1]))
        part = connected_components(graph, directed=False)[1]
        return bool(np.isin(part[: firsts[1]], part[firsts[-2] :]).any())

    def _at(self, path: TipPath, place: float, before: Matrix, drawn: int) -> Matrix:
        """(N, n) clear configurations with the tip on the path, from random ones and from those `before`."""
        random = np.array([self._robot.random_q(self._rng) for _ in range(drawn)])
        found = self._solve(path, place, np.vstack((before, random)))
        if len(found):
            wandered = found[self._rng.integers(0, len(found), drawn)]
            wandered = wandered + self._rng.normal(0.0, _WANDER, wandered.shape)
            found = np.vstack((found, self._solve(path, place, wandered)))
        return self._thinned(self._robot.reduce_unchecked(found))

    def _solve(self, path: TipPath, place: float, guesses: Matrix) -> Matrix:
        targets = TargetBatch.of([path.target(place)]).take(np.zeros(len(guesses), dtype=int))
        q, reached = solve_batch(self._kinematics, targets, guesses)
        q = q[reached]
        return q[self._screen.keeps(q)] if len(q) else q

    def _thinned(self, q: Matrix) -> Matrix:
        if len(q) < 2:
            return q
        near = self._tree(q).query_ball_point(self._tree(q).data, _THINNED * _NEAR, p=np.inf)
        kept = np.ones(len(q), dtype=bool)
        for row, others in enumerate(near):
            if kept[row]:
                kept[[other for other in others if other > row]] = False
        return q[kept]

    def _tree(self, q: Matrix) -> cKDTree:
        from scipy.spatial import cKDTree

        turns = self._robot.continuous
        box = np.where(turns, 2.0 * np.pi, 0.0)
        return cKDTree(np.where(turns, np.mod(q, 2.0 * np.pi) % (2.0 * np.pi), q), boxsize=box if turns.any() else None)
