"""From the wish for the tip to a velocity of the joints, by the completed law."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.law import CompletedLaw, CriticalRows
from backhoe_planner.live.clearance.pair_bounds import Near
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.plane_gaps import nearest_point_rows
from backhoe_planner.live.servo.commands import Commands
from backhoe_planner.machine import Configuration, Kinematics, Robot, movable_rows
from backhoe_planner.native import compiled

_SIDEWAYS = 0.2  # of the speed into an obstacle: a wish with more speed sideways decides which way around; chosen
_STEEP = 0.9  # size of a normal's z above which its surface is level, with no "up" along it; chosen, 26 degrees
_UP = np.array([0.0, 0.0, 1.0])
_NOTHING = np.zeros((0, 3))
_NO_SENSE = np.zeros(3)


class JointWish(NamedTuple):
    """A command as a velocity of the joints.

    Attributes
    ----------
    v: (n,) wished velocity, within the joints' rates [rad/s or m/s].
    tip: (3,) wished velocity of the tip [m/s], world.
    task: (m, n) Jacobian of the wish for the tip; None if the wish is for the joints.
    null: (n,) the part of v in its null space [rad/s or m/s].
    singular: whether the machine is near a singularity.
    """

    v: Vector
    tip: Vector
    task: Matrix | None
    null: Vector
    singular: bool


class TipTask:
    """The tip of one machine, and how the joints move it.

    Parameters
    ----------
    check: the check of the machine's braking paths.
    influence: margin within which an obstacle acts on the null space [m].

    Attributes
    ----------
    law: the completed law.
    position: (3,) of the tip [m], world, after `place`.
    jacobian: (6, n) of the tip, world axes, after `place`.
    blocking: (3,) unit vector into what holds the tip back; zeros if nothing does.
    """

    def __init__(self, robot: Robot, check: PathCheck, *, influence: float) -> None:
        self._robot, self._separation, self._bounds, self._at = robot, check.separation, check.joints, check.at
        self.law = CompletedLaw(robot, influence=influence)
        frame = robot.model.frames[robot.tip_frame]
        self._joint = int(frame.parentJoint)
        self._t = np.append(frame.placement.translation, 1.0)
        self._to_tip = np.eye(6)  # maps a twist at the world's origin to the tip
        self.jacobian = np.zeros((6, robot.n))
        self.position = np.zeros(3)
        self._rows = _movable_tip_rows(robot)
        self._all_rows = bool(self._rows.all())
        self._nobody = CriticalRows(np.zeros(0), np.zeros((0, robot.n)), np.zeros(0))
        self.blocking = np.zeros(3)
        self._critical: tuple[Near | None, CriticalRows] = None, self._nobody  # what was near, and its rows
        self._sense = _NO_SENSE

    def place(self, q: Vector) -> None:
        """Compute the forward kinematics at q (n,) and the tip's Jacobian."""
        at = self._at
        at.place(0, q)
        self.position = place_tip(at.T[0, self._joint], self._t, at.J[0], self._to_tip, self.jacobian)

    def wish(self, q: Vector, command: Commands, near: Near, *, circulate: bool) -> JointWish:
        """The velocity of the joints for a command at q (n,); call `place` with this q before.

        With `circulate` a tip that is pushed straight into an obstacle goes around it.
        """
        n = self._robot.n
        if command.joints is not None:
            joints = command.joints
            return JointWish(
                joints / self._bounds.over_rates(q, joints), self.jacobian[:3].dot(joints), None, joints, False
            )
        if command.tip is None:
            return JointWish(np.zeros(n), np.zeros(3), self.jacobian[:3], np.zeros(n), False)
        J, xdot = self.jacobian[:3], self._around(command.tip) if circulate else command.tip
        if not self._all_rows:
            J, xdot = J[self._rows], xdot[self._rows]
        if command.pitch is not None:
            turn = self.jacobian[3:]
            J = np.vstack((J, self._robot.pitch_sense * turn[:, -1] @ turn))
            xdot = np.append(xdot, command.pitch)
        nearby, damped = self._critical_points(q, near), False
        quick = self.law.quick_terms_unchecked(q, J, xdot, nearby)
        if quick is None:
            at = Configuration(self._robot, q, None, self.jacobian, self._at.J[0], _NOTHING)
            wish = self.law.wish_unchecked(at, J, xdot, nearby)
            v, null, damped = wish.v, wish.null, wish.task.damping > 0.0
        else:
            first, null, damping = quick
            v, damped = first + null, damping > 0.0
        over = self._bounds.over_rates(q, v)
        if over > 1.0 and np.count_nonzero(null):
            # the tip comes first: the null space gets the rates that are left
            first = v - null
            first /= self._bounds.over_rates(q, first)
            null = self._bounds.room_for(null, first) * null
            v = first + null
            over = self._bounds.over_rates(q, v)
        return JointWish(v / over, command.tip, J, null / over, damped)

    def _critical_points(self, q: Vector, near: Near) -> CriticalRows:
        """The rows that the law needs at q (n,): one for each near pair, at its nearest point.

        If the pairs were not examined in this step, their margins are extrapolated linearly from when they were.
        """
        margin = near.margin
        if len(margin) == 0 or margin[margin.argmin()] >= self.law.influence:
            return self._nobody
        seen, rows = self._critical
        if seen is not near:
            gradient = nearest_point_rows(self._separation, near.pairs, near.gaps, self._at)
            rows = CriticalRows(margin, gradient, self._separation.drift.take(near.pairs))
            self._critical = near, rows
        if near.q is q:
            return rows
        return CriticalRows(margin + rows.gradient.dot(q - near.q), rows.gradient, rows.drift)

    def _around(self, tip: Vector) -> Vector:
        """The wish for the tip (3,), with its part into the surface that blocks it turned along that surface."""
        into = float(tip.dot(self.blocking))
        if into <= 0.0:
            self._sense = _NO_SENSE
            return tip
        found, self._sense = turn_along_surface(tip, self.blocking, self._sense, bool(self._rows[2]))
        return found


