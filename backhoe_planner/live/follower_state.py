"""The state that a follower returns after every step."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from backhoe_planner.live.left_out import LeftOut
from backhoe_planner.live.servo.servo_state import ServoState


class FollowerStatus(str, Enum):
    """How following a plan is going; see `FollowerState`."""

    FOLLOWING = "following"
    WAITING = "waiting"
    GOING_ROUND = "going_round"
    BLOCKED = "blocked"
    ARRIVED = "arrived"


@dataclass(frozen=True)
class FollowerState:
    """The state after one step along a plan.

    Attributes
    ----------
    state: of the servo.
    plan_time: how far the plan's clock has come [s].
    behind: how much later than planned the machine is [s]; once it is done, how much later it arrived.
    deviation: of the joint that is farthest from the plan at `plan_time` [rad or m].
    done: whether the machine rests at the end of the plan.
    status: ``following``; ``waiting``: no progress, and a detour is searched, or soon will be;
        ``going_round``: on a detour that rejoins the plan; ``blocked``: no detour was found, and
        further searches follow; ``arrived``.
    reason: what the machine waits for, goes around, or is blocked by, or what is on the rest of the plan, in words, and
        whether a way round is searched for; while it is slower than the plan, what delays it: of several things the one
        that binds, which need not be the nearest; at the end, what was left out of the plan; otherwise empty. While
        a clearance is lost, it begins with what is too close, and how close.
    left_out: the parts of the plan that were left out so far, because detours rejoined it further on.
    """

    state: ServoState
    plan_time: float
    behind: float
    deviation: float
    done: bool
    status: FollowerStatus
    reason: str
    left_out: tuple[LeftOut, ...] = ()

    def __repr__(self) -> str:
        """One line: what it does and why, how far the plan's clock has come, and how late the machine is."""
        why = f" ({self.reason})" if self.reason else ""
        return f"<FollowerState {self.status.value}{why}, plan time {self.plan_time:.2f} s, {self.behind:.2f} s behind>"
