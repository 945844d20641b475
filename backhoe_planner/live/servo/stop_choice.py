"""The choice of a stop for a machine that moves when something turns up and no stop is proven.

The machine could stop along its track, but that was proven for what was there before. If something new is in the way
there, the machine may still stop beside it by leaving the track, at once or a little later. So the stops that its
accelerations allow are compared by the least margin on the way, to everything that is there and of the machine with
itself. Planes bound the distances along a whole stop; only where these bounds are the smallest of all is anything
measured, so that a stop that leads into something is soon known to. Of a cluster the boxes count that were found
around the machine: they reach as far as it moves while it brakes straight ahead.

A machine off a track brakes in a straight line, as planned with a part of its accelerations. If something turns up on
that line, all of its accelerations, in a shorter line, are what the other stops are compared with.

A step of the servo must not come late, least of all now. So each step looks at one or two stops, and the machine slows
down along its track meanwhile, until one is found that leaves more room.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import TypeAlias, TypeVar

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.live.braking.braking_path import JointState, Placements
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.narrow_phase import renew_plane
from backhoe_planner.live.planes.plane_gaps import gaps_at
from backhoe_planner.live.servo.joint_stop import JointStop, stops_from
from backhoe_planner.live.servo.track import Track
from backhoe_planner.machine import Robot

Stop: TypeAlias = Track | JointStop
_Found = TypeVar("_Found")
_Looking: TypeAlias = Generator[None, None, _Found]  # yields after each look, and returns what it found

_ENOUGH = 0.01  # m of margin beyond which one stop is as good as another; chosen
_TOUCH = 2e-4  # m below its clearance at which a stop still keeps it; twice what a certificate accepts
# by how much the least margin of a stop must be larger to be preferred to another one: in m, and as a part of the depth
# to which that one touches something, as the new one may touch more than that; chosen
_BETTER, _BETTER_PART = 2e-3, 0.1
_BETWEEN = 0.03  # m that any point moves between two places of a stop; chosen, then little is missed between them
_MOST_PLACES = 48  # of a stop; chosen
_LEAST_WAY = 1e-12  # m, so that nothing is divided by 0
_LATER = (0.1, 0.2, 0.3, 0.45)  # parts of the time to rest along a track after which it may be left; chosen
_MOST_MEASURED = 120  # distances for one stop: enough for many obstacles, mostly 15 do; chosen
# work of a comparison for each second of its steps, of one stop, and of one place of a machine that slows down along
# its track, all in measured distances, which take some 0.1 ms; chosen so that a step of 10 ms takes about 5 ms more
_WORK_PER_SECOND, _WORK_OF_STOP, _WORK_OF_PLACE = 5_000.0, 10, 2
_FARTHER = 1.3  # times what a machine needs to come to rest along its track, by a rough estimate; chosen
_AGAIN = 0.1  # s after which that is estimated once more; chosen
_UNCOMPARED = 0.1  # s between two comparisons of stops while the surroundings change; chosen, a stop takes longer


class StopChoice:
    """Compares the stops of one machine when something turns up.

    Parameters
    ----------
    robot: the machine.
    check: of its braking paths.

    Attributes
    ----------
    work: done in this step.
    """

    def __init__(self, robot: Robot, check: PathCheck) -> None:
        self._separation, self._bounds, self._joints = check.separation, check.bounds, check.joints
        self._acceleration = (1.0 - 1e-9) * check.joints.limits.acceleration
        self._at = Placements(robot, _MOST_PLACES + 1)
        self.work = 0
        self._comparison: Comparison | None = None  # begun when the present stop was not proven
        self._compare_from = math.inf  # s: from then on stops are compared anew
        self._compared_at = -math.inf  # s: when a comparison began

    def compare(self, stop: Stop) -> Comparison:
        """The comparison of a machine's present `stop` with others, over the next steps."""
        return Comparison(self, stop)

    def best(self, stop: Stop, state: JointState, time: float) -> Stop:
        """The stop to go on with instead of `stop`, which is not proven, in this `state` at `time` [s]."""
        begun = self._comparison
        if time > self._compare_from or (begun is not None and time > begun.until):
            self._compare_from, self._compared_at = math.inf, time
            begun = self._comparison = self.compare(stop)
        if begun is None or begun.is_done:
            return stop
        begun.go_on(state, time)
        return begun.best

    def compare_again(self) -> None:
        """Compare stops once more, as something has turned up; not in every step in which an obstacle is moved."""
        self._compare_from = min(self._compare_from, self._compared_at + _UNCOMPARED)

    def forget(self) -> None:
        """Drop the comparison, because the present stop is proven."""
        self._comparison, self._compare_from = None, math.inf

    def stops_from(self, v: Vector) -> dict[int, JointStop]:
        """The stops off the track from a velocity v (n,), by their keys."""
        return stops_from(v, self._acceleration, self._joints.dt)

    def look(self, looks: Iterator[None]) -> bool:
        """Look at a few stops, with a little work in each iteration of `looks`; whether there are more."""
        planes, self.work = [each.copy() for each in self._separation.plane_columns], 0
        most = _WORK_PER_SECOND * self._joints.dt
        try:
            return any(self.work >= most for _ in looks)
        finally:  # the planes that were measured where the machine is are of more use to the next steps
            for each, kept in zip(self._separation.plane_columns, planes, strict=True):
                each[...] = kept

    def least_margin(self, q: Vector, places: Matrix, times: Vector, *, worst: float) -> float:
        """The least margin from q (n,) on at `places` (K, n) and `times` (K,) [m, s], no more than `_ENOUGH`.

        Once it is known to be `worst` or less, the rest is not looked at. It is minus infinity if the joints do not
        stay within their limits. If no more may be measured, it is `worst`; or, without one, the least margin found,
        and so small that only a stop which keeps its clearances has more room.
        """
        if not self._joints.are_kept_at(places[-1]):
            return -math.inf
        most = self.work + _MOST_MEASURED
        self.work += _WORK_OF_STOP
        separation, at = self._separation, self._at
        places, times = self._spread(places, times)
        at.place_each(places)
        way = separation.travel.dot(np.abs(places - q).max(axis=0)).take(separation.classes)
        way += float(times[-1]) * np.linalg.norm(separation.velocity, axis=1)
        some = self._bounds.lower() - way < separation.clearance + _ENOUGH
        least = _ENOUGH
        pairs = some.nonzero()[0]
        clearance, moved = separation.clearance[pairs, None], separation.drift[pairs, None] * times
        # (K, S) bounds, better and better
        margins = gaps_at(separation, pairs, at, len(places)).least + moved - clearance
        while len(pairs) and least > worst:
            pair, place = np.unravel_index(int(margins.argmin()), margins.shape)
            if margins[pair, place] >= least:
                return least
            if self.work >= most:
                return min(least, -_TOUCH - _BETTER) if worst == -math.inf else worst
            self.work += 1
            asked = pairs[pair : pair + 1]
            distance = renew_plane(separation, int(asked[0]), at, int(place))
            anew = gaps_at(separation, asked, at, len(places)).least[0]
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


