"""The rows of what moves: they demand a velocity away from it that the machine can still reach.

For each corner of a link that is nearest to a moving obstacle, with the rate g v of its gap, and the obstacle's rate
u.n along the normal,

    g v + u.n >= -sqrt(2 a_n margin),   a_n = sum_j |g_j| a_j / 2

A machine that has conditions to keep gives way earlier: with the acceleration that is left while it keeps them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.braking_path import BUFFER
from backhoe_planner.live.braking.joint_bounds import FASTEST_RECOVERY, RECOVERY, SLOWEST_RECOVERY
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.clearance.pair_bounds import Near
from backhoe_planner.live.clearance.path_check import MOST_CANDIDATES, PathCheck
from backhoe_planner.live.planes.path_rows import Candidates
from backhoe_planner.live.planes.plane_gaps import corner_rows

_SLOW = 1e-3  # m/s: slower obstacles count as approaching at this speed when times are compared; chosen
_VIOLATED = 1e-7  # m: a distance that is too short by less does not count; rounding
_LEAST_AUTHORITY = 0.3  # part of the acceleration with which to give way that counts beside what is kept; chosen of 0.1
# to 1: with 1 it begins too late to keep a cup upright, 0.1 and 0.6 are as good
_URGENT = 0.5  # s until what moves is too close, from which on evading it comes before what is kept; chosen
_TINY = 1e-12  # keeps quotients finite
_AS_NEAR = 0.02  # m: chosen, corners within this of the nearest one get a row each
_RANK = 1e-3  # part of the largest singular value below which rows count as dependent; chosen, octagons have rank 2


class EvasionRows(NamedTuple):
    """The rows of what moves in one step.

    Attributes
    ----------
    rows: of obstacles that are approaching, and of moving ones that are already too close.
    early: those with which a machine gives way early enough to keep its conditions meanwhile.
    of_pairs: the pairs (K,) of `rows` with these rows, then those of `early`; empty if nothing comes.
    """

    rows: Rows
    early: Rows
    of_pairs: tuple[tuple[Indices, Rows], ...]


class Evasion:
    """Finds the rows of what moves.

    Parameters
    ----------
    check: the check of the machine's braking paths.

    Attributes
    ----------
    nothing: the rows if nothing comes.
    """

    def __init__(self, check: PathCheck) -> None:
        self._separation, self._bounds, self._at = check.separation, check.bounds, check.at
        self._acceleration, self._fastest = check.joints.limits.acceleration, check.joints.limits.velocity
        none = Rows.none("evasion", len(self._acceleration))
        self.nothing = EvasionRows(none, none, ())

    def find(self, near: Near, low: Vector, high: Vector, kept: KeptRows | None) -> EvasionRows:
        """The rows for the `near` pairs in this step; early ones only if there are conditions to be `kept`.

        Rows that no velocity between `low` and `high` (n,) can break are left out.
        """
        separation = self._separation
        if len(near.pairs) == 0 or not self._bounds.anything_moves:
            return self.nothing
        clearance = separation.clearance.take(near.pairs)
        too_close = np.maximum(near.distance, self._bounds.required.take(near.pairs)) < clearance - _VIOLATED
        too_close &= ~self._bounds.stands.take(near.pairs)
        drift = separation.drift.take(near.pairs)
        too_close |= drift < 0.0
        chosen = too_close.nonzero()[0]
        if len(chosen) == 0:
            return self.nothing
        k, corners, margin = _nearest_corners(near, chosen, clearance, drift)
        G = corner_rows(separation, near.pairs.take(k), 0, corners, self._at)
        comes = drift.take(k)
        moves = comes < 0.0
        margin -= clearance.take(k)
        margin -= moves * (2.0 * BUFFER)
        authority = 0.5 * np.abs(G).dot(self._acceleration)
        allowed = np.sqrt(2.0 * authority * np.maximum(margin, 0.0))
        back = -np.minimum(np.maximum(-RECOVERY * margin, SLOWEST_RECOVERY), FASTEST_RECOVERY)
        h = np.where(margin >= 0.0, np.where(moves, allowed, np.inf), back) + np.minimum(comes, 0.0)
        most = np.add.reduce(np.maximum(G * low, G * high), axis=1)
        # running from what is faster than the link can be does not help; it would only cost what is to be kept
        helps = np.abs(G).dot(self._fastest) >= -comes
        if kept is None:
            could = (most > h) & (helps | (margin < self._bounds.influence))
            rows = Rows("evasion", G[could], h[could])
            return EvasionRows(rows, self.nothing.early, ((near.pairs.take(k)[could], rows),))
        urgent = margin < -_URGENT * comes
        could = (most > h) & helps & (urgent | ~moves)
        beside = authority_beside(kept.near, G, self._acceleration) / np.maximum(2.0 * authority, _TINY)
        part = np.sqrt(np.minimum(np.maximum(beside, _LEAST_AUTHORITY), 1.0))
        sooner = np.where(moves, h - (1.0 - part) * allowed, h)
        soon = helps & moves & ((sooner < h) | ~urgent) & (most > sooner)
        pairs = near.pairs.take(k)
        rows, early = Rows("evasion", G[could], h[could]), Rows("early", G[soon], sooner[soon])
        return EvasionRows(rows, early, ((pairs[could], rows), (pairs[soon], early)))


def _nearest_corners(near: Near, chosen: Indices, clearance: Vector, drift: Vector) -> tuple[Indices, Indices, Vector]:
    """The corners that are nearest to their planes: the row of the near pair (R,), the corner (R,), its gap (R,) [m].

    Parameters
    ----------
    chosen: (M,) the rows of the pairs among which they are searched.
    clearance, drift: (K,) of the near pairs [m], and the rates at which the planes come nearer, if negative [m/s].
    """
    least, nearest = near.gaps.least[:, 0], near.gaps.nearest[:, 0]
    # the time that is left until the clearance is violated
    room = (least - clearance) / np.maximum(-drift, _SLOW)
    if len(chosen) > MOST_CANDIDATES:
        k = chosen[room.take(chosen).argpartition(MOST_CANDIDATES - 1)[:MOST_CANDIDATES]]
        return k, nearest.take(k), least.take(k)
    gaps = near.gaps.all.take(chosen, axis=0)[:, 0]
    within = np.maximum(least, clearance).take(chosen)
    within += _AS_NEAR
    binding = Candidates(gaps, within, nearest.take(chosen), room.take(chosen), np.arange(len(chosen)))
    row, corners = binding.all_of(MOST_CANDIDATES) or binding.tightest(MOST_CANDIDATES)
    return chosen.take(row), corners, gaps[row, corners]


def authority_beside(near: Matrix, G: Matrix, acceleration: Vector) -> Vector:
    """(K,) how fast joints with an acceleration (n,) can change each rate G v (K, n) while `near` v (M, n) stays.

    It is that in the direction that is nearest to the one in which the rate changes most.
    """
    scaled = G * acceleration
    if len(near):
        fixed = near * acceleration
        scaled_beside = scaled - scaled @ np.linalg.pinv(fixed, rcond=_RANK) @ fixed
    else:
        scaled_beside = np.sign(scaled)
    most = np.maximum(np.abs(scaled_beside).max(axis=1), _TINY)
    return np.asarray(np.einsum("kn,kn->k", scaled, scaled_beside) / most)
