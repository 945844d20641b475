"""Pseudo-inverses and the null-space projector.

The inverse for the task and the one in the projector are different. The first may be
damped near a singularity, where an exact inverse gives infinite rates. The projector
N = I - J^+ J must not be damped, because null-space terms would then leak into the task. It is
made from the undamped inverse, truncated at the numerical rank.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import eigenpy
import numpy as np

from backhoe_planner.arrays import Matrix, Vector

UNDAMPED = 0.08  # m/rad or rad/rad; chosen: damping sets in where the smallest singular value is below this
LARGEST_DAMPING = UNDAMPED  # lambda where the smallest singular value is 0; chosen: J^+ stays within 1 / 0.08
RANK_TOLERANCE = 1e-4  # part of the largest singular value; chosen: smaller ones count as 0 in the projector
_ROUNDING = 1e-10  # part of the scale of a matrix: singular values below are rounding


class TaskInverse(NamedTuple):
    """Inverse and null-space projector of a task Jacobian (m, n).

    Attributes
    ----------
    J: (m, n) the Jacobian.
    inverse: (n, m) J^+, damped near a singularity.
    projector: (n, n) N = I - J^+ J with the undamped, truncated J^+; never damped.
    damping: lambda that was used; 0 away from singularities.
    """

    J: Matrix
    inverse: Matrix
    projector: Matrix
    damping: float


def pseudo_inverse(J: Matrix, *, scale: float | None = None) -> Matrix:
    """The Moore-Penrose inverse J^+ of equation (3), by singular values; (n, m).

    Parameters
    ----------
    scale: size relative to which singular values count as rounding; by default the largest
        of them. A product such as J_o N needs the size of its factor J_o: if the null
        space cannot move the point at all, J_o N should be 0 but is rounding, which
        relative to itself looks like full rank.
    """
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    kept = s > _ROUNDING * (s[0] if scale is None else scale)
    return np.asarray((Vt[kept].T / s[kept]) @ U[:, kept].T)


def resolve(J: Matrix) -> TaskInverse:
    """J^+ and N of a task Jacobian J (m, n), m <= n or not.

    The damping grows smoothly from 0 as the smallest singular value falls below 0.08
    (Nakamura and Hanafusa 1986; Chiaverini 1997).
    """
    square = J.dot(J.T)
    if len(J) == 3 and (inverted := _invert_if_undamped(square.tolist())) is not None:
        inverse = J.T.dot(inverted)
        return TaskInverse(J, inverse, _eye(J.shape[1]) - inverse.dot(J), 0.0)
    solver = eigenpy.SelfAdjointEigenSolver(square)
    U = solver.eigenvectors()
    s = np.sqrt(np.maximum(solver.eigenvalues(), 0.0))
    smallest = float(s[0])
    if smallest > RANK_TOLERANCE * float(s[-1]):
        scaled = U / s
    else:
        kept = s > RANK_TOLERANCE * s[-1]
        scaled = U[:, kept] / s[kept]
    V = J.T.dot(scaled)  # right singular vectors, so that J^+ = V scaled^T
    projector = _eye(J.shape[1]) - V.dot(V.T)
    if smallest >= UNDAMPED:
        return TaskInverse(J, V.dot(scaled.T), projector, 0.0)
    damping = LARGEST_DAMPING * math.sqrt(1.0 - (smallest / UNDAMPED) ** 2)
    inverse = J.T @ ((U / (s * s + damping * damping)) @ U.T)
    return TaskInverse(J, inverse, projector, damping)


def _invert_if_undamped(square: list[list[float]]) -> Matrix | None:
    """(3, 3) the inverse of S = J J^T if J is known to need no damping; otherwise None.

    The smallest eigenvalue of S is at least det / (trace / 2)^2, see `resolve_on_null_line`.
    """
    (a, b, c), (_, d, e), (_, _, f) = square
    ad_a, ad_b, ad_c = d * f - e * e, c * e - b * f, b * e - c * d  # of the adjugate
    det = a * ad_a + b * ad_b + c * ad_c
    if not det > (UNDAMPED * 0.5 * (a + d + f)) ** 2:
        return None
    ad_d, ad_e, ad_f = a * f - c * c, b * c - a * e, a * d - b * b
    return np.array(((ad_a, ad_b, ad_c), (ad_b, ad_d, ad_e), (ad_c, ad_e, ad_f))) / det


def resolve_on_null_line(J: Matrix, xdot: Vector) -> tuple[list[float], list[float]] | None:
    """J^+ xdot (4 numbers), and the unit vector along which N projects (4 numbers).

    None unless the smallest singular value of J is known to be so large that J^+ needs no damping.

    Parameters
    ----------
    J: (3, 4) task Jacobian.
    xdot: (3,) task velocity.

    The null space is one line. Its direction z holds the 3 x 3 minors of J with alternating
    signs (the cross product in four dimensions), and by Cauchy and Binet |z|^2 = det(J J^T). So

        J^+ = J^T adj(J J^T) / |z|^2,    N = z z^T / |z|^2

    The smallest eigenvalue of J J^T is at least det / (trace / 2)^2, because the
    product of the other two is at most the square of half their sum. In plain numbers this
    takes a fraction of the time of a decomposition of so small a matrix.
    """
    (a0, a1, a2, a3), (b0, b1, b2, b3), (c0, c1, c2, c3) = J.tolist()
    x, y, w = xdot.tolist()
    bc01, bc02, bc03 = b0 * c1 - b1 * c0, b0 * c2 - b2 * c0, b0 * c3 - b3 * c0
    bc12, bc13, bc23 = b1 * c2 - b2 * c1, b1 * c3 - b3 * c1, b2 * c3 - b3 * c2
    z0 = a1 * bc23 - a2 * bc13 + a3 * bc12
    z1 = -(a0 * bc23 - a2 * bc03 + a3 * bc02)
    z2 = a0 * bc13 - a1 * bc03 + a3 * bc01
    z3 = -(a0 * bc12 - a1 * bc02 + a2 * bc01)
    det = z0 * z0 + z1 * z1 + z2 * z2 + z3 * z3
    aa, bb, cc = (
        a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3,
        b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3,
        c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3,
    )
    half = 0.5 * (aa + bb + cc)
    if not det > (UNDAMPED * half) ** 2:
        return None
    ab = a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3
    ac = a0 * c0 + a1 * c1 + a2 * c2 + a3 * c3
    bc = b0 * c0 + b1 * c1 + b2 * c2 + b3 * c3
    ab_, ac_, bc_ = ac * bc - ab * cc, ab * bc - ac * bb, ab * ac - aa * bc  # of the adjugate
    p = ((bb * cc - bc * bc) * x + ab_ * y + ac_ * w) / det
    r = (ab_ * x + (aa * cc - ac * ac) * y + bc_ * w) / det
    s = (ac_ * x + bc_ * y + (aa * bb - ab * ab) * w) / det
    size = math.sqrt(det)
    return (
        [a0 * p + b0 * r + c0 * s, a1 * p + b1 * r + c1 * s, a2 * p + b2 * r + c2 * s, a3 * p + b3 * r + c3 * s],
        [z0 / size, z1 / size, z2 / size, z3 / size],
    )


@lru_cache(maxsize=32)
def _eye(n: int) -> Matrix:
    identity = np.eye(n)
    identity.setflags(write=False)
    return identity
