"""A sampled check of motions in place of a proof, many times quicker; for motions that are later proven as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.planning.search.motion_check import MotionCheck, Point, places
from backhoe_planner.site import ClearanceScreen, Proximity

_TOGETHER = 16  # places checked at once if there are clusters; chosen
_APART = 0.04  # m between two places, of the point that moves most; chosen: 20 to 60 places for a motion of 1 s
_APART_HURRIED = 0.08  # m: the same in a hurry; chosen: saves a seventh of a quick plan at a shelf, motions are as good
_KEPT_EVERY = 0.05  # s of the slowest joint between two places where kept conditions are checked; chosen


class SampledCheck(MotionCheck):
    """Counts a motion as clear if it is clear at places close to each other.

    The ends and the middle are checked first, then the middles of the halves, and so on: if a motion is
    not clear, a few places mostly show it.

    Parameters
    ----------
    hurried: whether the places may be twice as far apart.
    """

    proves = False

    def __init__(
        self, problem: Problem, proximity: Proximity, ends: Sequence[Vector], *, spare: float, time: float = 0.0,
        brake: Brake | None = None, hurried: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(problem, proximity, ends, spare=spare, time=time, brake=brake)
        self._apart = _APART_HURRIED if hurried else _APART

    def keeps(self, q: Matrix) -> Flags:
        """(N,) which of `q` (N, n) satisfy `keep` and every clearance, with the least spare of any end."""
        self.brake.check()
        found = np.ones(len(q), dtype=bool) if self._keep is None else self._keep.holds_each(q)
        found[found] = self._screen.keeps(q[found])
        return found

    def _is_clear(self, q_a: Vector, q_b: Vector, point: Point, rate: Vector, more: Vector) -> bool:
        self.brake.check()
        if self._near is not None and not self._stays_near(point, rate):
            return False
        steps = int((rate @ self._transposed).max(initial=0.0) / self._apart) + 1
        if self._keep is not None:
            q = point(_column_of_places(max(steps, int(np.max(rate / self.rate) / _KEPT_EVERY) + 1)))
            if not self._keep.holds_each(q).all():
                return False
        if not len(self._pairs):
            return True
        q = point(_column_of_places(steps))
        if not self._screen.has_clusters:
            return self._are_clear_at(q)
        return all(self._are_clear_at(q[first : first + _TOGETHER]) for first in range(0, len(q), _TOGETHER))

    def _keeps_segment(self, q_a: Vector, q_b: Vector) -> bool:
        return True  # checked at places, see `_is_clear`

    def _keeps_corner(self, q_a: Vector, corner: Vector, q_b: Vector, sagitta: Vector) -> bool:
        return True

    def _are_clear_at(self, q: Matrix) -> bool:
        """Whether all of `q` (N, n) keep every clearance and its spare."""
        if not len(self._tight_rows):
            return self._screen.keeps_all_unchecked(q)
        row = 0  # most configurations keep the full spare of all pairs, also of pairs with less at an end
        while (row := row + self._full_screen.first_not_kept_unchecked(q[row:])) < len(q):
            if not self._screen.keeps_unchecked(q[row]) or self._measure(self._tight_rows, q[row]).min() < 0.0:
                return False
            row += 1
        return True

    @cached_property
    def _tight_rows(self) -> Indices:
        """(K,) the pairs that have less than the spare at an end."""
        return np.flatnonzero(self._tight)

    @cached_property
    def _full_screen(self) -> ClearanceScreen:
        """A screen with the full spare of all pairs, the tight ones included."""
        spare = np.zeros(len(self.proximity.pairs))
        spare[self._pairs] = self._spare
        return ClearanceScreen(self.proximity, time=self._time, spare=spare)


@lru_cache(maxsize=1024)
def _column_of_places(steps: int) -> Matrix:
    """(K, 1) the same as `places`, as a column."""
    found = np.array(places(steps))[:, None]
    found.setflags(write=False)
    return found
