"""Three task rows and four joints: pseudo-inverse and null space in closed form.

With one joint to spare the null space is one line. Its direction z holds the 3 x 3
minors of J with alternating signs (the cross product in four dimensions), and by
Cauchy and Binet |z|^2 = det(J J^T). So

    J^+ = J^T adj(J J^T) / |z|^2,    N = z z^T / |z|^2

In plain numbers this costs a fraction of a decomposition of so small a matrix.
"""

from __future__ import annotations

import math

from backhoe_planner.arrays import Matrix, Vector

__all__ = ["resolve_on_null_line"]


def resolve_on_null_line(J: Matrix, xdot: Vector, *, threshold: float) -> tuple[list[float], list[float]] | None:
    """J^+ xdot (4 numbers), and the unit vector along which N projects (4 numbers).

    Parameters
    ----------
    J: (3, 4) task Jacobian.
    xdot: (3,) task velocity.
    threshold: None is given back unless the smallest singular value of J is known to be larger.

    Of the eigenvalues of J J^T the smallest is at least det / (trace / 2)^2, because the
    product of the other two is at most the square of half their sum.
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
    if not det > (threshold * half) ** 2:
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
