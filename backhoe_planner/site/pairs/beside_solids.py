"""Links beside scans and meshes: whether they keep their distances in many configurations, in one call.

If no ball around a link comes within its distance on the grid of lower bounds, the link keeps it. Smaller balls decide
most of the other cases. Beside a mesh, the rest is compared with its triangles; beside a scan it is left to coal, and
so is everything without a compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import Cluster, Distances, LinkPiece
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.link_balls import LinkBalls, Poses
from backhoe_planner.site.pairs.link_corners import UNKNOWN, LinkCorners


class BesideSolids:
    """Verdicts on K pieces of one machine beside solids that are no ground.

    Parameters
    ----------
    pieces: K of the machine's.
    balls: those that cover them, on two levels.
    """

    def __init__(self, pieces: Sequence[LinkPiece], balls: LinkBalls) -> None:
        self._corners = LinkCorners(pieces, balls)
        coarse, fine = balls.levels
        self._balls = *coarse.in_one, *fine.in_one

    def keep(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, least: Vector, bounds: Distances
    ) -> Indices:  # fmt: skip
        """(M,) verdicts: whether some pieces (M,) are at least `least` (M,) [m] from the cluster in configurations.

        After a piece that is nearer, the others of the same configuration are not known.

        rows: (M,) the configurations, in order.
        bounds: those of the cluster's distances.
        """
        if bounds.grid is None:
            return np.full(len(rows), UNKNOWN, dtype=np.intp)
        grid = *bounds.grid.arrays, bounds.bounds
        asked = *self._corners.asked(cluster, poses, rows, pieces, least), *self._balls, *grid
        triangles = cluster.solid.triangles
        if triangles is None:
            return kept_on_grid(*asked)
        arguments: Any = (*asked, *triangles)
        return kept_over_mesh(*arguments)


@compiled
def kept_on_grid(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    least: Vector, frame: Matrix, origin: Vector, coarse: Matrix, coarse_starts: Indices, fine: Matrix,
    fine_starts: Indices, low: Vector, per_step: float, counts: Indices, values: NDArray[np.float32], bounds: Matrix, /,
) -> Indices:  # fmt: skip
    """(M,) verdicts on pieces in configurations, see `BesideSolids.keep`. This plain version leaves all to coal.

    Parameters
    ----------
    R, ..., origin: the first arguments of `kept_over_ground`.
    coarse, coarse_starts, fine, fine_starts: balls as there, on two levels.
    low, ..., bounds: the last arguments of `lower_on_grid`.
    """
    return np.full(len(row), UNKNOWN, dtype=np.intp)


@compiled
def kept_over_mesh(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    least: Vector, frame: Matrix, origin: Vector, coarse: Matrix, coarse_starts: Indices, fine: Matrix,
    fine_starts: Indices, low: Vector, per_step: float, counts: Indices, values: NDArray[np.float32], bounds: Matrix,
    boxes: Matrix, triangles: Matrix, in_leaf: int, side_low: Vector, sides_per_step: float, side_counts: Indices,
    sides: NDArray[np.uint8], /,
) -> Indices:  # fmt: skip
    """(M,) verdicts on pieces in configurations, see `BesideSolids.keep`. This plain version leaves all to coal.

    Parameters
    ----------
    R, ..., bounds: as for `kept_on_grid`.
    boxes, triangles, in_leaf: as for `nearest_on_mesh`.
    side_low, sides_per_step, side_counts: (3,) lowest corner [m], cells per metre, and (3,) cells of a grid around it.
    sides: of all its cells, the last axis varying fastest: 0 outside, 1 inside, 2 at the surface. None, (0,), if the
        mesh has no inside.
    """
    return np.full(len(row), UNKNOWN, dtype=np.intp)
