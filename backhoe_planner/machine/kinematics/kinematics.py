"""Forward kinematics, of one configuration and of many at once.

Owning a `Configuration` is evidence that everything in it belongs to its `q`; Pinocchio
computes it. A `ConfigurationBatch` holds the same for B configurations. It is computed with
one array operation per joint for the whole batch, which takes a few microseconds per
configuration in a batch of thousands. Tests compare the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.machine.robot import Robot
from backhoe_planner.native import compiled

_Angle = TypeVar("_Angle", float, Array)
_WORLD_AXES = pin.LOCAL_WORLD_ALIGNED


def joint_poses(data: pin.Data) -> Array:
    """(joints, 3, 4) R and t of every joint's frame in the world, a view of Pinocchio's memory; joint 0 is the world.

    The view always shows the current poses of the joints of `data`, which are equally spaced in memory.
    """
    poses = [(pose.rotation, pose.translation) for pose in data.oMi]
    first, second, *_ = (R.__array_interface__["data"][0] for R, _ in poses)
    R, t = poses[0]
    assert t.__array_interface__["data"][0] == first + 3 * R.strides[1], "the translation follows the rotation"
    return as_strided(R, (len(poses), 3, 4), (second - first, *R.strides), writeable=False)


def wrap_angle(angle: _Angle) -> _Angle:
    """`angle` [rad], a number or an array, brought into [-pi, pi)."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(eq=False, slots=True)
class Configuration:
    """Joint positions and what follows from them; read-only.

    Attributes
    ----------
    q: (n,) joint positions [rad or m].
    T_world_tip: pose of the tip.
    jacobian: (6, n) Jacobian of the tip's velocity, linear over angular, in world axes
        [m/rad, rad/rad].
    J_world: (6, n) Pinocchio's joint Jacobians: column j is the spatial velocity of
        joint j, with its linear part at the world's origin, in world axes.
    points: (n + 1, 3) origins of the joints from the machine outward, then the tip
        [m], world.
    """

    robot: Robot
    q: Vector
    T_world_tip: pin.SE3
    jacobian: Matrix
    J_world: Matrix
    points: Matrix

    @property
    def tip_position(self) -> Vector:
        """(3,) [m], world."""
        position: Vector = self.points[-1]
        return position

    @property
    def tip_rotation(self) -> Matrix:
        """(3, 3) R_world_tip."""
        return np.asarray(self.T_world_tip.rotation)

    @property
    def pitch(self) -> float:
        """Angle of the line from the bucket pin to the tip above the horizontal [rad], up positive.

        It is measured in the plane across the last joint's axis; see also `Robot.pitch_pin`. For the backhoe it
        equals boom + stick + bucket, up to whole turns.

        Raises
        ------
        InputError: the last joint's axis is not horizontal in every configuration.
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
        if self.robot.pitch_pin is not None:
            R_last_tip = self.robot.model.frames[self.robot.tip_frame].placement.rotation
            line -= self.tip_rotation @ R_last_tip.T @ self.robot.pitch_pin
        # horizontal direction in the plane: z x axis
        forward = line[1] * axis[0] - line[0] * axis[1]
        return float(np.arctan2(line[2], forward))

    @property
    def pitch_row(self) -> Vector:
        """(n,) derivative of `pitch` [rad/rad]."""
        return np.asarray(self.robot.pitch_sense * self.J_world[3:, -1] @ self.J_world[3:, :])


class Kinematics:
    """Forward kinematics of one robot.

    It owns its working memory: do not share one between threads.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        self._n = robot.n
        self._data = data = robot.model.createData()
        # views of Pinocchio's own memory: they show its latest results, and are copied before they are returned
        self._origins = joint_poses(data)[1:, :, 3]
        self._tip = data.oMf[robot.tip_frame]
        self._tip_position = self._tip.translation
        self._J = data.J.reshape(6, self._n)  # with one joint J is 1-D
        self._pin = robot.model, data, robot.tip_frame

    def at(self, q: Vector) -> Configuration:
        """The configuration at `q` (n,).

        Raises
        ------
        InputError: `q` is not n finite numbers.
        """
        return self.at_unchecked(as_vector(q, self._n, key="q", names=self.robot.joint_names))

    def at_unchecked(self, q: Vector) -> Configuration:
        """`at` without checks, for callers in a loop whose arguments are right by construction."""
        model, data, tip = self._pin
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, tip)
        own_q = q.copy()
        own_q.setflags(write=False)
        jacobian = pin.getFrameJacobian(model, data, tip, _WORLD_AXES)
        J, points = placed_arrays(self._J, self._origins, self._tip_position)
        return Configuration(self.robot, own_q, self._tip.copy(), jacobian.reshape(6, self._n), J, points)


