"""What the rods of m cylinders allow K joints' configurations, and what oil they take, from their moment arms.

The arms r = dl/dq (K, m) are those of each cylinder along its own joint [m/rad]. All functions
take `joint_of` (m,), the index of that joint; the areas `cap` and `annulus` (m,) [m^2]; and the number of joints.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.native import compiled


@compiled
def rod_limits(
    arms: Matrix, joint_of: Indices, cap: Vector, annulus: Vector, valve_flow: Vector, pressure: float,
    pump_flow: float, joints: int, /,
) -> tuple[Matrix, Matrix, Matrix, Matrix]:  # fmt: skip
    """(K, n) each: the greatest torques [N m], then the greatest speeds [rad/s], positive and negative.

    They are infinite if no cylinder moves the joint, and the speeds also if all of its cylinders are at a dead centre.

    Parameters
    ----------
    valve_flow: (m,) through the valve of each cylinder [m^3/s].
    pressure: at which relief valves open [Pa]; pump_flow: [m^3/s].
    """
    torques, speeds = [], []
    for sign in (1.0, -1.0):
        area = np.where(sign * arms > 0.0, cap, annulus)
        torque = sum_by_joint(np.abs(arms) * (pressure * area), joint_of, joints)
        torque[:, ~np.isin(np.arange(joints), joint_of)] = np.inf
        torques.append(torque)
        swept = area * np.abs(arms)  # m^3/rad
        share = sum_by_joint(swept, joint_of, joints)
        with np.errstate(divide="ignore"):
            speed = np.where(share > 0.0, pump_flow / share, np.inf)
            for i, joint in enumerate(joint_of.tolist()):
                own = np.where(swept[:, i] > 0.0, valve_flow[i] / swept[:, i], np.inf)
                speed[:, joint] = np.minimum(speed[:, joint], own)
        speeds.append(speed)
    return torques[0], torques[1], speeds[0], speeds[1]


@compiled
def rod_limit_slopes(
    arms: Matrix, arm_slopes: Matrix, joint_of: Indices, cap: Vector, annulus: Vector, valve_flow: Vector,
    pressure: float, pump_flow: float, joints: int, /,
) -> tuple[Matrix, Matrix, Matrix, Matrix]:  # fmt: skip
    """(K, n) each: the derivatives of `rod_limits` by each joint's own position; 0 where there is no limit.

    Parameters
    ----------
    arm_slopes: (K, m) dr/dq [m/rad^2].
    """
    _, _, *limits = rod_limits(arms, joint_of, cap, annulus, valve_flow, pressure, pump_flow, joints)
    torques, speeds = [], []
    for sign, limit in zip((1.0, -1.0), limits, strict=True):
        area = np.where(sign * arms > 0.0, cap, annulus)
        grown = np.sign(arms) * arm_slopes
        torques.append(sum_by_joint(grown * (pressure * area), joint_of, joints))
        swept, swept_slopes = area * np.abs(arms), area * grown
        of_inverse = sum_by_joint(swept_slopes, joint_of, joints) / pump_flow
        with np.errstate(divide="ignore", invalid="ignore"):
            for i, joint in enumerate(joint_of.tolist()):
                by_valve = valve_flow[i] / swept[:, i] == limit[:, joint]
                of_inverse[:, joint] = np.where(by_valve, swept_slopes[:, i] / valve_flow[i], of_inverse[:, joint])
            speeds.append(np.where(np.isfinite(limit), -(limit * limit) * of_inverse, 0.0))
    return torques[0], torques[1], speeds[0], speeds[1]


@compiled
def rod_forces(arms: Matrix, joint_of: Indices, torques: Matrix, /) -> Matrix:
    """(K, m) the forces F of least norm that give the joints' torques (K, n) [N m], push positive [N].

    F = r tau / (r . r), over the cylinders of a joint.
    """
    share = sum_by_joint(arms * arms, joint_of, torques.shape[1])[:, joint_of]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(arms * torques[:, joint_of] / share)


@compiled
def oil_taken(
    arms: Matrix, joint_of: Indices, cap: Vector, annulus: Vector, v: Matrix, torques: Matrix, /
) -> tuple[Vector, Vector, Vector]:
    """(K,) each: all flow [m^3/s], the power that the oil delivers [W], and the highest pressure that is needed [Pa].

    Only cylinders that move against their load need pressure and power.

    Parameters
    ----------
    v, torques: (K, n) of the joints [rad/s], [N m].
    """
    speed, force = arms * v[:, joint_of], rod_forces(arms, joint_of, torques)
    flow = np.abs(speed) * np.where(speed > 0.0, cap, annulus)
    with np.errstate(invalid="ignore"):
        pressure = np.where(force * speed > 0.0, np.abs(force) / np.where(force > 0.0, cap, annulus), 0.0)
        power = np.sum(pressure * flow, axis=1)
    return np.sum(flow, axis=1), power, np.max(pressure, axis=1, initial=0.0)


@compiled
def rod_flow_slopes(
    arms: Matrix, arm_slopes: Matrix, joint_of: Indices, cap: Vector, annulus: Vector, v: Matrix, /
) -> tuple[Matrix, Matrix]:
    """(K, n) each: the derivatives of all flow by q [m^3/s/rad] and by v [m^3/rad].

    At rest they are those for a positive velocity.
    """
    own = v[:, joint_of]
    way = np.where(own < 0.0, -1.0, 1.0)
    area = np.where(way * arms > 0.0, cap, annulus)
    by_q = sum_by_joint(np.abs(own) * area * np.sign(arms) * arm_slopes, joint_of, v.shape[1])
    return by_q, sum_by_joint(way * area * np.abs(arms), joint_of, v.shape[1])


def sum_by_joint(values: Matrix, joint_of: Indices, joints: int) -> Matrix:
    """(K, n) sums of values (K, m) over the cylinders of each joint."""
    total = np.zeros((len(values), joints))
    for i, joint in enumerate(joint_of.tolist()):
        total[:, joint] += values[:, i]
    return total
