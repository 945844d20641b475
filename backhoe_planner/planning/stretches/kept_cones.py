"""The cones of orientations that must be kept along a path whose waypoints leave the orientation open.

A cone is no exact orientation, so it cannot be written into the waypoints of an arm that has not enough joints
for any orientation at a position. It narrows the targets of the path instead: the tip is at the position and
within the cone. Everything that looks for configurations on the path uses these targets.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.law import Kind, Rows
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import Cone, Keep, Problem, TipPath, targets_along

SPARE = 1e-3  # rad kept inside a cone; chosen, ten times what rounded corners and curves were seen to use
_LEAST_PART = 0.9  # part of a narrow cone that is not used up by `SPARE`; chosen
_STEPS = 16  # of the angle between a cone and the nearest configuration that is found beside it; chosen


class KeptCones:
    """What keeps the tip within cones of orientations along a path that leaves its orientation open.

    Parameters
    ----------
    keep: all conditions to be kept; at least one of them is a cone.

    Attributes
    ----------
    tolerances: (C,) how far the tip may be from the middle of each cone, less a spare [rad].
    """

    def __init__(self, keep: Keep) -> None:
        self._keep = keep
        allowed = np.array([cone.usable for cone in keep.cones])
        self.tolerances = np.maximum(allowed - SPARE, _LEAST_PART * allowed)

    def narrowed(self, targets: TargetBatch) -> TargetBatch:
        """The targets, those without an orientation within the cones; a required pitch is required still."""
        return self._narrowed(targets, self.tolerances.tolist())

    def target(self, target: TipTarget) -> TipTarget:
        """A target without an orientation within the cones; of a target with a pitch only its position is required."""
        found = TipTarget(target.position)
        for cone, tolerance in zip(self._keep.cones, self.tolerances.tolist(), strict=True):
            found = cone.narrowed(found, tolerance) or found
        return found

    def holds_each(self, q: Matrix) -> Flags:
        """(N,) whether all that is to be kept holds at each of `q` (N, n)."""
        return self._keep.holds_each(q)

    def motion_holds(self, q: Matrix) -> bool:
        """Whether all that is to be kept is proven to hold on straight motions through `q` (T, n)."""
        return bool(self.holds_each(q).all()) and self._keep.motion_holds(q)

    def rows(self, q: Vector) -> tuple[Rows, ...]:
        """The rows that keep a step from the joints `q` (n,) within the cones, to first order."""
        found = []
        for cone, tolerance in zip(self._keep.cones, self.tolerances.tolist(), strict=True):
            (margin,), (gradient,) = cone.rows(q[None])
            found.append(Rows(cone.name, -gradient, margin - (cone.tolerance - cone.room - tolerance), Kind.HARD))
        return tuple(found)

    def broken_at(self, kinematics: BatchKinematics, targets: TargetBatch, q: Matrix) -> str:
        """What does not hold at the configuration that comes nearest to the cones, in words.

        Parameters
        ----------
        targets: one, without the cones.
        q: (N, n) configurations on it [rad or m], at least one, none within all cones.
        """
        angles = np.array([cone.values(q) for cone in self._keep.cones])
        nearest = int(np.argmin(np.max(angles - self.tolerances[:, None], axis=0)))
        tried = np.linspace(self.tolerances, np.maximum(angles[:, nearest], self.tolerances), _STEPS)
        batch = self._narrowed(targets.take(np.zeros(len(tried), dtype=int)), list(tried.T))
        found, reached = solve_batch(kinematics, batch, np.tile(q[nearest], (len(tried), 1)))
        best = found[int(np.argmax(reached))] if reached.any() else q[nearest]
        return self._keep.broken(best) or self._spared(best)

    def _narrowed(self, targets: TargetBatch, tolerances: Sequence[float | Vector]) -> TargetBatch:
        for cone, tolerance in zip(self._keep.cones, tolerances, strict=True):
            targets = cone.narrowed_batch(targets, tolerance)
        return targets

    def _spared(self, q: Vector) -> str:
        """How far the tip is turned at the joints `q` (n,) that are within the cones, and what of that is spared."""
        values = [float(cone.values(q[None])[0]) for cone in self._keep.cones]
        worst = int(np.argmax(values - self.tolerances))
        cone: Cone = self._keep.cones[worst]
        spare = np.degrees(cone.usable - self.tolerances[worst])
        turned = cone.describe(values[worst])
        return f"{turned}, of which the last {spare:.2g} deg are spared for the curve between postures"


def open_cones(problem: Problem, path: TipPath) -> KeptCones | None:
    """The cones to be kept along a path of a problem; None if there are none, or all waypoints give an orientation."""
    keep = problem.keep
    if keep is None or not keep.cones or all(waypoint.rotation is not None for waypoint in path.waypoints):
        return None
    return KeptCones(keep)


def cones_kept_by(q: Matrix, problem: Problem, path: TipPath) -> KeptCones | None:
    """The same; None also if any of the configurations `q` (N, n) is not within them, as of a way that breaks them."""
    cones = open_cones(problem, path)
    return cones if cones is not None and cones.holds_each(q).all() else None


def kept_targets(problem: Problem, path: TipPath, stations: Vector) -> TargetBatch:
    """The targets of the tip at `stations` (K,) [m] of a path, within the cones that are to be kept."""
    targets, cones = targets_along(path, stations), open_cones(problem, path)
    return targets if cones is None else cones.narrowed(targets)
