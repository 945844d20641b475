"""The rows of the pairs that are near."""

from __future__ import annotations

import reprlib
from dataclasses import dataclass, fields

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.errors import InputError


@dataclass(eq=False, slots=True)
class Nearby:
    """The pairs within a distance, one row each, in the order of `Proximity.pairs`; read-only.

    Attributes
    ----------
    pair: (K,) indices into `Proximity.pairs`.
    distance: (K,) signed distance [m], negative inside.
    margin: (K,) distance minus the clearance to be kept [m].
    normal: (K, 3) unit normal from the link to the obstacle, world.
    point_link, point_obstacle: (K, 3) critical point and its witness [m], world.
    gradient: (K, n) derivative of the distance [m/rad].
    drift: (K,) rate at which the obstacle's own motion changes the distance [m/s].
    """

    pair: Indices
    distance: Vector
    margin: Vector
    normal: Matrix
    point_link: Matrix
    point_obstacle: Matrix
    gradient: Matrix
    drift: Vector

    def __len__(self) -> int:
        return len(self.pair)

    def only(self, rows: Flags) -> Nearby:
        """The rows for which `rows` (K,) is true."""
        if np.shape(rows) != (len(self),) or np.asarray(rows).dtype != bool:
            allowed = f"{len(self)} times True or False"
            raise InputError("is not true or false of every row", key="rows", found=reprlib.repr(rows), allowed=allowed)
        rows = np.asarray(rows)
        return Nearby(*(getattr(self, field.name)[rows] for field in fields(self)))
