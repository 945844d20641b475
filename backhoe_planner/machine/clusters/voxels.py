"""A scan as a solid: every voxel that contains one of its points."""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.machine.clusters.cell_set import CellSet
from backhoe_planner.machine.clusters.cell_tree import CellTree
from backhoe_planner.machine.clusters.distance_grid import GridFrame
from backhoe_planner.machine.clusters.link_box import LinkReach
from backhoe_planner.machine.clusters.solid import Placed
from backhoe_planner.machine.clusters.tiles import Tiles
from backhoe_planner.machine.clusters.trees import Reading, Tree, voxel_tree
from backhoe_planner.machine.shape.convex import too_fine

Keys = NDArray[np.int64]
"""(n, 3) the lowest corner of each voxel, in multiples of its edge."""

_WIDEST = 65_000  # voxels along an axis: coal numbers them with 16 bits
_MOST_OF_A_SCAN = (0.01, 0.99)  # quantiles between which nearly all voxels are; chosen, strays are fewer
_NARROW = 0.1  # part of the whole extent within which nearly all voxels are, if a few points are strays; chosen
_TILE = 4  # voxels along the edge of a tile; chosen, larger ones contain more voxels out of reach
# part of voxels without neighbours from which on a scan has gaps; chosen: it then covers a sixth of flat ground
_LONE = 0.2
_LOOKED_AT = 4_000  # voxels from which that part is estimated


