"""Softening: a cost that jumps is replaced by a smooth one first, then by ones ever nearer to it.

The pump's pressure is that of the most heavily loaded cylinder that moves, however slowly, so no small change of a
motion that moves all of them lowers its cost. If a cylinder counts for less the slower it moves against its load, the
slope shows that it should rather stand still, or move at another time. The result for one softness is the start for
the next, less soft one (graduated non-convexity, Blake and Zisserman 1987).
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Hydraulics

# the flows below which a cylinder counts in part, as parts of its mean flow over the motion; chosen: begun at 10,
# motions cost 13 % more; ended at 0.01, only 2 %
_PARTS = (3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
_FINE_FROM = 3  # index of the first of them for a curve that is the result of a descent
_HURRIED = (0.3, 0.1, 0.03, 0.01)  # the same if few rounds are made
_POWER = 8  # of the norm that approximates the highest pressure; chosen
_ROUND_OFF = 0.1  # part of the flow below which a cylinder counts in part: amounts of oil are rounded off in it; chosen
_LEAST_PRESSURE = 1.0  # Pa, well below any that counts


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
    part = np.clip(against * oil / flow, 0.0, 1.0)
    pressure = np.nan_to_num(hydraulics.pressures(q, torque), posinf=0.0)  # at a dead centre
    counted = part * part * (3.0 - 2.0 * part) * pressure
    largest = np.maximum(np.max(counted, axis=-1, keepdims=True, initial=0.0), _LEAST_PRESSURE)
    highest = largest[..., 0] * np.sum((counted / largest) ** _POWER, axis=-1) ** (1.0 / _POWER)
    width = _ROUND_OFF * flow
    return np.asarray(highest * np.sum(np.sqrt(oil * oil + width * width) - width, axis=-1))
