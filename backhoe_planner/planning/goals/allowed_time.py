"""How long a motion to a goal may take that is to cost little, where its time is not the cost.

Mostly slower costs less, and with no limit some motions would cost nothing and take for ever. How
fast a motion the search finds is partly luck, so it is a multiple of the proven bound that decides.
"""

from __future__ import annotations

import math

_TIMES_BOUND = 3.0  # times the bound, that a motion may take; of 83 random sites it decides on 79, twice it on 70
_ROOM = 1.2  # times the fastest motion known, that a motion may take at least; chosen
_LONGER = 1.5  # times as long, where that is too little room; chosen, two seeds mostly agree on so large a step


def allowed_time(bound: float, fastest: float) -> float:
    """How long a motion may take [s].

    Parameters
    ----------
    bound: no motion takes less [s], proven; 0 where nothing is, and then the fastest motion decides alone.
    fastest: the duration of the fastest motion known [s].
    """
    if bound <= 0.0:
        return _LONGER * fastest
    if has_room(bound, fastest):
        return _TIMES_BOUND * bound
    steps = math.ceil(math.log(_ROOM * fastest / (_TIMES_BOUND * bound), _LONGER))
    return _TIMES_BOUND * bound * _LONGER**steps


def has_room(bound: float, fastest: float) -> bool:
    """Whether the bound alone decides, with a motion as fast as this known; see `allowed_time`."""
    return _ROOM * fastest <= _TIMES_BOUND * bound
