"""The condition of a search that the machine can hold its load all along a motion.

Where a joint cannot hold the load at rest, no timing keeps its limit for long. A search for the least time or cost
leaves such limits out of its descents. If its motion breaks them, another search has this condition beside those of
`keep`. The certificate is about the torques themselves.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine import Robot
from backhoe_planner.motion import DRIVE_TOLERANCE, Condition, Drive, Problem, drive_of

_BENT = 2.0  # part of a limit per rad^2 or m^2 by which the use bends between two configurations; chosen
_STEEPEST = 2.0  # part of a limit per rad or m by which the use changes at most; chosen


class HeldLoad(Condition):
    """No joint needs more than its torque to hold the load at rest; values are parts of that torque.

    Its bounds between configurations are estimates.

    Parameters
    ----------
    drive: of the machine, with limits and load.
    most: the greatest part that may be used.
    """

    name, unit, room = "load", "of the torque", 0.0

    def __init__(self, drive: Drive, most: float) -> None:
        self._drive, self._most = drive, most

    @classmethod
    def of(cls, problem: Problem) -> HeldLoad:
        """The condition of a problem; half of what a certificate tolerates is left for what is between the samples."""
        return cls(drive_of(problem), 1.0 + 0.5 * DRIVE_TOLERANCE)

    def values(self, q: Matrix) -> Vector:
        """(B,) the greatest part of its torque that a joint needs."""
        return np.asarray(np.max(self._drive.static_use(q), axis=1))

    def margins(self, values: Vector) -> Vector:
        """(B,) parts of the torque that are left."""
        return np.asarray(self._most - values)

    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) estimated."""
        bend = _BENT * np.sum(np.abs(delta), axis=1) ** 2 / 8.0
        return np.asarray(np.minimum(self.margins(before), self.margins(after)) - bend)

    def lever(self, travel: Vector) -> Vector:
        """(n,) estimated [1/rad or 1/m]."""
        return np.full(len(travel), _STEEPEST)

    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """One margin, that of the joint that needs most."""
        margins, gradients = self.facets(q)
        at = np.arange(len(q)), np.argmin(margins, axis=1)
        return margins[at][:, None], gradients[at][:, None]

    def facets(self, q: Matrix) -> tuple[Matrix, Array]:
        """One margin for each joint."""
        n, still = q.shape[1], np.zeros_like(q)
        slopes = self._drive.ratio_slopes(q, still, still)[:, :n, :n]
        return self._most - self._drive.static_use(q), -slopes

    def widened(self, robot: Robot, by: float) -> HeldLoad:
        """The same with more of the torque allowed."""
        return HeldLoad(self._drive, self._most + by)

    @property
    def allowed(self) -> str:
        """``at most 100 % of the torque``"""
        return f"at most {100.0 * self._most:.3g} % of the torque"

    def describe(self, value: float, when: str = "") -> str:
        """``the load takes 104 % of the torque at 2.40 s, allowed at most 100 % of the torque``"""
        return f"the load takes {100.0 * value:.3g} % of the torque{when}, allowed {self.allowed}"
