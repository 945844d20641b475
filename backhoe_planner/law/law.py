"""The paper's law, equations (1) to (12), as printed except for corrections 1 to 3.

    x_e   = f(theta)                                              (1)
    xdot_e = J_e v                                                (2)
    v     = J_e^+ xdot_e + (I - J_e^+ J_e) z                      (3)
    z     = [J_o N]^+ (xdot_o - J_o J_e^+ xdot_e)                 (4)
    v     = J_e^+ xdot_e + N [J_o N]^+ (xdot_o - J_o J_e^+ xdot_e)  (5)
    H_o   = N [J_o N]^+ (xdot_o - J_o J_e^+ xdot_e)               (10)
    H_k   = N [J_k N]^+ (xdot_k - J_k J_e^+ xdot_e)               (11)
    v     = s_e J_e^+ xdot_e + s_o H_o + sum_k s_k H_k            (12)

with N = I - J_e^+ J_e. Equation (1) is `Kinematics.at`, its derivative (2) is
`Configuration.jacobian`. The paper prints J_o^+ J_e in (4), (5), (10) and J_k^+ J_e in
(11), whose sizes do not fit; J_o J_e^+ and J_k J_e^+ are meant (Maciejewski and Klein
1985). `(J N)^+` is unbounded near configurations in which the null space cannot move the
point (and 0 exactly there). The law as printed has this property; `completed` removes it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law.null_space import pseudo_inverse


def projector(J_e: Matrix) -> Matrix:
    """(n, n) N = I - J_e^+ J_e of equation (3), for J_e (m, n)."""
    return np.eye(J_e.shape[1]) - pseudo_inverse(J_e) @ J_e


def general_solution(J_e: Matrix, xdot_e: Vector, z: Vector) -> Vector:
    """(n,) joint velocity of equation (3) for any z (n,)."""
    return pseudo_inverse(J_e) @ xdot_e + projector(J_e) @ z


def null_space_term(J_e: Matrix, xdot_e: Vector, J: Matrix, xdot: Vector) -> Vector:
    """(n,) H of equations (10) and (11): serve xdot = J v without moving the tip.

    Parameters
    ----------
    J_e: (m, n) tip Jacobian; xdot_e: (m,) tip velocity.
    J: (p, n) Jacobian J_o of a critical point, or J_k of the end of link k.
    xdot: (p,) velocity wanted of that point.
    """
    N = projector(J_e)
    scale = float(np.linalg.norm(J))
    return N @ pseudo_inverse(J @ N, scale=scale) @ (xdot - J @ pseudo_inverse(J_e) @ xdot_e)


def joint_velocity(
    J_e: Matrix, xdot_e: Vector, terms: Sequence[tuple[float, Matrix, Vector]], *, s_e: float = 1.0
) -> Vector:
    """(n,) joint velocity of equation (12).

    Parameters
    ----------
    terms: (gain, J, xdot) of every obstacle term (s_o, J_o, xdot_o) and every
        directionality term (s_k, J_k, xdot_k).
    s_e: gain of the primary term.
    """
    v = s_e * pseudo_inverse(J_e) @ xdot_e
    for gain, J, xdot in terms:
        v += gain * null_space_term(J_e, xdot_e, J, xdot)
    return np.asarray(v)
