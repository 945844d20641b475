"""Forward kinematics of many configurations at once.

One array operation per joint serves a whole batch; where thousands of configurations
are looked at together, that costs a few microseconds each instead of a call each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from backhoe_planner.machine.robot import Robot

__all__ = ["BatchKinematics", "ConfigurationBatch"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ConfigurationBatch:
    """B configurations and what follows from them.

    Attributes
    ----------
    q: (B, n) joint positions [rad or m].
    tip_position: (B, 3) [m], world.
    tip_rotation: (B, 3, 3) R_world_tip.
    axes: (B, n, 3) unit axes of the joints, world.
    origins: (B, n, 3) origins of the joints [m], world.
    rotations: (B, n, 3, 3) R_world_joint of the frames that turn with the joints.
    prismatic: (n,) which joints slide.
    pitch_sense: see `Robot.pitch_sense`; 0 where pitch is not defined.
    """

    q: Array
    tip_position: Array
    tip_rotation: Array
    axes: Array
    origins: Array
    rotations: Array
    prismatic: NDArray[np.bool_]
    pitch_sense: float

    def __len__(self) -> int:
        return len(self.q)

    def position_jacobian(self) -> Array:
        """(B, 3, n) of the tip's position, in world axes [m/rad]."""
        arm = self.tip_position[:, None, :] - self.origins
        turning = _cross(self.axes, arm)
        columns = np.where(self.prismatic[None, :, None], self.axes, turning)
        return np.swapaxes(columns, 1, 2)

    def rotation_jacobian(self) -> Array:
        """(B, 3, n) of the tip's angular velocity, in world axes [rad/rad]."""
        columns = np.where(self.prismatic[None, :, None], 0.0, self.axes)
        return np.swapaxes(columns, 1, 2)

    def pitch(self) -> Array:
        """(B,) angle of the line bucket pin to tip above the horizontal [rad]; see `Configuration.pitch`."""
        axis = self.pitch_sense * self.axes[:, -1]
        line = self.tip_position - self.origins[:, -1]
        forward = line[:, 1] * axis[:, 0] - line[:, 0] * axis[:, 1]
        return np.asarray(np.arctan2(line[:, 2], forward))

    def pitch_rows(self) -> Array:
        """(B, n) derivative of the pitch [rad/rad]."""
        rows = self.pitch_sense * np.einsum("bc,bnc->bn", self.axes[:, -1], self.axes)
        return np.where(self.prismatic[None, :], 0.0, rows)


class BatchKinematics:
    """Forward kinematics of one robot for arrays of configurations; keeps no state between calls."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        model = robot.model
        # a serial chain: joint j hangs on joint j - 1
        self._placements = [(p.rotation.copy(), p.translation.copy()) for p in model.jointPlacements][1:]
        self._axes = [_axis(model, joint) for joint in range(1, model.njoints)]
        # rotation by Rodrigues: I + sin K + (1 - cos) K^2
        self._skew = [pin.skew(axis) for axis in self._axes]
        self._square = [skew @ skew for skew in self._skew]
        frame = model.frames[robot.tip_frame]
        self._tip = (frame.placement.rotation.copy(), frame.placement.translation.copy())
        self._sense = robot.pitch_sense if robot.has_pitch else 0.0

    def at(self, q: Array) -> ConfigurationBatch:
        """The configurations `q` (B, n)."""
        q = np.asarray(q, dtype=float)
        count = len(q)
        rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
        position = np.zeros((count, 3))
        axes = np.empty((count, self.robot.n, 3))
        origins = np.empty((count, self.robot.n, 3))
        rotations = np.empty((count, self.robot.n, 3, 3))
        sine, versine = np.sin(q), 1.0 - np.cos(q)
        for joint, (R, p) in enumerate(self._placements):
            position = position + rotation @ p
            rotation = rotation @ R
            axes[:, joint] = rotation @ self._axes[joint]
            if self.robot.prismatic[joint]:
                position = position + axes[:, joint] * q[:, joint, None]
            else:
                turn = (
                    np.eye(3)
                    + sine[:, joint, None, None] * self._skew[joint]
                    + versine[:, joint, None, None] * self._square[joint]
                )
                rotation = rotation @ turn
            origins[:, joint] = position
            rotations[:, joint] = rotation
        return ConfigurationBatch(
            q=q,
            tip_position=position + rotation @ self._tip[1],
            tip_rotation=rotation @ self._tip[0],
            axes=axes,
            origins=origins,
            rotations=rotations,
            prismatic=self.robot.prismatic,
            pitch_sense=self._sense,
        )


def _axis(model: pin.Model, joint: int) -> Array:
    """(3,) the joint's axis in its own frame."""
    data = model.joints[joint].createData()
    model.joints[joint].calc(data, np.zeros(1))
    subspace = np.asarray(data.S).reshape(6)
    return np.array(subspace[3:] if np.any(subspace[3:]) else subspace[:3])


def _cross(a: Array, b: Array) -> Array:
    """The cross product over the last axis."""
    return np.stack(
        (
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ),
        axis=-1,
    )
