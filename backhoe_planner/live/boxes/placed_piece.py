"""The placement of a piece of an obstacle, or of a box around an obstacle's cells."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Part
from backhoe_planner.machine.shape import shapes

_MOST_CORNERS = 64  # of an obstacle's piece that is examined in the link's frame; chosen, to bound the work


class PlacedPiece:
    """A piece of an obstacle, or a box around its cells, and its `shift` (3,) from where it was built [m]."""

    def __init__(self, of: shapes.Piece | Part, shift: Vector | None = None) -> None:
        self._of = of
        self.shift = np.zeros(3) if shift is None else shift
        self._placed: tuple[list[float] | None, object] = None, None

    @cached_property
    def piece(self) -> shapes.Piece:
        """The piece where it was built; the piece of a box around cells is made at the first access."""
        return self._of.piece if isinstance(self._of, Part) else self._of

    @property
    def corners(self) -> Matrix | None:
        """(k, 3) corners of the piece [m]; None if it has too many, or none."""
        hull = self.piece.hull
        return hull if 0 < len(hull) <= _MOST_CORNERS else None

    def place(self) -> object:
        """Coal's transform; it is only recomputed after a shift."""
        shift = self.shift.tolist()
        if self._placed[0] != shift:
            R, t = self.piece.pose
            self._placed = (shift, shapes.transform(R, t + self.shift))
        return self._placed[1]
