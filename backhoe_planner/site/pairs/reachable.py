"""Pairs that the machine can bring near at all, found by a ball that no part of it ever leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from backhoe_planner.arrays import Indices, Vector
from backhoe_planner.machine.shape import shapes


def distances_from_ball(bodies: Sequence[shapes.Piece], centre: Vector, radius: float) -> Vector:
    """(B,) lower bounds of the distance of convex pieces from a ball about `centre` (3,) [m].

    They are the distances of the axis-aligned boxes around the pieces. For a half-space the bound is exact. It is
    minus infinity inside the ball.
    """
    found = np.full(len(bodies), -np.inf)
    bounded = [index for index, body in enumerate(bodies) if len(body.hull)]
    if bounded:
        hulls = [bodies[index].hull for index in bounded]
        starts = np.cumsum([0, *(len(hull) for hull in hulls[:-1])])
        points, fat = np.vstack(hulls), np.array([bodies[index].radius for index in bounded])[:, None]
        low, high = np.minimum.reduceat(points, starts) - fat, np.maximum.reduceat(points, starts) + fat
        away = np.maximum(np.maximum(low - centre, centre - high), 0.0)
        found[bounded] = np.sqrt((away**2).sum(axis=1)) - radius
    for index, body in enumerate(bodies):
        if not len(body.hull):
            n = body.placement.rotation @ body.shape.n
            found[index] = n @ (centre - body.placement.translation) - body.shape.d - radius
    return np.where(found > 0.0, found, -np.inf)


def measured_where_tightest(floor: Vector, clearance: Vector, measure: Callable[[Indices], Vector]) -> Vector:
    """(P,) the distances of all pairs that may have the least margin, infinite for those that certainly have not [m].

    Parameters
    ----------
    floor: (P,) lower bounds of the distances, minus infinity where none is known [m].
    clearance: (P,) of the pairs [m].
    measure: the distances of some pairs, by their numbers (K,) [m].
    """
    found, is_near = np.full(len(floor), np.inf), floor == -np.inf
    near = np.flatnonzero(is_near)
    found[near] = measure(near)
    further = np.flatnonzero(~is_near & (floor - clearance < np.min(found - clearance)))
    found[further] = measure(further)
    return found
