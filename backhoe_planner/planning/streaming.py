"""A plan, followed live: what turns up on the way slows, bends or holds the motion.

The plan's own clock s runs slower the further the machine is off the plan:

    v_w = s' v_p(s) + k (q_p(s) - q),    s' = max(0, 1 - |q_p(s) - q| / tolerance)

so that the machine waits for what is in its way, leaves the plan as far as it must, and
comes back to it. Where that leads nowhere for a while, the clock is let go on up to a
place of the plan that lies beyond, and the machine makes for that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.planning.plan import Plan
from backhoe_planner.planning.trajectory import Trajectory
from backhoe_planner.redundancy.servo import Servo
from backhoe_planner.redundancy.servo_state import ServoState

__all__ = ["Followed", "PlanFollower"]

Vector = NDArray[np.float64]

_PULL = 4.0  # 1/s
_TOLERANCE = 0.03  # rad or m off the plan at which its clock stands still
_ARRIVED = 1e-3  # rad or m
_PATIENCE = 1.0  # s without getting on after which the clock is let go
_FURTHEST = 1.0  # rad or m: how far ahead of the machine the clock may then run


@dataclass(frozen=True)
class Followed:
    """One step of a plan that is being followed.

    Attributes
    ----------
    state: of the servo.
    plan_time: how far the plan's clock has come [s].
    behind: how much later it is than planned [s].
    deviation: of the farthest joint from the plan [rad or m].
    done: the end of the plan is reached, at rest.
    """

    state: ServoState
    plan_time: float
    behind: float
    deviation: float
    done: bool


class PlanFollower:
    """Drives a servo along a plan, one step after the other.

    Parameters
    ----------
    servo: its machine must have the plan's joints. Where it stands off the plan's
        beginning it goes there first.
    plan: a plan, or its trajectory alone.

    Raises
    ------
    InputError: the plan has no motion, or another number of joints.
    """

    def __init__(self, servo: Servo, plan: Plan | Trajectory) -> None:
        trajectory = plan if isinstance(plan, Trajectory) else plan.trajectory
        if trajectory.q.shape[1] != servo.robot.n:
            raise InputError(
                "has another number of joints than the machine",
                key="plan.trajectory",
                found=trajectory.q.shape[1],
                allowed=str(servo.robot.n),
            )
        self.servo = servo
        self._time, self._q = trajectory.time, trajectory.q
        self._rates = trajectory.segment_velocities() if len(trajectory) > 1 else np.zeros((1, servo.robot.n))
        self._clock = 0.0
        self._steps = 0
        self._stuck = 0.0

    @property
    def done(self) -> bool:
        """Whether the end of the plan is reached, at rest."""
        servo = self.servo
        off = float(np.abs(self._q[-1] - servo.q).max())
        return self._clock >= float(self._time[-1]) and off < _ARRIVED and bool((np.abs(servo.v) < 1e-2).all())

    def step(self) -> Followed:
        """Move on by the servo's dt."""
        servo = self.servo
        q = servo.q
        goal, rates = self._at(self._clock)
        off = goal - q
        deviation = float(np.abs(off).max())
        pace = max(0.0, 1.0 - deviation / _TOLERANCE)
        if self._stuck > _PATIENCE and deviation < _FURTHEST:
            pace = 1.0
        state = servo.step(joint_velocity=pace * rates + _PULL * off)
        end = float(self._time[-1])
        waiting = self._clock < end and pace < 0.05 and float(np.abs(state.v).max()) < 0.02
        if waiting or (self._stuck > _PATIENCE and deviation > _TOLERANCE):
            self._stuck += servo.dt
        else:
            self._stuck = 0.0
        self._clock = min(self._clock + pace * servo.dt, end)
        self._steps += 1
        return Followed(
            state=state,
            plan_time=self._clock,
            behind=max(self._steps * servo.dt - self._clock, 0.0),
            deviation=deviation,
            done=self.done,
        )

    def _at(self, moment: float) -> tuple[Vector, Vector]:
        """(n,), (n,) the plan's joint positions and rates."""
        row = min(max(int(np.searchsorted(self._time, moment, side="right")) - 1, 0), len(self._rates) - 1)
        rates = self._rates[row]
        q = self._q[row] + (moment - float(self._time[row])) * rates
        return q, rates if moment < float(self._time[-1]) else np.zeros_like(rates)
