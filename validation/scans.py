"""A site as it comes from a survey: a scan of a million points, a terrain of a million cells, a fine mesh.

What they cost beside the same site without them: the time to take them in, to plan and of a
servo's step, and memory. What is verified is checked against the points themselves, without
the package's distances.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector

GROUND = -0.45  # m: mean height of the ground around the machine
FOLDS = 0.06  # m: amplitude of its waves
SCAN, TERRAIN, MESH = "scan", "terrain", "rock"
KINDS = (SCAN, TERRAIN, MESH)
START = {"swing": 0.0, "boom": 0.7, "stick": -1.2, "bucket": -1.2}
_EXTENT = 15.0  # m to all sides of a scan
_SIZE = 50.0  # m, edge of a terrain
_PLAIN: tuple[dict[str, Any], ...] = (
    {"name": "power line", "shape": "halfspace", "point": [0, 0, 7.0], "normal": [0, 0, -1]},
    {"name": "truck", "shape": "box", "size": [2.4, 2.4, 1.2], "position": [1.0, 4.6, 0.9]},
    {"name": "pole", "shape": "cylinder", "radius": 0.15, "length": 5.0, "position": [4.4, -2.6, 2.5]},
    {"name": "pipe", "shape": "capsule", "from": [3.0, 1.6, -0.2], "to": [6.0, 1.8, -0.2], "radius": 0.1},
)


@dataclass(frozen=True)
class Survey:
    """The files of a survey in a folder, and what they hold."""

    folder: Path
    points: Matrix

    def obstacles(self, kinds: Sequence[str] = KINDS, *, resolution: float = 0.05) -> list[dict[str, Any]]:
        """Their entries in a scene."""
        known: dict[str, dict[str, Any]] = {
            SCAN: {"shape": "pointcloud", "file": "scan.ply", "resolution": resolution},
            TERRAIN: {"shape": "heightmap", "file": "terrain.csv", "size": [_SIZE, _SIZE]},
            MESH: {"shape": "mesh", "file": "rock.stl", "position": [2.6, -4.2, 0.4]},
        }
        return [{"name": kind, **known[kind]} for kind in kinds]


def ground_height(x: Matrix, y: Matrix) -> Matrix:
    """Height of the ground at places x, y [m]."""
    return np.asarray(GROUND + FOLDS * np.sin(1.3 * x) * np.cos(0.9 * y))


def write_survey(folder: Path, rng: np.random.Generator, *, points: int, cells: int, triangles: int) -> Survey:
    """Write a scan, a terrain and a mesh of a yard: ground, a wall, a heap, a bush, a rock with a hole.

    Parameters
    ----------
    points, triangles: of the scan and of the mesh, about.
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
    return Survey(folder, np.asarray(trimesh.load(folder / "scan.ply").vertices, dtype=float))


def scan_points(rng: np.random.Generator, count: int) -> Matrix:
    """(count, 3) points on a yard's ground, a wall beside it, a heap and a bush [m]."""
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
    """The yard with a goal for the tip (3,) [m], and what was surveyed of it."""
    data: Mapping[str, Any] = {
        "version": 1,
        "start": {"joints": START},
        "task": {"goal": {"position": [round(float(value), 4) for value in goal]}},
        "clearance": 0.1,
        "obstacles": [*_PLAIN, *survey.obstacles(kinds, resolution=resolution)],
    }
    return bp.scene_from_dict(data, folder=survey.folder)


def goals(robot: bp.Robot, rng: np.random.Generator) -> Iterator[Vector]:
    """Places of the tip above the ground, within reach, one after the other."""
    kinematics = bp.Kinematics(robot)
    while True:
        tip = kinematics.at(robot.random_q(rng)).tip_position
        if GROUND + 0.5 < tip[2] < 3.0:
            yield tip


def nearest_point_gap(robot: bp.Robot, q: Vector, points: Matrix) -> float:
    """Distance from a scan's points to the nearest moving link at q (n,) [m]; 0 where one is inside.

    Of links as boxes, balls and hulls by the planes of their faces: for a point outside of a hull, the
    furthest of the planes it is beyond, which is at most its distance.
    """
    from scipy.spatial import ConvexHull

    placed = bp.Kinematics(robot).at(q)
    del placed
    data = robot.model.createData()
    import pinocchio as pin

    pin.forwardKinematics(robot.model, data, q)
    least = np.inf
    for piece in robot.pieces:
        if piece.joint == 0:
            continue
        T = data.oMi[piece.joint]
        own = (points - T.translation) @ T.rotation
        hull = piece.piece.hull
        low, high = hull.min(axis=0) - 0.5, hull.max(axis=0) + 0.5
        own = own[((own > low) & (own < high)).all(axis=1)]
        if not len(own):
            continue
        if len(hull) < 4:
            ends = hull[[0, -1]]
            way = ends[1] - ends[0]
            part = np.clip((own - ends[0]) @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
            away = np.linalg.norm(own - ends[0] - part[:, None] * way, axis=1) - piece.piece.radius
        else:
            planes = ConvexHull(hull).equations
            away = np.max(own @ planes[:, :3].T + planes[:, 3], axis=1) - piece.piece.radius
        least = min(least, float(away.min()))
    return least


@dataclass(frozen=True)
class Cost:
    """What a site costs: processor time to take it in, to plan and of a servo's step [s], and memory [MB]."""

    intake: float
    plan: float
    step: float
    memory: float


def resident() -> float:
    """The most memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def processor_time() -> float:
    """Of this process [s]."""
    return time.process_time()
