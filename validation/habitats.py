"""Sensible sizes and distances around each machine, and the forms of its narrow sites."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.obstacles import MACHINES, Record, capsule, turned_box
from validation.telescope import telescope_file


@dataclass(frozen=True)
class Habitat:
    """Sensible sizes and distances around one machine.

    Attributes
    ----------
    source, tip: arguments of `load_robot`; a source None is the machine of `telescope`.
    low, high: (3,) corners of the box that the machine itself fills [m].
    clearance, influence: of the scene [m].
    far: least distance between start and goal of the tip [m].
    length: least and greatest length of a path [m].
    extra: greatest margin of an obstacle close to the path [m].
    """

    source: str | None
    tip: str | None
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    clearance: float
    influence: float
    far: float
    length: tuple[float, float]
    extra: float

    def outside(self, low: Vector, high: Vector) -> bool:
        """Whether the box between two corners (3,) is clear of the box that the machine fills."""
        return bool(np.any(high < np.array(self.low)) or np.any(low > np.array(self.high)))


HABITATS = {
    "planar4": Habitat(
        source="example:planar4", tip=None, low=(-0.25, -0.25, -1.0), high=(0.25, 0.25, 1.0),
        clearance=0.02, influence=0.4, far=1.0, length=(0.5, 4.0), extra=0.12,
    ),
    "backhoe": Habitat(
        source="example:backhoe", tip=None, low=(-5.4, -1.35, 0.0), high=(0.85, 1.35, 2.9),
        clearance=0.05, influence=0.6, far=1.5, length=(0.6, 5.0), extra=0.2,
    ),
    "panda": Habitat(
        source="example:panda", tip="panda_hand_tcp", low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.5),
        clearance=0.01, influence=0.2, far=0.3, length=(0.3, 2.0), extra=0.06,
    ),
    "telescope": Habitat(
        source=None, tip=None, low=(-3.2, -1.1, 0.0), high=(0.4, 1.1, 1.4),
        clearance=0.05, influence=0.6, far=1.5, length=(0.6, 5.0), extra=0.2,
    ),
}  # fmt: skip
assert tuple(HABITATS) == MACHINES


@cache
def load_machine(machine: str) -> bp.Robot:
    """The robot for which the sites of a machine are drawn; loaded once per process."""
    habitat = HABITATS[machine]
    return bp.load_robot(telescope_file() if habitat.source is None else habitat.source, tip=habitat.tip)


def folded_ways(machine: str, start: Vector, goal: Vector) -> Iterator[Matrix]:
    """Paths (W, n) from start to goal by drawing the arm in, swinging it and stretching it out again."""
    if machine != "backhoe":
        return
    for boom, stick in ((1.2, -2.3), (0.7, -2.3), (1.3, -1.2)):
        over = [np.array([q[0], boom, stick, k[3]]) for q, k in ((start, start), (goal, goal))]
        yield np.array(over)
        # out of a trench or a gap: the boom first, then the rest
        lifted = [np.array([q[0], boom, q[2], q[3]]) for q in (start, goal)]
        yield np.array([lifted[0], *over, lifted[1]])
        drawn = [np.array([q[0], q[1], stick, q[3]]) for q in (start, goal)]
        yield np.array([drawn[0], *over, drawn[1]])


# --- narrow sites ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Narrows:
    """The narrow part of a site, and the conditions on start and goal.

    Attributes
    ----------
    form: trench, gap, slot, shelf, beam or pipes.
    obstacles: entries of a scene file; none for pipes, which are drawn across the path.
    turn: angle about z of the axes of `holds`.
    holds: whether the tip at start and goal, (3,) each in those axes, is placed as required.
    """

    form: str
    obstacles: list[Record]
    turn: float
    holds: Callable[[Vector, Vector], bool]

    def accepts(self, start: Vector, goal: Vector) -> bool:
        """Whether the path from one tip position (3,) to another leads through the narrow part."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return bool(self.holds(*(np.array([c * p[0] + s * p[1], -s * p[0] + c * p[1], p[2]]) for p in (start, goal))))


def draw_narrows(machine: str, index: int, rng: np.random.Generator) -> Narrows:
    """One of the machine's narrow forms, in turn, at a random angle around the machine."""
    return _NARROWS[machine](index, rng)


def _both_sides(gap: float, size: Sequence[float], x: float, z: float, turn: float) -> list[Record]:
    """Two boxes of one size with centres at (x, z) and a gap between them [m]."""
    return [turned_box(size, [x, side * 0.5 * (gap + size[1]), z], turn) for side in (-1.0, 1.0)]


def banks(turn: float, rng: np.random.Generator) -> list[Record]:
    """The soil on both sides of a trench that runs away from the machine at angle `turn`."""
    return _both_sides(float(rng.uniform(0.85, 1.3)), [5.0, 1.5, 3.0], 4.0, -1.5, turn)


