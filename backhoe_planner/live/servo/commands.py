"""The hand's commands: understood, held until the next one, and ended by a watchdog."""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.live.servo.servo_state import Command
from backhoe_planner.machine import Robot

_FASTEST_WISH = 100.0  # m/s or rad/s: chosen, faster than any machine; keeps the numbers of the problem small

_LEAST_WISH = 1e-6  # m/s or rad/s: less counts as no wish to move; chosen, far above rounding


class Commands:
    """The wish that holds now.

    Parameters
    ----------
    dt: time between two steps [s].
    watchdog: a wish ends when no command has come for this long [s].

    Attributes
    ----------
    tip: (3,) wished velocity of the tip [m/s], world, or None.
    joints: (n,) wished velocity of the joints [rad/s or m/s], or None.
    pitch: wished rate of the bucket's pitch [rad/s], or None.
    asks: whether a motion is wished for; a velocity of 0 is a wish to stand still.
    """

    def __init__(self, robot: Robot, *, dt: float, watchdog: float) -> None:
        self._n, self._has_pitch = robot.n, robot.has_pitch
        self._dt, self._watchdog = dt, watchdog
        self._since = math.inf
        self.tip: Vector | None = None
        self.joints: Vector | None = None
        self.pitch: float | None = None
        self.asks = False

    def understand(self, tip_velocity: object, joint_velocity: object, pitch_rate: object) -> Command:
        """Take the command of a step, see `Servo.step`, and return what became of it. Nothing is raised."""
        if tip_velocity is None and joint_velocity is None and pitch_rate is None:
            found = Command.HELD
        elif self._take(tip_velocity, joint_velocity, pitch_rate):
            self._since = 0.0
            return Command.NEW
        else:
            found = Command.INVALID
        self._since += self._dt
        if self._since > self._watchdog:
            self.tip = self.joints = self.pitch = None
            self.asks = False
            return Command.TIMED_OUT if found is Command.HELD else found
        return found

    def _take(self, tip_velocity: object, joint_velocity: object, pitch_rate: object) -> bool:
        """Make a command the wish if it is understood; return whether it was."""
        tip = None if tip_velocity is None else _numbers(tip_velocity, 3)
        joints = None if joint_velocity is None else _numbers(joint_velocity, self._n)
        pitch = None if pitch_rate is None else _numbers(pitch_rate, 1)
        understood = (
            (tip is not None) != (joints is not None)
            and (tip_velocity is None or tip is not None)
            and (joint_velocity is None or joints is not None)
            and (pitch_rate is None or (pitch is not None and tip is not None and self._has_pitch))
        )
        if understood:
            self.tip, self.joints = _capped(tip), _capped(joints)
            self.pitch = None if pitch is None else float(pitch[0])
            self.asks = any(
                max(map(abs, one.tolist())) > _LEAST_WISH for one in (tip, joints, pitch) if one is not None
            )
        return understood


def _numbers(values: object, count: int) -> Vector | None:
    """`values` as (count,) finite numbers, or None if they are not."""
    try:
        found = np.array(values)
        if found.dtype.kind not in "fiu":
            return None
        found = found.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        return None
    if count == 1 and found.ndim == 0:
        found = found.reshape(1)
    if found.shape != (count,) or not all(map(math.isfinite, found.tolist())):
        return None
    return found


def _capped(wish: Vector | None) -> Vector | None:
    """The wish, scaled so that its largest number is at most `_FASTEST_WISH`."""
    if wish is None:
        return None
    largest = max(map(abs, wish.tolist()))
    return wish if largest <= _FASTEST_WISH else wish / largest * _FASTEST_WISH
