"""What the servo says after every step."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from backhoe_planner.arrays import Vector


class Status(str, Enum):
    """What the servo is doing; the first that holds, from the bottom up."""

    OK = "ok"
    NEAR_SINGULARITY = "near_singularity"
    NEAR_LIMIT = "near_limit"
    NEAR_OBSTACLE = "near_obstacle"
    SLIDING = "sliding"
    STOPPED = "stopped"
    EVADING = "evading"


class Command(str, Enum):
    """What became of the last command."""

    NEW = "new"
    HELD = "held"
    TIMED_OUT = "timed_out"
    INVALID = "invalid"


class ServoState(NamedTuple):
    """Where the machine is to be at the end of a step.

    Attributes
    ----------
    time: since the servo began [s].
    q, v: (n,) joint positions, and the velocity that led there.
    status: what the servo is doing.
    command: whether the wish was new, is held from before, timed out, or could not be understood.
    margin: of the tightest pair, a proven lower bound of distance minus clearance [m];
        infinite where nothing is near.
    link, obstacle: of that pair; None where nothing is near.
    tip_position: (3,) at the beginning of the step [m], world.
    tip_velocity: (3,) that v gives the tip [m/s], world.
    refused: (3,) part of the wish that the tip does not follow [m/s], world.
    feedback_force: (3,) on the hand [N], world.
    proven: whether this step's braking path was proven clear of all that stands still.
    pace: part of the wished speed that the zones leave, 1 where none is near.
    """

    time: float
    q: Vector
    v: Vector
    status: Status
    command: Command
    margin: float
    link: str | None
    obstacle: str | None
    tip_position: Vector
    tip_velocity: Vector
    refused: Vector
    feedback_force: Vector
    proven: bool
    pace: float = 1.0
