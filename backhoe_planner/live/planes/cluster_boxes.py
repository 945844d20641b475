"""The boxes that represent a cluster's cells near a link, as the bodies of its pairs.

A cluster has a fixed number of pairs with each link (`ClusterPairs`). When its boxes are found, they become the bodies
of the first of these pairs, each with the plane that was found with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Array, Vector
from backhoe_planner.live.boxes.box_places import put_planes
from backhoe_planner.live.boxes.cluster_pairs import BoxSearch, ClusterPairs, KeptBoxes
from backhoe_planner.live.boxes.placed_piece import PlacedPiece
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.planes.separation import FAR, Separation
from backhoe_planner.machine import Part

_NO_BOXES = np.zeros((0, 50))


def find_boxes(
    separation: Separation, one: ClusterPairs, at: Placements, *, reach: float, exact: float, slack: float,
    is_new: bool,
) -> Vector | None:  # fmt: skip
    """Find again the boxes that represent a cluster around a link; return the distance of each of its pairs [m].

    None if there are no boxes now and before: all that is known about its pairs remains true.

    Parameters
    ----------
    at: the placements of the bodies; the first counts.
    reach: distance within which its cells count [m].
    exact: distance up to which boxes are to be as exact as cells [m].
    slack: see `ClusterPairs.find`.
    is_new: whether nothing is known about it from the step before.
    """
    pose = at.T[0, separation.own.joint[one.piece]]
    parts = one.find(pose, separation.shifts[one.number], reach, exact=exact, slack=slack, is_new=is_new)
    one.found_at = pose[:3].copy()
    if not (parts or one.boxes or is_new):
        separation.places.note(one)
        return None
    return put_boxes(separation, one, parts)


def search_boxes(
    separation: Separation, one: ClusterPairs, at: Placements, *, reach: float, exact: float, slack: float
) -> BoxSearch | None:
    """Begin to find these boxes bit by bit; None if they have to be found at once. Parameters as for `find_boxes`."""
    pose = at.T[0, separation.own.joint[one.piece]]
    return one.search(pose, separation.shifts[one.number], reach, exact=exact, slack=slack)


def put_boxes(separation: Separation, one: ClusterPairs, parts: Sequence[Part]) -> Vector:
    """Let these boxes represent a cluster around a link; return the distance of each of its pairs by them [m]."""
    shift = separation.shifts[one.number]
    one.boxes = len(parts)
    one.witnesses = np.empty((len(one.pairs), 6))
    separation.measured += len(parts)
    numbers = np.array([part.numbers for part in parts]) if parts else _NO_BOXES
    distance: Vector = put_planes(
        numbers, one.pairs, float(separation.own.radius[one.piece]), separation.velocity, shift, one.found_at, FAR,
        *separation.plane_columns, one.witnesses,
    )  # fmt: skip
    separation.put_bodies(one, [PlacedPiece(part, shift) for part in parts])
    return distance


def keep_boxes(separation: Separation, one: ClusterPairs, columns: Sequence[Array]) -> KeptBoxes:
    """Store the boxes of a link for `put_back_boxes`; `columns` are arrays of all pairs that change with them."""
    pairs = one.pairs
    return KeptBoxes(
        one.fields,
        [separation.body[pair] for pair in pairs.tolist()],
        [each.take(pairs, axis=0) for each in columns],
    )


def put_back_boxes(separation: Separation, one: ClusterPairs, kept: KeptBoxes, columns: Sequence[Array]) -> None:
    """Restore the boxes of a link that were stored, with the same `columns`."""
    vars(one).update(kept.fields)
    for each, values in zip(columns, kept.known, strict=True):
        each[one.pairs] = values
    separation.put_bodies(one, kept.bodies)
