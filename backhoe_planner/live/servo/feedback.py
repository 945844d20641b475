"""The force fed back to the hand: it shows what the machine refuses, and never adds energy.

    F_wished = -B (r . t)^+ t  -  B rho(margin) ((r . n)^+ + (x_w . n)^+) n,    r = x_free - x

r is the velocity that the tip would have with nothing in the way and no joint limit, minus
the one that it has. If the machine slides or stands still, r is the refused part of the wish.
The hand feels the components of r into the obstacle (n) and along the rest of the hand's own
motion (t). The rest of r is left out, so that the hand is not pulled aside when the machine
gives way. rho rises smoothly from 0 to 1 as an obstacle comes near, before anything is
refused. The force saturates smoothly at its largest value.

The force is smoothed over a hundredth of a second, so that it does not jump.

Passivity: a ledger (a passivity observer after Hannaford and Ryu, 2002) holds the energy
that the hand has put in so far. A force F is held until the next sample. Until then the hand
moves at its velocity w, changed by at most dw. F is scaled so that the most energy that it
can give back, dt (F . w + |F| dw), is no more than the ledger holds.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from backhoe_planner.arrays import Vector, as_number, as_vector
from backhoe_planner.live.braking.joint_bounds import TOLERANCE, straight_towards
from backhoe_planner.native import compiled

_SEED = 1e-7  # J that a force against the hand may use before the hand has put in any; chosen, too little to feel
_LEAK = 1e-13  # J per sample, so that an empty ledger can fill again; about a millionth of `_SEED`
_SMOOTHED_OVER = 0.01  # s: chosen, faster than a hand reacts
_SLOW_HAND = 0.02  # m/s: chosen, the direction of a slower hand is mostly noise
_MOST_STORED = 0.2  # J that the ledger holds at most: chosen, so that a long push is not given back as one blow
_REMEMBERED = 0.02  # s for which being held back still counts, so that a status does not flicker; chosen

HandState: TypeAlias = tuple[float, float, float, float, float, float, float, float]


class Recently:
    """Whether a condition holds or did just before, so that what depends on it does not flicker.

    Parameters
    ----------
    dt: length of a step [s].
    """

    def __init__(self, dt: float) -> None:
        self._steps = max(math.ceil(_REMEMBERED / dt), 1)
        self._counts_for = 0

    def next(self, *, holds: bool) -> bool:
        """Whether the condition held recently, after the next step, in which it `holds` or not."""
        self._counts_for = self._steps if holds else self._counts_for - 1
        return self._counts_for > 0


class Refusal:
    """Compares the joint velocity with that of a machine that has nothing in its way.

    Whether something is in the way is decided for the whole machine: if one joint is held back, the others do not
    move as they would otherwise, even if each of them goes at its own target velocity.

    Parameters
    ----------
    dt: length of a step [s].
    changes: n numbers, by how much the velocity of each joint can change in a step [rad/s or m/s].
    """

    def __init__(self, dt: float, changes: tuple[float, ...]) -> None:
        self._changes = changes
        self._free = np.zeros(len(changes))  # velocities with nothing in the way
        self._keeps = math.exp(-dt / _REMEMBERED)
        self._held = Recently(dt)

    def next(self, v: Vector, *, wish: Vector, target: Vector) -> Vector:
        """(n,) the velocity with nothing in the way, minus v (n,); see `VelocityWish` for `wish` and `target` (n,)."""
        self._free = straight_towards(wish, self._free, self._changes)
        beyond, off = self._free - v, v - target
        if not self._held.next(holds=float(off.dot(off)) > TOLERANCE * TOLERANCE):
            beyond *= self._keeps  # the machine catches up with the free motion
            self._free = v + beyond
        return beyond


def refused_part(wish: Vector, difference: Vector) -> Vector:
    """(3,) the part of a wish (3,) that is not followed, if the tip's velocity falls short by `difference` (3,).

    A wish w is the sum of the followed part f and the refused part r, and neither points against the other:
    f . r >= 0. With f = w - r this is the ball |r - w/2| <= |w|/2, in which also |r| <= |w|. r is the point of that
    ball nearest to `difference`. If the tip has the velocity nearest to the wish in any convex set that contains 0,
    `difference` itself is in the ball. It need not be if the machine gives way to a moving obstacle or leaves a
    violation.
    """
    (x, y, z), (dx, dy, dz) = wish.tolist(), difference.tolist()
    if dx * dx + dy * dy + dz * dz <= dx * x + dy * y + dz * z:
        return difference
    dx, dy, dz = dx - 0.5 * x, dy - 0.5 * y, dz - 0.5 * z
    part = math.sqrt((x * x + y * y + z * z) / (dx * dx + dy * dy + dz * dz))
    return np.array((0.5 * (x + part * dx), 0.5 * (y + part * dy), 0.5 * (z + part * dz)))


class Feedback:
    """The force on the hand at one control, which shows what the servo refuses.

    Parameters
    ----------
    dt: time between samples, over which a force is held [s].
    damping: B, the force per refused speed [N s/m].
    largest: the force that is approached but never exceeded [N].
    sharpest: greatest acceleration of the hand for which passivity holds [m/s^2].
    """

    def __init__(self, dt: float, *, damping: float = 60.0, largest: float = 30.0, sharpest: float = 200.0) -> None:
        dt, damping = as_number(dt, key="dt", above=0.0), as_number(damping, key="damping", least=0.0)
        largest, sharpest = as_number(largest, key="largest", above=0.0), as_number(sharpest, key="sharpest", least=0.0)
        part = 1.0 - math.exp(-dt / _SMOOTHED_OVER)
        self._settings = HandSettings(dt, damping, largest, sharpest, part)
        self._state: HandState = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    def next(self, hand: Vector, refused: Vector, normal: Vector, nearness: float) -> Vector:
        """(3,) force on the hand, to be held until the next sample [N], world.

        Parameters
        ----------
        hand: (3,) velocity of the hand since the last sample, which is the wish [m/s], world.
        refused: (3,) r, the tip's velocity with nothing in the way, minus its real one [m/s], world.
        normal: (3,) unit vector into the nearest obstacle, world; zeros if none is near.
        nearness: rho, 0 if obstacles are far, 1 if no further approach is possible.
        """
        try:
            # if the sum is finite, so are all the numbers; otherwise they are checked one by one below
            right = (
                isinstance(nearness, float)
                and 0.0 <= nearness <= 1.0
                and len(hand) == len(refused) == len(normal) == 3
                and math.isfinite(sum(hand.tolist() + refused.tolist() + normal.tolist()))
            )
        except (AttributeError, TypeError, ValueError):
            right = False
        if not right:
            hand, refused = as_vector(hand, 3, key="hand"), as_vector(refused, 3, key="refused")
            normal = as_vector(normal, 3, key="normal")
            nearness = as_number(nearness, key="nearness", least=0.0, most=1.0)
        force, self._state = force_on_hand(hand, refused, normal, nearness, self._state, self._settings)
        return force


class HandSettings(NamedTuple):
    """The settings of a `Feedback`, see there, and this module's constants; `part` is the smoothing per step."""

    dt: float
    damping: float
    largest: float
    sharpest: float
    part: float
    most_stored: float = _MOST_STORED
    slow_hand: float = _SLOW_HAND
    seed: float = _SEED
    leak: float = _LEAK


