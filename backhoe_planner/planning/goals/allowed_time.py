"""How long a motion to a goal may take, if its cost is not the time.

A slower motion mostly costs less; without a limit some would cost nothing and take forever. How fast a motion the
search finds is partly chance, so the limit is a multiple of the proven lower bound. The bound used here depends
on the problem alone: neither on a known motion nor on the effort.
"""

from __future__ import annotations

import math

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Problem
from backhoe_planner.planning.search.effort import EFFORTS
from backhoe_planner.proof import least_duration_of_all

_TIMES_BOUND = 3.0  # times the bound, that a motion may take; it decides on 79 of 83 random sites, a factor of 2 on 70
_ROOM = 1.2  # times the fastest known motion, that a motion may take at least; chosen
_LONGER = 1.5  # factor on the limit while that is too little; chosen: two seeds mostly agree on so large a step


def bound_for_allowed_time(problem: Problem, start: Vector) -> float:
    """A lower bound on the duration of any motion from rest at `start` (n,) [s], independent of known motions."""
    return least_duration_of_all(problem, start, boxes=EFFORTS["normal"].boxes)


def allowed_time(bound: float, fastest: float) -> float:
    """How long a motion may take [s].

    Parameters
    ----------
    bound: a proven lower bound on the duration [s]; if it is 0, the fastest motion alone decides.
    fastest: the duration of the fastest known motion [s].
    """
    if bound <= 0.0:
        return _LONGER * fastest
    if has_room(bound, fastest):
        return _TIMES_BOUND * bound
    steps = math.ceil(math.log(_ROOM * fastest / (_TIMES_BOUND * bound), _LONGER))
    return _TIMES_BOUND * bound * _LONGER**steps


def bound_behind(longest: float) -> float:
    """The bound for which a motion may take `longest` [s], if the bound alone decides."""
    return longest / _TIMES_BOUND


def has_room(bound: float, fastest: float) -> bool:
    """Whether the bound alone decides if a motion as fast as `fastest` is known; see `allowed_time`."""
    return fastest <= fastest_with_room(bound)


def fastest_with_room(bound: float) -> float:
    """The longest duration of the fastest known motion for which the bound alone decides [s]."""
    return _TIMES_BOUND * bound / _ROOM
