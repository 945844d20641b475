"""The ground at the teeth: how deep they are in it, how it slopes there, and the soil in the bucket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array, Vector


@dataclass(frozen=True, eq=False)
class GroundContact:
    """The contact of the teeth with the ground, at places of any shape (...).

    Attributes
    ----------
    depth: (...) vertical depth of the teeth below the ground [m]; negative above it.
    gradient: (..., 2) dz/dx and dz/dy of the ground; None if it is level.
    surcharge: (...) load on the ground beside the blade [Pa], besides the soil's own; None for none.
    held: (...) mass of the soil in the bucket [kg]; None for none.
    """

    depth: Array
    gradient: Array | None = None
    surcharge: Array | None = None
    held: Array | None = None


class Ground(Protocol):
    """What the soil's force on the teeth depends on besides the soil."""

    @property
    def held_at(self) -> Vector | None:
        """(3,) centre of the soil in the bucket, in the frame of the last joint [m]; None for the tip."""

    def contact(self, tip_position: Array) -> GroundContact:
        """The contact of teeth at (..., 3) [m], world, with the ground."""


@dataclass(frozen=True)
class LevelGround:
    """Ground that is level and unbounded; the bucket holds nothing.

    Attributes
    ----------
    height: z of the ground [m], world.
    """

    height: float = 0.0

    @property
    def held_at(self) -> Vector | None:
        """None: nothing is held."""
        return None

    def contact(self, tip_position: Array) -> GroundContact:
        """The contact of teeth at (..., 3) [m], world, with the ground."""
        return GroundContact(depth=self.height - np.asarray(tip_position, dtype=float)[..., 2])
