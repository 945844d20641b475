"""Lower bounds of the distances from what stands around, in many configurations at once, without asking coal.

Every piece of a link lies within a few balls. What stands around lies within a box in its own axes,
made rounder by its radius; the distance of a ball from that is exact, and of a link's piece it is at
least the least over its balls. Of a half-space it is that of the balls from its face. Where a ball may
touch, nothing is known. Nor is anything said of two pieces of the machine: to bound their distances in
the same way took as long as it saved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np

from backhoe_planner.arrays import Flags, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot, box_around, self_pieces
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.pairs.link_balls import LinkBalls

_MOST_BALLS = 4  # for one piece; chosen among 2 to 24: more leave fewer pairs to be measured, and take longer
_ROUNDING = 1e-9  # m: chosen far above what sums of a few products are off, and far below any clearance
TOGETHER = 64  # configurations; chosen: their bounds take a few MB where there are thousands of pairs


class BallBounds:
    """Bounds of the distances of P pairs.

    Parameters
    ----------
    own: how many pieces of the machine count: the first of `self_pieces`.
    bodies: the convex pieces around, numbered after these.
    first, second: (P,) the numbers of the pieces of each pair.
    asked: (P,) of which pairs anything is to be known.
    """

    def __init__(
        self, robot: Robot, own: int, bodies: Sequence[shapes.Piece],
        *, first: Indices, second: Indices, asked: Flags,
    ) -> None:  # fmt: skip
        self._kinematics, self._balls = balls_of(robot)
        self._pairs = len(first)
        self._around: list[tuple[Callable[[Matrix], Vector], Indices, Indices]] = []
        for body in np.unique(second[asked & (second >= own)]).tolist():
            pairs = np.flatnonzero(asked & (second == body))
            self._around.append((_distance_from(bodies[body - own]), pairs, first[pairs]))

    def of(self, q: Matrix) -> Iterator[Vector]:
        """(P,) lower bounds [m] for each of `q` (N, n), or minus infinity; obstacles stand where they did at first."""
        for start in range(0, len(q), TOGETHER):
            yield from self._of(q[start : start + TOGETHER])

    def _of(self, q: Matrix) -> Matrix:
        (level,) = self._balls.levels
        points = level.centres(self._balls.poses_of(self._kinematics.at(q))).reshape(3, -1)
        found = np.full((len(q), self._pairs), -np.inf)
        for distance, pairs, pieces in self._around:
            away = distance(points).reshape(len(q), -1)
            found[:, pairs] = level.least(away)[:, pieces]
        found -= _ROUNDING
        found[found <= 0.0] = -np.inf
        return found


@lru_cache(maxsize=8)
def balls_of(robot: Robot) -> tuple[BatchKinematics, LinkBalls]:
    """What bounds of a machine's distances begin with, whatever stands around it; neither keeps a state."""
    return BatchKinematics(robot), LinkBalls(self_pieces(robot), most=[_MOST_BALLS])


def _distance_from(body: shapes.Piece) -> Callable[[Matrix], Vector]:
    """Gives (M,) lower bounds of the distances of points (3, M) from a convex piece [m], world; inside 0 or less."""
    box = box_around(body)
    if box is None:
        normal = body.placement.rotation @ body.shape.n
        face = float(normal @ body.placement.translation) + float(body.shape.d)
        return lambda points: normal @ points - face
    R, middle, half, radius = box
    centre = (R.T @ middle)[:, None]

    def distance(points: Matrix) -> Vector:
        away = np.abs(R.T @ points - centre)
        away -= half[:, None]
        np.maximum(away, 0.0, out=away)
        away *= away
        return np.asarray(np.sqrt(away[0] + away[1] + away[2]) - radius)

    return distance
