"""A double-acting hydraulic cylinder across a joint."""

from __future__ import annotations

import math
from dataclasses import dataclass

from backhoe_planner.machine.hydraulics.linkage import Linkage

__all__ = ["Cylinder"]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder, and the linkage by which it moves its joint.

    Attributes
    ----------
    name: unique.
    joint: the joint that it moves.
    bore, rod: diameters [m].
    closed, open: shortest and longest pin-to-pin length [m].
    linkage: length and moment arm over the joint's angle.
    flow: the most that its valve passes [m^3/s].
    """

    name: str
    joint: str
    bore: float
    rod: float
    closed: float
    open: float
    linkage: Linkage
    flow: float

    @property
    def stroke(self) -> float:
        """[m]"""
        return self.open - self.closed

    @property
    def cap_area(self) -> float:
        """Of the piston, on which oil presses to extend [m^2]."""
        return 0.25 * math.pi * self.bore**2

    @property
    def annulus_area(self) -> float:
        """Of the piston less the rod, on which oil presses to retract [m^2]."""
        return 0.25 * math.pi * (self.bore**2 - self.rod**2)
