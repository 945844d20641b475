"""How far the tip is off a path between two samples.

Between two samples the joints move evenly, and the tip leaves the chord between its two
positions by at most a sagitta, which is made of the farthest that any point can be from
each joint. On one leg of the path no point of the chord is further from it than the worse
of its ends. Where that says too little, the error is measured between: with K equal parts
the sagitta of each is K^2 times smaller.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion.path import TipPath

_MOST_PARTS = 64  # of one segment; chosen: sagittas are then 4096 times smaller
_MOST = 100_000  # measurements for one motion; chosen, some seconds
_SAME = 1e-9  # m: rounding of an arc length


def chord_errors(
    path: TipPath, robot: Robot, *, q: Matrix, station: Vector, error: Vector, sagitta: Vector, tolerance: float
) -> Vector:
    """(T - 1,) the most that the tip is off `path` on each segment of a motion [m].

    Parameters
    ----------
    q: (T, n) the samples [rad or m]; station: (T,) arc lengths of the path there [m].
    error: (T,) how far the tip is off the path there [m].
    sagitta: (T - 1,) how far it can be off its chord [m].
    tolerance: where the bound is above this, and the errors are not, it is made sharper [m].
    """
    ends = np.maximum(error[:-1], error[1:])
    found = ends + sagitta
    low, high = station[:-1], station[1:]
    marks = np.unique(path.stations)
    inside = np.searchsorted(marks, high - _SAME) > np.searchsorted(marks, low + _SAME, side="right")
    unsure = np.flatnonzero((found > tolerance) & (ends <= tolerance) & (high >= low) & ~inside)
    kinematics, parts, looks = BatchKinematics(robot), 2, 0
    while len(unsure) and parts <= _MOST_PARTS and looks < _MOST:
        part = np.arange(1, parts) / parts
        between = (1.0 - part)[None, :, None] * q[unsure][:, None] + part[None, :, None] * q[unsure + 1][:, None]
        tips = kinematics.at(between.reshape(-1, q.shape[1])).tip_position.reshape(len(unsure), parts - 1, 3)
        worst = ends[unsure].copy()
        for row, segment in enumerate(unsure.tolist()):
            a, b = float(low[segment]), float(high[segment])
            worst[row] = max(worst[row], *(path.nearest(tip, low=a, high=b)[1] for tip in tips[row]))
        looks += tips.shape[0] * tips.shape[1]
        found[unsure] = np.minimum(found[unsure], worst + sagitta[unsure] / parts**2)
        unsure = unsure[(found[unsure] > tolerance) & (worst <= tolerance)]
        parts *= 2
    return found
