"""Joint directionality, equations (6) to (9) and (13) to (18).

Which way a link turns is predicted from where the tip goes, and asked for in the null
space. With P_0 the axis of the first joint, P_k the end of link k, P_e the tip:

    xdot_k = J_k v                                                     (8), (9)
    xdot_k = -D M sgn(P_e^k . xdot_e) dtheta' (a_k x P_k^{k-1}) + xdot_{k-1}   (13)
    dtheta' = angle between P_e^k and P_e^k + xdot_e                   (14)
    D = +1 to turn as predicted, -1 to hold link k                     (15)
    |xdot_e| = |xdot_k|                                                (16)
    M = |P_e^k| / |P_k^{k-1}|                                          (17), (18)

P_e^k runs from P_k to P_e, P_k^{k-1} from P_{k-1} to P_k. A velocity of the end of a
link stands across the link, hence the axis a_k in (13), which the print omits; the
box symbol lost in print is the inner product. In three dimensions all vectors are
taken across a_k. dtheta' is 0 when the tip moves straight along P_e^k: then nothing is
predicted.

Two choices are open in the paper and have names here:

- magnification: ``"printed"`` is the 1/M of (13), ``"norm_preserving"`` the M with
  which (16) holds.
- reference: (7) writes P_k = P_e + P_k^e for joints beyond k. ``"tip_referenced"``
  differentiates that as the paper does, so that column l > k of J_k is minus the
  tip's own column; ``"standard"`` leaves those columns 0.

The print's rule that a link turns clockwise when the tip moves outward holds only
where the arm beyond the joint bends clockwise (boom up); with `follow_bend` the sign of
the bend multiplies it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.kinematics import Configuration

__all__ = [
    "LinkChain", 
    "Magnification",
    "Reference",
    "all_link_jacobians",
    "all_link_velocities",
    "link_chain",
    "link_jacobian",
    "link_velocities",
]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Magnification = Literal["printed", "norm_preserving"]
Reference = Literal["tip_referenced", "standard"]

_SHORT = 1e-6  # m: a link shorter than this has no direction


@dataclass(frozen=True)
class LinkChain:
    """The arm as the paper draws it.

    Attributes
    ----------
    points: (n + 1, 3) P_0 ... P_n, the last one the tip [m], world.
    axes: (n, 3) axis a_k of the joint at P_{k-1}, unit, world; 0 for a prismatic joint.
    columns: (n, 3) velocity of the tip per joint: the columns of J_e.
    J_world: (6, n) as in `Configuration`.
    """

    points: Matrix
    axes: Matrix
    columns: Matrix
    J_world: Matrix


def link_chain(at: Configuration) -> LinkChain:
    """The chain of points and axes at a configuration."""
    return LinkChain(points=at.points, axes=at.J_world[3:].T, columns=at.jacobian[:3].T, J_world=at.J_world)


def link_jacobian(chain: LinkChain, k: int, *, reference: Reference = "tip_referenced") -> Matrix:
    """(3, n) J_k of equations (6) to (8): velocity of P_k, the end of link k = 1 .. n-1."""
    point = chain.points[k]
    J_k = chain.J_world[:3] + np.cross(chain.J_world[3:].T, point).T
    J_k[:, k:] = -chain.columns[k:].T if reference == "tip_referenced" else 0.0
    return np.asarray(J_k)


def link_velocities(
    chain: LinkChain,
    xdot_e: Vector,
    *,
    D: Vector,
    magnification: Magnification = "printed",
    follow_bend: bool = False,
) -> Matrix:
    """(n - 1, 3) xdot_k of equation (13) for k = 1 .. n-1 [m/s], world.

    Parameters
    ----------
    xdot_e: (3,) velocity of the tip [m/s].
    D: (n - 1,) directional operator of equation (15), +1 or -1 (or between).
    magnification, follow_bend: see the module's text.
    """
    count = len(chain.points) - 2
    found = np.zeros((count, 3))
    before = np.zeros(3)
    for k in range(1, count + 1):
        axis = chain.axes[k - 1]
        found[k - 1] = before
        if not np.any(axis):
            continue
        link = _across(chain.points[k] - chain.points[k - 1], axis)
        to_tip = _across(chain.points[-1] - chain.points[k], axis)
        rate = -D[k - 1] * _predicted_turn(to_tip, _across(xdot_e, axis))
        length, reach = np.sqrt(link @ link), np.sqrt(to_tip @ to_tip)
        if length < _SHORT or reach < _SHORT:
            continue
        M = reach / length
        rate *= M if magnification == "norm_preserving" else 1.0 / M
        if follow_bend:
            rate *= -np.sign(_triple(axis, link, to_tip))
        found[k - 1] = before + rate * _cross(axis, link)
        before = found[k - 1]
    return found


def all_link_jacobians(at: Configuration) -> Matrix:
    """(3 (n-1), n) the standard J_k of every k = 1 .. n-1, one under the other.

    The same as `link_jacobian(..., reference="standard")` row by row, in one go.
    """
    inner = at.points[1:-1]
    count, n = len(inner), at.q.size
    skew = np.zeros((count, 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = inner[:, 2], -inner[:, 1], inner[:, 0]
    skew -= skew.transpose(0, 2, 1)
    J = at.J_world[:3] + skew @ at.J_world[3:]
    J *= np.tri(n - 1, n)[:, None, :]
    return np.asarray(J.reshape(3 * count, n))


def all_link_velocities(at: Configuration, xdot_e: Vector, *, D: Vector) -> Matrix:
    """(n - 1, 3) xdot_k of equation (13) as rates: the limit of (14) for small steps.

    The same as `link_velocities` with ``"norm_preserving"`` and `follow_bend`, where
    dtheta' is taken as the rate |P_e^k x xdot_e| / |P_e^k|^2 instead of the angle that
    one whole step of length xdot_e would make.
    """
    axes = at.J_world[3:, :-1].T
    link = at.points[1:-1] - at.points[:-2]
    to_tip = at.points[-1] - at.points[1:-1]
    over_link, over_tip = _cross_rows(axes, link), _cross_rows(axes, to_tip)
    length2 = np.einsum("ki,ki->k", over_link, over_link)
    reach2 = np.einsum("ki,ki->k", over_tip, over_tip)
    bend = -np.sign(np.einsum("ki,ki->k", over_link, to_tip))
    outward = np.sign(to_tip @ xdot_e - np.einsum("ki,ki->k", to_tip, axes) * (axes @ xdot_e))
    rate = np.zeros(len(axes))
    valid = (length2 > _SHORT**2) & (reach2 > _SHORT**2)
    turn = np.abs(over_tip @ xdot_e)[valid] / reach2[valid]
    rate[valid] = -(D * bend * outward)[valid] * turn * np.sqrt(reach2[valid] / length2[valid])
    return np.asarray(np.cumsum(rate[:, None] * over_link, axis=0))


def _cross_rows(a: Matrix, b: Matrix) -> Matrix:
    """Row-wise cross product; numpy's own costs more than the rest of a step."""
    found = np.empty_like(b)
    found[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    found[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    found[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return found


def _predicted_turn(to_tip: Vector, xdot_e: Vector) -> float:
    """sgn(P_e^k . xdot_e) dtheta' of equations (13) and (14) [rad]."""
    ahead = to_tip + xdot_e
    cross = _cross(to_tip, ahead)
    turn = np.arctan2(np.sqrt(cross @ cross), to_tip @ ahead)
    return float(np.sign(to_tip @ xdot_e) * turn)


def _across(vector: Vector, axis: Vector) -> Vector:
    return np.asarray(vector - (vector @ axis) * axis)


def _cross(a: Vector, b: Vector) -> Vector:
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _triple(axis: Vector, a: Vector, b: Vector) -> float:
    return float(axis @ _cross(a, b))
