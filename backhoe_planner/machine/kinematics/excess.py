"""By how much differences of positions, or rotation vectors, are longer than a tolerance, and the derivatives."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector

_NO_LENGTH = 1e-12  # m or rad: a shorter vector has no direction, and is within any tolerance


def excess(off: Vector, tolerance: float) -> Vector:
    """(3,) a difference of positions [m], or a rotation vector [rad], shortened by `tolerance`, to no less than 0."""
    length = float(np.linalg.norm(off))
    return off * max(1.0 - tolerance / length, 0.0) if length > 0.0 else off


def excess_jacobian(off: Vector, tolerance: float) -> Matrix:
    """(3, 3) derivative of `excess` with respect to the vector."""
    return np.asarray(excess_jacobians(off[None], np.array([tolerance]))[0])


def excess_part(off: Array, tolerance: Array) -> Array:
    """(B,) the part of each vector (B, 3) by which it is longer than its `tolerance` (B,); 0 if it is not."""
    length = np.linalg.norm(off, axis=1)
    return np.asarray(np.maximum(1.0 - tolerance / np.maximum(length, _NO_LENGTH), 0.0))


def excess_jacobians(off: Matrix, tolerance: Vector) -> Array:
    """(B, 3, 3) derivatives of `excess` with respect to the vectors (B, 3), each with its tolerance (B,)."""
    length = np.linalg.norm(off, axis=1)
    beyond = length > tolerance
    found = np.zeros((len(off), 3, 3))
    axis = off[beyond] / length[beyond, None]
    part = (tolerance[beyond] / length[beyond])[:, None, None]
    found[beyond] = (1.0 - part) * np.eye(3) + part * (axis[:, :, None] * axis[:, None, :])
    return found
