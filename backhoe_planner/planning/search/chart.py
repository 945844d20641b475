"""The coordinates in which configurations are drawn at random."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import KEPT_TO
from backhoe_planner.planning.search.motion_check import MotionCheck

_BESIDE_BAND = 2.0 * KEPT_TO  # rad: an end may miss the band by `KEPT_TO`, and OMPL waits forever for an end outside


class Chart:
    """The coordinates in which OMPL samples: joint times, which are positions over velocity limits.

    If the pitch has to stay within a band, it replaces one of the joints that change it as a
    coordinate. It is linear in the joints, so straight motions stay straight, and every sample
    is within the band, however narrow that is.
    """

    def __init__(self, check: MotionCheck) -> None:
        self._limits = limits = check.problem.limits
        self._rate = check.rate
        self._band = None if check.problem.keep is None else check.problem.keep.band
        self._joint = 0
        self._turns = 0.0
        if self._band is not None:
            # the joint with the widest range: the fewest samples make it leave its range
            changes = np.abs(self._band.row) > 0.5
            self._joint = int(np.argmax(np.where(changes, limits.upper - limits.lower, -1.0)))

    def begin_at(self, start: Vector) -> None:
        """Count whole turns of the pitch from `start` (n,)."""
        if self._band is not None:
            whole = float(self._band.unwrapped(start))
            self._turns = whole - float(self._band.values(start[None, :])[0])

    def place(self, q: Vector) -> Vector:
        """(n,) the coordinates of the joints `q` (n,)."""
        found = q / self._rate
        if self._band is not None:
            found[self._joint] = (float(self._band.unwrapped(q)) - self._turns) / self._rate[self._joint]
        return np.asarray(found)

    def joints(self, places: Matrix) -> Matrix:
        """(..., n) joints at `places` (..., n), clipped to their limits, except the joint that the pitch replaces."""
        q = np.clip(places * self._rate, self._limits.lower, self._limits.upper)
        if self._band is not None:
            off = q[..., self._joint].copy()
            q[..., self._joint] = 0.0
            rest = off + self._turns - self._band.unwrapped(q)
            q[..., self._joint] = rest / self._band.row[self._joint]
        return np.asarray(q)

    def box(self, lower: Vector, upper: Vector) -> tuple[Vector, Vector]:
        """The box of samples, from that of the joints."""
        low, high = np.nextafter(lower / self._rate, -np.inf), np.nextafter(upper / self._rate, np.inf)
        if self._band is not None:
            half = (max(self._band.half, 0.0) + _BESIDE_BAND) / self._rate[self._joint]
            low[self._joint], high[self._joint] = -half, half
        return low, high

    def into_band(self, q: Matrix, rng: np.random.Generator) -> Matrix:
        """The joints `q` (N, n), with one of them changed so that the pitch is at random in the band."""
        if self._band is None:
            return q
        places = q / self._rate
        half = max(self._band.half, 0.0) / self._rate[self._joint]
        places[:, self._joint] = rng.uniform(-half, half, len(q))
        return self.joints(places)