class Comparison:
    """One comparison of stops.

    Parameters
    ----------
    choice: measures what is compared.
    stop: the present stop.

    Attributes
    ----------
    best: the stop to go on with, the present one unless that touches something and another is known to leave more room.
    until: when stops are to be compared anew, because one that is taken then leaves more room [s]; otherwise infinite.
    is_done: whether all stops were looked at.
    """

    def __init__(self, choice: StopChoice, stop: Stop) -> None:
        self.best, self.until, self.is_done = stop, math.inf, False
        self._choice, self._margin = choice, math.inf
        self._looks = self._compare()

    def go_on(self, state: JointState, time: float) -> None:
        """Look at a few more stops of a machine whose `state` at `time` [s] this is."""
        self._state, self._now = state, time
        self.is_done = not self._choice.look(self._looks)

    def _compare(self) -> Iterator[None]:
        """Look at one stop in each iteration: along the track, then off it from here, then off it later."""
        present, begun = self.best, self._now
        if isinstance(present, Track):
            if (yield from self._touches_nothing(present)):
                return
            begun = self._now
            places, times = yield from self._places_along(present)
        else:
            places, times = present.way_to_rest(self._state.q, self._state.v)
        # how near it comes at first does not count: the machine has come that far meanwhile
        here = min(int(times.searchsorted(self._now - begun)), len(times) - 1)
        self._margin = self._choice.least_margin(
            self._state.q, places[here:], times[here:] - times[here], worst=-math.inf
        )
        if self._margin >= -_TOUCH:
            return
        yield
        least_bad = yield from self._least_bad_from_here()
        if isinstance(present, Track) and self._margin < _ENOUGH and (yield from self._is_left(places, times, begun)):
            return
        if least_bad is not None:
            self.best = self._from_here().get(least_bad, self.best)

    def _touches_nothing(self, track: Track) -> _Looking[bool]:
        """Whether the stop along the track touches nothing, or one off it from here does, which is the best then."""
        q, v, _ = self._state
        measure = self._choice.least_margin
        self._margin = measure(q, *track.ahead(_FARTHER * track.time_to_rest(q, v)), worst=-_TOUCH)
        if self._margin > -_TOUCH:  # mostly: what turned up is nowhere near
            self.until = self._now + _AGAIN
            return True
        yield
        for key in self._order(track):  # one that touches nothing is worth more the sooner it is known
            other = self._from_here().get(key)
            if other is None:
                continue
            if measure(self._state.q, *other.way_to_rest(self._state.q, self._state.v), worst=-_TOUCH) > -_TOUCH:
                self.best = other
                return True
            yield
        return False

    def _places_along(self, track: Track) -> _Looking[tuple[Matrix, Vector]]:
        """(K, n) where the machine is while it stops along the track, and (K,) when [s]: as much work as many stops."""
        q, v, _ = self._state
        ahead, along = track.looking_ahead(), [q]
        for place in ahead.places_to_rest(q, v):
            along.append(place)
            self._choice.work += _WORK_OF_PLACE
            yield
        return np.array(along), ahead.dt * np.arange(len(along), dtype=float)

    def _least_bad_from_here(self) -> _Looking[int | None]:
        """The key of the stop from here that leaves most room; None if none leaves more than the present one."""
        least_bad = None
        for key in list(self._from_here()):
            other = self._from_here().get(key)
            if other is None:
                continue
            if self._is_better(*other.way_to_rest(self._state.q, self._state.v)):
                least_bad = key
            yield
        return least_bad

    def _is_left(self, places: Matrix, times: Vector, begun: float) -> _Looking[bool]:
        """Whether a stop that leaves the track later leaves more room; then stops are compared anew at that time.

        Parameters
        ----------
        places, times: (K, n), (K,) along the track, from the time `begun` on [s].
        """
        found = False
        for part in _LATER:
            row = math.ceil(part * (len(times) - 1))
            if row >= len(times) - 1:
                break
            rates = (places[row] - places[row - 1]) / (times[row] - times[row - 1])
            for other in self._choice.stops_from(rates).values():
                gone = int(times.searchsorted(self._now - begun))
                if gone >= row:  # the machine is already farther
                    break
                after, when = other.way_to_rest(places[row], rates)
                when = np.append(times[gone:row], times[row] + when) - times[gone]
                if self._is_better(np.vstack((places[gone:row], after)), when):
                    self.until, found = begun + float(times[row]), True
                if self._margin >= _ENOUGH:
                    return found
                yield
        return found

    def _order(self, track: Track) -> list[int]:
        """Keys of the stops from here, first those that keep what is kept along the track, or break it the least."""
        stops = self._from_here()
        if track.keep is None:
            return list(stops)
        ways = [stop.way_to_rest(self._state.q, self._state.v)[0] for stop in stops.values()]
        self._choice.work += _WORK_OF_STOP
        margins = track.keep.rows_each(np.concatenate(ways))[0].min(axis=1)
        lost = [max(-float(part.min()), 0.0) for part in np.split(margins, len(ways))]
        return [key for _, key in sorted(zip(lost, stops, strict=True))]

    def _from_here(self) -> dict[int, JointStop]:
        """The stops off the track by their keys, from where the machine is when they are asked for."""
        return self._choice.stops_from(self._state.v)

    def _is_better(self, places: Matrix, times: Vector) -> bool:
        """Whether a stop at `places` (K, n) and `times` (K,) leaves more room than the best so far; notes how much."""
        beyond_limits = self._margin == -math.inf  # then any stop within them is better
        to_beat = self._margin if beyond_limits else self._margin + max(_BETTER, -_BETTER_PART * self._margin)
        margin = self._choice.least_margin(self._state.q, places, times, worst=to_beat)
        if margin <= to_beat:
            return False
        self._margin = margin
        return True
