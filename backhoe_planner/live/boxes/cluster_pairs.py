"""The pairs of a link with a cluster: a few boxes that represent all of the cluster's cells nearby.

A cluster has thousands of cells. A link only needs the cells within some reach, in a few boxes
(`Cluster.around`). They are found again when the link has moved too far from where they were
found, one link in a step; in between, each box is an obstacle like any other. Each link has a
fixed number of pairs for them. A pair without a box has a plane so far away that it never counts.

The boxes contain all cells that were within `covered` of the link when they were found. A cell
that is in none of them is at least that far away, minus the link's travel since then.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.boxes.placed_piece import PlacedPiece
from backhoe_planner.machine import Around, Cluster, Part, Piece

SLOTS = 16  # pairs of a link with a cluster; chosen: the ground, a wall and some clutter take 3 to 10
_REST = 1  # of these, for the remaining cells if more boxes would be needed
_CHANGES = "covered", "nearest", "found_at", "witnesses", "boxes", "was_inside"
_ROOM = 0.05  # m beyond the clearance that boxes should cover at least; chosen


class KeptBoxes(NamedTuple):
    """The stored boxes of a link.

    Attributes
    ----------
    fields: those of its `ClusterPairs` that change with them, by name.
    bodies: the body of each of its pairs.
    known: the data of its pairs, as rows of arrays of all pairs.
    """

    fields: dict[str, object]
    bodies: list[PlacedPiece | None]
    known: list[Array]


class BoxSearch(NamedTuple):
    """A running search for the boxes of one link around one cluster.

    Attributes
    ----------
    one: the link and the cluster.
    found_at: (3, 4) pose of the link's body in the world when the search began [m].
    reach: distance within which cells count [m].
    bits: of work; the last one yields what was found.
    """

    one: ClusterPairs
    found_at: Matrix
    reach: float
    bits: Iterator[Around | None]


@dataclass(eq=False)
class ClusterPairs:
    """The part of one cluster that is around the piece of one link.

    Attributes
    ----------
    number: with which the obstacle was added.
    piece: row of the robot's pieces.
    own: the piece.
    classes: row of `Separation.travel` that applies to the piece.
    clearance: to be kept [m].
    ball: centre (3,) and radius [m] of the space that the machine can reach, relative to where the obstacle was built.
    speed: of the obstacle [m/s].
    covered: distance from the link beyond which cells are in no box, when the boxes were found [m].
    nearest: the least distance from a box then [m].
    found_at: (3, 4) pose of the link's body in the world then [m].
    witnesses: (B, 6) for each box the critical point of the link, in the frame of its body, and the witness point
        on a cell, in the world, when they were found [m]; nan if it was measured from no cell.
    boxes: how many there are now.
    was_inside: whether the piece was in the ground or in a closed mesh, and touched no cell.
    balls: that cover the piece, centres (k, 3) and radius [m].
    pairs: their indices.
    """

    number: int
    cluster: Cluster
    piece: int
    own: Piece
    classes: int
    clearance: float
    ball: tuple[Vector, float]
    balls: tuple[Matrix, float]
    speed: float = 0.0
    covered: float = 0.0
    nearest: float = 0.0
    found_at: Matrix = field(default_factory=lambda: np.zeros((3, 4)))
    witnesses: Matrix = field(default_factory=lambda: np.full((1, 6), np.nan))
    boxes: int = 0
    was_inside: bool = False
    pairs: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    @property
    def fields(self) -> dict[str, object]:
        """The fields that change when boxes are found, by name."""
        return {name: getattr(self, name) for name in _CHANGES}

    def __post_init__(self) -> None:
        self._bounds = self.cluster.grid(*self.ball)

    def find(
        self, pose: Matrix, shift: Vector, reach: float, *, exact: float, slack: float, is_new: bool
    ) -> tuple[Part, ...]:
        """The boxes around the piece with its body at `pose` (4, 4), in coordinates of where the obstacle was built.

        Parameters
        ----------
        shift: (3,) of the obstacle from where it was built [m].
        reach: distance within which its cells count [m].
        exact: distance up to which boxes are to be as exact as cells [m].
        is_new: whether nothing is known about it from the step before.
        slack: part of the distance by which boxes may be nearer than their cells, see `Cluster.around`.
        """
        away = self._at_least(pose, shift)
        if away > reach:
            self.covered = self.nearest = away
            return ()
        T = pin.SE3(np.array(pose[:3, :3]), pose[:3, 3] - shift)
        ground = self.cluster.ground_under(self.own, T, reach) if is_new or self.was_inside else None
        parts = self._parts(T, reach, exact, ground, slack)
        if ground is None and self.nearest <= 0.0:
            ground = self.cluster.ground_under(self.own, T, reach)
            if ground is not None:
                parts = self._parts(T, reach, exact, ground, slack)
        if ground is not None:
            self.was_inside = True
            # the ground's face is valid wherever the piece is, so it lasts until the piece is nearly out
            self.nearest = abs(ground.reading.distance)
            return parts
        if self.nearest > 0.0 and self.cluster.solid.is_full and (is_new or self.was_inside):
            # a piece that touches no cell may still be inside the ground or a closed mesh
            inside = self.cluster.inside_of(self.own, T)
            self.was_inside = inside is not None
            if inside is not None:
                parts = (*parts[: SLOTS - 1], inside)
                self.nearest = inside.reading.distance
        return parts

    def _at_least(self, pose: Matrix, shift: Vector) -> float:
        """Lower bound of the distance from the piece, with parameters as for `find` [m]."""
        centres, radius = self.balls
        lower = self._bounds.lower(pose[:3, :3].dot(centres.T) + (pose[:3, 3] - shift)[:, None])
        return float(lower[lower.argmin()]) - radius

    def _parts(self, T: pin.SE3, reach: float, exact: float, ground: Part | None, slack: float) -> tuple[Part, ...]:
        """The boxes of all cells, after `ground` if there is one."""
        first = () if ground is None else (ground,)
        found = self.cluster.around(
            self.own,
            T,
            reach,
            ball=self.ball,
            most=SLOTS - _REST - len(first),
            exact=exact,
            ground=ground,
            slack=slack,
        )
        return self._take(found, reach, first)

    def _take(self, found: Around, reach: float, first: tuple[Part, ...] = ()) -> tuple[Part, ...]:
        """The boxes that were found, after those in `first`; note the distance that they cover."""
        parts, self.covered = (*first, *found.parts), found.covered
        if found.rest is not None and found.covered < min(reach, self.clearance + _ROOM):
            parts, self.covered = (*parts, found.rest), reach
        self.nearest = min((part.reading.distance for part in parts), default=found.covered)
        return parts

    def search(self, pose: Matrix, shift: Vector, reach: float, *, exact: float, slack: float) -> BoxSearch | None:
        """Find the boxes bit by bit, with parameters as for `find`; None if they have to be found at once.

        That is so if it is little work, if the piece is inside something, or if the obstacle moves.
        """
        if self.speed > 0.0 or self.was_inside or self.nearest <= 0.0 or self._at_least(pose, shift) > reach:
            return None
        T = pin.SE3(np.array(pose[:3, :3]), pose[:3, 3] - shift)
        bits = self.cluster.around_bit_by_bit(
            self.own, T, reach, ball=self.ball, most=SLOTS - _REST, exact=exact, slack=slack
        )
        return BoxSearch(self, pose[:3].copy(), reach, bits)

    def take(self, found: Around, reach: float, found_at: Matrix) -> tuple[Part, ...]:
        """The boxes that a search has found; `found_at` (3, 4) is the pose of the body when the search began."""
        self.found_at = found_at
        return self._take(found, reach)
