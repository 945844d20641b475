"""How far the tip is off a path between two samples.

Between two samples the joints move evenly, and the tip leaves the chord between its two
positions by at most a sagitta, which follows from the farthest that any point can be from
each joint. On one leg of the path no point of the chord is further from the leg than the worse
of its ends. Beside a corner, the part of the chord on either side is no further from its leg than
the worse of its end and its distance from the corner. If that bound is too large, the error is
measured in between: with K equal parts the sagitta of each is K^2 times smaller, and both ends of a
part beside a corner are compared with the leg for which the further end is nearest.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion.path import TipPath

_MOST_PARTS = 64  # of one segment; chosen: sagittas are then 4096 times smaller
_MOST = 100_000  # measurements for one motion; chosen, some seconds
_SAME = 1e-9  # m: rounding of an arc length


def chord_errors(
    path: TipPath, robot: Robot, *, q: Matrix, station: Vector, error: Vector, sagitta: Vector, tips: Matrix,
    tolerance: float,
) -> Vector:  # fmt: skip
    """(T - 1,) the most that the tip is off `path` on each segment of a motion [m].

    Parameters
    ----------
    q: (T, n) the samples [rad or m]; station: (T,) arc lengths of the path there [m].
    error: (T,) how far the tip is off the path there [m].
    sagitta: (T - 1,) how far the tip can be off its chord [m].
    tips: (T, 3) position of the tip at the samples [m].
    tolerance: if the bound is above this but the errors are not, the bound is made tighter [m].
    """
    ends = np.maximum(error[:-1], error[1:])
    found = np.maximum(ends, _off_corners(path, station, tips)) + sagitta
    low, high = station[:-1], station[1:]
    marks = np.unique(path.stations)
    unsure = np.flatnonzero((found > tolerance) & (ends <= tolerance) & (high >= low))
    kinematics, parts, looks = BatchKinematics(robot), 2, 0
    while len(unsure) and parts <= _MOST_PARTS and looks < _MOST:
        part = np.arange(1, parts) / parts
        between = (1.0 - part)[None, :, None] * q[unsure][:, None] + part[None, :, None] * q[unsure + 1][:, None]
        places = kinematics.at(between.reshape(-1, q.shape[1])).tip_position.reshape(len(unsure), parts - 1, 3)
        worst, measured = np.zeros((2, len(unsure)))
        for row, segment in enumerate(unsure.tolist()):
            a, b = float(low[segment]), float(high[segment])
            corners = marks[(marks > a + _SAME) & (marks < b - _SAME)].tolist()
            along = np.vstack((tips[segment], places[row], tips[segment + 1]))
            worst[row], measured[row] = _off_legs(path, along, [a, *corners, b])
        looks += places.shape[0] * places.shape[1]
        found[unsure] = np.minimum(found[unsure], np.maximum(ends[unsure], worst) + sagitta[unsure] / parts**2)
        unsure = unsure[(found[unsure] > tolerance) & (measured <= tolerance)]
        parts *= 2
    return found


def _off_legs(path: TipPath, tips: Matrix, marks: Sequence[float]) -> tuple[float, float]:
    """The most that straight lines from tip to tip (K, 3) are off `path` [m], and the most that these tips are.

    Parameters
    ----------
    marks: the arc lengths where the path's legs begin and end there [m].
    """
    off = np.array([[path.nearest(tip, low=a, high=b)[1] for tip in tips] for a, b in pairwise(marks)])
    # the distance from one leg is convex along a straight line
    ways = np.min(np.maximum(off[:, :-1], off[:, 1:]), axis=0)
    return float(np.max(ways)), float(np.max(np.min(off, axis=0)))


def _off_corners(path: TipPath, station: Vector, tips: Matrix) -> Vector:
    """(T - 1,) how far from the path's corners the chord between samples passes [m]; 0 if there is no corner."""
    found = np.zeros(len(station) - 1)
    for mark, corner in zip(path.stations[1:-1], path.points[1:-1], strict=True):
        for row in np.flatnonzero((station[:-1] < mark) & (station[1:] > mark)):
            step = tips[row + 1] - tips[row]
            square = float(step @ step)
            part = float(np.clip((corner - tips[row]) @ step / square, 0.0, 1.0)) if square > 0.0 else 0.0
            found[row] = max(found[row], float(np.linalg.norm(tips[row] + part * step - corner)))
    return found