@compiled
def force_on_hand(
    hand: Vector, refused: Vector, normal: Vector, nearness: float, state: HandState, settings: HandSettings, /
) -> tuple[Vector, HandState]:
    """(3,) the force of `Feedback.next`, and the state after it.

    Parameters
    ----------
    state: the force before (3), the smoothed force before it was bounded and scaled (3) [N], the energy that the hand
        has put in and that may be given back [J], and the scale of the force.
    """
    # three numbers each: plain numbers cost a fraction of what arrays would
    (hx, hy, hz), (rx, ry, rz), (nx, ny, nz) = hand.tolist(), refused.tolist(), normal.tolist()
    fx, fy, fz, *smooth, stored, scale = state
    dt, damping, largest, sharpest, part, most_stored, slow_hand, seed, leak = settings
    stored = min(stored - dt * (fx * hx + fy * hy + fz * hz), most_stored)
    into = hx * nx + hy * ny + hz * nz
    there = nearness * into
    tx, ty, tz = hx - there * nx, hy - there * ny, hz - there * nz
    size = math.sqrt(tx * tx + ty * ty + tz * tz) + slow_hand
    along = max(rx * tx + ry * ty + rz * tz, 0.0) / (size * size)
    inward = nearness * (max(rx * nx + ry * ny + rz * nz, 0.0) + max(into, 0.0))
    sx, sy, sz = (
        before - part * (damping * (inward * normal_part + along * tangent) + before)
        for before, normal_part, tangent in zip(smooth, (nx, ny, nz), (tx, ty, tz), strict=True)
    )
    fx, fy, fz = sx, sy, sz
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    if size > 0.0:
        bounded = largest * math.tanh(size / largest)
        along = (fx * hx + fy * hy + fz * hz) * bounded / size
        most = dt * (along + bounded * sharpest * dt)
        held = max(stored + (seed if along <= 0.0 else 0.0), leak)
        # the stored energy is neither spent nor released all at once, so that the scale is smooth too
        scale = min(scale + part, 1.0)
        if most > 0.0:
            scale = min(scale, max(part * held, leak) / most)
        by = bounded / size * scale
        fx, fy, fz = fx * by, fy * by, fz * by
    return np.array((fx, fy, fz)), (fx, fy, fz, sx, sy, sz, stored, scale)
