"""Ends of a curve that stay where they are, and are nearer to something than a descent otherwise keeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Vector
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
        self._tight: list[tuple[Vector, Indices, Vector]] = []
        for q in ends:
            nearby = proximity.at(q, time=time, margin=spare)
            less = nearby.margin < spare
            if less.any():
                kept = _PART * np.maximum(nearby.margin[less], 0.0)
                self._tight.append((np.array(q), nearby.pair[less], kept))

    def __bool__(self) -> bool:
        """Whether any end is tight."""
        return bool(self._tight)

    def spares(self, q: Vector, pairs: Indices) -> Vector:
        """(M,) what each of `pairs` (M,) keeps beyond its clearance at `q` (n,) [m]."""
        travel = self._proximity.travel
        found = np.full(len(travel), self._spare)
        for end, tight, kept in self._tight:
            found[tight] = np.minimum(found[tight], kept + _SLOPE * (travel[tight] @ np.abs(q - end)))
        return np.asarray(found[pairs])
