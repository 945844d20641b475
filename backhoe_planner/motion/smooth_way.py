"""A path of the joints: straight legs with round corners.

At a corner the path leaves the leg at a distance d before the corner and joins the next
leg at d behind it, on the parabola that has both legs as tangents. So the corner needs no
stop. With the length s along the legs as the parameter, dq/ds turns linearly from one leg's
direction to the other's: the path is C1, and d2q/ds2 is piecewise constant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector


@dataclass(frozen=True, eq=False)
class SmoothWay:
    """Legs and parabolic corners in joint space, `way(s)`.

    Attributes
    ----------
    corners: (K, n) where the legs meet; the path does not pass through those that are cut.
    stations: (K,) length along the legs up to each corner [s of joint time].
    cuts: (K,) d of each corner; 0 at the ends and at corners that are not cut, where a motion
        must stop.
    """

    corners: Matrix
    stations: Vector
    cuts: Vector

    def __post_init__(self) -> None:
        for array in (self.corners, self.stations, self.cuts):
            array.setflags(write=False)

    @property
    def length(self) -> float:
        """Length of the legs, where s ends."""
        return float(self.stations[-1])

    @cached_property
    def _slopes(self) -> Matrix:
        """(K - 1, n) direction of each leg."""
        return np.asarray(np.diff(self.corners, axis=0) / np.diff(self.stations)[:, None])

    @property
    def knots(self) -> Vector:
        """Every s at which a leg or a round corner begins or ends, increasing, from 0 to the length."""
        return np.unique(np.concatenate((self.stations - self.cuts, self.stations + self.cuts)))

    @property
    def stops(self) -> Vector:
        """Every s at which a motion along the path must be at rest: the ends, and corners that are not cut."""
        return np.array(self.stations[self.cuts == 0.0])

    def __call__(self, s: float | Vector, order: int = 0) -> Matrix:
        """(n,) or (k, n) derivative of the given order (0, 1 or 2) with respect to s, from the right."""
        at = np.atleast_1d(np.asarray(s, dtype=float))
        slope = self._slopes
        leg = np.clip(np.searchsorted(self.stations, at, side="right") - 1, 0, len(slope) - 1)
        found = np.zeros((len(at), self.corners.shape[1]))
        if order == 0:
            found = self.corners[leg] + (at - self.stations[leg])[:, None] * slope[leg]
        elif order == 1:
            found = slope[leg]
        ahead = leg + 1
        # the only corner whose parabola may extend to s
        corner = np.where(at >= self.stations[ahead] - self.cuts[ahead], ahead, leg)
        begin, whole = self.stations[corner] - self.cuts[corner], 2.0 * self.cuts[corner]
        cut = np.flatnonzero((whole > 0.0) & (at >= begin) & (at < begin + whole))
        if len(cut):
            corner, d = corner[cut], self.cuts[corner[cut], None]
            into, turn = slope[corner - 1], (slope[corner] - slope[corner - 1]) / (2.0 * d)
            along = (at[cut] - begin[cut])[:, None]
            if order == 0:
                found[cut] = self.corners[corner] - d * into + along * into + 0.5 * along**2 * turn
            elif order == 1:
                found[cut] = into + along * turn
            else:
                found[cut] = turn
        return found if np.ndim(s) else found[0]
