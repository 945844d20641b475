"""The joint velocity by which the deepest violation falls fastest.

For every obstacle (and for the machine with itself) the deepest violation is

    V = max over its violated pairs of (clearance - distance)

A pair that is less deep may become deeper, but never deeper than V: several links that are
stuck in one obstacle need not leave it on the same side, and if each were held to its own
depth, none could move.

    max t   s.t.   g_i v + t <= k (V - depth_i)   for every violated pair

over the joint rates within reach; g_i is how fast a pair's distance falls with the joints. The
term with k leaves pairs that are far from being the deepest free, and binds them gradually, so
that no row enters with a jump. Among all the best velocities the one nearest to the wish is
taken. If no joint rate makes V smaller, t is 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.law import UNBOUNDED, BindingSolution, Kind, QuadraticProgram, Rows, solve_with_binding_rows

SMALLEST = 1e-12  # below any rate or row that matters: keeps divisions finite
_LITTLE = 10.0  # weight of what is to change little; chosen: with it alone, a tenth of what the joints can is used
_WISH = 1e-3  # weight of the wish beside the speed of the fall; chosen, so that it only breaks ties


def way_back(
    rows: Matrix,
    slack: Vector,
    *,
    target: Vector,
    low: Vector,
    high: Vector,
    fastest: float,
    others: tuple[Rows, ...] = (),
    note: Callable[[BindingSolution | None], None] | None = None,
    little: Matrix | None = None,
) -> tuple[Vector, float] | None:
    """The velocity (n,) by which the deepest violation falls fastest, and how fast that is [m/s].

    Parameters
    ----------
    rows: (R, n) g, how fast the distances of the violated pairs fall with the joints [m/rad].
    slack: (R,) k (V - depth) [m/s].
    target: (n,) the wished velocity [rad/s or m/s].
    low, high: (n,) the velocities that the joints can reach in this step [rad/s or m/s].
    fastest: speed of the fall that is enough [m/s].
    others: rows of everything else.
    note: receives the solution, to count the work.
    little: (K, n) functions of the velocity that are to change little, such as the rate of a cup's tilt.

    Returns
    -------
    None if the solver fails.
    """
    n = len(target)
    # scaled by what the joints can change, so that a start from rest is as exact as any other
    middle, reach = 0.5 * (low + high), np.maximum(0.5 * (high - low), SMALLEST)
    scale = max(float(np.abs(rows * reach).sum(axis=1).max(initial=0.0)), SMALLEST)
    wished = np.minimum(np.maximum((target - middle) / reach, -1.0), 1.0)
    H, f = _WISH * np.eye(n + 1), np.append(-_WISH * wished, -1.0)
    if little is not None and len(little):
        K = little * reach
        size = max(float(np.abs(K).sum(axis=1).max()), SMALLEST)
        H[:n, :n] += (_LITTLE / size**2) * K.T @ K
        f[:n] += (_LITTLE / size**2) * K.T @ (little @ middle)
    program = QuadraticProgram(
        H=H,
        f=f,
        low=np.append(np.full(n, -1.0), -UNBOUNDED),
        high=np.append(np.ones(n), fastest / scale),
        rows=(
            Rows("violation", _with_speed(rows * reach / scale, 1.0), (slack - rows @ middle) / scale, Kind.HARD),
            *(_scaled(block, middle, reach) for block in others),
        ),
    )
    solution = solve_with_binding_rows(program)
    if note is not None:
        note(solution)
    if solution is None:
        return None
    v = middle + reach * solution.x[:n]
    return np.minimum(np.maximum(v, low), high), float(solution.x[n] * scale)


def _scaled(block: Rows, middle: Vector, reach: Vector) -> Rows:
    """The same conditions on u with v = middle + reach u, each row scaled to size 1, without the speed t."""
    G = block.G * reach
    size = np.maximum(np.abs(G).sum(axis=1), SMALLEST)
    return block._replace(G=_with_speed(G / size[:, None], 0.0), h=(block.h - block.G @ middle) / size)


def _with_speed(G: Matrix, coefficient: float) -> Matrix:
    """(K, n + 1) the rows with a column for the speed t."""
    return np.hstack((G, np.full((len(G), 1), coefficient)))


def by_owner(depth: Vector, owner: Indices) -> Vector:
    """(K,) for every pair the largest `depth` (K,) of all pairs with the same `owner` (K,)."""
    deepest = np.zeros(len(depth))
    for number in set(owner.tolist()):
        own = owner == number
        deepest[own] = depth[own].max()
    return deepest
