"""What stands around, and the planes that a pair was last looked at closely with.

As long as neither of its bodies is another one, and what it must not touch stands where it stood, each of
them still bounds the pair's distance wherever the link is. A machine that brakes along the path of
before is where they were measured, so that they mostly prove its path without a measurement.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Part
from backhoe_planner.machine.shape import shapes

MOST_PLANES = 8  # of a pair; chosen, twice as many as one look measures
_MOST_CORNERS = 64  # of an obstacle's piece that is looked at from the link's side; chosen, to bound the work
_NO_NORMALS, _NO_OFFSETS = np.zeros((0, 3)), np.zeros(0)


class Stand:
    """A piece of an obstacle, or a box around cells of one, and its `shift` (3,) from where it was built [m]."""

    def __init__(self, of: shapes.Piece | Part, shift: Vector | None = None) -> None:
        self._of = of
        self.shift = np.zeros(3) if shift is None else shift
        self._placed: tuple[list[float] | None, object] = None, None

    @cached_property
    def piece(self) -> shapes.Piece:
        """The piece where it was built; that of a box around cells is made when it is first asked for."""
        return self._of.piece if isinstance(self._of, Part) else self._of

    @property
    def corners(self) -> Matrix | None:
        """(k, 3) of it [m]; None where it has too many, or none."""
        hull = self.piece.hull
        return hull if 0 < len(hull) <= _MOST_CORNERS else None

    def place(self) -> object:
        """Coal's transform; it is made anew only after a shift."""
        shift = self.shift.tolist()
        if self._placed[0] != shift:
            R, t = self.piece.pose
            self._placed = (shift, shapes.transform(R, t + self.shift))
        return self._placed[1]


class _Kept(NamedTuple):
    """Planes, and the piece, the body and the shift (3,) of it that they are of."""

    piece: int
    body: object
    shift: list[float] | None
    normals: Matrix
    offsets: Vector


class PlaneSets:
    """Planes by pair, in the frames of the bodies that must not be touched."""

    def __init__(self) -> None:
        self._kept: dict[int, _Kept] = {}

    def of(self, pair: int, piece: int, body: object, shift: list[float] | None) -> tuple[Matrix, Vector]:
        """Normals (k, 3) and offsets (k,) [m] that hold for a pair whose body is at `shift` (3,) [m]."""
        kept = self._kept.get(pair)
        if kept is None or kept.piece != piece or kept.body is not body or kept.shift != shift:
            return _NO_NORMALS, _NO_OFFSETS
        return kept.normals, kept.offsets

    def keep(
        self, pair: int, piece: int, body: object, shift: list[float] | None, normals: Matrix, offsets: Vector
    ) -> None:
        """Keep these in place of the pair's others."""
        self._kept[pair] = _Kept(piece, body, shift, normals[:MOST_PLANES], offsets[:MOST_PLANES])
