"""The first rounds of descents from several starts, for another cost than the time, which show the best starts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from backhoe_planner.planning.descent.descent import MISSED_WORTH, Timed
from backhoe_planner.planning.multistart.start_prices import Start

_FIRST_ROUNDS = 3  # of each start; measured: most of the fall of the cost happens in them
_MUCH_CHEAPER = 0.7  # times the least cost of a clear start: a blocked start below it gets more rounds; chosen
_ROUNDS_OUT = 14  # for a blocked start to leave its obstacle; chosen: it mostly turns to one side after 6 to 10
# places where clearances are checked for each where limits are: with fewer it slips through the obstacle; chosen
_DENSELY = 3
_NEARLY = 0.02  # m that a blocked start may miss after these rounds; chosen
# a blocked start that misses more than this part of its first miss after so many of these rounds stays blocked; chosen
_TRIED_OUT, _STAYS = 5, 0.8
# part of the cost by which a start falls behind after one round, and the first rounds after which none does; after more
# rounds it is less; chosen, see `Field`
_BEHIND, _NOT_BEFORE = 1.25, 1.5


GivesUp = Callable[[Timed, float], bool]  # whether a descent ends at a curve after so many rounds


class FewRounds(Protocol):
    """Some rounds of a descent from a start."""

    def __call__(
        self, start: Start, rounds: int, *, gives_up: GivesUp, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        """The curve after at most so many rounds, fewer if it gives up, and with `clear_first` if it is clear."""


class Field:
    """What the cheapest of several starts that got clear cost after each of its first rounds.

    A start that costs much more after as many rounds falls behind. On 97 searches for little work this saves a sixth of
    the time of the first rounds, and in one of them gave up the cheapest start, by 5 %. Judged sooner, up to two fifths
    are saved, but starts are given up whose costs fall late, to a third.

    Parameters
    ----------
    little: a cost that counts as little, in the objective's unit.
    """

    def __init__(self, little: float) -> None:
        self._little = little
        self._least: dict[float, float] = {}  # by the rounds
        self._own: dict[float, float] = {}  # of the present start

    def falls_behind(self, here: Timed, rounds: float) -> bool:
        """Whether the present start, which is `here` after so many rounds, costs much more than another one then."""
        worth = self._own[rounds] = max(min(_worth(here), *self._own.values(), np.inf), self._little)
        if rounds < _NOT_BEFORE:
            return False
        least = min((known for after, known in self._least.items() if after <= rounds), default=np.inf)
        return worth > (1.0 + _BEHIND / rounds) * least

    def end(self, found: Timed | None) -> None:
        """The present start has ended at `found`."""
        if found is not None and found.missed <= _NEARLY:
            for rounds, worth in self._own.items():
                self._least[rounds] = min(worth, self._least.get(rounds, np.inf))
        self._own = {}


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


def after_first_rounds(
    starts: Iterable[Start], bend: FewRounds, *, far_off: float, pushed: int, field: Field | None = None
) -> FirstRounds:
    """A few rounds of each start, and more of those that are cheap because they go through an obstacle.

    A curve through an obstacle stays there if leaving costs more than the penalty of the missed clearance. If it is
    much cheaper than all others, the penalty is raised until it is clear: mostly it is then still cheaper than the
    others.

    Parameters
    ----------
    far_off: a start that misses more than this counts as blocked [m].
    pushed: how many blocked starts at most get more rounds.
    field: of the starts, if those that fall behind get fewer rounds, and blocked ones that stay so.
    """
    clear: list[tuple[float, Start]] = []
    blocked: list[tuple[float, Start]] = []
    for start in starts:
        found = bend(start, _FIRST_ROUNDS, gives_up=_never if field is None else field.falls_behind)
        if field is not None:
            field.end(found)
        if found is not None and found.missed > far_off:
            blocked.append((found.cost, _as_far(start, found)))
        elif found is not None:
            clear.append((_worth(found), _as_far(start, found)))
    blocked.sort(key=lambda one: one[0])
    least = min((cost for cost, _ in clear), default=np.inf)
    for cost, start in blocked[:pushed]:
        if cost < _MUCH_CHEAPER * least:
            stays = _never if field is None else _stays_blocked()
            found = bend(start, _ROUNDS_OUT, gives_up=stays, density=_DENSELY, clear_first=True)
            if found is not None and found.missed <= _NEARLY:
                clear.append((_worth(found), _as_far(start, found)))
    clear.sort(key=lambda one: one[0])
    return FirstRounds(clear, blocked)


def _never(_here: Timed, _rounds: float) -> bool:
    return False


def _stays_blocked() -> GivesUp:
    """Whether a curve still misses nearly as much as at first, after some rounds."""
    first: list[float] = []

    def stays(here: Timed, rounds: float) -> bool:
        first.append(here.missed)
        return rounds >= _TRIED_OUT and here.missed > _STAYS * first[0]

    return stays


def _worth(found: Timed) -> float:
    return found.cost * (1.0 + MISSED_WORTH * found.missed)


def _as_far(start: Start, found: Timed) -> Start:
    return replace(start, curve=found.curve, duration=found.duration)
