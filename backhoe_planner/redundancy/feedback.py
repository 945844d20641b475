"""The force that goes back to the hand: what the machine refuses, and never any energy.

    F_wished = -B (x_free - x)  -  B rho(margin) (x_w . n)^+ n

The first part is the refused part of the wish: what the tip would do with nothing in
the way and no joint limit, minus what it does. The second rises smoothly, before
anything is refused, as the way into an obstacle narrows. It saturates smoothly at the
largest force.

Passivity. Whatever would push along with the hand's own velocity is taken out, and a
ledger (a passivity observer after Hannaford and Ryu, 2002) holds the energy that the
hand has given so far. The force that holds until the next sample, over which the hand
may move otherwise than it did, is bounded so that it cannot give back more than the
ledger holds, however the hand moves up to its greatest speed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Feedback"]

Vector = NDArray[np.float64]

_SEED = 1e-8  # J: what may be lent before anything was taken
_MOST_STORED = 0.2  # J: of what the hand has given, this much may come back


class Feedback:
    """The force on one hand.

    Parameters
    ----------
    dt: time between samples, over which a force is held [s].
    damping: B [N s/m].
    largest: force that is approached, never exceeded [N].
    fastest: greatest speed of the hand for which passivity is promised [m/s].
    """

    def __init__(self, dt: float, *, damping: float = 60.0, largest: float = 30.0, fastest: float = 3.0) -> None:
        self._dt = dt
        self._damping = damping
        self._largest = largest
        self._fastest = fastest
        self._stored = 0.0
        self._force = np.zeros(3)

    @property
    def stored(self) -> float:
        """Energy that the hand has given and that may still come back [J]."""
        return self._stored

    def next(self, hand: Vector, refused: Vector, normal: Vector, nearness: float) -> Vector:
        """(3,) force on the hand, to be held until the next sample [N], world.

        Parameters
        ----------
        hand: (3,) velocity of the hand since the last sample: the wish [m/s].
        refused: (3,) part of it that the tip does not follow [m/s].
        normal: (3,) unit vector into the nearest obstacle; zeros where none is near.
        nearness: 0 where obstacles are far, 1 where no more approach is possible.
        """
        given = -self._dt * float(self._force @ hand)
        self._stored = min(self._stored + given, _MOST_STORED)
        force = -self._damping * (refused + nearness * max(float(hand @ normal), 0.0) * normal)
        square = float(hand @ hand)
        power = float(force @ hand)
        if power > 0.0:
            force = force - (power / square) * hand
        size = math.sqrt(float(force @ force))
        if size > 0.0:
            bounded = self._largest * math.tanh(size / self._largest)
            lent = max(self._stored + _SEED, 0.0) / (self._dt * self._fastest)
            force = force * (min(bounded, lent) / size)
        self._force = force
        return force
