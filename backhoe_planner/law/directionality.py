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
the bend multiplies it. Where the arm lies straight about the joint's axis, as always
about a backhoe's swing, there is no such sign, and nothing is predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import Configuration

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
_STRAIGHT = 1e-9  # rad: an arm bent less than this has no sense of bending


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
            bend = _triple(axis, link, to_tip)
            rate *= -np.sign(bend) * (abs(bend) > _STRAIGHT * length * reach)
        found[k - 1] = before + rate * _cross(axis, link)
        before = found[k - 1]
    return found


def all_link_jacobians(at: Configuration) -> Matrix:
    """(3 (n-1), n) the standard J_k of every k = 1 .. n-1, one under the other.

    The same as `link_jacobian(..., reference="standard")` row by row, in one go.
    """
    inner = at.points[1:-1]
    n = at.q.size
    J = np.empty((n - 1, 3, n))
    px, py, pz = inner[:, 0, None], inner[:, 1, None], inner[:, 2, None]
    wx, wy, wz = at.J_world[3:]
    J[:, 0] = wy * pz - wz * py
    J[:, 1] = wz * px - wx * pz
    J[:, 2] = wx * py - wy * px
    J += at.J_world[:3]
    J *= _inner_joints(n)
    return J.reshape(3 * (n - 1), n)


@lru_cache(maxsize=32)
def _inner_joints(n: int) -> Matrix:
    """(n - 1, 1, n) 1 where joint l moves the end of link k: l <= k."""
    mask = np.tri(n - 1, n)[:, None, :]
    mask.setflags(write=False)
    return mask


def all_link_velocities(at: Configuration, xdot_e: Vector, D: Vector) -> Matrix:
    """(n - 1, 3) xdot_k of equation (13) as rates: the limit of (14) for small steps.

    The same as `link_velocities` with ``"norm_preserving"`` and `follow_bend`, where
    dtheta' is taken as the rate |P_e^k x xdot_e| / |P_e^k|^2 instead of the angle that
    one whole step of length xdot_e would make. Written out in floats: for a handful of
    links that is several times faster than arrays.
    """
    points = at.points.tolist()
    axes = at.J_world[3:].T.tolist()
    vx, vy, vz = xdot_e.tolist()
    ex, ey, ez = points[-1]
    found = []
    sx = sy = sz = 0.0
    for (ax, ay, az), (bx, by, bz), (px, py, pz), hold in zip(axes, points, points[1:-1], D.tolist(), strict=False):
        lx, ly, lz = px - bx, py - by, pz - bz
        tx, ty, tz = ex - px, ey - py, ez - pz
        # a x link and a x (P_e - P_k): both lie across the axis
        clx, cly, clz = ay * lz - az * ly, az * lx - ax * lz, ax * ly - ay * lx
        ctx, cty, ctz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
        length2 = clx * clx + cly * cly + clz * clz
        reach2 = ctx * ctx + cty * cty + ctz * ctz
        if length2 > _SHORT * _SHORT and reach2 > _SHORT * _SHORT:
            outward = tx * vx + ty * vy + tz * vz - (ax * tx + ay * ty + az * tz) * (ax * vx + ay * vy + az * vz)
            counter_clockwise = clx * tx + cly * ty + clz * tz
            turn = abs(ctx * vx + cty * vy + ctz * vz) / reach2
            rate = hold * turn * math.sqrt(reach2 / length2)
            if (outward > 0.0) != (counter_clockwise > 0.0):
                rate = -rate
            if outward == 0.0 or abs(counter_clockwise) <= _STRAIGHT * math.sqrt(length2 * reach2):
                rate = 0.0
            # -D * bend * outward with bend = -sgn(counter_clockwise)
            sx, sy, sz = sx + rate * clx, sy + rate * cly, sz + rate * clz
        found.append((sx, sy, sz))
    return np.array(found).reshape(-1, 3)


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