def voxel_keys(points: Matrix, resolution: float) -> Keys:
    """The voxels with an edge of `resolution` [m] that contain `points` (n, 3) [m], each once, in order."""
    keys = np.floor(points / resolution).astype(np.int64)
    low = keys.min(axis=0)
    counts = [int(count) for count in keys.max(axis=0) - low + 1]
    if counts[0] * counts[1] * counts[2] >= 2**62:  # too many to number them
        return np.unique(keys, axis=0)
    keys -= low
    number, z = np.divmod(np.unique((keys[:, 0] * counts[1] + keys[:, 1]) * counts[2] + keys[:, 2]), counts[2])
    found: Keys = np.column_stack((number // counts[1], number % counts[1], z)) + low
    return found


def lone_part(keys: Keys) -> float:
    """The part of voxels (n, 3), in order, that touch no other by face, edge or corner; estimated from a sample."""
    low = keys.min(axis=0) - 1
    spans = keys.max(axis=0) - low + 2

    def number(some: Keys) -> Keys:
        x, y, z = (some - low).T
        return np.asarray((x * spans[1] + y) * spans[2] + z)

    every, looked_at = number(keys), keys[:: max(len(keys) // _LOOKED_AT, 1)]
    alone = np.ones(len(looked_at), dtype=bool)
    for off in itertools.product((-1, 0, 1), repeat=3):
        if any(off):
            asked = number(looked_at + np.array(off))
            at = np.minimum(np.searchsorted(every, asked), len(every) - 1)
            alone &= every[at] != asked
    return float(alone.mean())


def _too_wide(keys: Keys, edge: float) -> InputError:
    """The error for voxels (n, 3) with too many from the first to the last along an axis, and what may be the cause."""
    axis = int(np.ptp(keys, axis=0).argmax())
    along = keys[:, axis]
    first, last = int(along.min()), int(along.max()) + 1
    low, high = np.quantile(along, _MOST_OF_A_SCAN) * edge
    hint = "use a coarser resolution; are the points in metres?"
    if high - low < _NARROW * edge * (last - first):
        hint = f"leave out the points that are far away: nearly all are from {low:,.6g} to {high:,.6g} m"
    return InputError(
        "is too fine for how far it reaches",
        found=f"{last - first:,} voxels along {'xyz'[axis]}, from {edge * first:,.6g} to {edge * last:,.6g} m",
        allowed=f"up to {_WIDEST:,}", hint=hint,
    )  # fmt: skip


class VoxelSolid:
    """The voxels of a scan, in its own frame; see `Solid`.

    Parameters
    ----------
    keys: (n, 3) from `voxel_keys`.
    edge: of a voxel [m].
    most: the greatest number of voxels.

    Raises
    ------
    InputError: there are more than `most`, or more than 65,000 along an axis.
    """

    is_full = False
    ground = None

    def __init__(self, keys: Keys, edge: float, *, most: int) -> None:
        if len(keys) > most:
            raise too_fine(f"{len(keys)} voxels", most)
        low, high = keys.min(axis=0), keys.max(axis=0) + 1
        if (high - low).max() > _WIDEST:
            raise _too_wide(keys, edge)
        self._keys, self._edge = keys, edge
        self.bounds = edge * np.array([low, high], dtype=float)
        self.finest = edge
        self._base = (low + high) // 2

    def __len__(self) -> int:
        return len(self._keys)

    def closed_edge(self) -> float:
        """The edge with which most voxels touch others: the present one, or the least of 2, 4, 8, ... times it [m].

        Between voxels that touch no other nothing is solid, although the scanned surface is usually continuous.
        """
        times, keys = 1, self._keys
        while len(keys) > 1 and lone_part(keys) > _LONE:
            times *= 2
            keys = np.unique(self._keys // times, axis=0)
        return times * self._edge

    def _low(self) -> Matrix:
        """(n, 3) lowest corner of every voxel [m]."""
        return np.asarray(self._edge * self._keys, dtype=float)

    @cached_property
    def _tree(self) -> Tree:
        return voxel_tree(self._edge * (self._keys - self._base + 0.5), self._edge)

    @cached_property
    def _cells(self) -> CellTree:
        return CellTree.of_cubes(self._low() + 0.5 * self._edge, self._edge)

    @cached_property
    def _tiles(self) -> tuple[Tiles, NDArray[np.int32]]:
        """The tiles of its voxels, and (3, n) the voxels' keys relative to its middle, in the tiles' order."""
        low = self._low()
        tiles = Tiles(low, low + self._edge, _TILE * self._edge)
        return tiles, np.ascontiguousarray((self._keys[tiles.order] - self._base).T, dtype=np.int32)

    def prepare(self) -> None:
        """Build the trees."""
        self._tree, self._cells  # noqa: B018

    def prepare_near(self) -> None:
        """Sort the voxels into tiles."""
        self._tiles  # noqa: B018

    def taken(self, frame: GridFrame) -> Flags:
        """(frame.counts) which cells of a grid the voxels may touch."""
        low = self._low()
        return frame.taken_by_boxes(low, low + self._edge)

    def height_bounds(self, low: Vector, high: Vector) -> None:
        """None, because voxels are not ground."""

    def measure(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from a convex shape if it is less than `reach` [m], otherwise None."""
        is_known, found = self._cells.measure(link, reach)
        if is_known:
            return found
        base = self._edge * self._base
        found = self._tree.measure(link.shape, link.shifted(-base), reach)
        if found is None:
            return None
        return Reading(found.distance, found.normal, found.point + base, found.other_point + base)

    def deeper(self, link: Placed, found: Reading) -> Reading:
        """The reading `found`: voxels have nothing deeper."""
        return found

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> CellSet:
        """The voxels that may touch the box from `low` to `high` (3,) [m], and some other ones; see `Solid`."""
        tiles, ordered = self._tiles
        middle = ordered.take(tiles.near(low, high, link), axis=1).astype(float)
        middle += (self._base + 0.5)[:, None]
        middle *= self._edge
        return CellSet.of_cubes(middle, 0.5 * self._edge)

    @cached_property
    def cells(self) -> tuple[Any, ...]:
        """The arguments of `kept_over_cells` about the voxels, from `boxes` on: none is inside of them."""
        return *self._cells.arrays, np.zeros(3), 1.0, np.zeros(3, dtype=np.intp), np.zeros(0, dtype=np.uint8)

    @cached_property
    def voxels(self) -> tuple[Any, ...]:
        """The arguments of `boxes_of_voxels` about the voxels, from `keys` on."""
        tiles, ordered = self._tiles
        return ordered, self._base + 0.5, self._edge, *tiles.arrays

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m] and triangles (m, 3) of its surface, from larger voxels if there are too many."""
        edge, keys = self._edge, self._keys
        while True:
            sides = _open_sides(keys)
            if 2 * sum(map(len, sides)) <= most or len(keys) < 100:
                break
            edge, keys = 2.0 * edge, voxel_keys(keys.astype(float), 2.0)
        quads = np.concatenate([keys[own][:, None] + _SIDES[way] for way, own in enumerate(sides)]).reshape(-1, 3)
        first = 4 * np.arange(len(quads) // 4)[:, None]
        triangles = np.vstack((first + np.array([0, 1, 2]), first + np.array([0, 2, 3])))
        return edge * quads.astype(float), triangles.astype(np.intp)


_WAYS = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=np.int64)
_SIDES = np.array(  # corners of a voxel's side in each of these directions, counterclockwise as seen from outside
    [
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)],
        [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)],
    ],
    dtype=np.int64,
)


def _open_sides(keys: Keys) -> list[Indices]:
    """For each of the six directions the voxels that have no neighbour there."""
    low = keys.min(axis=0) - 1
    counts = keys.max(axis=0) - low + 2
    weights = np.array([counts[1] * counts[2], counts[2], 1], dtype=np.int64)
    number = np.sort((keys - low) @ weights)
    found = []
    for way in _WAYS:
        beside = (keys + way - low) @ weights
        place = np.minimum(np.searchsorted(number, beside), len(number) - 1)
        found.append(np.flatnonzero(number[place] != beside))
    return found
