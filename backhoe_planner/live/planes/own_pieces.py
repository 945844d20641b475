"""The pieces of a machine and of what it may carry, and which of them must not touch each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import LinkPiece, Robot, self_pairs, self_pieces

NO_LOAD = -1  # number of the load of what is always there


@dataclass(frozen=True, eq=False)
class OwnPieces:
    """The pieces of a machine, and after them those of its loads.

    Attributes
    ----------
    pieces: those of `Robot.pieces`, finer ones that count in their place, and the loads'.
    pairs: rows of two pieces that must not touch, the outer one first.
    load_of_pair: for each of them the number of the load with which it counts, `NO_LOAD` where it always does.
    rows_of_load: for each load, in the order of its pieces, their rows.
    """

    pieces: tuple[LinkPiece, ...]
    pairs: tuple[tuple[int, int], ...]
    load_of_pair: tuple[int, ...]
    rows_of_load: tuple[tuple[int, ...], ...]

    def corners(self) -> Array:
        """(M, V, 4) corners of the pieces that move, with a 1 behind each; those of the others are never used [m]."""
        that_move = [row for row, piece in enumerate(self.pieces) if piece.joint > 0]
        most = max((len(self.pieces[row].piece.hull) for row in that_move), default=1)
        found = np.full((len(self.pieces), most, 4), np.nan)
        for row in that_move:
            hull = self.pieces[row].piece.hull
            found[row] = (*hull[0], 1.0)  # the first again, where others have more
            found[row, : len(hull), :3] = hull
        return found

    def radii_of_pairs(self, robot: Robot, radii: Matrix) -> list[Vector]:
        """For each pair the travel `radii` (M, n) of the outer piece, but for joints that move both alike."""
        joints = [self.pieces[inner].joint for _, inner in self.pairs]
        both = zip(self.pairs, joints, strict=True)
        return [np.where(robot.support[joint] > 0.0, 0.0, radii[outer]) for (outer, _), joint in both]

    def load_of_rows(self) -> dict[int, int]:
        """The number of the load to which a row belongs; none of the machine's own."""
        return {row: load for load, rows in enumerate(self.rows_of_load) for row in rows}


def own_pieces(
    robot: Robot, laden: Sequence[Robot], posture: tuple[float, ...] | None, *, self_collision: bool
) -> OwnPieces:
    """The pieces of `robot` and of what it carries in each of `laden`, which are the same machine otherwise.

    Parameters
    ----------
    posture: as in `self_pairs`.
    self_collision: whether the machine is kept clear of itself, and its loads of it.
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
    """Rows that move and that an obstacle which is limited to these `links` is for, the loads' among them."""
    count = len(robot.pieces)
    rows = list(robot.pieces_of(links))
    for one, of_load in zip(laden, own.rows_of_load, strict=True):
        rows += [of_load[row - count] for row in one.pieces_of(links) if row >= count]
    return rows
