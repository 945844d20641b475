"""What the servo's wish means for the joints: the completed law, live."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.law import CompletedLaw, CriticalRows
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.braking.joint_bounds import JointBounds
from backhoe_planner.live.braking.pair_bounds import Near
from backhoe_planner.live.braking.separation import Separation
from backhoe_planner.live.servo.commands import Commands
from backhoe_planner.machine import Configuration, Kinematics, Robot, movable_rows

_INFLUENCE = 0.3  # m: further away the null space need not care
_UP = np.array([0.0, 0.0, 1.0])
_NOTHING = np.zeros((0, 3))
_NOBODY = CriticalRows(np.zeros(0), _NOTHING, np.zeros(0))


class JointWish(NamedTuple):
    """What a command means for the joints.

    Attributes
    ----------
    v: (n,) joint velocity that is wished, within the joints' rates.
    tip: (3,) velocity that is wished for the tip [m/s], world.
    task: (m, n) Jacobian of what is wished for the tip; None where joints are wished for.
    null: (n,) the part of v in its null space.
    singular: whether near a singularity.
    """

    v: Vector
    tip: Vector
    task: Matrix | None
    null: Vector
    singular: bool


class TipTask:
    """The tip of one machine, and how the joints serve it.

    Parameters
    ----------
    influence: margin within which an obstacle acts on the null space [m].
    at: placements, of which row 0 is where the machine is.
    circulate: whether a tip that is pushed straight into an obstacle goes round it.

    Attributes
    ----------
    circulate: as above; may be set.
    position: (3,) of the tip [m], world, after `place`.
    jacobian: (6, n) of the tip, world axes, after `place`.
    blocking: (3,) unit vector into what holds the tip back; zeros where nothing does.
    """

    def __init__(
        self,
        robot: Robot,
        separation: Separation,
        bounds: JointBounds,
        at: Placements,
        *,
        influence: float,
        circulate: bool,
    ) -> None:
        self._robot, self._separation, self._bounds, self._at = robot, separation, bounds, at
        self.circulate = circulate
        self.law = CompletedLaw(robot, influence=min(influence, _INFLUENCE))
        frame = robot.model.frames[robot.tip_frame]
        self._joint = int(frame.parentJoint)
        self._t = np.append(frame.placement.translation, 1.0)
        self._to_tip = np.eye(6)  # takes a twist at the world's origin to the tip
        self.jacobian = np.zeros((6, robot.n))
        self.position = np.zeros(3)
        self._rows = _movable_tip_rows(robot)
        self._all_rows = bool(self._rows.all())
        self.blocking = np.zeros(3)
        self._sense = np.zeros(3)

    def place(self, q: Vector) -> None:
        """Forward kinematics at q (n,), and the tip's Jacobian."""
        at = self._at
        at.place(0, q)
        self.position = at.T[0, self._joint] @ self._t
        x, y, z = self.position.tolist()
        to = self._to_tip  # its upper right part is omega -> omega x tip
        to[0, 4], to[0, 5], to[1, 3], to[1, 5], to[2, 3], to[2, 4] = z, -y, -z, x, y, -x
        np.matmul(to, at.J[0], out=self.jacobian)

    def wish(self, q: Vector, command: Commands, near: Near) -> JointWish:
        """What a command asks of the joints at q (n,), where the machine was placed."""
        n = self._robot.n
        if command.joints is not None:
            joints = command.joints
            return JointWish(
                joints / self._bounds.over_rates(q, joints), self.jacobian[:3] @ joints, None, joints, False
            )
        if command.tip is None:
            return JointWish(np.zeros(n), np.zeros(3), self.jacobian[:3], np.zeros(n), False)
        J, xdot = self.jacobian[:3], self._around(command.tip)
        if not self._all_rows:
            J, xdot = J[self._rows], xdot[self._rows]
        if command.pitch is not None:
            turn = self.jacobian[3:]
            J = np.vstack((J, self._robot.pitch_sense * turn[:, -1] @ turn))
            xdot = np.append(xdot, command.pitch)
        nearby, damped = self._critical_points(near), False
        quick = self.law.wish_on_null_line(q, J, xdot, nearby)
        if quick is None:
            at = Configuration(self._robot, q, None, self.jacobian, self._at.J[0], _NOTHING)
            wish = self.law.wish(at, J, xdot, nearby)
            v, null, damped = wish.v, wish.null, wish.task.damping > 0.0
        else:
            v, null = quick
        over = self._bounds.over_rates(q, v)
        if over > 1.0 and np.count_nonzero(null):
            # the tip comes first here too: the null space has the rates that are left
            first = v - null
            first /= self._bounds.over_rates(q, first)
            null = self._bounds.room_for(null, first) * null
            v = first + null
            over = self._bounds.over_rates(q, v)
        return JointWish(v / over, command.tip, J, null / over, damped)

    def _critical_points(self, near: Near) -> CriticalRows:
        """What is near as the law wants it: one row each, of the nearest point."""
        acts = (near.margin < self.law.influence).nonzero()[0]
        if len(acts) == 0:
            return _NOBODY
        pairs = near.pairs[acts]
        return CriticalRows(
            margin=near.margin[acts],
            gradient=-self._separation.nearest_rows(pairs, near.gaps[acts], near.least[acts], self._at),
            drift=self._separation.drift.take(pairs),
        )

    def _around(self, tip: Vector) -> Vector:
        """The tip's wish, turned along the surface that blocks it where that is asked for."""
        if not self.circulate:
            return tip
        normal = self.blocking
        into = float(tip @ normal)
        if into <= 0.0:
            self._sense = np.zeros(3)
            return tip
        along = tip - into * normal
        size = math.sqrt(float(along @ along))
        if size > 0.2 * into:
            self._sense = along / size
        else:
            sense = self._sense - (self._sense @ normal) * normal
            if not sense.any():
                sense = _UP - normal[2] * normal
                if abs(normal[2]) > 0.9 or not self._rows[2]:
                    sense = np.array([-normal[1], normal[0], 0.0])
            self._sense = sense / max(math.sqrt(float(sense @ sense)), 1e-9)
        return np.asarray(tip + into * self._sense)


def _movable_tip_rows(robot: Robot) -> Flags:
    """(3,) which directions any joint can move the tip in at all."""
    rng, kinematics = np.random.default_rng(0), Kinematics(robot)
    found = [movable_rows(kinematics.at(robot.random_q(rng)).jacobian[:3]) for _ in range(8)]
    return np.asarray(np.any(found, axis=0))
