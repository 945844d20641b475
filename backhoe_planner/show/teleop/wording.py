"""What the machine does, in a few words for the page.

    rest    no motion is wished for: grey
    free    the machine follows the wish: green
    near    the machine follows the wish, and something is near: yellow
    held    the wish is refused, wholly or in part: red

A worse state is shown at once. A better one is shown only after it has lasted, so that the words do not flicker while
the machine slides along something. Rest is shown at once.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from backhoe_planner.live import HOLDS_WITHIN, ServoState, Status

Kind = Literal["rest", "free", "near", "held"]

_LASTS = 0.5  # s: chosen, about the time to read a word
_MOVES = 1e-3  # rad/s or m/s: slower motions are not visible
_NEAR = 0.3  # m of margin within which the nearest thing is named; chosen, beyond where the servo slides along it
_WORSE: tuple[Kind, ...] = ("rest", "free", "near", "held")


class Caption(NamedTuple):
    """The words that the page shows.

    Attributes
    ----------
    kind: determines the colour of the words.
    word: what the machine does.
    more: the nearest thing and its margin; empty if nothing is near.
    """

    kind: Kind
    word: str
    more: str


class Wording:
    """Captions for one state after another."""

    def __init__(self) -> None:
        self._shown = Caption("rest", "At rest", "")
        self._since = 0.0

    def next(self, state: ServoState, *, has_wish: bool, waits: bool = False) -> Caption:
        """The caption of a state.

        Parameters
        ----------
        has_wish: whether a motion is wished for.
        waits: whether obstacles wait until somebody takes the controls.
        """
        if waits:
            return Caption("rest", "Nothing moves yet", "take the controls")
        found = _caption(state, has_wish=has_wish)
        better = _WORSE.index(found.kind) < _WORSE.index(self._shown.kind)
        if better and found.kind != "rest" and state.time - self._since < _LASTS:
            return self._shown._replace(more=found.more)
        self._shown, self._since = found, state.time
        return found


def _caption(state: ServoState, *, has_wish: bool) -> Caption:
    status, nearest = state.status, state.nearest
    name, more, distance = "", "", f"{state.margin:.2f} m".replace("-", "\N{MINUS SIGN}")
    if nearest is not None and nearest.margin < _NEAR:
        name, more = nearest.name, f"{nearest.link}, {distance}"
    if status is Status.EVADING:
        return Caption("held", f"Evading {name}".rstrip(), more)
    if status is Status.TOO_CLOSE:
        return Caption("held", f"Too close to {name}", more)
    if not has_wish:
        rests = float(np.abs(state.v).max()) < _MOVES
        return Caption("rest", "At rest" if rests else "Coming to rest", f"near {name}, {distance}" if name else "")
    holds = bool(name) and state.margin < HOLDS_WITHIN
    if status is Status.STOPPED:
        return Caption("held", f"Held by {name}" if holds else "Held by a limit", more)
    if status is Status.SLIDING:
        word = f"Sliding along {name}" if holds else f"Slowed before {name}" if name else "Slowed"
        return Caption("held" if holds else "near", word, more)
    words = {
        Status.NEAR_OBSTACLE: f"Near {name}",
        Status.NEAR_LIMIT: "At a joint limit",
        Status.NEAR_SINGULARITY: "Stretched out",
    }
    return Caption("near", words[status], more) if status in words else Caption("free", "Free", more)
