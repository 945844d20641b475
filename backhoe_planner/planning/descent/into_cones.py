"""Curves that are moved back into the cones that have to be kept, by Newton's method.

A step of a descent stays in a cone to first order. The tip's axis moves on arcs, so that a step of usual length leaves
a narrow cone nevertheless. A further step of least length brings the curve back, as its end is brought back onto the
goal. The curves within a cone are a manifold, and this is a retraction onto it (Absil et al. 2008).
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Cone
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kept_margins import KeptMargins

PLACES_OF_CONES = 6  # of each piece; chosen, as many as those at which margins are usually computed
_STEPS = 10  # of Newton's method at most; chosen: from a step of a descent, 1 or 2 are enough, from a long line 8
# damping, rad^2; chosen among 1e-6 to 3e-2: there are more places than control points, and with less damping the steps
# become as long as the gradients of neighbouring places differ little
_DAMPED = 1e-2
_LONGEST = 0.5  # rad or m of a joint in one step; chosen: beyond it the gradients say little
_FURTHER = 2.0  # times the spare, for which a place that misses it aims; chosen, so that its neighbours have it too


class IntoCones:
    """Moves curves and configurations into the cones that have to be kept.

    Parameters
    ----------
    kept: what has to be kept, with its spares; at least one condition is a cone.
    """

    def __init__(self, kept: KeptMargins) -> None:
        self._cones = [
            (one, float(spare))
            for one, spare in zip(kept.keep.conditions, kept.spares, strict=True)
            if isinstance(one, Cone)
        ]

    def moved(self, curve: JointCurve, limits: JointLimits) -> JointCurve:
        """The curve with its control points between the ends moved, as far as Newton's method gets it."""
        places = PLACES_OF_CONES * curve.pieces + 1
        weights, u = curve.weights(places)[1:-1, 1:-1], np.linspace(0.0, 1.0, places)[1:-1]
        alike = weights @ weights.T
        for _ in range(_STEPS):
            missing, G, row = self.missing(curve.at(u))
            if not len(missing):
                break
            alike_rows = alike[np.ix_(row, row)] * (G @ G.T)
            force = np.linalg.solve(alike_rows + _DAMPED * np.eye(len(row)), missing)
            step = weights[row].T @ (force[:, None] * G)
            step *= min(1.0, _LONGEST / max(float(np.max(np.abs(step))), _LONGEST))
            control = curve.control.copy()
            control[1:-1] = np.clip(control[1:-1] + step, limits.lower, limits.upper)
            curve = curve.moved_to(control)
        return curve

    def missing(self, q: Matrix) -> tuple[Vector, Matrix, Indices]:
        """(M,) what is missing where `q` (N, n) misses a spare [rad], (M, n) gradients, and (M,) rows of `q`."""
        missing, gradients, rows = [], [], []
        for cone, spare in self._cones:
            margins, gradient = cone.rows(q)
            out = np.flatnonzero(margins[:, 0] < spare)
            missing.append(_FURTHER * spare - margins[out, 0])
            gradients.append(gradient[out, 0])
            rows.append(out)
        return np.concatenate(missing), np.concatenate(gradients), np.concatenate(rows)
