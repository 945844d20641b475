"""A terrain as a solid: everything below a height map, cell by cell.

Over each cell the surface is the upper hull of its four corners: of the two ways to cut the cell
into triangles it is the higher one. A shape that does not touch the surface is compared with the
cells one by one, in a compiled call. Otherwise, and without the compiled functions, coal has the
triangles in trees, one for each tile of 32 x 32 cells, which is built when a shape first comes near.
A tree of triangles has no inside. A shape that touches no triangle is on one side of the surface
with all of its points, so that one of them tells on which side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.cell_set import CellSet
from backhoe_planner.machine.clusters.distance_grid import GridFrame
from backhoe_planner.machine.clusters.height_bounds import REACH, HeightBounds
from backhoe_planner.machine.clusters.link_box import LinkReach
from backhoe_planner.machine.clusters.solid import HeightMap, Placed
from backhoe_planner.machine.clusters.trees import LEAST_REACH, Reading, Tree, surface_tree
from backhoe_planner.machine.shape.convex import too_fine
from backhoe_planner.machine.shape.shapes import sphere
from backhoe_planner.native import compiled

_TILE = 32  # cells along the edge of a tile; chosen: some 6 ms and 1.3 MB to build its tree
_MOST_TREES = 256  # trees that are kept; chosen: some 330 MB
_LOWERED = 0.5  # part of the depth by which the lowest point may approach the floor before the floor is lowered; chosen
_MOST_PARTS = 500_000  # parts into which cells are divided to bound distances; chosen: 22 MB
_FINE = 0.05  # m, edge down to which cells are divided to bound distances; chosen
_SKIRT = (-1, -1)  # the tile of the walls and the floor


class TerrainSolid:
    """The ground under a height map, in its own frame; see `Solid`.

    Parameters
    ----------
    heights: (rows, columns) [m]; rows run along y, columns along x, both ascending,
        and the map is centred on the origin.
    size: extent in x and y [m].
    depth: how far below the lowest point the ground reaches [m].
    most: the greatest number of cells.

    Raises
    ------
    InputError: it has more cells than `most`.
    """

    is_full = True
    voxels = None
    cells = None

    def __init__(self, heights: Matrix, size: tuple[float, float], *, depth: float, most: int) -> None:
        rows, columns = heights.shape
        if (rows - 1) * (columns - 1) > most:
            raise too_fine(f"{(rows - 1) * (columns - 1)} cells", most)
        self._heights, self._size, self._depth, self._most = heights, size, depth, most
        self._low = np.array([-0.5 * size[0], -0.5 * size[1]])
        self._cell = np.array([size[0] / (columns - 1), size[1] / (rows - 1)])
        self._x = self._low[0] + self._cell[0] * np.arange(columns)
        self._y = self._low[1] + self._cell[1] * np.arange(rows)
        self._floor = float(heights.min()) - depth
        self.bounds = np.array([[*self._low, self._floor], [*-self._low, float(heights.max())]])
        self.finest = float(self._cell.min())
        boxes_low, boxes_high = self._tile_bounds()
        self._tile_places = self._low.tolist(), self._cell.tolist(), boxes_low.shape[:2]
        self._tile_boxes = {
            tile: (boxes_low[tile].tolist(), boxes_high[tile].tolist()) for tile in np.ndindex(*boxes_low.shape[:2])
        }
        self._trees: dict[tuple[int, int], Tree] = {}

    def __len__(self) -> int:
        return (len(self._y) - 1) * (len(self._x) - 1)

    @cached_property
    def ground(self) -> HeightMap:
        """The height map."""
        return HeightMap(self._heights, self._x, self._y, self._floor, float(self.bounds[1, 2]))

    def is_over(self, heights: Matrix, size: tuple[float, float]) -> bool:
        """Whether `heights` (rows, columns) over a rectangle of `size` [m] are heights at the same places."""
        return self._heights.shape == heights.shape and self._size == size

    def with_heights(self, heights: Matrix) -> TerrainSolid:
        """The ground with other heights (rows, columns) [m] at the same places.

        The trees of tiles in which no height changes are reused.
        """
        found = TerrainSolid(heights, self._size, depth=self._depth, most=self._most)
        found._floor = min(self._floor, found._floor + _LOWERED * self._depth)
        found.bounds[0, 2] = found._floor
        same = heights == self._heights
        for tile, tree in self._trees.items():
            if tile == _SKIRT:
                is_same = found._floor == self._floor and all(
                    line.all() for line in (same[0], same[-1], same[:, 0], same[:, -1])
                )
            else:
                r0, r1, c0, c1 = self._span(tile)
                is_same = bool(same[r0 : r1 + 1, c0 : c1 + 1].all())
            if is_same:
                found._trees[tile] = tree
        return found

    def prepare(self) -> None:
        """Do nothing: the trees of the tiles are built when a shape comes near."""

    def prepare_near(self) -> None:
        """Do nothing: the cells are found by their numbers."""

    def taken(self, frame: GridFrame) -> Flags:
        """(frame.counts) which cells of a grid the ground may touch."""
        taken = np.zeros(frame.counts, dtype=bool)
        spans = []
        for axis, places in ((0, self._x), (1, self._y)):
            # the first and the last grid cell that each cell of the terrain touches
            at = (places - frame.low[axis]) / frame.step
            spans.append((np.floor(at[:-1]).astype(int), np.floor(at[1:]).astype(int)))
        h = self._heights
        top = np.maximum(np.maximum(h[:-1, :-1], h[1:, :-1]), np.maximum(h[:-1, 1:], h[1:, 1:]))
        along_x = _most_in(top, *spans[0], int(frame.counts[0]))  # (rows - 1, counts x)
        level = _most_in(along_x.T, *spans[1], int(frame.counts[1]))  # (counts x, counts y)
        last = np.floor((level - frame.low[2]) / frame.step)
        first = int(np.floor((self._floor - frame.low[2]) / frame.step))
        z = np.arange(frame.counts[2])
        taken[:] = (z >= first) & (z <= last[..., None])
        return taken

    def height_bounds(self, low: Vector, high: Vector) -> HeightBounds:
        """Bounds of the distance for points in the box from `low` to `high` (3,) [m]."""
        first = np.floor((low[:2] - self._low) / self._cell).astype(int)
        last = np.floor((high[:2] - self._low) / self._cell).astype(int)
        most = math.isqrt(_MOST_PARTS // int(np.prod(last - first + 1)))
        parts = max(min(math.ceil(float(self._cell.max()) / _FINE), most), 1)
        around = math.ceil(REACH / parts)
        counts = np.array([len(self._x) - 1, len(self._y) - 1])
        start = np.minimum(np.maximum(first - around, 0), counts)
        end = np.maximum(np.minimum(last + 1 + around, counts), start)
        tops = np.full(parts * (last - first + 1 + 2 * around), -np.inf)
        (x, y), (u, v) = parts * (start - (first - around)), parts * (end - (first - around))
        if (end > start).all():
            tops[x:u, y:v] = _tops(self._heights[start[1] : end[1] + 1, start[0] : end[0] + 1], parts).T
        spare = parts * around - REACH
        tops = tops[spare : len(tops) - spare, spare : tops.shape[1] - spare]
        return HeightBounds(tops, self._low + self._cell * first, self._cell / parts)

    def measure(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from a convex shape if it is less than `reach` [m], otherwise None.

        For a shape below the surface that does not touch it, it is minus the distance to the surface.
        """
        reach = max(reach, LEAST_REACH)
        low, high = link.box(0.0)
        found = self._from_surface(link, low, high, reach)
        if found is not None and found.distance <= 0.0:
            return found
        if low[2] > self.bounds[1, 2] or not self._is_inside(link.hull[0]):
            return found
        reach = max(reach, self.finest)
        while found is None:
            reach *= 4.0
            found = self._from_surface(link, low, high, reach)
        return Reading(-found.distance, -found.normal, found.point, found.other_point)

    def deeper(self, link: Placed, found: Reading) -> Reading:
        """The reading `found` of a shape in the ground, or the depth of its lowest corner if that is more.

        The shape is not out of the ground before that corner is. It can leave a single triangle earlier, aside or down.
        """
        points = link.hull[link.hull[:, 2] >= self._floor]
        height, _ = surface_under(points, self._heights, self._x, self._y)
        if not np.isfinite(height).any():
            return found
        above = points[:, 2] - height
        lowest = int(above.argmin())
        if link.radius - above[lowest] <= -found.distance:  # the surface is no further than straight up
            return found
        corner = points[lowest]
        under = self._from_surface(Placed(_POINT, np.eye(3), corner), corner, corner, LEAST_REACH - above[lowest])
        if under is None or under.distance <= 0.0 or under.distance + link.radius <= -found.distance:
            return found
        out = -under.normal
        return Reading(-under.distance - link.radius, out, corner + link.radius * out, under.other_point)

    def _from_surface(self, link: Placed, low: Vector, high: Vector, reach: float) -> Reading | None:
        """The distance from the triangles only, for a shape in the box from `low` to `high` (3,) [m]."""
        (x, y, z), (u, v, w) = low.tolist(), high.tolist()
        (least_x, least_y, _), (most_x, most_y, top) = self.bounds.tolist()
        if z - top >= reach:
            return None
        is_beside = min(x - least_x, most_x - u, y - least_y, most_y - v, z - self._floor) < reach
        if not is_beside:
            is_known, reading = self._from_cells(link, low, high, reach)
            if is_known:
                return reading
        near = []
        for tile in self._tiles_in((x - reach, y - reach), (u + reach, v + reach)):
            (a, b, c), (d, e, f) = self._tile_boxes[tile]
            off = (max(a - u, x - d, 0.0), max(b - v, y - e, 0.0), max(c - w, z - f, 0.0))
            away = math.hypot(*off)
            if away < reach:
                near.append((away, tile))
        if is_beside:
            near.append((0.0, _SKIRT))
        best = None
        for distance, tile in sorted(near):
            if distance >= reach:
                break
            found = self._tree(tile).measure(link.shape, link.shifted(_NO_SHIFT), reach)
            if found is not None and (best is None or found.distance < best.distance):
                best, reach = found, max(found.distance, 0.0)
        return best

    def _from_cells(self, link: Placed, low: Vector, high: Vector, reach: float) -> tuple[bool, Reading | None]:
        """Whether the cells alone give the distance from the surface, and the distance if so."""
        counts = len(self._x) - 1, len(self._y) - 1
        first = np.maximum((low[:2] - reach - self._low) // self._cell, 0.0).astype(int)
        last = np.minimum((high[:2] + reach - self._low) // self._cell, counts).astype(int) + 1
        columns, rows = (slice(start, end + 1) for start, end in zip(first.tolist(), last.tolist(), strict=True))
        return Reading.of_compiled(
            nearest_on_ground(
                link.hull, link.radius, self._heights[rows, columns], self._x[columns], self._y[rows], reach
            )
        )

    def _tiles_in(self, low: tuple[float, float], high: tuple[float, float]) -> Iterator[tuple[int, int]]:
        """The numbers along x and y of the tiles in a rectangle [m]."""
        spans = []
        for start, end, first, cell, count in zip(low, high, *self._tile_places, strict=True):
            edge = _TILE * cell
            before = math.floor(min(max((start - first) / edge, 0.0), count))
            last = math.floor(min(max((end - first) / edge, -1.0), count - 1))
            spans.append(range(before, last + 1))
        return ((i, j) for i in spans[0] for j in spans[1])

    def _tile_bounds(self) -> tuple[Array, Array]:
        """(i, j, 3), (i, j, 3) lowest and highest corner of the surface in every tile [m]."""
        counts = [(len(self._x) - 2) // _TILE + 1, (len(self._y) - 2) // _TILE + 1]
        low, high = np.empty((*counts, 3)), np.empty((*counts, 3))
        for i, j in np.ndindex(*counts):
            r0, r1, c0, c1 = self._span((i, j))
            heights = self._heights[r0 : r1 + 1, c0 : c1 + 1]
            low[i, j] = self._x[c0], self._y[r0], heights.min()
            high[i, j] = self._x[c1], self._y[r1], heights.max()
        return low, high

    def _span(self, tile: tuple[int, int]) -> tuple[int, int, int, int]:
        """First and last row, first and last column of a tile's points."""
        c0, r0 = tile[0] * _TILE, tile[1] * _TILE
        return r0, min(r0 + _TILE, len(self._y) - 1), c0, min(c0 + _TILE, len(self._x) - 1)

    def _tree(self, tile: tuple[int, int]) -> Tree:
        found = self._trees.pop(tile, None)
        if found is None:
            found = _tree_of(self._skirt().transpose(1, 2, 0) if tile == _SKIRT else self._triangles(*self._span(tile)))
            if len(self._trees) >= _MOST_TREES:
                del self._trees[next(iter(self._trees))]
        self._trees[tile] = found  # the latest one used is last
        return found

    def _triangles(self, r0: int, r1: int, c0: int, c1: int, *, low: float = -np.inf, high: float = np.inf) -> Array:
        """(3, 3, m) corners, each by coordinates, of the surface between rows and columns of points [m].

        The last row and column are included. Cells that are wholly below `low` or above `high` [m] are left out.
        """
        z = self._heights[r0 : r1 + 1, c0 : c1 + 1]
        a, b, c, d = z[:-1, :-1], z[:-1, 1:], z[1:, :-1], z[1:, 1:]
        least, most = np.minimum(np.minimum(a, b), np.minimum(c, d)), np.maximum(np.maximum(a, b), np.maximum(c, d))
        row, column = ((most >= low) & (least <= high)).nonzero()
        return self._triangles_of(row + r0, column + c0)

    def _triangles_of(self, row: Indices, column: Indices) -> Array:
        """(3, 3, 2 k) corners, each by coordinates, of the surface over some cells (k,) [m]."""
        z, x, y = self._heights, self._x, self._y
        a, b, c, d = z[row, column], z[row, column + 1], z[row + 1, column], z[row + 1, column + 1]
        x_a, x_b, y_a, y_c = x[column], x[column + 1], y[row], y[row + 1]
        main = a + d >= b + c
        # the cell is cut either along a d, or along b c
        first = (x_a, y_a, a), (x_b, y_a, b), (np.where(main, x_b, x_a), y_c, np.where(main, d, c))
        second = (np.where(main, x_a, x_b), y_a, np.where(main, a, b)), (x_b, y_c, d), (x_a, y_c, c)
        return np.concatenate((first, second), axis=2)

    def _skirt(self) -> Array:
        """(m, 3, 3) corners of the triangles of the walls around the map, and of its floor [m]."""
        walls = []
        x, y, h = self._x, self._y, self._heights
        for line in (
            np.column_stack((x, np.full(len(x), y[0]), h[0])),
            np.column_stack((x, np.full(len(x), y[-1]), h[-1])),
            np.column_stack((np.full(len(y), x[0]), y, h[:, 0])),
            np.column_stack((np.full(len(y), x[-1]), y, h[:, -1])),
        ):
            under = line.copy()
            under[:, 2] = self._floor
            walls += [
                np.stack((line[:-1], line[1:], under[1:]), axis=1),
                np.stack((line[:-1], under[1:], under[:-1]), axis=1),
            ]
        ends = np.array([[u, v, self._floor] for u in (x[0], x[-1]) for v in (y[0], y[-1])])
        return np.concatenate((*walls, ends[[[0, 1, 3], [0, 3, 2]]]))

    def _is_inside(self, point: Vector) -> bool:
        """Whether a point (3,) is in the ground."""
        x, y, z = point.tolist()
        (low_x, low_y), (edge_x, edge_y), _ = self._tile_places
        along, across, columns, rows = (x - low_x) / edge_x, (y - low_y) / edge_y, len(self._x) - 1, len(self._y) - 1
        if not (0.0 <= along <= columns and 0.0 <= across <= rows and z >= self._floor):
            return False
        c, r = min(int(along), columns - 1), min(int(across), rows - 1)
        u, v = along - c, across - r
        (a, b), (c_, d) = self._heights[r : r + 2, c : c + 2].tolist()
        if a + d >= b + c_:
            top = min(a + u * (b - a) + v * (d - b), a + v * (c_ - a) + u * (d - c_))
        else:
            top = min(a + u * (b - a) + v * (c_ - a), d + (1.0 - u) * (c_ - d) + (1.0 - v) * (b - d))
        return bool(z <= top)

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> CellSet:
        """The triangles that may touch the box from `low` to `high` (3,) [m], and some other ones; see `Solid`."""
        found = []
        if (high[:2] >= self._low).all() and (low[:2] <= -self._low).all():
            last = np.array([len(self._x) - 1, len(self._y) - 1])
            c0, r0 = np.maximum(np.floor((low[:2] - self._low) / self._cell).astype(int), 0).tolist()
            c1, r1 = np.minimum(np.ceil((high[:2] - self._low) / self._cell).astype(int), last).tolist()
            found.append(self._triangles(r0, max(r1, r0 + 1), c0, max(c1, c0 + 1), low=low[2], high=high[2]))
        if (low <= self.bounds[0]).any() or (high[:2] >= self.bounds[1, :2]).any():
            skirt = self._skirt()
            there = (skirt.max(axis=1) >= low).all(axis=1) & (skirt.min(axis=1) <= high).all(axis=1)
            found.append(skirt[there].transpose(1, 2, 0))
        return CellSet.of_triangles(np.concatenate(found, axis=2) if found else np.zeros((3, 3, 0)))

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m] and triangles (m, 3) of the surface, from fewer points if there are too many."""
        stride = max(int(np.ceil(np.sqrt(2.0 * len(self) / most))), 1)
        rows = np.unique(np.append(np.arange(0, len(self._y), stride), len(self._y) - 1))
        columns = np.unique(np.append(np.arange(0, len(self._x), stride), len(self._x) - 1))
        xs, ys = np.meshgrid(self._x[columns], self._y[rows])
        number = np.arange(xs.size).reshape(xs.shape)
        a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
        triangles = np.vstack((np.column_stack((a, b, d)), np.column_stack((a, d, c))))
        return np.column_stack((xs.ravel(), ys.ravel(), self._heights[np.ix_(rows, columns)].ravel())), triangles


_NO_SHIFT = np.zeros(3)
_POINT = sphere(0.0, pin.SE3.Identity())


@compiled
def nearest_on_ground(
    hull: Matrix, radius: float, heights: Matrix, x: Vector, y: Vector, reach: float, /
) -> tuple[()] | tuple[Vector] | None:
    """The distance of a convex shape from the surface of a height map, from its cells one by one.

    Returns a `Reading` as (10,) numbers; None if the distance is not less than `reach` [m]; an empty tuple if it is not
    known, such as when they touch. This plain version never knows: only the compiled one is faster than the trees of
    tiles.

    Parameters
    ----------
    hull: (k, 3) points; the shape is within `radius` [m] of their convex hull.
    heights: (rows, columns) [m] at y (rows,) and x (columns,).
    """
    return ()


def _tree_of(triangles: Array) -> Tree:
    """A tree of triangles with corners (3, 3, m), each by coordinates [m]."""
    corners = triangles.transpose(2, 0, 1).reshape(-1, 3)
    return surface_tree(corners, np.arange(len(corners)).reshape(-1, 3))


def _tops(heights: Matrix, parts: int) -> Matrix:
    """(parts rows, parts columns) the highest point of the surface over each part of the cells between `heights` [m].

    The cut of a cell into triangles runs from corner to corner of parts, so each part is highest at a corner.
    """
    a, b, c, d = (h[:, None, :, None] for h in (heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:]))
    v, u = (np.linspace(0.0, 1.0, parts + 1).reshape(shape) for shape in ((1, -1, 1, 1), (1, 1, 1, -1)))
    z = np.minimum(*_planes(a, b, c, d, u, v))
    top = np.maximum(np.maximum(z[:, :-1, :, :-1], z[:, :-1, :, 1:]), np.maximum(z[:, 1:, :, :-1], z[:, 1:, :, 1:]))
    return np.asarray(top.reshape(parts * (len(heights) - 1), -1))


def surface_under(points: Matrix, heights: Matrix, x: Vector, y: Vector) -> tuple[Vector, Matrix]:
    """(k,) the height of a height map straight below or above points (k, 3) [m], and (k, 2) its slopes along x and y.

    The height is minus infinity beside the map.

    Parameters
    ----------
    heights, x, y: as in `HeightMap`.
    """
    wide, deep = x[1] - x[0], y[1] - y[0]
    across, up = (points[:, 0] - x[0]) / wide, (points[:, 1] - y[0]) / deep
    over = (across >= 0.0) & (across < len(x) - 1) & (up >= 0.0) & (up < len(y) - 1)
    j, i = across[over].astype(int), up[over].astype(int)
    a, b, c, d = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
    first, second = _planes(a, b, c, d, across[over] - j, up[over] - i)
    is_first = first <= second
    height, slopes = np.full(len(points), -np.inf), np.zeros((len(points), 2))
    height[over] = np.where(is_first, first, second)
    slopes[over, 0] = np.where(is_first, b - a, d - c) / wide
    slopes[over, 1] = np.where(is_first == (a + d >= b + c), d - b, c - a) / deep
    return height, slopes


def _planes(a: Array, b: Array, c: Array, d: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """The heights of the planes of a cell's two triangles, at u along x and v along y [m].

    The surface is the lower one. The cell's corners have the heights a and b, then c and d; u and v are fractions of
    its edges.
    """
    main = a + d >= b + c  # cut along a d, otherwise along b c
    first = a + u * (b - a) + v * np.where(main, d - b, c - a)
    return first, np.where(main, a + v * (c - a) + u * (d - c), d + (1.0 - u) * (c - d) + (1.0 - v) * (b - d))


def _most_in(values: Matrix, first: Indices, last: Indices, count: int) -> Matrix:
    """(rows, count) the largest of `values` (rows, n) at each place; a value covers places `first` to `last` (n,)."""
    found = np.full((len(values), count), -np.inf)
    for place in range(max(int(first.min()), 0), min(int(last.max()) + 1, count)):
        # `first` and `last` ascend, so that the values that cover a place are consecutive
        start, end = np.searchsorted(last, place), np.searchsorted(first, place, side="right")
        if end > start:
            found[:, place] = values[:, start:end].max(axis=1)
    return found
