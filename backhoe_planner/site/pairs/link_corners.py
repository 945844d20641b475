"""The corners of a machine's pieces, and the questions about them that one compiled call answers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import Cluster, LinkPiece, Reading
from backhoe_planner.site.pairs.link_balls import LinkBalls, Poses

KEPT, NEARER, UNKNOWN = 1, 0, -1  # verdicts on whether a piece keeps a distance
READ, FAR, SUNK = 1, 0, 2  # states of a distance; any other means not known


class LinkCorners:
    """The corners of K pieces of one machine.

    Parameters
    ----------
    pieces: K of the machine's.
    balls: those that cover them.
    """

    def __init__(self, pieces: Sequence[LinkPiece], balls: LinkBalls) -> None:
        counts = [len(own.piece.hull) for own in pieces]
        self._pieces = (
            balls.slot,
            np.ascontiguousarray(np.vstack([own.piece.hull for own in pieces])),
            np.cumsum([0, *counts]),
            np.array([own.piece.radius for own in pieces]),
        )

    def asked(self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, number: Vector) -> tuple[Any, ...]:
        """The first arguments of `kept_over_ground` and its like: M pieces in some configurations, each with a number.

        rows, pieces, number: (M,) each, the rows in order.
        """
        return (
            np.ascontiguousarray(poses.R), np.ascontiguousarray(poses.t), *self._pieces, rows, pieces, number,
            np.ascontiguousarray(cluster.placement.rotation), np.array(cluster.placement.translation),
        )  # fmt: skip


def found_readings(states: Indices, found: Matrix, *, sunk: bool = False) -> list[Reading | Literal["far"] | None]:
    """M distances from their states (M,) and numbers (M, 10): "far" if beyond the reach, None if not known.

    sunk: whether the state `SUNK` counts as known.
    """
    told = (READ, SUNK) if sunk else (READ,)
    return [
        Reading(one[0], *row[1:].reshape(3, 3)) if state in told else "far" if state == FAR else None
        for state, one, row in zip(states.tolist(), found.tolist(), found, strict=True)
    ]
