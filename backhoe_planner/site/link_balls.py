"""Balls that cover a machine's links."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Matrix
from backhoe_planner.machine import Robot, covering_balls


class LinkBalls:
    """S balls that cover some pieces of one machine.

    Parameters
    ----------
    pieces: rows of the robot's pieces, K of them.
    """

    def __init__(self, robot: Robot, pieces: Sequence[int]) -> None:
        balls = [covering_balls(robot.pieces[row].piece) for row in pieces]
        counts = [len(centres) for centres, _ in balls]
        self._first = np.cumsum([0, *counts[:-1]])
        self._radii = np.repeat([radius for _, radius in balls], counts)
        joints = np.repeat([robot.pieces[row].joint for row in pieces], counts)
        centres = np.vstack([centres for centres, _ in balls])
        self._of_joints = [
            (joint, rows := np.flatnonzero(joints == joint), centres[rows]) for joint in set(joints.tolist())
        ]

    def at(self, data: pin.Data) -> Matrix:
        """(S, 3) centres of all balls [m], world, where the joints of `data` are."""
        found = np.empty((len(self._radii), 3))
        for joint, rows, centres in self._of_joints:
            place = data.oMi[joint]
            found[rows] = centres @ place.rotation.T + place.translation
        return found

    def at_each(self, origins: Array, rotations: Array) -> Array:
        """(N, S, 3) the same for N configurations: joints at `origins` (N, n, 3) [m], `rotations` (N, n, 3, 3)."""
        found = np.empty((len(origins), len(self._radii), 3))
        for joint, rows, centres in self._of_joints:
            if joint:
                found[:, rows] = centres @ rotations[:, joint - 1].transpose(0, 2, 1) + origins[:, None, joint - 1]
            else:
                found[:, rows] = centres
        return found

    def least_of_pieces(self, values: Array) -> Array:
        """(..., K) the least over each piece's balls of `values` (..., S) less their radii [m]."""
        return np.asarray(np.minimum.reduceat(values - self._radii, self._first, axis=-1))
