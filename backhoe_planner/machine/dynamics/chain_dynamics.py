"""Torques and energies of a serial chain in many moments at once, and how the torques change.

Velocities, accelerations and forces of the bodies are vectors of six: first of the point of each body that passes the
chain's origin, then of its turning, all in the world's axes. S_i is what joint i adds to the velocity per rad/s or
m/s, v_i, a_i the velocity and the acceleration of body i (the base's is minus gravity), and I_i its inertia:

    f_i = I_i a_i + v_i x* (I_i v_i)        tau_i = S_i . sum of the f_k from i outward

With u_j = v_(j-1) x S_j, x_j = a_(j-1) x S_j + v_(j-1) x u_j, and sums I^c, B^c, F^c from the outer of the joints i, j
outward, B_k y = y x* (I_k v_k) + v_k x* (I_k y) - I_k (v_k x y), the derivatives are (Carpentier and Mansard 2018)

    dtau_i / dq_j = S_i . (I^c x_j + B^c u_j), and S_j x* F^c in the brackets if joint j is the outer one
    dtau_i / dv_j = S_i . (B^c S_j + 2 I^c u_j)        dtau_i / da_j = S_i . I^c S_j

All functions take the joints' positions, velocities and accelerations (B, n), and the constants of a `Chain`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine.kinematics.kinematics import chain_factors, chain_placements
from backhoe_planner.machine.robot import Robot
from backhoe_planner.native import compiled

_LOWER = np.tril_indices(3)  # xx, xy, yy, xz, yz, zz of a symmetric matrix


class Chain(NamedTuple):
    """The constants of a chain.

    Attributes
    ----------
    factors: (33, n) of `chain_factors`, with the chain's origin at the first joint; slides: (n,) 1 for a joint that
        slides, 0 for a hinge.
    bodies: (n, 10) of the body on each joint, in the joint's frame: its mass [kg], its centre of mass [m], and its
        inertia about that [kg m^2], as xx, xy, yy, xz, yz, zz.
    gravity: (3,) [m/s^2].
    """

    factors: Matrix
    slides: Vector
    bodies: Matrix
    gravity: Vector

    @classmethod
    def of(cls, robot: Robot, model: pin.Model) -> Chain:
        """That of a robot, with the bodies of a `model` of the same joints."""
        factors = chain_factors(robot)
        factors[-3:, 0] = 0.0
        inertias = list(model.inertias)[1:]
        bodies = [np.concatenate(([one.mass], one.lever, one.inertia[_LOWER])) for one in inertias]
        return cls(
            np.ascontiguousarray(factors), robot.prismatic.astype(float), np.array(bodies), model.gravity.linear.copy()
        )


@compiled
def chain_torques(
    q: Matrix, v: Matrix, a: Matrix, factors: Matrix, slides: Vector, bodies: Matrix, gravity: Vector, /
) -> Matrix:
    """(B, n) torques or forces of the joints [N m or N]."""
    S, inertias, _ = _placed(q, factors, slides, bodies)
    _, _, forces = _moved(S, inertias, v, a, gravity)
    outward = np.cumsum(forces[::-1], axis=0)[::-1]
    return np.ascontiguousarray(np.einsum("nbk,nbk->bn", S, outward))


@compiled
def chain_torque_slopes(
    q: Matrix, v: Matrix, a: Matrix, factors: Matrix, slides: Vector, bodies: Matrix, gravity: Vector, /
) -> tuple[Matrix, Array]:
    """(B, n) the torques, and (B, n, 3 n) their derivatives by q, then those by v and by a."""
    n = q.shape[1]
    S, inertias, _ = _placed(q, factors, slides, bodies)
    velocity, acceleration, forces = _moved(S, inertias, v, a, gravity)
    across = inertias @ _motion_product(velocity)
    bends = _force_product_with(np.einsum("nbij,nbj->nbi", inertias, velocity)) - across - np.swapaxes(across, 2, 3)
    M, B, F = (np.cumsum(each[::-1], axis=0)[::-1] for each in (inertias, bends, forces))
    slopes = np.empty((len(q), n, 3 * n))
    rest, falling = np.zeros((len(q), 6)), np.concatenate((-gravity, np.zeros(3)))
    for j in range(n):
        before = _motion_product(velocity[j - 1] if j else rest)
        u = _applied(before, S[j])
        x = _applied(_motion_product(acceleration[j - 1] if j else falling + rest), S[j]) + _applied(before, u)
        for i in range(n):
            k = max(i, j)
            of_q = _applied(M[k], x) + _applied(B[k], u)
            if i < j:
                of_q += _applied(_force_product_with(F[j]), S[j])
            of_v = _applied(B[k], S[j]) + 2.0 * _applied(M[k], u)
            for part, each in enumerate((of_q, of_v, _applied(M[k], S[j]))):
                slopes[:, i, part * n + j] = np.sum(S[i] * each, axis=1)
    return np.ascontiguousarray(np.einsum("nbk,nbk->bn", S, F)), slopes


@compiled
def chain_energies(
    q: Matrix, v: Matrix, factors: Matrix, slides: Vector, bodies: Matrix, gravity: Vector, /
) -> tuple[Vector, Vector]:
    """(B,), (B,) the kinetic energies, and the potential ones above the chain's origin [J]."""
    S, inertias, centres = _placed(q, factors, slides, bodies)
    velocity = np.cumsum(S * v.T[:, :, None], axis=0)
    kinetic = 0.5 * np.einsum("nbi,nbij,nbj->b", velocity, inertias, velocity)
    return kinetic, np.asarray(-np.einsum("n,nbi,i->b", bodies[:, 0], centres, gravity))


