"""Seeded random scenes for studies, benchmarks and tests.

A random site is named by machine, kind, task and index (`SiteKey`), and drawn from its
own generator with these as the seed: it does not depend on where, or in which order,
sites are drawn.

    kind        goal                                     path
    open        1 to 3 obstacles beside start and goal   1 to 3 beside a known motion
    cluttered   6 to 10 obstacles                        6 to 10 beside a known motion
    narrow      a trench, a gap, a slot under a beam,    a trench (backhoe), or obstacles
                pipes across the path                    a few centimetres from the motion
    scan        as open, as one point cloud
    terrain     as open, on uneven ground with pits about start and goal, or along the motion

What is known of each site is in its record. The start, and a configuration at the goal,
are always free with `SPARE` beyond every clearance. A solution is known (`way_known`) if
one of a few simple motions, or in narrow sites two small random trees that met, was
proven free. Of the first 40 sites of each kind this holds for

    open       25 planar4, 38 backhoe, 37 panda
    cluttered  14 planar4, 33 backhoe, 27 panda
    narrow     none of the gaps and slots of planar4; most of the others

Nothing is known of the rest; some may have no solution.

A path comes from a joint motion that follows it, free with `SPARE` beyond every
clearance, so a solution is known (for the panda always), unless the site is `blocked`,
that is, an obstacle was put on the path (a detour is then allowed, and no solution is
known), or the start is elsewhere and no motion to the path was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import tip_travel_bound
from backhoe_planner.motion import TipPath
from backhoe_planner.site import Waypoint
from validation.free_space import clear_along, margins, trees_meet
from validation.habitats import HABITATS, Narrows, banks, draw_narrows, folded_ways
from validation.obstacles import MACHINES, Record, extent, lump, name_all, pipe, random_fixtures, random_obstacle, shift
from validation.scenes import NO_TASK, quaternion, scene_of
from validation.surveys import folder, ground, scan

KINDS = ("open", "cluttered", "narrow")
SURVEYED = ("scan", "terrain")
TASKS = ("goal", "path")

SPARE = 0.01  # m beyond every clearance that free configurations keep
_LEG = 0.05  # m, the most between checked configurations along a tip path
_SAGITTA = 3e-3  # m, the most that the tip may deviate from the path between them
_TRIES = 400
_GROWTH = 60  # branches of the trees that search for a solution in a narrow site


@dataclass(frozen=True)
class SiteKey:
    """The name of a random site, which determines it."""

    machine: str
    kind: str
    task: str
    index: int
    seed: int = 0

    def __str__(self) -> str:
        return f"{self.machine}/{self.kind}/{self.task}/{self.index}"

    def generator(self, *turn: int) -> np.random.Generator:
        """The site's own generator; `turn` selects another one of the same site."""
        place = (MACHINES.index(self.machine), (*KINDS, *SURVEYED).index(self.kind), TASKS.index(self.task))
        return np.random.default_rng([self.seed, *place, self.index, *turn])


