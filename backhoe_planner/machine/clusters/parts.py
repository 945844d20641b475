"""A part of a cluster near a link: a box that contains its cells there; and the compiled search for such boxes."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.clusters.trees import Reading
from backhoe_planner.machine.shape.shapes import LateBox, Piece
from backhoe_planner.native import compiled


class Part:
    """A part of a cluster near a link: a box that contains it, and the distance from the link's placement then.

    Parameters
    ----------
    numbers: (50,) the numbers that describe it, see `boxes_of_cells`.

    Attributes
    ----------
    numbers: as above.
    """

    def __init__(self, numbers: Vector) -> None:
        self.numbers = numbers

    @staticmethod
    def of(box: Piece, reading: Reading, *, at_cell: bool = False) -> Part:
        """The part of a box (8 corners) with the reading of its distance."""
        (R, t), hull = box.pose, box.hull
        edges = np.sqrt(((hull[[1, 3, 4]] - hull[0]) ** 2).sum(axis=1))
        return Part(
            np.concatenate(([reading.distance], *reading[1:], R.reshape(-1), t, edges, hull.reshape(-1), [at_cell]))
        )

    @property
    def piece(self) -> Piece:
        """The box."""
        numbers = self.numbers
        return LateBox(numbers[22:25], numbers[10:19].reshape(3, 3), numbers[19:22], numbers[25:49].reshape(8, 3))

    @property
    def reading(self) -> Reading:
        """The distance, and the points between which it is."""
        numbers = self.numbers
        return Reading(float(numbers[0]), numbers[1:4], numbers[4:7], numbers[7:10])

    @property
    def at_cell(self) -> bool:
        """Whether the witness point is on an original cell, and not on a cube that replaces several cells."""
        return bool(self.numbers[49] > 0.0)


@compiled
def boxes_of_cells(
    hull: Matrix, R: Matrix, middle: Matrix, half: Vector, corners: Array, off: Vector, most: int,
    rules: tuple[float, ...], T_R: Matrix, T_t: Vector, /,
) -> tuple[Matrix, Indices] | None:  # fmt: skip
    """The boxes of `Cluster.around` around all cells of a set, one row of numbers each, and the cells in none of them.

    None if coal is needed: if the link touches or nearly touches a cell, and always in plain Python.

    The numbers are the distance from the link; the normal, the critical point and the witness point (3,) each; the
    axes (3, 3), the middle (3,), the edges (3,) and the corners (8, 3) of the box; and 1 if the witness point is on
    one of the cells, see `CellSet.is_cell`. All in the world [m].

    Parameters
    ----------
    hull, R: (k, 3) the link's points, and (3, 3) its axes, in the frame of the solid.
    middle, half, corners: of a `CellSet`; off: (K + T,) distances of its cells' middles from the link [m].
    most: the greatest number of boxes.
    rules: the link's radius [m], `slack` of `Cluster.around`, `Solid.finest` [m] and `_BEYOND`.
    T_R, T_t: (3, 3), (3,) placement of the solid [m].
    """
    return None


@compiled
def boxes_of_voxels(
    hull: Matrix, axes: Matrix, R: Matrix, t: Vector, T_R: Matrix, T_t: Vector, regions: Matrix,
    rules: tuple[float, ...], most: int, coarse: Matrix, coarse_origin: Vector, coarse_spread: Vector,
    coarse_tile: float, coarse_counts: Indices, coarse_number: Indices, coarse_start: Indices, coarse_middle: Matrix,
    coarse_size: Vector, keys: Array, base: Vector, edge: float, origin: Vector, spread: Vector, tile: float,
    counts: Indices, number: Indices, start: Indices, middle: Matrix, size: Vector, /,
) -> tuple[Matrix, Matrix, Vector, Vector] | None:  # fmt: skip
    """The boxes of `Cluster.around` around voxels near a link and, beyond some distance, around coarse cubes.

    Returns the numbers of the boxes, and the middles (3, k), half edges (k,) and distances (k,) [m] of the cells in
    none of them. None as for `boxes_of_cells`.

    Parameters
    ----------
    hull: (k, 3) the link's points in the frame of its body [m]; axes: (3, 3) of its shape there.
    R, t: (3, 3), (3,) placement of the body [m].
    T_R, T_t: (3, 3), (3,) placement of the solid [m].
    regions: (4, 3) lowest and highest corner of the region with coarse cubes, and of the solid [m].
    rules: of `boxes_of_cells`, then reach, the distance within which voxels count, and the edge of coarse cubes [m].
    coarse: (3, n) middles of coarse cubes, by tiles [m]; the next arguments are their tiles, see `cells_of_tiles`.
    keys: (3, m) integer keys of voxels, by tiles, with middles `edge` (keys + `base`) [m].
    """
    return None
