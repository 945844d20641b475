"""The force that goes back to the hand: what the machine refuses, and never any energy.

    F_wished = -B (r . t)^+ t  -  B rho(margin) ((r . n)^+ + (x_w . n)^+) n,    r = x_free - x

r is the refused part of the wish: what the tip would do with nothing in the way and no
joint limit, minus what it does. The hand feels its components into the obstacle (n) and
along the rest of the hand's own motion (t). The rest of r is left out, so that the hand is
not pulled aside when the machine gives way. rho rises smoothly from 0 to 1 as an obstacle
comes near, before anything is refused. The force saturates smoothly at its largest.

The force is smoothed over a hundredth of a second, so that it does not jump.

Passivity: a ledger (a passivity observer after Hannaford and Ryu, 2002) holds the energy
that the hand has given so far. A force F holds until the next sample. Until then the hand
moves at its velocity w, changed by at most dw. F is scaled so that the most energy that it
can give, dt (F . w + |F| dw), is no more than the ledger holds.
"""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Vector, as_number, as_vector
from backhoe_planner.live.braking.joint_bounds import TOLERANCE

_SEED = 1e-7  # J that a force against the hand may use before the hand has given any; chosen, too little to feel
_LEAK = 1e-13  # J per sample, so that an empty ledger can fill again; about a millionth of that
_SMOOTHED_OVER = 0.01  # s: chosen, faster than a hand reacts
_SLOW_HAND = 0.02  # m/s: chosen, the direction of a slower hand is mostly noise
_MOST_STORED = 0.2  # J that the ledger holds at most: chosen, so that a long push is not given back as one blow
_REMEMBERED = 0.02  # s for which being held back counts, so that a status does not flicker; chosen


class Refusal:
    """Compares the machine with one that has nothing in its way.

    Parameters
    ----------
    dt: length of a step [s].
    changes: n numbers, by how much a joint's velocity can change in a step [rad/s or m/s].
    """

    def __init__(self, dt: float, changes: list[float]) -> None:
        self._changes = changes
        self._free = [0.0] * len(changes)  # velocities with nothing in the way
        self._forgets = 1.0 - math.exp(-dt / _REMEMBERED)
        self._steps = max(math.ceil(_REMEMBERED / dt), 1)
        self._counts_for = 0

    def remember(self, *, held_back: bool) -> bool:
        """Whether the machine is held back, or was just now."""
        self._counts_for = self._steps if held_back else self._counts_for - 1
        return self._counts_for > 0

    def next(self, v: Vector, *, wish: Vector, target: Vector) -> Vector:
        """(n,) the velocity that is refused in a step at v (n,); see `VelocityWish` for `wish` and `target` (n,)."""
        rates, wishes = v.tolist(), wish.tolist()
        joints = zip(self._free, wishes, rates, target.tolist(), self._changes, strict=True)
        # a joint that goes at its target has caught up with what it would have done
        self._free = [
            free
            + (min(max(aim - free, -most), most) if abs(rate - goal) > TOLERANCE else self._forgets * (rate - free))
            for free, aim, rate, goal, most in joints
        ]
        return np.array([free - rate - aim for free, rate, aim in zip(self._free, rates, wishes, strict=True)])


class Feedback:
    """The force on one hand.

    Parameters
    ----------
    dt: time between samples, over which a force is held [s].
    damping: B, the force per refused speed [N s/m].
    largest: the force that is approached and never exceeded [N].
    sharpest: greatest acceleration of the hand for which passivity holds [m/s^2].
    """

    def __init__(self, dt: float, *, damping: float = 60.0, largest: float = 30.0, sharpest: float = 200.0) -> None:
        dt, damping = as_number(dt, key="dt", above=0.0), as_number(damping, key="damping", least=0.0)
        largest, sharpest = as_number(largest, key="largest", above=0.0), as_number(sharpest, key="sharpest", least=0.0)
        self._dt = dt
        self._damping = damping
        self._largest = largest
        self._change = sharpest * dt
        self._stored = 0.0  # J that the hand has given and that may still come back
        self._force: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._smooth = [0.0, 0.0, 0.0]
        self._scale = 1.0
        self._part = 1.0 - math.exp(-dt / _SMOOTHED_OVER)

    def next(self, hand: Vector, refused: Vector, normal: Vector, nearness: float) -> Vector:
        """(3,) force on the hand, to be held until the next sample [N], world.

        Parameters
        ----------
        hand: (3,) velocity of the hand since the last sample, which is the wish [m/s], world.
        refused: (3,) part of it that the tip does not follow [m/s], world.
        normal: (3,) unit vector into the nearest obstacle, world; zeros where none is near.
        nearness: rho, 0 where obstacles are far, 1 where no more approach is possible.
        """
        # three numbers each: plain numbers cost a fraction of what arrays would
        try:
            (hx, hy, hz), (rx, ry, rz), (nx, ny, nz) = hand.tolist(), refused.tolist(), normal.tolist()
            right = (
                isinstance(nearness, float)
                and 0.0 <= nearness <= 1.0
                and math.isfinite(hx + hy + hz + rx + ry + rz + nx + ny + nz)
            )
        except (AttributeError, TypeError, ValueError):
            right = False
        if not right:
            hx, hy, hz = as_vector(hand, 3, key="hand").tolist()
            rx, ry, rz = as_vector(refused, 3, key="refused").tolist()
            nx, ny, nz = as_vector(normal, 3, key="normal").tolist()
            nearness = as_number(nearness, key="nearness", least=0.0, most=1.0)
        fx, fy, fz = self._force
        self._stored = min(self._stored - self._dt * (fx * hx + fy * hy + fz * hz), _MOST_STORED)
        into = hx * nx + hy * ny + hz * nz
        there = nearness * into
        tx, ty, tz = hx - there * nx, hy - there * ny, hz - there * nz
        size = math.sqrt(tx * tx + ty * ty + tz * tz) + _SLOW_HAND
        along = max(rx * tx + ry * ty + rz * tz, 0.0) / (size * size)
        inward = nearness * (max(rx * nx + ry * ny + rz * nz, 0.0) + max(into, 0.0))
        part, damping = self._part, self._damping
        self._smooth = [
            before - part * (damping * (inward * normal_part + along * tangent) + before)
            for before, normal_part, tangent in zip(self._smooth, (nx, ny, nz), (tx, ty, tz), strict=True)
        ]
        fx, fy, fz = self._smooth
        size = math.sqrt(fx * fx + fy * fy + fz * fz)
        if size > 0.0:
            bounded = self._largest * math.tanh(size / self._largest)
            along = (fx * hx + fy * hy + fz * hz) * bounded / size
            most = self._dt * (along + bounded * self._change)
            held = max(self._stored + (_SEED if along <= 0.0 else 0.0), _LEAK)
            # what is stored is neither spent at once nor released at once, so that the scale is smooth too
            scale = min(self._scale + part, 1.0)
            if most > 0.0:
                scale = min(scale, max(part * held, _LEAK) / most)
            self._scale = scale
            by = bounded / size * scale
            fx, fy, fz = fx * by, fy * by, fz * by
        self._force = (fx, fy, fz)
        return np.array(self._force)
