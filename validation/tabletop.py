"""Problems for the Panda at a table, at a shelf and at a cage of bars, each with a known solution.

    table   4 to 9 boxes on a table top; the tip moves low between them from place to place
    shelf   a back, two sides, three boards and a divider; from one compartment into another
    cage    upright bars around the arm between two rings; the hand moves from one gap to another

At start and goal the hand reaches in along its own axis. From both it is drawn back straight
by inverse kinematics, and two random trees meet between the drawn-back configurations: so a
solution is known, and the difficulty of leaving a compartment does not decide which problems
are kept. They are named like random sites (`SiteKey`), with the machine ``panda``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import TipTarget
from validation.free_space import clear_along, margins, trees_meet
from validation.habitats import HABITATS
from validation.obstacles import Record, box, capsule, name_all, turned_box
from validation.scenes import NO_TASK, quaternion, scene_of
from validation.sites import SPARE, Site, SiteKey

KINDS = ("table", "shelf", "cage")
MACHINE = "panda"

_TRIES = 400  # drawings of one problem
_ENDS = 25  # places drawn for each end of a motion
_GROWTH = 300  # branches of the trees
_STEP = 0.04  # m between the configurations while the hand is drawn back
_STRAIGHT = 0.15  # rad or m, the most that a joint may change between them, for a nearly straight tip path
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class _Reach:
    """A place of the hand, its direction of approach, and the distance by which it must be drawn back."""

    position: Vector
    approach: Vector
    roll: float
    back: float
    place: int
    """The compartment or gap; start and goal are in different ones."""

    @property
    def rotation(self) -> Matrix:
        """(3, 3) the hand's rotation: it points along `approach`, and at roll 0 its fingers open upward or outward."""
        away = _UP if abs(self.approach[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
        across = away - (away @ self.approach) * self.approach
        across /= np.linalg.norm(across)
        c, s = np.cos(self.roll), np.sin(self.roll)
        opening = c * across + s * np.cross(self.approach, across)
        return np.column_stack((np.cross(opening, self.approach), opening, self.approach))


@dataclass(frozen=True)
class _Furniture:
    """Obstacles, and a function that draws a place for the hand among them."""

    obstacles: list[Record]
    reach: Callable[[np.random.Generator], _Reach]


def tabletop_problem(robot: bp.Robot, key: SiteKey, *, by_joints: bool = False) -> Site:
    """Draw the problem that is named `key`; `robot` is ``load_machine("panda")``.

    Parameters
    ----------
    by_joints: whether the goal is given by the joints; else by the full pose of the tip.

    Raises
    ------
    ValueError: the kind does not exist.
    """
    for turn in range(_TRIES):
        rng = np.random.default_rng([key.seed, KINDS.index(key.kind), key.index, turn])
        furniture = _FURNITURE[key.kind](rng)
        obstacles = name_all(furniture.obstacles)
        site = _site(robot, key, obstacles, furniture.reach, by_joints, rng)
        if site is not None:
            return site
    raise RuntimeError(f"no problem could be drawn for {key} with seed {key.seed}")


def _site(
    robot: bp.Robot,
    key: SiteKey,
    obstacles: Sequence[Record],
    reach: Callable[[np.random.Generator], _Reach],
    by_joints: bool,
    rng: np.random.Generator,
) -> Site | None:
    proximity = bp.Proximity(robot, bp.build_obstacles(_scene(robot, key, obstacles, NO_TASK, robot.middle), robot))
    first = _drawn_back(robot, proximity, reach, None, rng)
    second = None if first is None else _drawn_back(robot, proximity, reach, first[0], rng)
    if first is None or second is None:
        return None
    (_, leaving), (end, entering) = first, second
    if not trees_meet(robot, proximity, leaving[-1], entering[-1], growth=_GROWTH, rng=rng):
        return None
    start, goal = leaving[0], entering[0]
    asked: Record = {
        "position": bp.Kinematics(robot).at(goal).tip_position.tolist(),
        "quaternion": quaternion(end.rotation),
    }
    if by_joints:
        asked = {"joints": dict(zip(robot.joint_names, goal.tolist(), strict=True))}
    scene = _scene(robot, key, obstacles, {"goal": asked}, start)
    return Site(key, scene, key.kind, start, goal, None, False, way_known=True)


def _drawn_back(
    robot: bp.Robot,
    proximity: bp.Proximity,
    reach: Callable[[np.random.Generator], _Reach],
    other: _Reach | None,
    rng: np.random.Generator,
) -> tuple[_Reach, Matrix] | None:
    """A place for the hand other than `other`, and the configurations (W, n) by which it is drawn back."""
    for _ in range(_ENDS):
        wanted = reach(rng)
        apart = np.inf if other is None else float(np.linalg.norm(wanted.position - other.position))
        if apart < HABITATS[MACHINE].far or (other is not None and wanted.place == other.place):
            continue
        found = bp.solve_inverse_kinematics(robot, _target(wanted, 0.0), start=robot.random_q(rng), rng=rng, attempts=4)
        if not found.reached or np.min(margins(proximity, found.q)) < SPARE:
            continue
        way = [found.q]
        for away in np.linspace(0.0, wanted.back, int(np.ceil(wanted.back / _STEP)) + 1)[1:]:
            found = bp.solve_inverse_kinematics(robot, _target(wanted, float(away)), start=way[-1], attempts=1)
            if not found.reached or np.max(np.abs(found.q - way[-1])) > _STRAIGHT:
                break
            way.append(found.q)
        else:
            if clear_along(proximity, np.array(way), 0.0):
                return wanted, np.array(way)
    return None


def _target(wanted: _Reach, away: float) -> TipTarget:
    return TipTarget(wanted.position - away * wanted.approach, rotation=wanted.rotation)


def _scene(robot: bp.Robot, key: SiteKey, obstacles: Sequence[Record], task: Record, start: Vector) -> bp.Scene:
    habitat = HABITATS[MACHINE]
    room: Record = {"clearance": habitat.clearance, "influence": habitat.influence}
    return scene_of(robot, obstacles, start=start, task=task, name=str(key), **room)


# --- furniture -------------------------------------------------------------------------


def _table(rng: np.random.Generator) -> _Furniture:
    top = float(rng.uniform(-0.05, 0.2))
    obstacles = [box([0.7, 1.4, 0.04], [0.6, 0.0, top - 0.02], [0.0, 0.0, 0.0])]
    for _ in range(int(rng.integers(4, 10))):
        size = rng.uniform([0.04, 0.04, 0.08], [0.2, 0.2, 0.35])
        x, y = rng.uniform([0.32, -0.6], [0.85, 0.6])
        obstacles.append(box(size, [x, y, top + 0.5 * size[2]], [0.0, 0.0, rng.uniform(0.0, np.pi)]))

    def reach(rng: np.random.Generator) -> _Reach:
        position = np.array([*rng.uniform([0.32, -0.6], [0.8, 0.6]), top + rng.uniform(0.03, 0.15)])
        approach = np.array([*rng.uniform(-0.35, 0.35, 2), -1.0])
        number = int(rng.integers(1 << 30))  # two places at a table are never the same
        away = float(rng.uniform(0.15, 0.3))
        return _Reach(position, approach / np.linalg.norm(approach), float(rng.uniform(0.0, np.pi)), away, number)

    return _Furniture(obstacles, reach)


def _shelf(rng: np.random.Generator) -> _Furniture:
    turn, away, depth = float(rng.uniform(-1.2, 1.2)), float(rng.uniform(0.45, 0.6)), float(rng.uniform(0.22, 0.32))
    width, board = float(rng.uniform(0.7, 1.0)), 0.02
    lowest, rise = float(rng.uniform(0.05, 0.25)), rng.uniform(0.28, 0.42, 2)
    levels = lowest + np.array([0.0, rise[0], rise[0] + rise[1]])
    divider = float(rng.uniform(-0.15, 0.15))
    middle, height = 0.5 * (levels[0] + levels[2]), float(levels[2] - levels[0])
    obstacles = [turned_box([depth, width, board], [away + 0.5 * depth, 0.0, level], turn) for level in levels]
    walls = (-0.5 * width, divider, 0.5 * width)
    obstacles += [turned_box([depth, board, height], [away + 0.5 * depth, y, middle], turn) for y in walls]
    obstacles.append(turned_box([board, width, height], [away + depth, 0.0, middle], turn))

    def reach(rng: np.random.Generator) -> _Reach:
        row, column = int(rng.integers(2)), int(rng.integers(2))
        inside = rng.uniform(0.3, 0.7, 2)
        y = walls[column] + inside[0] * (walls[column + 1] - walls[column])
        z = levels[row] + inside[1] * (levels[row + 1] - levels[row])
        x = away + rng.uniform(0.2, 0.75) * depth
        c, s, sideways = np.cos(turn), np.sin(turn), turn + float(rng.uniform(-0.25, 0.25))
        approach = np.array([np.cos(sideways), np.sin(sideways), rng.uniform(-0.3, 0.3)])
        position = np.array([c * x - s * y, s * x + c * y, z])
        roll = float(rng.choice([0.0, 0.5 * np.pi]) + rng.uniform(-0.2, 0.2))
        return _Reach(position, approach / np.linalg.norm(approach), roll, x - away + 0.12, 2 * row + column)

    return _Furniture(obstacles, reach)


def _cage(rng: np.random.Generator) -> _Furniture:
    radius, gap, bar = float(rng.uniform(0.42, 0.5)), float(rng.uniform(0.19, 0.27)), float(rng.uniform(0.008, 0.015))
    low, high = float(rng.uniform(0.0, 0.15)), float(rng.uniform(0.75, 1.0))
    spacing = (gap + 2.0 * bar) / radius
    gaps = int(2.8 / spacing)
    angles = float(rng.uniform(-0.4, 0.4)) + spacing * (np.arange(gaps + 1) - 0.5 * gaps)
    feet = radius * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(gaps + 1)))
    obstacles = [capsule(foot + low * _UP, foot + high * _UP, bar) for foot in feet]
    for level in (low, high):
        obstacles += [capsule(a + level * _UP, b + level * _UP, bar) for a, b in pairwise(feet)]

    def reach(rng: np.random.Generator) -> _Reach:
        place = int(rng.integers(gaps))
        angle = 0.5 * (angles[place] + angles[place + 1]) + float(rng.uniform(-0.03, 0.03))
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        beyond = float(rng.uniform(0.05, 0.2))
        position = (radius + beyond) * out + rng.uniform(low + 0.15, high - 0.15) * _UP
        approach = out + rng.uniform(-0.3, 0.3) * _UP
        return _Reach(position, approach / np.linalg.norm(approach), rng.uniform(-0.15, 0.15), beyond + 0.1, place)

    return _Furniture(obstacles, reach)


_FURNITURE: dict[str, Callable[[np.random.Generator], _Furniture]] = {"table": _table, "shelf": _shelf, "cage": _cage}
