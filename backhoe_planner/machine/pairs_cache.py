"""Which pairs of a machine's own pieces must keep apart, as a record, and kept in the user's cache folder.

With meshes they take up to a second or two to work out, with many primitives some hundredths of one. An
entry belongs to all that they depend on: the URDF, the pieces with the triangles in them, the joints and
their ranges, to the code that works them out and to the versions of the libraries that it calls.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from backhoe_planner.arrays import Array
from backhoe_planner.files.cache import caches, keep_entry, maker_digest, read_entry
from backhoe_planner.machine.finer_pairs import FinerPiece
from backhoe_planner.machine.robot import Robot
from backhoe_planner.machine.shape.shapes import Piece

_MAKERS = (
    "self_collision.py", "finer_pairs.py", "marks_outside.py", "proven_apart.py", "collision_model.py",
    "pairs_cache.py", "robot.py", "shape/shapes.py", "shape/overlap.py", "shape/closed_bodies.py",
)  # fmt: skip
_LIBRARIES = ("coal", "pin", "numpy")


@dataclass(frozen=True)
class LeftOut:
    """Two links of which some pieces do not count as a pair that must keep apart.

    Attributes
    ----------
    link, other: names of the links, the one further out first.
    touch: whether they touch by construction; else they cannot meet.
    why: in words.
    """

    link: str
    other: str
    touch: bool
    why: str


@dataclass(frozen=True)
class SelfPairs:
    """The pairs of a machine's own pieces.

    Attributes
    ----------
    kept: pairs of indices into `self_pieces`, those of the robot and finer ones, that must not touch each other.
    left_out: why the other pairs of links that move against each other need not be looked at.
    divided: pairs of indices into `Robot.pieces` in whose place finer pieces are among those that are kept.
    finer: these finer pieces.
    """

    kept: tuple[tuple[int, int], ...]
    left_out: tuple[LeftOut, ...]
    divided: tuple[tuple[int, int], ...] = ()
    finer: tuple[FinerPiece, ...] = ()


def key_of(robot: Robot) -> bytes:
    """A digest of all that a machine's pairs depend on, the same for every copy of it and in every process."""
    digest = hashlib.sha256(_maker() + repr((robot.tip, sorted(robot.hold.items()))).encode() + robot.urdf.xml)
    for array in _arrays_of(robot):
        digest.update(repr(array.shape).encode() + np.ascontiguousarray(array, dtype=float).tobytes())
    digest.update("\n".join(f"{piece.link} {type(piece.piece.shape).__name__}" for piece in robot.pieces).encode())
    return digest.digest()


def _arrays_of(robot: Robot) -> Iterator[Array]:
    yield from (robot.limits.lower, robot.limits.upper)
    yield from (placement.homogeneous for placement in robot.model.jointPlacements)
    if robot.tube is not None and robot.prismatic.any():  # how far a slide runs out counts, and its error with it
        yield robot.tube.joints
    for piece in robot.pieces:
        own = piece.piece
        yield from (np.array([piece.joint, own.radius, own.prism]), own.placement.homogeneous, own.hull)
        yield from _inner_of(own)


def _inner_of(piece: Piece) -> Iterator[Array]:
    """What the inner shape of a piece is made of."""
    if piece.make_inner is not None:
        if not isinstance(piece.make_inner, partial):
            raise TypeError("an inner shape is made by a partial call of a function of arrays")
        yield from piece.make_inner.args


@cache
def _maker() -> bytes:
    """Of the code that works pairs out."""
    return maker_digest(Path(__file__).parent, _MAKERS, _LIBRARIES)


def read_pairs(key: bytes) -> SelfPairs | None:
    """The pairs that are kept for a `key`; None where there are none."""
    with contextlib.suppress(RuntimeError):  # no home
        body = read_entry(_entry(key), key)
        if body is not None:
            kept, left_out, divided, finer = json.loads(body)
            return SelfPairs(
                tuple((outer, inner) for outer, inner in kept),
                tuple(LeftOut(*one) for one in left_out),
                tuple((outer, inner) for outer, inner in divided),
                tuple(FinerPiece(parent, tuple((x, y, z) for x, y, z in corners)) for parent, corners in finer),
            )
    return None


def keep_pairs(key: bytes, pairs: SelfPairs) -> None:
    """Write them into the cache folder, where that can be."""
    with contextlib.suppress(RuntimeError):
        left_out, finer = ([astuple(one) for one in own] for own in (pairs.left_out, pairs.finer))
        body = json.dumps((pairs.kept, left_out, pairs.divided, finer)).encode()
        keep_entry(_entry(key), key, body)


def _entry(key: bytes) -> Path:
    return caches() / "own_pairs" / f"{key.hex()}.json"
