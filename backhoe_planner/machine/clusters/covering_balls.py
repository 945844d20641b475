"""Balls that cover a convex piece: their distances from anything bound that of the piece."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine.shape.shapes import Piece

_SMALL = 0.02  # m, half edge of a part that needs no smaller balls; chosen
_MOST_BALLS = 24  # that cover one piece; chosen: more are tighter, and take longer


def covering_balls(piece: Piece) -> tuple[Matrix, float]:
    """(k, 3) centres and a radius [m]: balls that cover a link's piece, in its body's frame."""
    R, middle, half, radius = _box_around(piece) or (np.eye(3), np.zeros(3), np.zeros(3), 0.0)
    counts, cell = np.ones(3, dtype=int), half.copy()
    while cell.max() > max(radius, _SMALL):
        longest = int(np.argmax(cell))
        if counts.prod() // counts[longest] * (counts[longest] + 1) > _MOST_BALLS:
            break
        counts[longest] += 1
        cell[longest] = half[longest] / counts[longest]
    places = np.array(list(np.ndindex(*counts.tolist())), dtype=float)
    centres = middle + ((2.0 * places + 1.0) * cell - half) @ R.T
    return centres, float(np.linalg.norm(cell)) + radius


def _box_around(piece: Piece) -> tuple[Matrix, Vector, Vector, float] | None:
    """The box around a piece's hull in its own axes: R (3, 3), middle (3,), half edges (3,), and radius [m].

    None for a half-space.
    """
    if not len(piece.hull):
        return None
    R = piece.placement.rotation
    own = piece.hull @ R
    low, high = own.min(axis=0), own.max(axis=0)
    return R, R @ (0.5 * (low + high)), 0.5 * (high - low), piece.radius
