"""The box around a link, used to leave out cells that are out of its reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.native import compiled


@dataclass(frozen=True)
class LinkBox:
    """The box around a link along its own axes R (3, 3): middle (3,) and half edges (3,) along these, radius [m]."""

    R: Matrix
    middle: Vector
    half: Vector
    radius: float

    @staticmethod
    def around(hull: Matrix, R: Matrix, radius: float) -> LinkBox:
        """The box around all points within `radius` [m] of the hull of points (k, 3)."""
        own = hull @ R
        low, high = np.minimum.reduce(own, axis=0), np.maximum.reduce(own, axis=0)
        return LinkBox(R, 0.5 * (low + high), 0.5 * (high - low), radius)

    def off(self, points: Matrix) -> Vector:
        """(k,) signed distance of points (3, k) from the box [m]; a lower bound for a round link."""
        return off_turned_box(points, self.R, self.middle, self.half, self.radius)


class LinkReach(NamedTuple):
    """The region within `reach` [m] of the box around a link."""

    box: LinkBox
    reach: float


ANYWHERE = LinkReach(LinkBox(np.eye(3), np.zeros(3), np.zeros(3), 0.0), np.inf)


@compiled
def off_turned_box(points: Matrix, R: Matrix, middle: Vector, half: Vector, radius: float, /) -> Vector:
    """(k,) distance of points (3, k) from a box along axes R (3, 3), less a radius; negative inside [m].

    middle, half: (3,) of the box along its axes [m].
    """
    off = R.T @ points
    off -= middle[:, None]
    np.abs(off, out=off)
    off -= half[:, None]
    found = np.minimum(np.maximum.reduce(off, axis=0), 0.0)
    np.maximum(off, 0.0, out=off)
    off *= off
    found += np.sqrt(np.add.reduce(off, axis=0))
    found -= radius
    return np.asarray(found)
