"""The first rounds of descents from several starts, for another cost than the time, which show the best starts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from backhoe_planner.planning.descent.descent import MISSED_WORTH, Timed
from backhoe_planner.planning.descent.starts import Start

_FIRST_ROUNDS = 3  # of each start; measured: most of the fall of the cost happens in them
_MUCH_CHEAPER = 0.7  # times the least cost of a clear start: a blocked start below it gets more rounds; chosen
_ROUNDS_OUT = 14  # for a blocked start to leave its obstacle; chosen: it mostly turns to one side after 6 to 10
# places where clearances are checked for each where limits are: with fewer it slips through the obstacle; chosen
_DENSELY = 3
_NEARLY = 0.02  # m that a blocked start may miss after these rounds; chosen


class FewRounds(Protocol):
    """Some rounds of a descent from a start."""

    def __call__(self, start: Start, rounds: int, *, density: int = 1, clear_first: bool = False) -> Timed | None:
        """The curve after at most so many rounds; with `clear_first` it ends as soon as the curve is clear."""


@dataclass(frozen=True, eq=False)
class FirstRounds:
    """Starts after their first rounds.

    Attributes
    ----------
    clear: the starts that got clear, or nearly, as far as they were bent, with their costs; the cheapest first.
    blocked: the starts that were still in an obstacle after their first rounds, likewise.
    """

    clear: list[tuple[float, Start]]
    blocked: list[tuple[float, Start]]

    @property
    def least_blocked(self) -> float:
        """The least cost of a start that was still in an obstacle; infinite if none was."""
        return self.blocked[0][0] if self.blocked else np.inf


def after_first_rounds(starts: Iterable[Start], bend: FewRounds, *, far_off: float, pushed: int) -> FirstRounds:
    """A few rounds of each start, and more of those that are cheap because they go through an obstacle.

    A curve through an obstacle stays there if leaving costs more than the penalty of the missed clearance. If it is
    much cheaper than all others, the penalty is raised until it is clear: mostly it is then still cheaper than the
    others.

    Parameters
    ----------
    far_off: a start that misses more than this counts as blocked [m].
    pushed: how many blocked starts at most get more rounds.
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
    return FirstRounds(clear, blocked)


def _worth(found: Timed) -> float:
    return found.cost * (1.0 + MISSED_WORTH * found.missed)


def _as_far(start: Start, found: Timed) -> Start:
    return replace(start, curve=found.curve, duration=found.duration)
