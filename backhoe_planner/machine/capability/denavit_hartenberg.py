"""The Denavit-Hartenberg table of a machine, from its URDF.

Classic parameters (Denavit and Hartenberg 1955): the transform from frame k-1 to frame k is a turn by
theta about z_{k-1}, a shift by d along it, a shift by a along x_k, and a turn by alpha
about x_k; z_{k-1} is the axis of joint k. Joint k's own position adds to theta (a hinge)
or to d (a slide).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector
from backhoe_planner.machine.robot import Robot

_PARALLEL = 1e-9  # rad or m: below this, axes are parallel, or meet, but for rounding


@dataclass(frozen=True)
class DhRow:
    """One joint.

    Attributes
    ----------
    joint: its name.
    theta, alpha: [rad]; d, a: [m].
    prismatic: whether its position adds to d instead of theta.
    """

    joint: str
    theta: float
    d: float
    a: float
    alpha: float
    prismatic: bool

    def transform(self, position: float) -> pin.SE3:
        """T_{k-1}_k at a joint position [rad or m]."""
        theta = self.theta + (0.0 if self.prismatic else position)
        d = self.d + (position if self.prismatic else 0.0)
        turn_z = pin.SE3(pin.exp3(np.array([0.0, 0.0, theta])), np.array([0.0, 0.0, d]))
        turn_x = pin.SE3(pin.exp3(np.array([self.alpha, 0.0, 0.0])), np.array([self.a, 0.0, 0.0]))
        return turn_z * turn_x


@dataclass(frozen=True)
class DhTable:
    """The table, and the two transforms that tie it to the world and to the tip.

    Attributes
    ----------
    base: T_world_0.
    rows: one per joint.
    tool: T_n_tip.
    """

    base: pin.SE3
    rows: tuple[DhRow, ...]
    tool: pin.SE3

    def tip(self, q: Vector) -> pin.SE3:
        """T_world_tip at joint positions (n,)."""
        pose = self.base
        for row, position in zip(self.rows, q, strict=True):
            pose = pose * row.transform(float(position))
        return pose * self.tool


def dh_table(robot: Robot) -> DhTable:
    """The table of the joints between the root and the tip of `robot`, at q = 0."""
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, np.zeros(robot.n))
    tip = pin.updateFramePlacement(robot.model, data, robot.tip_frame).copy()
    axes, points = _axes(robot, data)
    base = _frame(axes[0], points[0], None)
    frame = base
    rows = []
    for k, name in enumerate(robot.joint_names):
        if k + 1 < robot.n:
            axis, point = axes[k + 1], points[k + 1]
        else:  # the last frame keeps the direction of the last axis, through the tip
            axis, point = axes[k], tip.translation
        after = _next_frame(frame, axis, point)
        relative = frame.inverse() * after
        theta = float(np.arctan2(relative.rotation[1, 0], relative.rotation[0, 0]))
        alpha = float(np.arctan2(relative.rotation[2, 1], relative.rotation[2, 2]))
        a = float(relative.translation[:2] @ np.array([np.cos(theta), np.sin(theta)]))
        rows.append(DhRow(name, theta, float(relative.translation[2]), a, alpha, bool(robot.prismatic[k])))
        frame = after
    return DhTable(base=base, rows=tuple(rows), tool=frame.inverse() * tip)


def _axes(robot: Robot, data: pin.Data) -> tuple[list[Vector], list[Vector]]:
    """Direction and a point of every joint's axis, in the world at q = 0."""
    axes, points = [], []
    for k in range(robot.n):
        column = data.J.reshape(6, robot.n)[:, k]  # with one joint J is 1-D
        axes.append(np.array(column[:3] if robot.prismatic[k] else column[3:]))
        points.append(np.array(data.oMi[k + 1].translation))
    return axes, points


def _frame(z: Vector, origin: Vector, x: Vector | None) -> pin.SE3:
    if x is None:
        seed = np.eye(3)[int(np.argmin(np.abs(z))) if abs(z[0]) > 0.9 else 0]  # x, unless z is nearly along it
        x = seed - (seed @ z) * z
    x = x / np.linalg.norm(x)
    return pin.SE3(np.column_stack((x, np.cross(z, x), z)), origin)


def _next_frame(frame: pin.SE3, axis: Vector, point: Vector) -> pin.SE3:
    """The frame on the next axis, with x along the common normal of both axes."""
    z, origin = frame.rotation[:, 2], frame.translation
    normal = np.cross(z, axis)
    across = point - origin - ((point - origin) @ z) * z
    if np.linalg.norm(normal) < _PARALLEL:  # parallel: of all common normals take the one through `point`
        if np.linalg.norm(across) < _PARALLEL:
            return _frame(axis, point, frame.rotation[:, 0])
        return _frame(axis, point, across)
    # the point where the common normal meets the next axis
    normal /= np.linalg.norm(normal)
    plane = np.cross(normal, z)
    along = ((origin - point) @ plane) / (axis @ plane)
    foot = point + along * axis
    offset = foot - origin - ((foot - origin) @ z) * z
    x = offset if np.linalg.norm(offset) > _PARALLEL else normal
    return _frame(axis, foot, x)
