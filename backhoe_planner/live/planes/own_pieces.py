"""The pieces of a machine and of what it may carry, and which of them must not touch each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import LinkPiece, Robot, self_pairs, self_pieces

NO_LOAD = -1  # load number of what is always there


@dataclass(frozen=True, eq=False)
class OwnPieces:
    """The pieces of a machine, followed by those of its loads.

    Attributes
    ----------
    pieces: those of `Robot.pieces`, finer ones that count in their place, and the loads'.
    pairs: rows of two pieces that must not touch, the outer one first.
    load_of_pair: for each pair the number of the load with which it counts, `NO_LOAD` if it always counts.
    rows_of_load: for each load the rows of its pieces, in their order.
    """

    pieces: tuple[LinkPiece, ...]
    pairs: tuple[tuple[int, int], ...]
    load_of_pair: tuple[int, ...]
    rows_of_load: tuple[tuple[int, ...], ...]


def own_pieces(robot: Robot, laden: Sequence[Robot], q: Vector | None, *, self_collision: bool) -> OwnPieces:
    """The pieces of `robot` and of what it carries in each of `laden`, which are otherwise the same machine.

    Parameters
    ----------
    q: (n,) where it begins [rad or m]. A q outside the joint limits extends the joints' ranges, see `self_pairs`.
    self_collision: whether the machine is kept clear of itself, and its loads of the machine.
    """
    posture = None
    if q is not None and np.any((q < robot.limits.lower) | (q > robot.limits.upper)):
        posture = tuple(q.tolist())
    pieces = list(self_pieces(robot) if self_collision else robot.pieces)
    pairs = list(self_pairs(robot, posture).kept if self_collision else ())
    loads, rows_of_load = [NO_LOAD] * len(pairs), []
    for number, one in enumerate(laden):
        theirs = self_pieces(one) if self_collision else one.pieces
        rows = {row: row for row in range(len(robot.pieces))}

        def taken(row: int, theirs: Sequence[LinkPiece] = theirs, rows: dict[int, int] = rows) -> int:
            if row not in rows:
                rows[row] = len(pieces)
                pieces.append(theirs[row])
            return rows[row]

        rows_of_load.append(tuple(taken(row) for row in range(len(robot.pieces), len(one.pieces))))
        name = one.carried[0] if one.carried is not None else None
        if self_collision:
            kept = [pair for pair in self_pairs(one, posture).kept if name in {theirs[row].link for row in pair}]
            pairs += [(taken(outer), taken(inner)) for outer, inner in kept]
            loads += [number] * len(kept)
    return OwnPieces(tuple(pieces), tuple(pairs), tuple(loads), tuple(rows_of_load))


def rows_on(robot: Robot, laden: Sequence[Robot], own: OwnPieces, links: Collection[str] | None) -> list[int]:
    """Rows that move and that an obstacle limited to these `links` applies to, including those of loads."""
    count = len(robot.pieces)
    rows = list(robot.pieces_of(links))
    for one, of_load in zip(laden, own.rows_of_load, strict=True):
        rows += [of_load[row - count] for row in one.pieces_of(links) if row >= count]
    return rows
