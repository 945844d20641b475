"""Where a machine stands in the site."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import as_number, as_vector


@dataclass(frozen=True)
class Base:
    """Where the root link of a machine stands: upright, at the height 0 of the world.

    Attributes
    ----------
    position: x, y of the root link [m], world.
    heading: the angle about the vertical from the world's x to the root link's [rad].

    Raises
    ------
    InputError: not two finite numbers, or not one.
    """

    position: tuple[float, float] = (0.0, 0.0)
    heading: float = 0.0

    def __post_init__(self) -> None:
        x, y = as_vector(self.position, 2, key="base.position").tolist()
        object.__setattr__(self, "position", (x, y))
        object.__setattr__(self, "heading", as_number(self.heading, key="base.heading"))

    @property
    def placement(self) -> pin.SE3:
        """T_world_root."""
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        turned = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return pin.SE3(turned, np.array([*self.position, 0.0]))

    @property
    def is_origin(self) -> bool:
        """Whether root link and world have the same axes."""
        return self == ORIGIN


ORIGIN = Base()  # root link and world have the same axes
