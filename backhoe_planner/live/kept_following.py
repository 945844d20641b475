"""What is to be kept along a plan, while something pushes the machine off it or holds it back.

The servo keeps the machine clear, and knows nothing of a full bucket. So the follower watches: where
the machine slides off the plan and what is to be kept would be lost before it could stop, it is
held still instead, until a way round is found that keeps it. Only what comes nearer by itself can then
still make it lose it: the machine gives way to a person rather than to keep its bucket level.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Keep

_HELD = 0.5  # s for which the machine is held; chosen: it takes some tenths to stop
_BRAKED = 1.0  # part of the braking time for which the present rate counts; 0.5 would be exact, the rest is room


class KeptFollowing:
    """Whether the machine has to stop for what is to be kept.

    Parameters
    ----------
    keep: None where nothing is.
    limits: of the joints.
    """

    def __init__(self, keep: Keep | None, limits: JointLimits) -> None:
        self._keep, self._limits = keep, limits
        self._until = -np.inf  # s: held until then
        self._lost = ""

    @property
    def lost(self) -> str:
        """What is not kept now, or would not have been, in words; empty where nothing is missing."""
        return self._lost

    def must_stop(self, q: Vector, v: Vector, *, time: float, off_plan: bool) -> bool:
        """Whether the machine at `q` (n,), with the rates `v` (n,), has to stop.

        Parameters
        ----------
        time: now [s].
        off_plan: whether the machine is beside its plan; on it all is kept.
        """
        if self._keep is None:
            return False
        if not off_plan:
            self._lost, self._until = "", -np.inf
            return False
        margins, rates = self._keep.margins(q), self._keep.gradients(q) @ v
        stopping = _BRAKED * float(np.max(np.abs(v) / self._limits.acceleration))
        if bool(np.any((rates < 0.0) & (margins + stopping * rates < 0.0))):
            self._until = time + _HELD
            self._lost = self._keep.broken(q) or "it does not slide on, to keep what is asked for"
        return time < self._until
