"""Pseudo-inverses and the null-space projector.

Two things are kept apart that are often mixed. The inverse that serves the task may
be damped near a singularity, where an exact one asks for infinite rates. The
projector N = I - J^+ J must not be: a damped one lets the null-space terms leak into
the task. It is made from the undamped inverse, truncated at the numerical rank.
"""

from __future__ import annotations

from dataclasses import dataclass

import eigenpy
import numpy as np
from numpy.typing import NDArray

__all__ = ["Resolved", "pseudo_inverse", "resolve"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

RANK_TOLERANCE = 1e-4  # of the largest singular value


@dataclass(frozen=True)
class Resolved:
    """A task Jacobian taken apart.

    Attributes
    ----------
    inverse: (n, m) J^+, damped near a singularity.
    projector: (n, n) N = I - J^+ J with the undamped, truncated J^+; never damped.
    singular_values: (m,) ascending.
    damping: lambda that was used; 0 away from singularities.
    """

    inverse: Matrix
    projector: Matrix
    singular_values: Vector
    damping: float


def pseudo_inverse(J: Matrix) -> Matrix:
    """The Moore-Penrose inverse J^+ of equation (3), by singular values; (n, m)."""
    return np.asarray(np.linalg.pinv(J, rcond=1e-12))


def resolve(J: Matrix, *, threshold: float = 0.08, largest_damping: float = 0.08) -> Resolved:
    """J^+ and N of a task Jacobian (m, n), m <= n or not.

    Parameters
    ----------
    threshold: smallest singular value below which damping sets in.
    largest_damping: lambda where the smallest singular value is 0.

    The damping grows smoothly from 0 as the smallest singular value falls
    (Nakamura and Hanafusa 1986; Chiaverini 1997).
    """
    m, n = J.shape
    solver = eigenpy.SelfAdjointEigenSolver(J @ J.T)
    U = solver.eigenvectors()
    s2 = np.maximum(solver.eigenvalues(), 0.0)
    s = np.sqrt(s2)
    kept = s > RANK_TOLERANCE * s[-1]
    projector = np.eye(n)
    if kept.all():
        V = J.T @ (U / s)
    else:
        V = J.T @ (U[:, kept] / s[kept])
    projector -= V @ V.T
    damping = 0.0
    if s[0] < threshold:
        damping = largest_damping * float(np.sqrt(1.0 - (s[0] / threshold) ** 2))
    lambda2 = damping * damping
    if lambda2 == 0.0:
        inverse = J.T @ ((U / s2) @ U.T) if kept.all() else (V / s[kept]) @ U[:, kept].T
    else:
        inverse = J.T @ ((U / (s2 + lambda2)) @ U.T)
    return Resolved(inverse=inverse, projector=projector, singular_values=s, damping=damping)
