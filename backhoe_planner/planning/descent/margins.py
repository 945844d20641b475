"""The small margins along a curve: of clearances, and of conditions that have to be kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.planning.descent.kept_margins import KeptMargins
from backhoe_planner.planning.descent.seen_distances import SeenDistances
from backhoe_planner.planning.descent.tight_ends import TightEnds
from backhoe_planner.site import Nearby, NearInEach, Proximity


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins at places of a curve.

    Attributes
    ----------
    place: (M,) index of the place of each.
    margin: (M,) of clearances [m] and of kept conditions [rad or m], beyond the spare.
    counted: (M,) the same as clearances that are kept or missed [m], see `KeptMargins`.
    gradient: (M, n) of the margins.
    reach: (places,) below which those at each place were looked for [m]; minus infinity where none were. None if that
        is not known.
    """

    place: Indices
    margin: Vector
    counted: Vector
    gradient: Matrix
    reach: Vector | None = None

    @classmethod
    def none(cls, n: int) -> Margins:
        """Those of a curve of n joints that is not looked at, or far from everything."""
        return cls(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0), np.zeros((0, n)))

    @property
    def least(self) -> float:
        """The least of them, as a clearance [m]; infinite if there is none."""
        return float(self.counted.min(initial=np.inf))

    def some(self, which: Flags | Indices) -> Margins:
        """Those of `which`, flags (M,) or indices; without their reach."""
        return Margins(self.place[which], self.margin[which], self.counted[which], self.gradient[which])

    def in_order(self) -> Margins:
        """The same, the places in order; without their reach."""
        return self.some(np.argsort(self.place, kind="stable"))

    def and_those(self, other: Margins) -> Margins:
        """These, then those of the same curve at other places; without their reach."""
        return Margins(
            np.append(self.place, other.place), np.append(self.margin, other.margin),
            np.append(self.counted, other.counted), np.concatenate((self.gradient, other.gradient)),
        )  # fmt: skip


def find_margins(
    proximity: Proximity, kept: KeptMargins | None, q: Matrix, *, spare: float, reach: float | Vector, time: float,
    places: Indices | None = None, seen: SeenDistances | None = None, ends: TightEnds | None = None,
) -> Margins:  # fmt: skip
    """All margins below `reach` [m] at places q (K, n), those of one place after those of another.

    `reach` is one number, or (K,) for the places.

    Parameters
    ----------
    kept: conditions to be kept besides the clearances, with their own spares; all their margins count.
    spare: to be kept beyond every clearance [m].
    time: at which the positions of the obstacles are taken [s].
    places: (K,) their indices; by default they are counted.
    seen: known lower bounds of the distances there, for the same `time`; the new ones are added.
    ends: near which pairs keep less than `spare`.
    """
    places = np.arange(len(q)) if places is None else places
    seen = seen or SeenDistances()
    margins = np.zeros(len(q)) + (reach + spare)
    proximity.cover_unchecked(q)
    bounds = seen.bounds(places, q, proximity.travel)
    rows = np.flatnonzero((bounds <= proximity.clearance + margins[:, None]).any(axis=1))
    near = _nearby(proximity, q[rows], margins[rows], bounds[rows], time)
    proximity.clusters.forget_expected()
    seen.keep(places[rows], q[rows], near.lower)
    row = rows[near.row]
    margin = near.distance - proximity.clearance[near.pair] - (ends.spares(q[row], near.pair) if ends else spare)
    found = Margins(places[row], margin, margin, near.gradient)
    if kept is None:
        return found
    movable = (places > 0).nonzero()[0]  # the start cannot be changed
    of_kept, counted, slopes = kept.at(q[movable])
    row = np.append(row, np.repeat(movable, of_kept.shape[1]))
    more = Margins(
        np.repeat(places[movable], of_kept.shape[1]), of_kept.ravel(), counted.ravel(),
        slopes.reshape(-1, q.shape[1]),
    )  # fmt: skip
    return found.and_those(more).some(np.argsort(row, kind="stable"))


def _nearby(proximity: Proximity, q: Matrix, margins: Vector, bounds: Matrix, time: float) -> NearInEach:
    """All pairs within `margins` (K,) [m] beyond their clearance at each of q (K, n).

    The distances are known to be at least `bounds` (K, P) [m].
    """
    plain, some_clusters = proximity.plain, len(proximity.clusters) > 0 and len(q) > 0
    needed = proximity.clearance + margins[:, None]
    if some_clusters:
        expected = proximity.clusters.expect(q, time, needed=needed[:, plain:], sunk=True)
        bounds = np.column_stack((bounds[:, :plain], np.fmax(bounds[:, plain:], expected)))
    found = proximity.near_in_each_unchecked(q, margins, bounds)
    if found is None:
        return _near_one_by_one(proximity, q, margins, bounds, time)
    if not some_clusters:
        return found
    lower = bounds[:, plain:]
    rows = np.flatnonzero((lower <= needed[:, plain:]).any(axis=1)).tolist()
    near = [proximity.near_clusters_unchecked(q[row], float(margins[row]), lower[row], time=time) for row in rows]
    if not rows:
        return replace(found, lower=np.column_stack((found.lower, lower)))
    more = _joined(lower, rows, near, q.shape[1])
    order = np.argsort(np.append(found.row, more.row), kind="stable")
    return NearInEach(
        np.column_stack((found.lower, lower)), np.append(found.row, more.row)[order],
        np.append(found.pair, more.pair)[order], np.append(found.distance, more.distance)[order],
        np.concatenate((found.gradient, more.gradient))[order],
    )  # fmt: skip


def _near_one_by_one(proximity: Proximity, q: Matrix, margins: Vector, bounds: Matrix, time: float) -> NearInEach:
    """As `_nearby`, with one measurement for each configuration."""
    known = np.fmax(bounds, list(proximity.bounds_unchecked(q))) if len(q) else bounds
    lower, near = known.copy(), list[Nearby]()
    for row, margin in enumerate(margins.tolist()):
        near.append(proximity.at(q[row], time=time, margin=margin, known=known[row]))
        lower[row] = proximity.found_unchecked
    return _joined(lower, range(len(q)), near, q.shape[1])


def _joined(lower: Matrix, rows: Sequence[int], near: Sequence[Nearby], n: int) -> NearInEach:
    """The pairs `near` in each of the configurations `rows`; `lower` (N, P) are bounds of distances in all of them."""
    return NearInEach(
        lower, np.repeat(np.array(rows, dtype=np.intp), [len(one) for one in near]),
        np.concatenate([np.zeros(0, dtype=np.intp), *(one.pair for one in near)]),
        np.concatenate([np.zeros(0), *(one.distance for one in near)]),
        np.concatenate([np.zeros((0, n)), *(one.gradient for one in near)]),
    )  # fmt: skip
