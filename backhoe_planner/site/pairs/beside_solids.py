"""Links beside scans and meshes in many configurations: bounds of their distances, and verdicts, in one call.

A few balls around a link, and smaller ones where these are too near, bound its distance on the grid of lower bounds.
Verdicts come from the solid's own cells where the grid does not decide; they are left to coal without a compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import Cluster, Distances, LinkPiece, Reading, lower_on_grid
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.link_balls import LinkBalls, Poses
from backhoe_planner.site.pairs.link_corners import UNKNOWN, LinkCorners, found_readings


class BesideSolids:
    """K pieces of one machine beside solids that are no ground.

    Parameters
    ----------
    pieces: K of the machine's.
    balls: those that cover them, on two levels.
    """

    def __init__(self, pieces: Sequence[LinkPiece], balls: LinkBalls) -> None:
        self._corners = LinkCorners(pieces, balls)
        coarse, fine = balls.levels
        self._balls = *coarse.in_one, *fine.in_one

    def lower(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, needed: Vector, bounds: Distances
    ) -> Vector:  # fmt: skip
        """(M,) lower bounds of the distances of pieces (M,) from the cluster in configurations `rows` (M,) [m].

        A bound that is at least `needed` (M,) [m] may be far below the distance; one of 0 or less says nothing.

        bounds: those of the cluster's distances.
        """
        if bounds.grid is None:
            return np.full(len(rows), -np.inf)
        arguments: Any = self._asked(cluster, poses, rows, pieces, needed, bounds)
        return least_on_grid(*arguments)

    def keep(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, least: Vector, bounds: Distances
    ) -> Indices:  # fmt: skip
        """(M,) verdicts: whether some pieces (M,) are at least `least` (M,) [m] from a solid in some configurations.

        After a piece that is nearer, the others of the same configuration are not known. If the cluster is ground,
        nothing is known.

        rows: (M,) the configurations, in order.
        bounds: those of the cluster's distances.
        """
        cells = cluster.solid.cells
        if cells is None or bounds.grid is None:
            return np.full(len(rows), UNKNOWN, dtype=np.intp)
        arguments: Any = (*self._asked(cluster, poses, rows, pieces, least, bounds), *cells)
        return kept_over_cells(*arguments)

    def measure(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, reach: Vector
    ) -> list[Reading | Literal["far"] | None]:
        """M distances of some pieces (M,) in configurations `rows` (M,) from a solid, within `reach` (M,) [m].

        "far" if a distance is not less than its reach, None if it is not known: where they touch, and without a
        compiler.
        """
        if cluster.solid.cells is None:
            return [None] * len(rows)
        arguments: Any = (*self._corners.asked(cluster, poses, rows, pieces, reach), *cluster.solid.cells)
        return found_readings(*read_over_cells(*arguments))

    def _asked(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, number: Vector, bounds: Distances
    ) -> tuple[Any, ...]:  # fmt: skip
        """The arguments of `least_on_grid`."""
        assert bounds.grid is not None
        asked = self._corners.asked(cluster, poses, rows, pieces, number)
        return *asked, *self._balls, *bounds.grid.arrays, bounds.bounds


@compiled
def least_on_grid(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    needed: Vector, frame: Matrix, origin: Vector, coarse: Matrix, coarse_starts: Indices, fine: Matrix,
    fine_starts: Indices, low: Vector, per_step: float, counts: Indices, values: NDArray[np.float32], bounds: Matrix, /,
) -> Vector:  # fmt: skip
    """(M,) lower bounds of the distances of pieces in configurations, see `BesideSolids.lower` [m].

    Parameters
    ----------
    R, ..., origin: the first arguments of `kept_over_ground`.
    coarse, coarse_starts, fine, fine_starts: balls as there, on two levels; the second is used if the first gives less
        than `needed` (M,) [m].
    low, ..., bounds: the last arguments of `lower_on_grid`.
    """
    found = np.empty(len(row))
    for k, (at, which) in enumerate(zip(row.tolist(), piece.tolist(), strict=True)):
        place, least = (at, slot[which]), -np.inf
        for balls, firsts in ((coarse, coarse_starts), (fine, fine_starts)):
            own = balls[firsts[which] : firsts[which + 1]]
            centres = (own[:, :3] @ R[place].T + t[place] - origin) @ frame
            away = lower_on_grid(np.ascontiguousarray(centres.T), low, per_step, counts, values, bounds) - own[:, 3]
            least = max(least, float(away.min(initial=np.inf)))
            if least >= needed[k]:
                break
        found[k] = least
    return found


@compiled
def kept_over_cells(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    least: Vector, frame: Matrix, origin: Vector, coarse: Matrix, coarse_starts: Indices, fine: Matrix,
    fine_starts: Indices, low: Vector, per_step: float, counts: Indices, values: NDArray[np.float32], bounds: Matrix,
    boxes: Matrix, cells: Matrix, in_leaf: int, half: float, side_low: Vector, sides_per_step: float,
    side_counts: Indices, sides: NDArray[np.uint8], /,
) -> Indices:  # fmt: skip
    """(M,) verdicts on pieces in configurations, see `BesideSolids.keep`. This plain version leaves all to coal.

    Parameters
    ----------
    R, ..., bounds: as for `least_on_grid`.
    boxes, cells, in_leaf, half: as for `nearest_on_cells`.
    side_low, sides_per_step, side_counts: (3,) lowest corner [m], cells per metre, and (3,) cells of a grid around it.
    sides: of all its cells, the last axis varying fastest: 0 outside, 1 inside, 2 at the surface. None, (0,), if it
        has no inside.
    """
    return np.full(len(row), UNKNOWN, dtype=np.intp)


@compiled
def read_over_cells(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    reach: Vector, frame: Matrix, origin: Vector, boxes: Matrix, cells: Matrix, in_leaf: int, half: float,
    side_low: Vector, sides_per_step: float, side_counts: Indices, sides: NDArray[np.uint8], /,
) -> tuple[Indices, Matrix]:  # fmt: skip
    """(M,) states of distances from the cells, and (M, 10) each distance as a `Reading`; see `read_over_ground`.

    This plain version leaves all to coal. The arguments are the first of `kept_over_ground` and the last of
    `kept_over_cells`.
    """
    return np.full(len(row), UNKNOWN, dtype=np.intp), np.zeros((len(row), 10))
