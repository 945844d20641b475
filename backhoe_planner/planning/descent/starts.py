"""Curves from which descents may begin, and which of them promise to cost least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Descent
from backhoe_planner.site import ClearanceScreen

_PLACES = 25  # of a curve, that are asked whether they are clear; chosen, about every 2 to 10 cm of the tip
_APART = 0.15  # part of the longest time: joint time between two starts that count as different; chosen


@dataclass(frozen=True, eq=False)
class Start:
    """A curve from which a descent may begin, about how long it takes [s], where it ends, and how it was found."""

    curve: JointCurve
    duration: float
    goal: Goal
    way: str


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
    part = np.linspace(0.0, 1.0, _PLACES)
    cost = [
        descent.estimate(start.curve, max(start.duration, longest), longest=longest)
        * (2.0 - float(np.mean(screen.keeps(start.curve(part)))))
        for start in starts
    ]
    chosen: list[Start] = []
    for index in np.argsort(cost, kind="stable"):
        start = starts[index]
        apart = [float(np.max(np.abs(start.curve.control - one.curve.control) / descent.rate)) for one in chosen]
        if min(apart, default=np.inf) > _APART * longest:
            chosen.append(start)
        if len(chosen) == count:
            break
    return chosen
