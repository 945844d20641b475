"""What a machine has to keep, such as the tilt of a cup, as far as it tells velocities of the joints apart."""

from __future__ import annotations

from typing import NamedTuple

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import Rows


class KeptRows(NamedTuple):
    """The conditions to be kept, where the machine is.

    Attributes
    ----------
    G: (K, n) gradients of the conditions' margins.
    left: (K,) margins, negative where a condition is broken [rad or m].
    near: (M, n) those gradients whose margins are small, times how small. A machine that gives way does so in a
        direction that changes these little, if there is one.
    ahead: of the velocity of the next step, so that the machine keeps the conditions where it can stop straight ahead.
    early: of the velocity with which the machine begins early enough to evade what moves within the conditions; they
        count less than these. None if the servo has not found them.
    firm: whether a machine that is too close to what stands still may not come out at the cost of a condition.
        Otherwise it may, if there is no other way.
    """

    G: Matrix
    left: Vector
    near: Matrix
    ahead: Rows
    firm: bool
    early: Rows | None = None
