"""What the machine does, in a few words for the page.

    rest    nobody asks for anything: grey
    free    it does what is asked: green
    near    it does, and something is near: yellow
    held    what is asked is refused, wholly or in part: red

What is worse is told at once; what is better only once it has lasted, so that the words
do not flicker where the machine slides along something. Where nobody asks any more it is
at rest at once.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from backhoe_planner.live import ServoState, Status

Kind = Literal["rest", "free", "near", "held"]

_LASTS = 0.5  # s
_MOVES = 1e-3  # rad/s or m/s
_NEAR = 0.3  # m of margin within which the nearest thing is named
_TOUCHES = 0.05  # m of margin within which it is the nearest thing that holds the machine
_WORSE: tuple[Kind, ...] = ("rest", "free", "near", "held")


class Telling(NamedTuple):
    """What is told.

    Attributes
    ----------
    kind: how it is coloured.
    word: what the machine does.
    more: of what is nearest; may be empty.
    """

    kind: Kind
    word: str
    more: str


class Wording:
    """Words for one state after the other."""

    def __init__(self) -> None:
        self._told = Telling("rest", "At rest", "")
        self._since = 0.0

    def next(self, state: ServoState, *, asked: bool) -> Telling:
        """What is told of a state; `asked` says whether somebody asks for a motion."""
        found = _telling(state, asked=asked)
        better = _WORSE.index(found.kind) < _WORSE.index(self._told.kind)
        if better and found.kind != "rest" and state.time - self._since < _LASTS:
            return self._told._replace(more=found.more)
        self._told, self._since = found, state.time
        return found


def _telling(state: ServoState, *, asked: bool) -> Telling:
    status, name = state.status, state.obstacle
    close = name is not None and state.margin < _NEAR
    distance = f"{state.margin:.2f} m".replace("-", "\N{MINUS SIGN}")
    more = f"{state.link}, {distance}" if close else ""
    if status is Status.EVADING:
        return Telling("held", f"Evading {name}" if close else "Evading", more)
    if not asked:
        rests = float(np.abs(state.v).max()) < _MOVES
        return Telling("rest", "At rest" if rests else "Coming to rest", f"near {name}, {distance}" if close else "")
    holds = close and state.margin < _TOUCHES
    if status is Status.STOPPED:
        return Telling("held", f"Held by {name}" if holds else "Held by a limit", more)
    if status is Status.SLIDING:
        word = f"Sliding along {name}" if holds else f"Slowed before {name}" if close else "Slowed"
        return Telling("held" if holds else "near", word, more)
    if status is Status.NEAR_OBSTACLE:
        return Telling("near", f"Near {name}", more)
    if status is Status.NEAR_LIMIT:
        return Telling("near", "At a joint limit", more)
    if status is Status.NEAR_SINGULARITY:
        return Telling("near", "Stretched out", more)
    return Telling("free", "Free", more)
