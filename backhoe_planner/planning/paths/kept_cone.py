"""The cone of orientations that must be kept along a path whose waypoints leave the orientation open.

A cone is no exact orientation, so it cannot be written into the waypoints of an arm that has not enough joints
for any orientation at a position. It narrows the targets of the path instead: the tip is at the position and
within the cone. Everything that looks for configurations on the path uses these targets.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.law import Kind, Rows
from backhoe_planner.machine import BatchKinematics, TargetBatch, TipTarget, solve_batch
from backhoe_planner.motion import Keep, Problem, RotationCone, TipPath, targets_along

SPARE = 1e-3  # rad kept inside the cone; chosen, ten times what rounded corners and curves were seen to use
_LEAST_PART = 0.9  # part of a narrow cone that is not used up by `SPARE`; chosen
_STEPS = 16  # of the angle between the cone and the nearest configuration that is found beside it; chosen


class KeptCone:
    """What keeps the tip within a cone of orientations along a path that leaves its orientation open.

    Parameters
    ----------
    keep: all conditions to be kept; a cone is among them.
    cone: that cone.

    Attributes
    ----------
    tolerance: how far the tip may be turned from the middle of the cone, less a spare [rad].
    """

    def __init__(self, keep: Keep, cone: RotationCone) -> None:
        self._keep, self._cone = keep, cone
        allowed = max(cone.tolerance - cone.room, 0.0)
        self.tolerance = max(allowed - SPARE, _LEAST_PART * allowed)

    def narrowed(self, targets: TargetBatch, tolerance: float | Vector | None = None) -> TargetBatch:
        """The targets, those without an orientation within the cone; a required pitch is required still.

        Parameters
        ----------
        tolerance: how far the tip may be turned from the middle of the cone instead, also (B,) for each target [rad].
        """
        open_ = ~targets.has_rotation
        asked = self.tolerance if tolerance is None else tolerance
        return replace(
            targets,
            rotation=np.where(open_[:, None, None], self._cone.rotation, targets.rotation),
            has_rotation=np.ones(len(targets), dtype=bool),
            rotation_tolerance=np.where(open_, asked, targets.rotation_tolerance),
        )

    def target(self, target: TipTarget) -> TipTarget:
        """A target without an orientation within the cone; of a target with a pitch only its position is required."""
        return TipTarget(target.position, None, self._cone.rotation, self.tolerance)

    def holds_each(self, q: Matrix) -> Flags:
        """(N,) whether all that is to be kept holds at each of `q` (N, n)."""
        return self._keep.holds_each(q)

    def motion_holds(self, q: Matrix) -> bool:
        """Whether all that is to be kept is proven to hold on straight motions through `q` (T, n)."""
        return bool(self.holds_each(q).all()) and self._keep.motion_holds(q)

    def row(self, q: Vector) -> Rows:
        """The row that keeps a step from the joints `q` (n,) within the cone, to first order."""
        margin, gradient = self._cone.rows(q)
        spare = self._cone.tolerance - self._cone.room - self.tolerance
        return Rows("rotation", -gradient, margin - spare, Kind.HARD)

    def broken_at(self, kinematics: BatchKinematics, targets: TargetBatch, q: Matrix) -> str:
        """What does not hold at the configuration that comes nearest to the cone, in words.

        Parameters
        ----------
        targets: one, without the cone.
        q: (N, n) configurations on it [rad or m], at least one, none within the cone.
        """
        angles = self._cone.values(q)
        nearest = int(np.argmin(angles))
        tried = np.linspace(self.tolerance, angles[nearest], _STEPS)
        batch = self.narrowed(targets.take(np.zeros(len(tried), dtype=int)), tried)
        found, reached = solve_batch(kinematics, batch, np.tile(q[nearest], (len(tried), 1)))
        best = found[int(np.argmax(reached))] if reached.any() else q[nearest]
        return self._keep.broken(best) or self._spared(best)

    def _spared(self, q: Vector) -> str:
        """How far the tip is turned at the joints `q` (n,) that are within the cone, and what of that is spared."""
        spare = np.degrees(max(self._cone.tolerance - self._cone.room, 0.0) - self.tolerance)
        turned = self._cone.describe(float(self._cone.values(q[None])[0]))
        return f"{turned}, of which the last {spare:.2g} deg are spared for the curve between postures"


def open_cone(problem: Problem, path: TipPath) -> KeptCone | None:
    """The cone to be kept along a path of a problem; None if there is none, or every waypoint gives its orientation."""
    keep = problem.keep
    if keep is None or all(waypoint.rotation is not None for waypoint in path.waypoints):
        return None
    cone = next((one for one in keep.conditions if isinstance(one, RotationCone)), None)
    return None if cone is None else KeptCone(keep, cone)


def cone_kept_by(q: Matrix, problem: Problem, path: TipPath) -> KeptCone | None:
    """The same; None also if any of the configurations `q` (N, n) is not within it, as of a way that breaks it."""
    cone = open_cone(problem, path)
    return cone if cone is not None and cone.holds_each(q).all() else None


def kept_targets(problem: Problem, path: TipPath, stations: Vector) -> TargetBatch:
    """The targets of the tip at `stations` (K,) [m] of a path, within the cone that is to be kept."""
    targets, cone = targets_along(path, stations), open_cone(problem, path)
    return targets if cone is None else cone.narrowed(targets)
