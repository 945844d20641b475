"""Joint torques by inverse dynamics, and the power and energy of a motion.

    tau = M(q) a + C(q, v) v + g(q) - J_tip^T F

with F the external force on the tip, such as that of the soil. A payload is part of the last
body: its weight and its inertia are in M, C and g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.dynamics.chain_dynamics import Chain, chain_energies, chain_torque_slopes, chain_torques
from backhoe_planner.machine.robot import Robot
from backhoe_planner.native import is_compiled

GRAVITY = 9.81  # m/s^2


class Dynamics:
    """Inverse dynamics of one machine with a payload at its tip.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    payload: mass that the tip carries [kg], as a point.
    payload_at: (3,) position of that point from the tip, in the tip's axes [m]; at the tip by default.
    """

    def __init__(
        self, robot: Robot, *, payload: float = 0.0, payload_at: Sequence[float] | Vector | None = None
    ) -> None:
        at = None if payload_at is None else tuple(map(float, payload_at))
        self._model, self._chain = _loaded(robot, float(payload), at)
        self._data = self._model.createData()
        self._tip = robot.tip_frame

    def torques(self, q: Vector, v: Vector, a: Vector, *, tip_force: Vector | None = None) -> Vector:
        """(n,) joint torques or forces [N m or N] at positions q, velocities v and accelerations a (n,).

        Parameters
        ----------
        tip_force: (3,) external force on the tip [N], world.
        """
        tau = np.array(pin.rnea(self._model, self._data, q, v, a))
        if tip_force is not None:
            J = pin.computeFrameJacobian(self._model, self._data, q, self._tip, pin.LOCAL_WORLD_ALIGNED)
            tau -= J.reshape(6, len(tau))[:3].T @ tip_force  # with one joint J is 1-D
        return tau

    def torques_along(self, q: Matrix, v: Matrix, a: Matrix) -> Matrix:
        """(B, n) the joint torques or forces of B moments, with q, v and a (B, n)."""
        if self._chain is not None:
            return chain_torques(q, v, a, *self._chain)
        found = np.empty(np.shape(q))
        rnea, model, data = pin.rnea, self._model, self._data  # looked up once: rnea is called millions of times
        for row, moment in enumerate(zip(q, v, a, strict=True)):
            found[row] = rnea(model, data, *moment)
        return found

    def torque_slopes(self, q: Matrix, v: Matrix, a: Matrix) -> tuple[Matrix, Array]:
        """(B, n) the torques of `torques_along` [N m or N], and (B, n, 3 n) their derivatives.

        Along the last axis, the derivatives by q (B, n) come first, then those by v and by a (B, n).
        """
        if self._chain is not None:
            return chain_torque_slopes(q, v, a, *self._chain)
        count, n = np.shape(q)
        found, slopes = np.empty((count, n)), np.empty((count, n, 3 * n))
        derive, model, data = pin.computeRNEADerivatives, self._model, self._data
        for row, moment in enumerate(zip(q, v, a, strict=True)):
            derive(model, data, *moment)
            found[row] = data.tau
            slopes[row, :, :n], slopes[row, :, n : 2 * n], slopes[row, :, 2 * n :] = data.dtau_dq, data.dtau_dv, data.M
        _mirror(slopes[:, :, 2 * n :])
        return found, slopes

    def gravity_torques(self, q: Matrix) -> Matrix:
        """(B, n) joint torques or forces that hold the machine still at q (B, n) [N m or N]."""
        if self._chain is not None:
            rest = np.zeros(q.shape)
            return chain_torques(q, rest, rest, *self._chain)
        found = [pin.computeGeneralizedGravity(self._model, self._data, row) for row in q]
        return np.array(found, dtype=float).reshape(q.shape)

    def mass_matrices(self, q: Matrix) -> Array:
        """(B, n, n) M of every configuration in q (B, n)."""
        found = np.empty((*q.shape, q.shape[-1]))
        for row, joints in enumerate(q):
            found[row] = pin.crba(self._model, self._data, joints)
        _mirror(found)
        return found

    def bodies(self) -> tuple[Vector, Matrix]:
        """(n,) the mass of the body on each joint [kg], and (n, 3) the centres of mass in the joints' frames [m]."""
        inertias = [self._model.inertias[joint] for joint in range(1, self._model.njoints)]
        return np.array([one.mass for one in inertias]), np.array([one.lever for one in inertias])

    def kinetic_energy(self, q: Vector, v: Vector) -> float:
        """Kinetic energy at q, v (n,) [J]."""
        return float(pin.computeKineticEnergy(self._model, self._data, q, v))

    def potential_energy(self, q: Vector) -> float:
        """Potential energy at q (n,), up to a constant [J]."""
        return float(pin.computePotentialEnergy(self._model, self._data, q))

    def energies_along(self, q: Matrix, v: Matrix) -> tuple[Vector, Vector]:
        """(B,), (B,) kinetic and potential energies of B moments, q and v (B, n); the latter up to a constant [J]."""
        if self._chain is not None:
            return chain_energies(q, v, *self._chain)
        kinetic = [self.kinetic_energy(*moment) for moment in zip(q, v, strict=True)]
        return np.array(kinetic, dtype=float), np.array([self.potential_energy(row) for row in q], dtype=float)


