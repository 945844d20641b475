"""Lower bounds of the distance from a solid, on a grid around it: one look-up for any number of points.

A cell of the grid counts as taken where the solid may touch it. The centres of two cells are
d apart, so that a point of the one and a point of the other are at least d - sqrt(3) steps
apart; d to the nearest cell that is taken comes from a distance transform. So the bound falls
short of the true distance by at most twice that.

Where a solid changes in a few places, the grid is renewed around these alone: what went leaves
all bounds true, what came is no nearer than the box around it, and near both the transform is
made anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector

_ROUNDING = 1e-5  # steps by which a solid may reach into a cell that does not count as taken
_CELLS = 2_000_000  # of one grid; chosen: 8 MB, and some 0.4 s to fill


_RENEWED = 8  # cells around a change in which the transform is made anew; chosen: some 0.6 m around a machine
_SHORT = np.float32(np.sqrt(3.0) + 10.0 * _ROUNDING)  # steps by which two centres are further apart than two points


class Change(NamedTuple):
    """Where a solid became another: in the box from `low` to `high` (3,) [m]; whether any of it came, or all went."""

    low: Vector
    high: Vector
    came: bool


class GridFrame:
    """Where the cells of a grid are: between two corners, all alike.

    Attributes
    ----------
    low: (3,) its lowest corner [m].
    step: edge of a cell [m].
    counts: cells along each axis.
    """

    def __init__(self, low: Vector, high: Vector, *, least_step: float) -> None:
        """Of the box from `low` to `high` (3,) [m]; cells are at least `least_step` wide [m]."""
        size = np.maximum(high - low, least_step)
        self.low = np.asarray(low, dtype=float)
        self.step = max(least_step, float(np.prod(size) / _CELLS) ** (1.0 / 3.0), float(size.max()) / _CELLS)
        self.counts = np.ceil(size / self.step).astype(int) + 1

    @property
    def high(self) -> Vector:
        """(3,) its highest corner [m]."""
        return np.asarray(self.low + self.step * self.counts)

    def taken_by_boxes(self, low: Matrix, high: Matrix) -> Flags:
        """(counts) which cells the boxes from `low` to `high` (n, 3) [m] touch."""
        taken = np.zeros(self.counts, dtype=bool)
        first = np.floor((low - self.low) / self.step + _ROUNDING).astype(np.int64)
        last = np.maximum(np.ceil((high - self.low) / self.step - _ROUNDING).astype(np.int64) - 1, first)
        inside = ((last >= 0) & (first < self.counts)).all(axis=1)
        first = np.maximum(first[inside], 0)
        extent = np.minimum(last[inside], self.counts - 1) - first + 1
        # boxes that span equally many cells are entered at once
        spans, group = np.unique(extent, axis=0, return_inverse=True)
        group = group.reshape(-1)
        for number, span in enumerate(spans.tolist()):
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
    bounds: (2, 3) box around the whole solid [m]; some of it may lie outside of the grid.
    """

    def __init__(self, frame: GridFrame, taken: Flags, bounds: Matrix) -> None:
        from scipy.ndimage import distance_transform_edt

        if taken.any():
            found = distance_transform_edt(~taken).astype(np.float32)
        else:
            found = np.full(frame.counts, np.inf, dtype=np.float32)
        self._hold(frame, bounds, _bounds_of(found, frame, bounds, np.zeros(3, dtype=int)))

    def _hold(self, frame: GridFrame, bounds: Matrix, values: NDArray[np.float32]) -> None:
        self.frame, self._bounds = frame, bounds
        counts = frame.counts
        self._values: NDArray[np.float32] = values.reshape(-1)
        self._strides = np.array([counts[1] * counts[2], counts[2], 1], dtype=np.int64)
        self._last, self._per_step = counts - 1e-9, 1.0 / frame.step

    def renewed(self, taken: Flags, changes: Iterable[Change]) -> DistanceGrid:
        """The grid of the solid after some changes; its bounds are true, and those far from a change may be lower.

        Parameters
        ----------
        taken: (frame.counts) which cells the solid may touch now.
        changes: wherever it is another than the one of this grid; the box around all of it is still the same.
        """
        from scipy.ndimage import distance_transform_edt

        frame, values = self.frame, self._values.reshape(self.frame.counts).copy()
        boxes = [
            (
                np.floor((change.low - frame.low) / frame.step - _ROUNDING).astype(int),
                np.floor((change.high - frame.low) / frame.step + _ROUNDING).astype(int),
                change.came,
            )
            for change in changes
        ]
        for first, last, came in boxes:
            if came:
                aside = [
                    np.maximum(np.maximum(first[k] - np.arange(count), np.arange(count) - last[k]), 0)
                    for k, count in enumerate(frame.counts)
                ]
                squared = np.add.outer(np.add.outer(aside[0] ** 2, aside[1] ** 2), aside[2] ** 2)
                away = (np.sqrt(squared.astype(np.float32)) - _SHORT) * np.float32(frame.step)
                np.minimum(values, np.maximum(away, np.float32(0.0)), out=values)
        for first, last, _ in boxes:
            outer, start = _window(first - 2 * _RENEWED, last + 2 * _RENEWED, frame)
            inner, own = _window(first - _RENEWED, last + _RENEWED, frame)
            if taken[inner].size == 0:
                continue
            near = np.full(taken[outer].shape, _RENEWED, dtype=np.float32)
            if taken[outer].any():
                # what is further away may be nearer to a cell beyond the window
                np.minimum(near, distance_transform_edt(~taken[outer]), out=near)
            near = near[
                tuple(slice(a - b, a - b + size) for a, b, size in zip(own, start, taken[inner].shape, strict=True))
            ]
            values[inner] = np.maximum(values[inner], _bounds_of(near, frame, self._bounds, own))
        found = DistanceGrid.__new__(DistanceGrid)
        found._hold(frame, self._bounds, values)
        return found

    def lower(self, points: Array) -> Array:
        """(...) lower bound of the distance from points (..., 3) [m]; 0 where nothing is known."""
        at = (points - self.frame.low) * self._per_step
        there = np.minimum(np.maximum(at, 0.0), self._last)
        i = there.astype(np.int32)
        found = self._values.take(i[..., 0] * self._strides[0] + i[..., 1] * self._strides[1] + i[..., 2]).astype(float)
        outside = (there != at).any(axis=-1)
        if outside.any():
            own = points[outside]
            away = np.maximum(np.maximum(self._bounds[0] - own, own - self._bounds[1]), 0.0)
            found[outside] = np.sqrt((away * away).sum(axis=-1))
        return np.asarray(found)


