"""Joint torques by inverse dynamics, and what a motion costs.

    tau = M(q) a + C(q, v) v + g(q) - J_tip^T F

with F the weight of the payload at the tip.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.machine.robot import Robot

__all__ = ["Dynamics", "motion_costs"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

GRAVITY = 9.81  # m/s^2


class Dynamics:
    """Inverse dynamics of one machine with a payload at its tip; own working memory.

    Parameters
    ----------
    payload: mass that the tip carries [kg], taken as a point: its weight and its
        inertia both count.
    """

    def __init__(self, robot: Robot, *, payload: float = 0.0) -> None:
        self._model = robot.model.copy()
        if payload > 0.0:
            frame = self._model.frames[robot.tip_frame]
            load = pin.Inertia(payload, np.zeros(3), np.zeros((3, 3)))
            self._model.appendBodyToJoint(frame.parentJoint, load, frame.placement)
        self._data = self._model.createData()

    def torques(self, q: Vector, v: Vector, a: Vector) -> Vector:
        """(n,) joint torques or forces [N m or N] for q, v, a (n,)."""
        return np.array(pin.rnea(self._model, self._data, q, v, a))

    def kinetic_energy(self, q: Vector, v: Vector) -> float:
        """[J]"""
        return float(pin.computeKineticEnergy(self._model, self._data, q, v))

    def potential_energy(self, q: Vector) -> float:
        """[J], up to a constant."""
        return float(pin.computePotentialEnergy(self._model, self._data, q))


def motion_costs(
    robot: Robot, time: Vector, q: Matrix, v: Matrix, a: Matrix, *, payload: float = 0.0
) -> dict[str, float]:
    """What a sampled motion costs, by the names of the objectives.

    Parameters
    ----------
    time: (T,) [s]; q, v, a: (T, n).

    Returns
    -------
    velocity_norm: integral of v.v [rad^2/s]; kinetic: integral of the kinetic energy
    [J s]; effort: integral of tau.tau [N^2 m^2 s]; work: integral of
    sum_i max(tau_i v_i, 0) [J], hydraulics give nothing back.
    """
    dynamics = Dynamics(robot, payload=payload)
    torque = np.array([dynamics.torques(*row) for row in zip(q, v, a, strict=True)])
    kinetic = np.array([dynamics.kinetic_energy(*row) for row in zip(q, v, strict=True)])
    return {
        "velocity_norm": float(np.trapezoid(np.sum(v * v, axis=1), time)),
        "kinetic": float(np.trapezoid(kinetic, time)),
        "effort": float(np.trapezoid(np.sum(torque * torque, axis=1), time)),
        "work": float(np.trapezoid(np.sum(np.maximum(torque * v, 0.0), axis=1), time)),
    }
