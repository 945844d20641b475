"""The surroundings of a machine as a survey: points of a scan, and a height map of the ground.

Both have their own frames. Files are written to a folder that is deleted when the process ends; their
content depends only on the generator, so that a site is the same wherever it is drawn.
"""

from __future__ import annotations

import atexit
import hashlib
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.ndimage import minimum_filter

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.obstacles import Record, extent, name_all
from validation.scenes import scene_of
from validation.signed_distances import obstacle_distance

_POINTS = 60_000  # drawn in the box around an obstacle; those of its shell are kept
_EDGES = {"planar4": 0.05, "backhoe": 0.06, "panda": 0.015, "telescope": 0.06}  # m, approximate, of a voxel
_GROUND = {"planar4": 0.5, "backhoe": -0.1, "panda": -0.02, "telescope": -0.1}  # m, approximate height of the ground
_REACH = {"planar4": 4.5, "backhoe": 7.5, "panda": 1.2, "telescope": 7.5}  # m, half an edge of the ground
_CELLS = (40, 120)  # of the ground along an edge, least and most
_STEEPEST = 1.5  # slope of the sides of a pit


@cache
def folder() -> Path:
    """The folder of the files in this process."""
    made = tempfile.TemporaryDirectory()
    atexit.register(made.cleanup)
    return Path(made.name)


def scan(robot: bp.Robot, machine: str, records: Sequence[Record], rng: np.random.Generator) -> Record:
    """One scan of the surfaces of obstacles, with noise, in a turned and shifted frame."""
    edge = _EDGES[machine] * float(rng.uniform(0.6, 1.8))
    found = []
    scene = scene_of(robot, name_all(records), start=robot.middle)
    for spec, record in zip(scene.obstacles, records, strict=True):
        points = rng.uniform(*extent(record), (_POINTS, 3))
        away = obstacle_distance(spec, scene)(points)
        found.append(points[(away <= 0.0) & (away > -2.0 * edge)])
    points = np.vstack(found)
    points += rng.normal(0.0, 0.1 * edge, points.shape)
    rpy = rng.uniform(-0.2, 0.2, 3) if rng.random() < 0.5 else np.zeros(3)
    R, t = pin.rpy.rpyToMatrix(*rpy), rng.uniform(-1.0, 1.0, 3)
    return {
        "shape": "pointcloud", "file": _written((points - t) @ R), "resolution": edge,
        "position": t.tolist(), "rpy": rpy.tolist(),
    }  # fmt: skip


def ground(robot: bp.Robot, machine: str, configurations: Matrix, clear: float, rng: np.random.Generator) -> Record:
    """Uneven ground with pits, in which the machine keeps about `clear` [m] at configurations (W, n).

    For an arm that moves in a level plane it is a wall of this kind.
    """
    half, count = _REACH[machine], int(rng.integers(*_CELLS))
    x = np.linspace(-half, half, count + 1)
    heights = _GROUND[machine] * float(rng.uniform(0.5, 1.5)) + np.zeros((count + 1, count + 1))
    for _ in range(int(rng.integers(2, 6))):
        size, (u, v), phase = rng.uniform(0.01, 0.05) * half, rng.uniform(-8.0, 8.0, 2) / half, rng.uniform(0.0, 6.3)
        heights += size * np.sin(u * x[None, :] + v * x[:, None] + phase)
    rpy = np.array([0.0, 0.0, rng.uniform(-0.5, 0.5)])
    t = np.array([*rng.uniform(-0.1, 0.1, 2) * half, 0.0])
    if machine == "planar4":
        away, turn = float(rng.uniform(1.5, 3.5)), float(rng.uniform(-np.pi, np.pi))
        inward = np.array([np.cos(turn), np.sin(turn), 0.0])
        rpy, t = np.array([0.0, 0.5 * np.pi, turn]), -(away + _GROUND[machine]) * inward
    R, cell = pin.rpy.rpyToMatrix(*rpy), 2.0 * half / count
    points = (_points_of(robot, configurations) - t) @ R
    at = np.round((points[:, :2] + half) / cell).astype(int)
    on = ((at >= 0) & (at <= count)).all(axis=1)
    most = np.full_like(heights, np.inf)
    np.minimum.at(most, (at[on, 1], at[on, 0]), points[on, 2] - 1.3 * clear)
    most = minimum_filter(most, size=2 * int(np.ceil(1.3 * clear / cell) + 1) + 1)
    for _ in range(count):
        most = np.minimum(most, minimum_filter(most, size=3) + _STEEPEST * cell)
    return {
        "shape": "heightmap", "file": _written(np.minimum(heights, most)), "size": [2.0 * half, 2.0 * half],
        "position": t.tolist(), "rpy": rpy.tolist(),
    }  # fmt: skip


def _written(numbers: Matrix) -> str:
    """Write these numbers to a file whose name depends only on its content; return the name."""
    name = f"{hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()[:16]}.csv"
    np.savetxt(folder() / name, numbers, fmt="%.4f", delimiter=",")
    return name


def _points_of(robot: bp.Robot, configurations: Matrix) -> Matrix:
    """(k, 3) points of the boxes around the pieces of all moving links, at configurations (W, n) [m], world."""
    data, found = robot.model.createData(), []
    grid = np.array(list(np.ndindex(9, 9, 9))) / 8.0
    for piece in robot.pieces:
        piece_points = _lattice(piece.piece.hull, piece.piece.placement.rotation, piece.piece.radius, grid)
        found.append((piece.joint, piece_points))
    placed = []
    for q in np.asarray(configurations, dtype=float):
        pin.forwardKinematics(robot.model, data, q)
        placed += [
            points @ data.oMi[joint].rotation.T + data.oMi[joint].translation for joint, points in found if joint
        ]
    return np.vstack(placed)


def _lattice(hull: Matrix, R: Matrix, radius: float, grid: Matrix) -> Matrix:
    own: Vector = hull @ R
    low, high = own.min(axis=0) - radius, own.max(axis=0) + radius
    return np.asarray((low + grid * (high - low)) @ R.T)
