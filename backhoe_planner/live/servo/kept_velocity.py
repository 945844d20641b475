"""The velocity that keeps the conditions of a task, such as the tilt of a cup, as far as what is in the way allows.

To a program that finds the velocity nearest to a wish among obstacles it adds one variable s, by which the conditions
may be missed, and its price:

    min_{v, s}  1/2 v^T H v + f^T v + W / 2 s^2
    s.t.        rows and bounds of v,   G v - s <= h,   s >= 0

W is far above what the wish counts, and far below the price of the obstacles' rows. So the machine first gives way
within what is to be kept, and misses it as little as it must where the rows leave nothing else. Rows for evading early
count between the wish and what is kept, each by itself.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.law import UNBOUNDED, Kind, QuadraticProgram, Rows

_PRICE_KEPT = 100.0  # W; chosen: the wish counts up to 1, and rows of obstacles 5e3 and more for each (m/s)^2
_PRICE_EARLY = 1.0  # the same of rows for evading early; chosen, far below W


def keeping(program: QuadraticProgram, kept: Rows, early: Rows | None = None) -> QuadraticProgram:
    """The program (n,) with further variables at its end, by which rows may be missed.

    One is for all rows `kept` (K, n), and there is one for each row of `early` (M, n).
    """
    n, more = len(program.f), 1 + (0 if early is None else len(early.h))
    blocks = [_without(block, more) for block in program.rows]
    blocks.append(_missed(kept, np.zeros(len(kept.h), dtype=np.intp), more))
    if early is not None and len(early.h):
        blocks.append(_missed(early, 1 + np.arange(len(early.h)), more))
    H = np.zeros((n + more, n + more))
    H[:n, :n] = program.H
    H.reshape(-1)[n * (n + more + 1) :: n + more + 1] = [_PRICE_KEPT, *[_PRICE_EARLY] * (more - 1)]
    return QuadraticProgram(
        H=H,
        f=np.append(program.f, np.zeros(more)),
        low=np.append(program.low, np.zeros(more)),
        high=np.append(program.high, np.full(more, UNBOUNDED)),
        rows=tuple(blocks),
    )


def _without(block: Rows, more: int) -> Rows:
    """The rows with `more` columns of zeros."""
    return block._replace(G=np.hstack((block.G, np.zeros((len(block.h), more)))))


def _missed(block: Rows, by: Indices, more: int) -> Rows:
    """The rows, each of which may be missed by one of `more` further variables, which `by` (K,) says."""
    wider = _without(block, more)
    wider.G[np.arange(len(by)), wider.G.shape[1] - more + by] = -1.0
    return wider._replace(kind=Kind.HARD)


def breaks(kept: Rows | None, v: Vector, tolerance: float) -> bool:
    """Whether there are rows that v (n,) does not keep."""
    return kept is not None and not kept.are_kept_by(v, tolerance)
