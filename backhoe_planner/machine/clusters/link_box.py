"""The box around a link, by which cells that are out of its reach are left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.native import compiled


@dataclass(frozen=True)
class LinkBox:
    """The box around a link along axes R (3, 3) of its own: middle (3,) and half edges (3,) along these, radius [m]."""

    R: Matrix
    middle: Vector
    half: Vector
    radius: float

    @staticmethod
    def around(hull: Matrix, R: Matrix, radius: float) -> LinkBox:
        """Around all that is within `radius` [m] of the hull of points (k, 3)."""
        own = hull @ R
        low, high = np.minimum.reduce(own, axis=0), np.maximum.reduce(own, axis=0)
        return LinkBox(R, 0.5 * (low + high), 0.5 * (high - low), radius)

    def off(self, points: Matrix) -> Vector:
        """(k,) signed distance of points (3, k) from it [m]; less than the true one where the link is round."""
        return off_turned_box(points, self.R, self.middle, self.half, self.radius)


class LinkReach(NamedTuple):
    """All that is within `reach` [m] of the box around a link."""

    box: LinkBox
    reach: float


ANYWHERE = LinkReach(LinkBox(np.eye(3), np.zeros(3), np.zeros(3), 0.0), np.inf)


@compiled
def off_turned_box(points: Matrix, R: Matrix, middle: Vector, half: Vector, radius: float, /) -> Vector:
    """(k,) how far points (3, k) are off a box along axes R (3, 3), less a radius, negative inside [m].

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
