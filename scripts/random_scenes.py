"""Seeded random scenes for studies, benchmarks and tests.

A random site is named by machine, kind, task and index (`SiteKey`), and drawn from a
generator of its own that is seeded with these: the same wherever, and in whichever
order, it is drawn.

    kind        goal                                     path
    open        1 to 3 obstacles beside start and goal   1 to 3 beside a known motion
    cluttered   6 to 10 obstacles                        6 to 10 beside a known motion
    narrow      a trench, a gap, a slot under a beam,    a trench (backhoe), or obstacles
                pipes across the way                     a few centimetres from the motion

What is known of each site stands in its record. The start, and a configuration at the
goal, are always free with `SPARE` beyond every clearance. That a way leads from one to
the other is known (`way_known`) where one of a few simple motions, or in narrow sites
two small random trees that met, was proven free. Of the first 40 sites of each kind
that is so in

    open       25 planar4, 38 backhoe, 37 panda
    cluttered  14 planar4, 33 backhoe, 27 panda
    narrow     none of the gaps and slots of planar4; most of the others

Of the rest nothing is known; some may have no solution.

A path comes from a joint motion that follows it, free with `SPARE` to spare: a
resolution is known (for the panda always), save where the site is `blocked`, that is
where an obstacle was put on the path (a detour is then allowed, and nothing is known
of it), or where the start lies elsewhere and no way to the path was found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

import backhoe_planner as bp
from backhoe_planner.machine import tip_travel_bound
from backhoe_planner.motion import TipPath, build_problem
from backhoe_planner.site import Waypoint

__all__ = [
    "KINDS",
    "MACHINES",
    "SPARE",
    "TASKS",
    "Site",
    "SiteKey",
    "load_machine",
    "random_planar_scene",
    "random_site",
]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Record = dict[str, Any]

MACHINES = ("planar4", "backhoe", "panda")
KINDS = ("open", "cluttered", "narrow")
TASKS = ("goal", "path")

SPARE = 0.01  # m beyond every clearance that what is called free keeps
_LEG = 0.05  # m between the configurations that are looked at along a tip path, at most
_SAGITTA = 3e-3  # m that the tip may be off the path between them
_TRIES = 400
_GROWTH = 60  # branches of the trees that look for a way in a narrow site


@dataclass(frozen=True)
class SiteKey:
    """The name of a random site, from which it is drawn."""

    machine: str
    kind: str
    task: str
    index: int
    seed: int = 0

    def __str__(self) -> str:
        return f"{self.machine}/{self.kind}/{self.task}/{self.index}"

    def generator(self, *turn: int) -> np.random.Generator:
        """The site's own generator; `turn` for another one of the same site."""
        place = (MACHINES.index(self.machine), KINDS.index(self.kind), TASKS.index(self.task))
        return np.random.default_rng([self.seed, *place, self.index, *turn])


@dataclass(frozen=True, eq=False)
class Site:
    """A scene, and what is known of it.

    Attributes
    ----------
    key: from which it was drawn.
    scene: what is to be planned.
    form: what makes it narrow (trench, gap, beam, pipes, close), or its kind.
    start_q: (n,) the free start; None where the scene leaves it out.
    goal_q: (n,) a free configuration at the goal, or at the end of the path.
    motion: (W, n) joint motion along the path from which the path was made, free where
        the site is not blocked; None for a goal.
    blocked: an obstacle stands on the path.
    way_known: a solution is known to exist.
    """

    key: SiteKey
    scene: bp.Scene
    form: str
    start_q: Vector | None
    goal_q: Vector
    motion: Matrix | None
    blocked: bool
    way_known: bool


@dataclass(frozen=True)
class _Habitat:
    """What is sensible around one machine.

    Attributes
    ----------
    source, tip: from which it is loaded.
    low, high: (3,) corners of the box that the machine itself fills [m].
    clearance, influence: of the scene [m].
    far: least distance between start and goal of the tip [m].
    length: least and greatest length of a path [m].
    extra: greatest margin of an obstacle that is close to the way [m].
    obstacle: draws one.
    fixtures: draws what belongs to every site.
    """

    source: str
    tip: str | None
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    clearance: float
    influence: float
    far: float
    length: tuple[float, float]
    extra: float
    obstacle: Callable[[np.random.Generator], Record]
    fixtures: Callable[[np.random.Generator], list[Record]]


@cache
def load_machine(machine: str) -> bp.Robot:
    """The robot for which the sites of a machine are drawn; loaded once in a process."""
    habitat = _HABITATS[machine]
    return bp.load_robot(habitat.source, tip=habitat.tip)


def random_site(robot: bp.Robot, key: SiteKey) -> Site:
    """Draw the site that is named `key`; `robot` is `load_machine(key.machine)`.

    Raises
    ------
    ValueError: the machine, the kind or the task does not exist.
    """
    for turn in range(_TRIES):
        workshop = _Workshop(robot, key, key.generator(turn))
        site = workshop.goal_site() if key.task == "goal" else workshop.path_site()
        if site is not None:
            return site
    raise RuntimeError(f"no site could be drawn for {key} with seed {key.seed}")


