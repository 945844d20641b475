"""Derivatives of values of moments by the joints, their velocities and their accelerations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.arrays import Array, Matrix

_NUDGES = (1e-5, 1e-5, 1e-4)  # of q, v and a; chosen between rounding error and curvature error


def moment_slopes(
    value: Callable[[Matrix, Matrix, Matrix], Matrix], q: Matrix, v: Matrix, a: Matrix
) -> tuple[Matrix, Array]:
    """(K, U) values at q, v, a (K, n), and (K, U, 3 n) their derivatives by q, v and a; one call for all of them."""
    places, n = q.shape
    here = np.hstack((q, v, a))
    nudges = np.repeat(_NUDGES, n)
    moved = np.concatenate((here[None], here[None] + np.diag(nudges)[:, None, :])).reshape(-1, 3 * n)
    found = value(moved[:, :n], moved[:, n : 2 * n], moved[:, 2 * n :]).reshape(3 * n + 1, places, -1)
    return found[0], np.asarray(np.moveaxis((found[1:] - found[0]) / nudges[:, None, None], 0, -1))
