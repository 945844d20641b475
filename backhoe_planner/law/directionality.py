"""Joint directionality, equations (6) to (9) and (13) to (18).

The direction in which a link turns is predicted from the motion of the tip, and requested in
the null space. With P_0 the axis of the first joint, P_k the end of link k, P_e the tip:

    xdot_k = J_k v                                                     (8), (9)
    xdot_k = -D M sgn(P_e^k . xdot_e) dtheta' (a_k x P_k^{k-1}) + xdot_{k-1}   (13)
    dtheta' = angle between P_e^k and P_e^k + xdot_e                   (14)
    D = +1 to turn as predicted, -1 to hold link k                     (15)
    |xdot_e| = |xdot_k|                                                (16)
    M = |P_e^k| / |P_k^{k-1}|                                          (17), (18)

P_e^k runs from P_k to P_e, P_k^{k-1} from P_{k-1} to P_k. The velocity of the end of a
link is perpendicular to the link, hence the axis a_k in (13), which the paper omits; the
box symbol lost in print is the inner product. In three dimensions all vectors are
projected onto the plane across a_k. dtheta' is 0 when the tip moves straight along P_e^k:
then nothing is predicted.

The paper leaves two choices open, which have names here:

- magnification: ``"printed"`` is the 1/M of (13), ``"norm_preserving"`` the M with
  which (16) holds.
- reference: (7) writes P_k = P_e + P_k^e for joints beyond k. ``"tip_referenced"``
  differentiates that as the paper does, so that column l > k of J_k is minus the
  tip's own column; ``"standard"`` leaves those columns 0.

The paper's rule that a link turns clockwise when the tip moves outward holds only
if the arm beyond the joint bends clockwise (boom up); with `follow_bend` the sign of
the bend multiplies it. If the arm is straight about the joint's axis, as it always is
about a backhoe's swing, there is no such sign, and nothing is predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Configuration

Magnification = Literal["printed", "norm_preserving"]
Reference = Literal["tip_referenced", "standard"]

_SHORT = 1e-6  # m: a link shorter than this has no direction; chosen
_STRAIGHT = 1e-9  # rad, rounding: an arm that bends less has no direction of bending


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
    as_rates: bool = False,
) -> Matrix:
    """(n - 1, 3) xdot_k of equation (13) for k = 1 .. n-1 [m/s], world.

    Parameters
    ----------
    xdot_e: (3,) velocity of the tip [m/s].
    D: (n - 1,) directional operator of equation (15), +1 or -1 (or between).
    magnification, follow_bend: see the module's text.
    as_rates: dtheta' is the rate |P_e^k x xdot_e| / |P_e^k|^2, the limit of (14) for small
        steps, instead of the angle that one whole step of length xdot_e would make.

    The code uses plain floats: for a handful of links that is several times faster than arrays.
    """
    points, axes = chain.points.tolist(), chain.axes.tolist()
    vx, vy, vz = xdot_e.tolist()
    ex, ey, ez = points[-1]
    found = []
    sx = sy = sz = 0.0
    for (ax, ay, az), (bx, by, bz), (px, py, pz), d in zip(axes, points, points[1:-1], D.tolist(), strict=False):
        lx, ly, lz = px - bx, py - by, pz - bz
        tx, ty, tz = ex - px, ey - py, ez - pz
        # a x P_k^{k-1} and a x P_e^k: as long as the parts of these vectors across the axis
        clx, cly, clz = ay * lz - az * ly, az * lx - ax * lz, ax * ly - ay * lx
        ctx, cty, ctz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
        length2 = clx * clx + cly * cly + clz * clz
        reach2 = ctx * ctx + cty * cty + ctz * ctz
        if length2 > _SHORT * _SHORT and reach2 > _SHORT * _SHORT:
            outward = tx * vx + ty * vy + tz * vz - (ax * tx + ay * ty + az * tz) * (ax * vx + ay * vy + az * vz)
            sideways = abs(ctx * vx + cty * vy + ctz * vz)
            turn = sideways / reach2 if as_rates else math.atan2(sideways, reach2 + outward)
            M = math.sqrt(reach2 / length2)
            rate = -d * turn * (M if magnification == "norm_preserving" else 1.0 / M)
            rate *= (outward > 0.0) - (outward < 0.0)
            if follow_bend:
                bend = clx * tx + cly * ty + clz * tz
                straight = abs(bend) <= _STRAIGHT * math.sqrt(length2 * reach2)
                rate *= 0.0 if straight else -math.copysign(1.0, bend)
            sx, sy, sz = sx + rate * clx, sy + rate * cly, sz + rate * clz
        found.append((sx, sy, sz))
    return np.array(found).reshape(-1, 3)
