"""The conditions to be kept along a plan while something pushes the machine off it or holds it back.

The servo keeps the machine clear, but knows nothing of a full bucket. So the follower watches how much of every
condition the machine loses by being beside its plan. If that is more than the plan leaves, the plan's clock waits
until the machine is back. If the machine slides off the plan and a condition would be lost before it could stop, it
is held still instead, until a detour is found that keeps the condition. Only an approaching obstacle can then still
break it: the machine gives way to a person rather than keep its bucket level.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.live.braking.joint_bounds import BRAKING
from backhoe_planner.live.detours.reference import Clocked
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Keep

_HELD = 0.5  # s for which the machine is held; chosen: it needs some tenths of a second to stop
_BRAKED = 2.0  # times the time in which sliding alone can be stopped, for which it counts; chosen
_SLIDES = 0.1  # s for which sliding counts at least; chosen
_AHEAD = 0.3  # s of the plan ahead of its clock of which the margins count; chosen, a deviation is made up for sooner
_LEAST = 2e-4  # rad or m that may be lost beside the plan: far below what a plan leaves, above what following it takes
_PLACES = 4  # of the plan ahead, at which its margins count; chosen
_STILL = 1e-9  # squared rad/s or m/s below which the plan has no direction


class KeptFollowing:
    """Decides whether the machine has to slow down or to stop to keep the conditions of its task.

    Parameters
    ----------
    keep: the conditions; None if there are none.
    limits: of the joints.
    """

    def __init__(self, keep: Keep | None, limits: JointLimits) -> None:
        self._keep, self._limits = keep, limits
        self._until = -np.inf  # s: held until then
        self._lost = ""

    @property
    def lost(self) -> str:
        """The condition that is not kept, or would not have been, in words; empty if there is none."""
        return self._lost

    def held(self, q: Vector, v: Vector, dt: float) -> Vector:
        """(n,) the velocity to be commanded when the machine has to stop, see `held_velocity`."""
        return np.zeros_like(v) if self._keep is None else held_velocity(self._keep, self._limits, q, v, dt)

    def pace(self, q: Vector, v: Vector, reference: Clocked, rates: Vector, *, time: float) -> float | None:
        """The part of its speed at which the plan may go on, 0 to 1; None if the machine at `q` (n,) has to stop.

        Parameters
        ----------
        v: (n,) the machine's rates.
        reference: the plan, on which every condition is kept.
        rates: (n,) the plan's rates at its clock.
        time: now [s].
        """
        if self._keep is None:
            return 1.0
        gradients, across = self._keep.gradients(q), _across(v, rates)
        # all joints brake in proportion: sliding ends only when the joint that takes longest stands still
        straight = 0.5 * float(np.max(np.abs(v) / (BRAKING * self._limits.acceleration)))
        stopping = max(_BRAKED * float(np.max(np.abs(across) / self._limits.acceleration)), _SLIDES)
        # being ahead on the plan or behind loses nothing, as long as the plan goes that far: only what is beside it
        ahead = min(max(_time_along(q - reference.q, rates), -_AHEAD), _AHEAD)
        abreast = reference.at(max(reference.clock + ahead, 0.0))
        beside, sliding = gradients @ (q - abreast), gradients @ across
        leaving = (sliding < 0.0) & (beside + straight * sliding < -_LEAST)
        if not ((beside < -_LEAST) | (beside + stopping * sliding < -_LEAST) | leaving).any():
            if time >= self._until:
                self._lost = ""
            return None if time < self._until else 1.0
        places = np.linspace(reference.clock, reference.clock + _AHEAD, _PLACES)
        left = np.min([self._keep.margins(reference.at(place)) for place in places.tolist()], axis=0).clip(0.0)
        here = self._keep.margins(q)
        # where the machine would stand still, in a straight line; outside already, it must not lose more
        outside = leaving & (self._keep.margins(q + straight * v) < np.where(here < 0.0, here, -_LEAST))
        if (outside | (sliding < 0.0) & (left + beside + stopping * sliding < -_LEAST)).any():
            self._until = time + _HELD
            self._lost = self._keep.broken(q) or "the machine stopped, because sliding on would violate `keep`"
        if time < self._until:
            return None
        lost = beside < -_LEAST
        return float(np.min((left[lost] + _LEAST) / -beside[lost], initial=1.0))


def held_velocity(keep: Keep, limits: JointLimits, q: Vector, v: Vector, dt: float) -> Vector:
    """(n,) the velocity to be commanded to a machine at q, v (n,) that has to stop, for the next `dt` [s].

    All joints slow down in proportion. If a condition would be lost meanwhile, the joints that can change it the
    soonest counteract, as far as their accelerations allow: how fast a full bucket tips is stopped sooner by turning
    the bucket than by stopping the boom.
    """
    time = float(np.max(np.abs(v) / limits.acceleration))
    if time == 0.0:
        return v
    slower, gradients = max(1.0 - dt / time, 0.0) * v, keep.gradients(q)
    left = keep.margins(q) + 0.5 * time * (gradients @ v)  # at rest
    gradient, change = gradients[int(left.argmin())], limits.acceleration * dt
    rate = float(gradient @ slower)
    if rate >= 0.0 or left.min() >= 0.0:
        return slower
    by = gradient * limits.acceleration**2
    return np.asarray(np.clip(slower - rate / float(gradient @ by) * by, v - change, v + change))


def _time_along(vector: Vector, rates: Vector) -> float:
    """In what time [s] the plan goes as far along its rates (n,) as `vector` (n,) does; 0 if it stands still."""
    squared = float(rates @ rates)
    return float(vector @ rates) / squared if squared > _STILL else 0.0


def _across(vector: Vector, rates: Vector) -> Vector:
    """(n,) the part of `vector` (n,) that is across the plan's rates (n,)."""
    return vector - _time_along(vector, rates) * rates