@compiled
def placed_arrays(J: Matrix, origins: Matrix, tip: Vector, /) -> tuple[Matrix, Matrix]:
    """Copies of J (6, n), and of `origins` (n, 3) followed by the `tip` (3,)."""
    points = np.empty((len(origins) + 1, 3))
    points[:-1], points[-1] = origins, tip
    return J.copy(), points


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
    pitch_sense: see `Robot.pitch_sense`; 0 if pitch is not defined.
    pitch_pin: see `Robot.pitch_pin`.
    """

    q: Array
    tip_position: Array
    tip_rotation: Array
    axes: Array
    origins: Array
    rotations: Array
    prismatic: Flags
    pitch_sense: float
    pitch_pin: Vector | None

    def __len__(self) -> int:
        return len(self.q)

    def position_jacobian(self) -> Array:
        """(B, 3, n) of the tip's position, in world axes [m/rad]."""
        x, y, z = self.axes.transpose(2, 1, 0)
        to_x, to_y, to_z = (self.tip_position[:, None, :] - self.origins).transpose(2, 1, 0)
        columns = np.empty((3, *x.shape))
        columns[0], columns[1], columns[2] = y * to_z - z * to_y, z * to_x - x * to_z, x * to_y - y * to_x
        if self.prismatic.any():
            columns[:, self.prismatic] = self.axes.transpose(2, 1, 0)[:, self.prismatic]
        return columns.transpose(2, 0, 1)

    def rotation_jacobian(self) -> Array:
        """(B, 3, n) of the tip's angular velocity, in world axes [rad/rad]."""
        columns = np.array(self.axes.transpose(2, 1, 0))
        columns[:, self.prismatic] = 0.0
        return columns.transpose(2, 0, 1)

    def pitch(self) -> Array:
        """(B,) angle of the line from bucket pin to tip above the horizontal [rad]; see `Configuration.pitch`."""
        axis = self.pitch_sense * self.axes[:, -1]
        line = self.tip_position - self.origins[:, -1]
        if self.pitch_pin is not None:
            line -= self.rotations[:, -1] @ self.pitch_pin
        forward = line[:, 1] * axis[:, 0] - line[:, 0] * axis[:, 1]
        return np.asarray(np.arctan2(line[:, 2], forward))

    def pitch_rows(self) -> Array:
        """(B, n) derivative of the pitch [rad/rad]."""
        rows = self.pitch_sense * np.einsum("bc,bnc->bn", self.axes[:, -1], self.axes)
        return np.where(self.prismatic[None, :], 0.0, rows)


def chain_factors(robot: Robot) -> Matrix:
    """(33, n) the constants of each joint: a column is an (11, 3) matrix, flattened row by row.

    In a serial chain joint j hangs on joint j - 1. By Rodrigues its rotation is I + sin K + (1 - cos) K^2. All
    factors of the rotation before it are in one (3, 11) matrix, which is stored transposed: R, R K, R K^2, the axis,
    the origin [m].
    """
    own = []
    for placement, axis in zip(list(robot.model.jointPlacements)[1:], robot.joint_axes, strict=True):
        R, skew = placement.rotation, pin.skew(axis)
        own.append(np.column_stack((R, R @ skew, R @ skew @ skew, R @ axis, placement.translation)).T.ravel())
    return np.array(own).reshape(-1, 33).T


