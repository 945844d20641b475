"""Random obstacles as entries of a scene file, without names (`name_all` adds them).

`random_obstacle` and `random_fixtures` draw likely surroundings of a machine; the others draw
one obstacle at a given place. The numbers drawn and their order are part of the meaning of a
seed: a change makes other sites of the same keys.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector

Triple = Sequence[float] | Vector
Record = dict[str, Any]

MACHINES = ("planar4", "backhoe", "panda", "telescope")

# pipes of 1 to 4 m length and 0.05 to 0.2 m thickness for the backhoe, scaled to the arm's reach
_PIPE_SCALE = {"backhoe": 1.0, "planar4": 0.4, "panda": 0.2, "telescope": 1.0}


def random_obstacle(machine: str, rng: np.random.Generator) -> Record:
    """An obstacle of any shape that is likely around a machine, within or just beyond its reach."""
    return _OBSTACLES[machine](rng)


def random_fixtures(machine: str, rng: np.random.Generator) -> list[Record]:
    """Fixtures of some of a machine's sites: the ground, a line overhead, a wall, a table."""
    return _FIXTURES[machine](rng)


# --- shapes -----------------------------------------------------------------------------


def sphere(radius: float, position: Triple) -> Record:
    """A ball about `position` (3,)."""
    return {"shape": "sphere", "radius": float(radius), "position": _plain(position)}


def box(size: Triple, position: Triple, rpy: Triple) -> Record:
    """A box with full edges `size` (3,), turned by `rpy` (3,) about its middle."""
    return {"shape": "box", "size": _plain(size), "position": _plain(position), "rpy": _plain(rpy)}


def turned_box(size: Triple, local: Triple, turn: float) -> Record:
    """A box at `local` (3,) in axes turned about z."""
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = local
    return box(size, [c * x - s * y, s * x + c * y, z], [0.0, 0.0, turn])


def cylinder(radius: float, length: float, position: Triple) -> Record:
    """An upright cylinder about `position` (3,)."""
    return {"shape": "cylinder", "radius": float(radius), "length": float(length), "position": _plain(position)}


def capsule(a: Triple, b: Triple, radius: float) -> Record:
    """A capsule whose axis runs from `a` to `b`, (3,) each."""
    return {"shape": "capsule", "from": _plain(a), "to": _plain(b), "radius": float(radius)}


def halfspace(point: Triple, normal: Triple) -> Record:
    """Solid behind the plane through `point` (3,) with the outward `normal` (3,)."""
    return {"shape": "halfspace", "point": _plain(point), "normal": _plain(normal)}


def _plain(values: Triple) -> list[float]:
    return [float(value) for value in values]


def _level(turn: float) -> Vector:
    """(3,) the unit vector at angle `turn` in the horizontal plane."""
    return np.array([np.cos(turn), np.sin(turn), 0.0])


# --- around a machine -------------------------------------------------------------------


def _around_backhoe(rng: np.random.Generator) -> Record:
    """A boulder, a crate or a spoil heap's block, a post, a pipe in the ground, a pipe overhead."""
    radius, angle = rng.uniform(1.8, 6.5), rng.uniform(-1.6, 1.6)
    x, y, _ = radius * _level(angle)
    kind = int(rng.integers(5))
    if kind == 0:
        ball = float(rng.uniform(0.2, 0.7))
        record = sphere(ball, [x, y, rng.uniform(-1.0, ball)])
    elif kind == 1:
        size = rng.uniform([0.4, 0.4, 0.4], [2.0, 2.5, 1.6])
        base = float(rng.choice([0.0, -float(rng.uniform(0.5, 2.0))]))
        record = box(size, [x, y, base + 0.5 * float(size[2])], [0.0, 0.0, rng.uniform(-1.5, 1.5)])
    elif kind == 2:
        length = float(rng.uniform(1.5, 7.0))
        record = cylinder(rng.uniform(0.08, 0.4), length, [x, y, 0.5 * length])
    elif kind == 3:
        record = pipe("backhoe", np.array([x, y, rng.uniform(-2.0, -0.3)]), rng)
    else:
        middle = np.array([x, y, float(rng.uniform(2.0, 4.5))])
        turn = float(rng.uniform(0.0, np.pi))
        half = 0.5 * float(rng.uniform(1.0, 4.0)) * _level(turn)
        record = capsule(middle - half, middle + half, rng.uniform(0.03, 0.15))
    return _with_own_clearance(record, 0.4, [0.02, 0.1, 0.2, 0.3], rng)


