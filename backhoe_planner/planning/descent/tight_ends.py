"""Ends of a curve that stay where they are, and are nearer to something than a descent otherwise keeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.site import Proximity

_PART = 0.5  # part of a margin at such an end, that is kept there; chosen: a curve may come nearer before it leaves
_SLOPE = 0.1  # m of spare for each metre that a link may have moved from there; chosen: all of it after 3 cm


class TightEnds:
    """The spare of each pair beyond its clearance: less near an end at which the pair has less.

    No curve could keep the whole spare there. It grows with the way that the links of the pair may have moved.

    Parameters
    ----------
    ends: (n,) each, configurations that a descent does not move [rad or m].
    spare: elsewhere [m].
    time: at which the positions of the obstacles are taken [s].
    """

    def __init__(self, proximity: Proximity, ends: Sequence[Vector], *, spare: float, time: float) -> None:
        self._proximity, self._spare = proximity, spare
        self._tight: list[tuple[Vector, Vector]] = []  # an end, and what each pair keeps there
        for q in ends:
            nearby = proximity.at(q, time=time, margin=spare)
            less = nearby.margin < spare
            if less.any():
                kept = np.full(len(proximity.travel), spare)
                kept[nearby.pair[less]] = _PART * np.maximum(nearby.margin[less], 0.0)
                self._tight.append((np.array(q), kept))

    def __bool__(self) -> bool:
        """Whether any end is tight."""
        return bool(self._tight)

    def spares(self, q: Matrix, pairs: Indices) -> Vector:
        """(M,) what each of `pairs` (M,) keeps beyond its clearance at q (M, n), one configuration for each [m]."""
        travel, found = self._proximity.travel[pairs], np.full(len(pairs), self._spare)
        for end, kept in self._tight:
            found = np.minimum(found, kept[pairs] + _SLOPE * np.sum(travel * np.abs(q - end), axis=1))
        return found
