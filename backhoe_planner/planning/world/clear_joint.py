"""The least move of one joint that takes a posture out of a collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.search.postures import POSTURE_SPARE
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_STEP = 0.01  # rad or m between the values that are tried: the message gives one of them, short enough to write down
_FARTHEST = 150  # values to either side that are tried; chosen
_AT_A_TIME = 10  # values to either side of every joint that are tried before those further away


@dataclass(frozen=True)
class ClearJoint:
    """A posture that keeps every clearance and differs in one joint from one that collides.

    Attributes
    ----------
    name: of the joint.
    now, then: its position in the posture that collides and in the clear one [rad or m].
    unit: rad or m.
    """

    name: str
    now: float
    then: float
    unit: str

    def __str__(self) -> str:
        return f"with {self.name} at {self.then:.2f} {self.unit} instead of {self.now:.4g} it keeps its clearances"


def find_clear_joint(world: World, q: Vector, *, time: float) -> ClearJoint | None:
    """The least move of one joint after which `q` (n,) [rad or m] keeps every clearance and the problem's `keep`.

    Moves are counted in hundredths of a radian or metre. None if 1.5 rad or m are not enough for any joint.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].
    """
    problem, robot = world.problem, world.problem.robot
    screen = ClearanceScreen(world.proximity, time=time, spare=POSTURE_SPARE)
    rounded = np.round(q / _STEP)
    for first in range(1, _FARTHEST, _AT_A_TIME):
        steps = np.repeat(np.arange(first, first + _AT_A_TIME), 2)
        steps[1::2] *= -1
        # the nearest of all joints first
        joints, moved = np.tile(np.arange(robot.n), len(steps)), np.repeat(steps, robot.n)
        values = (rounded[joints] + moved) * _STEP
        within = (values >= problem.limits.lower[joints]) & (values <= problem.limits.upper[joints])
        joints, values = joints[within], values[within]
        tried = np.tile(q, (len(joints), 1))
        tried[np.arange(len(joints)), joints] = values
        kept = screen.keeps(tried)
        if problem.keep is not None and kept.any():
            kept = kept & problem.keep.holds_each(tried)
        if kept.any():
            found = int(np.argmax(kept))
            joint = int(joints[found])
            name, unit = robot.joint_names[joint], robot.joint_units[joint]
            return ClearJoint(name, float(q[joint]), float(values[found]), unit)
    return None
