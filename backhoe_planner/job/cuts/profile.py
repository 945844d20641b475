"""The ground in the arm's plane: heights over the radius, in lanes side by side across the blade."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector, as_array, as_number
from backhoe_planner.errors import InputError
from backhoe_planner.job.cuts.arm_plane import ArmPlane

_LANES = 7  # across the blade; chosen: a lane of a bucket of 0.6 m is then less than two cells of 5 cm wide
RIM = 1.71  # cells: half a diagonal, which the blade may cover in part, and one cell of interpolation
_STEP = 0.0125  # m along the radius: a quarter of a cell of 5 cm
_WALL = 3.5  # cells over which interpolation may spread a wall that is askew to the grid
_SLOPING = 1.2  # dz/dr, 50 degrees: a steeper slope over so short a distance counts as a wall; chosen
_BESIDE = 0.15  # m to each side over which the ground's slope is taken; chosen, as long as a wedge ahead of the blade
_STEEPEST = 0.7  # of the slope: 35 degrees; steeper soil slumps, or is a wall that no wedge leans on


class Heights(Protocol):
    """A grid of heights such as that of a terrain: rows along y, columns along x."""

    @property
    def low(self) -> Vector:
        """(2,) x, y of the first node [m]."""

    @property
    def cell(self) -> float:
        """Distance between neighbouring nodes [m]."""

    @property
    def bank(self) -> Matrix:
        """(rows, columns) height of the undisturbed soil [m]."""

    @property
    def loose(self) -> Matrix:
        """(rows, columns) thickness of the loose soil on it [m]."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Heights of the ground in the arm's plane.

    Attributes
    ----------
    r: (K,) distances from the swing axis, increasing [m].
    bank: (K, L) height of the undisturbed soil in L lanes of equal width across the blade [m], world.
    loose: (K, L) thickness of the loose soil on it [m].

    Raises
    ------
    InputError: the shapes do not fit, a number is not finite, `r` does not increase, or loose soil is below 0.
    """

    r: Vector
    bank: Matrix
    loose: Matrix

    def __post_init__(self) -> None:
        r = as_array(self.r, None, key="profile.r")
        if len(r) < 2 or np.any(np.diff(r) <= 0.0):
            raise InputError("does not increase", key="profile.r", allowed="two or more increasing radii")
        for name in ("bank", "loose"):
            as_array(getattr(self, name), len(r), None, key=f"profile.{name}")
        if self.loose.shape != self.bank.shape:
            raise InputError("is not of the shape of the bank", key="profile.loose", found=str(self.loose.shape))
        if np.any(self.loose < 0.0):
            raise InputError("is below 0", key="profile.loose", found=float(np.min(self.loose)), allowed="0 or more")

    @classmethod
    def level(cls, height: float, low: float, high: float) -> Profile:
        """Level ground of undisturbed soil from radius `low` to `high` [m]."""
        low, high = as_number(low, key="low"), as_number(high, key="high")
        count = max(int(np.ceil((high - low) / _STEP)) + 1, 2)
        r = np.linspace(low, high, count)
        return cls(r, np.full((count, 1), as_number(height, key="height")), np.zeros((count, 1)))

    @classmethod
    def of_terrain(cls, terrain: Heights, plane: ArmPlane, swing: float, *, width: float) -> Profile:
        """The heights of a terrain under a blade of `width` [m] that runs along the plane at a swing angle.

        Raises
        ------
        InputError: fewer than two of its radii are on the terrain.
        """
        rows, columns = terrain.bank.shape
        size = terrain.cell * np.array([columns - 1, rows - 1])
        corners = terrain.low + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) * size
        farthest = float(np.max(np.linalg.norm(corners - plane.axis, axis=1)))
        r = np.arange(0.0, farthest + width, min(_STEP, 0.25 * terrain.cell))
        _, left = plane.directions(swing)
        middle = plane.world(swing, r, np.zeros(len(r)))[:, :2]
        # if the blade covers a column in part, only its mean height is known: use only wholly covered columns
        half = max(0.5 * width - RIM * terrain.cell, 0.0)
        lanes = half * np.linspace(-1.0, 1.0, _LANES)
        points = (middle[:, None, :] + lanes[:, None] * left - terrain.low) / terrain.cell
        inside = np.all((points >= 0.0) & (points <= [columns - 1, rows - 1]), axis=(1, 2))
        if np.count_nonzero(inside) < 2:
            raise InputError("the terrain has no ground under the blade", key="swing", found=swing)
        first, last = int(np.argmax(inside)), len(inside) - int(np.argmax(inside[::-1]))
        if not inside[first:last].all():
            last = first + int(np.argmin(inside[first:]))
        points, r = points[first:last], r[first:last]
        bank = _bilinear(terrain.bank, points)
        for lane in bank.T:
            _stand_walls(r, lane, _WALL * terrain.cell)
        return cls(r, bank, _bilinear(terrain.loose, points))

    @cached_property
    def surface(self) -> Matrix:
        """(K, L) height of the ground [m]."""
        return np.asarray(self.bank + self.loose)

    @cached_property
    def mean(self) -> Vector:
        """(K,) height of the ground, averaged across the blade [m]."""
        return np.asarray(self.surface.mean(axis=1))

    @cached_property
    def _surface_lanes(self) -> _Lanes:
        return _Lanes(self.r, self.surface)

    @cached_property
    def _bank_lanes(self) -> _Lanes:
        return _Lanes(self.r, self.bank)

    @cached_property
    def _loose_lanes(self) -> _Lanes:
        return _Lanes(self.r, self.loose)

    @cached_property
    def slope(self) -> Vector:
        """(K,) dz/dr of the ground around each radius."""
        ahead, behind = (np.interp(self.r + step, self.r, self.mean) for step in (_BESIDE, -_BESIDE))
        span = np.minimum(self.r + _BESIDE, self.r[-1]) - np.maximum(self.r - _BESIDE, self.r[0])
        return np.asarray(np.clip((ahead - behind) / span, -_STEEPEST, _STEEPEST))

    def height(self, r: Array) -> Array:
        """(...) height of the ground at radii (...) [m]; beyond its ends, that of the end."""
        return np.interp(r, self.r, self.mean)

    def depth(self, r: Array, z: Array) -> Array:
        """(...) mean depth below the ground, across the blade, of an edge at r, z (...) [m].

        If the edge is above all of the ground: its height above the highest lane, negative.
        """
        r, z = np.broadcast_arrays(r, z)
        lanes = np.stack(list(self._surface_lanes.at(r)), axis=-1) - z[..., None]
        within = np.mean(np.maximum(lanes, 0.0), axis=-1)
        return np.asarray(np.where(within > 0.0, within, np.max(lanes, axis=-1)))

    def taken(self, r: Vector, z: Vector, *, width: float) -> tuple[Vector, Vector]:
        """(M,), (M,) bank and loose soil [m^3] that an edge of `width` has taken up to each place r, z (M,) [m].

        The edge moves inward: r does not increase. Loose soil is on top of the bank, so an edge coming from above takes
        it first.
        """
        at, over = self._bank_lanes.at(r), self._loose_lanes.at(r)
        bank = np.maximum(at - z, 0.0).sum(axis=0)
        thickness = np.minimum(np.maximum(at + over - z, 0.0), over).sum(axis=0)
        lanes = self.bank.shape[1]
        return _inward(r, bank / lanes) * width, _inward(r, thickness / lanes) * width


class _Lanes:
    """Several functions of the radius at once, as `np.interp` of each: their places are looked up once for all.

    Parameters
    ----------
    r: (K,) increasing radii [m].
    values: (K, L) of the functions there.
    """

    def __init__(self, r: Vector, values: Matrix) -> None:
        self._r = r
        self._values = np.ascontiguousarray(values.T)
        rises = np.diff(self._values, axis=1) / np.diff(r)
        self._rises = np.concatenate((rises, np.zeros((len(rises), 1))), axis=1)  # level beyond the last

    def at(self, r: Array) -> Array:
        """(L, ...) at radii (...) [m]; beyond the ends, as at the end."""
        within = np.clip(r, self._r[0], self._r[-1])
        before = np.searchsorted(self._r, within, side="right") - 1
        return np.asarray(self._rises[:, before] * (within - self._r[before]) + self._values[:, before])


def _inward(r: Vector, depth: Vector) -> Vector:
    """(M,) area [m^2] of `depth` (M,) over non-increasing radii, up to each of them, by the trapezium rule."""
    return np.concatenate(([0.0], np.cumsum(0.5 * (depth[1:] + depth[:-1]) * -np.diff(r))))


def _stand_walls(r: Vector, z: Vector, longest: float) -> None:
    """Make those walls upright in the line z (K,) [m] that are no longer than `longest` [m]; the area below is kept.

    A column on the edge of a trench has a mean height. Interpolation spreads the wall over the neighbouring columns,
    as if soil that was dug long ago still leaned on it.
    """
    slope = np.diff(z) / np.diff(r)
    steep = np.sign(slope) * (np.abs(slope) > _SLOPING)
    ends = np.flatnonzero(np.diff(np.concatenate(([0.0], steep, [0.0]))))
    for a, b in itertools.pairwise(ends.tolist()):
        if steep[a] == 0.0 or r[b] - r[a] > longest:
            continue
        own = z[a : b + 1]
        low, high = float(own[0]), float(own[-1])
        area = float(np.sum(0.5 * (own[1:] + own[:-1]) * np.diff(r[a : b + 1])))
        # low up to the wall, high beyond it; the sample next to the wall takes the rest of the area
        at = r[b] - (area - low * (r[b] - r[a])) / (high - low)
        past = np.clip((r[a + 1 : b] - at) / (r[b] - r[a]) * (b - a) + 0.5, 0.0, 1.0)
        own[1:-1] = low + (high - low) * past


def _bilinear(grid: Matrix, points: Array) -> Array:
    """(...) values of a grid at points (..., 2), column and row."""
    column, row = points[..., 0], points[..., 1]
    j = np.clip(column.astype(int), 0, grid.shape[1] - 2)
    i = np.clip(row.astype(int), 0, grid.shape[0] - 2)
    s, t = column - j, row - i
    low = (1.0 - s) * grid[i, j] + s * grid[i, j + 1]
    high = (1.0 - s) * grid[i + 1, j] + s * grid[i + 1, j + 1]
    return np.asarray((1.0 - t) * low + t * high)
