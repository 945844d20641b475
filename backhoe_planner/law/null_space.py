"""Pseudo-inverses and the null-space projector.

Two things are kept apart that are often mixed. The inverse that serves the task may
be damped near a singularity, where an exact one asks for infinite rates. The
projector N = I - J^+ J must not be: a damped one lets the null-space terms leak into
the task. It is made from the undamped inverse, truncated at the numerical rank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import eigenpy
import numpy as np

from backhoe_planner.arrays import Matrix, Vector

__all__ = ["TaskInverse", "pseudo_inverse", "resolve"]


RANK_TOLERANCE = 1e-4  # of the largest singular value
_ROUNDING = 1e-10  # of the scale of a matrix: singular values below are rounding


@dataclass(frozen=True)
class TaskInverse:
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


def pseudo_inverse(J: Matrix, *, scale: float | None = None) -> Matrix:
    """The Moore-Penrose inverse J^+ of equation (3), by singular values; (n, m).

    Parameters
    ----------
    scale: size beside which singular values count as rounding; by default the largest
        of them. A product such as J_o N needs that of its factor J_o: where the null
        space cannot move the point at all, J_o N should be 0 and is rounding, which
        beside itself looks like full rank.
    """
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    kept = s > _ROUNDING * (s[0] if scale is None else scale)
    return np.asarray((Vt[kept].T / s[kept]) @ U[:, kept].T)


def resolve(J: Matrix, *, threshold: float = 0.08, largest_damping: float = 0.08) -> TaskInverse:
    """J^+ and N of a task Jacobian (m, n), m <= n or not.

    Parameters
    ----------
    threshold: smallest singular value below which damping sets in.
    largest_damping: lambda where the smallest singular value is 0.

    The damping grows smoothly from 0 as the smallest singular value falls
    (Nakamura and Hanafusa 1986; Chiaverini 1997).
    """
    solver = eigenpy.SelfAdjointEigenSolver(J @ J.T)
    U = solver.eigenvectors()
    s = np.sqrt(np.maximum(solver.eigenvalues(), 0.0))
    smallest = float(s[0])
    full_rank = smallest > RANK_TOLERANCE * float(s[-1])
    if full_rank:
        scaled = U / s
    else:
        kept = s > RANK_TOLERANCE * s[-1]
        scaled = U[:, kept] / s[kept]
    V = J.T @ scaled  # right singular vectors, so that J^+ = V scaled^T
    projector = _eye(J.shape[1]) - V @ V.T
    if smallest >= threshold:
        return TaskInverse(inverse=V @ scaled.T, projector=projector, singular_values=s, damping=0.0)
    damping = largest_damping * math.sqrt(1.0 - (smallest / threshold) ** 2)
    inverse = J.T @ ((U / (s * s + damping * damping)) @ U.T)
    return TaskInverse(inverse=inverse, projector=projector, singular_values=s, damping=damping)


@lru_cache(maxsize=32)
def _eye(n: int) -> Matrix:
    identity = np.eye(n)
    identity.setflags(write=False)
    return identity
