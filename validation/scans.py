"""A surveyed site: a scan of a million points, a terrain of a million cells, a fine mesh.

Their cost compared with the same site without them: the time to load, to plan and of a servo
step, and memory. Verified plans are checked against the points themselves, without the
package's distances.
"""

from __future__ import annotations

import gc
import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh
from scipy.spatial import ConvexHull

import backhoe_planner as bp
from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import TipTarget, solve_inverse_kinematics
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import plan_problem
from backhoe_planner.show import plan_page
from validation.step_times import ServoDrive, collecting_only_new

GROUND = -0.45  # m: mean height of the ground around the machine
FOLDS = 0.06  # m: amplitude of its waves
SCAN, TERRAIN, MESH = "scan", "terrain", "rock"
KINDS = (SCAN, TERRAIN, MESH)
SOLIDS = "solids"  # primitives at the places of the scan's points: the cost beyond these is that of the scan
START = {"swing": 0.0, "boom": 0.7, "stick": -1.2, "bucket": -1.2}
ROCK = (2.6, -4.2, 0.4)  # m: the place of the mesh
_CLEARANCE = 0.1  # m
_NEAR = 0.5  # m around a link, within which points are checked
_EVERY = 5  # samples of a motion from one that is checked to the next
_PITCHES, _ATTEMPTS = 360, 10  # steps of pitch over a goal's configurations, and starts for each
_BLOCK = 50  # steps of one servo before the next one's turn
_EXTENT = 15.0  # m to all sides of a scan
_SIZE = 50.0  # m, edge of a terrain
_PLAIN: tuple[dict[str, Any], ...] = (
    {"name": "power line", "shape": "halfspace", "point": [0, 0, 7.0], "normal": [0, 0, -1]},
    {"name": "truck", "shape": "box", "size": [2.4, 2.4, 1.2], "position": [1.0, 4.6, 0.9]},
    {"name": "pole", "shape": "cylinder", "radius": 0.15, "length": 5.0, "position": [4.4, -2.6, 2.5]},
    {"name": "pipe", "shape": "capsule", "from": [3.0, 1.6, -0.2], "to": [6.0, 1.8, -0.2], "radius": 0.1},
)
# the ground at its mean height, the wall, the heap and the bush of `scan_points`
_SOLIDS: tuple[dict[str, Any], ...] = (
    {"name": "ground", "shape": "halfspace", "point": [0, 0, GROUND], "normal": [0, 0, 1]},
    {"name": "wall", "shape": "box", "position": [2.0, -5.4, 1.025], "size": [8.0, 0.06, 2.95]},
    {"name": "heap", "shape": "mesh", "file": "heap.stl", "position": [4.6, 1.4, GROUND]},
    {"name": "bush", "shape": "sphere", "position": [3.4, 3.4, 0.4], "radius": 0.5},
)


@dataclass(frozen=True)
class Survey:
    """The files of a survey in a folder, and their content."""

    folder: Path
    points: Matrix

    def raw_points(self, kinds: Sequence[str]) -> Matrix:
        """(n, 3) points of the scan and of the terrain's grid, and corners of the mesh [m], world."""
        known: dict[str, Matrix] = {}
        if SCAN in kinds:
            known[SCAN] = self.points
        if TERRAIN in kinds:
            heights = np.loadtxt(self.folder / "terrain.csv", delimiter=",")
            x = np.linspace(-_SIZE / 2.0, _SIZE / 2.0, len(heights))
            known[TERRAIN] = np.column_stack((np.tile(x, len(x)), np.repeat(x, len(x)), heights.ravel()))
        if MESH in kinds:
            known[MESH] = np.asarray(trimesh.load(self.folder / "rock.stl").vertices) + ROCK
        return np.vstack([np.zeros((0, 3)), *known.values()])

    def obstacles(self, kinds: Sequence[str] = KINDS, *, resolution: float = 0.05) -> list[dict[str, Any]]:
        """The scene entries of these kinds."""
        known: dict[str, dict[str, Any]] = {
            SCAN: {"shape": "pointcloud", "file": "scan.ply", "resolution": resolution},
            TERRAIN: {"shape": "heightmap", "file": "terrain.csv", "size": [_SIZE, _SIZE]},
            MESH: {"shape": "mesh", "file": "rock.stl", "position": list(ROCK)},
        }
        solids = [dict(one) for one in _SOLIDS] if SOLIDS in kinds else []
        return [*solids, *({"name": kind, **known[kind]} for kind in kinds if kind != SOLIDS)]


def ground_height(x: Matrix, y: Matrix) -> Matrix:
    """Height of the ground at places x, y [m]."""
    return np.asarray(GROUND + FOLDS * np.sin(1.3 * x) * np.cos(0.9 * y))