def _narrow_backhoe(index: int, rng: np.random.Generator) -> Narrows:
    turn = float(rng.uniform(-1.1, 1.1))
    form = ("trench", "gap", "beam", "pipes")[index % 4]
    if form == "trench":
        return Narrows(form, banks(turn, rng), turn, lambda a, b: a[2] > 0.2 and b[2] < -0.3)
    if form == "gap":
        gap, near = float(rng.uniform(1.0, 1.7)), float(rng.uniform(2.2, 3.2))
        height = float(rng.uniform(1.0, 4.0))
        walls = _both_sides(gap, [2.5, 0.3, height], near + 1.25, 0.5 * height, turn)

        def into(a: Vector, b: Vector) -> bool:
            inside = b[0] > near + 0.2 and abs(b[1]) < 0.5 * gap and 0.0 < b[2] < height
            return bool(inside and abs(a[1]) > 0.5 * gap + 0.3)

        return Narrows(form, walls, turn, into)
    if form == "beam":
        away, height = float(rng.uniform(2.6, 4.0)), float(rng.uniform(1.2, 2.4))
        a, b = (
            [away * np.cos(turn) - s * np.sin(turn), away * np.sin(turn) + s * np.cos(turn), height] for s in (-2, 2)
        )
        beam = capsule(a, b, float(rng.uniform(0.1, 0.25)))

        def under(a: Vector, b: Vector) -> bool:
            below = b[0] > away + 0.3 and b[2] < height - 0.3 and abs(b[1]) < 1.5
            return bool(below and a[2] > height + 0.2)

        return Narrows(form, [beam], turn, under)
    return Narrows(form, [], turn, lambda a, b: True)


def _narrow_planar(index: int, rng: np.random.Generator) -> Narrows:
    turn = float(rng.uniform(-np.pi, np.pi))
    form = ("gap", "slot", "pipes")[index % 3]
    gap = float(rng.uniform(0.4, 0.8))
    if form == "gap":
        away = float(rng.uniform(1.2, 2.2))
        walls = _both_sides(gap, [0.15, 1.6, 0.5], away, 0.0, turn)
        return Narrows(form, walls, turn, lambda a, b: a[0] < away - 0.2 and b[0] > away + 0.3 and abs(b[1]) < 1.2)
    if form == "slot":
        away = float(rng.uniform(1.4, 2.2))
        walls = _both_sides(gap, [1.2, 0.15, 0.5], away + 0.6, 0.0, turn)

        def into(a: Vector, b: Vector) -> bool:
            return bool(away + 0.2 < b[0] < away + 1.2 and abs(b[1]) < 0.5 * gap and abs(a[1]) > gap)

        return Narrows(form, walls, turn, into)
    return Narrows(form, [], turn, lambda a, b: True)


def _narrow_panda(index: int, rng: np.random.Generator) -> Narrows:
    turn = float(rng.uniform(-np.pi, np.pi))
    form = ("gap", "shelf", "beam")[index % 3]
    away, floor = float(rng.uniform(0.4, 0.55)), float(rng.uniform(0.05, 0.4))
    if form == "shelf":
        inside = float(rng.uniform(0.3, 0.45))
        boards = [
            turned_box([0.35, 0.8, 0.03], [away + 0.175, 0.0, height], turn) for height in (floor, floor + inside)
        ]

        def on_board(a: Vector, b: Vector) -> bool:
            held = away < b[0] < away + 0.35 and abs(b[1]) < 0.4 and floor < b[2] < floor + inside
            return bool(held and (a[0] < away or a[2] > floor + inside or abs(a[1]) > 0.4))

        return Narrows(form, boards, turn, on_board)
    if form == "gap":
        gap = float(rng.uniform(0.25, 0.4))
        walls = _both_sides(gap, [0.3, 0.04, 0.6], away + 0.15, floor + 0.3, turn)

        def between(a: Vector, b: Vector) -> bool:
            return bool(b[0] > away and abs(b[1]) < 0.5 * gap and b[2] < floor + 0.6 and abs(a[1]) > 0.5 * gap)

        return Narrows(form, walls, turn, between)
    height = float(rng.uniform(0.35, 0.6))
    beam = turned_box([0.08, 1.2, 0.08], [away, 0.0, height], turn)

    def under(a: Vector, b: Vector) -> bool:
        return bool(b[0] > away + 0.05 and b[2] < height - 0.05 and abs(b[1]) < 0.5 and a[2] > height + 0.05)

    return Narrows(form, [beam], turn, under)


_NARROWS: dict[str, Callable[[int, np.random.Generator], Narrows]] = {
    "planar4": _narrow_planar,
    "backhoe": _narrow_backhoe,
    "panda": _narrow_panda,
    "telescope": _narrow_backhoe,
}
