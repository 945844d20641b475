"""A few rounds of descents from several starts, for another cost than the time, and which of them promise most."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from backhoe_planner.planning.descent.descent import MISSED_WORTH, Timed
from backhoe_planner.planning.descent.starts import Start

_FIRST_ROUNDS = 3  # of each start; measured, most of what the cost falls is gained in them
_MUCH_CHEAPER = 0.7  # times the least cost of those that get clear, below which one that does not is worth more; chosen
_ROUNDS_OUT = 14  # in which such a one may get out of the obstacle; chosen, it mostly turns to one side after 6 to 10
# places at which it is then looked, for each at which limits are: it goes through the obstacle between few; chosen
_DENSELY = 3
_NEARLY = 0.02  # m that it may miss then; chosen


class FewRounds(Protocol):
    """Some rounds of a descent from a start."""

    def __call__(self, start: Start, rounds: int, *, density: int = 1, clear_first: bool = False) -> Timed | None:
        """The curve after at most so many rounds; with `clear_first` no more than it takes to get clear."""


@dataclass(frozen=True, eq=False)
class FirstRounds:
    """Starts after their first rounds.

    Attributes
    ----------
    clear: those that got clear, or nearly, as far as they came, with what they then cost; the cheapest first.
    blocked: what the cheapest costs that stayed in an obstacle at first; infinite where none did.
    """

    clear: list[tuple[float, Start]]
    blocked: float


def after_first_rounds(starts: Iterable[Start], bend: FewRounds, *, far_off: float, pushed: int) -> FirstRounds:
    """A few rounds of each start, and more of those that are cheap as they go through an obstacle.

    A curve through an obstacle stays there where that costs less than what it misses counts for. Where it is much
    cheaper than all others, getting clear counts more until it is: mostly it is then still cheaper than they are.

    Parameters
    ----------
    far_off: a start that misses more counts as one that does not get clear [m].
    pushed: how many of these at most are to get clear.
    """
    clear: list[tuple[float, Start]] = []
    blocked: list[tuple[float, Start]] = []
    for start in starts:
        found = bend(start, _FIRST_ROUNDS)
        if found is not None and found.missed > far_off:
            blocked.append((found.cost, _as_far(start, found)))
        elif found is not None:
            clear.append((_worth(found), _as_far(start, found)))
    blocked.sort(key=lambda one: one[0])
    least = min((cost for cost, _ in clear), default=np.inf)
    for cost, start in blocked[:pushed]:
        if cost < _MUCH_CHEAPER * least:
            found = bend(start, _ROUNDS_OUT, density=_DENSELY, clear_first=True)
            if found is not None and found.missed <= _NEARLY:
                clear.append((_worth(found), _as_far(start, found)))
    clear.sort(key=lambda one: one[0])
    return FirstRounds(clear, blocked[0][0] if blocked else np.inf)


def _worth(found: Timed) -> float:
    return found.cost * (1.0 + MISSED_WORTH * found.missed)


def _as_far(start: Start, found: Timed) -> Start:
    return replace(start, curve=found.curve, duration=found.duration)
