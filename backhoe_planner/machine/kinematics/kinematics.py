"""A configuration whose forward kinematics are done.

Owning a `Configuration` is evidence that everything in it belongs to its `q`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.machine.robot import Robot

__all__ = ["Configuration", "Kinematics", "wrap_angle"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def wrap_angle(angle: float) -> float:
    """`angle` [rad] brought into [-pi, pi)."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


class Configuration:
    """Joint positions and what follows from them; read-only.

    Attributes
    ----------
    q: (n,) joint positions [rad or m].
    T_world_tip: pose of the tip.
    jacobian: (6, n) of the tip's velocity, linear over angular, in world axes
        [m/rad, rad/rad].
    J_world: (6, n) Pinocchio's joint Jacobians: column j is the spatial velocity of
        joint j, linear part taken at the world's origin, in world axes.
    points: (n + 1, 3) origins of the joints from the machine outward, then the tip
        [m], world.
    """

    __slots__ = ("J_world", "T_world_tip", "jacobian", "points", "q", "robot")

    def __init__(
        self, robot: Robot, q: Vector, T_world_tip: pin.SE3, jacobian: Matrix, J_world: Matrix, points: Matrix
    ) -> None:
        self.robot = robot
        self.q = q
        self.T_world_tip = T_world_tip
        self.jacobian = jacobian
        self.J_world = J_world
        self.points = points

    @property
    def tip_position(self) -> Vector:
        """(3,) [m], world."""
        return np.asarray(self.T_world_tip.translation)

    @property
    def tip_rotation(self) -> Matrix:
        """(3, 3) R_world_tip."""
        return np.asarray(self.T_world_tip.rotation)

    @property
    def pitch(self) -> float:
        """Angle of the line bucket pin to tip above the horizontal [rad], up positive.

        Taken in the plane across the last joint's axis; for the backhoe it equals
        boom + stick + bucket, up to whole turns.

        Raises
        ------
        InputError: the last joint's axis is not horizontal in every posture.
        """
        if not self.robot.has_pitch:
            raise InputError(
                "pitch is not defined for this arm: the axis of its last joint does not stay horizontal",
                key="pitch",
                found=self.robot.name,
                allowed="rpy or quaternion",
            )
        axis = self.robot.pitch_sense * self.J_world[3:, -1]
        line = self.tip_position - self.points[-2]
        # horizontal direction in the plane: z x axis
        forward = line[1] * axis[0] - line[0] * axis[1]
        return float(np.arctan2(line[2], forward))

    @property
    def pitch_row(self) -> Vector:
        """(n,) derivative of `pitch` [rad/rad]."""
        return np.asarray(self.robot.pitch_sense * self.J_world[3:, -1] @ self.J_world[3:, :])


class Kinematics:
    """Forward kinematics of one robot, with working memory of its own.

    Do not share one between threads; make one each.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._data = robot.model.createData()
        self._joints = range(1, robot.model.njoints)

    def at(self, q: Vector) -> Configuration:
        """The configuration at `q` (n,), which must be finite and of the right length."""
        robot, data = self.robot, self._data
        pin.computeJointJacobians(robot.model, data, q)
        T_world_tip = pin.updateFramePlacement(robot.model, data, robot.tip_frame).copy()
        jacobian = pin.getFrameJacobian(robot.model, data, robot.tip_frame, pin.LOCAL_WORLD_ALIGNED)
        if robot.n == 1:  # comes back 1-D
            jacobian = jacobian.reshape(6, 1)
        points = [data.oMi[joint].translation for joint in self._joints]
        points.append(T_world_tip.translation)
        own_q = np.array(q, dtype=float)
        own_q.setflags(write=False)
        return Configuration(robot, own_q, T_world_tip, jacobian, data.J.reshape(6, robot.n).copy(), np.array(points))
