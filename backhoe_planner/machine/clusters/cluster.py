"""An obstacle of thousands of cells that is measured as one: a scan, a terrain or a fine mesh at its placement.

It answers three questions, each in the fastest way:

- How far is it from many points at least? A grid of lower bounds takes one look-up for each point; for
  ground the heights around the point are used.
- How far is it exactly, within a reach? Trees of coal descend only where it matters.
- Which parts of it are around a link, as few convex pieces? See `Cluster.around`.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Indices, Matrix, Vector
from backhoe_planner.machine.clusters.cell_set import CellSet, CoarseCells
from backhoe_planner.machine.clusters.distance_grid import DistanceGrid, GridFrame, off_box
from backhoe_planner.machine.clusters.height_bounds import HeightBounds
from backhoe_planner.machine.clusters.link_box import LinkBox, LinkReach
from backhoe_planner.machine.clusters.parts import Part, boxes_of_cells, boxes_of_voxels
from backhoe_planner.machine.clusters.solid import Placed, Solid
from backhoe_planner.machine.clusters.trees import Reading
from backhoe_planner.machine.shape.convex import voxel_boxes
from backhoe_planner.machine.shape.shapes import Gauge, Piece, box, transform

_AROUND = 1.5  # m around the solid that its grid covers; chosen, further away the box around it is exact enough
_FINE_WITHIN = 2.5  # coarse edges from a link, 0.25 m or more, within which single cells are used; chosen
_HALF_DIAGONAL = 0.5 * 3.0**0.5  # of a cube, in edges
_COARSE = 0.1  # m, edge of the cells that are used further away; chosen
_FINE_AT_MOST = 0.6  # m from a link within which single cells are used on demand; chosen
_BEYOND = 1e-9  # m by which a cell that counts as behind a plane may reach across it


class Cluster:
    """A solid of many cells at its placement in the world.

    Parameters
    ----------
    solid: in its own frame.
    placement: T_world_solid.
    """

    def __init__(self, solid: Solid, placement: pin.SE3) -> None:
        self.solid, self.placement = solid, placement
        self._R, self._t = np.array(placement.rotation), np.array(placement.translation)
        self._is_upright = bool((np.eye(3) == self._R).all())
        self._bounds: dict[bytes, tuple[DistanceGrid | None, HeightBounds | None]] = {}
        self._coarser: dict[bytes, CoarseCells] = {}
        self._coarse_of: tuple[object, CoarseCells | None] = None, None  # the latest ball and its cells

    def __len__(self) -> int:
        return len(self.solid)

    def shifted(self, by: Vector) -> Cluster:
        """The same cluster, shifted `by` (3,) [m]."""
        return Cluster(self.solid, pin.SE3(self._R, self._t + by))

    def moved_to(self, placement: pin.SE3) -> Cluster:
        """The same solid at another placement, with the structures that were built to measure it."""
        found = Cluster(self.solid, placement)
        found._bounds.update(self._bounds)
        found._coarser.update(self._coarser)
        return found

    @property
    def bounds(self) -> Matrix:
        """(2, 3) lowest and highest corner of a box around it [m], world."""
        low, high = self.solid.bounds
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        centre, reach = self._R @ middle + self._t, np.abs(self._R) @ half
        return np.array([centre - reach, centre + reach])

    # --- bounds --------------------------------------------------------------------------

    def grid(self, centre: Vector, radius: float) -> Distances:
        """Lower bounds of the distance, finest within `radius` [m] of `centre` (3,), world; kept for later calls."""
        middle = (centre - self._t) @ self._R
        low = np.maximum(middle - radius, self.solid.bounds[0] - _AROUND)
        high = np.minimum(middle + radius, self.solid.bounds[1] + _AROUND)
        if (high <= low).any():
            return Distances(self._R, self._t, None, None, self.solid.bounds, self._is_upright)
        key = np.round(np.concatenate((low, high)), 6).tobytes()
        if key not in self._bounds:
            self._bounds[key] = self._make_bounds(low, high)
        return Distances(self._R, self._t, *self._bounds[key], self.solid.bounds, self._is_upright)

    def _make_bounds(self, low: Vector, high: Vector) -> tuple[DistanceGrid | None, HeightBounds | None]:
        """Bounds in the box from `low` to `high` (3,) [m]: from the heights for ground, otherwise from a grid."""
        heights = self.solid.height_bounds(low, high)
        if heights is not None:
            return None, heights
        frame = GridFrame(low, high, least_step=self.solid.finest)
        return DistanceGrid(frame, self.solid.taken(frame), self.solid.bounds), None

    def prepare(self, centre: Vector, radius: float) -> None:
        """Build in advance what is needed to measure within `radius` [m] of `centre` (3,), world."""
        self.grid(centre, radius)
        away = (centre - self._t) @ self._R
        if (np.maximum(self.solid.bounds[0] - away, away - self.solid.bounds[1]) < radius).all():
            self.solid.prepare()

    def prepare_boxes(self, ball: tuple[Vector, float]) -> None:
        """Build in advance what `grid` and `around` need for links within a ball, centre (3,) and radius [m], world."""
        self.grid(*ball)
        self._coarse(ball)
        self.solid.prepare_near()

    # --- distances -----------------------------------------------------------------------

    def _local(self, piece: Piece, T_world_body: pin.SE3, shift: Vector) -> Placed:
        R = self._R.T.dot(T_world_body.rotation)
        return Placed(piece, R, (T_world_body.translation - self._t - shift).dot(self._R))

    def measure(
        self, piece: Piece, T_world_body: pin.SE3, reach: float = np.inf, *, shift: Vector | None = None
    ) -> Reading | None:
        """The signed distance from a convex piece of a body; None if it is not less than `reach` [m].

        For a piece that touches cells it is minus the depth in the deepest cell. The ground and a closed mesh are
        solid between their cells, too: a piece inside that touches no cell is as deep as the nearest cell is away. In
        the ground, the depth of its lowest corner under the surface counts if it is more. The true depth is not less.

        Parameters
        ----------
        T_world_body: placement of the body.
        shift: (3,) how far the cluster has moved [m].
        """
        shift = _NO_SHIFT if shift is None else shift
        link = self._local(piece, T_world_body, shift)
        found = self.solid.measure(link, reach)
        if found is None:
            return None
        if found.distance < 0.0:
            found = self.solid.deeper(link, found)
        base = self._t + shift
        return Reading(
            found.distance, self._R @ found.normal, self._R @ found.point + base, self._R @ found.other_point + base
        )

    # --- cells around a link ----------------------------------------------------------------

    def around(
        self, piece: Piece, T_world_body: pin.SE3, reach: float, *, ball: tuple[Vector, float], most: int,
        slack: float, exact: float = 0.0, ground: Part | None = None,
    ) -> Around:  # fmt: skip
        """All cells within `reach` [m] of a convex piece of a body, in a few boxes.

        Between the piece and its nearest cell is a gap with parallel planes on both sides. All cells that are
        wholly behind the plane at the cell, or nearly so, go into one box, with a face on that plane. The nearest
        cell of those that are left gives the next box, and so on. The boxes contain all the cells, so that distances
        from the boxes are not more than those from the cells. At the present placement of the piece they are at least
        1 - `slack` times those within `_FINE_WITHIN` edges of a coarse cell; further away they are less by at most the
        edge of a coarse cell.

        Parameters
        ----------
        T_world_body: placement of the body.
        exact: distance up to which single cells are used, too, so that no coarse cube comes nearer than this [m].
        ball: centre (3,) and radius [m] of the region that the machine can reach, world.
        ground: from `ground_under` for the same reach. Cells behind its face are in it, and in no other box.
        slack: part of the distance by which a plane may be nearer, so that it has more cells behind it; with a smaller
            slack there are more boxes.
        most: the greatest number of boxes. If more are needed, the cells left are further away than `covered` [m].
        """
        *_, found = self.around_bit_by_bit(
            piece, T_world_body, reach, ball=ball, most=most, slack=slack, exact=exact, ground=ground
        )
        assert found is not None
        return found

    def around_bit_by_bit(
        self, piece: Piece, T_world_body: pin.SE3, reach: float, *, ball: tuple[Vector, float], most: int,
        slack: float, exact: float, ground: Part | None = None,
    ) -> Iterator[Around | None]:  # fmt: skip
        """`around` in steps of some 50 to 100 us: yields None after each step, and the result at the end.

        It takes two or three steps, and one for each box if `boxes_of_cells` leaves them to coal.
        """
        quick = None
        if ground is None:
            quick = self._quick_boxes(piece, T_world_body, reach, self._coarse(ball), most, slack, exact)
        if quick is not None and not len(quick[2]):
            yield Around(tuple(quick[0]), reach)
            return
        link = self._local(piece, T_world_body, _NO_SHIFT)
        if quick is None:
            cells, off = yield from self._cells_around(link, reach, ball, exact)
            if ground is not None:
                n = ground.reading.normal @ self._R
                face = float((ground.reading.other_point - self._t) @ ground.reading.normal)
                above = (cells.least_along(n) < face - _BEYOND).nonzero()[0]
                cells, off = cells.only(above), off.take(above)
            parts, cells, off = yield from self._boxes_of(cells, off, link, most, slack)
        else:
            parts, cells, off = quick
        if not len(off):
            yield Around(tuple(parts), reach)
            return
        around = self._box(cells, link.R)
        T_box = transform(around.placement.rotation, around.placement.translation)
        T_here = transform(self._R @ link.R, self._R @ link.t + self._t)
        rest = Part.of(around, Reading(*Gauge().measure(link.shape, T_here, around.shape, T_box)))
        yield Around(tuple(parts), min(reach, float((off - cells.around()[1]).min())), rest)

    def _quick_boxes(
        self, piece: Piece, T_world_body: pin.SE3, reach: float, coarse: CoarseCells, most: int, slack: float,
        exact: float,
    ) -> tuple[list[Part], CellSet, Vector] | None:  # fmt: skip
        """The boxes around voxels, the cells in none of them, and the distances of these; None if coal is needed."""
        cubes, voxels = coarse.cubes, self.solid.voxels
        if cubes is None or voxels is None:
            return None
        rules = piece.radius, slack, self.solid.finest, _BEYOND, reach, _fine_within(coarse.step, exact), coarse.step
        found = boxes_of_voxels(
            piece.hull, piece.pose[0], T_world_body.rotation, T_world_body.translation, self._R, self._t,
            coarse.regions, rules, most, *cubes, *voxels,
        )  # fmt: skip
        if found is None:
            return None
        numbers, middle, half, off = found
        return list(map(Part, numbers)), CellSet(middle, half, _NO_TRIANGLES), off

    def _boxes_of(
        self, cells: CellSet, off: Vector, link: Placed, most: int, slack: float
    ) -> Generator[None, None, tuple[list[Part], CellSet, Vector]]:
        """The boxes around cells, the cells that are in none of them, and the distances `off` of these.

        None is yielded between steps of the work.
        """
        quick = boxes_of_cells(
            link.hull, link.R, cells.middle, cells.half, cells.corners, off, most,
            (link.radius, slack, self.solid.finest, _BEYOND), self._R, self._t,
        )  # fmt: skip
        if quick is not None:
            return list(map(Part, quick[0])), cells.only(quick[1]), off.take(quick[1])
        gauge, T_link = Gauge(), transform(link.R, link.t)
        parts: list[Part] = []
        while len(off) and len(parts) < most:
            nearest = int(off.argmin())
            distance, n, x_link, x_cell = cells.measure(nearest, gauge, link.shape, T_link)
            own, left, before = cells.split(n, nearest, slack * max(distance, 0.0) + _BEYOND)
            part = cells if len(own) == len(off) else cells.only(own)
            distance += before
            box_of = self._box(part, _frame_along(n, link.R))
            at_cell = cells.is_cell(nearest, self.solid.finest)
            parts.append(Part.of(box_of, self._placed(Reading(distance, n, x_link, x_cell)), at_cell=at_cell))
            cells, off = cells.only(left), off.take(left)
            yield None
        return parts, cells, off

    def _box(self, cells: CellSet, axes: Matrix) -> Piece:
        """The box around cells along `axes` (3, 3) of the solid's frame, in the world."""
        start, end = cells.extent(axes)
        end = np.maximum(end, start + self.solid.finest)
        R = axes if self._is_upright else self._R @ axes
        return box(end - start, pin.SE3(R, R @ (0.5 * (start + end)) + self._t))

    def _placed(self, reading: Reading) -> Reading:
        """A reading in the frame of the solid, transformed to the world."""
        base, (distance, n, x_link, x_cell) = self._t, reading
        if self._is_upright:
            return Reading(distance, n, x_link + base, x_cell + base)
        return Reading(distance, self._R @ n, self._R @ x_link + base, self._R @ x_cell + base)

    def _cells_around(
        self, link: Placed, reach: float, ball: tuple[Vector, float], exact: float
    ) -> Generator[None, None, tuple[CellSet, Vector]]:
        """The cells within a reach of a link, with coarse cubes further away, and the distances of their middles.

        None is yielded between steps of the work.
        """
        coarse, around = self._coarse(ball), LinkBox.around(link.hull, link.R, link.radius)
        fine_within = _fine_within(coarse.step, exact)
        box = link.box(reach)
        if reach <= fine_within or not coarse.hold(*box):
            near = self.solid.near(*box, LinkReach(around, reach))
            yield None
            return _within(near, around, reach)
        cubes = coarse.near(*box, LinkReach(around, reach + coarse.step))
        away = around.off(cubes)
        outer = ((away > fine_within) & (away <= reach + coarse.step)).nonzero()[0]
        # cells in none of these cubes are in a cube whose middle is nearer
        fine = fine_within + _HALF_DIAGONAL * coarse.step
        if not (away <= fine_within).any():
            return CellSet.of_cubes(cubes.take(outer, axis=1), 0.5 * coarse.step), away.take(outer)
        near = self.solid.near(*link.box(fine), LinkReach(around, fine))
        yield None
        cells, off = _within(near, around, fine)
        if not len(outer):
            return cells, off
        both = cells.together(CellSet.of_cubes(cubes.take(outer, axis=1), 0.5 * coarse.step))
        # cubes precede triangles
        first = len(cells.half)
        return both, np.concatenate((off[:first], away.take(outer), off[first:]))

    def ground_under(self, piece: Piece, T_world_body: pin.SE3, reach: float) -> Part | None:
        """For a piece of a body that is in the ground: a box that contains the ground under and beside it.

        Its face is level with the surface over the piece, so that the direction out is up. From below the surface,
        or within it, single cells would push the piece down or aside. The box contains all cells within `reach` [m]
        that are not above that face. None for a piece that is not in the ground, or if the solid is not ground.
        """
        link = self._local(piece, T_world_body, _NO_SHIFT)
        if self.solid.ground is None:
            return None
        touching = self.solid.measure(link, 0.0)
        if touching is None or touching.distance >= 0.0:
            return None
        low, high = link.box(0.0)
        size = float((high - low).max()) + reach
        cells = self.solid.near(low - reach, high + np.array((reach, reach, size)))
        middle, _ = cells.around()
        more = self.solid.finest
        beside = np.maximum(low[:2, None] - middle[:2], middle[:2] - high[:2, None])
        over = (beside.max(axis=0) <= more).nonzero()[0]
        if not len(over):
            return None
        above = middle.take(over, axis=1)
        above -= above.mean(axis=1)[:, None]
        slope = np.linalg.lstsq(above[:2].T, above[2], rcond=1e-3)[0]
        n = np.array([*np.clip(slope, -1.0, 1.0), -1.0])
        n /= math.sqrt(float(n @ n))
        along = cells.least_along(n)
        plane = float(along[over].min())
        own = (along >= plane - more - _BEYOND).nonzero()[0]
        plane = float(along[own].min())
        deepest = int((link.hull @ n).argmax())
        x_link = link.hull[deepest] + link.radius * n
        distance = plane - float(x_link @ n)
        if distance >= 0.0:
            return None
        axes = _frame_along(n, link.R)
        start, end = cells.only(own).extent(axes)
        at = link.hull @ axes
        more_aside = size - distance
        start = np.minimum(start, at.min(axis=0) - link.radius - more_aside)
        end = np.maximum(end, at.max(axis=0) + link.radius + more_aside)
        start[0] = plane
        R = self._R @ axes
        placed = box(end - start, pin.SE3(R, R @ (0.5 * (start + end)) + self._t))
        return Part.of(placed, self._placed(Reading(distance, n, x_link, x_link + distance * n)))

    def inside_of(self, piece: Piece, T_world_body: pin.SE3) -> Part | None:
        """For a piece of a body that is in the ground or in a closed mesh and touches no cell: a box around it.

        The box ends at the nearest cell. None for a piece that is not inside.
        """
        link = self._local(piece, T_world_body, _NO_SHIFT)
        found = self.solid.measure(link, 0.0)
        if found is None or found.distance >= 0.0:
            return None
        axes = _frame_along(found.normal, link.R)
        at = link.hull @ axes
        start, end = at.min(axis=0) - link.radius, at.max(axis=0) + link.radius
        size = float((end - start).max())
        start[1:] -= size
        end += size
        start[0] = float(found.other_point @ found.normal)
        R = self._R @ axes
        placed = box(end - start, pin.SE3(R, R @ (0.5 * (start + end)) + self._t))
        return Part.of(placed, self._placed(found))

    def _coarse(self, ball: tuple[Vector, float]) -> CoarseCells:
        """The surface of the solid in cubes, within a ball."""
        for_ball, found = self._coarse_of
        if found is None or for_ball is not ball:
            found = self._make_coarse(ball)
            self._coarse_of = ball, found
        return found

    def _make_coarse(self, ball: tuple[Vector, float]) -> CoarseCells:
        middle = (ball[0] - self._t) @ self._R
        step = max(_COARSE, 2.0 * self.solid.finest)
        low = np.maximum(middle - ball[1] - _AROUND, self.solid.bounds[0])
        high = np.minimum(middle + ball[1] + _AROUND, self.solid.bounds[1])
        key = np.round(np.concatenate((low, high)), 6).tobytes()
        if key not in self._coarser:
            if (high < low).any():
                self._coarser[key] = CoarseCells(np.zeros((0, 3)), step, (low, high), self.solid.bounds)
            else:
                from scipy.ndimage import binary_erosion

                frame = GridFrame(low, np.maximum(high, low + step), least_step=step)
                taken = self.solid.taken(frame)
                taken &= ~binary_erosion(taken)
                cubes = frame.low + frame.step * np.argwhere(taken)
                self._coarser[key] = CoarseCells(cubes, frame.step, (low, high), self.solid.bounds)
        return self._coarser[key]

    def boxes(self, cells: int) -> tuple[Piece, ...]:
        """Boxes that contain the cluster, merged from the cells of a grid around it with about `cells` cells."""
        low, high = self.solid.bounds
        size = np.maximum(high - low, self.solid.finest)
        frame = GridFrame(low, high, least_step=max(float(np.prod(size) / cells) ** (1.0 / 3.0), self.solid.finest))
        found = voxel_boxes(np.argwhere(self.solid.taken(frame)).astype(float) + 0.5, 1.0)
        return tuple(
            box(frame.step * size, self.placement * pin.SE3(np.eye(3), frame.low + frame.step * centre))
            for centre, size in found
        )

    def drawing(self, most: int) -> tuple[Matrix, Indices]:
        """Vertices (k, 3) [m], world, and triangles (m, 3) of its surface, about `most` at most."""
        vertices, triangles = self.solid.drawing(most)
        return vertices @ self._R.T + self._t, triangles