def _around_planar(rng: np.random.Generator) -> Record:
    radius, angle = rng.uniform(0.6, 4.2), rng.uniform(-np.pi, np.pi)
    place = radius * _level(angle)
    kind = int(rng.integers(4))
    if kind == 0:
        record = sphere(rng.uniform(0.1, 0.45), place)
    elif kind == 1:
        record = box([*rng.uniform(0.2, 1.0, 2), 0.5], place, [0.0, 0.0, rng.uniform(0.0, np.pi)])
    elif kind == 2:
        record = cylinder(rng.uniform(0.08, 0.4), 1.0, place)
    else:
        record = pipe("planar4", place, rng)
    return _with_own_clearance(record, 0.3, [0.0, 0.05, 0.1], rng)


def _around_panda(rng: np.random.Generator) -> Record:
    radius, angle = rng.uniform(0.3, 0.95), rng.uniform(-np.pi, np.pi)
    size = rng.uniform(0.05, 0.4, 3)
    x, y, _ = radius * _level(angle)
    z = rng.uniform(0.0, 1.0)
    upright = rng.random() < 0.7
    rpy: Triple = [0.0, 0.0, float(rng.uniform(-np.pi, np.pi))] if upright else rng.uniform(-1.5, 1.5, 3)
    return box(size, [x, y, z], rpy)


def _with_own_clearance(record: Record, part: float, clearances: Sequence[float], rng: np.random.Generator) -> Record:
    """`record`, in a fraction `part` of the cases with its own clearance [m]."""
    if rng.random() < part:
        record["clearance"] = float(rng.choice(clearances))
    return record


def _fixtures_of_backhoe(rng: np.random.Generator) -> list[Record]:
    """The ground for boom and stick, and in some sites a line overhead."""
    found: list[Record] = []
    if rng.random() < 0.7:
        found.append({**halfspace([0, 0, 0], [0, 0, 1]), "links": ["boom", "stick"]})
    if rng.random() < 0.3:
        found.append({**halfspace([0, 0, rng.uniform(4.5, 7.0)], [0, 0, -1]), "clearance": 0.5})
    return found


def _fixtures_of_planar(rng: np.random.Generator) -> list[Record]:
    """In some sites a wall that no link may pass."""
    if rng.random() > 0.3:
        return []
    inward = _level(float(rng.uniform(-np.pi, np.pi)))
    away = float(rng.uniform(1.5, 3.5))
    return [halfspace(-away * inward, inward)]


def _fixtures_of_panda(rng: np.random.Generator) -> list[Record]:
    """In half of the sites a table."""
    if rng.random() < 0.5:
        return []
    links = [*(f"panda_link{k}" for k in range(2, 8)), "panda_hand"]
    return [{"shape": "box", "size": [2.0, 2.0, 0.1], "position": [0.0, 0.0, -0.06], "links": links}]


_OBSTACLES: dict[str, Callable[[np.random.Generator], Record]] = {
    "planar4": _around_planar,
    "backhoe": _around_backhoe,
    "panda": _around_panda,
    "telescope": _around_backhoe,
}
_FIXTURES: dict[str, Callable[[np.random.Generator], list[Record]]] = {
    "planar4": _fixtures_of_planar,
    "backhoe": _fixtures_of_backhoe,
    "panda": _fixtures_of_panda,
    "telescope": _fixtures_of_backhoe,
}


# --- at a place ------------------------------------------------------------------------


def lump(machine: str, middle: Vector, rng: np.random.Generator) -> Record:
    """A compact obstacle at a point (3,), in the plane of a planar arm."""
    scale = float(rng.uniform(0.08, 0.25)) * (0.3 if machine == "panda" else 1.0)
    middle = _in_plane(machine, middle)
    if rng.random() < 0.5:
        return sphere(scale, middle)
    size = 2.0 * scale * rng.uniform(0.6, 1.4, 3)
    return box(size, middle, [0.0, 0.0, rng.uniform(-1.5, 1.5)])


