"""Digging forces: how hard the teeth bite at relief pressure.

In the spirit of ISO 6015 and SAE J1179, from geometry alone:

- bucket: the greatest force at the tooth tip, across the line bucket pin to tip, that the
  bucket's cylinders give by curling, over the range of the bucket;
- stick: the same of the stick's cylinders, across the line stick pin to tip, over the
  range of the stick, with the bucket where its own force is greatest.

All other cylinders hold, the machine neither tips nor slides, and nothing weighs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine.kinematics.kinematics import Kinematics
from backhoe_planner.machine.robot import Robot

__all__ = ["DiggingForces", "digging_forces"]


_SAMPLES = 4001  # of a joint's range: a thousandth of a radian apart, torque being flat at its greatest
_AT_PIN = 1e-3  # m: a tip this near the last pin cannot dig about it


@dataclass(frozen=True)
class DiggingForces:
    """Forces at the tooth tip; see the module's text.

    Attributes
    ----------
    bucket: by the last joint's cylinders [N]; bucket_at: position of that joint [rad].
    stick: by those of the joint before [N]; stick_at: its position [rad].
    """

    bucket: float
    bucket_at: float
    stick: float
    stick_at: float


def digging_forces(robot: Robot) -> DiggingForces | None:
    """The digging forces; None without cylinders on the last two joints, without a pitch, or with the tip on a pin."""
    if robot.hydraulics is None or robot.n < 2 or not robot.has_pitch:
        return None
    if {robot.n - 2, robot.n - 1} - set(robot.hydraulics.joint_of.tolist()):
        return None
    kinematics = Kinematics(robot)
    q = np.clip(np.zeros(robot.n), robot.limits.lower, robot.limits.upper)
    curl, q[-1] = _strongest(robot, q, robot.n - 1)
    points = kinematics.at(q).points
    pull, stick_at = _strongest(robot, q, robot.n - 2)
    to_bucket_pin, to_stick_pin = np.linalg.norm(points[-1] - points[[-2, -3]], axis=1)
    if to_bucket_pin < _AT_PIN:
        return None
    return DiggingForces(
        bucket=curl / float(to_bucket_pin),
        bucket_at=float(q[-1]),
        stick=pull / float(to_stick_pin),
        stick_at=stick_at,
    )


def _strongest(robot: Robot, q: Vector, joint: int) -> tuple[float, float]:
    """The greatest torque that curls the joint [N m], and where in its range [rad]."""
    assert robot.hydraulics is not None
    angles = np.linspace(robot.limits.lower[joint], robot.limits.upper[joint], _SAMPLES)
    postures = np.tile(q, (_SAMPLES, 1))
    postures[:, joint] = angles
    limits = robot.hydraulics.torque_limits(postures)
    # to curl is to lower the tip where the arm reaches out
    torque = (limits.negative if _lifts(robot, joint) else limits.positive)[:, joint]
    best = int(np.argmax(torque))
    return float(torque[best]), float(angles[best])


def _lifts(robot: Robot, joint: int) -> bool:
    """Whether turning the joint forward increases the pitch."""
    q = np.clip(np.zeros(robot.n), robot.limits.lower, robot.limits.upper)
    return bool(Kinematics(robot).at(q).pitch_row[joint] > 0.0)
