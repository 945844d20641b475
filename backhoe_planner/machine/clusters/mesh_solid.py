"""A fine mesh as a solid: its triangles in one tree, and the inside if it is closed."""

from __future__ import annotations

from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.cell_set import CellSet
from backhoe_planner.machine.clusters.cell_tree import CellTree
from backhoe_planner.machine.clusters.distance_grid import DistanceGrid, GridFrame
from backhoe_planner.machine.clusters.link_box import LinkReach
from backhoe_planner.machine.clusters.solid import Placed, clustered
from backhoe_planner.machine.clusters.tiles import Tiles
from backhoe_planner.machine.clusters.trees import Reading, Tree, surface_tree
from backhoe_planner.machine.shape.closed_bodies import ClosedBodies
from backhoe_planner.machine.shape.convex import too_fine

if TYPE_CHECKING:
    import trimesh

_TILE = 6.0  # edge of a tile, in mean edges of the triangles; chosen
_SIDE_CELLS = 96  # cells along the longest axis of the grid that tells inside from outside; chosen
_DEEP = 2.0  # cells of that grid: a shape with a point deeper inside is not compared with the triangles; chosen
_TOWARDS_CORNERS = (0.25, 0.5, 0.75, 1.0)  # parts of the ways from the middle of a hull to its corners; chosen
_MOST_PARTS = 400_000  # parts into which large triangles are cut for a grid; chosen: some 30 ms
_MOST_HOLLOWS = 200  # connected parts of that grid that are sorted into inside and outside; smaller ones are surface
# triangles that a shape touches, among which the deepest is looked for; chosen: a link in a fine mesh touches hundreds,
# each of which says how deep it is in that link, and not how far the link is from the outside
_MOST_TOUCHED = 32
_OUTSIDE, _INSIDE, _SURFACE = 0, 1, 2
_HAIR = 1e-9  # of a mesh's size by which triangles without area are widened; chosen, far below any clearance
_NO_SHIFT = np.zeros(3)
_AXES = np.concatenate((np.eye(3), -np.eye(3)), axis=1)
_EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])


