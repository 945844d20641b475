"""Where a motion may end: the tip at a pose, or the joints at a posture.

A planner needs the same of both: how far a configuration is from the goal (`error`, with its
Jacobian), and either the fixed posture (`q`) or the tip pose to solve for (`search_target`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_number, as_vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.errors import check_kind
from backhoe_planner.machine import Configuration, TipTarget

GOAL_TOLERANCE = 1e-3  # m at which a goal is reached; chosen, far below what a machine's control can do
ANGLE_TOLERANCE = 1e-2  # rad at which a required angle is reached; chosen, half a degree
JOINT_TOLERANCE = 1e-3  # rad or m at which a joint is at its goal; chosen, a centimetre at the end of a 10 m arm
_SEARCHED = 0.9  # part of a tolerance that a search uses; chosen, so that rounding never exceeds it


@dataclass(frozen=True, eq=False)
class Goal:
    """One permitted end of a motion. A problem may have several; reaching any of them is enough.

    Attributes
    ----------
    target: the required pose of the tip; for a goal given by joints, the tip's pose there.
    q: (n,) the only permitted posture [rad or m]; None if a tip pose is required.
    name: in sentences: ``goal``, or ``goal 2`` if there are several, counted from 1.
    rotation_tolerance: how far the tip may be turned from the required orientation, or its axis from the required
        direction [rad]; None
        if the scene does not say. Then 0.01 rad is enough for a motion, and a search is exact.
    tolerance: how far the tip may be from the required position [m]; None if the scene does not say. Then 1 mm
        is enough for a motion, and a search is exact.
    aim: (3,) the position at which a search aims exactly [m], world; None for the required one, or for any within
        the tolerance if the scene gives one. It differs from the required one if that is out of reach, and a position
        within the tolerance is not.

    Raises
    ------
    InputError: an attribute has the wrong type or value.
    """

    target: TipTarget
    q: Vector | None = None
    name: str = "goal"
    rotation_tolerance: float | None = None
    tolerance: float | None = None
    aim: Vector | None = None

    def __post_init__(self) -> None:
        check_kind(self.target, TipTarget, key="target")
        check_kind(self.name, str, key="name")
        if self.q is not None:
            object.__setattr__(self, "q", as_vector(self.q, max(np.size(self.q), 1), key="q"))
        if self.rotation_tolerance is not None:
            as_number(self.rotation_tolerance, key="rotation_tolerance", above=0.0)
        if self.tolerance is not None:
            as_number(self.tolerance, key="tolerance", above=0.0)
        if self.aim is not None:
            object.__setattr__(self, "aim", as_vector(self.aim, 3, key="aim"))

    @property
    def allowed_off(self) -> float:
        """How far the tip may be from the required position [m]."""
        return GOAL_TOLERANCE if self.tolerance is None else self.tolerance

    @property
    def search_target(self) -> TipTarget:
        """The target for inverse kinematics: the pose, with most of its tolerances free to use, or exactly at `aim`."""
        if self.q is not None:
            return self.target
        target = self.target if self.aim is None else replace(self.target, position=self.aim)
        if self.tolerance is not None and self.aim is None:
            target = replace(target, position_tolerance=_SEARCHED * self.tolerance)
        if self.rotation_tolerance is None:
            return target
        turned = _SEARCHED * self.rotation_tolerance
        tilt = None if target.tilt is None else replace(target.tilt, tolerance=turned)
        return replace(target, rotation_tolerance=turned, tilt=tilt)

    @cached_property
    def exactly(self) -> Goal:
        """The same goal, for a search that does not use its tolerance of the position."""
        return replace(self, aim=self.target.position) if self.search_target.position_tolerance else self

    def error(self, at: Configuration) -> Vector:
        """(m,) the difference between the goal and a configuration; all 0 on the goal.

        Rows: for a tip pose, `TipTarget.error` of the `search_target`, position [m] and angles [rad];
        for a posture, `q` minus the joints (n,) [rad or m].
        """
        if self.q is None:
            return self.search_target.error(at)
        check_kind(at, Configuration, key="at")
        return as_vector(self.q, len(at.q), key="q") - at.q

    def jacobian(self, at: Configuration) -> Matrix:
        """(m, n) Jacobian of `error`: to first order, a step dq reduces the error by jacobian @ dq."""
        check_kind(at, Configuration, key="at")
        return self.search_target.jacobian(at) if self.q is None else np.eye(len(self.q))

    def distances(self, at: Configuration) -> tuple[float, float]:
        """How far the tip is from its pose [m] and turned from it [rad], both 0 or more, with no tolerance deducted."""
        return self.target.distances(at)

    def shortfall(self, at: Configuration) -> str:
        """How the end of a motion misses the goal, in words; empty if the goal is reached."""
        robot = check_kind(at, Configuration, key="at").robot
        if self.q is not None:
            off = np.abs(at.q - self.q)
            joint = int(np.argmax(off))
            if off[joint] <= JOINT_TOLERANCE:
                return ""
            slides = bool(robot.prismatic[joint])
            much = _metres(off[joint], JOINT_TOLERANCE) if slides else _degrees(off[joint], JOINT_TOLERANCE, ".2f")
            return f"{robot.joint_names[joint]} ends {much} from the {self.name}"
        position, angle = self.distances(at)
        allowed_angle = ANGLE_TOLERANCE if self.rotation_tolerance is None else self.rotation_tolerance
        missing = []
        if position > self.allowed_off:
            missing.append(f"{_metres(position, self.allowed_off)} from the {self.name}")
        if angle > allowed_angle:
            missing.append(f"{_degrees(angle, allowed_angle, '.1f')} from the asked angle")
        return f"the tip ends {' and '.join(missing)}" if missing else ""


def _metres(length: float, allowed: float) -> str:
    """A length [m] in words that is more than is `allowed`."""
    return f"{beside_bounds(length, allowed, places='.3f')[0]} m"


def _degrees(angle: float, allowed: float, places: str) -> str:
    """An angle [rad] in words that is more than is `allowed`."""
    return f"{beside_bounds(float(np.degrees(angle)), float(np.degrees(allowed)), places=places)[0]} deg"
