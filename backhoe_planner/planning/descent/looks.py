"""The places of a curve at which clearances are checked: equal steps, and places between where a link collides.

Between two equal steps the tip may move by half a metre, more than the thickness of many obstacles. There a
screen is queried, which only answers yes or no.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.motion import Keep
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.into_cones import IntoCones
from backhoe_planner.planning.descent.kept_margins import KeptMargins
from backhoe_planner.planning.descent.margins import Margins, find_margins
from backhoe_planner.planning.descent.seen_distances import SeenDistances
from backhoe_planner.planning.descent.tight_ends import TightEnds
from backhoe_planner.site import ClearanceScreen, Proximity

KEPT_PART = 0.5  # part of the spare that is kept between equal steps, and with which a curve counts as clear; chosen
_FINER = 16  # times more places than equal steps; chosen: a step of the tip by 0.6 m is then checked every 4 cm
_APART = 0.04  # m between two queries of the screen, for the point that moves most; chosen
_NEAR = 0.08  # m: larger margins are not linearised, however far a step moves a link; chosen: 0.25 takes twice as long
_NEAR_HURRIED = 0.05  # m: the same for a descent in a hurry; chosen: saves a twentieth of a quick plan, and is no worse
_FAR = 0.4  # m: the same at places where a step has gone into an obstacle; chosen: a link moves as far in a step
_ROUNDING = 1e-5  # m: a distance beyond a clearance by more is seen by the screen too; coal's are right to some 1e-6
_MUCH = 0.01  # m that must be missed at such a place; chosen


class Looks:
    """The places that one descent checks. A place that was once noticed is checked from then on.

    Parameters
    ----------
    screen: of the same obstacles, with `KEPT_PART` of the spare.
    keep: what has to be kept besides the clearances.
    steps: over the curve, equally many in every piece.
    spare: to be kept beyond every clearance at the places [m].
    time: at which the positions of the obstacles are taken [s].
    hurried: whether to linearise only smaller margins.
    fixed: (n,) each, the ends of the curve that stay where they are.

    Attributes
    ----------
    places: the number of equally spaced places that are distinguished; `Margins.place` counts these.
    allowed: a curve that misses the spare by no more than this counts as clear [m].
    kept: the margins of what has to be kept; None if there is nothing.
    cones: move curves into the cones that have to be kept; None if there are none.
    """

    def __init__(
        self, proximity: Proximity, screen: ClearanceScreen, keep: Keep | None, *,
        steps: int, spare: float, time: float, hurried: bool = False,
        fixed: Sequence[Vector] = (),
    ) -> None:  # fmt: skip
        self._proximity, self._screen = proximity, screen
        self._spare, self._time = spare, time
        self.allowed = KEPT_PART * spare
        self.kept = None if keep is None else KeptMargins(keep, spare=spare, allowed=self.allowed, ends=fixed)
        self.cones = None if self.kept is None or not self.kept.keep.cones else IntoCones(self.kept)
        self.places = _FINER * steps + 1
        self._u = np.linspace(0.0, 1.0, self.places)
        self._looked_at = np.arange(0, self.places, _FINER)
        self._near = _NEAR_HURRIED if hurried else _NEAR
        self._reach = np.full(self.places, self._near)
        self._widened = 0  # places with the larger reach
        self._seen = SeenDistances()
        self._ends = TightEnds(proximity, fixed, spare=spare, time=time)

    @property
    def known(self) -> tuple[int, int]:
        """How many places are checked, and at how many the larger reach is used; neither number decreases."""
        return len(self._looked_at), self._widened

    def find_margins(self, curve: JointCurve, *, before: Margins | None = None) -> Margins:
        """All small margins of a curve.

        Parameters
        ----------
        before: those of the same curve, if they were found before other places, or larger reaches, were added; then
            only those are looked at.
        """
        at, reach = self._looked_at, np.full(self.places, -np.inf)
        q, reach[at] = curve.at(self._u[at]), self._reach[at]
        if before is None or before.reach is None:
            is_new = np.ones(len(at), dtype=bool)
            margins = self._margins_at(q, at)
        else:
            is_new = before.reach[at] != reach[at]
            known = before.some(before.reach[before.place] == reach[before.place])
            margins = known.and_those(self._margins_at(q[is_new], at[is_new])).in_order()
        noticed = self._notice(curve, q, margins, is_new[:-1] | is_new[1:])
        if len(noticed):
            self._looked_at = np.union1d(at, noticed)
            margins = margins.and_those(self._margins_at(curve.at(self._u[noticed]), noticed))
        return replace(margins, reach=reach)

    def widen(self, margins: Margins) -> None:
        """Use a larger reach from now on where a curve with these margins goes into an obstacle."""
        deep = np.zeros(self.places, dtype=bool)
        deep[margins.place[margins.margin < -_MUCH]] = True
        self._widened += int(np.count_nonzero(deep & (self._reach < _FAR)))
        self._reach[deep] = _FAR

    def _margins_at(self, q: Matrix, places: Indices) -> Margins:
        return find_margins(
            self._proximity, self.kept, q,
            spare=self._spare, reach=self._reach[places], time=self._time, places=places, seen=self._seen,
            ends=self._ends,
        )  # fmt: skip

    def _notice(self, curve: JointCurve, q: Matrix, margins: Margins, intervals: Flags) -> Indices:
        """The first places that are not clear between two checked ones, at q (K, n) with these `margins`.

        `intervals` (K - 1,) are those between checked places in which others are looked for.
        """
        travel, at = self._proximity.travel, self._looked_at
        if not len(travel):
            return np.zeros(0, dtype=np.intp)
        least = self._reach.copy()
        np.minimum.at(least, margins.place, margins.margin)
        least = least[at]
        self._proximity.cover_unchecked(q)
        way = np.abs(np.diff(q, axis=0)) @ travel.max(axis=0)
        between: list[range] = []
        before: list[int] = []  # the checked place before each of them
        unsure = intervals & (least[:-1] + least[1:] < way)  # in the others no link collides
        for interval in np.flatnonzero(unsure).tolist():
            a, b = int(at[interval]), int(at[interval + 1])
            step = math.ceil((b - a) / (min(int(way[interval] / _APART), b - a - 1) + 1))
            if a + step < b:
                between.append(range(a + step, b, step))
                before.append(interval)
        between = self._not_known_clear(curve, between, np.array(before, dtype=np.intp), q)
        asked = [place for places in between for place in places]
        if not asked:
            return np.zeros(0, dtype=np.intp)
        found_at = curve.at(self._u[asked])
        if self._screen.has_clusters:  # many are checked together nearly as fast as one
            kept = dict(zip(asked, self._screen.keeps(found_at).tolist(), strict=True))
            noticed = [next((k for k in places if not kept[k]), -1) for places in between]
            return np.array([place for place in noticed if place >= 0], dtype=np.intp)
        after = np.cumsum([len(places) for places in between])  # rows of `found_at`
        first, row = [], self._screen.first_not_kept_unchecked(found_at)
        while row < len(asked):
            first.append(asked[row])
            row = int(after[np.searchsorted(after, row, side="right")])
            row += self._screen.first_not_kept_unchecked(found_at[row:])
        return np.array(first, dtype=np.intp)

    def _not_known_clear(self, curve: JointCurve, between: list[range], before: Indices, q: Matrix) -> list[range]:
        """Those of the places `between` checked ones, which are at q (K, n), where known distances leave it open.

        With the ways w_a and w_b of its link from both checked places, a pair keeps at least the mean of d_a - w_a and
        d_b - w_b.

        Parameters
        ----------
        before: the checked place before each of `between`.
        """
        if not between:
            return between
        count = [len(places) for places in between]
        at = np.repeat(before, count)
        there = curve.at(self._u[[place for places in between for place in places]])
        moved = np.abs(there - q[at]) + np.abs(there - q[at + 1])
        most = np.maximum.reduceat(moved, np.cumsum([0, *count[:-1]]))
        travel, is_end = self._proximity.travel, np.zeros(len(q), dtype=bool)
        is_end[before] = is_end[before + 1] = True
        known = self._seen.bounds(self._looked_at[is_end], q[is_end], travel)
        row = np.cumsum(is_end)[before] - 1
        least = 0.5 * (known[row] + known[row + 1] - most @ travel.T)
        clear = (least > self._proximity.clearance + self.allowed + _ROUNDING).all(axis=1)
        return [places for places, is_clear in zip(between, clear.tolist(), strict=True) if not is_clear]
