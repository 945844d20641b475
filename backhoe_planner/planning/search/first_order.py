"""How the conditions of a `keep` limit a step, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import KEPT_TO, Keep, least_step_unchecked

_TURNS = 3  # corrections of a step that leaves the conditions; chosen: 1 is usual
_LEFT = 0.5  # part of a margin that a corrected step leaves; chosen


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """Margins (K,) at a configuration [rad or m], and their gradients (K, n)."""

    margins: Vector
    gradients: Matrix

    @classmethod
    def at(cls, keep: Keep, q: Vector) -> FirstOrder:
        """The margins at the joints `q` (n,), in several directions of every cone."""
        margins, gradients, _ = keep.facets_each(q[None])
        return cls(margins[0], gradients[0])

    def kept_by(self, step: Vector) -> Vector:
        """(n,) a step near `step` (n,) [rad or m] that takes no margin below 0, to first order."""
        for _ in range(_TURNS):
            after = self.margins + self.gradients @ step
            out = after < np.minimum(self.margins, 0.0) - KEPT_TO
            if not out.any():
                break
            G, missing = self.gradients[out], _LEFT * np.maximum(self.margins[out], 0.0) - after[out]
            step = step + least_step_unchecked(G, missing)
        return step
