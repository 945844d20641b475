"""Distances between a machine's links and the clusters around it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Distances, Reading, Robot, reach_ball
from backhoe_planner.site.link_balls import LinkBalls
from backhoe_planner.site.obstacles import Obstacle, offset_at

EXACT_WITHIN = 0.5  # m: distances from clusters beyond it are lower bounds; chosen, about how far obstacles act
_FIRST_REACH = 0.25  # m beyond what is known already, within which a cluster is first looked for; chosen


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
        self._reach = reach_ball(robot)
        pieces, self._column = np.unique(self.piece, return_inverse=True)
        self._balls = LinkBalls(robot, pieces.tolist()) if pairs else None
        self._rows = [(index, np.flatnonzero(self.owner == index)) for index in np.unique(self.owner).tolist()]
        self._moving = {index for index, _ in self._rows if obstacles[index].moves}
        self._grids: dict[int, Distances] = {}
        self._kinematics = BatchKinematics(robot)
        self._data = robot.model.createData()

    def __len__(self) -> int:
        return len(self.owner)

    def lower(self, data: pin.Data, time: float) -> Vector:
        """(K,) lower bounds of the distances [m] where the joints of `data` are, or minus infinity."""
        assert self._balls is not None
        found = np.full(len(self), -np.inf)
        for rows, bounds in self.lower_of_balls(self._balls.at(data), time):
            found[rows] = bounds
        return found

    def lower_of_balls(self, centres: Array, time: float) -> Iterator[tuple[Indices, Array]]:
        """For each cluster its pairs (k,), and (..., k) lower bounds of their distances [m].

        centres: (..., S, 3) of the balls that cover the links, see `LinkBalls` [m], world.
        """
        assert self._balls is not None
        for index, rows in self._rows:
            away = self._grid(index).lower(centres, self._shift(index, time))
            bounds = self._balls.least_of_pieces(away)[..., self._column[rows]]
            # where a ball may touch it, nothing is known of how deep the piece is inside
            yield rows, np.where(bounds > 0.0, bounds, -np.inf)

    def measure(self, pair: int, data: pin.Data, time: float, reach: float) -> Reading | None:
        """The distance of a pair where the joints of `data` are; None where it is not less than `reach` [m]."""
        index, piece = int(self.owner[pair]), self._robot.pieces[self.piece[pair]]
        cluster = self._obstacles[index].cluster
        assert cluster is not None
        return cluster.measure(piece.piece, data.oMi[piece.joint], reach, shift=self._shift(index, time))

    def nearest(self, pair: int, data: pin.Data, time: float, *, lower: float, reach: float) -> Reading | None:
        """The same, looked for further and further away; what it is known to be at least is `lower` [m]."""
        within = min(max(lower, 0.0) + _FIRST_REACH, reach)
        while True:
            found = self.measure(pair, data, time, within)
            if found is not None or within >= reach:
                return found
            within = min(2.0 * within, reach)

    def keep(self, least: Vector, data: pin.Data, time: float) -> bool:
        """Whether all distances are at least `least` (K,) [m]."""
        return self._keep(least, self.lower(data, time), data, time)

    def keep_each(self, least: Vector, q: Matrix, time: float) -> Iterator[bool]:
        """Whether they are, at each of `q` (N, n), one after the other; the bounds of all of them are found at once."""
        assert self._balls is not None
        at = self._kinematics.at(q)
        lower = np.full((len(q), len(self)), -np.inf)
        for rows, bounds in self.lower_of_balls(self._balls.at_each(at.origins, at.rotations), time):
            lower[:, rows] = bounds
        doubtful = np.asarray((lower < least).any(axis=1))
        for row, is_doubtful in enumerate(doubtful.tolist()):
            if is_doubtful:
                pin.forwardKinematics(self._robot.model, self._data, q[row])
            yield not is_doubtful or self._keep(least, lower[row], self._data, time)

    def _keep(self, least: Vector, lower: Vector, data: pin.Data, time: float) -> bool:
        """Whether all distances are at least `least` (K,) where the joints of `data` are; they are at least `lower`."""
        doubtful = np.flatnonzero(lower < least)
        order = doubtful[np.argsort((lower - least)[doubtful], kind="stable")]
        return all(self.is_at_least(pair, data, time, float(least[pair])) for pair in order.tolist())

    def is_at_least(self, pair: int, data: pin.Data, time: float, least: float) -> bool:
        """Whether the distance of a pair is at least `least` [m]."""
        found = self.measure(pair, data, time, least)
        return found is None or found.distance >= least

    def _shift(self, index: int, time: float) -> Vector | None:
        """(3,) how far an obstacle has moved [m]; None where it has not."""
        if index not in self._moving:
            return None
        return offset_at(self._obstacles[index], time)

    def _grid(self, index: int) -> Distances:
        if index not in self._grids:
            cluster = self._obstacles[index].cluster
            assert cluster is not None
            self._grids[index] = cluster.grid(*self._reach)
        return self._grids[index]
