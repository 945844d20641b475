"""Softening: a cost that jumps is replaced by a smooth one first, then by ones ever nearer to it.

The pump's pressure is that of the most heavily loaded cylinder that moves, however slowly, so no small change of a
motion that moves all of them lowers its cost. If a cylinder counts for less the slower it moves against its load, the
slope shows that it should rather stand still, or move at another time. The result for one softness is the start for
the next, less soft one (graduated non-convexity, Blake and Zisserman 1987).
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import Hydraulics

# the flows below which a cylinder counts in part, as parts of its mean flow over the motion; chosen: begun at 10,
# motions cost 13 % more; ended at 0.01, only 2 %
_PARTS = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
_FINE_FROM = 3  # index of the first of them for a curve that is the result of a descent
_HURRIED = (0.3, 0.1, 0.03, 0.01)  # the same if few rounds are made
_POWER = 8  # of the norm that approximates the highest pressure; chosen
_ROUND_OFF = 0.1  # part of the flow below which a cylinder counts in part: amounts of oil are rounded off in it; chosen
_LEAST_PRESSURE = 1e-300  # Pa: the least by which pressures are divided


def soft_flows(mean_flow: float, *, first: bool, fine: bool, hurried: bool) -> tuple[float, ...]:
    """The flows below which cylinders count in part, in turn [m^3/s]; only 0 if none is soft.

    Parameters
    ----------
    mean_flow: of a cylinder over the motion [m^3/s]; 0 for a cost that does not jump.
    first: whether the softest is enough.
    fine: whether the curve is the result of a descent.
    hurried: whether few rounds are made.
    """
    if mean_flow <= 0.0:
        return (0.0,)
    usual = _HURRIED if hurried else _PARTS[_FINE_FROM if fine else 0 :]
    parts = _PARTS[:1] if first else usual
    return tuple(part * mean_flow for part in parts)


def soft_power(hydraulics: Hydraulics, q: Matrix, v: Matrix, torque: Matrix, *, flow: float) -> Vector:
    """(K,) smooth approximation of `Hydraulics.load_sensing_power` [W] at q, v, torque (K, n); less `flow`, less error.

    Parameters
    ----------
    flow: from this flow a cylinder that moves against its load counts in full [m^3/s], and below in a part that grows
        smoothly from 0; the highest pressure and the amounts of oil are rounded off at their kinks.
    """
    oil, against = hydraulics.flows(q, v), np.sign(torque * v)[:, hydraulics.joint_of]
    pressure = np.nan_to_num(hydraulics.pressures(q, torque), posinf=0.0)  # at a dead centre
    counted = _counted_part(against * oil / flow) * pressure
    return np.asarray(_highest(counted)[0] * _all_oil(oil, flow))


def soft_power_slopes(
    hydraulics: Hydraulics, q: Matrix, v: Matrix, torque: Matrix, torque_slopes: Array, *, flow: float
) -> tuple[Vector, Matrix]:
    """`soft_power`, and (K, 3 n) its derivatives by q, v and a, one after the other.

    Parameters
    ----------
    torque_slopes: (K, n, 3 n) the derivatives of the torques by these.
    """
    n, joint, (cap, annulus) = q.shape[1], hydraulics.joint_of, hydraulics.areas
    of_joint = np.eye(n)[joint]  # (m, n)
    arms, arm_slopes, own_v, own_torque = hydraulics.arms(q), hydraulics.arm_slopes(q), v[:, joint], torque[:, joint]
    # the oil of each cylinder, A |r v|
    speed = arms * own_v
    side = np.sign(speed) * np.where(speed > 0.0, cap, annulus)
    oil, oil_by_q, oil_by_v = side * speed, side * arm_slopes * own_v, side * arms
    # the pressure in it, |F| / A with F = r tau / (r . r)
    squared, squared_by_q = (each @ of_joint @ of_joint.T for each in (arms * arms, 2.0 * arms * arm_slopes))
    with np.errstate(divide="ignore", invalid="ignore"):  # at a dead centre
        share, share_by_q = arms / squared, (arm_slopes - arms * squared_by_q / squared) / squared
    share, share_by_q = (np.nan_to_num(each, posinf=0.0, neginf=0.0) for each in (share, share_by_q))
    force = share * own_torque
    side = np.sign(force) / np.where(force > 0.0, cap, annulus)
    pressure, pressure_by_q, pressure_by_torque = side * force, side * share_by_q * own_torque, side * share
    # of which a part counts, and of these parts the highest, times all oil
    against = np.sign(own_torque * own_v) / flow
    part = _counted_part(against * oil)
    part_by_oil = against * _counted_part_slope(against * oil)
    (highest, by_counted), all_oil = _highest(part * pressure), _all_oil(oil, flow)
    by_counted = all_oil[:, None] * by_counted
    by_oil = by_counted * part_by_oil * pressure + highest[:, None] * oil / _rounded_off(oil, flow)
    by_pressure = by_counted * part
    found = np.einsum("kj,kjm->km", (by_pressure * pressure_by_torque) @ of_joint, torque_slopes)
    found[:, :n] += (by_oil * oil_by_q + by_pressure * pressure_by_q) @ of_joint
    found[:, n : 2 * n] += (by_oil * oil_by_v) @ of_joint
    return highest * all_oil, found


def _counted_part(part: Array) -> Array:
    """How much of its pressure counts for a cylinder with this part of the flow from which it counts in full."""
    part = np.clip(part, 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def _counted_part_slope(part: Array) -> Array:
    part = np.clip(part, 0.0, 1.0)
    return np.asarray(6.0 * part * (1.0 - part))


def _highest(pressure: Array) -> tuple[Array, Array]:
    """(K,) the highest of pressures (K, m) [Pa], its kinks rounded off, and (K, m) its derivatives by them."""
    largest = np.maximum(np.max(pressure, axis=-1, keepdims=True, initial=0.0), _LEAST_PRESSURE)
    part = pressure / largest  # their powers do not become 0 where the pressures are only rounding
    total = np.sum(part**_POWER, axis=-1, keepdims=True)
    slopes = part ** (_POWER - 1) / np.maximum(total, 1.0) ** (1.0 - 1.0 / _POWER)
    return np.asarray(largest[..., 0] * total[..., 0] ** (1.0 / _POWER)), slopes


def _all_oil(oil: Array, flow: float) -> Array:
    """(K,) the sum of amounts of oil (K, m) [m^3/s], which are rounded off at 0."""
    return np.asarray(np.sum(_rounded_off(oil, flow) - _ROUND_OFF * flow, axis=-1))


def _rounded_off(oil: Array, flow: float) -> Array:
    """Amounts of oil [m^3/s], rounded off at 0, where they are too great by `_ROUND_OFF` of the flow."""
    width = _ROUND_OFF * flow
    return np.asarray(np.sqrt(oil * oil + width * width))
