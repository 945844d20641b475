"""The machine as a digger: its plane, its bucket, and what its cylinders hold along a cut."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_number
from backhoe_planner.errors import check_kind
from backhoe_planner.job.cuts.arm_plane import ArmPlane
from backhoe_planner.job.cuts.bucket import Bucket
from backhoe_planner.job.cuts.cut import Cut, CutGround, Holding
from backhoe_planner.machine import Dynamics, JointLimits, Robot
from backhoe_planner.motion import Drive, Trajectory, time_along
from backhoe_planner.site import Soil, SoilReaction

RESERVE = 0.15  # part of a cylinder's capability that is reserved for acceleration and for harder soil; chosen
_SWELL = 1.25  # volume of loose soil divided by that of the bank: usually 1.2 to 1.3
# part of the accelerations, for the path's curvature and for the speed each: durations of 60 random cuts were then
# estimated to 0.5 % on average, with a spread of 2 %; on rough ground a motion may take up to 50 % longer
OF_ACCELERATION = 0.75
_INTERVALS = 250  # of the timing: the duration is within 1 % of that with 1000


class Digger:
    """A machine that digs in a soil.

    Parameters
    ----------
    robot: the machine.
    soil: the soil that it digs; its `surface` does not matter.
    bucket: the bucket; by default that of the machine.
    limits: limits of the joints; by default the machine's own.
    swell: volume of loose soil divided by that of the bank.

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
    ) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        self.limits = robot.limits if limits is None else limits
        self.plane = ArmPlane(robot, limits=self.limits)
        self.bucket = Bucket.of(robot, width=soil.width) if bucket is None else bucket
        self.soil = check_kind(soil, Soil, key="soil").model_copy(update={"width": self.bucket.width})
        self.swell = as_number(swell, key="swell", above=0.0)
        self._drive = Drive(robot, effort=self.limits.effort)

    def motion(self, cut: Cut) -> Trajectory:
        """The cut from rest to rest, as fast as joints, valves, pump, engine and cylinders allow in the soil."""
        stations = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(cut.r), np.diff(cut.z)))))
        return time_along(stations, cut.q, self.limits, drive=self.drive(cut), intervals=_INTERVALS)

    def drive(self, cut: Cut) -> Drive:
        """The drive of the machine along a cut."""
        return Drive(self.robot, effort=self.limits.effort, soil=self.soil, ground=cut.ground)

    def loads(self, q: Matrix, ground: CutGround) -> tuple[Matrix, Holding]:
        """(K, n) torques that hold the machine and drive it through joints q (K, n) against the soil [N m], and
        the cylinder that is used most along the way.

        The soil's force depends on the direction, so that both ends and the middle of every step are evaluated in the
        direction of that step.
        """
        step, count = np.diff(q, axis=0), len(q)
        rows = np.vstack((q, q[:-1], 0.5 * (q[:-1] + q[1:]), q[1:]))
        direction = np.vstack((np.gradient(q, axis=0), step, step, step))
        fast = direction / np.maximum(np.max(np.abs(direction), axis=1, keepdims=True), 1e-12)
        weight = self._drive.gravity_torques(q)
        weights = np.vstack((weight, weight[:-1], 0.5 * (weight[:-1] + weight[1:]), weight[1:]))
        torque = weights - SoilReaction(self.robot, self.soil, ground).torques(rows, fast)
        use = self._drive.effort_use(rows, torque)
        row, joint = (int(i) for i in np.unravel_index(int(np.argmax(use)), use.shape))
        return torque[:count], self._holding(rows[row], torque[row], joint)

    def _holding(self, q: Vector, torque: Vector, joint: int) -> Holding:
        limits = self._drive.torque_limits(q)
        needed = abs(float(torque[joint]))
        available = float((limits.positive if torque[joint] > 0.0 else limits.negative)[joint])
        hydraulics, name = self.robot.hydraulics, self.robot.joint_names[joint]
        if hydraulics is not None:
            own = [c.name for c, index in zip(hydraulics.cylinders, hydraulics.joint_of, strict=True) if index == joint]
            name = " and ".join(own) or name
        r, z, _ = self.plane.place(q[None, :])
        return Holding(name, needed / available, needed, available, float(r[0]), float(z[0]))

    def estimated_run(
        self, q: Matrix, torque: Matrix, *, inertia: Dynamics | None = None, part: float = OF_ACCELERATION,
        pace: float = 1.0,
    ) -> tuple[float, float]:  # fmt: skip
        """Duration [s] and work [J] of a run from rest to rest through joints q (K, n) under `torque` (K, n) [N m].

        At each place the speed is limited by joints, valves, pump and engine, with the torques without inertia. Between
        places the accelerations of the joints limit the change of speed.

        Parameters
        ----------
        inertia: the machine with what it carries, whose inertia the work includes; None to leave it out.
        part: part of the joint accelerations that may be used, for the path's curvature and for the speed each.
        pace: speed divided by the greatest possible.
        """
        slope = np.gradient(q, axis=0)
        bend = np.gradient(slope, axis=0)
        x = pace**2 * self._speeds(q, (slope, bend), torque, part * self.limits.acceleration)
        speed = np.sqrt(x)
        times = 2.0 / (speed[1:] + speed[:-1])
        step, mean = np.diff(q, axis=0), 0.5 * (torque[1:] + torque[:-1])
        if inertia is not None:
            middle, rest = 0.5 * (q[1:] + q[:-1]), np.zeros_like(step)
            curved = 0.25 * (bend[1:] + bend[:-1]) * (x[1:] + x[:-1])[:, None]
            v, a = step / times[:, None], 0.5 * step * np.diff(x)[:, None] + curved
            mean = mean + inertia.torques_along(middle, v, a) - inertia.torques_along(middle, rest, rest)
        return float(np.sum(times)), float(np.sum(np.maximum(mean * step, 0.0)))

    def _speeds(self, q: Matrix, slopes: tuple[Matrix, Matrix], torque: Matrix, acceleration: Vector) -> Vector:
        """(K,) squares of the greatest speeds [places^2/s^2] of a run; `slopes` of q by the place, first and second."""
        limits, hydraulics = self.limits, self.robot.hydraulics
        slope, bend = slopes
        span = np.max(np.abs(slope) / limits.velocity, axis=1)
        if hydraulics is not None:
            rods = hydraulics.velocity_limits(q)
            span = np.maximum(span, np.max(np.abs(slope) / np.where(slope > 0.0, rods.positive, rods.negative), axis=1))
            span = np.maximum(span, hydraulics.total_flow(q, slope) / hydraulics.pump_flow)
            span = np.maximum(span, hydraulics.power(q, slope, torque) / hydraulics.power_limit)
        with np.errstate(divide="ignore"):
            turning = np.min(acceleration / np.abs(bend), axis=1)
            gain = np.min(acceleration / np.abs(slope), axis=1)
        x = np.minimum(1.0 / np.maximum(span, 1e-9) ** 2, turning).tolist()
        x[0] = x[-1] = 0.0
        rise = (2.0 * np.minimum(gain[1:], gain[:-1])).tolist()
        for i, more in enumerate(rise):
            x[i + 1] = min(x[i + 1], x[i] + more)
        for i in range(len(rise) - 1, -1, -1):
            x[i] = min(x[i], x[i + 1] + rise[i])
        return np.array(x)
