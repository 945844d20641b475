"""The record of the pairs of a machine's own pieces that must keep apart, and its entry in the user's cache folder.

With meshes the pairs take up to a second or two to find, with many primitives some hundredths of a second. The
key of an entry covers all that they depend on: the URDF, the pieces with their triangles, the joints and
their ranges, the code that finds them, and the versions of the libraries that the code calls.
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
    """Two links of which some pairs of pieces are left out and need not keep apart.

    Attributes
    ----------
    link, other: names of the links, the one further out first.
    touch: whether they touch by construction; otherwise they cannot meet.
    why: the reason in words.
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
    kept: pairs of indices into `self_pieces`, the robot's pieces and the finer ones, that must not touch each other.
    left_out: why the other pairs of links that move against each other need not be checked.
    divided: pairs of indices into `Robot.pieces` that pairs of finer pieces replace in `kept`.
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
    if robot.tube is not None and robot.prismatic.any():  # the reach of a slide matters, and so its tracking error
        yield robot.tube.joints
    for piece in robot.pieces:
        own = piece.piece
        yield from (np.array([piece.joint, own.radius, own.prism]), own.placement.homogeneous, own.hull)
        yield from _inner_of(own)


def _inner_of(piece: Piece) -> Iterator[Array]:
    """The arrays from which the inner shape of a piece is made."""
    if piece.make_inner is not None:
        if not isinstance(piece.make_inner, partial):
            raise TypeError("an inner shape is made by a partial call of a function of arrays")
        yield from piece.make_inner.args


@cache
def _maker() -> bytes:
    """A digest of the code that finds the pairs."""
    return maker_digest(Path(__file__).parent, _MAKERS, _LIBRARIES)


def read_pairs(key: bytes) -> SelfPairs | None:
    """The stored pairs for a `key`; None if there are none."""
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
    """Write the pairs into the cache folder, if possible."""
    with contextlib.suppress(RuntimeError):
        left_out, finer = ([astuple(one) for one in own] for own in (pairs.left_out, pairs.finer))
        body = json.dumps((pairs.kept, left_out, pairs.divided, finer)).encode()
        keep_entry(_entry(key), key, body)


def _entry(key: bytes) -> Path:
    return caches() / "own_pairs" / f"{key.hex()}.json"
