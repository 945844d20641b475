"""What makes a machine slower than its plan, in words.

The plan's clock goes on at the least of several paces: of a machine beside the plan, of what is to be kept there, of
where it can stop straight ahead, and the one that is asked for. The pace that binds is told by its cause. If it is that
of a machine beside the plan, the cause is what held the machine back last, on its way there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from backhoe_planner.live.servo.holding import Hold
from backhoe_planner.live.servo.servo import Servo
from backhoe_planner.live.servo.servo_state import HOLDS_WITHIN, ServoState

_FULL = 1e-3  # part of a pace: one that is less by no more is as fast; chosen, far below what can be noticed
_BESIDE = 1e-3  # rad or m beside the plan from which a hold counts: from there on the plan's clock waits
_LASTS = 0.2  # s for which a cause is still told once the machine is as fast as the plan; chosen, to be readable


class Paces(NamedTuple):
    """The paces of a plan's clock in a step off the track, 0 to 1.

    Attributes
    ----------
    beside: of a machine beside the plan.
    kept: of what is to be kept there.
    stops: of what is to be kept where the machine comes to rest straight ahead.
    changes: of a pace that is asked for, as far as it can be had by now.
    waits: whether the clock waits until the machine is exactly on the plan.
    """

    beside: float
    kept: float
    stops: float
    changes: float
    waits: bool


class Delay:
    """Notes at every step what delays a machine along a plan.

    Parameters
    ----------
    servo: that drives the machine.

    Attributes
    ----------
    reason: what delays it now, or did a moment ago; empty if nothing does.
    """

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self.reason, self._since = "", 0.0
        self._hold: Hold | None = None  # the last one, since the machine was on the plan

    def on_track(self, state: ServoState, pace: float, asked: float) -> None:
        """Note a step along a track at a `pace`, of one that was `asked` for."""
        self._hold = None
        if pace >= asked - _FULL:
            self._note("")
        else:
            self._note("a zone slows the machine down" if state.pace < 1.0 else "the machine gathers speed")

    def off_track(
        self, state: ServoState, paces: Paces, asked: float, beside: float, stops_for: Callable[[], str]
    ) -> None:
        """Note a step off the track.

        Parameters
        ----------
        asked: the pace that is asked for.
        beside: how far the machine is beside the plan after the step [rad or m].
        stops_for: says what stopping straight ahead would violate, if that determines the pace.
        """
        hold = self._servo.held_by_unchecked()
        if hold is not None:
            self._hold = hold
        elif beside < _BESIDE:
            self._hold = None
        least = min(paces.beside, paces.kept, paces.stops, paces.changes, asked)
        if paces.waits:
            self._note("the machine comes back onto the plan before it goes on")
        elif state.pace < 1.0:
            self._note("a zone slows the machine down")
        elif least >= asked - _FULL:
            self._note(self._held(state) if hold is not None and beside > _BESIDE else "")
        elif least == paces.beside:
            self._note(self._held(state))
        elif least == paces.kept:
            self._note(f"going on beside the plan at its speed would violate `keep`{self._for_what_moves()}")
        elif least == paces.stops:
            violated = f"stopping straight ahead from the plan's speed would violate {stops_for() or '`keep`'}"
            self._note(f"{violated}{self._for_what_moves()}")
        else:
            self._note("the machine gathers speed")

    def held_by(self, state: ServoState) -> str:
        """What holds the machine back that does not get on, in words."""
        return self._held(state)

    def _note(self, reason: str) -> None:
        now = self._servo.time
        if reason:
            self._since = now
        if reason or now > self._since + _LASTS:
            self.reason = reason

    def _held(self, state: ServoState) -> str:
        hold = self._hold
        if hold is not None and hold.obstruction is not None:
            one = hold.obstruction
            if one.kind == "joint":
                return f"{one.obstacle} is at its limit"
            moves = one.kind == "obstacle" and self._servo.is_moving(one.obstacle)
            return f"{one.link} is held back by {one.name}{'' if moves else self._for_what_moves()}"
        if hold is not None and hold.keeps:
            return f"stopping straight ahead from a higher speed would violate `keep`{self._for_what_moves()}"
        if state.nearest is None or state.margin > HOLDS_WITHIN:
            return "the machine is off the plan"
        return f"{state.nearest.link} is held back by {state.nearest.name}"

    def _for_what_moves(self) -> str:
        """Why the machine must be able to stop straight ahead, although its plan is proven; empty if nothing moves."""
        comes = self._servo.reached_by
        return f"; while {comes} moves, the machine must be able to stop straight ahead" if comes else ""