class _Workshop:
    """One attempt to draw a site; anything may come back as None and is then drawn anew."""

    def __init__(self, robot: bp.Robot, key: SiteKey, rng: np.random.Generator) -> None:
        self.robot = robot
        self.key = key
        self.rng = rng
        self.habitat = _HABITATS[key.machine]
        self.kinematics = bp.Kinematics(robot)

    # --- goals ---------------------------------------------------------------

    def goal_site(self) -> Site | None:
        form, built = self.key.kind, list[Record]()
        asked: Callable[[Vector, Vector], bool] = lambda start, goal: True  # noqa: E731
        if self.key.kind == "narrow":
            form, built, asked = _NARROW[self.key.machine](self.key.index, self.rng)
        fixed = self._proximity(built)
        ends = self._free_ends(fixed, asked)
        if ends is None:
            return None
        start, goal = ends
        # what would stand in the way of the ends is left out, so nothing is drawn in vain
        wanted = self._count(len(built))
        loose = [] if form == "pipes" else self._beside(np.array([start, goal]), wanted)
        if form == "pipes":
            loose = self._pipes(start, goal)
            if not loose:
                return None
        if self.key.kind != "narrow" and len(loose) < wanted:
            return None
        obstacles = _named(built + self._keeping(self.habitat.fixtures(self.rng), np.array([start, goal])) + loose)
        proximity = self._proximity(obstacles)
        if min(float(np.min(self._margins(proximity, q))) for q in (start, goal)) < SPARE:
            return None
        scene = self._scene(obstacles, {"goal": self._pose(goal, loose_pitch=True)}, start)
        way = self._way(proximity, start, goal)
        return Site(self.key, scene, form, start, goal, None, False, way)

    def _free_ends(
        self, proximity: bp.Proximity, asked: Callable[[Vector, Vector], bool]
    ) -> tuple[Vector, Vector] | None:
        """Two free configurations whose tips are apart and lie as the site asks."""
        free: list[tuple[Vector, Vector]] = []
        for _ in range(60):
            q = self._random_q()
            if np.min(self._margins(proximity, q)) <= SPARE:
                continue
            tip = self.kinematics.at(q).tip_position
            if not self._outside_machine(tip):
                continue
            for other, other_tip in free:
                if np.linalg.norm(tip - other_tip) < self.habitat.far:
                    continue
                if asked(other_tip, tip):
                    return other, q
                if asked(tip, other_tip):
                    return q, other
            free.append((q, tip))
        return None

    def _way(self, proximity: bp.Proximity, start: Vector, goal: Vector) -> bool:
        """Whether one of a few simple motions from start to goal is proven free."""
        ways = [np.array([start, goal])]
        ways += [np.array([start, *via, goal]) for via in _folded(self.key.machine, start, goal)]
        ways += [np.array([start, self.robot.random_q(self.rng), goal]) for _ in range(6)]
        if any(self._clear_along(proximity, way, 0.0) for way in ways):
            return True
        return self.key.kind == "narrow" and self._trees_meet(proximity, start, goal)

    def _trees_meet(self, proximity: bp.Proximity, start: Vector, goal: Vector) -> bool:
        """Whether two small random trees, grown from both ends through free space, meet."""
        trees = [[start], [goal]]
        for count in range(_GROWTH):
            here, there = trees[count % 2], trees[1 - count % 2]
            grown = self._towards(proximity, here, self.robot.random_q(self.rng))
            here.append(grown)
            met = self._towards(proximity, there, grown)
            if np.array_equal(met, grown):
                return True
            there.append(met)
        return False

    def _towards(self, proximity: bp.Proximity, tree: list[Vector], wanted: Vector) -> Vector:
        """(n,) as far from the nearest of a tree to `wanted` as the straight motion is proven free."""
        a = min(tree, key=lambda q: float(np.sum(np.square(q - wanted))))
        part = self._free_part(proximity, a, wanted, 0.0)
        return wanted if part >= 1.0 else a + 0.95 * part * (wanted - a)

    def _pipes(self, start: Vector, goal: Vector) -> list[Record]:
        """Two to four thin capsules across or beside the straight joint motion."""
        found = []
        for _ in range(int(self.rng.integers(2, 5))):
            part = float(self.rng.uniform(0.25, 0.75))
            at = self.kinematics.at((1.0 - part) * start + part * goal)
            joint = int(self.rng.integers(len(at.points) // 2, len(at.points)))
            middle = at.points[joint] + self.rng.normal(0.0, 0.5 * self.habitat.extra, 3) + 0.5 * self.habitat.extra
            found.append(_pipe(self.key.machine, middle, self.rng))
        return self._keeping(found, np.array([start, goal]))

    # --- paths ---------------------------------------------------------------

    def path_site(self) -> Site | None:
        trench = self.key.machine == "backhoe" and self.key.kind == "narrow" and self.key.index % 2 == 0
        drawn = self._smooth_motion() if self.key.machine == "panda" else self._bucket_motion(radial=trench)
        if drawn is None:
            return None
        waypoints, motion = drawn
        looked = motion[np.unique(np.linspace(0, len(motion) - 1, 50).astype(int))]
        form = self.key.kind
        wanted = self._count(0)
        if trench:
            form = "trench"
            loose = self._keeping(_banks(self._mean_swing(looked), self.rng), looked)
            if len(loose) < 2:
                return None
        elif form == "narrow":
            form = "close"
            loose = self._close_to(looked, wanted)
        else:
            loose = self._beside(looked, wanted)
        if len(loose) < (2 if trench else wanted):
            return None
        fixtures = self._keeping(self.habitat.fixtures(self.rng), looked)
        blocked = self.key.machine != "panda" and bool(self.rng.random() < 0.4)
        on_path = self._on_path(motion) if blocked else []
        if blocked and not on_path:
            return None
        obstacles = _named(fixtures + loose + on_path)
        proximity = self._proximity(obstacles)
        if not blocked and not self._clear_along(proximity, motion, SPARE):
            return None
        start = self._path_start(proximity, motion)
        if start is not None and np.min(self._margins(proximity, start)) < SPARE:
            return None
        detour = bool(self.key.machine != "panda" and (blocked or self.rng.random() < 0.5))
        path: Record = {"waypoints": waypoints, "detour": detour}
        if self.rng.random() < 0.5:
            path["speed"] = float(self.rng.uniform(0.3, 0.8) * (0.3 if self.key.machine == "panda" else 1.0))
        elsewhere = start is not None and not np.array_equal(start, motion[0])
        scene = self._scene(obstacles, {"path": path}, start)
        way = not blocked and (start is None or not elsewhere or self._way(proximity, start, motion[0]))
        return Site(self.key, scene, form, start, motion[-1], motion, blocked, way)

    def _path_start(self, proximity: bp.Proximity, motion: Matrix) -> Vector | None:
        """The motion's first configuration in half of the sites; else none, or elsewhere."""
        turn = self.key.index % 4
        if turn % 2 == 0:
            return np.array(motion[0])
        if turn == 1 or self.key.machine == "panda":
            return None
        for _ in range(100):
            q = self._random_q()
            if np.min(self._margins(proximity, q)) > SPARE:
                return q
        return np.array(motion[0])

    def _bucket_motion(self, *, radial: bool) -> tuple[list[Record], Matrix] | None:
        """A path of two or three waypoints, and the joint motion that follows it.

        A radial one, for a trench, lies in the plane of the arm and goes below the ground.
        """
        count = int(self.rng.integers(2, 4))
        proximity = self._proximity([])
        ends: list[Vector] = []
        for _ in range(60):
            q = self._random_q()
            if radial and ends:
                q[0] = ends[0][0]
            tip = self.kinematics.at(q).tip_position
            if radial and len(ends) == 1 and tip[2] > -0.3:
                continue
            near = not ends or 0.4 < float(np.linalg.norm(tip - self.kinematics.at(ends[-1]).tip_position)) < 3.0
            if near and self._outside_machine(tip) and np.min(self._margins(proximity, q)) > SPARE:
                ends.append(q)
            if len(ends) == count:
                break
        if len(ends) < count:
            return None
        angle = str(self.rng.choice(["", "pitch", "range"])) if self.robot.has_pitch else ""
        waypoints = []
        for q in ends:
            at = self.kinematics.at(q)
            waypoint: Record = {"position": at.tip_position.tolist()}
            if angle == "pitch":
                waypoint["pitch"] = at.pitch
            elif angle == "range":
                half = float(self.rng.uniform(0.2, 0.6))
                waypoint["pitch"] = [at.pitch - half, at.pitch + half]
            waypoints.append(waypoint)
        path = TipPath([Waypoint.model_validate(waypoint) for waypoint in waypoints])
        if not self.habitat.length[0] <= path.length <= self.habitat.length[1]:
            return None
        motion = self._followed(path, ends[0])
        if motion is None or not self._clear_along(proximity, motion, SPARE):
            return None
        return waypoints, motion

    def _followed(self, path: TipPath, first: Vector) -> Matrix | None:
        """(W, n) configurations along a path, each near the one before; None where it breaks off."""
        stations = np.unique(np.concatenate((np.arange(0.0, path.length, _LEG), path.stations))).tolist()
        reach = tip_travel_bound(self.robot)
        motion, station = [first], 0.0
        ahead = stations[:0:-1]
        while ahead:
            found = bp.solve_inverse_kinematics(
                self.robot, path.target(ahead[-1]), start=motion[-1], attempts=1, kinematics=self.kinematics
            )
            step = np.abs(found.q - motion[-1])
            # the sagitta of the tip's way between the two: where it may leave the path, look in between
            if not found.reached or 0.125 * float(np.sum(step) * (step @ reach)) > _SAGITTA:
                if ahead[-1] - station < _LEG / 16.0:
                    return None
                ahead.append(0.5 * (station + ahead[-1]))
                continue
            motion.append(found.q)
            station = ahead.pop()
        return np.array(motion)

    def _smooth_motion(self) -> tuple[list[Record], Matrix] | None:
        """200 to 500 full poses on a smooth joint motion."""
        lower, upper = self.robot.limits.lower, self.robot.limits.upper
        room = 0.05 * (upper - lower)
        knots = [self._random_q()]
        for _ in range(3):
            step = self.rng.normal(0.0, 0.3, self.robot.n)
            knots.append(np.clip(knots[-1] + step, lower + room, upper - room))
        count = int(self.rng.integers(200, 501))
        motion = np.asarray(CubicSpline(np.arange(4.0), np.array(knots))(np.linspace(0.0, 3.0, count)))
        if np.any(motion < lower + 0.02) or np.any(motion > upper - 0.02):
            return None
        waypoints, tips = [], []
        for q in motion:
            at = self.kinematics.at(q)
            tips.append(at.tip_position)
            waypoints.append({"position": at.tip_position.tolist(), "quaternion": _quaternion(at.tip_rotation)})
        length = float(np.sum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
        if not self.habitat.length[0] <= length <= self.habitat.length[1] or np.min(np.array(tips)[:, 2]) < 0.05:
            return None
        if not self._clear_along(self._proximity([]), motion, SPARE):
            return None
        return waypoints, motion

    def _on_path(self, motion: Matrix) -> list[Record]:
        """One obstacle on the middle of the path that leaves both its ends free."""
        middle = motion[int(len(motion) * self.rng.uniform(0.35, 0.65))]
        tip = self.kinematics.at(middle).tip_position
        off = self.rng.normal(0.0, 0.05, 3)
        return self._keeping([_lump(self.key.machine, tip + off, self.rng)], motion[[0, -1]])

    # --- obstacles -------------------------------------------------------------

    def _count(self, built: int) -> int:
        if self.key.kind == "open":
            return int(self.rng.integers(1, 4))
        if self.key.kind == "cluttered":
            return int(self.rng.integers(6, 11))
        return int(self.rng.integers(0, 3)) if built else int(self.rng.integers(3, 6))

    def _beside(self, configurations: Matrix, count: int) -> list[Record]:
        """Up to `count` obstacles that keep their clearance at every configuration (W, n)."""
        found: list[Record] = []
        for _ in range(4):
            if len(found) >= count:
                break
            drawn = [self.habitat.obstacle(self.rng) for _ in range(2 * count)]
            found += self._keeping(drawn, configurations)
        return found[:count]

    def _close_to(self, configurations: Matrix, count: int) -> list[Record]:
        """Obstacles brought up to a few centimetres from a motion (W, n)."""
        found: list[Record] = []
        for _ in range(6):
            if len(found) >= count:
                break
            moved = []
            for record in (self.habitat.obstacle(self.rng) for _ in range(2 * count)):
                proximity = self._proximity([record], itself=False)
                # the convex set moved along the normal of its nearest point comes nearest there
                near = [proximity.at(q) for q in configurations[::5]]
                best = min((n for n in near if len(n)), key=lambda n: float(np.min(n.margin)), default=None)
                if best is None:
                    continue
                row = int(np.argmin(best.margin))
                wanted = float(self.rng.uniform(2.0 * SPARE, self.habitat.extra))
                step = -(float(best.margin[row]) - wanted) * best.normal[row]
                if np.linalg.norm(step) < 3.0 * self.habitat.far:
                    moved.append(_shifted(record, step))
            found += self._keeping(moved, configurations)
        return found[:count]

    def _keeping(self, records: Sequence[Record], configurations: Matrix) -> list[Record]:
        """Those that stand outside the machine and leave every configuration (W, n) free."""
        records = [record for record in records if self._outside(record)]
        if not records:
            return []
        proximity = self._proximity(records, itself=False)
        if not proximity.pairs:
            return list(records)
        least = np.min([proximity.distances(q) - proximity.clearance for q in configurations], axis=0)
        hit = set(proximity.owner[least < 1.5 * SPARE].tolist())
        return [record for index, record in enumerate(records) if index not in hit]

    def _outside(self, record: Record) -> bool:
        """Whether an obstacle stands clear of the box that the machine itself fills."""
        if record["shape"] == "halfspace":
            return True
        low, high = _extent(record)
        return bool(np.any(high < np.array(self.habitat.low)) or np.any(low > np.array(self.habitat.high)))

    def _outside_machine(self, point: Vector) -> bool:
        return bool(np.any(point < np.array(self.habitat.low)) or np.any(point > np.array(self.habitat.high)))

    # --- free or not -----------------------------------------------------------

    def _proximity(self, records: Sequence[Record], *, itself: bool = True) -> bp.Proximity:
        scene = self._scene(_named(list(records)), {"goal": {"position": [1.0, 0.0, 0.0]}}, self.robot.middle)
        return bp.Proximity(self.robot, bp.build_obstacles(scene, self.robot), self_collision=itself)

    def _margins(self, proximity: bp.Proximity, q: Vector) -> Vector:
        if not proximity.pairs:
            return np.array([np.inf])
        return np.asarray(proximity.distances(q) - proximity.clearance)

    def _clear_along(self, proximity: bp.Proximity, way: Matrix, extra: float) -> bool:
        """Whether every margin is proven to be at least `extra` on the straight joint motions along `way`.

        Conservative advancement: no distance can shrink faster than the joints move
        times the reach of the link from them.
        """
        if any(self._free_part(proximity, a, b, extra) < 1.0 for a, b in pairwise(way)):
            return False
        return bool(np.min(self._margins(proximity, way[-1])) >= extra)

    def _free_part(self, proximity: bp.Proximity, a: Vector, b: Vector, extra: float) -> float:
        """The part of the straight joint motion from `a` to `b` that is proven to keep `extra`."""
        rate = proximity.travel @ np.abs(b - a)
        part = 0.0
        while part < 1.0:
            spare = proximity.distances(a + part * (b - a)) - proximity.clearance - extra
            step = float(np.min(np.where(rate > 1e-12, spare / np.maximum(rate, 1e-12), np.inf), initial=np.inf))
            if step < 2e-3 and part + step < 1.0:
                return part
            part += step
        return 1.0

    # --- the scene -------------------------------------------------------------

    def _random_q(self) -> Vector:
        """Uniform within the middle 96 % of the limits."""
        lower, upper = self.robot.limits.lower, self.robot.limits.upper
        return np.asarray(self.rng.uniform(lower + 0.02 * (upper - lower), upper - 0.02 * (upper - lower)))

    def _mean_swing(self, motion: Matrix) -> float:
        return float(np.mean(motion[:, 0]))

    def _pose(self, q: Vector, *, loose_pitch: bool) -> Record:
        """The tip's pose at `q` as a goal: the position, and in some sites the angle too."""
        at = self.kinematics.at(q)
        pose: Record = {"position": at.tip_position.tolist()}
        kind = int(self.rng.integers(3))
        if self.robot.has_pitch and kind:
            low, high = self.rng.uniform(0.1, 0.5, 2) if kind == 1 and loose_pitch else (0.0, 0.0)
            pose["pitch"] = [at.pitch - low, at.pitch + high] if kind == 1 else at.pitch
        elif self.key.machine == "panda" and kind:
            pose["quaternion"] = _quaternion(at.tip_rotation)
        return pose

    def _scene(self, obstacles: Sequence[Record], task: Record, start: Vector | None) -> bp.Scene:
        content: Record = {
            "version": 1,
            "name": str(self.key),
            "task": task,
            "obstacles": list(obstacles),
            "clearance": self.habitat.clearance,
            "influence": self.habitat.influence,
        }
        if start is not None:
            content["start"] = {"joints": dict(zip(self.robot.joint_names, start.tolist(), strict=True))}
        return bp.scene_from_dict(content)


# --- what stands on a site ----------------------------------------------------------


def _backhoe_obstacle(rng: np.random.Generator) -> Record:
    """A post, a boulder, a crate, a pipe, a spoil heap's block, around the machine."""
    radius, angle = rng.uniform(1.8, 6.5), rng.uniform(-1.6, 1.6)
    x, y = float(radius * np.cos(angle)), float(radius * np.sin(angle))
    kind = int(rng.integers(5))
    if kind == 0:
        ball = float(rng.uniform(0.2, 0.7))
        record: Record = {"shape": "sphere", "radius": ball, "position": [x, y, float(rng.uniform(-1.0, ball))]}
    elif kind == 1:
        size = rng.uniform([0.4, 0.4, 0.4], [2.0, 2.5, 1.6])
        base = float(rng.choice([0.0, -float(rng.uniform(0.5, 2.0))]))
        record = {
            "shape": "box",
            "size": size.tolist(),
            "position": [x, y, base + 0.5 * float(size[2])],
            "rpy": [0.0, 0.0, float(rng.uniform(-1.5, 1.5))],
        }
    elif kind == 2:
        length = float(rng.uniform(1.5, 7.0))
        record = {
            "shape": "cylinder",
            "radius": float(rng.uniform(0.08, 0.4)),
            "length": length,
            "position": [x, y, 0.5 * length],
        }
    elif kind == 3:
        record = _pipe("backhoe", np.array([x, y, rng.uniform(-2.0, -0.3)]), rng)
    else:
        height, turn = float(rng.uniform(2.0, 4.5)), float(rng.uniform(0.0, np.pi))
        half = 0.5 * float(rng.uniform(1.0, 4.0)) * np.array([np.cos(turn), np.sin(turn), 0.0])
        record = _capsule(
            np.array([x, y, height]) - half, np.array([x, y, height]) + half, float(rng.uniform(0.03, 0.15))
        )
    if rng.random() < 0.4:
        record["clearance"] = float(rng.choice([0.02, 0.1, 0.2, 0.3]))
    return record


def _backhoe_fixtures(rng: np.random.Generator) -> list[Record]:
    """The ground for boom and stick, and in some sites a line overhead."""
    found: list[Record] = []
    if rng.random() < 0.7:
        found.append({"shape": "halfspace", "point": [0, 0, 0], "normal": [0, 0, 1], "links": ["boom", "stick"]})
    if rng.random() < 0.3:
        height = float(rng.uniform(4.5, 7.0))
        found.append({"shape": "halfspace", "point": [0, 0, height], "normal": [0, 0, -1], "clearance": 0.5})
    return found


def _planar_obstacle(rng: np.random.Generator) -> Record:
    radius, angle = rng.uniform(0.6, 4.2), rng.uniform(-np.pi, np.pi)
    x, y = float(radius * np.cos(angle)), float(radius * np.sin(angle))
    kind = int(rng.integers(4))
    if kind == 0:
        record: Record = {"shape": "sphere", "radius": float(rng.uniform(0.1, 0.45)), "position": [x, y, 0.0]}
    elif kind == 1:
        size = [*rng.uniform(0.2, 1.0, 2).tolist(), 0.5]
        turn = [0.0, 0.0, float(rng.uniform(0.0, np.pi))]
        record = {"shape": "box", "size": size, "position": [x, y, 0.0], "rpy": turn}
    elif kind == 2:
        record = {
            "shape": "cylinder", "radius": float(rng.uniform(0.08, 0.4)), "length": 1.0, "position": [x, y, 0.0],
        }  # fmt: skip
    else:
        record = _pipe("planar4", np.array([x, y, 0.0]), rng)
    if rng.random() < 0.3:
        record["clearance"] = float(rng.choice([0.0, 0.05, 0.1]))
    return record


def _planar_fixtures(rng: np.random.Generator) -> list[Record]:
    """In some sites a wall that no link may pass."""
    if rng.random() > 0.3:
        return []
    turn, away = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(1.5, 3.5))
    inward = np.array([np.cos(turn), np.sin(turn), 0.0])
    return [{"shape": "halfspace", "point": (-away * inward).tolist(), "normal": inward.tolist()}]


def _panda_obstacle(rng: np.random.Generator) -> Record:
    radius, angle = rng.uniform(0.3, 0.95), rng.uniform(-np.pi, np.pi)
    size = rng.uniform(0.05, 0.4, 3)
    position = [float(radius * np.cos(angle)), float(radius * np.sin(angle)), float(rng.uniform(0.0, 1.0))]
    turn = [0.0, 0.0, float(rng.uniform(-np.pi, np.pi))] if rng.random() < 0.7 else rng.uniform(-1.5, 1.5, 3).tolist()
    return {"shape": "box", "size": size.tolist(), "position": position, "rpy": turn}


def _panda_fixtures(rng: np.random.Generator) -> list[Record]:
    """In half of the sites a table."""
    if rng.random() < 0.5:
        return []
    links = [*(f"panda_link{k}" for k in range(2, 8)), "panda_hand"]
    return [{"shape": "box", "size": [2.0, 2.0, 0.1], "position": [0.0, 0.0, -0.06], "links": links}]


def _lump(machine: str, middle: Vector, rng: np.random.Generator) -> Record:
    """A compact obstacle about a point."""
    scale = float(rng.uniform(0.08, 0.25)) * (1.0 if machine != "panda" else 0.3)
    if machine == "planar4":
        middle = middle * [1.0, 1.0, 0.0]
    if rng.random() < 0.5:
        return {"shape": "sphere", "radius": scale, "position": middle.tolist()}
    size = (2.0 * scale * rng.uniform(0.6, 1.4, 3)).tolist()
    return {"shape": "box", "size": size, "position": middle.tolist(), "rpy": [0.0, 0.0, float(rng.uniform(-1.5, 1.5))]}


def _pipe(machine: str, middle: Vector, rng: np.random.Generator) -> Record:
    """A thin capsule about a point, level in space, in the plane of a planar arm."""
    scale = {"backhoe": 1.0, "planar4": 0.4, "panda": 0.2}[machine]
    turn = float(rng.uniform(0.0, np.pi))
    half = 0.5 * scale * float(rng.uniform(1.0, 4.0)) * np.array([np.cos(turn), np.sin(turn), 0.0])
    middle = middle * [1.0, 1.0, 0.0] if machine == "planar4" else middle
    return _capsule(middle - half, middle + half, scale * float(rng.uniform(0.05, 0.2)))


def _capsule(a: Vector, b: Vector, radius: float) -> Record:
    return {"shape": "capsule", "from": a.tolist(), "to": b.tolist(), "radius": radius}


def _turned_box(size: Sequence[float], local: Sequence[float], turn: float) -> Record:
    """A box at `local` in axes turned about z."""
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = local
    place = [float(c * x - s * y), float(s * x + c * y), float(z)]
    return {"shape": "box", "size": [float(edge) for edge in size], "position": place, "rpy": [0.0, 0.0, turn]}


def _banks(turn: float, rng: np.random.Generator) -> list[Record]:
    """The soil on both sides of a trench that runs away from the machine."""
    gap, wide, depth = float(rng.uniform(0.85, 1.3)), 1.5, 3.0
    return [
        _turned_box([5.0, wide, depth], [4.0, side * 0.5 * (gap + wide), -0.5 * depth], turn) for side in (-1.0, 1.0)
    ]


# --- narrow sites: what is built, and how start and goal lie to it ------------------

_Asked = Callable[[Vector, Vector], bool]
_Built = tuple[str, list[Record], _Asked]


def _turned(point: Vector, turn: float) -> Vector:
    """(3,) `point` in axes turned about z."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([c * point[0] + s * point[1], -s * point[0] + c * point[1], point[2]])


def _narrow_backhoe(index: int, rng: np.random.Generator) -> _Built:
    turn = float(rng.uniform(-1.1, 1.1))
    form = ("trench", "gap", "beam", "pipes")[index % 4]
    if form == "trench":
        return form, _banks(turn, rng), lambda start, goal: bool(start[2] > 0.2 and goal[2] < -0.3)
    if form == "gap":
        gap, near = float(rng.uniform(1.0, 1.7)), float(rng.uniform(2.2, 3.2))
        height = float(rng.uniform(1.0, 4.0))
        walls = [
            _turned_box([2.5, 0.3, height], [near + 1.25, side * 0.5 * (gap + 0.3), 0.5 * height], turn)
            for side in (-1.0, 1.0)
        ]

        def into(start: Vector, goal: Vector) -> bool:
            a, b = _turned(start, turn), _turned(goal, turn)
            inside = b[0] > near + 0.2 and abs(b[1]) < 0.5 * gap and 0.0 < b[2] < height
            return bool(inside and abs(a[1]) > 0.5 * gap + 0.3)

        return form, walls, into
    if form == "beam":
        away, height = float(rng.uniform(2.6, 4.0)), float(rng.uniform(1.2, 2.4))
        a, b = (
            [away * np.cos(turn) - s * np.sin(turn), away * np.sin(turn) + s * np.cos(turn), height] for s in (-2, 2)
        )
        beam = _capsule(np.array(a, dtype=float), np.array(b, dtype=float), float(rng.uniform(0.1, 0.25)))

        def under(start: Vector, goal: Vector) -> bool:
            p, q = _turned(start, turn), _turned(goal, turn)
            below = q[0] > away + 0.3 and q[2] < height - 0.3 and abs(q[1]) < 1.5
            return bool(below and p[2] > height + 0.2)

        return form, [beam], under
    return form, [], lambda start, goal: True


def _narrow_planar(index: int, rng: np.random.Generator) -> _Built:
    turn = float(rng.uniform(-np.pi, np.pi))
    form = ("gap", "slot", "pipes")[index % 3]
    gap = float(rng.uniform(0.4, 0.8))
    if form == "gap":
        away = float(rng.uniform(1.2, 2.2))
        walls = [_turned_box([0.15, 1.6, 0.5], [away, side * (0.5 * gap + 0.8), 0.0], turn) for side in (-1.0, 1.0)]

        def beyond(start: Vector, goal: Vector) -> bool:
            a, b = _turned(start, turn), _turned(goal, turn)
            return bool(a[0] < away - 0.2 and b[0] > away + 0.3 and abs(b[1]) < 1.2)

        return form, walls, beyond
    if form == "slot":
        away = float(rng.uniform(1.4, 2.2))
        walls = [
            _turned_box([1.2, 0.15, 0.5], [away + 0.6, side * 0.5 * (gap + 0.15), 0.0], turn) for side in (-1.0, 1.0)
        ]

        def into(start: Vector, goal: Vector) -> bool:
            a, b = _turned(start, turn), _turned(goal, turn)
            return bool(away + 0.2 < b[0] < away + 1.2 and abs(b[1]) < 0.5 * gap and abs(a[1]) > gap)

        return form, walls, into
    return form, [], lambda start, goal: True


def _narrow_panda(index: int, rng: np.random.Generator) -> _Built:
    turn = float(rng.uniform(-np.pi, np.pi))
    form = ("gap", "shelf", "beam")[index % 3]
    away, floor = float(rng.uniform(0.4, 0.55)), float(rng.uniform(0.05, 0.4))
    if form == "shelf":
        inside = float(rng.uniform(0.3, 0.45))
        boards = [
            _turned_box([0.35, 0.8, 0.03], [away + 0.175, 0.0, height], turn) for height in (floor, floor + inside)
        ]

        def on_board(start: Vector, goal: Vector) -> bool:
            a, b = _turned(start, turn), _turned(goal, turn)
            held = away < b[0] < away + 0.35 and abs(b[1]) < 0.4 and floor < b[2] < floor + inside
            return bool(held and (a[0] < away or a[2] > floor + inside or abs(a[1]) > 0.4))

        return form, boards, on_board
    if form == "gap":
        gap = float(rng.uniform(0.25, 0.4))
        walls = [
            _turned_box([0.3, 0.04, 0.6], [away + 0.15, side * 0.5 * (gap + 0.04), floor + 0.3], turn)
            for side in (-1.0, 1.0)
        ]

        def between(start: Vector, goal: Vector) -> bool:
            a, b = _turned(start, turn), _turned(goal, turn)
            return bool(b[0] > away and abs(b[1]) < 0.5 * gap and b[2] < floor + 0.6 and abs(a[1]) > 0.5 * gap)

        return form, walls, between
    height = float(rng.uniform(0.35, 0.6))
    beam = _turned_box([0.08, 1.2, 0.08], [away, 0.0, height], turn)

    def under(start: Vector, goal: Vector) -> bool:
        a, b = _turned(start, turn), _turned(goal, turn)
        return bool(b[0] > away + 0.05 and b[2] < height - 0.05 and abs(b[1]) < 0.5 and a[2] > height + 0.05)

    return form, [beam], under


_NARROW: dict[str, Callable[[int, np.random.Generator], _Built]] = {
    "backhoe": _narrow_backhoe,
    "planar4": _narrow_planar,
    "panda": _narrow_panda,
}

_HABITATS = {
    "planar4": _Habitat(
        source="example:planar4", tip=None, low=(-0.25, -0.25, -1.0), high=(0.25, 0.25, 1.0),
        clearance=0.02, influence=0.4, far=1.0, length=(0.5, 4.0), extra=0.12,
        obstacle=_planar_obstacle, fixtures=_planar_fixtures,
    ),
    "backhoe": _Habitat(
        source="example:backhoe", tip=None, low=(-5.4, -1.35, 0.0), high=(0.85, 1.35, 2.9),
        clearance=0.05, influence=0.6, far=1.5, length=(0.6, 5.0), extra=0.2,
        obstacle=_backhoe_obstacle, fixtures=_backhoe_fixtures,
    ),
    "panda": _Habitat(
        source="example:panda", tip="panda_hand_tcp", low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.5),
        clearance=0.01, influence=0.2, far=0.3, length=(0.3, 2.0), extra=0.06,
        obstacle=_panda_obstacle, fixtures=_panda_fixtures,
    ),
}  # fmt: skip


def _folded(machine: str, start: Vector, goal: Vector) -> Iterator[Matrix]:
    """Ways by a folded arm: drawn in, swung over, stretched out again."""
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


def _named(records: list[Record]) -> list[Record]:
    return [{"name": f"{record['shape']} {index}", **record} for index, record in enumerate(records)]


def _shifted(record: Record, step: Vector) -> Record:
    moved = dict(record)
    for key in ("position", "from", "to"):
        if key in record:
            moved[key] = (np.array(record[key]) + step).tolist()
    return moved


def _extent(record: Record) -> tuple[Vector, Vector]:
    """Corners of the box along the axes that holds an obstacle [m]."""
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


def _quaternion(rotation: Matrix) -> list[float]:
    x, y, z, w = pin.Quaternion(rotation).coeffs().tolist()
    return [w, x, y, z]


# --- planar scenes of the study of the laws ------------------------------------------


def random_planar_scene(robot: bp.Robot, rng: np.random.Generator) -> tuple[bp.Scene, NDArray[np.float64]]:
    """A scene for a planar arm with 1 to 6 obstacles, and a free configuration at its goal.

    Start and goal configuration are drawn until both keep every clearance by a
    centimetre, so that each of them is free; whether a way leads from one to the other
    is not known.
    """
    kinematics = bp.Kinematics(robot)
    while True:
        content: dict[str, Any] = {
            "version": 1,
            "start": {"joints": dict.fromkeys(robot.joint_names, 0.0)},
            "task": {"goal": {"position": [1.0, 1.0, 0.0]}},
            "obstacles": [_obstacle(index, rng) for index in range(int(rng.integers(1, 7)))],
            "clearance": 0.02,
            "influence": 0.4,
        }
        problem = build_problem(robot, bp.scene_from_dict(content))
        proximity = bp.Proximity(robot, problem.obstacles)
        free: list[NDArray[np.float64]] = []
        for _ in range(100):
            q = robot.random_q(rng)
            if np.all(proximity.distances(q) > proximity.clearance + 0.01):
                free.append(q)
            if len(free) == 2:
                break
        if len(free) < 2:
            continue
        content["start"] = {"joints": dict(zip(robot.joint_names, free[0].tolist(), strict=True))}
        content["task"] = {"goal": {"position": kinematics.at(free[1]).tip_position.tolist()}}
        return bp.scene_from_dict(content), free[1]


def _obstacle(index: int, rng: np.random.Generator) -> dict[str, Any]:
    place = rng.uniform(-3.5, 3.5, 2)
    kind = int(rng.integers(3))
    name = f"obstacle {index}"
    if kind == 0:
        return {
            "name": name,
            "shape": "sphere",
            "radius": float(rng.uniform(0.1, 0.5)),
            "position": [*place.tolist(), 0.0],
        }
    if kind == 1:
        size = [*rng.uniform(0.2, 1.0, 2).tolist(), 0.5]
        turn = [0.0, 0.0, float(rng.uniform(0.0, 3.0))]
        return {"name": name, "shape": "box", "size": size, "position": [*place.tolist(), 0.0], "rpy": turn}
    half = rng.uniform(-0.7, 0.7, 2)
    ends = [[*(place - half).tolist(), 0.0], [*(place + half).tolist(), 0.0]]
    return {"name": name, "shape": "capsule", "radius": float(rng.uniform(0.05, 0.2)), "from": ends[0], "to": ends[1]}
