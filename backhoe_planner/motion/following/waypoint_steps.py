"""How far the joints move from one waypoint of a path to the next.

Between two waypoints that are passed, the range of a joint counts: the largest position
minus the least. A detour that leaves out waypoints counts with all legs that it bridges.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion.path import TipPath

_SAME = 1e-9  # m: rounding of an arc length
_KEPT_WITHIN = 1e-6  # part of the allowed step: rounding


@dataclass(frozen=True)
class WaypointStep:
    """How far one joint moves from one waypoint to another.

    Attributes
    ----------
    joint: its index.
    before, after: indices of the waypoints.
    size: largest position minus least [rad or m].
    allowed: how far it may move [rad or m].
    """

    joint: int
    before: int
    after: int
    size: float
    allowed: float

    @property
    def ratio(self) -> float:
        """`size` over the allowed step."""
        return self.size / self.allowed

    @property
    def kept(self) -> bool:
        """Whether the step is no longer than allowed."""
        return self.ratio <= 1.0 + _KEPT_WITHIN


def longest_step(
    path: TipPath,
    stations: Vector,
    q: Matrix,
    allowed: Vector,
    *,
    gaps: Sequence[tuple[int, int]] = (),
    slack: float = 1e-6,
) -> WaypointStep | None:
    """The step from waypoint to waypoint that is the longest relative to the allowed one; None if none is passed.

    Parameters
    ----------
    stations: (K,) arc lengths of the samples [m], not decreasing outside `gaps`.
    q: (K, n) joints there [rad or m].
    allowed: (n,) how far a joint may move on one leg [rad or m], infinite if it is not limited.
    gaps: the samples before and behind each detour.
    slack: a waypoint this near to the first or the last sample counts as passed there [m].
    """
    found: WaypointStep | None = None
    for before, after, places in _legs(path, stations, q, gaps, slack):
        size, most = np.ptp(places, axis=0), (after - before) * allowed
        joint = int(np.argmax(size / most))
        step = WaypointStep(joint, before, after, float(size[joint]), float(most[joint]))
        if found is None or step.ratio > found.ratio:
            found = step
    return found


def _legs(
    path: TipPath, stations: Vector, q: Matrix, gaps: Sequence[tuple[int, int]], slack: float
) -> Iterator[tuple[int, int, Matrix]]:
    """From each waypoint that is passed to the next: their indices, and (M, n) the joints between."""
    inside = np.ones(len(stations), dtype=bool)
    for a, b in gaps:
        inside[a + 1 : b] = False
    rows = np.flatnonzero(inside)
    at = np.array(stations[rows])
    marks, indices = np.unique(path.stations, return_index=True)
    for end in (0, -1):
        near = float(marks[np.argmin(np.abs(marks - at[end]))])
        if abs(at[end] - near) <= slack:
            at[end] = near
    last: tuple[int, int, Matrix] | None = None  # waypoint, row at or before it, joints there
    for mark, index in zip(marks.tolist(), indices.tolist(), strict=True):
        first = int(np.searchsorted(at, mark - _SAME))
        if first == len(rows) or (first == 0 and at[0] > mark + _SAME):
            continue
        end = int(np.searchsorted(at, mark + _SAME, side="right")) - 1
        if end >= first:  # samples are on the waypoint
            begin, here = int(rows[end]), q[rows[first] : rows[end] + 1]
            leave = int(rows[first])
        elif rows[first] == rows[first - 1] + 1 and not any(a == rows[first - 1] for a, _ in gaps):
            part = (mark - at[first - 1]) / (at[first] - at[first - 1])
            begin = leave = int(rows[first - 1])
            here = ((1.0 - part) * q[begin] + part * q[begin + 1])[None, :]
            leave += 1
        else:
            continue  # a detour leaves it out
        if last is not None:
            yield last[0], index, np.vstack((last[2], q[last[1] + 1 : leave], here))
        last = (index, begin, here)
