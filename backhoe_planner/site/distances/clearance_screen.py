"""Which of many configurations keep every clearance: yes or no, without the distances.

Compiled code decides nearly all at once (`CertainlyClear`). For the others, and for all without a compiler,
Pinocchio's broad phase calls coal only for pairs whose boxes meet, all pairs of a configuration in one call. A pair
counts as touching within its clearance. Clusters are measured afterwards, if their lower bounds do not decide.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine import self_pieces
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.distances.proximity import Proximity
from backhoe_planner.site.pairs.certainly_clear import CertainlyClear

_MOST_PAIRS = 3_000  # pairs that are examined one by one before coal is called; chosen
# configurations that are examined pair by pair first, and the most pairs in doubt in one of them; measured: a broad
# phase takes 1 ms to build, and then 30 us less for each
_FIRST, _FEW_PAIRS = 20, 12
_ALL_AGAINST_ALL = 90  # pieces up to which every box is compared with every other; beyond it they are sorted first


class _Part:
    """A broad phase for those of some pairs for which `asked` is true."""

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
        # Pinocchio also has tree managers, but they miss contacts with half-spaces
        few = self._model.ngeoms <= _ALL_AGAINST_ALL
        broad_phase = pin.BroadPhaseManager_NaiveCollisionManager if few else pin.BroadPhaseManager_SSaPCollisionManager
        self.manager = broad_phase(proximity.robot.model, self._model, self._geometry)


class ClearanceScreen:
    """Screens configurations for the obstacles of one `Proximity`.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    time: the obstacles are where they are at this time [s]; those that appear later are left out.
    spare: distance kept beyond every clearance [m], one number or (P,) of the pairs of `proximity`.
    """

    def __init__(self, proximity: Proximity, *, time: float = 0.0, spare: float | Vector = 0.0) -> None:
        self._robot = proximity.robot.model
        self._data = self._robot.createData()
        self._clusters, self._time = proximity.clusters.with_own_memory(), time
        present = proximity.appears_at <= time
        least = np.where(present, proximity.clearance + spare, -np.inf)
        self._least = least[proximity.plain :]
        # pairs that no posture brings near enough need no check
        asked = least[: proximity.plain] > proximity.floor[: proximity.plain]
        self._proximity, self._asked, self._plain_least = proximity, asked, least
        self._looked_at = 0  # configurations examined pair by pair

    @cached_property
    def _parts(self) -> list[_Part]:
        proximity, asked = self._proximity, self._asked
        return [
            _Part(proximity, model, pairs, asked, self._plain_least, self._time)
            for pairs, model in proximity.geometry_parts_unchecked(asked)
        ]

    @cached_property
    def _certainly(self) -> CertainlyClear | None:
        """None if there are no pairs, or too many to examine each of them."""
        proximity, asked = self._proximity, np.flatnonzero(self._asked)
        if not 0 < len(asked) <= _MOST_PAIRS:
            return None
        own = len(self_pieces(proximity.robot))
        bodies: list[shapes.Piece] = []
        shifts, firsts = [], []
        for index, obstacle in enumerate(proximity.obstacles):
            firsts.append(own + len(bodies))
            bodies += obstacle.pieces
            shifts += [proximity.obstacle_offset(index, self._time)] * len(obstacle.pieces)
        owner = proximity.owner[asked]
        second = np.array(proximity.second, dtype=np.intp)[asked]
        second += np.where(owner < 0, 0, np.array([*firsts, 0])[owner])
        return CertainlyClear(
            proximity.robot, bodies, np.array(shifts).reshape(-1, 3),
            first=np.array([proximity.pairs[pair].piece for pair in asked.tolist()], dtype=np.intp), second=second,
            least=self._plain_least[asked],
        )  # fmt: skip

    def keeps(self, q: Matrix) -> Flags:
        """(N,) whether each of `q` (N, n) keeps every clearance and its spare."""
        plain = np.ones(len(q), dtype=bool)
        for row, nearer in self._plain_not_apart(q):
            plain[row] = not nearer and self._keeps_plain(q[row])
        if len(self._clusters) and plain.any():
            plain[plain] = list(self._clusters.keep_each(self._least, q[plain], self._time))
        return plain

    @property
    def has_clusters(self) -> bool:
        """Whether there are clusters, so that one query for many configurations is faster than one for each."""
        return len(self._clusters) > 0

    def keeps_all_unchecked(self, q: Matrix) -> bool:
        """Whether all of `q` (N, n) keep every clearance, without checks of arguments, for callers in a loop."""
        return self.first_not_kept_unchecked(q) == len(q)

    def first_not_kept_unchecked(self, q: Matrix) -> int:
        """The first of `q` (N, n) that does not keep every clearance, N if there is none; for such callers."""
        first = len(q)
        for row, nearer in self._plain_not_apart(q):
            if nearer or not self._keeps_plain(q[row]):
                first = row
                break
        if not len(self._clusters):
            return first
        kept = self._clusters.keep_each(self._least, q[:first], self._time)
        return next((row for row, keeps in enumerate(kept) if not keeps), first)

    def pairs_not_apart_unchecked(self, q: Vector) -> Indices:
        """The pairs of `proximity` that are not known to keep clearance and spare at q (n,), for such callers."""
        asked = np.flatnonzero(self._asked)
        if self._certainly is not None:
            asked = asked[self._certainly.pairs_not_apart(q)]
        clusters = np.arange(len(self._asked), len(self._asked) + len(self._least))
        return np.concatenate((asked, clusters[self._least > -np.inf]))

    def keeps_unchecked(self, q: Vector) -> bool:
        """Whether one configuration (n,) keeps every clearance, for such callers."""
        if not all(not nearer and self._keeps_plain(q) for _, nearer in self._plain_not_apart(q[None])):
            return False
        if not len(self._clusters):
            return True
        pin.forwardKinematics(self._robot, self._data, q)
        return self._clusters.keep(self._least, self._data, self._time, q=q)

    def _plain_not_apart(self, q: Matrix) -> Iterator[tuple[int, bool]]:
        """The rows of `q` (N, n) that do not certainly keep their clearances, clusters left out.

        For each, whether it certainly does not.
        """
        if self._certainly is None:
            yield from ((row, False) for row in range(len(q)))
            return
        row = 0
        while row < len(q):
            certain, nearer = self._certainly.first_not_apart(q[row:])
            row += certain
            if row < len(q):
                yield row, nearer
            row += 1

    def _keeps_plain(self, q: Vector) -> bool:
        """Whether one configuration (n,) keeps its clearances, clusters left out."""
        if self._looked_at < _FIRST and self._certainly is not None:
            pairs = np.flatnonzero(self._asked)[self._certainly.pairs_not_apart(q)]
            if len(pairs) <= _FEW_PAIRS:
                self._looked_at += 1
                distances = self._proximity.distances_of_unchecked(pairs, q, time=self._time)
                return not np.count_nonzero(distances < self._plain_least[pairs])
            self._looked_at = _FIRST
        return not any(pin.computeCollisions(self._robot, self._data, part.manager, q, True) for part in self._parts)
