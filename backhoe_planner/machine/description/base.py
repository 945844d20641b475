"""The placement of a machine in the site."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import as_number, as_vector


@dataclass(frozen=True)
class Base:
    """The placement of a machine's root link: upright, at height 0 of the world.

    Attributes
    ----------
    position: x, y of the root link [m], world.
    heading: the angle about the vertical from the world's x axis to the root link's [rad].

    Raises
    ------
    InputError: `position` is not two finite numbers, or `heading` not one.
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
        """Whether the frames of the root link and the world are the same."""
        return self == ORIGIN


ORIGIN = Base()  # the frames of the root link and the world are the same
