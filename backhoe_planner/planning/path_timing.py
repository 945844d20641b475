"""A resolved stretch of a bucket path made into motions, with stops at its sharp corners."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine.robot import JointLimits
from backhoe_planner.planning.blending import PERIOD
from backhoe_planner.planning.bucket_path import BucketPath
from backhoe_planner.planning.timing import time_along
from backhoe_planner.planning.trajectory import Trajectory

__all__ = ["time_stretch"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_CORNER = np.radians(5.0)  # a sharper corner of the path is stopped at


def time_stretch(
    path: BucketPath, stations: Vector, q: Matrix, limits: JointLimits, *, speed: float | None, period: float = PERIOD
) -> list[Trajectory]:
    """The motions, each from rest to rest, along joints `q` (K, n) at `stations` (K,) [m].

    Parameters
    ----------
    speed: of the tip at most [m/s], None for as fast as the joints allow.
    period: between the samples of the motions [s].
    """
    marks = {0, len(stations) - 1}
    for corner in path.corners(_CORNER).tolist():
        if stations[0] < corner < stations[-1]:
            marks.add(int(np.argmin(np.abs(stations - corner))))
    return [
        time_along(stations[first : last + 1], q[first : last + 1], limits, speed=speed, period=period)
        for first, last in pairwise(sorted(marks))
    ]
