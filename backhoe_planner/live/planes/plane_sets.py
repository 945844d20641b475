"""The planes of the last close look at each pair.

As long as the pair's bodies are the same and the one that must not be touched has not moved, each of these
planes still bounds the pair's distance wherever the link is. A machine that brakes along its previous path
is where they were measured, so they mostly prove its path without a new measurement.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector

MOST_PLANES = 8  # kept for a pair; chosen, twice as many as one look measures
_NO_NORMALS, _NO_OFFSETS = np.zeros((0, 3)), np.zeros(0)


class _Kept(NamedTuple):
    """Planes, with the piece, the other body and its shift (3,) that they belong to."""

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
        """Normals (k, 3) and offsets (k,) [m] that are valid for a pair whose body is at `shift` (3,) [m]."""
        kept = self._kept.get(pair)
        if kept is None or kept.piece != piece or kept.body is not body or kept.shift != shift:
            return _NO_NORMALS, _NO_OFFSETS
        return kept.normals, kept.offsets

    def keep(
        self, pair: int, piece: int, body: object, shift: list[float] | None, normals: Matrix, offsets: Vector
    ) -> None:
        """Keep these planes in place of the pair's previous ones."""
        self._kept[pair] = _Kept(piece, body, shift, normals[:MOST_PLANES], offsets[:MOST_PLANES])
