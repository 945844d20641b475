"""Which of many configurations keep every clearance: yes or no, without the distances.

Pinocchio's broad phase asks coal only about pairs whose boxes meet, all pairs of a configuration in
one call. Each pair has its clearance as the margin within which it counts as touching. Clusters are
asked afterwards, where their lower bounds do not decide.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.proximity import Proximity

_ALL_AGAINST_ALL = 90  # pieces up to which every box is compared with every other, beyond which they are sorted first


class _Part:
    """A broad phase for some of the pairs, with those left out that are not asked for."""

    def __init__(
        self, proximity: Proximity, model: pin.GeometryModel, pairs: Indices, asked: Flags, least: Vector, time: float
    ) -> None:
        every, here = model.collisionPairs, asked[pairs]
        self._model = model.copy()
        for slot in np.flatnonzero(~here).tolist():
            self._model.removeCollisionPair(every[slot])
        for slot in np.flatnonzero(here & (proximity.speed[pairs] > 0.0)).tolist():
            index, obstacle = int(pairs[slot]), int(proximity.owner[pairs[slot]])
            placement = proximity.obstacles[obstacle].pieces[proximity.second[index]].placement
            moved = placement.translation + proximity.obstacle_offset(obstacle, time)
            self._model.geometryObjects[every[slot].second].placement = pin.SE3(placement.rotation, moved)
        self._geometry = self._model.createData()
        for request, margin in zip(self._geometry.collisionRequests, least[pairs[here]].tolist(), strict=True):
            shapes.prepare(request)
            request.security_margin = margin
        # the trees that pinocchio offers as well miss contacts with half-spaces
        few = self._model.ngeoms <= _ALL_AGAINST_ALL
        broad_phase = pin.BroadPhaseManager_NaiveCollisionManager if few else pin.BroadPhaseManager_SSaPCollisionManager
        self.manager = broad_phase(proximity.robot.model, self._model, self._geometry)


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
        self._clusters, self._time = proximity.clusters.with_own_memory(), time
        present = proximity.appears_at <= time
        least = np.where(present, proximity.clearance + spare, -np.inf)
        self._least = least[proximity.plain :]
        # what no posture brings near enough needs no look
        asked = least[: proximity.plain] > proximity.floor[: proximity.plain]
        self._parts: list[_Part] = []
        for pairs, model in proximity.geometry_parts_unchecked(asked):
            self._parts.append(_Part(proximity, model, pairs, asked, least, time))

    def keeps(self, q: Matrix) -> Flags:
        """(N,) whether each of `q` (N, n) keeps every clearance and its spare."""
        plain = np.array([self._keeps_plain(joints) for joints in q], dtype=bool)
        if len(self._clusters) and plain.any():
            plain[plain] = list(self._clusters.keep_each(self._least, q[plain], self._time))
        return plain

    @property
    def has_clusters(self) -> bool:
        """Whether there are any, so that many configurations are asked about sooner than each."""
        return len(self._clusters) > 0

    def keeps_all_unchecked(self, q: Matrix) -> bool:
        """Whether all of `q` (N, n) do; for callers in a loop, whose arguments are right as they are made."""
        if not all(self._keeps_plain(joints) for joints in q):
            return False
        return not len(self._clusters) or all(self._clusters.keep_each(self._least, q, self._time))

    def keeps_unchecked(self, q: Vector) -> bool:
        """Whether one configuration (n,) does, for such callers."""
        if not self._keeps_plain(q):
            return False
        if not len(self._clusters):
            return True
        pin.forwardKinematics(self._robot, self._data, q)
        return self._clusters.keep(self._least, self._data, self._time, q=q)

    def _keeps_plain(self, q: Vector) -> bool:
        """Whether one configuration (n,) keeps its clearances from all that is no cluster."""
        return not any(pin.computeCollisions(self._robot, self._data, part.manager, q, True) for part in self._parts)