def pipe(machine: str, middle: Vector, rng: np.random.Generator) -> Record:
    """A thin level capsule at a point (3,), in the plane of a planar arm."""
    scale = _PIPE_SCALE[machine]
    turn = float(rng.uniform(0.0, np.pi))
    half = 0.5 * scale * float(rng.uniform(1.0, 4.0)) * _level(turn)
    middle = _in_plane(machine, middle)
    return capsule(middle - half, middle + half, scale * float(rng.uniform(0.05, 0.2)))


def _in_plane(machine: str, point: Vector) -> Vector:
    return point * [1.0, 1.0, 0.0] if machine == "planar4" else point


def planar_obstacle(rng: np.random.Generator) -> Record:
    """A ball, a block or a capsule anywhere in the workspace of the planar arm."""
    place = np.array([*rng.uniform(-3.5, 3.5, 2), 0.0])
    kind = int(rng.integers(3))
    if kind == 0:
        return sphere(rng.uniform(0.1, 0.5), place)
    if kind == 1:
        return box([*rng.uniform(0.2, 1.0, 2), 0.5], place, [0.0, 0.0, rng.uniform(0.0, 3.0)])
    half = np.array([*rng.uniform(-0.7, 0.7, 2), 0.0])
    return capsule(place - half, place + half, rng.uniform(0.05, 0.2))


def course_obstacle(index: int, rng: np.random.Generator) -> Record:
    """A ball, a crate or a post in turn, each of one size, in the backhoe's reach."""
    radius, angle = rng.uniform(2.5, 6.0), rng.uniform(-1.3, 1.3)
    x, y, _ = radius * _level(angle)
    place = np.array([x, y, rng.uniform(-2.5, 3.0)])
    if index % 3 == 0:
        return sphere(0.3, place)
    if index % 3 == 1:
        return {"shape": "box", "size": [0.5, 0.5, 0.5], "position": place.tolist()}
    return capsule(place, place + np.array([0.0, 0.0, 1.0]), 0.1)


def appearing_obstacle(place: Vector, rng: np.random.Generator) -> Record:
    """A ball, a tilted box or a post at a place (3,), as may get in a backhoe's way."""
    kind = int(rng.integers(3))
    if kind == 0:
        return sphere(rng.uniform(0.1, 0.4), place)
    if kind == 1:
        return box(rng.uniform(0.15, 0.8, 3), place, rng.uniform(-np.pi, np.pi, 3))
    length = float(rng.uniform(1.0, 4.0))
    middle = place + np.array([0.0, 0.0, float(rng.uniform(-0.45, 0.45)) * length])
    return cylinder(rng.uniform(0.04, 0.15), length, middle)


# --- all of them ---------------------------------------------------------------------------


def name_all(records: Sequence[Record]) -> list[Record]:
    """The same records with names made of shape and number."""
    return [{"name": f"{record['shape']} {index}", **record} for index, record in enumerate(records)]


def shift(record: Record, step: Vector) -> Record:
    """The same obstacle moved by `step` (3,)."""
    return {
        key: (np.array(value) + step).tolist() if key in ("position", "from", "to") else value
        for key, value in record.items()
    }


def extent(record: Record) -> tuple[Vector, Vector]:
    """The lowest and highest corner (3,) of an obstacle's axis-aligned bounding box."""
    if record["shape"] == "capsule":
        ends = np.array([record["from"], record["to"]])
        return ends.min(axis=0) - record["radius"], ends.max(axis=0) + record["radius"]
    middle = np.array(record["position"])
    if record["shape"] == "sphere":
        half = np.full(3, record["radius"])
    elif record["shape"] == "cylinder":
        half = np.array([record["radius"], record["radius"], 0.5 * record["length"]])
    else:
        half = 0.5 * np.array(record["size"])
    corners = np.array(list(product((-1.0, 1.0), repeat=3))) * half
    rotation = pin.rpy.rpyToMatrix(*record.get("rpy", (0.0, 0.0, 0.0)))
    turned = corners @ rotation.T + middle
    return turned.min(axis=0), turned.max(axis=0)
