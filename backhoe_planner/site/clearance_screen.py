"""Which of many configurations keep every clearance: yes or no, without the distances.

Pinocchio's broad phase asks coal only about pairs whose boxes meet, all pairs of a configuration in
one call. Each pair has its clearance as the margin within which it counts as touching. Clusters are
asked afterwards, where their lower bounds do not decide.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.cluster_distances import ClusterDistances
from backhoe_planner.site.proximity import Proximity

_ALL_AGAINST_ALL = 90  # pieces up to which every box is compared with every other, beyond which they are sorted first


class ClearanceScreen:
    """Screens configurations for the obstacles of one `Proximity`.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    time: the obstacles stand where they are at this time [s]; those that appear later are left out.
    spare: kept beyond every clearance [m], one number or (P,) of the pairs of `proximity`.
    """

    def __init__(self, proximity: Proximity, *, time: float = 0.0, spare: float | Vector = 0.0) -> None:
        self._robot = proximity.robot.model
        self._data = self._robot.createData()
        every = proximity.geometry[0].collisionPairs
        self._model = proximity.geometry[0].copy()
        margin = proximity.clearance + spare
        present = proximity.appears_at <= time
        self._clusters, self._time = ClusterDistances(proximity.robot, proximity.obstacles), time
        self._least = np.where(present, margin, -np.inf)[proximity.plain :]
        here = present[: proximity.plain]
        margins = margin[: proximity.plain][here].tolist()
        for index in np.flatnonzero(~here).tolist():
            self._model.removeCollisionPair(every[index])
        for index in np.flatnonzero(here & (proximity.speed[: proximity.plain] > 0.0)).tolist():
            obstacle = int(proximity.owner[index])
            placement = proximity.obstacles[obstacle].pieces[proximity.second[index]].placement
            moved = placement.translation + proximity.obstacle_offset(obstacle, time)
            self._model.geometryObjects[every[index].second].placement = pin.SE3(placement.rotation, moved)
        self._geometry = self._model.createData()
        for request, margin in zip(self._geometry.collisionRequests, margins, strict=True):
            shapes.prepare(request)
            request.security_margin = margin
        # the trees that pinocchio offers as well miss contacts with half-spaces
        few = self._model.ngeoms <= _ALL_AGAINST_ALL
        broad_phase = pin.BroadPhaseManager_NaiveCollisionManager if few else pin.BroadPhaseManager_SSaPCollisionManager
        self._manager = broad_phase(self._robot, self._model, self._geometry)
        self._pairs = len(margins)

    def keeps(self, q: Matrix) -> Flags:
        """(N,) whether each of `q` (N, n) keeps every clearance and its spare."""
        return np.array([self.keeps_unchecked(joints) for joints in q], dtype=bool)

    def keeps_unchecked(self, q: Vector) -> bool:
        """The same of one configuration (n,), for callers in a loop, whose arguments are right as they are made."""
        if self._pairs and pin.computeCollisions(self._robot, self._data, self._manager, q, True):
            return False
        if not len(self._clusters):
            return True
        pin.forwardKinematics(self._robot, self._data, q)
        return self._clusters.keep(self._least, self._data, self._time)
