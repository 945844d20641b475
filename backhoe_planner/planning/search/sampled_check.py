"""A look at motions in place of a proof, many times quicker: for what is proven later, as a whole."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.search.motion_check import MotionCheck, places

_APART = 0.04  # m between two looks, of the point that moves most; chosen: a motion of 1 s is looked at 20 to 60 times


class SampledCheck(MotionCheck):
    """Says of a motion that it is clear where it is clear at places close to each other.

    The places are asked the middle first, then the middles of the halves, and so on: where a motion is
    not clear, few of them say so.
    """

    def _is_clear(self, q_a: Vector, q_b: Vector, point: Callable[[float], Vector], rate: Vector, more: Vector) -> bool:
        self._brake.check()
        if self._near is not None and not self._stays_near(point, rate):
            return False
        if not len(self._pairs):
            return True
        steps = int(np.max(rate @ self._transposed) / _APART) + 1
        return all(self._is_clear_at(point(part)) for part in places(steps))
