"""Rounds the corners of a route as far as that is proven clear."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import SmoothWay, chord_sagitta
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.sampling import JointPath

_HALVINGS = 7  # chosen: a cut that is less than a hundredth of the longest possible saves little time
_SHARED = 0.5  # part of a leg that each of two corners may use: an even half
_ALONE = 0.95  # part of a leg that its only corner may use: nearly all, so that a piece of the leg is left


def blend(check: MotionCheck, way: JointPath) -> SmoothWay:
    """Round every corner of `way` as far as that is proven clear; the motion stops at corners that cannot be rounded.

    Parameters
    ----------
    check: the check that `way` was found with.
    """
    q = way.q
    steps = np.linalg.norm(np.diff(q, axis=0) / check.rate, axis=1)
    keep = np.concatenate(([True], steps > 0.0))
    q, steps = np.array(q[keep]), steps[steps > 0.0]
    stations = np.concatenate(([0.0], np.cumsum(steps)))
    cuts = np.zeros(len(q))
    for corner in range(1, len(q) - 1):
        cuts[corner] = _cut(check, q, steps, corner)
    return SmoothWay(q, stations, cuts)


def _cut(check: MotionCheck, q: Matrix, steps: Vector, corner: int) -> float:
    """How far before and after a corner to cut [s]: the longest possible, or halved until clear; 0 if never clear."""
    into = (q[corner] - q[corner - 1]) / steps[corner - 1]
    out = (q[corner + 1] - q[corner]) / steps[corner]
    d = min(
        steps[corner - 1] * (_ALONE if corner == 1 else _SHARED),
        steps[corner] * (_ALONE if corner == len(q) - 2 else _SHARED),
    )
    sagitta = chord_sagitta(check.problem.limits)
    for _ in range(_HALVINGS):
        if check.corner_is_clear(q[corner] - d * into, q[corner], q[corner] + d * out, sagitta=sagitta):
            return float(d)
        d *= 0.5
    return 0.0
