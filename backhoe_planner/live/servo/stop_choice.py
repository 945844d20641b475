"""The choice of a stop for a machine on its track when something turns up and no stop is proven.

The machine could stop along its track, but that was proven for what was there before. If something new is in the way
there, the machine may still stop beside it by leaving the track, at once or a little later. So the stops that its
accelerations allow are compared by the least margin on the way, to everything that is there and of the machine with
itself. Planes bound the distances along a whole stop; only where these bounds are the smallest of all is anything
measured, so that a stop that leads into something is soon known to. Of a cluster the boxes count that were found
around the machine: they reach as far as it moves while it brakes straight ahead.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.live.braking.braking_path import JointState, Placements
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.servo.joint_stop import JointStop, stops_from
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Robot

Stop: TypeAlias = Track | JointStop

_ENOUGH = 0.01  # m of margin beyond which one stop is as good as another; chosen
_TOUCH = 2e-4  # m below its clearance at which a stop still keeps it; twice what a certificate accepts
# by how much the least margin of a stop must be larger to be preferred to another one: in m, and as a part of the depth
# to which that one touches something, as the new one may touch more than that; chosen
_BETTER, _BETTER_PART = 2e-3, 0.1
_BETWEEN = 0.03  # m that any point moves between two places of a stop; chosen, then little is missed between them
_MOST_PLACES = 48  # of a stop; chosen
_LEAST_WAY = 1e-12  # m, so that nothing is divided by 0
_LATER = (0.1, 0.2, 0.3, 0.45)  # parts of the time to rest along a track after which it may be left; chosen
_MOST_MEASURED = 600  # distances for one choice; chosen, some 20 us each
_MOST_FOR_PRESENT = 300  # of them for the present stop; chosen, so that among many obstacles others are looked at too


class ChosenStop(NamedTuple):
    """A stop, how long it is the best one [s], and the least margin on the way if it is chosen anew then [m]."""

    stop: Stop
    until: float
    margin: float


class StopChoice:
    """Compares the stops of one machine.

    Parameters
    ----------
    robot: the machine.
    check: of its braking paths.
    """

    def __init__(self, robot: Robot, check: PathCheck) -> None:
        self._separation, self._bounds, self._joints = check.separation, check.bounds, check.joints
        self._acceleration = (1.0 - 1e-9) * check.joints.limits.acceleration
        self._at = Placements(robot, _MOST_PLACES + 1)
        self._left = 0  # distances that may still be measured for this choice

    def choose(self, state: JointState, stop: Stop) -> ChosenStop:
        """The stop that leaves the most room from here; the present `stop` if it touches nothing."""
        planes = [each.copy() for each in self._separation.of_boxes]
        self._left = _MOST_MEASURED
        try:
            return self._best(state, stop)
        finally:  # the planes that were measured where the machine is are of more use to the next steps
            for each, kept in zip(self._separation.of_boxes, planes, strict=True):
                each[...] = kept

    def _best(self, state: JointState, stop: Stop) -> ChosenStop:
        q, v, _ = state
        if isinstance(stop, Track):
            margin = self._least_margin(q, *stop.ahead(), worst=-_TOUCH)
            if margin > -_TOUCH:  # mostly: what turned up is nowhere near
                return ChosenStop(stop, math.inf, margin)
        places, times = stop.way_to_rest(q, v)
        others = min(self._left, _MOST_MEASURED - _MOST_FOR_PRESENT)
        self._left -= others
        best = ChosenStop(stop, math.inf, self._least_margin(q, places, times, worst=-math.inf))
        self._left += others
        if best.margin >= -_TOUCH:
            return best
        for other in stops_from(v, self._acceleration, self._joints.dt):
            way, when = other.way_to_rest(q, v)
            margin = self._least_margin(q, way, when, worst=_to_beat(best))
            if margin > _to_beat(best):
                best = ChosenStop(other, math.inf, margin)
            if best.margin >= _ENOUGH:
                return best
        if not isinstance(stop, Track):
            return best
        for part in _LATER:
            row = math.ceil(part * (len(times) - 1))
            if row >= len(times) - 1:
                break
            v = (places[row] - places[row - 1]) / (times[row] - times[row - 1])
            for other in stops_from(v, self._acceleration, self._joints.dt):
                way, when = other.way_to_rest(places[row], v)
                way, when = np.vstack((places[:row], way)), np.append(times[:row], times[row] + when)
                margin = self._least_margin(q, way, when, worst=_to_beat(best))
                if margin > _to_beat(best):
                    best = ChosenStop(stop, float(times[row]), margin)
                if best.margin >= _ENOUGH:
                    return best
        return best

    def _least_margin(self, q: Vector, places: Matrix, times: Vector, *, worst: float) -> float:
        """The least margin from q (n,) on at `places` (K, n) and `times` (K,) [m, s], no more than `_ENOUGH`.

        Once it is known to be `worst` or less, the rest is not looked at. It is minus infinity if the joints do not
        stay within their limits. If no more may be measured, it is `worst`; or, without one, the least margin found,
        and so small that only a stop which keeps its clearances has more room.
        """
        if not self._joints.are_kept_at(places[-1]):
            return -math.inf
        separation, at = self._separation, self._at
        places, times = self._spread(places, times)
        at.place_each(places)
        way = separation.travel.dot(np.abs(places - q).max(axis=0)).take(separation.classes)
        way += float(times[-1]) * np.linalg.norm(separation.velocity, axis=1)
        some = self._bounds.lower() - way < separation.clearance + _ENOUGH
        least = _ENOUGH
        pairs = some.nonzero()[0]
        clearance, moved = separation.clearance[pairs, None], separation.drift[pairs, None] * times
        margins = separation.gaps(pairs, at, len(places)).least + moved - clearance  # (K, S) bounds, better and better
        while len(pairs) and least > worst:
            pair, place = np.unravel_index(int(margins.argmin()), margins.shape)
            if margins[pair, place] >= least:
                return least
            if self._left <= 0:
                return min(least, -_TOUCH - _BETTER) if worst == -math.inf else worst
            self._left -= 1
            asked = pairs[pair : pair + 1]
            distance = separation.renew(int(asked[0]), at, int(place))
            anew = separation.gaps(asked, at, len(places)).least[0]
            shift = separation.drift[asked] * times - clearance[pair]
            margins[pair] = np.maximum(margins[pair], anew + shift)
            margins[pair, place] = distance + shift[place]
            least = min(least, float(margins[pair, place]))
        return least

    def _spread(self, places: Matrix, times: Vector) -> tuple[Matrix, Vector]:
        """(S, n), (S,) the places and times [s] of a way at equal distances from each other."""
        travel = self._separation.travel.dot(np.abs(np.diff(places, axis=0)).T).max(axis=0, initial=0.0)
        along = np.concatenate(([0.0], np.cumsum(travel)))
        count = min(max(math.ceil(along[-1] / _BETWEEN), 1), _MOST_PLACES)
        at = np.linspace(0.0, along[-1], count + 1)
        row = along[1:-1].searchsorted(at, side="right")
        part = (at - along[row]) / np.maximum(along[row + 1] - along[row], _LEAST_WAY)
        return places[row] + part[:, None] * (places[row + 1] - places[row]), times[row] + part * (
            times[row + 1] - times[row]
        )


def _to_beat(best: ChosenStop) -> float:
    """The margin that a stop must have to be preferred to the best one so far [m]."""
    if best.margin == -math.inf:
        return -math.inf
    return best.margin + max(_BETTER, -_BETTER_PART * best.margin)
