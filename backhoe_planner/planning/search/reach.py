"""The configurations through which a motion from a start to one of several ends can be short enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine import JointLimits, travel_within

# part of a box by which configurations are drawn beyond the joint limits; chosen among 0.05 to 0.8: in four of the
# hardest cases a route was found after 1,400 checks of motions instead of 50,000, and no case needs more than before
_BEYOND = 0.25


@dataclass(frozen=True, eq=False)
class Reach:
    """The configurations that a motion from rest at the start to rest at an end can pass within a longest time.

    Attributes
    ----------
    limits: of the joints.
    start: (n,) where motions begin [rad or m].
    ends: (G, n) where they may end.
    longest: the longest time that they may take [s]; infinite for any time.
    """

    limits: JointLimits
    start: Vector
    ends: Matrix
    longest: float = np.inf

    def holds(self, q: Matrix) -> Flags:
        """(N,) whether a motion through `q` (N, n) can be short enough, with every joint at its full velocity."""
        if self.longest == np.inf:
            return np.ones(len(q), dtype=bool)
        rate, joints = self.limits.velocity[:, None], np.ascontiguousarray(q.T)
        before = np.abs(joints - self.start[:, None])
        left = self.longest - (before / rate).max(axis=0, initial=0.0)
        most = np.minimum(self.travel()[:, None] - before, left * rate)  # (n, N) how far each joint can still move
        found = np.zeros(len(q), dtype=bool)
        for end in self.ends:
            found |= (np.abs(end[:, None] - joints) <= most).all(axis=0)
        return found

    def box(self) -> tuple[Vector, Vector]:
        """(n,) lower and upper bounds of these configurations; continuous joints may turn by 2 pi beyond the ends."""
        ends = np.vstack((self.start, self.ends))
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        lower = np.where(np.isfinite(self.limits.lower), self.limits.lower, low - 2.0 * np.pi)
        upper = np.where(np.isfinite(self.limits.upper), self.limits.upper, high + 2.0 * np.pi)
        if self.longest < np.inf:
            travel = self.travel()
            lower = np.maximum(lower, 0.5 * (self.start + low - travel))
            upper = np.minimum(upper, 0.5 * (self.start + high + travel))
        return lower, upper

    def travel(self) -> Vector:
        """(n,) how far each joint can move from rest to rest in the longest time, there and back counted [rad or m]."""
        return travel_within(self.longest, self.limits)


def beyond_limits(limits: JointLimits, low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds for drawing configurations between `low` and `high` (..., n) that are clipped to joint limits later.

    Bounds that are joint limits are moved outwards, so that many a joint ends up exactly at its limit. Routes often
    pass there, for example with the arm folded up, but random values hardly ever do.
    """
    room = _BEYOND * (high - low)
    return low - np.where(low <= limits.lower, room, 0.0), high + np.where(high >= limits.upper, room, 0.0)
