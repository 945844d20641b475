"""The way back from a detour whose obstacle has gone: it is searched while the machine drives on along the detour.

It begins at a place of the detour that is far enough ahead for the answer to come before the machine must slow down for
it. If it comes later, or leads nowhere sooner than the detour does, the machine has lost nothing: it is still on its
detour at full pace.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.live.detours.reference import Clocked, Reference
from backhoe_planner.live.detours.rejoining import Rejoining
from backhoe_planner.live.detours.stop_ahead import Approach, first_rest
from backhoe_planner.machine import JointLimits

_LEAD = 0.3  # s for the first search; each one whose answer comes too late doubles it for the next; chosen
_GAIN = 0.2  # s that a way back must save; chosen, below what a person notices
_EVERY = 0.02  # s between places of the plan that are compared; chosen, as the samples of a plan are apart


@dataclass
class ReturnAhead:
    """A way from a place ahead on a detour to the plan.

    Attributes
    ----------
    approach: the detour up to where the way begins, at rest there.
    since: the place on the plan from which on the way may rejoin it [s].
    revision: of the surroundings for which it is searched.
    found: the way, once it is found and leads to the end sooner than the detour.
    """

    approach: Approach
    since: float
    revision: int
    found: Rejoining | None = None

    @property
    def is_late(self) -> bool:
        """Whether the machine would have to slow down now, without a way."""
        return self.found is None and self.approach.clock >= self.approach.slows_at


class ReturnChoice:
    """Chooses where a way back to the plan begins, and whether it leads to the end of the plan sooner.

    Parameters
    ----------
    detour: that the machine follows.
    limits: of the machine.
    rejoins_at: where the detour ends on the plan [s].
    """

    def __init__(self, detour: Reference, limits: JointLimits, rejoins_at: float) -> None:
        self._detour, self._limits, self._rejoins_at = detour, limits, rejoins_at
        self._lead = _LEAD

    def begin(self, plan: Clocked, revision: int) -> ReturnAhead | None:
        """The way back that is to be searched now; None if none can save anything.

        It leaves out no more of the plan than the detour does.

        Parameters
        ----------
        plan: its clock is where the detour left it.
        revision: of the surroundings.
        """
        ahead = copy(self._detour)
        ahead.advance(self._lead)
        place = first_rest(ahead, self._limits, 1.0)
        if not 0.0 < place < self._detour.end:
            return None
        approach = Approach(self._detour, self._limits, place)
        times = np.append(np.arange(plan.clock, self._rejoins_at, _EVERY), self._rejoins_at)
        ways = _least_durations(np.array([plan.at(time) for time in times.tolist()]) - approach.last_q, self._limits)
        best = int((ways - times).argmin())
        if self._saved(approach, float(ways[best]), float(times[best])) < _GAIN:
            return None
        return ReturnAhead(approach, float(times[best]), revision)

    def take(self, way: ReturnAhead, answer: Rejoining) -> None:
        """Keep an answer if it leads to the end of the plan sooner than the detour, and leaves out no more of it."""
        sooner = self._saved(way.approach, answer.motion.duration, answer.rejoins_at)
        if answer.rejoins_at <= self._rejoins_at and sooner >= _GAIN:
            way.found = answer

    def search_longer(self) -> None:
        """Note that an answer came too late."""
        self._lead *= 2.0

    def _saved(self, approach: Approach, duration: float, rejoins_at: float) -> float:
        """How much sooner [s] the end of the plan is reached by a way of a `duration` [s] from the approach's end."""
        along_detour = self._detour.end - self._detour.clock - self._rejoins_at
        return along_detour - (approach.end - approach.clock + duration - rejoins_at)


def _least_durations(off: Matrix, limits: JointLimits) -> Vector:
    """(K,) the least time from rest to rest [s] over the distances `off` (K, n) [rad or m]."""
    far, v, a = np.abs(off), limits.velocity, limits.acceleration
    return np.asarray(np.where(far * a > v**2, far / v + v / a, 2.0 * np.sqrt(far / a)).max(axis=1))