def _placed(q: Matrix, factors: Matrix, slides: Vector, bodies: Matrix) -> tuple[Array, Array, Array]:
    """S (n, B, 6) of the joints, the inertias (n, B, 6, 6) of their bodies, and centres of mass (n, B, 3), world."""
    joints = np.ascontiguousarray(q.T)
    axes, origins, rotations, _, _ = chain_placements(
        joints, np.sin(joints), 1.0 - np.cos(joints), factors, slides, np.zeros((4, 3))
    )
    axes, origins = axes.transpose(0, 2, 1), origins.transpose(0, 2, 1)
    R = rotations.transpose(0, 3, 2, 1)
    turning = 1.0 - slides[:, None, None]
    S = np.concatenate((turning * np.cross(origins, axes) + (1.0 - turning) * axes, turning * axes), axis=2)
    mass, own = bodies[:, 0, None, None, None], np.empty((len(bodies), 1, 3, 3))
    lower = np.tril_indices(3)
    own[:, 0, lower[0], lower[1]] = own[:, 0, lower[1], lower[0]] = bodies[:, 4:]
    centres = origins + _applied(R, bodies[:, None, 1:4])
    inertias, cross = np.zeros((*S.shape, 6)), _cross_matrix(centres)
    inertias[..., :3, :3] = mass * np.eye(3)
    inertias[..., :3, 3:], inertias[..., 3:, :3] = -mass * cross, mass * cross
    inertias[..., 3:, 3:] = R @ own @ np.swapaxes(R, 2, 3) - mass * (cross @ cross)
    return S, inertias, centres


def _moved(S: Array, inertias: Array, v: Matrix, a: Matrix, gravity: Vector) -> tuple[Array, Array, Array]:
    """(n, B, 6) each: velocities, accelerations and forces of the bodies."""
    added = S * v.T[:, :, None]
    velocity = np.cumsum(added, axis=0)
    acceleration = np.cumsum(S * a.T[:, :, None] + _applied(_motion_product(velocity), added), axis=0)
    acceleration[..., :3] -= gravity
    forces = _applied(inertias, acceleration)
    forces += _applied(_force_product_with(_applied(inertias, velocity)), velocity)
    return velocity, acceleration, forces


def _applied(matrices: Array, vectors: Array) -> Array:
    """Each of `matrices` (..., i, j) times its vector (..., j)."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _cross_matrix(x: Array) -> Array:
    """(..., 3, 3) the matrices of x (..., 3) times another vector."""
    found = np.zeros((*x.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        found[..., k, j], found[..., j, k] = x[..., i], -x[..., i]
    return found


def _motion_product(y: Array) -> Array:
    """(..., 6, 6) the matrices of y x z, for motions y (..., 6) and z."""
    found, turning = np.zeros((*y.shape, 6)), _cross_matrix(y[..., 3:])
    found[..., :3, :3] = found[..., 3:, 3:] = turning
    found[..., :3, 3:] = _cross_matrix(y[..., :3])
    return found


def _force_product_with(f: Array) -> Array:
    """(..., 6, 6) the matrices of y x* f, for motions y and forces f (..., 6)."""
    found, pull = np.zeros((*f.shape, 6)), -_cross_matrix(f[..., :3])
    found[..., :3, 3:] = found[..., 3:, :3] = pull
    found[..., 3:, 3:] = -_cross_matrix(f[..., 3:])
    return found
