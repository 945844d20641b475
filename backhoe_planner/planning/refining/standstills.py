"""Joints are let stand still for a while, if the cost jumps where a rod begins to move.

However slowly a rod moves against its load, the pump supplies its pressure to all oil. The steps of a descent make such
a rod ever slower, but do not stop it, and where two joints cost less one after the other, no small step parts them. So
all ways are compared to let one joint stand still between two control points of a curve: it stays where it is at the
first, or is at the first already where it is at the last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH
from backhoe_planner.planning.descent.own_time import OwnTime

_PLACES = 2  # of each piece, for the comparison of all standstills; chosen: it shows which may gain
_TRIED = 60  # of the cheapest are tried after one comparison; chosen: of these some can be put in together
_SWEEPS, _MUCH_GAIN = 4, 0.01  # comparisons at most, and the part of the cost that one must gain for the next; chosen
_GAIN = 1e-3  # part of the cost that one standstill must gain; chosen
_TOGETHER = 400  # curves whose costs are computed at once, to bound the memory

IsAllowed = Callable[[JointCurve, float], bool]  # whether a curve may be run over a duration [s]


class _Standstill(NamedTuple):
    """One joint between two control points, and the one of these at whose position it stays."""

    joint: int
    first: int
    last: int
    stays_at: int

    def put_in(self, curve: JointCurve) -> JointCurve:
        control = curve.control.copy()
        control[self.first : self.last + 1, self.joint] = control[self.stays_at, self.joint]
        return curve.moved_to(control)


def with_standstills(own_time: OwnTime, curve: JointCurve, duration: float, is_allowed: IsAllowed) -> JointCurve:
    """The curve with standstills that lower the cost of its motion over a duration [s]; the ends stay.

    Parameters
    ----------
    own_time: computes the cost, with its jumps.
    is_allowed: asked only of curves that cost less.
    """
    cost = own_time.cost(curve, duration, width=LEAST_WIDTH)
    for _ in range(_SWEEPS):
        before = cost
        for one in _promising(own_time, curve, duration):
            there = one.put_in(curve)
            cost_there = own_time.cost(there, duration, width=LEAST_WIDTH)
            if cost_there < (1.0 - _GAIN) * cost and is_allowed(there, duration):
                curve, cost = there, cost_there
        if cost > (1.0 - _MUCH_GAIN) * before:
            break
    return curve


def _promising(own_time: OwnTime, curve: JointCurve, duration: float) -> list[_Standstill]:
    """The standstills with which a curve seems to cost less, the cheapest first."""
    every = list(_all_in(curve))
    costs = _compared(own_time, [curve, *(one.put_in(curve) for one in every)], duration)
    cheapest = np.argsort(costs[1:], kind="stable")[:_TRIED].tolist()
    return [every[index] for index in cheapest if costs[index + 1] < (1.0 - _GAIN) * costs[0]]


def _compared(own_time: OwnTime, curves: list[JointCurve], duration: float) -> Vector:
    """(C,) the costs of curves with equally many pieces, at few places."""
    parts = [curves[first : first + _TOGETHER] for first in range(0, len(curves), _TOGETHER)]
    return np.concatenate([
        own_time.costs(part, np.full(len(part), duration), width=LEAST_WIDTH, places=_PLACES) for part in parts
    ])  # fmt: skip


def _all_in(curve: JointCurve) -> Iterator[_Standstill]:
    """All standstills that leave the ends of a curve where they are."""
    last, n = len(curve.control) - 1, curve.control.shape[1]
    for joint in range(n):
        for first in range(last):
            for end in range(first + 1, last + 1):
                if end < last:
                    yield _Standstill(joint, first, end, stays_at=first)
                if first > 0:
                    yield _Standstill(joint, first, end, stays_at=end)
