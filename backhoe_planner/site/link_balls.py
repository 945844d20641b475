"""Balls that cover a machine's links."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.machine import Robot, covering_balls


class LinkBalls:
    """Balls that cover the pieces of one machine.

    Attributes
    ----------
    radii: (S,) [m].
    first: (pieces + 1,) where the balls of each piece begin.
    """

    def __init__(self, robot: Robot) -> None:
        balls = [covering_balls(piece.piece) for piece in robot.pieces]
        self.first = np.cumsum([0, *(len(centres) for centres, _ in balls)])
        self._centres = np.vstack([np.zeros((0, 3)), *(centres for centres, _ in balls)])
        self.radii = np.concatenate([np.zeros(0), *(np.full(len(centres), radius) for centres, radius in balls)])
        self._joint = np.repeat(np.array([piece.joint for piece in robot.pieces], dtype=int), np.diff(self.first))
        self._joints = np.unique(self._joint)
        self._rows = [np.flatnonzero(self._joint == joint) for joint in self._joints]

    def at(self, data: pin.Data) -> Matrix:
        """(S, 3) centres of all balls [m], world, where the joints of `data` are."""
        found = np.empty_like(self._centres)
        for joint, rows in zip(self._joints.tolist(), self._rows, strict=True):
            place = data.oMi[joint]
            found[rows] = self._centres[rows] @ place.rotation.T + place.translation
        return found

    def least_of_pieces(self, values: Array) -> Array:
        """(..., pieces) the least over each piece's balls of `values` (..., S) less their radii [m]."""
        return np.asarray(np.minimum.reduceat(values - self.radii, self.first[:-1], axis=-1))
