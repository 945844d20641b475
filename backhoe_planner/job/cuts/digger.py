"""The machine as it digs: its plane, its bucket, and what its cylinders hold along a cut."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_number
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.bucket import Bucket
from backhoe_planner.job.cuts.cut import Cut, CutGround, Holding
from backhoe_planner.machine import JointLimits, Robot
from backhoe_planner.motion import Drive, Trajectory, time_along
from backhoe_planner.site import Soil, SoilReaction

_MARGIN = 0.15  # part of what a cylinder can hold, kept for acceleration and for soil that is harder; chosen
_SWELL = 1.25  # volume of loose soil over that of the bank: usual are 1.2 to 1.3
_INTERVALS = 250  # of the timing: within 1 % of the duration with 1000


class Digger:
    """A machine that digs in a soil.

    Parameters
    ----------
    robot: the machine.
    soil: that it digs in; its `surface` does not matter.
    bucket: by default that of the machine.
    limits: of the joints; by default the machine's own.
    swell: volume of loose soil over that of the bank.
    margin: part of what a cylinder can hold that is kept in reserve.

    Raises
    ------
    InputError: the machine has no bucket that digs in an upright plane; see `Bucket.of` and `ArmPlane`.
    """

    def __init__(
        self,
        robot: Robot,
        soil: Soil,
        *,
        bucket: Bucket | None = None,
        limits: JointLimits | None = None,
        swell: float = _SWELL,
        margin: float = _MARGIN,
    ) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        self.limits = robot.limits if limits is None else limits
        self.plane = ArmPlane(robot, limits=self.limits)
        self.bucket = Bucket.of(robot, width=soil.width) if bucket is None else bucket
        self.soil = check_kind(soil, Soil, key="soil").model_copy(update={"width": self.bucket.width})
        self.swell = as_number(swell, key="swell", above=0.0)
        self.margin = as_number(margin, key="margin", least=0.0)
        if self.margin >= 1.0:
            raise InputError("leaves nothing to dig with", key="margin", found=self.margin, allowed="below 1")
        self._drive = Drive(robot, effort=self.limits.effort)

    def motion(self, cut: Cut) -> Trajectory:
        """The cut from rest to rest, as fast as joints, valves, pump, engine and cylinders allow in the soil."""
        stations = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(cut.r), np.diff(cut.z)))))
        return time_along(stations, cut.q, self.limits, drive=self.drive(cut), intervals=_INTERVALS)

    def drive(self, cut: Cut) -> Drive:
        """The drive of the machine along a cut."""
        return Drive(self.robot, effort=self.limits.effort, soil=self.soil, ground=cut.ground)

    def loads(self, q: Matrix, ground: CutGround) -> tuple[Matrix, Matrix]:
        """(K, n) torques that hold the machine and drive it against the soil from place to place [N m], and
        (K, n) these over the greatest in their direction.
        """
        still = np.zeros_like(q)
        reaction = SoilReaction(self.robot, self.soil, ground)
        direction = np.gradient(q, axis=0)
        fast = direction / np.maximum(np.max(np.abs(direction), axis=1, keepdims=True), 1e-12)
        torque = self._drive.rigid_torques(q, still, still) - reaction.torques(q, fast)
        return torque, self._drive.effort_use(q, torque)

    def holding(self, q: Matrix, torque: Matrix, use: Matrix, at: tuple[Vector, Vector]) -> Holding:
        """Which cylinder is used most, at the edge's places r, z (K,)."""
        row, joint = np.unravel_index(int(np.argmax(use)), use.shape)
        needed, ratio = abs(float(torque[row, joint])), float(use[row, joint])
        limits = self._drive.torque_limits(q[row])
        available = (limits.positive if torque[row, joint] > 0.0 else limits.negative)[joint]
        hydraulics, name = self.robot.hydraulics, self.robot.joint_names[joint]
        if hydraulics is not None:
            own = [c.name for c, index in zip(hydraulics.cylinders, hydraulics.joint_of, strict=True) if index == joint]
            name = " and ".join(own) or name
        return Holding(name, ratio, needed, float(available), float(at[0][row]), float(at[1][row]))

    def estimated_run(self, q: Matrix, torque: Matrix) -> tuple[float, float]:
        """Duration [s] and work [J] of a run through joints q (K, n) under `torque` (K, n) [N m].

        From place to place at the speed that joints, valves, pump and engine allow, and from rest to
        rest at the accelerations of the slowest joint. The torques are those without inertia.
        """
        limits, hydraulics = self.limits, self.robot.hydraulics
        step, middle = np.diff(q, axis=0), 0.5 * (q[1:] + q[:-1])
        mean = 0.5 * (torque[1:] + torque[:-1])
        span = np.max(np.abs(step) / limits.velocity, axis=1)
        if hydraulics is not None:
            rods = hydraulics.velocity_limits(middle)
            span = np.maximum(span, np.max(np.abs(step) / np.where(step > 0.0, rods.positive, rods.negative), axis=1))
            span = np.maximum(span, hydraulics.total_flow(middle, step) / hydraulics.pump_flow)
            span = np.maximum(span, hydraulics.power(middle, step, mean) / hydraulics.power_limit)
        rate = step / np.maximum(span, 1e-9)[:, None]
        slowest = np.max(np.abs(rate) / limits.acceleration, axis=1)
        return float(np.sum(span) + 0.5 * (slowest[0] + slowest[-1])), float(np.sum(np.maximum(mean * step, 0.0)))
