"""The braking path: where the machine goes if it brakes from now on.

Braking in proportion, all joints slow down together and the joints move on a straight
line. With T = max_j |v_j| / a_j, a step of dt at v and then braking lead from q to

    e = q + v (dt + T / 2)

and wherever braking begins later, what is left of it is a part of that line. A motion
whose braking path is clear at one step can therefore always be ended without touching
anything: braking is an answer that was proven before it is needed.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.machine.robot import Robot

__all__ = ["BrakingPath", "Placements", "bend"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MOST_PARTS = 8
_BEND = 0.002  # m that a point may deviate from the chord of a part, where parts are left


def bend(travel: Matrix, delta: Vector, turning: Vector) -> Vector:
    """(C,) bound on how sharply points bend off a straight line over a motion delta [m].

    With s from 0 to 1 along the motion, |x''| <= sum_j r_j |d_j| (w_j + 2 sum_{i<j} w_i),
    since the second derivative by joints i <= j is a_i x (a_j x (x - o_j)); w is |d| for
    hinges and 0 for slides.

    Parameters
    ----------
    travel: (C, n) r, see `travel_bounds`.
    delta: (n,) the motion.
    turning: (n,) 1 for hinges, 0 for slides.
    """
    size = np.abs(delta)
    angle = size * turning
    return np.asarray(travel @ (size * (2.0 * angle.cumsum() - angle)))


class Placements:
    """Where the bodies are at several configurations at once; working memory.

    Attributes
    ----------
    R, t: (S, joints, 3, 3) and (S, joints, 3) pose of every joint's frame in the world; joint 0 is the world.
    J: (S, 6, n) Pinocchio's joint Jacobians, linear part taken at the world's origin.
    """

    def __init__(self, robot: Robot, most: int) -> None:
        model = robot.model
        self._model = model
        self._data = model.createData()
        count, n = model.njoints, robot.n
        self.R = np.zeros((most, count, 3, 3))
        self.R[:, 0] = np.eye(3)
        self.t = np.zeros((most, count, 3))
        self.J = np.zeros((most, 6, n))
        # views of Pinocchio's own memory, which stays where it is
        joints = range(1, count)
        self._rotations = [self._data.oMi[joint].rotation for joint in joints]
        self._translations = [self._data.oMi[joint].translation for joint in joints]
        self._jacobian = self._data.J.reshape(6, n)
        self._targets = [
            [(self.R[sample, joint], self.t[sample, joint]) for joint in joints] for sample in range(most)
        ]

    def place(self, sample: int, q: Vector) -> None:
        """Fill row `sample` with the placements at q (n,)."""
        pin.computeJointJacobians(self._model, self._data, q)
        for (R, t), rotation, translation in zip(
            self._targets[sample], self._rotations, self._translations, strict=True
        ):
            R[:] = rotation
            t[:] = translation
        self.J[sample] = self._jacobian


class BrakingPath:
    """The line from q to e, looked at in equal parts.

    Attributes
    ----------
    delta: (n,) e - q.
    end: (n,) e.
    parts: how many; `parts + 1` rows of the placements belong to it.
    time: [s] until it stands.
    D: (n, n) derivative of e by v.
    bends: (C,) bound on |x''| over the whole line, by class of pairs [m].
    """

    def __init__(
        self,
        q: Vector,
        v: Vector,
        dt: float,
        *,
        acceleration: Vector,
        travel: Matrix,
        turning: Vector,
        parts: int | None = None,
    ) -> None:
        rates = np.abs(v) / acceleration
        slowest = int(rates.argmax())
        braking = float(rates[slowest])
        look = dt + 0.5 * braking
        self.q = q
        self.v = v
        self.delta = v * look
        self.end = q + self.delta
        self.look = look
        self.time = dt + braking
        self._slowest = slowest
        self._per_rate = 0.5 * math.copysign(1.0, v[slowest]) / float(acceleration[slowest]) if braking > 0.0 else 0.0
        self.bends = bend(travel, self.delta, turning)
        if parts is None:
            parts = min(max(math.ceil(math.sqrt(float(self.bends.max(initial=0.0)) / (8.0 * _BEND))), 1), MOST_PARTS)
        self.parts = parts
        self.off_chord = self.bends / (8.0 * parts * parts)

    @property
    def D(self) -> Matrix:
        D = self.look * np.eye(len(self.v))
        D[:, self._slowest] += self.v * self._per_rate
        return D

    def place(self, placements: Placements) -> None:
        """Fill the placements at the ends of the parts; row 0, at q, is already there."""
        for part in range(1, self.parts + 1):
            placements.place(part, self.q + (part / self.parts) * self.delta)
