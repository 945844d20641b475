"""New boxes of a cluster around a link: their distances, and what is proven with them over the braking path.

Boxes contain more than the cells that they represent, and different boxes of the same cells contain different parts of
the space around them. So new boxes may prove less for the braking path than the previous ones did. What was proven for
the cells remains proven.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.live.boxes.box_places import SLACK
from backhoe_planner.live.boxes.cluster_pairs import BoxSearch, ClusterPairs
from backhoe_planner.live.braking.braking_path import BrakingPath, Placements
from backhoe_planner.live.braking.joint_bounds import TOLERANCE
from backhoe_planner.live.clearance.pair_bounds import PairBounds
from backhoe_planner.live.planes.close_look import proven_along
from backhoe_planner.live.planes.cluster_boxes import find_boxes, keep_boxes, put_back_boxes, put_boxes, search_boxes
from backhoe_planner.live.planes.separation import Separation

_ROOM = 0.1  # m beyond their clearance at which the planes of boxes are not examined; chosen


class BoxBounds:
    """Finds the boxes of clusters again, and updates the bounds of their pairs.

    Parameters
    ----------
    separation, bounds: the pairs, and the bounds of their distances.

    Attributes
    ----------
    short: links and clusters whose new boxes prove less for the braking path than must be kept. The proof by the
        previous boxes still holds, so the machine can brake along the path; once it stands, the boxes have to be found
        again.
    """

    def __init__(self, separation: Separation, bounds: PairBounds) -> None:
        self._separation, self._bounds = separation, bounds
        # the search for boxes that is running, and the odometer's value of their link when it began
        self._search: tuple[BoxSearch, float] | None = None
        self.short: list[ClusterPairs] = []

    def forget(self) -> None:
        """End the running search, because the pairs or their motion have changed."""
        self._search = None
        self.short = [one for one in self.short if one in self._separation.counting_clusters]

    def find(self, one: ClusterPairs, at: Placements, *, reach: float, path: BrakingPath | None = None) -> None:
        """Find again the boxes that represent a cluster around a link, at the placements' row 0.

        Parameters
        ----------
        reach: distance within which its cells count [m].
        path: the present braking path, if distances that must be kept along it were proven with the previous boxes;
            otherwise None.
        """
        if self._search is not None and self._search[0].one is one:
            self._search = None  # this search replaces the running one
        kept = float(self._bounds.required[one.pairs].min())
        if self._put(one, at, reach, is_new=path is None) and path is not None:
            self._prove(one, kept, at, reach=reach, path=path)

    def search(self, one: ClusterPairs, at: Placements, *, reach: float) -> bool:
        """Begin to find these boxes bit by bit in the following steps; False if they have to be found at once."""
        search = search_boxes(
            self._separation, one, at, reach=reach, exact=one.clearance + self._bounds.influence, slack=SLACK
        )
        self._search = None if search is None else (search, self._bounds.odometer(one.classes))
        return search is not None

    @property
    def searches(self) -> bool:
        """Whether boxes are being found bit by bit."""
        return self._search is not None

    def search_on(self, at: Placements, path: BrakingPath) -> None:
        """Do the next bit of the search, with parameters as for `find`; the last one installs the boxes."""
        assert self._search is not None
        search, odometer = self._search
        found = next(search.bits)
        if found is None:
            return
        self._search = None
        separation, bounds, one = self._separation, self._bounds, search.one
        kept, before = float(bounds.required[one.pairs].min()), keep_boxes(separation, one, self._columns)
        boxes = one.take(found, search.reach, search.found_at)
        if one.nearest <= 0.0:  # a link inside something needs the full search
            self.find(one, at, reach=search.reach, path=path)
            return
        came = bounds.odometer(one.classes) - odometer
        bounds.set_distance(one.pairs, put_boxes(separation, one, boxes) - came)
        bounds.note_renewed(one.pairs)
        self._prove(one, kept, at, reach=search.reach, path=path)
        if one in self.short:  # the previous boxes cover the path, and any motion until boxes are checked again
            put_back_boxes(separation, one, before, self._columns)
            bounds.look_at_all()
            self.short.remove(one)
            bounds.find_inside()

    @property
    def _columns(self) -> tuple[Array, ...]:
        """The data of all pairs that change with their boxes."""
        return *self._separation.plane_columns, *self._bounds.columns

    def _put(
        self, one: ClusterPairs, at: Placements, reach: float, *, is_new: bool = False, slack: float = SLACK
    ) -> bool:
        """Install the boxes of a cluster around a link that are found now, and note their distances.

        False if there are none, as before.
        """
        found = find_boxes(
            self._separation, one, at, reach=reach, exact=one.clearance + self._bounds.influence,
            is_new=is_new, slack=slack,
        )  # fmt: skip
        if found is None:
            return False
        self._bounds.set_distance(one.pairs, found)
        self._bounds.note_renewed(one.pairs)
        return True

    def _prove(self, one: ClusterPairs, kept: float, at: Placements, *, reach: float, path: BrakingPath) -> None:
        """Note the distances that are proven for new boxes over the present braking path.

        Parameters
        ----------
        kept: the least distance that the previous boxes have to keep [m].
        at, reach, path: as for `find`.
        """
        separation, bounds, pairs, own = self._separation, self._bounds, one.pairs, one.classes
        bound = bounds.lower_after(pairs, own, float(separation.travel[own].dot(np.abs(path.delta))))
        if self.short:
            self.short = [other for other in self.short if other is not one]
        if bound[bound.argmin()] >= one.clearance + _ROOM:
            bounds.set_proven(pairs, bound)
            bounds.required[pairs] = separation.clearance.take(pairs)
            if len(bounds.inside):
                bounds.find_inside()
            return
        at_rest = not path.delta.any()
        path.place(at)
        bound = proven_along(separation, pairs, path, at, path.time)
        if bound.min() < kept - TOLERANCE:
            # a box is nearer than all its cells. Without slack none is nearer here, but that needs more boxes, and
            # elsewhere on the path one may still be nearer, so they are only of use if they cover as much
            covered = one.covered
            self._put(one, at, reach, slack=0.0)
            if one.covered < covered and not at_rest:
                self._put(one, at, reach)
            bound = proven_along(separation, pairs, path, at, path.time)
        bounds.set_proven(pairs, bound)
        keeps = np.maximum(bound, kept)  # what was proven for the cells remains proven
        if bound.min() < kept - TOLERANCE:
            if at_rest:
                # no path would keep what was proven: the way out begins here
                keeps = bound
            else:
                self.short.append(one)
        bounds.required[pairs] = np.minimum(separation.clearance[pairs], keeps)
        bounds.find_inside()