@dataclass(frozen=True)
class Around:
    """The cells around a link: `parts` contain all cells that are within `covered` [m] of it.

    Attributes
    ----------
    rest: a box around the other cells within the requested reach; None if the parts contain all.
    """

    parts: tuple[Part, ...]
    covered: float
    rest: Part | None = None


@dataclass(frozen=True)
class Distances:
    """Lower bounds of the distance from a cluster at R (3, 3), t (3,) [m]; upright if R is the identity."""

    R: Matrix
    t: Vector
    grid: DistanceGrid | None
    heights: HeightBounds | None
    bounds: Matrix
    is_upright: bool

    def lower(self, points: Matrix, shift: Matrix | None = None) -> Vector:
        """(k,) lower bounds of the distance of points (3, k), world [m]; 0 where nothing is known.

        shift: (3, k) how far the cluster has moved, for each point [m].
        """
        own = points - self.t[:, None]
        if shift is not None:
            own -= shift
        if not self.is_upright:
            own = self.R.T @ own
        if self.grid is not None:
            return self.grid.lower(own)
        return off_box(own, self.bounds) if self.heights is None else self.heights.lower(own, self.bounds)


def _fine_within(step: float, exact: float) -> float:
    """Distance from a link within which single cells are used; beyond it, coarse ones with an edge `step` [m]."""
    return max(_FINE_WITHIN * step, min(exact + 2.0 * _HALF_DIAGONAL * step, _FINE_AT_MOST))


_NO_SHIFT = np.zeros(3)
_NO_TRIANGLES = np.zeros((3, 3, 0))
_HERE = transform(np.eye(3), np.zeros(3))


def _within(cells: CellSet, link: LinkBox, reach: float) -> tuple[CellSet, Vector]:
    """The cells that are within `reach` of a link [m], and the distances of their middles."""
    middle, radius = cells.around()
    off = link.off(middle)
    near = (off - radius <= reach).nonzero()[0]
    return cells.only(near), off.take(near)


def _frame_along(n: Vector, R: Matrix) -> Matrix:
    """(3, 3) axes: the first is along `n`, the second across it and as near as possible to one of those of `R`."""
    x, y, z = n.tolist()
    best, second = -1.0, (0.0, 0.0, 0.0)
    for a, b, c in R.T.tolist():
        along = a * x + b * y + c * z
        a, b, c = a - along * x, b - along * y, c - along * z
        size = a * a + b * b + c * c
        if size > best:
            best, second = size, (a, b, c)
    size = math.sqrt(best)
    a, b, c = (part / size for part in second)
    return np.array(((x, a, y * c - z * b), (y, b, z * a - x * c), (z, c, x * b - y * a)))
