"""A resolved stretch of a bucket path made into motions, with stops at its sharp corners."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import SAMPLE_PERIOD, Drive, TipPath, Trajectory, time_along
from backhoe_planner.planning.paths.corners import SHARP

__all__ = ["time_stretch"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def time_stretch(
    path: TipPath,
    stations: Vector,
    q: Matrix,
    limits: JointLimits,
    *,
    speed: float | None,
    period: float = SAMPLE_PERIOD,
    drive: Drive | None = None,
    stops: Vector | None = None,
) -> list[Trajectory]:
    """The motions, each from rest to rest, along joints `q` (K, n) at `stations` (K,) [m].

    Parameters
    ----------
    speed: of the tip at most [m/s], None for as fast as the joints allow.
    period: between the samples of the motions [s].
    drive: what moves the joints, None for no limits but those of the joints.
    stops: (C,) arc lengths to stop at [m]; by default all sharp corners of the path.
    """
    marks = {0, len(stations) - 1}
    for corner in (path.corners(SHARP) if stops is None else stops).tolist():
        if stations[0] < corner < stations[-1]:
            marks.add(int(np.argmin(np.abs(stations - corner))))
    return [
        time_along(stations[first : last + 1], q[first : last + 1], limits, speed=speed, period=period, drive=drive)
        for first, last in pairwise(sorted(marks))
    ]
