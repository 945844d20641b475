"""The joint velocity by which the deepest violation falls fastest.

Of every obstacle (and of the machine with itself) the deepest violation is

    V = max over its violated pairs of (clearance - distance)

A pair that is less deep may become deeper, never deeper than V: several links that
stick in one obstacle need not leave it by the same side, and what would hold each of
them to its own depth would hold them all.

    max t   s.t.   g_i v + t <= k (V - depth_i)   for every violated pair

over the joint rates within reach; g_i is how fast a pair's distance falls. The term
with k lets what is far from being the deepest go its way, and takes hold of it
gradually, so that no row enters with a jump. Of all the best velocities the one
nearest to the wish is taken. Where no joint rate makes V smaller, t is 0.
"""

from __future__ import annotations

import daqp
import numpy as np
from numpy.typing import NDArray

__all__ = ["by_owner", "way_back"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]

_WISH = 1e-3  # weight of the wish beside the speed of the way back
_SOFT, _HARD = 8, 0  # daqp's senses
_UNBOUNDED = -1e30
_SMALLEST = 1e-12


def way_back(
    rows: Matrix,
    slack: Vector,
    *,
    target: Vector,
    low: Vector,
    high: Vector,
    fastest: float,
    soft_rows: Matrix,
    soft_bounds: Vector,
) -> tuple[Vector, float] | None:
    """The velocity by which the deepest violation falls fastest, and how fast that is [m/s].

    Parameters
    ----------
    rows: (R, n) how fast the gaps of the violated pairs' corners fall with the joints [m/rad].
    slack: (R,) k (V - depth) [m/s].
    target: (n,) the velocity that is wished.
    low, high: (n,) what the joints can do in this step.
    fastest: speed that is enough [m/s].
    soft_rows, soft_bounds: (S, n), (S,) `row @ v <= bound` for everything else.

    None where the solver fails.
    """
    n, hard, soft = len(target), len(slack), len(soft_bounds)
    # in parts of what the joints can change, so that a start from rest is as exact as any other
    middle, reach = 0.5 * (low + high), np.maximum(0.5 * (high - low), _SMALLEST)
    A = rows * reach
    scale = max(float(np.abs(A).sum(axis=1).max(initial=0.0)), _SMALLEST)
    B = soft_rows * reach
    size = np.maximum(np.abs(B).sum(axis=1), _SMALLEST)
    constraints = np.zeros((hard + soft, n + 1))
    constraints[:hard, :n], constraints[:hard, n] = A / scale, 1.0
    constraints[hard:, :n] = B / size[:, None]
    upper = np.concatenate(
        (
            np.ones(n),
            [fastest / scale],
            (slack - rows @ middle) / scale,
            (soft_bounds - soft_rows @ middle) / size,
        )
    )
    lower = np.full(n + 1 + hard + soft, _UNBOUNDED)
    lower[:n] = -1.0
    sense = np.full(n + 1 + hard + soft, _HARD, dtype=np.int32)
    sense[n + 1 + hard :] = _SOFT
    wished = np.minimum(np.maximum((target - middle) / reach, -1.0), 1.0)
    f = np.append(-_WISH * wished, -1.0)
    x, _, flag, _ = daqp.solve(_WISH * np.eye(n + 1), f, constraints, upper, lower, sense)
    if flag < 1 or not np.isfinite(x).all():
        return None
    return np.minimum(np.maximum(middle + reach * x[:n], low), high), float(x[n] * scale)


def by_owner(depth: Vector, owner: Indices) -> Vector:
    """(K,) of every pair the deepest of its obstacle."""
    deepest = np.zeros(len(depth))
    for number in set(owner.tolist()):
        own = owner == number
        deepest[own] = depth[own].max()
    return deepest
