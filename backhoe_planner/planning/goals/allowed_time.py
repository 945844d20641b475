"""How long a motion to a goal may take that is to cost little, where its time is not the cost.

Mostly slower costs less, and with no limit some motions would cost nothing and take for ever. How
fast a motion the search finds is partly luck, so it is a multiple of the proven bound that decides, which for this
depends on the problem alone: neither on a motion that is known nor on the effort.
"""

from __future__ import annotations

import math

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Problem
from backhoe_planner.planning.search.effort import EFFORTS
from backhoe_planner.proof import least_duration_of_all

_TIMES_BOUND = 3.0  # times the bound, that a motion may take; of 83 random sites it decides on 79, twice it on 70
_ROOM = 1.2  # times the fastest motion known, that a motion may take at least; chosen
_LONGER = 1.5  # times as long, where that is too little room; chosen, two seeds mostly agree on so large a step


def bound_for_allowed_time(problem: Problem, start: Vector) -> float:
    """What no motion from rest at `start` (n,) takes less than [s], the same whatever is known of the motions."""
    return least_duration_of_all(problem, start, boxes=EFFORTS["normal"].boxes)


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


def bound_behind(longest: float) -> float:
    """The bound that lets a motion take `longest` [s], where it alone decides."""
    return longest / _TIMES_BOUND


def has_room(bound: float, fastest: float) -> bool:
    """Whether the bound alone decides, with a motion as fast as this known; see `allowed_time`."""
    return fastest <= fastest_with_room(bound)


def fastest_with_room(bound: float) -> float:
    """What the fastest motion known takes at most, so that the bound alone decides [s]."""
    return _TIMES_BOUND * bound / _ROOM
