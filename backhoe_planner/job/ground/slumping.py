"""Slumping: loose soil that is steeper than its angle of repose slides until it is at rest.

If neighbouring columns (each has eight neighbours) differ by more than the angle of repose allows, loose soil moves
from the higher to the lower, at most as much as there is. Pairs that share no column move at once, so that each step
lowers the soil's centre of mass and keeps its volume. Undisturbed soil stays, even if upright: this model does not
say how long a trench wall remains standing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.errors import check_kind
from backhoe_planner.job.ground.terrain import Terrain

# of the drop between neighbours at the angle of repose: half a degree; chosen. Soil that is too steep by less than
# half of it stays, so that a heap at the angle of repose does not move
_WITHIN = 0.02
_MOST_ROUNDS = 4_000  # chosen: a heap of 2 m^3 that collapses from one column takes some 1,000
_MARGIN = 8  # columns around the changed area that are included at first; chosen
_MORE = 24  # columns by which the area grows if soil reaches its border; chosen
_ROUNDS_BETWEEN = 8  # between two checks whether the soil is at rest; chosen
# rows and columns from one neighbour to the other: two straight pairs, two diagonal ones
_WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))


def slumped(terrain: Terrain, low: Vector | None = None, high: Vector | None = None) -> Terrain:
    """The ground after its loose soil has come to rest; the volume is kept to rounding.

    Parameters
    ----------
    low, high: (2,) corners of the rectangle in which soil may not be at rest [m]; by default everywhere.

    Raises
    ------
    InputError: `terrain` is not a Terrain.
    """
    check_kind(terrain, Terrain, key="terrain")
    low, high = terrain.low if low is None else low, terrain.high if high is None else high
    rows, columns = terrain.columns_within(low, high, margin=_MARGIN * terrain.cell)
    if rows.stop - rows.start < 2 or columns.stop - columns.start < 2 or not terrain.loose[rows, columns].any():
        return terrain
    drop = math.tan(terrain.repose) * terrain.cell
    loose = terrain.loose.copy()
    while True:
        own = loose[rows, columns]
        before = own.copy()
        settle(terrain.bank[rows, columns], own, drop)
        spread = own != before
        wider = [
            slice(max(one.start - _MORE * bool(first), 0), min(one.stop + _MORE * bool(last), count))
            for one, count, first, last in (
                (rows, loose.shape[0], spread[:2].any(), spread[-2:].any()),
                (columns, loose.shape[1], spread[:, :2].any(), spread[:, -2:].any()),
            )
        ]
        if [rows, columns] == wider:
            break
        rows, columns = wider
    return terrain if (loose == terrain.loose).all() else terrain.with_layers(terrain.bank, loose)


def settle(bank: Matrix, loose: Matrix, drop: float) -> None:
    """Bring loose soil to rest, in place.

    Parameters
    ----------
    bank, loose: (rows, columns) height of the fixed soil, and thickness of the loose soil [m].
    drop: height difference between neighbours at the angle of repose [m].
    """
    pairs = [
        (bank[a], bank[b], loose[a], loose[b], (1.0 + 0.5 * _WITHIN) * drop * math.hypot(*way))
        for way in _WAYS for a, b in _apart(bank.shape, way)
    ]  # fmt: skip
    for turn in range(_MOST_ROUNDS):
        worst = 0.0
        for bank_a, bank_b, loose_a, loose_b, allowed in pairs:
            if not bank_a.size:
                continue
            over = bank_a + loose_a
            over -= bank_b
            over -= loose_b
            # positive: soil moves from a to b
            go = 0.5 * (over - np.minimum(np.maximum(over, -allowed), allowed))
            np.minimum(go, loose_a, out=go)
            np.maximum(go, -loose_b, out=go)
            if turn % _ROUNDS_BETWEEN == 0:
                worst = max(worst, float(np.abs(go).max()) / allowed)
            loose_a -= go
            loose_b += go
        if turn % _ROUNDS_BETWEEN == 0 and worst <= 0.5 * _WITHIN:
            break
    np.maximum(loose, 0.0, out=loose)


def _apart(shape: tuple[int, ...], way: tuple[int, int]) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Two sets of pairs of neighbours; no two pairs of one set share a column."""
    rows, columns = shape
    down, right = way
    for first in (0, 1):
        if down:
            a = slice(first, rows - 1, 2)
            b = slice(first + 1, rows, 2)
            left = slice(max(-right, 0), columns - max(right, 0))
            yield (a, left), (b, slice(max(right, 0), columns - max(-right, 0)))
        else:
            yield (slice(None), slice(first, columns - 1, 2)), (slice(None), slice(first + 1, columns, 2))
