"""Machines among many obstacles of several shapes, and the limits of their motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.law import Shield
from backhoe_planner.machine import Robot
from backhoe_planner.site import Proximity, build_obstacles, scene_from_dict

DT = 0.02


def shape_in_turn(
    rng: np.random.Generator, index: int, place: list[float], *, radius: float, height: float
) -> dict[str, Any]:
    """A box, a ball of at most `radius` or a capsule of `height` [m] at a place, in turn."""
    shapes: list[dict[str, Any]] = [
        {"shape": "box", "size": rng.uniform(0.1, 1.0, 3).tolist(), "position": place, "rpy": [0.3, 0.2, 1.0]},
        {"shape": "sphere", "radius": float(rng.uniform(0.05, radius)), "position": place},
        {"shape": "capsule", "radius": 0.1, "from": place, "to": [*place[:2], place[2] + height]},
    ]
    return shapes[index % 3]


def crowd(robot: Robot, count: int, seed: int, *, moving: bool, earlier: float = 0.0) -> Proximity:
    """Boxes, balls and capsules within and beyond a machine's reach, and a half-space above it.

    Those that move have appeared `earlier` by so much [s], as on the clock of a later leg of a sequence.
    """
    rng = np.random.default_rng(seed)
    entries: list[dict[str, Any]] = [{"name": "roof", "shape": "halfspace", "point": [0, 0, 7], "normal": [0, 0, -1]}]
    for index in range(count):
        place = (rng.normal(size=3) * [3.0, 3.0, 0.5] + [0.0, 0.0, 0.3]).tolist()
        shape = shape_in_turn(rng, index, place, radius=0.5, height=2.0)
        if moving and index % 2:
            shape |= {"velocity": rng.uniform(-1.0, 1.0, 3).tolist(), "appears_at": 0.5 * (index % 4)}
        entries.append({"name": f"o{index}", **shape})
    scene = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [0, 0, 0]}}, "obstacles": entries}
    built = build_obstacles(scene_from_dict(scene), robot)
    return Proximity(robot, [replace(one, appears_at=one.appears_at - earlier) if one.moves else one for one in built])


def lead_at(robot: Robot, v: Vector) -> dict[str, Any]:
    """Arguments of `at_unchecked` in a loop that moves at v (n,)."""
    shield, change = Shield(robot.limits), robot.limits.acceleration * DT
    stop, longest = shield.stopping_time(np.abs(v) + change), shield.stopping_time(robot.limits.velocity)
    return {"v": v, "fastest": np.abs(v) + change, "stop": stop, "longest": longest}
