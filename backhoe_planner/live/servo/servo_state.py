"""What the servo says after every step."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from backhoe_planner.arrays import Vector
from backhoe_planner.site import Obstruction

HOLDS_WITHIN = 0.05  # m of margin within which an obstacle is said to hold the machine; chosen, half of `CLOSE`


class Status(str, Enum):
    """What the servo is doing. Where several hold, it is the last of them in this list.

    `SLIDING` and `STOPPED` are said of a machine that is asked to move: something is in the way of the command, and it
    goes where that leaves it to, or stands. A machine that nobody asks to move is not held by anything, and one that
    begins to move neither. Without a valid command, `TIMED_OUT` or `INVALID`, it is `STOPPED` once it stands, and so it
    is in every step that failed.
    """

    OK = "ok"
    NEAR_SINGULARITY = "near_singularity"
    NEAR_LIMIT = "near_limit"
    NEAR_OBSTACLE = "near_obstacle"
    SLIDING = "sliding"
    STOPPED = "stopped"
    EVADING = "evading"


class Command(str, Enum):
    """Whether the command of a step was new, held from before, ended by the watchdog, or not understood."""

    NEW = "new"
    HELD = "held"
    TIMED_OUT = "timed_out"
    INVALID = "invalid"


class ServoState(NamedTuple):
    """Where the machine is to be at the end of a step.

    Attributes
    ----------
    time: since the servo began [s].
    q, v: (n,) joint positions [rad or m], and the velocity that led there [rad/s or m/s].
    status: what the servo is doing.
    command: what became of the command of this step.
    nearest: the tightest pair of a link and what it must not touch, with proven lower bounds of
        distance and margin; None where nothing is within the influence distance.
    tip_position: (3,) at the beginning of the step [m], world.
    tip_velocity: (3,) of the tip at `v` [m/s], world.
    refused: (3,) part of the wish that the tip does not follow [m/s], world; never longer than the wish for the tip.
        What it does not follow yet, only because the joints are still accelerating, is no part of it.
    feedback_force: (3,) on the hand [N], world.
    proven: whether the braking path after this step was proven clear of everything that stands still.
    pace: part of the wished speed that the zones leave, 1 where none is near.
    """

    time: float
    q: Vector
    v: Vector
    status: Status
    command: Command
    nearest: Obstruction | None
    tip_position: Vector
    tip_velocity: Vector
    refused: Vector
    feedback_force: Vector
    proven: bool
    pace: float

    @property
    def margin(self) -> float:
        """Of `nearest` [m]; infinite where nothing is near."""
        return math.inf if self.nearest is None else self.nearest.margin
