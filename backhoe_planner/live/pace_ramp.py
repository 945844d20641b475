"""The pace that a machine can have by now, if the pace that is asked for changes faster than the machine can."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.live.detours.reference import Clocked

_STILL = 1e-9  # rad/s or m/s: a joint whose reference is slower does not narrow the pace; rounding


class PaceRamp:
    """Follows the pace that is asked for, within the accelerations of the joints.

    A step at the pace p from the velocity v keeps them if

        |p r - v| <= a dt   for every joint

    with the rates r of the reference over the step at full pace. So its own accelerations count too.

    Parameters
    ----------
    acceleration: (n,) the greatest accelerations [rad/s^2 or m/s^2].
    dt: length of a step [s].

    Attributes
    ----------
    pace: of the step that was taken last, 0 to 1; may be set.
    """

    def __init__(self, acceleration: Vector, dt: float) -> None:
        self._change, self._dt = acceleration * dt, dt
        self.pace = 1.0  # the reference begins at rest, where any pace can be had at once

    def towards(self, asked: float, reference: Clocked) -> float:
        """The pace nearest to the one that is `asked` for which a machine on the reference can have in the next step.

        If there is none, as for a reference that needs more than the accelerations itself, the pace stays.
        """
        if asked != self.pace:
            clock = reference.clock
            v = (reference.q - reference.at(max(clock - self.pace * self._dt, 0.0))) / self._dt
            least, most = _paces_between(v - self._change, v + self._change, reference.rates(self._dt))
            if least <= most:
                self.pace = min(max(asked, min(least, 1.0)), max(most, 0.0))
        return self.pace


def _paces_between(low: Vector, high: Vector, rates: Vector) -> tuple[float, float]:
    """The least and the greatest pace at which `rates` (n,) are between `low` and `high` (n,)."""
    moving = np.abs(rates) > _STILL
    ends = np.array((low[moving], high[moving])) / rates[moving]
    return float(ends.min(axis=0).max(initial=0.0)), float(ends.max(axis=0).min(initial=1.0))