@dataclass(frozen=True, eq=False)
class Site:
    """A scene and what is known of it.

    Attributes
    ----------
    key: its name.
    scene: to be planned.
    form: of its narrow part (trench, gap, beam, pipes, close), or its kind.
    start_q: (n,) the free start; None if the scene has no start.
    goal_q: (n,) a free configuration at the goal, or at the end of the path.
    motion: (W, n) the joint motion from which the path was made, free unless the site is
        blocked; None for a goal.
    blocked: an obstacle is on the path.
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


def random_site(robot: bp.Robot, key: SiteKey) -> Site:
    """Draw the site that is named `key`; `robot` is `load_machine(key.machine)`.

    Raises
    ------
    ValueError: the machine, the kind or the task does not exist.
    """
    for turn in range(_TRIES):
        draft = _Draft(robot, key, key.generator(turn))
        site = draft.goal_site() if key.task == "goal" else draft.path_site()
        if site is not None:
            return site
    raise RuntimeError(f"no site could be drawn for {key} with seed {key.seed}")


class _Draft:
    """One attempt to draw a site; if a part returns None, the site is drawn again."""

    def __init__(self, robot: bp.Robot, key: SiteKey, rng: np.random.Generator) -> None:
        self.robot = robot
        self.key = key
        self.rng = rng
        self.habitat = HABITATS[key.machine]
        self.kinematics = bp.Kinematics(robot)

    # --- goals ---------------------------------------------------------------

    def goal_site(self) -> Site | None:
        narrows = draw_narrows(self.key.machine, self.key.index, self.rng) if self.key.kind == "narrow" else None
        form, built = (narrows.form, narrows.obstacles) if narrows else (self.key.kind, [])
        ends = self._free_ends(self._proximity(built), narrows)
        if ends is None:
            return None
        start, goal = ends
        # obstacles that collide with start or goal are left out, so nothing is drawn in vain
        wanted = self._count(len(built))
        loose = self._pipes(start, goal) if form == "pipes" else self._beside(np.array([start, goal]), wanted)
        if (form == "pipes" and not loose) or (self.key.kind != "narrow" and len(loose) < wanted):
            return None
        fixtures = self._keeping(random_fixtures(self.key.machine, self.rng), np.array([start, goal]))
        loose = self._surveyed(loose, np.array([start, goal]))
        obstacles = name_all(built + fixtures + loose)
        proximity = self._proximity(obstacles)
        if min(float(np.min(margins(proximity, q))) for q in (start, goal)) < SPARE:
            return None
        scene = self._scene(obstacles, {"goal": self._pose(goal)}, start)
        return Site(self.key, scene, form, start, goal, None, False, self._way(proximity, start, goal))

    def _free_ends(self, proximity: bp.Proximity, narrows: Narrows | None) -> tuple[Vector, Vector] | None:
        """Two free configurations with their tips apart and the narrow part between them."""
        free: list[tuple[Vector, Vector]] = []
        for _ in range(60):
            q = self._random_q()
            if np.min(margins(proximity, q)) <= SPARE:
                continue
            tip = self.kinematics.at(q).tip_position
            if not self.habitat.outside(tip, tip):
                continue
            for other, other_tip in free:
                if np.linalg.norm(tip - other_tip) < self.habitat.far:
                    continue
                if narrows is None or narrows.accepts(other_tip, tip):
                    return other, q
                if narrows.accepts(tip, other_tip):
                    return q, other
            free.append((q, tip))
        return None

    def _way(self, proximity: bp.Proximity, start: Vector, goal: Vector) -> bool:
        """Whether one of a few simple motions from start to goal is proven free."""
        ways = [np.array([start, goal])]
        ways += [np.array([start, *via, goal]) for via in folded_ways(self.key.machine, start, goal)]
        ways += [np.array([start, self.robot.random_q(self.rng), goal]) for _ in range(6)]
        if any(clear_along(proximity, way, 0.0) for way in ways):
            return True
        return self.key.kind == "narrow" and trees_meet(
            self.robot, proximity, start, goal, growth=_GROWTH, rng=self.rng
        )

    def _pipes(self, start: Vector, goal: Vector) -> list[Record]:
        """Two to four thin capsules across or beside the straight joint motion."""
        found = []
        for _ in range(int(self.rng.integers(2, 5))):
            part = float(self.rng.uniform(0.25, 0.75))
            at = self.kinematics.at((1.0 - part) * start + part * goal)
            joint = int(self.rng.integers(len(at.points) // 2, len(at.points)))
            middle = at.points[joint] + self.rng.normal(0.0, 0.5 * self.habitat.extra, 3) + 0.5 * self.habitat.extra
            found.append(pipe(self.key.machine, middle, self.rng))
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
            loose = self._keeping(banks(float(np.mean(looked[:, 0])), self.rng), looked)
            if len(loose) < 2:
                return None
        elif form == "narrow":
            form = "close"
            loose = self._close_to(looked, wanted)
        else:
            loose = self._beside(looked, wanted)
        if len(loose) < (2 if trench else wanted):
            return None
        fixtures = self._keeping(random_fixtures(self.key.machine, self.rng), looked)
        blocked = self.key.machine != "panda" and bool(self.rng.random() < 0.4)
        loose = self._surveyed(loose, looked)
        on_path = self._on_path(motion) if blocked else []
        if blocked and not on_path:
            return None
        obstacles = name_all(fixtures + loose + on_path)
        proximity = self._proximity(obstacles)
        if not blocked and not clear_along(proximity, motion, SPARE):
            return None
        start = self._path_start(proximity, motion)
        if start is not None and np.min(margins(proximity, start)) < SPARE:
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
            if np.min(margins(proximity, q)) > SPARE:
                return q
        return np.array(motion[0])

    def _bucket_motion(self, *, radial: bool) -> tuple[list[Record], Matrix] | None:
        """A path of two or three waypoints, and the joint motion that follows it.

        A radial path, for a trench, is in the plane of the arm and goes below the ground.
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
            if near and self.habitat.outside(tip, tip) and np.min(margins(proximity, q)) > SPARE:
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
        motion = self._follow(path, ends[0])
        if motion is None or not clear_along(proximity, motion, SPARE):
            return None
        return waypoints, motion

    def _follow(self, path: TipPath, first: Vector) -> Matrix | None:
        """(W, n) configurations along a path, each near the previous one; None if the path breaks off."""
        stations = np.unique(np.concatenate((np.arange(0.0, path.length, _LEG), path.stations))).tolist()
        reach = tip_travel_bound(self.robot)
        motion, station = [first], 0.0
        ahead = stations[:0:-1]
        while ahead:
            found = bp.solve_inverse_kinematics(self.robot, path.target(ahead[-1]), start=motion[-1], attempts=1)
            step = np.abs(found.q - motion[-1])
            # the sagitta of the tip's motion between the two: check in between if it may leave the path
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
            waypoints.append({"position": at.tip_position.tolist(), "quaternion": quaternion(at.tip_rotation)})
        length = float(np.sum(np.linalg.norm(np.diff(tips, axis=0), axis=1)))
        if not self.habitat.length[0] <= length <= self.habitat.length[1] or np.min(np.array(tips)[:, 2]) < 0.05:
            return None
        if not clear_along(self._proximity([]), motion, SPARE):
            return None
        return waypoints, motion

    def _on_path(self, motion: Matrix) -> list[Record]:
        """One obstacle on the middle of the path that leaves both its ends free."""
        middle = motion[int(len(motion) * self.rng.uniform(0.35, 0.65))]
        tip = self.kinematics.at(middle).tip_position
        off = self.rng.normal(0.0, 0.05, 3)
        return self._keeping([lump(self.key.machine, tip + off, self.rng)], motion[[0, -1]])

    # --- obstacles -------------------------------------------------------------

    def _count(self, built: int) -> int:
        if self.key.kind in ("open", *SURVEYED):
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
            drawn = [random_obstacle(self.key.machine, self.rng) for _ in range(2 * count)]
            found += self._keeping(drawn, configurations)
        return found[:count]

    def _close_to(self, configurations: Matrix, count: int) -> list[Record]:
        """Obstacles moved up to a few centimetres from a motion (W, n)."""
        found: list[Record] = []
        for _ in range(6):
            if len(found) >= count:
                break
            moved = []
            for record in (random_obstacle(self.key.machine, self.rng) for _ in range(2 * count)):
                proximity = self._proximity([record], itself=False)
                # a convex set that moves along the normal of its nearest point comes nearest there
                near = [proximity.at(q) for q in configurations[::5]]
                best = min((n for n in near if len(n)), key=lambda n: float(np.min(n.margin)), default=None)
                if best is None:
                    continue
                row = int(np.argmin(best.margin))
                wanted = float(self.rng.uniform(2.0 * SPARE, self.habitat.extra))
                step = -(float(best.margin[row]) - wanted) * best.normal[row]
                if np.linalg.norm(step) < 3.0 * self.habitat.far:
                    moved.append(shift(record, step))
            found += self._keeping(moved, configurations)
        return found[:count]

    def _keeping(self, records: Sequence[Record], configurations: Matrix) -> list[Record]:
        """Those outside the machine that leave every configuration (W, n) free."""
        records = [r for r in records if r["shape"] == "halfspace" or self.habitat.outside(*extent(r))]
        if not records:
            return []
        proximity = self._proximity(records, itself=False)
        if not proximity.pairs:
            return list(records)
        least = np.min([proximity.distances(q) - proximity.clearance for q in configurations], axis=0)
        hit = set(proximity.owner[least < 1.5 * SPARE].tolist())
        return [record for index, record in enumerate(records) if index not in hit]

    def _surveyed(self, records: list[Record], configurations: Matrix) -> list[Record]:
        """The obstacles in the form of this kind of site, with configurations (W, n) to be kept free."""
        if self.key.kind == "scan":
            return [scan(self.robot, self.key.machine, records, self.rng)]
        if self.key.kind == "terrain":
            clear = self.habitat.clearance + 2.0 * SPARE
            return [*records, ground(self.robot, self.key.machine, configurations, clear, self.rng)]
        return records

    # --- free or not -----------------------------------------------------------

    def _proximity(self, records: Sequence[Record], *, itself: bool = True) -> bp.Proximity:
        scene = self._scene(name_all(list(records)), NO_TASK, self.robot.middle)
        return bp.Proximity(self.robot, bp.build_obstacles(scene, self.robot), self_collision=itself)

    # --- the scene -------------------------------------------------------------

    def _random_q(self) -> Vector:
        """Uniform within the middle 96 % of the limits."""
        lower, upper = self.robot.limits.lower, self.robot.limits.upper
        return np.asarray(self.rng.uniform(lower + 0.02 * (upper - lower), upper - 0.02 * (upper - lower)))

    def _pose(self, q: Vector) -> Record:
        """The tip's pose at `q` as a goal: its position, and in some sites its angle too."""
        at = self.kinematics.at(q)
        pose: Record = {"position": at.tip_position.tolist()}
        kind = int(self.rng.integers(3))
        if self.robot.has_pitch and kind:
            low, high = self.rng.uniform(0.1, 0.5, 2) if kind == 1 else (0.0, 0.0)
            pose["pitch"] = [at.pitch - low, at.pitch + high] if kind == 1 else at.pitch
        elif self.key.machine == "panda" and kind:
            pose["quaternion"] = quaternion(at.tip_rotation)
        return pose

    def _scene(self, obstacles: Sequence[Record], task: Record, start: Vector | None) -> bp.Scene:
        room: Record = {"clearance": self.habitat.clearance, "influence": self.habitat.influence}
        if self.key.kind in SURVEYED:
            room["folder"] = folder()
        return scene_of(self.robot, obstacles, start=start, task=task, name=str(self.key), **room)