def write_survey(folder: Path, rng: np.random.Generator, *, points: int, cells: int, triangles: int) -> Survey:
    """Write a scan, a terrain and a mesh of a yard: ground, a wall, a heap, a bush, a rock with a hole.

    Parameters
    ----------
    points, triangles: approximate numbers for the scan and the mesh.
    cells: along each edge of the terrain.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = scan_points(rng, points)
    trimesh.PointCloud(found).export(folder / "scan.ply")
    x = np.linspace(-_SIZE / 2.0, _SIZE / 2.0, cells + 1)
    heights = ground_height(x[None, :], x[:, None]) - 0.15 + rng.normal(0.0, 0.005, (cells + 1, cells + 1))
    np.savetxt(folder / "terrain.csv", heights, fmt="%.4f", delimiter=",")
    sections = max(round(np.sqrt(triangles / 2.0 / 0.3)), 8)
    rock = trimesh.creation.torus(0.9, 0.3, major_sections=sections, minor_sections=max(round(0.3 * sections), 6))
    rock.export(folder / "rock.stl")
    trimesh.creation.cone(radius=1.1, height=0.9, sections=16).export(folder / "heap.stl")
    return Survey(folder, np.asarray(trimesh.load(folder / "scan.ply").vertices, dtype=float))


def scan_points(rng: np.random.Generator, count: int) -> Matrix:
    """(count, 3) points on a yard's ground, a wall next to it, a heap and a bush [m]."""
    kind = rng.choice(4, size=count, p=[0.7, 0.15, 0.1, 0.05])
    xy = rng.uniform(-_EXTENT, _EXTENT, (count, 2))
    z = ground_height(xy[:, 0], xy[:, 1])
    points = np.column_stack((xy, z + rng.normal(0.0, 0.005, count)))
    wall = kind == 1
    points[wall] = np.column_stack(
        (rng.uniform(-2.0, 6.0, wall.sum()), rng.normal(-5.4, 0.01, wall.sum()), rng.uniform(GROUND, 2.5, wall.sum()))
    )
    heap = kind == 2
    around, off = rng.uniform(0.0, 2.0 * np.pi, heap.sum()), 1.1 * np.sqrt(rng.uniform(0.0, 1.0, heap.sum()))
    places = np.array([4.6, 1.4]) + off[:, None] * np.column_stack((np.cos(around), np.sin(around)))
    points[heap] = np.column_stack((places, GROUND + 0.9 * (1.0 - off / 1.1) + 0.0 * off))
    bush = kind == 3
    ball = rng.normal(size=(bush.sum(), 3))
    ball *= (0.5 * rng.uniform(0.2, 1.0, bush.sum()) / np.linalg.norm(ball, axis=1))[:, None]
    points[bush] = ball + np.array([3.4, 3.4, 0.4])
    return points


def site_scene(survey: Survey, goal: Vector, *, kinds: Sequence[str], resolution: float = 0.05) -> bp.Scene:
    """The yard with a goal for the tip (3,) [m] and the surveys of these kinds."""
    data: Mapping[str, Any] = {
        "version": 1,
        "start": {"joints": START},
        "task": {"goal": {"position": [round(float(value), 4) for value in goal]}},
        "clearance": _CLEARANCE,
        "obstacles": [*_PLAIN, *survey.obstacles(kinds, resolution=resolution)],
    }
    return bp.scene_from_dict(data, folder=survey.folder)


def goals(robot: bp.Robot, rng: np.random.Generator) -> Iterator[Vector]:
    """Yield places for the tip above the ground and within reach."""
    kinematics = bp.Kinematics(robot)
    while True:
        tip = kinematics.at(robot.random_q(rng)).tip_position
        if GROUND + 0.5 < tip[2] < 3.0:
            yield tip