@compiled
def turn_along_surface(tip: Vector, normal: Vector, sense: Vector, rises: bool, /) -> tuple[Vector, Vector]:
    """(3,) the wish for the tip with its part into a surface turned along it, and (3,) the unit vector along which.

    Parameters
    ----------
    tip: (3,) the wish, which has a part into the surface [m/s]; normal: (3,) unit vector into it.
    sense: (3,) the unit vector of the step before, zeros if there is none. It decides if the wish is straight into
        the surface.
    rises: whether the tip can go up.
    """
    into = float(tip.dot(normal))
    along = tip - into * normal
    size = math.sqrt(float(along.dot(along)))
    if size <= _SIDEWAYS * into:
        along = sense - sense.dot(normal) * normal
        if not along.any():
            along = _UP - normal[2] * normal
            if abs(normal[2]) > _STEEP or not rises:
                along = np.array([-normal[1], normal[0], 0.0])
        size = max(math.sqrt(float(along.dot(along))), 1e-9)
    along = along / size
    return tip + into * along, along


@compiled
def place_tip(pose: Matrix, tip: Vector, J: Matrix, to_tip: Matrix, jacobian: Matrix, /) -> Vector:
    """(3,) position of the `tip` (4,) of a body at `pose` (4, 4) [m]; writes its `jacobian` (6, n) from J (6, n).

    The upper right part of `to_tip` (6, 6), omega -> omega x tip, is written, too; its rest is the identity.
    """
    position: Vector = pose.dot(tip)[:3]
    x, y, z = position.tolist()
    to_tip[0, 4], to_tip[0, 5], to_tip[1, 3], to_tip[1, 5], to_tip[2, 3], to_tip[2, 4] = z, -y, -z, x, y, -x
    np.dot(to_tip, J, out=jacobian)
    return position


def _movable_tip_rows(robot: Robot) -> Flags:
    """(3,) whether any joint can move the tip at all along each axis of the world."""
    rng, kinematics = np.random.default_rng(0), Kinematics(robot)
    found = [movable_rows(kinematics.at(robot.random_q(rng)).jacobian[:3]) for _ in range(8)]
    return np.asarray(np.any(found, axis=0))
