"""Balls that cover a convex piece: their distances from an object bound the piece's distance from it."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine.shape.shapes import Piece

_SMALL = 0.02  # m, half edge of a part that needs no smaller balls; chosen
_MOST_BALLS = 24  # balls for one piece; chosen: more give tighter bounds, and take longer


def covering_balls(piece: Piece, *, most: int = _MOST_BALLS) -> tuple[Matrix, float]:
    """(k, 3) centres and a radius [m]: up to `most` balls that cover a link's piece, in its body's frame."""
    R, middle, half, radius = box_around(piece) or (np.eye(3), np.zeros(3), np.zeros(3), 0.0)
    edges, counts = half.tolist(), [1, 1, 1]
    while True:
        cells = [edge / count for edge, count in zip(edges, counts, strict=True)]
        longest = cells.index(max(cells))
        more = [count + (axis == longest) for axis, count in enumerate(counts)]
        if cells[longest] <= max(radius, _SMALL) or more[0] * more[1] * more[2] > most:
            break
        counts = more
    places = np.indices(counts).reshape(3, -1).T
    centres = middle + ((2.0 * places + 1.0) * cells - half) @ R.T
    return centres, float(np.linalg.norm(cells)) + radius


def box_around(piece: Piece) -> tuple[Matrix, Vector, Vector, float] | None:
    """The box around a piece's hull in its own axes: R (3, 3), middle (3,), half edges (3,), and radius [m].

    None for a half-space.
    """
    if not len(piece.hull):
        return None
    R = piece.placement.rotation
    own = piece.hull @ R
    low, high = own.min(axis=0), own.max(axis=0)
    return R, R @ (0.5 * (low + high)), 0.5 * (high - low), piece.radius
