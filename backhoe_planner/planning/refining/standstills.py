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

from backhoe_planner.arrays import Indices, Matrix
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.search.effort import Brake

_PLACES = 2  # of each piece, for the comparison of all standstills; chosen: it shows which may gain
_TRIED = 60  # of the cheapest are tried after one comparison; chosen: of these some can be put in together
_SWEEPS, _MUCH_GAIN = 4, 0.01  # comparisons at most, and the part of the cost that one must gain for the next; chosen
_GAIN = 1e-3  # part of the cost that one standstill must gain; chosen
_TOGETHER = 400  # standstills that are compared at once, to bound the memory

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


def with_standstills(
    own_time: OwnTime, curve: JointCurve, duration: float, is_allowed: IsAllowed, *, brake: Brake
) -> JointCurve:
    """The curve with standstills that lower the cost of its motion over a duration [s]; the ends stay.

    Parameters
    ----------
    own_time: computes the cost, with its jumps.
    is_allowed: asked only of curves that cost less.
    brake: ends it if it takes too long.

    Raises
    ------
    OutOfTime: the budget is used up.
    """
    cost = own_time.cost(curve, duration, width=LEAST_WIDTH)
    for _ in range(_SWEEPS):
        before = cost
        for one in _promising(own_time, curve, duration, brake):
            there = one.put_in(curve)
            cost_there = own_time.cost(there, duration, width=LEAST_WIDTH)
            if cost_there < (1.0 - _GAIN) * cost and is_allowed(there, duration):
                curve, cost = there, cost_there
        if cost > (1.0 - _MUCH_GAIN) * before:
            break
    return curve


def _promising(own_time: OwnTime, curve: JointCurve, duration: float, brake: Brake) -> list[_Standstill]:
    """The standstills with which a curve seems to cost less, the cheapest first."""
    places = _PLACES * curve.pieces + 1
    weights = [curve.weights(places, k) / duration**k for k in range(3)]
    here, share = [each @ curve.control for each in weights], duration * curve.shares(places)
    rate, acts = own_time.rates(*here, width=LEAST_WIDTH), np.abs(weights).sum(axis=0) > 0.0
    every, gains = list(_all_in(curve)), []
    for begin in range(0, len(every), _TOGETHER):
        brake.check()
        joint, shift = _shifts(curve, every[begin : begin + _TOGETHER])
        which, place = np.nonzero((shift != 0.0).astype(float) @ acts.T)  # elsewhere nothing changes
        there = [each[place] for each in here]
        for each, moments in zip(weights, there, strict=True):
            moments[np.arange(len(place)), joint[which]] += (shift @ each.T)[which, place]
        gain = share[place] * (rate[place] - own_time.rates(*there, width=LEAST_WIDTH))
        gains.append(np.bincount(which, gain, minlength=len(joint)))
    gained = np.concatenate(gains) if gains else np.zeros(0)
    greatest = np.argsort(-gained, kind="stable")[:_TRIED].tolist()
    return [every[index] for index in greatest if gained[index] > _GAIN * float(share @ rate)]


def _shifts(curve: JointCurve, standstills: list[_Standstill]) -> tuple[Indices, Matrix]:
    """(S,) the joint of each standstill, and (S, L + 1) by how much it shifts that joint at the control points."""
    joint, first, last, stays_at = np.array(standstills).T
    point = np.arange(len(curve.control))
    held = (first[:, None] <= point) & (point <= last[:, None])
    return joint, np.where(held, curve.control[stays_at, joint][:, None] - curve.control.T[joint], 0.0)


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
