"""The velocity that keeps the conditions of a task, such as the tilt of a cup, as far as what is in the way allows.

To a program that finds the velocity nearest to a wish among obstacles it adds one variable s, by which the conditions
may be missed, and its price:

    min_{v, s}  1/2 v^T H v + f^T v + W / 2 s^2
    s.t.        rows and bounds of v,   G v - s <= h,   s >= 0

W is far above what the wish counts, and far below the price of the obstacles' rows. So the machine first gives way
within what is to be kept, and misses it as little as it must where the rows leave nothing else.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import UNBOUNDED, Kind, QuadraticProgram, Rows

PRICE_KEPT = 100.0  # W; chosen: the wish counts up to 1, and rows of obstacles 5e3 and more for each (m/s)^2
_RANK = 1e-3  # part of the largest singular value below which rows count as dependent; chosen, octagons have rank 2
_NOTHING = 1e-12  # keeps quotients finite


def keeping(program: QuadraticProgram, kept: Rows) -> QuadraticProgram:
    """The program (n,) with a further variable, by which the rows `kept` (K, n) may be missed, at its end."""
    n = len(program.f)
    H = np.zeros((n + 1, n + 1))
    H[:n, :n], H[n, n] = program.H, PRICE_KEPT
    missed = kept._replace(G=np.hstack((kept.G, np.full((len(kept.h), 1), -1.0))), kind=Kind.HARD)
    rows = (block._replace(G=np.hstack((block.G, np.zeros((len(block.h), 1))))) for block in program.rows)
    return QuadraticProgram(
        H=H,
        f=np.append(program.f, 0.0),
        low=np.append(program.low, 0.0),
        high=np.append(program.high, UNBOUNDED),
        rows=(*rows, missed),
    )


def breaks(kept: Rows | None, v: Vector, tolerance: float) -> bool:
    """Whether there are rows that v (n,) does not keep."""
    return kept is not None and not kept.are_kept_by(v, tolerance)


def authority_beside(near: Matrix, G: Matrix, acceleration: Vector) -> Vector:
    """(K,) how fast joints with an acceleration (n,) can change each rate G v (K, n) while `near` v (M, n) stays.

    It is that in the direction that is nearest to the one in which the rate changes most.
    """
    scaled = G * acceleration
    if len(near):
        fixed = near * acceleration
        scaled_beside = scaled - scaled @ np.linalg.pinv(fixed, rcond=_RANK) @ fixed
    else:
        scaled_beside = np.sign(scaled)
    most = np.maximum(np.abs(scaled_beside).max(axis=1), _NOTHING)
    return np.asarray(np.einsum("kn,kn->k", scaled, scaled_beside) / most)