@dataclass(frozen=True, eq=False)
class MotionEnergy:
    """Torque, power and energy over the T samples of a motion.

    Attributes
    ----------
    time: (T,) [s].
    torque: (T, n) of the joints [N m or N].
    joint_power: (T, n) tau_i v_i, the power of each joint [W]; negative where it brakes.
    power: (T,) sum of max(tau_i v_i, 0) [W]: hydraulics recover no energy.
    work: (T,) integral of `power` up to that time [J].
    kinetic, potential: (T,) [J]; the potential energy is relative to the first sample.
    hydraulic_power: (T,) power of a load-sensing pump, the highest pressure times the
        whole flow [W]; None for a machine without a hydraulic description.
    hydraulic: (T,) its integral [J], or None.
    """

    time: Vector
    torque: Matrix
    joint_power: Matrix
    power: Vector
    work: Vector
    kinetic: Vector
    potential: Vector
    hydraulic_power: Vector | None
    hydraulic: Vector | None


def _mirror(M: Array) -> None:
    """Complete mass matrices M (..., n, n): Pinocchio fills only the upper triangle, which the lower one repeats."""
    rows, columns = _below_diagonal(M.shape[-1])
    M[..., rows, columns] = M[..., columns, rows]


@lru_cache(maxsize=32)
def _below_diagonal(n: int) -> tuple[Indices, Indices]:
    rows, columns = np.tril_indices(n, -1)
    return rows, columns


@lru_cache(maxsize=8)  # a plan needs the same some thirty times
def _loaded(
    robot: Robot, payload: float, payload_at: tuple[float, ...] | None
) -> tuple[pin.Model, Chain | None]:  # fmt: skip
    """The model with the payload, and its chain for many moments at once; both are to be read only.

    Without the compiled functions Pinocchio is quicker, moment by moment, and there is no chain.
    """
    model = robot.model.copy()
    if payload > 0.0:
        frame = model.frames[robot.tip_frame]
        centre = np.zeros(3) if payload_at is None else np.array(payload_at)
        model.appendBodyToJoint(frame.parentJoint, pin.Inertia(payload, centre, np.zeros((3, 3))), frame.placement)
    return model, Chain.of(robot, model) if is_compiled(chain_torques) else None


def motion_energy(
    robot: Robot,
    time: Vector,
    *,
    q: Matrix,
    v: Matrix,
    a: Matrix,
    payload: float = 0.0,
    payload_at: Sequence[float] | Vector | None = None,
    tip_force: Matrix | None = None,
    outside: Matrix | None = None,
) -> MotionEnergy:
    """Torque, power and energy along a sampled motion.

    Parameters
    ----------
    time: (T,) [s]; q, v, a: (T, n) positions, velocities and accelerations of the joints.
    payload, payload_at: as for `Dynamics`.
    tip_force: (T, 3) external force on the tip [N], world.
    outside: (T, n) external torques or forces on the joints [N m or N], such as those of the soil.
    """
    dynamics = Dynamics(robot, payload=payload, payload_at=payload_at)
    if tip_force is None:
        torque = dynamics.torques_along(q, v, a)
    else:
        moments = zip(q, v, a, tip_force, strict=True)
        torque = np.array([dynamics.torques(*row, tip_force=force) for *row, force in moments]).reshape(q.shape)
    if outside is not None:
        torque = torque - outside
    kinetic, potential = dynamics.energies_along(q, v)
    joint_power = torque * v
    power = np.sum(np.maximum(joint_power, 0.0), axis=1)
    hydraulic_power = None if robot.hydraulics is None else robot.hydraulics.load_sensing_power(q, v, torque)
    return MotionEnergy(
        time=time,
        torque=torque,
        joint_power=joint_power,
        power=power,
        work=_integral(power, time),
        kinetic=kinetic,
        potential=potential - potential[:1],
        hydraulic_power=hydraulic_power,
        hydraulic=None if hydraulic_power is None else _integral(hydraulic_power, time),
    )


def _integral(values: Vector, time: Vector) -> Vector:
    """(T,) the integral of `values` (T,) up to each `time` (T,), by the trapezium rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (values[1:] + values[:-1]))))
