"""Whether the joints go to another posture while the tip stands on its path.

The tip stands as long as it gets on along the path by less than a tenth of the tolerance. A turn that
the path itself asks for is progress along it, so it is none of these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector

_STANDS = 0.1  # part of the path's tolerance by which the tip gets on while it stands; chosen
_LEAST = 0.1  # rad or m of a joint; chosen: planned paths move a joint by a tenth of it within such a part


@dataclass(frozen=True)
class SpotTurn:
    """A posture left for another while the tip stands.

    Attributes
    ----------
    joint: the index of the one that moves furthest.
    size: largest position minus least [rad or m].
    station: where on the path the tip stands, by its measure [m].
    time: when it begins [s].
    """

    joint: int
    size: float
    station: float
    time: float


def largest_spot_turn(time: Vector, q: Matrix, station: Vector, on: Flags, *, tolerance: float) -> SpotTurn | None:
    """The largest turn on the spot; None where no joint moves by 0.1 rad or m while the tip stands.

    A motion that comes to the path from elsewhere may turn at its beginning: that is part of the approach.

    Parameters
    ----------
    time: (T,) of the samples [s]; q: (T, n) joints there [rad or m].
    station: (T,) how far along the path the tip is [m].
    on: (T,) whether it is on the path there.
    tolerance: of the path [m].
    """
    stands = _STANDS * tolerance
    rows = np.flatnonzero(on)
    if not len(rows):
        return None
    if rows[0] > 0:
        rows = rows[_gets_on(station[rows], stands) - 1 :]
    found: SpotTurn | None = None
    for begin in rows.tolist():
        end = begin + _gets_on(station[begin:], stands)
        left = np.flatnonzero(~on[begin:end])
        end = begin + int(left[0]) if len(left) else end
        moved = np.ptp(q[begin:end], axis=0)
        joint = int(np.argmax(moved))
        if moved[joint] > (_LEAST if found is None else found.size):
            found = SpotTurn(joint, float(moved[joint]), float(station[begin]), float(time[begin]))
    return found


def _gets_on(station: Vector, stands: float) -> int:
    """How many of the samples, from the first on, the tip is within `stands` [m] of where it is at the first.

    Also where it goes back along the path, or comes to it from a place that is nearest to a later one.
    """
    look = 64  # samples; more where the tip stands for longer
    while not (away := np.abs(station[:look] - station[0]) > stands).any():
        if look >= len(station):
            return len(station)
        look *= 2
    return int(np.argmax(away))