def _window(first: Indices, last: Indices, frame: GridFrame) -> tuple[tuple[slice, ...], Indices]:
    """The cells from `first` to `last` (3,), both included, as far as they are on the grid, and the first of them."""
    start = np.clip(first, 0, frame.counts)
    end = np.clip(last + 1, start, frame.counts)
    return tuple(slice(int(a), int(b)) for a, b in zip(start, end, strict=True)), start


def _bounds_of(steps: NDArray[np.float32], frame: GridFrame, bounds: Matrix, first: Indices) -> NDArray[np.float32]:
    """Lower bounds [m] in a window of cells, from the steps between centres, in place; `first` (3,) of its cells."""
    found, step = steps, frame.step
    found -= _SHORT
    found *= np.float32(step)
    # what lies outside of the grid is no nearer than the side of it that it lies beyond
    for axis in range(3):
        cells = first[axis] + np.arange(found.shape[axis], dtype=np.float32)
        shape = [-1 if k == axis else 1 for k in range(3)]
        if bounds[0, axis] < frame.low[axis]:
            np.minimum(found, (step * cells).reshape(shape), out=found)
        if bounds[1, axis] > frame.high[axis]:
            np.minimum(found, (step * (frame.counts[axis] - 1 - cells)).reshape(shape), out=found)
    np.maximum(found, np.float32(0.0), out=found)
    return found
