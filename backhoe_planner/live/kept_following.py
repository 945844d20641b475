"""The conditions to be kept along a plan while something pushes the machine off it or holds it back.

The servo keeps the machine clear, but knows nothing of a full bucket. So the follower watches how much of every
condition the machine loses by being beside its plan. If that is more than the plan leaves, the plan's clock waits
until the machine is back, and so it does if the machine slides off the plan and would lose a condition before it could
stop. The servo takes only velocities from which the machine stops within the conditions (`KeptRows.ahead`). Only an
approaching obstacle can then still break one: the machine gives way to a person rather than keep its bucket level. It
does so where the conditions leave no other way to evade, and then returns into what they allow.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.law import Rows
from backhoe_planner.live.braking.joint_bounds import BRAKING
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.detours.reference import Clocked
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Keep

_BRAKED = 2.0  # times the time in which sliding alone can be stopped, for which it counts; chosen
_SLIDES = 0.1  # s for which sliding counts at least; chosen
_AHEAD = 0.3  # s of the plan ahead of its clock of which the margins count; chosen, a deviation is made up for sooner
_LEAST = 2e-4  # rad or m that may be lost beside the plan: far below what a plan leaves, above what following it takes
_PLACES = 4  # of the plan ahead, at which its margins count; chosen
_NEAR = (
    0.2  # rad or m: a condition with less margin counts when the machine gives way; chosen, it moves as far meanwhile
)
_PART = 0.5  # part of the accelerations for braking on the way back; chosen, as on the return to the plan
_STILL = 1e-9  # squared rad/s or m/s below which the plan has no direction


class KeptFollowing:
    """Decides whether the machine has to slow down or to stop to keep the conditions of its task.

    Parameters
    ----------
    keep: the conditions; None if there are none.
    limits: of the joints.

    Attributes
    ----------
    keep: as above.
    returns: whether the machine, in the last step, was on its way back into what is allowed.
    """

    def __init__(self, keep: Keep | None, limits: JointLimits) -> None:
        self.keep, self._limits = keep, limits
        self._lost = self._broken = ""
        self.returns = False

    def lost(self, *, evades: bool) -> str:
        """The condition that is not kept, or would not have been, in words; empty if there is none.

        evades: whether the machine evades something that moves, at the cost of the condition.
        """
        if evades and self._broken:
            return f"{self._broken}, as nothing else evades what moves"
        return (
            f"{self._broken}; the machine returns by the shortest way" if self.returns else self._broken or self._lost
        )

    def held(self, q: Vector, v: Vector, dt: float) -> Vector:
        """(n,) the velocity to be commanded when the machine has to stop, or has to come back from outside.

        See `held_velocity` and `velocity_back`.
        """
        self.returns = False
        if self.keep is None:
            return np.zeros_like(v)
        self._broken = self.keep.broken(q)
        if not self._broken:
            return held_velocity(self.keep, self._limits, q, v, dt)
        back = velocity_back(self.keep, self._limits, q, dt)
        self.returns = back is not None
        return held_velocity(self.keep, self._limits, q, v, dt) if back is None else back

    def rows(self, q: Vector, v: Vector, dt: float, *, gives_way: bool, firm: bool) -> KeptRows | None:
        """The conditions at `q` (n,) for the servo's next step of `dt` [s]; None if there are none.

        v: (n,) the machine's rates.

        gives_way: whether the machine gives way now. Then a cone has a row for each of several directions, which takes
            ten times as long; otherwise the direction in which its edge is nearest is enough.
        firm: see `KeptRows`.
        """
        if self.keep is None:
            return None
        # the braking path of the next step is at most so much longer than if the machine braked now
        look = dt + 0.5 * (float(np.max(np.abs(v) / (BRAKING * self._limits.acceleration))) + dt / BRAKING)
        places = np.array((q, q + look * v))
        margins, gradients = (self.keep.facets_each(places) if gives_way else self.keep.rows_each(places))[:2]
        left, G = margins[0], gradients[0]
        weights = np.clip(1.0 - left / _NEAR, 0.0, 1.0)
        near = weights > 0.0
        # at the end of the path: margin + look g (v' - v) >= 0
        ahead = Rows("keep", -gradients[1], margins[1] / look - gradients[1] @ v)
        return KeptRows(G, left, weights[near, None] * G[near], ahead, firm)

    def pace(self, q: Vector, v: Vector, reference: Clocked, rates: Vector) -> float | None:
        """The part of its speed at which the plan may go on, 0 to 1; None if the machine at `q` (n,) is outside.

        Parameters
        ----------
        v: (n,) the machine's rates.
        reference: the plan, on which every condition is kept.
        rates: (n,) the plan's rates at its clock.
        """
        self.returns, self._broken = False, ""
        if self.keep is None:
            return 1.0
        (here,), (gradients,) = self.keep.rows_each(q[None])
        if (here < np.minimum(self.keep.margins(reference.q), 0.0) - _LEAST).any():
            return None
        across = _across(v, rates)
        # all joints brake in proportion: sliding ends only when the joint that takes longest stands still
        straight = 0.5 * float(np.max(np.abs(v) / (BRAKING * self._limits.acceleration)))
        stopping = max(_BRAKED * float(np.max(np.abs(across) / self._limits.acceleration)), _SLIDES)
        # being ahead on the plan or behind loses nothing, as long as the plan goes that far: only what is beside it
        ahead = min(max(_time_along(q - reference.q, rates), -_AHEAD), _AHEAD)
        abreast = reference.at(max(reference.clock + ahead, 0.0))
        beside, sliding = gradients @ (q - abreast), gradients @ across
        leaving = (sliding < 0.0) & (beside + straight * sliding < -_LEAST)
        if not ((beside < -_LEAST) | (beside + stopping * sliding < -_LEAST) | leaving).any():
            self._lost = ""
            return 1.0
        places = np.linspace(reference.clock, reference.clock + _AHEAD, _PLACES)
        left = np.min([self.keep.margins(reference.at(place)) for place in places.tolist()], axis=0).clip(0.0)
        # where the machine would stand still, in a straight line; outside already, it must not lose more
        outside = leaving & (self.keep.margins(q + straight * v) < np.where(here < 0.0, here, -_LEAST))
        if (outside | (sliding < 0.0) & (left + beside + stopping * sliding < -_LEAST)).any():
            self._lost = "the plan waits, because sliding on would violate `keep`"
            return 0.0
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


def velocity_back(keep: Keep, limits: JointLimits, q: Vector, dt: float) -> Vector | None:
    """(n,) the velocity by which a machine at q (n,) that breaks a condition returns by the shortest way of the joints.

    All joints arrive at once, and can brake in time. None if no place nearby keeps the conditions.
    """
    found = keep.project(q, limits.lower, limits.upper)
    if found is None:
        return None
    off = found - q
    size = np.abs(off)
    moving = size > 0.0
    fastest = np.minimum(np.sqrt(2.0 * _PART * limits.acceleration * size), limits.velocity)[moving] / size[moving]
    return np.asarray(min(float(fastest.min(initial=np.inf)), 1.0 / dt) * off)


def _time_along(vector: Vector, rates: Vector) -> float:
    """In what time [s] the plan goes as far along its rates (n,) as `vector` (n,) does; 0 if it stands still."""
    squared = float(rates @ rates)
    return float(vector @ rates) / squared if squared > _STILL else 0.0


def _across(vector: Vector, rates: Vector) -> Vector:
    """(n,) the part of `vector` (n,) that is across the plan's rates (n,)."""
    return vector - _time_along(vector, rates) * rates
