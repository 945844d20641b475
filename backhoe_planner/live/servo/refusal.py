"""How much of a wish the machine does not follow, joint by joint."""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Vector

__all__ = ["Refusal"]


_REMEMBERED = 0.02  # s for which being held back counts, so that a status does not flicker
_AS_WISHED = 1e-9  # rad/s or m/s: rounding


class Refusal:
    """Compares the machine with one that nothing is in the way of.

    Parameters
    ----------
    n: number of joints.
    dt: length of a step [s].
    changes: n numbers, by how much a joint's velocity can change in a step.
    """

    def __init__(self, n: int, dt: float, changes: list[float]) -> None:
        self._changes = changes
        self._free = [0.0] * n  # velocities with nothing in the way
        self._forgets = 1.0 - math.exp(-dt / _REMEMBERED)
        self._steps = max(math.ceil(_REMEMBERED / dt), 1)
        self._counts_for = 0

    def remember(self, *, held_back: bool) -> bool:
        """Whether the machine is held back, or was just now."""
        self._counts_for = self._steps if held_back else self._counts_for - 1
        return self._counts_for > 0

    def next(self, v: Vector, *, wish: Vector, target: Vector) -> Vector:
        """(n,) the velocity that is refused in a step at v (n,).

        Parameters
        ----------
        wish, target: (n,) see `VelocityWish`.
        """
        rates, wishes = v.tolist(), wish.tolist()
        joints = zip(self._free, wishes, rates, target.tolist(), self._changes, strict=True)
        # a joint that goes as it is told has caught up with what it would have done
        self._free = [
            free
            + (min(max(aim - free, -most), most) if abs(rate - goal) > _AS_WISHED else self._forgets * (rate - free))
            for free, aim, rate, goal, most in joints
        ]
        return np.array([free - rate - aim for free, rate, aim in zip(self._free, rates, wishes, strict=True)])
