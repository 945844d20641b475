"""The greatest use of each limit of the machine over a whole motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import BatchKinematics
from backhoe_planner.motion import DRIVE_TOLERANCE, LimitUsage, Problem, Tracking, Trajectory, drive_of, limit_usage

MachineLimit = Literal["position", "velocity", "acceleration", "effort", "hydraulics"]
# the fields of a certificate that are the use of a limit, in the order in which they are reported
LimitName = Literal[MachineLimit, "tip_speed", "duration"]

JOINTS_WITHIN = 1e-6  # part of a limit of the joints: rounding
# part of the required speed; chosen for motions from other programs: plans are timed to within 0.1 %
_TIP_SPEED_WITHIN = 0.03
_WITHIN = {
    "position": JOINTS_WITHIN,
    "velocity": JOINTS_WITHIN,
    "acceleration": JOINTS_WITHIN,
    "tip speed": _TIP_SPEED_WITHIN,
    "duration": JOINTS_WITHIN,
}


@dataclass(frozen=True)
class LimitUse:
    """The greatest use of a limit over a motion.

    Limits of the drive may be exceeded by 1 %, because torques depend on accelerations, which
    the samples give only to second order in the time between them; the tip's speed by 3 %;
    joint limits not at all.

    Attributes
    ----------
    kind: ``position``, ``velocity``, ``acceleration``, ``torque``, ``rod speed``,
        ``pump flow``, ``engine power``, ``tip speed`` or ``duration``.
    joint: name of the joint; empty for the last four.
    ratio: use over limit. For a position outside its range, 1 plus the excess [rad or m].
    time: time of the greatest use [s].
    needed, available: use and limit, in `unit`; `available` is 0 if there is no limit.
    at_rest: for a torque, the part of `ratio` that is needed to hold still; 0 for other kinds.
    leg: name of the leg of a sequence to which it belongs; empty without a sequence.
    """

    kind: str
    joint: str
    ratio: float
    time: float
    needed: float
    available: float
    unit: str
    at_rest: float = 0.0
    leg: str = ""

    @property
    def most(self) -> float:
        """The greatest `ratio` with which the limit counts as kept."""
        return 1.0 + _WITHIN.get(self.kind, DRIVE_TOLERANCE)

    @property
    def kept(self) -> bool:
        """Whether the limit holds."""
        return self.ratio <= self.most

    @property
    def is_held(self) -> bool:
        """Whether the joint holds the load at rest; of other kinds true."""
        return self.at_rest <= self.most

    @property
    def percent(self) -> str:
        """The `ratio` in per cent, in words; one that is not kept shows that it is not."""
        percent = 100.0 * self.ratio
        return f"{percent:.1f}" if self.kept else beside_bounds(percent, 100.0 * self.most, places=".1f")[0]

    def describe(self) -> str:
        """The sentence about a limit that does not hold."""
        return describe_use(self, f"at {self.time:.2f} s")


def describe_use(use: LimitUse, when: str) -> str:
    """The sentence about a limit that does not hold, with words for when that is: ``at 2.50 s``."""
    much = describe_ratio(use.ratio)
    if use.kind == "position":
        return f"{use.joint} exceeds its position limit {when} ({use.ratio - 1.0:.3g} {use.unit} outside)"
    if use.kind in ("velocity", "acceleration"):
        return f"{use.joint} exceeds its {use.kind} limit {when} ({much} it)"
    if use.kind == "torque":
        lacks = "force" if use.unit == "N" else "torque"
        what = f"has too little {lacks} for the motion" if use.is_held else "cannot hold the load"
        torques = (1e-3 * abs(use.needed), 1e-3 * use.available)
        needed, available = beside_bounds(*torques, places=".3g", bounds_as=".3g")
        figures = f"{needed} k{use.unit} of {available} k{use.unit} ({much} it)"
        return f"{use.joint} {what} {when}: it takes {figures}"
    if use.kind == "rod speed":
        return f"{use.joint} asks its cylinders for {much} their greatest speed {when}"
    if use.kind == "tip speed":
        needed, asked = beside_bounds(use.needed, use.available, places=".3g", bounds_as=".3g")
        return f"the tip moves at {needed} m/s {when}, {much} the asked {asked} m/s"
    if use.kind == "duration":
        needed, allowed = beside_bounds(use.needed, use.available)
        return f"the motion takes {needed} s, max_duration allows {allowed} s"
    return f"the motion asks for {much} the {use.kind} {when}"


def describe_ratio(ratio: float) -> str:
    """A `ratio` to a limit in words: ``149 % of``, ``12 times``, ``more than 1000 times``."""
    if ratio < 10.0:
        return f"{beside_bounds(100.0 * ratio, 100.0, places='.2f' if ratio < 1.1 else '.0f')[0]} % of"
    return f"{ratio:.0f} times" if ratio < 1000.0 else "more than 1000 times"


def position_use(problem: Problem, trajectory: Trajectory) -> LimitUse:
    """Use of the joints' ranges; exact, because joints move linearly between samples."""
    lower, upper = problem.limits.lower, problem.limits.upper
    with np.errstate(invalid="ignore"):  # continuous joints have infinite limits
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        used = np.where(np.isfinite(half), np.abs(trajectory.q - middle) / half, 0.0)
    excess = np.maximum(trajectory.q - upper, lower - trajectory.q)
    used = np.where(excess > 0.0, 1.0 + excess, np.minimum(used, 1.0))
    row, joint = np.unravel_index(int(np.argmax(used)), used.shape)
    q = float(trajectory.q[row, joint])
    nearest = float(lower[joint] if q - lower[joint] < upper[joint] - q else upper[joint])
    return LimitUse(
        "position", problem.robot.joint_names[joint], float(used[row, joint]), float(trajectory.time[row]),
        q, _finite(nearest), problem.robot.joint_units[joint],
    )  # fmt: skip


