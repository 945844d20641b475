"""Balls that cover a machine's links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import ConfigurationBatch, LinkPiece, covering_balls


@dataclass(frozen=True)
class Poses:
    """The placements of the J joints that carry some pieces, in N configurations.

    Attributes
    ----------
    R, t: (N, J, 3, 3) and (N, J, 3) T_world_joint [m].
    """

    R: Array
    t: Array

    def __len__(self) -> int:
        return len(self.R)


class LinkBalls:
    """Balls that cover K pieces of one machine: a few for each piece, and more and smaller ones on further levels.

    Parameters
    ----------
    pieces: K of the machine's.
    most: the greatest number of balls for a piece, for each level.

    Attributes
    ----------
    slot: (K,) which of the joints of `Poses` carries each piece.
    """

    def __init__(self, pieces: Sequence[LinkPiece], *, most: Sequence[int]) -> None:
        joints, slot = np.unique([own.joint for own in pieces], return_inverse=True)
        self.slot: Indices = slot
        self._joints: list[int] = joints.tolist()
        self.levels = tuple(
            BallLevel([covering_balls(own.piece, most=count) for own in pieces], slot, joints) for count in most
        )

    def poses_at(self, data: pin.Data) -> Poses:
        """The placements of the joints of `data`."""
        places = [data.oMi[joint] for joint in self._joints]
        return Poses(
            np.array([[place.rotation for place in places]]), np.array([[place.translation for place in places]])
        )

    def poses_of(self, at: ConfigurationBatch) -> Poses:
        """The placements of the joints in some configurations."""
        if self._joints[0]:
            rows = np.array(self._joints) - 1
            return Poses(at.rotations[:, rows], at.origins[:, rows])
        rows = np.array(self._joints[1:], dtype=np.intp) - 1
        R, t = np.zeros((len(at.q), len(self._joints), 3, 3)), np.zeros((len(at.q), len(self._joints), 3))
        R[:, 0], R[:, 1:], t[:, 1:] = np.eye(3), at.rotations[:, rows], at.origins[:, rows]
        return Poses(R, t)


class BallLevel:
    """S balls that cover K pieces.

    Parameters
    ----------
    balls: centres (k, 3) in the frame of its joint and radius of each piece [m], see `covering_balls`.
    slot: (K,) which of the joints of `Poses` carries each piece.
    joints: (J,) the numbers of these joints; 0 for the base.

    Attributes
    ----------
    first: (K,) the number of each piece's first ball.
    radii: (S,) of the balls [m].
    joints: (S,) the joint that each ball is fixed to.
    """

    def __init__(self, balls: Sequence[tuple[Matrix, float]], slot: Indices, joints: Indices) -> None:
        self._counts = np.array([len(centres) for centres, _ in balls])
        self.first: Indices = np.cumsum(self._counts) - self._counts
        self._slot = slot
        self._radius = np.array([radius for _, radius in balls])
        self.radii: Vector = self._radius.repeat(self._counts)
        self._centres = np.ascontiguousarray(np.vstack([centres for centres, _ in balls]).T)
        of_balls = slot.repeat(self._counts)
        self.joints: Indices = joints[of_balls]
        self._of_slots = [(one, (of_balls == one).nonzero()[0]) for one in np.unique(slot).tolist()]

    def __len__(self) -> int:
        return len(self.radii)

    @property
    def in_one(self) -> tuple[Matrix, Indices]:
        """(S, 4) centres and radii [m], and (K + 1,) where those of each piece begin and end."""
        return np.ascontiguousarray(np.column_stack((self._centres.T, self.radii))), np.append(self.first, len(self))

    def centres(self, poses: Poses) -> Array:
        """(3, N, S) centres of all balls [m], world."""
        found = np.empty((3, len(poses), len(self)))
        for slot, balls in self._of_slots:
            at = poses.R[:, slot] @ self._centres.take(balls, axis=1)
            at += poses.t[:, slot, :, None]
            found[:, :, balls] = at.transpose(1, 0, 2)
        return found

    def least(self, away: Array) -> Array:
        """(..., K) the least over each piece's balls of distances `away` (..., S) less their radii [m]."""
        return np.asarray(np.minimum.reduceat(away - self.radii, self.first, axis=-1))

    def centres_of(self, poses: Poses, rows: Indices, pieces: Indices) -> tuple[Matrix, Indices]:
        """(3, F) centres of the balls of `pieces` (M,) in the configurations `rows` (M,), in this order [m], world.

        Also how many each of the pieces has, (M,).
        """
        counts = self._counts.take(pieces)
        ends = counts.cumsum()
        balls = np.arange(ends[-1]) + (self.first.take(pieces) - ends + counts).repeat(counts)
        slots = self._slot.take(pieces)
        R = poses.R[rows, slots].transpose(1, 2, 0).repeat(counts, axis=2)
        t = poses.t[rows, slots].T.repeat(counts, axis=1)
        centres = self._centres.take(balls, axis=1)
        R *= centres
        t += np.add.reduce(R, axis=1)
        return t, counts

    def least_of(self, away: Vector, counts: Indices, pieces: Indices) -> Vector:
        """(M,) `least` for these pieces alone, from the distances (F,) of their balls [m]."""
        return np.asarray(np.minimum.reduceat(away, counts.cumsum() - counts) - self._radius.take(pieces))
