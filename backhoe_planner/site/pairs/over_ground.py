"""Links over ground: whether they keep their distances in many configurations, and these distances, in one call.

A link that reaches into the ground, or whose lowest corner is too near to the ground straight below, needs no
further check; for the others, the cells around are checked. A link that is beside the map or reaches below its floor
is left to coal, and so is everything without a compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import Cluster, Distances, HeightMap, LinkPiece, Reading, surface_under
from backhoe_planner.native import compiled
from backhoe_planner.site.pairs.link_balls import LinkBalls, Poses
from backhoe_planner.site.pairs.link_corners import SUNK, UNKNOWN, LinkCorners, found_readings


class OverGround:
    """Distances between K pieces of one machine and ground.

    Parameters
    ----------
    pieces: K of the machine's.
    balls: those that cover them.
    """

    def __init__(self, pieces: Sequence[LinkPiece], balls: LinkBalls) -> None:
        self._corners = LinkCorners(pieces, balls)
        self._balls = balls.levels[0].in_one

    def keep(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, least: Vector, bounds: Distances
    ) -> Indices:  # fmt: skip
        """(M,) verdicts: whether some pieces (M,) are at least `least` (M,) [m] from the ground in some configurations.

        After a piece that is nearer, the others of the same configuration are not known. If the cluster is no ground,
        nothing is known.

        rows: (M,) the configurations, in order.
        bounds: those of the cluster's distances.
        """
        if cluster.solid.ground is None or bounds.heights is None:
            return np.full(len(rows), UNKNOWN, dtype=np.intp)
        asked = self._asked(cluster, cluster.solid.ground, poses, rows, pieces, least)
        arguments: Any = (*asked, *self._balls, *bounds.heights.rings, bounds.bounds)
        return kept_over_ground(*arguments)

    def measure(
        self, cluster: Cluster, poses: Poses, rows: Indices, pieces: Indices, reach: Vector, *, sunk: bool = False
    ) -> list[Reading | Literal["far"] | None]:
        """M distances of some pieces (M,) in some configurations `rows` (M,) from the ground, within `reach` (M,) [m].

        "far" if a distance is not less than its reach, None if it is not known.

        sunk: whether the depth of a piece with corners in the ground is that of its lowest corner under the plane of
            the ground above it, instead of that in the deepest triangle, which takes a hundred times as long.
        """
        if cluster.solid.ground is None:
            return [None] * len(rows)
        states, found = read_over_ground(*self._asked(cluster, cluster.solid.ground, poses, rows, pieces, reach))
        return found_readings(states, found, sunk=sunk)

    def _asked(
        self, cluster: Cluster, ground: HeightMap, poses: Poses, rows: Indices, pieces: Indices, number: Vector
    ) -> Any:  # fmt: skip
        """The arguments of `read_over_ground`."""
        return (
            *self._corners.asked(cluster, poses, rows, pieces, number),
            ground.heights, ground.x, ground.y, (ground.floor, ground.top),
        )  # fmt: skip


@compiled
def kept_over_ground(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    least: Vector, frame: Matrix, origin: Vector, heights: Matrix, x: Vector, y: Vector, levels: tuple[float, float],
    balls: Matrix, ball_starts: Indices, low: Vector, per_cell: Vector, counts: Indices, highest: NDArray[np.float32],
    squared_aside: Vector, furthest: float, bounds: Matrix, /,
) -> Indices:  # fmt: skip
    """(M,) verdicts on pieces in configurations, see `OverGround.keep`. This plain version leaves all to coal.

    Parameters
    ----------
    R, t: (N, J, 3, 3) and (N, J, 3) T_world_joint [m].
    slot: (K,) which of the joints carries each piece.
    corners: (P, 3) points of the pieces one after the other in the frames of these joints [m]; those of piece k begin
        at `starts[k]`, (K + 1,), and the piece is within `radius[k]`, (K,), of their convex hull [m].
    row, piece, least: (M,) each.
    frame, origin: (3, 3) and (3,) T_world_ground [m].
    heights, x, y: (rows, columns) [m] at y (rows,) and x (columns,), each evenly spaced.
    levels: how far down the ground reaches, and how far up [m].
    balls: (S, 4) centres of balls that cover the pieces, in the frames of the joints, and radii [m]; those of piece k
        begin at `ball_starts[k]`, (K + 1,). The others are arguments of `lower_over_heights`.
    """
    return np.full(len(row), UNKNOWN, dtype=np.intp)


@compiled
def read_over_ground(
    R: Array, t: Array, slot: Indices, corners: Matrix, starts: Indices, radius: Vector, row: Indices, piece: Indices,
    reach: Vector, frame: Matrix, origin: Vector, heights: Matrix, x: Vector, y: Vector, levels: tuple[float, float], /,
) -> tuple[Indices, Matrix]:  # fmt: skip
    """(M,) states of distances from the ground, and (M, 10) each distance as a `Reading`.

    A state is 1 if the distance is read, 0 if it is not less than `reach` (M,) [m], 2 if a corner is in the ground and
    its depth is read, -1 if it is not known. This plain version reads only depths and leaves the others to coal. The
    arguments are the first of `kept_over_ground`.
    """
    states, found = np.full(len(row), UNKNOWN, dtype=np.intp), np.zeros((len(row), 10))
    for k, (at, which) in enumerate(zip(row.tolist(), piece.tolist(), strict=True)):
        joint = slot[which]
        points = corners[starts[which] : starts[which + 1]] @ R[at, joint].T + t[at, joint]
        points = (points - origin) @ frame
        points = points[points[:, 2] >= levels[0]]
        height, slopes = surface_under(points, heights, x, y)
        above = points[:, 2] - height
        if not (above <= 0.0).any():
            continue
        low = int(above.argmin())
        normal = np.array([*slopes[low], -1.0]) / np.sqrt(1.0 + slopes[low] @ slopes[low])
        distance = -above[low] * normal[2] - radius[which]
        point = points[low] + radius[which] * normal
        states[k] = SUNK
        found[k] = (
            distance,
            *(frame @ normal),
            *(frame @ point + origin),
            *(frame @ (point + distance * normal) + origin),
        )
    return states, found
