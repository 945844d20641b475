"""The shapes of a machine's pieces as arrays, and how far their points can travel.

None of this changes with the obstacles, or with what is carried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.live.planes.own_pieces import NO_LOAD, OwnPieces, rows_on
from backhoe_planner.machine import LinkPiece, Robot, tracking_room, travel_bounds


@dataclass(frozen=True, eq=False)
class OwnGeometry:
    """The M pieces of a machine and of its loads.

    Attributes
    ----------
    pieces: those of `OwnPieces`.
    joint: (M,) joint that moves the piece; 0 for the world.
    corners: (M, V, 4) in the frame of the joint, with a 1 appended to each [m]; nan if the piece does not move.
    columns: (M, 4, V) the same, transposed.
    radius: (M,) the piece is within this of the hull of its corners [m].
    shapes: of each piece coal's shape, and its placement (4, 4) in the frame of the joint.
    room: (M,) how far the tracking error may move the piece [m].
    load: (M,) number of the load that the piece belongs to, `NO_LOAD` for the machine's own.
    travel: (C, n) how far a point can travel per joint, one row for each class, see `travel_bounds`.
    class_of_piece: (M,) the class of a piece among obstacles; without meaning if no obstacle counts for it.
    class_of_pair: (O,) the class of a pair of `OwnPieces`: of its outer piece, as seen from the inner one.
    """

    pieces: tuple[LinkPiece, ...]
    joint: Indices
    corners: Array
    columns: Array
    radius: Vector
    shapes: tuple[tuple[object, Matrix], ...]
    room: Vector
    load: Indices
    travel: Matrix
    class_of_piece: Indices
    class_of_pair: Indices

    @classmethod
    def of(cls, robot: Robot, laden: Sequence[Robot], own: OwnPieces, q: Vector | None) -> OwnGeometry:
        """The geometry of `own`, the pieces of `robot` and of what it carries in `laden`; for q see `travel_bounds`."""
        pieces, radii = own.pieces, travel_bounds(robot, q, pieces=own.pieces)
        moving, corners = rows_on(robot, laden, own, None), _corners(pieces)
        rows = [*radii[moving], *_radii_of_pairs(robot, own, radii)]
        travel, classes = np.unique(np.array(rows).reshape(-1, robot.n), axis=0, return_inverse=True)
        classes = np.asarray(classes.reshape(-1), dtype=np.intp)
        class_of_piece = np.zeros(len(pieces), dtype=np.intp)
        class_of_piece[moving] = classes[: len(moving)]
        load = np.full(len(pieces), NO_LOAD, dtype=np.intp)
        for number, those in enumerate(own.rows_of_load):
            load[list(those)] = number
        return cls(
            pieces=pieces,
            joint=np.array([piece.joint for piece in pieces], dtype=np.intp),
            corners=corners,
            columns=np.ascontiguousarray(corners.transpose(0, 2, 1)),
            radius=np.array([piece.piece.radius for piece in pieces]),
            shapes=tuple((piece.piece.shape, np.array(piece.piece.placement.homogeneous)) for piece in pieces),
            room=tracking_room(robot, pieces, radii),
            load=load,
            travel=travel,
            class_of_piece=class_of_piece,
            class_of_pair=classes[len(moving) :],
        )


def _corners(pieces: tuple[LinkPiece, ...]) -> Array:
    """(M, V, 4) the field `corners` of `OwnGeometry`."""
    that_move = [row for row, piece in enumerate(pieces) if piece.joint > 0]
    most = max((len(pieces[row].piece.hull) for row in that_move), default=1)
    found = np.full((len(pieces), most, 4), np.nan)
    for row in that_move:
        hull = pieces[row].piece.hull
        found[row] = (*hull[0], 1.0)  # padded with the first corner if other pieces have more
        found[row, : len(hull), :3] = hull
    return found


def _radii_of_pairs(robot: Robot, own: OwnPieces, radii: Matrix) -> list[Vector]:
    """For each pair of `own` the travel `radii` (M, n) of the outer piece, with 0 for joints that move both alike."""
    joints = [own.pieces[inner].joint for _, inner in own.pairs]
    both = zip(own.pairs, joints, strict=True)
    return [np.where(robot.support[joint] > 0.0, 0.0, radii[outer]) for (outer, _), joint in both]
