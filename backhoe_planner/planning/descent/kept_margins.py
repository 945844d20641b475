"""The margins of what has to be kept, at the places of one descent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import Cone, Keep

_OF_SPARE = 0.1  # part of the spare beyond clearances [m] that counts for kept conditions [rad or m]; chosen
_OF_CONE = 0.1  # part of a cone that is spared at most; chosen
_OF_END = 0.5  # part of the margin at an end that stays where it is, which is spared at most; chosen
_NOTHING = 1e-9  # rad or m: of a smaller spare, any miss counts as all
_USABLE = 0.5  # part of the spare that a clear curve may use; chosen: between its places it needs the rest


class KeptMargins:
    """Margins of the conditions of a `keep`, beyond a spare that is less in a narrow cone.

    Parameters
    ----------
    spare: kept beyond every clearance [m].
    allowed: of which a curve that counts as clear may miss so much [m].
    ends: (n,) each, configurations that stay where they are [rad or m].

    Attributes
    ----------
    spares: (K,) of the conditions [rad or m].
    """

    def __init__(self, keep: Keep, *, spare: float, allowed: float, ends: Sequence[Vector] = ()) -> None:
        self.keep, self._allowed = keep, allowed
        self.spares: Vector = np.full(len(keep.conditions), _OF_SPARE * spare)
        for index, one in enumerate(keep.conditions):
            if isinstance(one, Cone):
                at_ends = one.margins(one.values(np.array(ends))) if len(ends) else np.full(1, np.inf)
                least = max(_OF_END * float(np.min(at_ends)), 0.0)
                self.spares[index] = min(self.spares[index], _OF_CONE * one.usable, least)

    def at(self, q: Matrix) -> tuple[Matrix, Matrix, Array]:
        """(N, K) margins at `q` (N, n) beyond the spares, (N, K) the same as clearances [m], and (N, K, n) gradients.

        A curve counts as clear if it misses the spare beyond a clearance by at most what is allowed. So it does if it
        misses half of the spare of a condition: as a clearance, the margin is lower by as much as the missed part of
        that.
        """
        margins, gradients, owner = self.keep.facets_each(q)
        spares = self.spares[owner]
        margins = margins - spares
        missed = np.minimum(np.maximum(-margins, 0.0) / np.maximum(_USABLE * spares, _NOTHING), 1.0)
        return margins, margins - self._allowed * missed, gradients
