"""The path of the bucket's edge: down from the ground, along under it, and up again, in the arm's plane.

The edge stays above a floor and at most a given depth below the ground, smoothed over 0.3 m. Within this it falls and
rises by no more than two angles as it moves inward, and concave corners are rounded. The lowest line with these
properties follows from running maxima, and from a ball that is rolled along above it (a closing by a disc).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Vector
from backhoe_planner.job.cuts.profile import Profile

_STEP = 0.01  # m of radius between the points of the line; chosen: a tenth of `_RADIUS`
_RADIUS = 0.1  # m, of concave corners; chosen: it leaves 1.3 cm at 5 cm from a wall
_SMOOTH = 0.3  # m over which the ground that is followed is averaged: the cutting plate is longer than shorter waves
_SPACING = 0.03  # m between the places of the edge's path; chosen


@dataclass(frozen=True, eq=False)
class Descent:
    """The steepness of the edge's path.

    Attributes
    ----------
    entry, leave: the greatest angles at which it goes down and up as it moves inward [rad].
    """

    entry: float
    leave: float


class Underground:
    """The floor and the ground under one blade, on a regular grid from `end` to `start`, and beyond.

    Parameters
    ----------
    profile: profile of the ground.
    floor: (F,) radii and (F,) heights of the floor [m]; it continues level beyond its ends.
    end, start: radii between which the edge may be below the ground [m].
    """

    def __init__(self, profile: Profile, floor: tuple[Vector, Vector], *, end: float, start: float) -> None:
        low = max(end - 0.5, float(profile.r[0]))
        high = min(start + 0.5, float(profile.r[-1]))
        count = max(int(np.ceil((start - end) / _STEP)), 1)
        step = (start - end) / count
        before, after = int(max(end - low, 0.0) / step), int(max(high - start, 0.0) / step)
        self.r: Vector = np.asarray(end + step * np.arange(-before, count + after + 1), dtype=float)
        self.step = step
        self.start, self.profile = start, profile
        self.height = profile.height(self.r)
        self.floor = _highest(floor, self.r, step)
        window = max(int(_SMOOTH / step) // 2, 1)
        padded = np.pad(self.height, window, mode="edge")
        mean = np.convolve(padded, np.full(2 * window + 1, 1.0 / (2 * window + 1)), mode="valid")
        self.followed = np.minimum(mean, self.height)

    def line(self, depth: float, end: float, descent: Descent) -> Array:
        """(K,) height of the edge over `r` [m], at most `depth` below the smoothed ground from `end` to the start."""
        wanted = np.maximum(self.floor, self.followed - depth)
        outside = (self.r < end) | (self.r > self.start + 1e-9)
        wanted = np.where(outside, self.height, np.minimum(wanted, self.height))
        fall, rise = np.tan(descent.entry) * self.r, np.tan(descent.leave) * self.r
        from_outside = np.maximum.accumulate((wanted - fall)[::-1])[::-1] + fall
        from_inside = np.maximum.accumulate(wanted + rise) - rise
        # the end is between two points of the grid
        from_end = float(self.profile.height(np.array(end))) + np.tan(descent.leave) * (end - self.r)
        found = np.maximum(np.maximum(from_outside, from_inside), np.where(outside, -np.inf, from_end))
        return _rounded(found, self.step)

    def path(self, depth: float, end: float, descent: Descent) -> tuple[Vector, Vector]:
        """(M,), (M,) the line from the start to `end`, r not increasing [m]."""
        inside = (self.r > end) & (self.r <= self.start + 1e-9)
        z = self.line(depth, end, descent)[inside][::-1]
        return np.append(self.r[inside][::-1], end), np.append(z, float(self.profile.height(np.array(end))))


def _highest(floor: tuple[Vector, Vector], r: Vector, step: float) -> Vector:
    """(K,) the greatest height of a floor within one step of each of the evenly spaced radii r (K,)."""
    found = np.maximum(np.interp(r - step, *floor), np.interp(r + step, *floor))
    own_r, own_z = (np.asarray(values, dtype=float) for values in floor)
    nearest = np.round((own_r - r[0]) / step).astype(int)
    for off in range(-2, 3):  # two of the radii to either side: those within a step, and room for rounding
        index = nearest + off
        inside = (index >= 0) & (index < len(r))
        index, beside, z = index[inside], own_r[inside], own_z[inside]
        near = np.abs(r[index] - beside) <= step
        np.maximum.at(found, index[near], z[near])
    return found


def _rounded(z: Array, step: float) -> Array:
    """A line with its concave corners rounded by `_RADIUS`; it is nowhere lowered."""
    half = int(_RADIUS / step)
    if half < 1:
        return z
    offset = step * np.arange(-half, half + 1)
    ball = np.sqrt(np.maximum(_RADIUS**2 - offset**2, 0.0))
    padded = np.concatenate((np.full(2 * half, z[0]), z, np.full(2 * half, z[-1])))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    upper = np.max(windows + ball, axis=1)
    lower = np.min(np.lib.stride_tricks.sliding_window_view(upper, 2 * half + 1) - ball, axis=1)
    return np.asarray(np.maximum(lower, z))


def spaced(r: Vector, z: Vector) -> tuple[Vector, Vector]:
    """(M,), (M,) places about `_SPACING` apart along a line r, z (K,) [m], with both its ends."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(r), np.diff(z)))))
    count = max(int(np.ceil(along[-1] / _SPACING)), 2)
    at = np.linspace(0.0, along[-1], count + 1)
    return np.interp(at, along, r), np.interp(at, along, z)
