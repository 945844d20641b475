"""What stands on the ground of a point cloud: walls, trees and vehicles, told from the ground and kept as voxels.

A column of the ground is known by its lowest points, and where a vehicle or a roof hides it, by the columns around:
openings of growing width (a progressive morphological filter: Zhang et al., IEEE TGRS 41(4), 2003) remove what is
narrower than a vehicle and rises more steeply than soil does. A point is off the ground if it is higher than the
ground of its column and of the eight columns around it by more than the roughness. Points on the wall of a trench are
not: they are at most as high as the ground beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Matrix, Vector, as_number
from backhoe_planner.errors import InputError
from backhoe_planner.job.ground.grids import (
    HeightGrid,
    column_lowest,
    columns_of,
    from_nearest,
    lowest_in_columns,
    widened,
)
from backhoe_planner.machine import VoxelSolid, voxel_keys
from backhoe_planner.site import MOST_VOXELS

_WIDEST = 3.0  # m across the narrower side of what is told from the ground: a vehicle, with room; chosen
_STEP = 0.1  # m by which the half width of the opening grows; chosen
_STEEPEST = 1.0  # m per m: ridges of soil are not steeper on both sides; it comes to rest at 0.5 to 0.8 rad
BEYOND = 10.0  # m beyond the modelled ground where ground and things are kept, too: further than an arm reaches; chosen
_COARSEST = 0.4  # m, edge of the voxels of a sparse cloud; chosen: thicker ones keep a bucket from free ground
_OFF_BORDER = 1e-6  # m: rounding puts points on the border of two voxels into either
_BESIDE = (1, 2)  # columns on each side that show that a point is stray; the second for clouds with holes, chosen
_KNOWN_BESIDE = 5  # known columns among them that are needed; chosen, most of eight
_OWN_NAMES = 5  # of the largest things; chosen: each is measured by itself


@dataclass(frozen=True, eq=False)
class PartedPoints:
    """Points of a cloud, parted into those of the ground and others.

    Attributes
    ----------
    off: (n,) which stand on the ground, or hang above it.
    stray: (n,) which are far below it, by an error of the scanner.
    ground: on a grid and up to 10 m around it, by its lowest points, without holes unless nothing is known of it.
    part: the rows and columns of the grid in that.
    """

    off: Flags
    stray: Flags
    ground: HeightGrid
    part: tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class OffGround:
    """Points that stand on the ground, as voxels that contain them.

    Attributes
    ----------
    edge: of a voxel [m].
    keys: (n, 3) the lowest corner of each voxel in multiples of its edge, world; each once, in order.
    """

    edge: float
    keys: NDArray[np.int64]

    def __post_init__(self) -> None:
        found = np.asarray(self.keys)
        if found.ndim != 2 or found.shape[1] != 3 or not len(found) or found.dtype.kind != "i":
            raise InputError("are no voxels", key="keys", found=f"{found.dtype} of shape {found.shape}",
                             allowed="whole numbers (n, 3), n of 1 or more")  # fmt: skip
        keys = np.unique(found.astype(np.int64), axis=0)
        keys.setflags(write=False)
        object.__setattr__(self, "keys", keys)
        object.__setattr__(self, "edge", as_number(self.edge, key="edge", above=0.0))

    @property
    def centres(self) -> Matrix:
        """(n, 3) the middles of the voxels [m]."""
        return np.asarray(self.edge * (self.keys + 0.5))

    @cached_property
    def _numbers(self) -> NDArray[np.int64]:
        """(n,) the number of the thing that each voxel belongs to."""
        from scipy.ndimage import binary_dilation, label

        flat = self.keys[:, :2] - self.keys[:, :2].min(axis=0) + 1
        plan = np.zeros(flat.max(axis=0) + 2, dtype=bool)
        plan[tuple(flat.T)] = True
        joined = binary_dilation(plan, np.ones((3, 3), dtype=bool))  # across a gap of up to two voxels
        return np.asarray(label(joined, np.ones((3, 3)))[0][tuple(flat.T)])

    @property
    def things(self) -> tuple[tuple[str, NDArray[np.int64]], ...]:
        """Name and voxels (k, 3) of each thing, the largest first; small ones are one, without a place in its name."""
        return self.things_within_unchecked(np.full(2, -np.inf), np.full(2, np.inf))

    def things_within_unchecked(self, low: Vector, high: Vector) -> tuple[tuple[str, NDArray[np.int64]], ...]:
        """As `things`, of those with a voxel whose middle is between x, y `low` and `high` (2,) [m]."""
        number, middle = self._numbers, self.centres[:, :2]
        near = np.all((middle >= low) & (middle <= high), axis=1)
        sizes = np.where(np.isin(np.arange(number.max() + 1), number[near]), np.bincount(number), 0)
        order = np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes)].tolist()
        found: dict[str, NDArray[np.int64]] = {}
        for one in order[:_OWN_NAMES]:
            own = self.keys[number == one]
            x, y = (np.round(self.edge * (own[:, :2].mean(axis=0) + 0.5), 1) + 0.0).tolist()  # no -0.0
            name = f"what stands at x {x:.1f}, y {y:.1f} m"
            found[name if name not in found else f"{name} ({one})"] = own
        if len(order) > _OWN_NAMES:
            found["what else stands on the ground"] = self.keys[np.isin(number, order[_OWN_NAMES:])]
        return tuple(found.items())

    @property
    def has_gaps(self) -> bool:
        """Whether most of its voxels touch no other, so that what is between them counts as free."""
        return len(self.keys) > 1 and VoxelSolid(self.keys, self.edge, most=MOST_VOXELS).closed_edge() > self.edge


def voxels_of(points: Matrix, cell: float) -> OffGround:
    """The voxels of points (n, 3) [m], one or more.

    Their edge is `cell` [m] or, if most voxels would touch no other then, 2, 4, ... times as much.
    """
    keys, times = voxel_keys(points, cell), 1
    closed = VoxelSolid(keys, cell, most=MOST_VOXELS).closed_edge()
    while 2 * times * cell <= min(closed, _COARSEST) * (1.0 + 1e-9):
        times *= 2
    return OffGround(times * cell, keys // times)


def same_voxels(one: OffGround | None, other: OffGround | None) -> bool:
    """Whether the same stands in both."""
    if one is None or other is None:
        return one is other
    return one.edge == other.edge and np.array_equal(one.keys, other.keys)


def join_voxels(one: OffGround | None, other: OffGround | None) -> OffGround | None:
    """What stands in either, with the larger edge."""
    if one is None or other is None:
        return one or other
    fine, coarse = sorted((one, other), key=lambda some: some.edge)
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (1.0 - 1e-9) + 5e-10
    # a box that is no larger than a voxel is within those that contain its corners
    points = fine.edge * (fine.keys[:, None, :] + corners).reshape(-1, 3)
    return OffGround(coarse.edge, np.vstack((coarse.keys, voxel_keys(points, coarse.edge))))


def standing_in(found: OffGround | None, keep: Flags, grid: HeightGrid) -> OffGround | None:
    """What stands in the columns that `keep` (rows, columns) names, or beyond the grid, by the middles of voxels."""
    if found is None:
        return None
    on, column = columns_of(found.centres, grid)
    kept = ~on
    kept[on] = keep.ravel()[column]
    return OffGround(found.edge, found.keys[kept]) if kept.any() else None


def columns_below(found: OffGround | None, ground: HeightGrid, headroom: float) -> Flags:
    """(rows, columns) on which something stands, or above which it hangs by less than `headroom` [m]."""
    from scipy.ndimage import binary_dilation

    taken = np.zeros(ground.z.shape, dtype=bool)
    if found is None:
        return taken
    on, column = columns_of(found.centres, ground)
    low = found.edge * found.keys[on, 2] - ground.z.ravel()[column] < headroom
    taken.ravel()[column[low]] = True
    half = int(np.ceil(0.5 * found.edge / ground.cell))  # columns on each side that a voxel reaches into
    return np.asarray(binary_dilation(taken, np.ones((2 * half + 1, 2 * half + 1), dtype=bool)))


def describe(points: Matrix, ground: HeightGrid, off: OffGround) -> str:
    """How many columns of the ground those points (n, 3) [m] stand on, how high, and what follows from that."""
    on, column = columns_of(points, ground)
    above = np.nan_to_num(points[on, 2] - ground.z.ravel()[column])
    found = []
    if len(column):
        highest = int(np.argmax(above))
        x, y = points[on][highest, :2].tolist()
        found.append(
            f"on {len(np.unique(column))} of {ground.z.size} columns something stands, "
            f"up to {above[highest]:.2f} m high at x {x:.2f}, y {y:.2f}"
        )
    if not on.all():
        found.append(f"{np.count_nonzero(~on)} points stand beyond the modelled ground")
    gaps = "; its points are far apart, and what is between its voxels counts as free" if off.has_gaps else ""
    return (
        f"{'; '.join(found)}: obstacles of voxels of {off.edge:g} m, which digging does not remove{gaps}. Leave "
        "out the points of the machine itself and of what will be gone. Up to ground.roughness points count as ground"
    )


def part_points(points: Matrix, grid: HeightGrid, roughness: float, known: Matrix | None) -> PartedPoints:
    """Tell what stands on the ground from the ground.

    Parameters
    ----------
    points: (n, 3) [m].
    grid: the columns of the ground.
    roughness: height above the ground up to which a point belongs to it [m].
    known: (rows, columns) heights of the ground at an earlier time [m]: nothing stands on what is below them.
    """
    wide, part = widened(grid, points[:, :2].min(axis=0), points[:, :2].max(axis=0), BEYOND)
    near, index = columns_of(points, wide)
    z = points[near, 2]
    lowest = lowest_in_columns(z, index, wide)
    off, stray = np.zeros((2, len(points)), dtype=bool)
    if not np.isfinite(lowest).any():
        return PartedPoints(off, stray, wide, part)
    ground, is_stray = _ground_of(lowest, wide.cell, roughness)
    reference = _highest_around(ground)
    if known is not None:
        reference[part] = np.maximum(reference[part], _highest_around(known))
    off[near] = z > reference.ravel()[index] + roughness
    stray[near] = is_stray.ravel()[index] & (z < ground.ravel()[index] - roughness)
    return PartedPoints(off, stray, replace(wide, z=ground), part)


def below(points: Matrix, ground: HeightGrid, hidden: Flags) -> Matrix:
    """(k, 3) points that fill the unseen space between things and the ground that they hide [m].

    Under a roof or a vehicle that was seen from above nothing else was seen: it is not free.

    Parameters
    ----------
    points: (n, 3) what stands on the ground [m].
    ground: its heights.
    hidden: (rows, columns) where the ground was not seen.
    """
    lowest = column_lowest(points, ground)
    reached = hidden & np.isfinite(lowest) & np.isfinite(ground.z)
    return filling(ground, lowest, reached, ground.cell)


def filling(ground: HeightGrid, tops: Matrix, which: Flags, step: float) -> Matrix:
    """(k, 3) points between a ground and `tops` (rows, columns) above it, `step` apart in height [m].

    Parameters
    ----------
    which: (rows, columns) the columns that are filled; both heights are known there.
    """
    low, gap = ground.z[which], np.maximum(tops[which] - ground.z[which], 0.0)
    counts = np.ceil(gap / step).astype(int)
    level = np.concatenate([np.zeros(0), *(np.arange(count) + 0.5 for count in counts.tolist())])
    places = np.repeat(ground.nodes()[which], counts, axis=0) + _OFF_BORDER
    return np.column_stack((places, np.repeat(low, counts) + level * step))


def _ground_of(lowest: Matrix, cell: float, roughness: float) -> tuple[Matrix, Flags]:
    """(rows, columns) the ground [m] in columns with those lowest points (NaN without): that around what hides it.

    And (rows, columns) whose lowest point is a stray one below the ground.
    """
    from scipy.ndimage import convolve, grey_opening, minimum_filter

    unknown = np.isnan(lowest)
    is_stray = np.zeros(lowest.shape, dtype=bool)
    for half in _BESIDE:
        # scanners put stray points below the ground: a column far below all known ones around it has one
        around = np.ones((2 * half + 1, 2 * half + 1), dtype=int)
        around[half, half] = 0
        beside = minimum_filter(np.where(unknown, np.inf, lowest), footprint=around, mode="constant", cval=np.inf)
        known = convolve((~unknown).astype(int), around, mode="constant")
        found = (lowest < beside - roughness - _STEEPEST * half * cell) & (known >= _KNOWN_BESIDE)
        lowest = np.where(found, beside, lowest)
        is_stray |= found
    filled = from_nearest(lowest, unknown)
    hidden = np.zeros(lowest.shape, dtype=bool)
    surface, before = filled, 0
    steps = np.arange(_STEP, 0.5 * _WIDEST + 1e-9, _STEP)
    for half in sorted({max(1, int(np.ceil(step / cell))) for step in steps.tolist()}):
        opened = grey_opening(surface, size=(2 * half + 1, 2 * half + 1), mode="nearest")
        hidden |= surface - opened > roughness + _STEEPEST * (half - before) * cell
        surface, before = opened, half
    if hidden.all():
        return filled, is_stray
    return from_nearest(lowest, np.isnan(lowest) | hidden), is_stray


def _highest_around(heights: Matrix) -> Matrix:
    """(rows, columns) the greatest of each height and the eight around it; beyond the rim they go on as they fall."""
    from scipy.ndimage import maximum_filter

    padded = np.pad(heights, 1, mode="reflect", reflect_type="odd")
    return np.asarray(maximum_filter(padded, size=3)[1:-1, 1:-1])
