"""Proofs that a motion between configurations keeps its clearances, with few distance queries.

On a curve q(t), 0 <= t <= 1, whose joints change at rates of at most r, no distance
changes by more than B = r . travel from one end to the other, so a margin anywhere
between is at least (m_a + m_b - B) / 2. Only the pairs that this does not decide are
measured halfway, and so on. A pair that is far away at one end is not measured at all.

Beyond each clearance a spare distance is kept. A motion may leave or reach an end of the
route that has less: for the pairs concerned the spare is half of what they have at that
end, and grows with the distance from it (by `_SLOPE`, so the bound B counts
1 + `_SLOPE` times).

The conditions that the problem keeps along the motion are proven as well (`motion.keeping`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.site import ClearanceScreen, Proximity

Condition = Callable[[Matrix], bool]  # whether all configurations (B, n) fulfil it
Point = Callable[[Any], Vector]  # the configuration (n,) at a part 0..1 of a motion; (K, n) at a column of parts (K, 1)

_SLOPE = 0.05  # m of spare per metre of travel away from a tight end; chosen small, since B grows by it
_ROUNDING = 5e-7  # m: chosen far below every clearance, and far above the rounding of a distance
_SELF_SPARE = 0.002  # m: the links of a machine are built to pass each other closely
_MOST_HALVINGS = 250  # of one motion; chosen: a motion still undecided then is too tight to be worth more
_REMEMBERED = 20_000  # configurations; chosen to bound the memory, more than one search visits
_ANCHORS = 100  # configurations with all pairs measured, which bound others; chosen: each is compared at every query
_ANCHOR_FROM = 0.4  # chosen: if so large a part of the pairs was measured anyway, the rest is measured for an anchor
_NEAR_EVERY = 0.02  # s of the slowest joint between two checks of `near`: the period of a motion's samples


@dataclass(slots=True, eq=False)
class _Margins:
    """Margins of all pairs at one configuration [m]: lower bounds, exact where `exact`."""

    margin: Vector
    exact: NDArray[np.bool_]


class MotionCheck:
    """Decides which motions of one problem are clear; it remembers its measurements.

    Parameters
    ----------
    problem: its joint limits are kept, and its velocity limits are the weights of the joints.
    proximity: distances to the obstacles.
    ends: (n,) configurations at which a route may begin or end [rad or m].
    spare: kept beyond every clearance [m]; between links of the machine at most 2 mm.
    time: at which the positions of the obstacles are taken [s].
    near: a further condition on configurations. It is not proven but sampled along a
        motion, every 0.02 s of the slowest joint.
    brake: checked at every query; by default none.

    Attributes
    ----------
    proves: whether a positive answer is a proof.
    ends_clear: whether each end satisfies its clearances, the limits, `near` and the problem's `keep`.
    measured: how many configurations were measured.
    """

    proves = True

    def __init__(
        self,
        problem: Problem,
        proximity: Proximity,
        ends: Sequence[Vector],
        *,
        spare: float,
        time: float = 0.0,
        near: Condition | None = None,
        brake: Brake | None = None,
    ) -> None:
        self.problem = problem
        self.proximity = proximity
        self.rate = problem.limits.velocity
        self.measured = 0
        self._time = time
        self._near = near
        self._keep = problem.keep
        self.brake = brake or Brake()
        self._pairs = np.flatnonzero(proximity.appears_at <= time)
        self._spare = np.where(proximity.owner[self._pairs] < 0, min(spare, _SELF_SPARE), spare)
        self._clearance = proximity.clearance[self._pairs]
        proximity.cover_unchecked(np.array(ends))
        self._travel = proximity.travel[self._pairs] * (1.0 + _SLOPE)
        self._transposed = np.ascontiguousarray(self._travel.T)
        self._nothing = np.zeros(len(self._pairs))
        self._known: dict[bytes, _Margins] = {}
        self._anchors: list[tuple[Vector, Vector]] = []
        self._tight = np.zeros(len(self._pairs), dtype=bool)
        self._tight_ends: list[tuple[Vector, Vector]] = []
        twice = np.zeros(len(proximity.pairs))
        twice[self._pairs] = 2.0 * self._spare + _ROUNDING
        self._wide_screen = ClearanceScreen(proximity, time=time, spare=twice)
        self.ends_clear = [self._add_end(np.asarray(q, dtype=float)) for q in ends]
        self._screen = ClearanceScreen(proximity, time=time, spare=self._least_spare())
        self._known.clear()  # measured before all ends were known, on which the spare depends

    # --- queries ---------------------------------------------------------------

    def segment_is_clear(self, q_a: Vector, q_b: Vector) -> bool:
        """Whether the straight motion from `q_a` (n,) to `q_b` (n,) is proven clear.

        Raises
        ------
        OutOfTime: the budget of the brake is used up.
        """
        dq = q_b - q_a
        if not self._within_limits(q_b) or not self._within_limits(q_a):
            return False
        if not self._keeps_segment(q_a, q_b):
            return False
        return self._is_clear(q_a, q_b, lambda t: q_a + t * dq, np.abs(dq), self._nothing)

    def corner_is_clear(self, q_a: Vector, corner: Vector, q_b: Vector, *, sagitta: Vector) -> bool:
        """Whether the parabola from `q_a` to `q_b` with its tangents meeting at `corner` is clear.

        Parameters
        ----------
        sagitta: (n,) by which the joints may be off the parabola [rad or m]: the distance by which
            this can move a link is kept free as well, even where the spare is less.

        Raises
        ------
        OutOfTime: the budget of the brake is used up.
        """
        if not self._keeps_corner(q_a, corner, q_b, sagitta):
            return False
        first, second = corner - q_a, q_b - corner
        turn = second - first

        def point(t: Any) -> Vector:
            return np.asarray(q_a + t * (2.0 * first + t * turn))

        rate = 2.0 * np.maximum(np.abs(first), np.abs(second))  # dq/dt is linear in t
        return self._is_clear(q_a, q_b, point, rate, sagitta @ self._transposed)

    def _within_limits(self, q: Vector) -> bool:
        limits = self.problem.limits
        return bool(np.count_nonzero((q >= limits.lower) & (q <= limits.upper)) == len(q))

    def _keeps_segment(self, q_a: Vector, q_b: Vector) -> bool:
        return self._keep is None or self._keep.segment_holds(q_a, q_b)

    def _keeps_corner(self, q_a: Vector, corner: Vector, q_b: Vector, sagitta: Vector) -> bool:
        return self._keep is None or self._keep.corner_holds(q_a, corner, q_b, sagitta=sagitta)

    # --- the proof ---------------------------------------------------------------

    def _is_clear(self, q_a: Vector, q_b: Vector, point: Point, rate: Vector, more: Vector) -> bool:
        """Whether the curve `point` from `q_a` to `q_b` is clear.

        Parameters
        ----------
        rate: (n,) greatest change of each joint over t.
        more: (P,) further distance that each pair must keep [m].
        """
        self.brake.check()
        if self._near is not None and not self._stays_near(point, rate):
            return False
        if not len(self._pairs):
            return True
        bound = rate @ self._transposed
        if q_b.tobytes() in self._known and q_a.tobytes() not in self._known:
            q_a, q_b, forward = q_b, q_a, point
            point = lambda t: forward(1.0 - t)  # noqa: E731
        known_a = self._at(q_a, bound + more)
        margin_a = known_a.margin - more
        if margin_a.min() < 0.0:
            self._make_exact(known_a, q_a, margin_a < 0.0)
            margin_a = known_a.margin - more
        known_b = self._toward(q_b, known_a, bound, margin_a < bound)
        if known_b is None:
            return False
        margin_b = known_b.margin - more
        if margin_b.min() < 0.0 or margin_a.min() < 0.0:
            return False
        open_ = margin_a + margin_b < bound
        if not open_.any():
            return True
        for known, q in ((known_a, q_a), (known_b, q_b)):
            self._make_exact(known, q, open_)
        margin_a, margin_b = known_a.margin - more, known_b.margin - more
        rows = np.flatnonzero(margin_a + margin_b < bound)
        return self._halve(point, rows, margin_a[rows], margin_b[rows], bound, more)

    def _halve(
        self,
        point: Point,
        rows: NDArray[np.intp],
        margin_a: Vector,
        margin_b: Vector,
        bound: Vector,
        more: Vector,
    ) -> bool:
        parts = deque([(0.0, 1.0, rows, margin_a, margin_b)] if len(rows) else [])
        halvings = 0
        while parts:
            halvings += 1
            if halvings > _MOST_HALVINGS:
                return False
            a, b, rows, margin_a, margin_b = parts.popleft()
            middle = 0.5 * (a + b)
            q = point(middle)
            if not self._screen.keeps_unchecked(q):
                return False
            margin = self._measure(rows, q) - more[rows]
            if margin.min() < 0.0:
                return False
            half = bound[rows] * (0.5 * (b - a))
            left = margin_a + margin < half
            if left.any():
                parts.append((a, middle, rows[left], margin_a[left], margin[left]))
            right = margin + margin_b < half
            if right.any():
                parts.append((middle, b, rows[right], margin[right], margin_b[right]))
        return True

    def _stays_near(self, point: Point, rate: Vector) -> bool:
        assert self._near is not None
        steps = int(np.ceil(float(np.max(rate / self.rate)) / _NEAR_EVERY)) + 1
        at = places(steps)  # most motions that go too far off do so at an end or in the middle
        return all(self._near(np.array([point(part) for part in some])) for some in (at[:3], at[3:]) if some)

    # --- what is known -----------------------------------------------------------

    def _at(self, q: Vector, enough: Vector) -> _Margins:
        """Margins at `q`: for each pair the exact one, or a lower bound of at least `enough` (P,) [m]."""
        key = q.tobytes()
        known = self._known.get(key)
        if known is None:
            known = _Margins(self._bounds_at(q), np.zeros(len(enough), dtype=bool))
            self._make_exact(known, q, known.margin < enough)
            if len(self._anchors) < _ANCHORS and np.mean(known.exact) > _ANCHOR_FROM:
                self._make_exact(known, q, ~known.exact)
                self._anchors.append((q, known.margin))
            self._remember(key, known)
        return known

    def _bounds_at(self, q: Vector) -> Vector:
        """(P,) lower bounds of the margins at `q` [m], from the nearest anchor."""
        if not self._anchors:
            return np.full(len(self._pairs), -np.inf)
        away = np.abs(np.array([anchor for anchor, _ in self._anchors]) - q)
        nearest = int(np.argmin(np.sum(away / self.rate, axis=1)))
        return np.asarray(self._anchors[nearest][1] - away[nearest] @ self._transposed)

    def _toward(self, q: Vector, from_: _Margins, bound: Vector, needed: NDArray[np.bool_]) -> _Margins | None:
        """Margins at `q`, exact for the pairs that are `needed`; None if one of these is negative."""
        key = q.tobytes()
        known = self._known.get(key)
        if known is None:
            known = _Margins(from_.margin - bound, np.zeros(len(bound), dtype=bool))
        missing = np.flatnonzero(needed & ~known.exact)
        if len(missing):
            if not self._screen.keeps_unchecked(q):
                return None
            measured = self._measure(missing, q)
            known.margin[missing] = measured
            known.exact[missing] = True
            if measured.min() < 0.0:
                return None
        np.maximum(known.margin, from_.margin - bound, out=known.margin, where=~known.exact)
        self._remember(key, known)
        return known

    def _make_exact(self, known: _Margins, q: Vector, rows: NDArray[np.bool_]) -> None:
        loose = np.flatnonzero(rows & ~known.exact)
        if len(loose):
            known.margin[loose] = self._measure(loose, q)
            known.exact[loose] = True

    def _remember(self, key: bytes, known: _Margins) -> None:
        if len(self._known) >= _REMEMBERED:
            self._known.clear()
        self._known[key] = known

    def _measure(self, rows: NDArray[np.intp], q: Vector) -> Vector:
        """(K,) distance beyond clearance and spare of the pairs `rows` at `q` [m]."""
        self.measured += 1
        margin = self.proximity.distances_of_unchecked(self._pairs[rows], q, time=self._time) - self._clearance[rows]
        if not self._tight_ends or not self._tight[rows].any():
            return np.asarray(margin - self._spare[rows])
        spare = self._spare[rows]
        for end, at_end in self._tight_ends:
            away = np.abs(q - end) @ self._transposed[:, rows]
            np.minimum(spare, at_end[rows] + (_SLOPE / (1.0 + _SLOPE)) * away, out=spare)
        return np.asarray(margin - spare)

    def _least_spare(self) -> Vector:
        """(P,) the spare that is kept beyond every clearance everywhere [m]: away from tight ends it is larger."""
        spare = np.zeros(len(self.proximity.pairs))
        spare[self._pairs] = np.min([self._spare, *(at_end for _, at_end in self._tight_ends)], axis=0) - _ROUNDING
        return spare

    def _add_end(self, q: Vector) -> bool:
        if not self._within_limits(q) or (self._near is not None and not self._near(q[None])):
            return False
        if self._keep is not None and not self._keep.holds(q):
            return False
        if not len(self._pairs):
            return True
        # all other pairs have at least twice the spare
        rows = np.searchsorted(self._pairs, self._wide_screen.pairs_not_apart_unchecked(q))
        margin = np.full(len(self._pairs), np.inf)
        near = self.proximity.distances_of_unchecked(self._pairs[rows], q, time=self._time)
        margin[rows] = near - self._clearance[rows]
        if margin.min() < -0.5 * _ROUNDING:
            return False
        allowed = np.minimum(0.5 * margin, margin - _ROUNDING)
        tight = allowed < self._spare
        if tight.any():
            self._tight |= tight
            self._tight_ends.append((q, np.where(tight, allowed, np.inf)))
        return True


@lru_cache(maxsize=1024)
def places(steps: int) -> tuple[float, ...]:
    """0 to 1 in equal steps; the ends and the middle first, where most motions fail."""
    order = [0]  # numbers with their binary digits reversed (van der Corput)
    for _ in range((steps - 1).bit_length()):
        order = [2 * k for k in order] + [2 * k + 1 for k in order]
    return (1.0, 0.0, *(k / steps for k in order if 0 < k < steps))
