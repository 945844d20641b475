"""The machine's collision shape as Pinocchio sees it, and which parts may meet.

Neighbouring links overlap at their joint, and some parts touch in every posture:
such pairs say nothing and are left out. All others count.
"""

from __future__ import annotations

from collections import Counter
from functools import lru_cache

import numpy as np
import pinocchio as pin

from backhoe_planner.machine.robot import Robot

__all__ = ["geometry_model", "self_pairs"]

_SAMPLES = 60  # postures: a rate of 0.9 is then known to within 0.04 (one standard deviation)
_TOUCHES_BY_CONSTRUCTION = 0.9  # of the sampled postures


def geometry_model(robot: Robot) -> pin.GeometryModel:
    """A new geometry model that holds `robot.pieces`, in their order, without pairs."""
    model = pin.GeometryModel()
    for piece in robot.pieces:
        model.addGeometryObject(
            pin.GeometryObject(piece.name, piece.joint, 0, piece.piece.placement, piece.piece.shape)
        )
    return model


@lru_cache(maxsize=8)
def self_pairs(robot: Robot) -> tuple[tuple[int, int], ...]:
    """Pairs of indices into `robot.pieces` that must not touch each other.

    Left out are pieces on one body, on bodies joined by one joint, and links that
    touch in nearly every posture (60 seeded ones).
    """
    pieces = robot.pieces
    parents = robot.model.parents
    candidates = [
        (a, b)
        for a in range(len(pieces))
        for b in range(a + 1, len(pieces))
        if pieces[a].joint != pieces[b].joint
        and parents[pieces[a].joint] != pieces[b].joint
        and parents[pieces[b].joint] != pieces[a].joint
    ]
    if not candidates:
        return ()
    touches = _touch_rates(robot, candidates)
    return tuple(pair for pair in candidates if touches[_links(robot, pair)] < _TOUCHES_BY_CONSTRUCTION)


def _links(robot: Robot, pair: tuple[int, int]) -> tuple[str, str]:
    return robot.pieces[pair[0]].link, robot.pieces[pair[1]].link


def _touch_rates(robot: Robot, pairs: list[tuple[int, int]]) -> dict[tuple[str, str], float]:
    """Part of the sampled postures in which two links touch, by their names."""
    model = geometry_model(robot)
    for a, b in pairs:
        model.addCollisionPair(pin.CollisionPair(a, b))
    data, geometry = robot.model.createData(), model.createData()
    rng = np.random.default_rng(0)
    hits: Counter[tuple[str, str]] = Counter()
    for _ in range(_SAMPLES):
        pin.computeCollisions(robot.model, data, model, geometry, robot.random_q(rng), False)
        results = zip(pairs, geometry.collisionResults, strict=True)
        hits.update({_links(robot, pair) for pair, result in results if result.isCollision()})
    return {links: hits[links] / _SAMPLES for links in {_links(robot, pair) for pair in pairs}}
