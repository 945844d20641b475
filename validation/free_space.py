"""Proofs of free motion between configurations, without the planner: conservative advancement and small trees."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector

_LEAST_STEP = 2e-3  # part of a motion below which an advance counts as stuck


def margins(proximity: bp.Proximity, q: Vector) -> Vector:
    """(P,) distances beyond the clearances [m] at `q` (n,); a single infinite one if there are no pairs."""
    if not proximity.pairs:
        return np.array([np.inf])
    return np.asarray(proximity.distances(q) - proximity.clearance)


def clear_along(proximity: bp.Proximity, way: Matrix, extra: float) -> bool:
    """Whether every margin is proven to be at least `extra` [m] on the straight joint motions along `way` (W, n)."""
    if any(free_part(proximity, a, b, extra) < 1.0 for a, b in pairwise(way)):
        return False
    return bool(np.min(margins(proximity, way[-1])) >= extra)


def free_part(proximity: bp.Proximity, a: Vector, b: Vector, extra: float) -> float:
    """The part of the straight joint motion from `a` to `b`, (n,) each, that is proven to keep `extra` [m].

    Conservative advancement: no distance can shrink faster than the joints move times the
    reach of the link from them.
    """
    rate = proximity.travel @ np.abs(b - a)
    part = 0.0
    while part < 1.0:
        spare = proximity.distances(a + part * (b - a)) - proximity.clearance - extra
        step = float(np.min(np.where(rate > 1e-12, spare / np.maximum(rate, 1e-12), np.inf), initial=np.inf))
        if step < _LEAST_STEP and part + step < 1.0:
            return part
        part += step
    return 1.0


def trees_meet(
    robot: bp.Robot, proximity: bp.Proximity, start: Vector, goal: Vector, *, growth: int, rng: np.random.Generator
) -> bool:
    """Whether two random trees of `growth` branches, grown from both ends (n,) through free space, meet."""
    trees = [[start], [goal]]
    for count in range(growth):
        here, there = trees[count % 2], trees[1 - count % 2]
        grown = _towards(proximity, here, robot.random_q(rng))
        here.append(grown)
        met = _towards(proximity, there, grown)
        if np.array_equal(met, grown):
            return True
        there.append(met)
    return False


def _towards(proximity: bp.Proximity, tree: list[Vector], wanted: Vector) -> Vector:
    """(n,) the end of the proven free part of the straight motion from the nearest node of a tree to `wanted`."""
    a = min(tree, key=lambda q: float(np.sum(np.square(q - wanted))))
    part = free_part(proximity, a, wanted, 0.0)
    return wanted if part >= 1.0 else a + 0.95 * part * (wanted - a)