class MeshSolid:
    """The triangles of a mesh and everything inside if they close, in its own frame; see `Solid`.

    Parameters
    ----------
    mesh: any triangle mesh [m].
    most: the greatest number of triangles.

    Raises
    ------
    InputError: it has more triangles than `most`.
    """

    ground = None
    voxels = None

    def __init__(self, mesh: trimesh.Trimesh, *, most: int) -> None:
        if len(mesh.faces) > most:
            raise too_fine(f"{len(mesh.faces)} triangles", most, hint="use a coarser mesh")
        self._vertices = np.asarray(mesh.vertices, dtype=float)
        self._faces = np.asarray(mesh.faces, dtype=np.intp)
        self._corners = self._vertices[self._faces]
        self._bodies = ClosedBodies(self._vertices, self._faces)
        self.is_full = len(self._bodies) > 0
        used = self._corners.reshape(-1, 3)
        self.bounds = np.array([used.min(axis=0), used.max(axis=0)])
        edges = np.linalg.norm(self._corners - np.roll(self._corners, 1, axis=1), axis=2)
        self.finest = max(float(np.median(edges)), 1e-4 * float(np.ptp(self.bounds, axis=0).max()))

    def __len__(self) -> int:
        return len(self._faces)

    @cached_property
    def _tree(self) -> Tree:
        return surface_tree(*_with_area(self._vertices, self._faces), most_touched=_MOST_TOUCHED)

    @cached_property
    def _cells(self) -> CellTree:
        return CellTree.of_triangles(self._corners)

    @cached_property
    def _tiles(self) -> tuple[Tiles, Array]:
        """The tiles of its triangles, and (3, 3, m) the triangles' corners in the tiles' order."""
        tiles = Tiles(self._corners.min(axis=1), self._corners.max(axis=1), _TILE * self.finest)
        return tiles, np.ascontiguousarray(self._corners[tiles.order].transpose(1, 2, 0))

    def prepare(self) -> None:
        """Build the trees, and find what is inside."""
        self._tree, self._cells, self._depths  # noqa: B018

    def prepare_near(self) -> None:
        """Sort the triangles into tiles, and find what is inside."""
        self._tiles, self._sides  # noqa: B018

    def taken(self, frame: GridFrame) -> Flags:
        """(frame.counts) which cells of a grid the mesh may touch."""
        return np.asarray(self._sides_in(frame) != _OUTSIDE)

    def _taken_by_surface(self, frame: GridFrame) -> Flags:
        parts = self._corners
        whole = []
        while True:
            large = np.ptp(parts, axis=1).max(axis=1) > 2.0 * frame.step
            whole.append(parts[~large])
            parts = parts[large]
            if not len(parts) or 4 * len(parts) > _MOST_PARTS:
                break
            a, b, c = parts[:, 0], parts[:, 1], parts[:, 2]
            ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
            quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
            parts = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
        parts = np.concatenate((*whole, parts))
        return frame.taken_by_boxes(parts.min(axis=1), parts.max(axis=1))

    @cached_property
    def _sides(self) -> tuple[GridFrame, Array]:
        """A grid around the mesh, and the side of each of its cells: outside, inside or surface."""
        low, high = self.bounds
        size = float((high - low).max())
        frame = GridFrame(low - 0.02 * size, high + 0.02 * size, least_step=size / _SIDE_CELLS)
        return frame, self._sides_in(frame)

    def _sides_in(self, frame: GridFrame) -> Array:
        """(frame.counts) the side of each cell of a grid: outside, inside or surface; an unknown one is surface."""
        surface = self._taken_by_surface(frame)
        if not self.is_full:
            return np.where(surface, _SURFACE, _OUTSIDE)
        from scipy import ndimage

        parts, count = ndimage.label(~surface)
        labels = parts.reshape(-1)
        sizes = np.bincount(labels, minlength=count + 1)[1:]
        a_cell = np.zeros(count + 1, dtype=np.intp)
        a_cell[labels] = np.arange(len(labels))
        largest = 1 + np.argsort(-sizes)[:_MOST_HOLLOWS]
        places = np.column_stack(np.unravel_index(a_cell[largest], parts.shape))
        side = np.full(count + 1, _SURFACE)
        inside = self._bodies.contain(frame.low + frame.step * (places + 0.5))
        side[largest] = np.where(inside, _INSIDE, _OUTSIDE)
        return np.asarray(side[parts])

    @cached_property
    def _depths(self) -> tuple[DistanceGrid, float]:
        """Lower bounds of the distance from outside, which is also all around the grid, and the grid's step [m]."""
        frame, side = self._sides
        return DistanceGrid(frame, side != _INSIDE, _EVERYWHERE), frame.step

    def _deep_inside(self, link: Placed) -> Reading | None:
        """The depth of a shape that has a point far inside the mesh; None if none of a few points is.

        Where a ball around a point of the shape is inside the mesh, the shape is not out before it has moved by the
        radius of the ball. The triangles that the shape touches may say much less.
        """
        if not self.is_full:
            return None
        points, (depths, step) = link.hull.T.dot(_points_within(len(link.hull))), self._depths
        found = depths.lower(points)
        deepest = int(found.argmax())
        depth, point = float(found[deepest]), points[:, deepest]
        if depth < _DEEP * step:
            return None
        around = depths.lower(point[:, None] + step * _AXES)
        slope = around[:3] - around[3:]
        size = float(np.linalg.norm(slope))
        if size == 0.0:
            return None  # in the middle of the mesh: no way out is nearer than another
        inwards = slope / size
        return Reading(-depth - link.radius, inwards, point + link.radius * inwards, point - depth * inwards)

    def _is_inside(self, points: Matrix) -> bool:
        """Whether a shape that touches no triangle, and contains `points` (k, 3), is inside the mesh."""
        if not self.is_full:
            return False
        near = points[((points > self.bounds[0]) & (points < self.bounds[1])).all(axis=1)]
        if len(near) < len(points):
            return False  # one of its points is outside, so all are
        frame, side = self._sides
        cell = np.floor((points - frame.low) / frame.step).astype(int)
        found = side[cell[:, 0], cell[:, 1], cell[:, 2]]
        clear = found[found != _SURFACE]
        return bool(clear[0] == _INSIDE if len(clear) else self._bodies.contain(points[:1])[0])

    @cached_property
    def cells(self) -> tuple[Any, ...]:
        """The arguments of `kept_over_cells` about the triangles, from `boxes` on."""
        frame, side = self._sides
        sides = side.reshape(-1).astype(np.uint8) if self.is_full else np.zeros(0, dtype=np.uint8)
        return *self._cells.arrays, frame.low, 1.0 / frame.step, frame.counts, sides

    def height_bounds(self, low: Vector, high: Vector) -> None:
        """None, because a mesh is not ground."""

    def measure(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from a convex shape if it is less than `reach` [m], otherwise None.

        For a shape inside a closed mesh that touches no triangle, it is minus the distance to the nearest one; for a
        shape with a point far inside, it is at least as deep as that point.
        """
        deep = self._deep_inside(link)
        if deep is not None:
            return deep
        found = self._nearest(link, reach)
        if found is not None and found.distance <= 0.0:
            return found
        if not self._is_inside(link.hull):
            return found
        reach = max(reach, self.finest)
        while found is None:
            reach *= 4.0
            found = self._nearest(link, reach)
        return Reading(-found.distance, -found.normal, found.point, found.other_point)

    def _nearest(self, link: Placed, reach: float) -> Reading | None:
        """The signed distance from the triangles if it is less than `reach` [m]; negative if the shape touches some."""
        is_known, found = self._cells.measure(link, reach)
        if is_known:
            return found
        T = link.shifted(_NO_SHIFT)
        return self._tree.depth(link.shape, T) or self._tree.measure(link.shape, T, reach)

    def deeper(self, link: Placed, found: Reading) -> Reading:
        """The reading `found`: nothing deeper is looked for."""
        return found

    def near(self, low: Vector, high: Vector, link: LinkReach | None = None) -> CellSet:
        """The triangles that may touch the box from `low` to `high` (3,) [m], and some other ones; see `Solid`."""
        tiles, ordered = self._tiles
        return CellSet.of_triangles(ordered.take(tiles.near(low, high, link), axis=2))

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m] and triangles (m, 3), reduced if there are more than `most`."""
        return clustered(self._vertices, self._faces, most)


def _with_area(vertices: Matrix, faces: Indices) -> tuple[Matrix, Indices]:
    """The same surface, with triangles without area widened by a hair.

    Coal has no normal of those for a ball, and takes its whole radius for its depth in them.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    flat = np.flatnonzero(~np.cross(b - a, c - a).any(axis=1))
    if not len(flat):
        return vertices, faces
    hair = max(_HAIR * float(np.ptp(vertices, axis=0).max()), 4.0 * float(np.spacing(np.abs(vertices).max())))
    a, b, c = a[flat], b[flat], c[flat]
    doubled = (a == b).all(axis=1)[:, None]
    beside = hair * np.eye(3)[np.abs(np.where(doubled, c, b) - a).argmin(axis=1)]  # nearly across their line
    b, c = np.where(doubled, b + beside, b), np.where(doubled, c, c + beside)
    c[(a == c).all(axis=1), 1] += hair  # of a point, which has been moved along x
    faces = faces.copy()
    faces[flat] = len(vertices) + np.arange(3 * len(flat)).reshape(-1, 3)
    return np.vstack((vertices, np.stack((a, b, c), axis=1).reshape(-1, 3))), faces


@cache
def _points_within(corners: int) -> Matrix:
    """(corners, m) weights of the corners of a hull for some points of it: its middle, and towards every corner."""
    middle = np.full((corners, 1), 1.0 / corners)
    towards = [middle + part * (np.eye(corners) - middle) for part in _TOWARDS_CORNERS]
    return np.hstack((middle, *towards))
