"""Whether a machine gets on along what it follows."""

from __future__ import annotations

import numpy as np

from backhoe_planner.live.detours.reference import Clocked

# The numbers are chosen; validation/placements.py drives machines with them.
ARRIVED = 1e-3  # rad or m from the end of the plan
_PUSHED = 0.2  # rad or m by which the machine is pushed away: more than it slides to and fro
_WINDOW = 0.4  # s of the plan that could have been made, in which there must be progress by `_PACE` or by `_APPROACH`
_PACE = 0.05  # part of the speed that the machine could have by which the clock goes on
_APPROACH = 0.1  # part of the slowest joint's greatest rate by which the machine comes nearer to the plan


class Progress:
    """Notices when neither the clock goes on nor the machine comes nearer to the plan than it was.

    Sliding to and fro before an obstacle is no progress.

    Parameters
    ----------
    slowest: greatest rate of the slowest joint [rad/s or m/s].

    Attributes
    ----------
    waited: how long there has been no progress [s of the plan that could have been made], counted in windows.
    """

    def __init__(self, slowest: float) -> None:
        self.waited = 0.0
        self._approach = _APPROACH * _WINDOW * slowest
        self._clock = self._nearest = np.inf
        self._looked = 0.0

    def made(self, reference: Clocked, deviation: float, could: float) -> bool:
        """Whether this step completes some progress.

        could: how far the clock could have gone on in this step, within the pace asked for and the accelerations [s].
        """
        clock = reference.clock
        if deviation > self._nearest + _PUSHED or self._clock == np.inf:
            self._clock, self._nearest = clock, deviation
        self._looked += could
        # near the end no more progress is required than what is left
        further = clock > self._clock + _PACE * _WINDOW or (reference.ended and self._clock < clock)
        approach = min(self._approach, 0.5 * self._nearest)
        if further or (deviation < self._nearest - approach and self._nearest > ARRIVED):
            self._clock, self._nearest, self._looked, self.waited = clock, deviation, 0.0, 0.0
            return True
        if self._looked > _WINDOW:
            self.waited += self._looked
            self._clock, self._looked = clock, 0.0
        return False
