"""The state that the servo returns after every step."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from backhoe_planner.arrays import Vector
from backhoe_planner.site import Obstruction

HOLDS_WITHIN = 0.05  # m of margin within which an obstacle counts as holding the machine; chosen, half of `CLOSE`


class Status(str, Enum):
    """What the servo is doing. If several apply, it is the last of them in this list.

    `SLIDING` and `STOPPED` mean that something is in the way of a command to move: the machine follows it as far as
    possible, or stands still. They do not apply to a machine that is not commanded to move, or that only begins to
    move. Without a valid command (`TIMED_OUT` or `INVALID`) the status is `STOPPED` once the machine stands still. It
    is also `STOPPED` in every step that failed. `TOO_CLOSE` means that a clearance is lost at the end of the step, as
    was measured: `nearest` is the pair. It may be an obstacle that was put there, or that came faster than the machine
    can give way. At most four pairs are measured: among many things that come at 3 m/s and more it may be missed.
    """

    OK = "ok"
    NEAR_SINGULARITY = "near_singularity"
    NEAR_LIMIT = "near_limit"
    NEAR_OBSTACLE = "near_obstacle"
    SLIDING = "sliding"
    STOPPED = "stopped"
    EVADING = "evading"
    TOO_CLOSE = "too_close"


class Command(str, Enum):
    """Whether the command of a step was new, held from before, ended by the watchdog, or not understood."""

    NEW = "new"
    HELD = "held"
    TIMED_OUT = "timed_out"
    INVALID = "invalid"


class ServoState(NamedTuple):
    """The state of the machine at the end of a step.

    Attributes
    ----------
    time: since the servo started [s].
    q, v: (n,) joint positions [rad or m], and the velocity that led there [rad/s or m/s].
    status: what the servo is doing.
    command: what became of the command of this step.
    nearest: the tightest pair of a link and what it must not touch, with proven lower bounds of
        distance and margin, which are measured if it is too close; None if nothing is within the influence distance.
    tip_position: (3,) at the beginning of the step [m], world.
    tip_velocity: (3,) of the tip at `v` [m/s], world.
    refused: (3,) part of the wish that the tip does not follow [m/s], world; never longer than the wish for the tip.
        It does not include what the tip does not follow yet only because the joints are still accelerating.
    feedback_force: (3,) on the hand [N], world.
    proven: whether braking straight ahead after this step, or along a track, was proven clear of everything that stands
        still in this step, not in an earlier one.
    pace: part of the wished speed that the zones allow, 1 if none is near.
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
        """Margin of `nearest` [m]; infinite if nothing is near."""
        return math.inf if self.nearest is None else self.nearest.margin
