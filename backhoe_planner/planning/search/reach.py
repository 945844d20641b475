"""Through which configurations a motion from a start to one of several ends can be short enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine import JointLimits

# part of a box by which configurations are drawn beyond the limits of joints; chosen among 0.05 to 0.8: in four of the
# hardest cases a way was found after 1,400 looks at motions instead of 50,000, nowhere are more needed
_BEYOND = 0.25


@dataclass(frozen=True, eq=False)
class Reach:
    """What lies within a longest time from rest at the start to rest at an end.

    Attributes
    ----------
    limits: of the joints.
    start: (n,) where motions begin [rad or m].
    ends: (G, n) where they may end.
    longest: that they may take [s]; infinite for any time.
    """

    limits: JointLimits
    start: Vector
    ends: Matrix
    longest: float = np.inf

    def holds(self, q: Matrix) -> Flags:
        """(N,) whether a motion through `q` (N, n) can be short enough; every joint needs its way at full rate."""
        if self.longest == np.inf:
            return np.ones(len(q), dtype=bool)
        rate, joints = self.limits.velocity[:, None], np.ascontiguousarray(q.T)
        before = np.abs(joints - self.start[:, None])
        left = self.longest - (before / rate).max(axis=0, initial=0.0)
        most = np.minimum(self.travel()[:, None] - before, left * rate)  # (n, N) that each joint may move from there
        found = np.zeros(len(q), dtype=bool)
        for end in self.ends:
            found |= (np.abs(end[:, None] - joints) <= most).all(axis=0)
        return found

    def box(self) -> tuple[Vector, Vector]:
        """(n,) lower and upper bounds of all of them; a continuous joint may turn by one revolution beyond the ends."""
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
        """(n,) how far each joint gets from rest to rest in the longest time, there and back counted [rad or m]."""
        return travel_within(self.limits, self.longest)


def travel_within(limits: JointLimits, time: float) -> Vector:
    """(n,) how far each joint gets in a time [s] from rest to rest [rad or m]."""
    peak = np.minimum(limits.velocity, 0.5 * limits.acceleration * time)
    return np.asarray(peak * (time - peak / limits.acceleration))


def beyond_limits(limits: JointLimits, low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds from which to draw configurations between `low` and `high` (..., n), to be held within limits afterwards.

    They are further out where they are limits of joints, so that many a joint is right at one. That is often where
    ways lead, as of an arm that is folded up, and hardly where chance puts a joint.
    """
    room = _BEYOND * (high - low)
    return low - np.where(low <= limits.lower, room, 0.0), high + np.where(high >= limits.upper, room, 0.0)
