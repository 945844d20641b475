"""Curves from which descents may begin, and which of them promise to cost least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve, from_rest_to_rest
from backhoe_planner.planning.descent.descent import Descent
from backhoe_planner.site import ClearanceScreen

_PLACES = 25  # of a curve, that are asked whether they are clear; chosen, about every 2 to 10 cm of the tip
_PART = 0.5  # of the way, in which an early or a late joint makes all of its own; chosen
_APART = 0.15  # part of the longest time: joint time between two starts that count as different; chosen


@dataclass(frozen=True, eq=False)
class Start:
    """A curve from which a descent may begin, about how long it takes [s], where it ends, and how it was found."""

    curve: JointCurve
    duration: float
    goal: Goal
    way: str


def paced(starts: Sequence[Start], descent: Descent, screen: ClearanceScreen, *, longest: float) -> list[Start]:
    """Each of `starts`, straight lines, with the joints early or late on the way, so that it costs less.

    What a motion costs is often decided by which joint moves first: an arm that is unfolded after it was lowered needs
    little of the work of one that is held out on the way, and from an even pace no small step leads there. The joints
    are looked at one after the other, twice.

    Parameters
    ----------
    longest: that a motion may take [s].
    """
    found = []
    for start in starts:
        control, way = start.curve.control, start.curve.control[-1] - start.curve.control[0]
        u = np.linspace(0.0, 1.0, len(control))
        early, late = np.minimum(u / _PART, 1.0), np.maximum((u - 1.0) / _PART + 1.0, 0.0)
        paces = [from_rest_to_rest(part) for part in (early, u, late)]
        best, least = start, _price(start, descent, screen, longest)
        for joint in (*range(len(way)), *range(len(way))):
            for pace in paces:
                moved = best.curve.control.copy()
                moved[:, joint] = control[0, joint] + pace * way[joint]
                if np.array_equal(moved, best.curve.control):
                    continue
                other = replace(start, curve=start.curve.moved_to(moved))
                price = _price(other, descent, screen, longest)
                if price < least:
                    best, least = other, price
        if best is not start:
            found.append(best)
    return found


def _price(start: Start, descent: Descent, screen: ClearanceScreen, longest: float) -> float:
    """About what a descent from there costs: more, the more of it is blocked."""
    kept = screen.keeps(start.curve(np.linspace(0.0, 1.0, _PLACES)))
    return descent.estimate(start.curve, max(start.duration, longest), longest=longest) * (2.0 - float(np.mean(kept)))


def cheapest(
    starts: Sequence[Start], count: int, descent: Descent, screen: ClearanceScreen, *, longest: float
) -> list[Start]:
    """At most `count` of them: what costs least, and less is blocked, first; of those near each other one.

    Parameters
    ----------
    descent: of another cost than the time.
    screen: of the obstacles.
    longest: that a motion may take [s].
    """
    cost = [_price(start, descent, screen, longest) for start in starts]
    chosen: list[Start] = []
    for index in np.argsort(cost, kind="stable"):
        start = starts[index]
        apart = [float(np.max(np.abs(start.curve.control - one.curve.control) / descent.rate)) for one in chosen]
        if min(apart, default=np.inf) > _APART * longest:
            chosen.append(start)
        if len(chosen) == count:
            break
    return chosen
