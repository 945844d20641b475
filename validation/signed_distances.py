"""Exact signed distances of points to shapes in plain numpy, independent of the planner and of coal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.site.schema import obstacle_shapes

SignedDistance = Callable[[Matrix], NDArray[np.float64]]
_APART = 0.02  # m between points on a height map, along a cell's edge; at most 2.5 cm between any neighbours
_NEAREST = (8, 64)  # voxels, those with the nearest middles, among which the nearest one is searched


def sphere_distance(points: Matrix, radius: float) -> NDArray[np.float64]:
    """(K,) exact signed distance of points (K, 3) to a sphere, centred."""
    return np.asarray(np.linalg.norm(points, axis=1) - radius)


def box_distance(points: Matrix, size: Matrix) -> NDArray[np.float64]:
    """(K,) exact signed distance of points (K, 3) to a box of full edges `size`, centred."""
    off = np.abs(points) - size / 2.0
    return np.asarray(np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(np.max(off, axis=1), 0.0))


def cylinder_distance(points: Matrix, radius: float, length: float) -> NDArray[np.float64]:
    """(K,) exact signed distance to a cylinder along z, centred."""
    off = np.column_stack((np.hypot(points[:, 0], points[:, 1]) - radius, np.abs(points[:, 2]) - length / 2.0))
    return np.asarray(np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(np.max(off, axis=1), 0.0))


def capsule_distance(points: Matrix, start: Matrix, end: Matrix, radius: float) -> NDArray[np.float64]:
    """(K,) exact signed distance to a capsule."""
    axis = end - start
    square = float(axis @ axis)
    part = np.clip((points - start) @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    return np.asarray(np.linalg.norm(points - start - part[:, None] * axis, axis=1) - radius)


def hull_distance(points: Matrix, planes: Matrix) -> NDArray[np.float64]:
    """(K,) largest distance over the `planes` (F, 4) of a convex hull, n x + d = 0: never above the true distance."""
    return np.asarray(np.max(points @ planes[:, :3].T + planes[:, 3], axis=1))


def height_map_distance(heights: Matrix, size: tuple[float, float]) -> SignedDistance:
    """The distance to the ground below a height map, centred, by points on its surface at most 2.5 cm apart.

    It exceeds the true distance by less than 0.8 mm at 0.1 m. Between four heights the surface is bilinear.
    """
    rows, columns = heights.shape
    x, y = (
        np.linspace(-0.5 * extent, 0.5 * extent, count) for extent, count in zip(size, (columns, rows), strict=True)
    )
    corners = np.stack((heights[:-1, :-1], heights[:-1, 1:], heights[1:, :-1], heights[1:, 1:]))
    points = []
    parts = np.ceil(np.hypot(np.ptp(corners, axis=0), max(x[1] - x[0], y[1] - y[0])) / _APART)
    for count in np.unique(parts).astype(int).tolist():
        i, j = np.nonzero(parts == count)
        part = (np.arange(count) + 0.5) / count
        for u in part.tolist():
            for v in part.tolist():
                a, b, c, d = (corner[i, j] for corner in corners)
                z = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
                points.append(np.column_stack((x[j] + u * (x[1] - x[0]), y[i] + v * (y[1] - y[0]), z)))
    tree = cKDTree(np.vstack(points))

    def distance(at: Matrix) -> NDArray[np.float64]:
        far, _ = tree.query(at)
        column = np.clip((at[:, 0] - x[0]) / (x[1] - x[0]), 0.0, columns - 1.0)
        row = np.clip((at[:, 1] - y[0]) / (y[1] - y[0]), 0.0, rows - 1.0)
        j, i = np.minimum(column.astype(int), columns - 2), np.minimum(row.astype(int), rows - 2)
        u, v = column - j, row - i
        a, b, c, d = (corner[i, j] for corner in corners)
        z = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
        over = (np.abs(at[:, 0]) <= 0.5 * size[0]) & (np.abs(at[:, 1]) <= 0.5 * size[1])
        return np.asarray(np.where(over & (at[:, 2] < z), -far, far))

    return distance


def voxels_distance(points: Matrix, edge: float) -> SignedDistance:
    """The distance to all voxels with an `edge` [m] that contain any of `points` (k, 3).

    It is exact if no more than 64 voxels have a middle nearer than the nearest one's farthest corner, which holds up
    to some 40 edges from a wall. Further away it may exceed the true distance by less than half an edge. Within
    voxels it is the depth in the deepest.
    """
    half = 0.5 * edge
    middles = (np.unique(np.floor(points / edge), axis=0) + 0.5) * edge
    tree = cKDTree(middles)

    def distance(at: Matrix) -> NDArray[np.float64]:
        found = np.full(len(at), np.inf)
        open_ = np.arange(len(at))
        for count in _NEAREST:
            count = min(count, len(middles))
            away, number = tree.query(at[open_], k=[*range(1, count + 1)])
            off = np.abs(at[open_, None] - middles[number]) - half
            out = np.linalg.norm(np.maximum(off, 0.0), axis=2) + np.minimum(np.max(off, axis=2), 0.0)
            found[open_] = np.min(out, axis=1)
            # a voxel with a middle further away than that is no nearer
            open_ = open_[away[:, -1] - np.sqrt(3.0) * half < found[open_]]
            if not len(open_) or count == len(middles):
                break
        return found

    return distance


def obstacle_distance(spec: obstacle_shapes.ObstacleSpec, scene: bp.Scene) -> SignedDistance:
    """The distance to an obstacle of a scene at its place at time 0, as a function of points (K, 3).

    Points of a scan are read from text; a PLY is not read here.
    """
    if isinstance(spec, obstacle_shapes.HalfSpace):
        point, normal = np.array(spec.point), np.array(spec.normal)
        return lambda points: np.asarray((points - point) @ normal)
    if isinstance(spec, obstacle_shapes.Capsule):
        start, end = np.array(spec.start), np.array(spec.end)
        return lambda points: capsule_distance(points, start, end, spec.radius)
    rotation, place = spec.placement.rotation, spec.placement.translation

    def local(points: Matrix) -> Matrix:
        return np.asarray((points - place) @ rotation)

    if isinstance(spec, obstacle_shapes.Sphere):
        return lambda points: sphere_distance(points - place, spec.radius)
    if isinstance(spec, obstacle_shapes.Box):
        size = np.array(spec.size)
        return lambda points: box_distance(local(points), size)
    if isinstance(spec, obstacle_shapes.Cylinder):
        return lambda points: cylinder_distance(local(points), spec.radius, spec.length)
    if isinstance(spec, obstacle_shapes.Mesh):
        mesh = spec.loaded(scene.folder)
        return lambda points: -np.asarray(trimesh.proximity.signed_distance(mesh, local(points)))
    if isinstance(spec, obstacle_shapes.HeightMap):
        far = height_map_distance(np.loadtxt(scene.folder / spec.file, delimiter=",", ndmin=2), spec.size)
        return lambda points: far(local(points))
    points = np.loadtxt(scene.folder / spec.file, delimiter=",", ndmin=2)[:, :3]
    near = voxels_distance(points, spec.resolution)
    return lambda at: near(local(at))
