"""The pieces of a machine and of what it may carry, and which of them must not touch each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
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

    def corners(self) -> Array:
        """(M, V, 4) corners of the pieces that move, with a 1 appended to each; other pieces are never used [m]."""
        that_move = [row for row, piece in enumerate(self.pieces) if piece.joint > 0]
        most = max((len(self.pieces[row].piece.hull) for row in that_move), default=1)
        found = np.full((len(self.pieces), most, 4), np.nan)
        for row in that_move:
            hull = self.pieces[row].piece.hull
            found[row] = (*hull[0], 1.0)  # padded with the first corner if other pieces have more
            found[row, : len(hull), :3] = hull
        return found

    def radii_of_pairs(self, robot: Robot, radii: Matrix) -> list[Vector]:
        """For each pair the travel `radii` (M, n) of the outer piece, with 0 for joints that move both alike."""
        joints = [self.pieces[inner].joint for _, inner in self.pairs]
        both = zip(self.pairs, joints, strict=True)
        return [np.where(robot.support[joint] > 0.0, 0.0, radii[outer]) for (outer, _), joint in both]

    def load_of_rows(self) -> dict[int, int]:
        """For each row of a load the load's number; the machine's own rows are not included."""
        return {row: load for load, rows in enumerate(self.rows_of_load) for row in rows}


def own_pieces(
    robot: Robot, laden: Sequence[Robot], posture: tuple[float, ...] | None, *, self_collision: bool
) -> OwnPieces:
    """The pieces of `robot` and of what it carries in each of `laden`, which are otherwise the same machine.

    Parameters
    ----------
    posture: as in `self_pairs`.
    self_collision: whether the machine is kept clear of itself, and its loads of the machine.
    """
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
