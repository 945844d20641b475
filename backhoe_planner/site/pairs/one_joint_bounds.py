"""Lower bounds of the distances of pieces that only one joint moves, kept for intervals of that joint.

A swing post is close to the ground in every posture of the arm, and how close depends only on the swing. It is
measured in the middle of an interval; no point of it moves further from there than that joint can move it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine import Robot, travel_bounds

_SHORT = 0.01  # m that a bound falls short at most; chosen: a swing of half a turn has some hundred intervals
_ROUNDING = 1e-9  # m: chosen, far above the rounding of sums of a few products
_REMEMBERED = 20_000  # intervals; chosen to bound the memory


class OneJointBounds:
    """Bounds for those of K pairs of a piece and an obstacle whose piece only one joint moves.

    Parameters
    ----------
    piece: (K,) row of the robot's pieces.
    stands: (K,) whether the obstacle does not move.
    measure: the distance of a pair in a posture (n,), or less [m].
    """

    def __init__(self, robot: Robot, piece: Indices, stands: Flags, measure: Callable[[int, Vector], float]) -> None:
        self._measure, self._posture = measure, robot.middle
        self._pairs: list[tuple[int, int, float]] = []  # pair, joint, width of its intervals [rad or m]
        for pair in np.flatnonzero(stands).tolist():
            own = robot.pieces[int(piece[pair])]
            joints = np.flatnonzero(robot.support[own.joint] > 0.0)
            if len(joints) == 1:
                joint = int(joints[0])
                travel = float(travel_bounds(robot, pieces=[own])[0, joint])
                self._pairs.append((pair, joint, 2.0 * _SHORT / max(travel, _SHORT)))
        self._known: dict[tuple[int, int], float] = {}  # by pair and interval

    def raise_to(self, needed: Matrix, found: Matrix, q: Matrix) -> None:
        """Raise bounds `found` (N, K) in postures q (N, n) that are below what is `needed` (N, K) [m].

        An interval is measured when it is needed for the second time.
        """
        for pair, joint, width in self._pairs:
            rows = (found[:, pair] < needed[:, pair]).nonzero()[0]
            for row, interval in zip(rows.tolist(), np.floor(q[rows, joint] / width).tolist(), strict=True):
                known = self._known.get((pair, interval))
                if known is None:
                    if len(self._known) >= _REMEMBERED:
                        self._known.clear()
                    known = -np.inf
                elif known == -np.inf:
                    known = self._bound(pair, joint, (interval + 0.5) * width)
                self._known[pair, interval] = known
                found[row, pair] = max(found[row, pair], known)

    def _bound(self, pair: int, joint: int, middle: float) -> float:
        posture = self._posture.copy()
        posture[joint] = middle
        return self._measure(pair, posture) - _SHORT - _ROUNDING
