"""Which of many configurations keep every clearance.

Balls cover the links. Their distances from the boxes around the obstacles are computed at
once for a whole batch of configurations. Only pairs for which these do not decide are
measured, the most doubtful first, until one is too near.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, ConfigurationBatch, Piece
from backhoe_planner.site.proximity import Proximity

_PORTION = 2_000_000  # numbers in one array at most: 16 MB
_MOST_BALLS = 8  # that cover one piece; chosen: more are tighter, and take longer


class ClearanceScreen:
    """Screens configurations with one `Proximity`, whose working memory it uses."""

    def __init__(self, proximity: Proximity) -> None:
        self._proximity = proximity
        robot = proximity.robot
        self._kinematics = BatchKinematics(robot)
        balls = [_balls(piece.piece) for piece in robot.pieces]
        self._first = np.cumsum([0, *(len(centres) for centres, _ in balls)])
        self._centres = np.vstack([np.zeros((0, 3)), *(centres for centres, _ in balls)])
        self._radii = np.concatenate([np.zeros(0), *(np.full(len(centres), radius) for centres, radius in balls)])
        self._joint = np.repeat(np.array([piece.joint for piece in robot.pieces], dtype=int), np.diff(self._first))
        self._boxes = [[_box(piece) for piece in obstacle.pieces] for obstacle in proximity.obstacles]

    def keeps(self, q: Matrix, *, time: float = 0.0, spare: float = 0.0) -> Flags:
        """(N,) whether each of `q` (N, n) keeps every clearance and `spare` [m] at `time` [s]."""
        proximity = self._proximity
        least = proximity.clearance + spare
        found = np.ones(len(q), dtype=bool)
        if not proximity.pairs or not len(q):
            return found
        portion = max(_PORTION // max(len(proximity.pairs), len(self._centres)), 1)
        for first in range(0, len(q), portion):
            part = q[first : first + portion]
            bounds = self.lower_bounds(part, time=time)
            for row, (joints, bound) in enumerate(zip(part, bounds, strict=True)):
                doubtful = np.flatnonzero(bound < least)
                order = doubtful[np.argsort((bound - least)[doubtful], kind="stable")]
                found[first + row] = proximity.all_at_least_unchecked(order, least[order], joints, time=time)
        return found

    def lower_bounds(self, q: Matrix, *, time: float = 0.0) -> Matrix:
        """(N, P) lower bounds of all distances [m] at q (N, n), `time` [s]; infinite before an obstacle appears."""
        proximity = self._proximity
        centres = self._ball_centres(self._kinematics.at(q))
        found = np.full((len(q), len(proximity.pairs)), -np.inf)
        last, off = (-1, -1), np.zeros((0, 0))
        for index, pair in enumerate(proximity.pairs):
            own = slice(self._first[pair.piece], self._first[pair.piece + 1])
            owner = int(proximity.owner[index])
            if owner >= 0:
                if proximity.appears_at[index] > time:
                    found[:, index] = np.inf
                    continue
                here = (owner, proximity.second[index])
                if here != last:
                    off = self._off_box(centres, owner, here[1], time)
                    last = here
                found[:, index] = np.min(off[:, own] - self._radii[own], axis=1)
            else:
                other = proximity.second[index]
                across = slice(self._first[other], self._first[other + 1])
                apart = np.linalg.norm(centres[:, own, None, :] - centres[:, None, across, :], axis=3)
                reach = self._radii[own, None] + self._radii[None, across]
                found[:, index] = np.min(apart - reach, axis=(1, 2))
        return found

    def _off_box(self, centres: Array, owner: int, part: int, time: float) -> Matrix:
        """(N, S) signed distance of every ball's centre from the box around one piece of an obstacle [m]."""
        box = self._boxes[owner][part]
        shift = self._proximity.obstacle_offset(owner, time)
        if box is None:  # a half-space
            piece = self._proximity.obstacles[owner].pieces[part]
            normal = np.asarray(piece.shape.n)
            level = float(piece.shape.d) + float(normal @ (piece.placement.translation + shift))
            return np.asarray(centres @ normal - level)
        R, middle, half, radius = box
        off = np.abs((centres - (middle + shift)) @ R) - half
        outside = np.linalg.norm(np.maximum(off, 0.0), axis=2)
        return np.asarray(outside + np.minimum(np.max(off, axis=2), 0.0) - radius)

    def _ball_centres(self, at: ConfigurationBatch) -> Array:
        """(N, S, 3) centres of all balls [m], world."""
        fixed = self._joint == 0
        joint = np.maximum(self._joint - 1, 0)
        moved = np.einsum("bsij,sj->bsi", at.rotations[:, joint], self._centres) + at.origins[:, joint]
        return np.where(fixed[None, :, None], self._centres[None], moved)


def _balls(piece: Piece) -> tuple[Matrix, float]:
    """(k, 3) centres and a radius [m]: balls that cover a link's piece, in its body's frame."""
    R, middle, half, radius = _box(piece) or (np.eye(3), np.zeros(3), np.zeros(3), 0.0)
    longest = int(np.argmax(half))
    rest = float(np.linalg.norm(np.delete(half, longest)))
    count = int(np.clip(np.ceil(half[longest] / max(rest + radius, 1e-9)), 1, _MOST_BALLS))
    cell = half.copy()
    cell[longest] /= count
    along = (2.0 * np.arange(count) + 1.0) * cell[longest] - half[longest]
    centres = middle + along[:, None] * R[:, longest]
    return centres, float(np.linalg.norm(cell)) + radius


def _box(piece: Piece) -> tuple[Matrix, Vector, Vector, float] | None:
    """The box around a piece's hull in its own axes: R (3, 3), middle (3,), half edges (3,), and radius [m].

    None for a half-space.
    """
    if not len(piece.hull):
        return None
    R = piece.placement.rotation
    own = piece.hull @ R
    low, high = own.min(axis=0), own.max(axis=0)
    return R, R @ (0.5 * (low + high)), 0.5 * (high - low), piece.radius
