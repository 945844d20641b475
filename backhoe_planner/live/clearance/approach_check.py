"""Whether obstacles that move may reach a machine on a stretch of its track.

The machine is somewhere on the stretch for some time, and each obstacle moves on at its velocity. The planes of the
pairs move with the obstacles, so that one which flies away, or past, never comes nearer to them. Only where they leave
it open is anything measured.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.live.braking.braking_path import Placements
from backhoe_planner.live.braking.joint_bounds import BRAKING, JointBounds
from backhoe_planner.live.clearance.pair_bounds import PairBounds
from backhoe_planner.live.planes.narrow_phase import renew_plane
from backhoe_planner.live.planes.plane_gaps import gaps_at
from backhoe_planner.live.planes.separation import Separation
from backhoe_planner.machine import Robot

SEEN_COMING = 1.5  # s before a moving obstacle could arrive from which on it acts, also from farther away; chosen
_RESTS = 1.5  # times what braking straight ahead takes; measured along 55 plans, mostly 1, and 2.3 at most
_PLACES = 8  # of a stretch; chosen, what is between them is bounded
_MOST_MEASURED = 10  # distances for one answer, some 20 us each; chosen, mostly none is measured


class PlacesAhead(Protocol):
    """A motion with a clock, such as a `Track`, which says more of the method."""

    def places_within(self, time: float, count: int) -> Matrix:
        """(count, n) places for a `time` [s] from the clock on."""


class ApproachCheck:
    """The check for one machine.

    Parameters
    ----------
    robot: the machine.
    separation, bounds, joints: its pairs, their bounds, and the bounds of the joint velocities.

    Attributes
    ----------
    pair: the one that may come too close, by the last answer; -1 if none may.
    """

    def __init__(self, robot: Robot, separation: Separation, bounds: PairBounds, joints: JointBounds) -> None:
        self._separation, self._bounds, self._joints = separation, bounds, joints
        self._at = Placements(robot, _PLACES)
        self.forget()

    def forget(self) -> None:
        """Forget the last answer, since there are other pairs, or others of them move."""
        self._known: tuple[int, PlacesAhead | None] = -1, None
        self.pair = -1

    def reaches(self, track: PlacesAhead, v: Vector, step: int) -> bool:
        """Whether what moves may reach a machine at v (n,) that comes to rest along a track before it gives way.

        step: number of the step; in each step the answer is found once.
        """
        if self._known != (step, track):
            rest = _RESTS * self._joints.braking_time(v)
            self._known = step, track
            # a joint that turns round between two places goes at most this far beyond both
            turn = self._joints.acceleration / BRAKING * (rest / (_PLACES - 1)) ** 2 / 8.0
            self.pair = self._pair_that_comes(track.places_within(rest, _PLACES), turn, rest + SEEN_COMING)
        return self.pair >= 0

    def _pair_that_comes(self, places: Matrix, turn: Vector, time: float) -> int:
        """A pair of something that moves and of a machine somewhere between `places` (S, n); -1 if there is none.

        It may come too close within a `time` [s], or it would take too many measurements to know. There are at most
        `_PLACES` places. Between two of them each joint is at most `turn` (n,) [rad or m] off the straight line.
        """
        separation = self._separation
        for one in separation.counting_clusters:
            if one.speed > 0.0:  # its boxes are only known near the machine
                return int(one.pairs[0])
        pairs = (~self._bounds.stands).nonzero()[0]
        before = [each[pairs] for each in separation.plane_columns]
        try:
            return self._look_along(pairs, places, turn, time) if len(pairs) else -1
        finally:  # the planes that were measured where the machine is are of more use to the next steps
            for each, kept in zip(separation.plane_columns, before, strict=True):
                each[pairs] = kept

    def _look_along(self, pairs: Indices, places: Matrix, turn: Vector, time: float) -> int:
        """As `_pair_that_comes`, among `pairs` (K,); changes their planes."""
        separation, at, count, pair = self._separation, self._at, len(places), -1
        at.place_each(places)
        off = 0.5 * np.abs(np.diff(places, axis=0)) + turn
        between = separation.travel.dot(off.T).max(axis=1, initial=0.0)
        needed = separation.clearance.take(pairs) + between.take(separation.classes.take(pairs))
        margins = gaps_at(separation, pairs, at, count).least - needed[:, None]
        margins += time * np.minimum(separation.drift.take(pairs), 0.0)[:, None]
        for _ in range(_MOST_MEASURED):
            row, place = np.unravel_index(int(margins.argmin()), margins.shape)
            if margins[row, place] >= 0.0:
                return -1
            pair = int(pairs[row])
            distance = renew_plane(separation, pair, at, int(place))
            comes = time * min(float(separation.drift[pair]), 0.0) - float(needed[row])
            if distance + comes < 0.0:
                return pair
            anew = gaps_at(separation, pairs[row : row + 1], at, count).least[0]
            margins[row] = np.maximum(margins[row], anew + comes)
            margins[row, place] = distance + comes
        return pair