def machine_uses(
    problem: Problem, trajectory: Trajectory
) -> tuple[LimitUse, LimitUse, LimitUse | None, LimitUse | None]:
    """Use of velocities, accelerations, torques, and hydraulics; None for a limit that the machine does not have."""
    usage = limit_usage(problem, trajectory, tip_speed=False)
    kinds = {kind for kind, _ in usage.limits}
    return (
        _worst(problem, usage, "velocity"),
        _worst(problem, usage, "acceleration"),
        _worst(problem, usage, "torque") if "torque" in kinds else None,
        _worst(problem, usage, "rod speed", "pump flow", "engine power") if "pump flow" in kinds else None,
    )


def tip_speed_use(problem: Problem, trajectory: Trajectory, tracking: Tracking) -> LimitUse | None:
    """Use of the tip's speed on the followed parts of a path, or on the whole motion to a goal; None if it is free."""
    if problem.tip_speed is not None:
        time, speed = _fastest_tip(problem, trajectory)
        return LimitUse("tip speed", "", speed / problem.tip_speed, time, speed, problem.tip_speed, "m/s")
    path = problem.scene.task.path
    if path is None or path.speed is None:
        return None
    ratio = tracking.max_speed / path.speed
    return LimitUse("tip speed", "", ratio, tracking.max_speed_time, tracking.max_speed, path.speed, "m/s")


def duration_use(problem: Problem, trajectory: Trajectory) -> LimitUse | None:
    """Use of the time that the motion to a goal may take; None where it may take any."""
    longest, taken = problem.max_duration, trajectory.duration
    if not np.isfinite(longest):
        return None
    return LimitUse("duration", "", taken / longest, float(trajectory.time[-1]), taken, longest, "s")


def _fastest_tip(problem: Problem, trajectory: Trajectory) -> tuple[float, float]:
    """The time at which the tip is fastest [s], and its speed then [m/s]."""
    moments = trajectory.moments()
    if len(moments.time) < 2:
        return 0.0, 0.0
    tips = BatchKinematics(problem.robot).at(moments.q).tip_position
    speed = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(moments.time)
    row = int(np.argmax(speed))
    return float(moments.time[row]), float(speed[row])


def _worst(problem: Problem, usage: LimitUsage, *kinds: str) -> LimitUse:
    """The limit of these kinds that is used most."""
    row, column = usage.worst(*kinds)
    (kind, joint), ratio, moments = usage.limits[column], float(usage.ratio[row, column]), usage.moments
    time, q = float(moments.time[row]), moments.q[row : row + 1]
    index = problem.robot.joint_names.index(joint) if joint else 0
    turns = problem.robot.joint_units[index]
    hydraulics = problem.robot.hydraulics
    if kind == "torque":
        drive, torque = drive_of(problem), float(usage.torque[row, index])
        limits, at_rest = drive.torque_limits(q), float(drive.static_use(q)[0, index])
        available = _finite((limits.positive if torque > 0.0 else limits.negative)[0, index])
        unit = "N" if turns == "m" else "N m"
        return LimitUse(kind, joint, ratio, time, torque, available, unit, at_rest)
    if kind in ("velocity", "acceleration"):
        available, unit = _finite(getattr(problem.limits, kind)[index]), f"{turns}/s" + "^2" * (kind != "velocity")
    else:
        assert hydraulics is not None
        limits = hydraulics.velocity_limits(q)
        rods = limits.positive if moments.v[row, index] > 0.0 else limits.negative
        available, unit = {
            "rod speed": (_finite(rods[0, index]), f"{turns}/s"),
            "pump flow": (hydraulics.pump_flow, "m^3/s"),
            "engine power": (hydraulics.power_limit, "W"),
        }[kind]
    return LimitUse(kind, joint, ratio, time, ratio * available, available, unit)


def _finite(value: float) -> float:
    """A limit, or 0 if there is none (infinity)."""
    return float(value) if np.isfinite(value) else 0.0
