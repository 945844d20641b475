"""Whether the joints go to another posture while the tip stands still on its path.

The tip stands still as long as it advances along the path by less than a tenth of the tolerance. A turn that
the path itself requires is progress along it and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector

_STANDS = 0.1  # part of the path's tolerance that the tip may advance while it counts as standing still; chosen
_LEAST = 0.1  # rad or m of a joint; chosen: planned paths move a joint by a tenth of it within such a part


@dataclass(frozen=True)
class SpotTurn:
    """A change from one posture to another while the tip stands still.

    Attributes
    ----------
    joint: the index of the joint that moves furthest.
    size: largest position minus least [rad or m].
    station: where on the path the tip is, by its measure [m].
    time: when it begins [s].
    """

    joint: int
    size: float
    station: float
    time: float


def largest_spot_turn(time: Vector, q: Matrix, station: Vector, on: Flags, *, tolerance: float) -> SpotTurn | None:
    """The largest turn on the spot; None if no joint moves by 0.1 rad or m while the tip stands still.

    A motion that comes to the path from elsewhere may turn at the path's beginning: that is part of the approach.

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
    """How many samples, from the first on, have the tip within `stands` [m] of its place at the first.

    Going back along the path, or coming to it from a place that is nearest to a later one, counts likewise.
    """
    look = 64  # samples; more if the tip stands still for longer
    while not (away := np.abs(station[:look] - station[0]) > stands).any():
        if look >= len(station):
            return len(station)
        look *= 2
    return int(np.argmax(away))