class BatchKinematics:
    """Forward kinematics of one robot for arrays of configurations; keeps no state between calls."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        model = robot.model
        self._factors, self._slides = chain_factors(robot), robot.prismatic.astype(float)
        self._inward = []  # for a point that a joint carries: R, R K, R K^2 stacked (9, 3), the axis, the origin
        for own in self._factors.T:
            parts = own.reshape(11, 3).T
            self._inward.append((np.vstack(np.split(parts[:, :9], 3, axis=1)), parts[:, 9:10], parts[:, 10:]))
        frame = model.frames[robot.tip_frame]
        tip = np.column_stack((frame.placement.rotation, frame.placement.translation))
        self._tip = np.ascontiguousarray(tip.T)
        self._sense = robot.pitch_sense if robot.has_pitch else 0.0

    def tip_positions(self, q: Array) -> Array:
        """(B, 3) positions of the tip [m], world, in the configurations `q` (B, n), and nothing else."""
        joints = np.ascontiguousarray(np.asarray(q, dtype=float).T)
        sine, versine = np.sin(joints), 1.0 - np.cos(joints)
        point = self._tip[3][:, None]  # in the frame of the last joint, then of each joint further in
        for joint in range(len(joints) - 1, -1, -1):
            matrix, axis, origin = self._inward[joint]
            parts = matrix @ point
            if self.robot.prismatic[joint]:
                point = origin + parts[:3] + axis * joints[joint]
            else:
                point = origin + parts[:3] + sine[joint] * parts[3:6] + versine[joint] * parts[6:]
        return np.ascontiguousarray(point.T)

    def at(self, q: Array) -> ConfigurationBatch:
        """The configurations `q` (B, n)."""
        q = np.asarray(q, dtype=float)
        return place_chain(q, *self.chain, prismatic=self.robot.prismatic, sense=self._sense, pin=self.robot.pitch_pin)

    @property
    def chain(self) -> tuple[Matrix, Vector, Matrix]:
        """The constants of the chain for `chain_placements`: factors (33, n), slides (n,) and tip (4, 3)."""
        return self._factors, self._slides, self._tip


def place_chain(
    q: Array, factors: Matrix, slides: Vector, tip: Matrix, *, prismatic: Flags, sense: float, pin: Vector | None
) -> ConfigurationBatch:
    """The configurations `q` (B, n) of a chain.

    Parameters
    ----------
    factors, slides, tip: as for `chain_placements`.
    prismatic: (n,) which joints slide; sense, pin: see `ConfigurationBatch`.
    """
    joints = np.ascontiguousarray(q.T)  # the configurations run along the last axis, along which numpy is fast
    axes, origins, rotations, tip_position, tip_rotation = chain_placements(
        joints, np.sin(joints), 1.0 - np.cos(joints), factors, slides, tip
    )
    return ConfigurationBatch(
        q=q,
        tip_position=tip_position.T,
        tip_rotation=tip_rotation.transpose(2, 1, 0),
        axes=axes.transpose(2, 0, 1),
        origins=origins.transpose(2, 0, 1),
        rotations=rotations.transpose(3, 0, 2, 1),
        prismatic=prismatic,
        pitch_sense=sense,
        pitch_pin=pin,
    )


@compiled
def chain_placements(
    q: Matrix, sine: Matrix, versine: Matrix, factors: Matrix, slides: Vector, tip: Matrix, /
) -> tuple[Array, Array, Array, Matrix, Array]:
    """A chain's axes (n, 3, B), origins (n, 3, B) and rotations, (3, B) tip position, and the tip's rotation (3, 3, B).

    The rotations (n, 3, 3, B) are stored column by column.

    Parameters
    ----------
    q: (n, B) joint positions [rad or m]; sine, versine: of these.
    factors: (33, n) constants of the joints, from `chain_factors`.
    slides: (n,) 1 for a joint that slides, 0 for a hinge.
    tip: (4, 3) the columns of the tip's rotation in the last joint, and its position there [m].
    """
    n, count = q.shape
    axes, origins, rotations = np.empty((n, 3, count)), np.empty((n, 3, count)), np.empty((n, 3, 3, count))
    rotation = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    position = np.zeros((3, count))
    for joint, (own, slide) in enumerate(zip(factors.T, slides.tolist(), strict=True)):
        parts = (own.reshape(11, 3) @ rotation.reshape(3, -1)).reshape(11, 3, count)
        axes[joint] = parts[9]
        rotation = rotations[joint]
        if slide:
            position = position + parts[10] + parts[9] * q[joint]
            rotation[:] = parts[:3]
        else:
            position = position + parts[10]
            np.multiply(sine[joint], parts[3:6], out=rotation)
            rotation += parts[:3]
            parts[6:9] *= versine[joint]
            rotation += parts[6:9]
        origins[joint] = position
    turned = (tip @ rotation.reshape(3, -1)).reshape(4, 3, count)
    return axes, origins, rotations, position + turned[3], turned[:3].copy()
