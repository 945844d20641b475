"""A detour that is followed, and the way back to the plan if its obstacle has gone.

The way back is searched while the machine drives on along the detour. It begins at a place of the detour that is far
enough ahead for the answer to come before the machine must slow down for it. If it comes later, or leads nowhere sooner
than the detour does, the machine has lost nothing: it is still on its detour at full pace.
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
class WayBack:
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


class Detour:
    """A detour that is followed.

    Parameters
    ----------
    found: the detour.
    limits: of the machine.
    revision: of the surroundings for which it is known to be clear.

    Attributes
    ----------
    reference: the detour's motion.
    rejoins_at: where it ends on the plan [s].
    checked: the revision of the surroundings for which it is known to be clear, or is being checked.
    check_at: from when on it may be checked again [s].
    back: the way back that is searched, or found; None if there is none.
    """

    def __init__(self, found: Rejoining, limits: JointLimits, revision: int) -> None:
        self.reference, self.rejoins_at = Reference(found.motion, limits), found.rejoins_at
        self.checked, self.check_at = revision, 0.0
        self.back: WayBack | None = None
        self._around, self._limits, self._lead = found.around, limits, _LEAD
        self._best_at = -1  # revision of the surroundings for which no way back leads to the end sooner

    @property
    def followed(self) -> Clocked:
        """What the machine is to follow: the detour to its end, or to where a way back begins."""
        return self.reference if self.back is None or self.back.found is None else self.back.approach

    @property
    def reason(self) -> str:
        """What it is for, in words."""
        return "back to the plan" if self._around is None else f"round {self._around}"

    def look_back(self, plan: Clocked, revision: int) -> WayBack | None:
        """The way back that is to be searched now; None if none can save anything.

        It leaves out no more of the plan than the detour does.

        Parameters
        ----------
        plan: its clock is where the detour left it.
        revision: of the surroundings.
        """
        if revision == self._best_at:
            return None
        self._best_at = revision
        ahead = copy(self.reference)
        ahead.advance(self._lead)
        place = first_rest(ahead, self._limits, 1.0)
        if not 0.0 < place < self.reference.end:
            return None
        approach = Approach(self.reference, self._limits, place)
        times = np.append(np.arange(plan.clock, self.rejoins_at, _EVERY), self.rejoins_at)
        ways = _least_durations(np.array([plan.at(time) for time in times.tolist()]) - approach.last_q, self._limits)
        best = int((ways - times).argmin())
        if self._saves(approach, float(ways[best]), float(times[best])):
            self.back = WayBack(approach, float(times[best]), revision)
        return self.back

    def take(self, answer: object) -> None:
        """Keep the way back if the answer leads to the end of the plan sooner than the detour; else give it up."""
        back = self.back
        if (
            back is not None
            and isinstance(answer, Rejoining)
            and answer.rejoins_at <= self.rejoins_at
            and self._saves(back.approach, answer.motion.duration, answer.rejoins_at)
        ):
            back.found = answer
        else:
            self.back = None

    def go_on(self) -> None:
        """Give up the way back, and look for another one later, further ahead."""
        self.back = None
        self._lead *= 2.0
        self._best_at = -1

    def _saves(self, approach: Approach, duration: float, rejoins_at: float) -> bool:
        """Whether a way of a `duration` [s] from the approach's end leads to the end of the plan sooner."""
        along_detour = self.reference.end - self.reference.clock - self.rejoins_at
        return along_detour - (approach.end - approach.clock + duration - rejoins_at) >= _GAIN


def _least_durations(off: Matrix, limits: JointLimits) -> Vector:
    """(K,) the least time from rest to rest [s] over the distances `off` (K, n) [rad or m]."""
    far, v, a = np.abs(off), limits.velocity, limits.acceleration
    return np.asarray(np.where(far * a > v**2, far / v + v / a, 2.0 * np.sqrt(far / a)).max(axis=1))
