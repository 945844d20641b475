"""Lower bounds of the distance from a solid, on a grid around it: one look-up for any number of points.

A cell of the grid counts as taken if the solid may touch it. If the centres of two cells are
d apart, a point of one and a point of the other are at least d - sqrt(3) steps
apart; d to the nearest taken cell comes from a distance transform. So the bound is less than
the true distance by at most 2 sqrt(3) steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.native import compiled

_ROUNDING = 1e-5  # steps by which a solid may reach into a cell that does not count as taken
_CELLS = 2_000_000  # of one grid; chosen: 8 MB, and some 0.4 s to fill


_SHORT = np.float32(np.sqrt(3.0) + 10.0 * _ROUNDING)  # steps by which two centres may be further apart than two points


class GridFrame:
    """The cells of a grid between two corners, all of the same size.

    Attributes
    ----------
    low: (3,) the grid's lowest corner [m].
    step: edge of a cell [m].
    counts: cells along each axis.
    """

    def __init__(self, low: Vector, high: Vector, *, least_step: float) -> None:
        """Divide the box from `low` to `high` (3,) [m] into cells that are at least `least_step` wide [m]."""
        size = np.maximum(high - low, least_step)
        self.low = np.asarray(low, dtype=float)
        self.step = max(least_step, float(np.prod(size) / _CELLS) ** (1.0 / 3.0), float(size.max()) / _CELLS)
        self.counts = np.ceil(size / self.step).astype(int) + 1

    @property
    def high(self) -> Vector:
        """(3,) the grid's highest corner [m]."""
        return np.asarray(self.low + self.step * self.counts)

    def taken_by_boxes(self, low: Matrix, high: Matrix) -> Flags:
        """(counts) which cells the boxes from `low` to `high` (n, 3) [m] touch."""
        taken = np.zeros(self.counts, dtype=bool)
        first = np.floor((low - self.low) / self.step + _ROUNDING).astype(np.int64)
        last = np.maximum(np.ceil((high - self.low) / self.step - _ROUNDING).astype(np.int64) - 1, first)
        inside = ((last >= 0) & (first < self.counts)).all(axis=1)
        first = np.maximum(first[inside], 0)
        extent = np.minimum(last[inside], self.counts - 1) - first + 1
        if not len(extent):
            return taken
        # boxes that span equally many cells are entered together; one number for each span is sorted far sooner
        most = extent.max(axis=0) + 1
        spans = (extent[:, 0] * most[1] + extent[:, 1]) * most[2] + extent[:, 2]
        _, one, group = np.unique(spans, return_index=True, return_inverse=True)
        for number, span in enumerate(extent[one].tolist()):
            own = first[group == number]
            if np.prod(span) > 1000 and len(own) < 1000:
                for x, y, z in own.tolist():
                    taken[x : x + span[0], y : y + span[1], z : z + span[2]] = True
                continue
            for x, y, z in np.ndindex(*span):
                taken[own[:, 0] + x, own[:, 1] + y, own[:, 2] + z] = True
        return taken


class DistanceGrid:
    """Lower bounds of the distance from a solid.

    Parameters
    ----------
    frame: of the grid.
    taken: (frame.counts) which cells the solid may touch.
    bounds: (2, 3) box around the whole solid [m]; parts of the solid may be outside of the grid.
    """

    def __init__(self, frame: GridFrame, taken: Flags, bounds: Matrix) -> None:
        from scipy.ndimage import distance_transform_edt

        if taken.any():
            found = distance_transform_edt(~taken).astype(np.float32)
        else:
            found = np.full(frame.counts, np.inf, dtype=np.float32)
        self.frame, self._bounds = frame, bounds
        self._values = _bounds_of(found, frame, bounds).reshape(-1)
        self._counts, self._per_step = frame.counts.astype(np.intp), 1.0 / frame.step

    def lower(self, points: Matrix) -> Vector:
        """(k,) lower bound of the distance from points (3, k) [m]; 0 where nothing is known."""
        return lower_on_grid(points, *self.arrays, self._bounds)

    @property
    def arrays(self) -> tuple[Vector, float, Indices, NDArray[np.float32]]:
        """The arguments of `lower_on_grid` about the grid, from `low` on."""
        return self.frame.low, self._per_step, self._counts, self._values


@compiled
def lower_on_grid(
    points: Matrix, low: Vector, per_step: float, counts: Indices, values: NDArray[np.float32], bounds: Matrix, /
) -> Vector:
    """(k,) the values of a grid at points (3, k); for points outside of it, the distance from `bounds` (2, 3) [m].

    Parameters
    ----------
    low, per_step, counts: (3,) the grid's lowest corner [m], cells per metre, and (3,) cells along each axis.
    values: of all cells, the last axis varying fastest [m].
    """
    at = points - low[:, None]
    at *= per_step
    there = np.minimum(np.maximum(at, 0.0), (counts - 1e-9)[:, None])
    x, y, z = there.astype(np.intp)
    found = values.take((x * counts[1] + y) * counts[2] + z).astype(float)
    outside = np.logical_or.reduce(at != there, axis=0).nonzero()[0]
    found[outside] = off_box(points.take(outside, axis=1), bounds)
    return np.asarray(found)


def off_box(points: Matrix, bounds: Matrix) -> Vector:
    """(k,) distance of points (3, k) from the box between the two corners `bounds` (2, 3) [m]."""
    away = np.maximum(bounds[0][:, None] - points, points - bounds[1][:, None])
    np.maximum(away, 0.0, out=away)
    away *= away
    return np.asarray(np.sqrt(np.add.reduce(away, axis=0)))


def _bounds_of(steps: NDArray[np.float32], frame: GridFrame, bounds: Matrix) -> NDArray[np.float32]:
    """Lower bounds [m] in all cells, from the distances between centres in steps; changes `steps` in place."""
    found, step = steps, frame.step
    found -= _SHORT
    found *= np.float32(step)
    # a part of the solid outside of the grid is no nearer than the side of the grid that it is beyond
    for axis in range(3):
        cells = np.arange(found.shape[axis], dtype=np.float32)
        shape = [-1 if k == axis else 1 for k in range(3)]
        if bounds[0, axis] < frame.low[axis]:
            np.minimum(found, (step * cells).reshape(shape), out=found)
        if bounds[1, axis] > frame.high[axis]:
            np.minimum(found, (step * (frame.counts[axis] - 1 - cells)).reshape(shape), out=found)
    np.maximum(found, np.float32(0.0), out=found)
    return found
