"""The conditions to be kept along a plan while something pushes the machine off it or holds it back.

The servo keeps the machine clear, but knows nothing of a full bucket. So the follower watches: if
the machine slides off the plan and a condition would be lost before it could stop, the machine is
held still instead, until a detour is found that keeps the condition. Only an approaching obstacle can
then still break it: the machine gives way to a person rather than keep its bucket level.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Keep

_HELD = 0.5  # s for which the machine is held; chosen: it needs some tenths of a second to stop
_BRAKED = 1.0  # part of the braking time for which the present rate counts; 0.5 would be exact, the rest is a margin


class KeptFollowing:
    """Decides whether the machine has to stop to keep the conditions of its task.

    Parameters
    ----------
    keep: the conditions; None if there are none.
    limits: of the joints.
    """

    def __init__(self, keep: Keep | None, limits: JointLimits) -> None:
        self._keep, self._limits = keep, limits
        self._until = -np.inf  # s: held until then
        self._lost = ""

    @property
    def lost(self) -> str:
        """The condition that is not kept, or would not have been, in words; empty if there is none."""
        return self._lost

    def must_stop(self, q: Vector, v: Vector, *, time: float, off_plan: bool) -> bool:
        """Whether the machine at `q` (n,), with the rates `v` (n,), has to stop.

        Parameters
        ----------
        time: now [s].
        off_plan: whether the machine is off its plan; on the plan every condition is kept.
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
            self._lost = self._keep.broken(q) or "the machine stopped, because sliding on would violate `keep`"
        return time < self._until