def least_gap(robot: bp.Robot, motion: Matrix, points: Matrix) -> float:
    """Distance from raw points to the moving links over configurations (T, n) [m], without the package's distances.

    Links are the hulls of their pieces. A point is at least as far from a hull as from the plane of any face.
    """
    data, least = robot.model.createData(), np.inf
    moving = [piece for piece in robot.pieces if piece.joint > 0]
    planes = [ConvexHull(piece.piece.hull).equations if len(piece.piece.hull) > 3 else None for piece in moving]
    for q in motion:
        pin.forwardKinematics(robot.model, data, q)
        for piece, faces in zip(moving, planes, strict=True):
            T, hull, radius = data.oMi[piece.joint], piece.piece.hull, piece.piece.radius
            own = (points - T.translation) @ T.rotation
            own = own[((own > hull.min(axis=0) - _NEAR) & (own < hull.max(axis=0) + _NEAR)).all(axis=1)]
            if not len(own):
                continue
            if faces is None:  # a ball or a capsule
                way = hull[-1] - hull[0]
                part = np.clip((own - hull[0]) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
                away = np.linalg.norm(own - hull[0] - part[:, None] * way, axis=1)
            else:
                away = np.max(own @ faces[:, :3].T + faces[:, 3], axis=1)
            least = min(least, float(away.min()) - radius)
    return least


def widest_gap(robot: bp.Robot, goal: Vector, points: Matrix) -> float:
    """The largest `least_gap` of all configurations with the tip at a goal (3,), by steps of pitch [m].

    Minus infinity if there are none.
    """
    pitches = np.linspace(-np.pi, np.pi, _PITCHES, endpoint=False)
    found = [
        solve_inverse_kinematics(robot, TipTarget(goal, pitch=(pitch, pitch)), attempts=_ATTEMPTS) for pitch in pitches
    ]
    gaps = [least_gap(robot, one.q[None], points) for one in found if one.reached]
    return max(gaps, default=-np.inf)


@dataclass(frozen=True)
class Cost:
    """The costs of a site in addition to planning and steps.

    Attributes
    ----------
    intake: processor time to load it [s].
    memory: peak of the process until then [MB].
    page: size of the page of one plan [MB].
    """

    intake: float
    memory: float
    page: float


def measure(robot: bp.Robot, survey: Survey, kinds: Sequence[str], *, goal: Vector) -> Cost:
    """The cost of the yard with these kinds of surveys, and of one motion to a goal (3,) [m]."""
    scene = site_scene(survey, goal, kinds=kinds)
    gc.collect()  # or the files of an earlier call would be known
    begun = time.process_time()
    problem = build_problem(robot, scene)
    intake = time.process_time() - begun
    page = len(plan_page(plan_problem(problem))[0]) / 1e6
    bp.Servo(robot, scene)  # which needs memory too
    return Cost(intake, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, page)


def drive_in_turn(
    robot: bp.Robot, survey: Survey, sets: Sequence[Sequence[str]], *, goal: Vector, steps: int, seed: int
) -> Matrix:
    """(S, steps) processor times of the servo's steps with each of S sets of surveys and the same wishes [us].

    They take some steps in turn, so that other load on the computer slows all of them alike.

    goal: (3,) of the scene [m]; the servo does not use it.
    """
    servos = [bp.Servo(robot, site_scene(survey, goal, kinds=kinds)) for kinds in sets]
    with collecting_only_new():
        drives = [ServoDrive(servo, 0, np.random.default_rng(seed)) for servo in servos]
        taken: list[list[Vector]] = [[] for _ in drives]
        for _ in range(max(steps // _BLOCK, 1)):
            for drive, times in zip(drives, taken, strict=True):
                times.append(drive.take(_BLOCK).whole)
    return np.array([np.concatenate(times) for times in taken])


@dataclass(frozen=True)
class PlanCosts:
    """The costs of planning to G goals with each of S sets of surveys.

    Attributes
    ----------
    seconds: (G, S) processor time of planning, without loading the site [s].
    durations: (G, S) of the verified plans, nan for the others [s].
    least_gap: (S,) of all verified plans from the raw points [m]; infinite without surveys.
    blocked: (G, S) whether no configuration with the tip at the goal keeps the clearance from the raw points; not
        checked for goals with a verified plan.
    """

    seconds: Matrix
    durations: Matrix
    least_gap: Vector
    blocked: Flags


def plan_in_turn(robot: bp.Robot, survey: Survey, sets: Sequence[Sequence[str]], *, count: int, seed: int) -> PlanCosts:
    """Plan to goals that can be reached in the yard without surveys, with all sets in turn for each.

    Parameters
    ----------
    sets: of kinds, the first of them empty; it is used before and after the others, for the mean.
    count: number of goals.
    """
    raw = [survey.raw_points(kinds) for kinds in sets]
    places = goals(robot, np.random.default_rng(seed))
    seconds: list[list[float]] = []
    durations: list[list[float]] = []
    blocked: list[list[bool]] = []
    gaps = np.full(len(sets), np.inf)
    while len(seconds) <= count:  # the first goal warms up
        goal = next(places)
        taken, plan = _timed(robot, site_scene(survey, goal, kinds=()))
        if not plan.certificate.verified:
            continue
        row, lasts = [taken], [plan.trajectory.duration]
        for number, kinds in enumerate(sets[1:], start=1):
            taken, plan = _timed(robot, site_scene(survey, goal, kinds=kinds))
            row.append(taken)
            lasts.append(plan.trajectory.duration if plan.certificate.verified else np.nan)
            if plan.certificate.verified:
                gaps[number] = min(gaps[number], least_gap(robot, plan.trajectory.q[::_EVERY], raw[number]))
        row[0] = 0.5 * (row[0] + _timed(robot, site_scene(survey, goal, kinds=()))[0])
        seconds.append(row)
        durations.append(lasts)
        blocked.append(
            [
                not np.isfinite(taken) and widest_gap(robot, goal, points) < _CLEARANCE
                for taken, points in zip(lasts, raw, strict=True)
            ]
        )
    return PlanCosts(np.array(seconds[1:]), np.array(durations[1:]), gaps, np.array(blocked[1:]))


def _timed(robot: bp.Robot, scene: bp.Scene) -> tuple[float, bp.Plan]:
    """The processor time of planning with the site loaded [s], and the plan."""
    problem = build_problem(robot, scene)
    begun = time.process_time()
    plan = plan_problem(problem)
    return time.process_time() - begun, plan
