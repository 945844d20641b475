"""Points on every link's collision shape, read from the URDF itself, as trees of balls.

`LinkDistances` is for one configuration, `independent_check` for whole motions.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.machine import load_mesh, mesh_frame
from validation.signed_distances import SignedDistance, box_distance, cylinder_distance, hull_distance, sphere_distance

Indices = NDArray[np.intp]

SPACING = 0.04  # m, the most between points on a surface
BRANCHES = 8  # of a ball: as in an octree, by three halvings of the points
_ON_MESH = 1500  # points on a mesh in addition to its corners


@dataclass(frozen=True, eq=False)
class Cover:
    """Points on all collision shapes of a link, as a tree of balls in the frame of its joint.

    A ball without children is a point; its radius is the reach of the shape beyond it.
    """

    link: str
    joint: int
    centre: Matrix  # (M, 3)
    radius: NDArray[np.float64]  # (M,)
    first: Indices  # (M,) the first child, -1 if there is none
    children: Indices  # (M,) number of children

    @property
    def points(self) -> Matrix:
        """(N, 3) the points alone, without the balls around them."""
        return self.centre[self.first < 0]


@dataclass(frozen=True, eq=False)
class Solid:
    """One collision shape of a link, which other links must not touch."""

    link: str
    joint: int
    T_joint_shape: pin.SE3
    signed_distance: SignedDistance  # in the frame of the shape


@dataclass(frozen=True)
class Nearest:
    """The least signed distance found [m] and its two bodies; infinite if nothing was near."""

    distance: float
    link: str
    obstacle: str


class LinkDistances:
    """Signed distances of the links' surface points to placed shapes, at one configuration at a time.

    Parameters
    ----------
    links: names of the links; all moving ones by default.
    """

    def __init__(self, robot: bp.Robot, *, links: Iterable[str] | None = None) -> None:
        self._robot = robot
        self._data = robot.model.createData()
        covers, _ = link_shapes(robot)
        self._covers = [c for c in covers if c.joint > 0 and (links is None or c.link in links)]

    def least(
        self, q: NDArray[np.float64], obstacles: Mapping[str, tuple[SignedDistance, NDArray[np.float64]]]
    ) -> Nearest:
        """The least at `q` (n,) over obstacles given as distance and shift (3,); only exact below 0.3 m."""
        pin.forwardKinematics(self._robot.model, self._data, q)
        found = Nearest(np.inf, "", "")
        for cover in self._covers:
            placement = self._data.oMi[cover.joint]
            middle = placement.rotation @ cover.centre[0] + placement.translation
            points = None
            for name, (distance, shift) in obstacles.items():
                rough = float(distance((middle - shift)[None])[0]) - float(cover.radius[0])
                if rough > min(0.3, found.distance):
                    continue
                if points is None:
                    points = cover.points @ placement.rotation.T + placement.translation
                exact = float((distance(points - shift) - cover.radius[cover.first < 0]).min())
                if exact < found.distance:
                    found = Nearest(exact, cover.link, name)
        return found


@lru_cache(maxsize=8)
def link_shapes(robot: bp.Robot) -> tuple[list[Cover], list[Solid]]:
    """Every link's cover, and every shape of every link."""
    covers, solids = [], []
    for link in robot.urdf.robot.links:
        if not link.collisions:
            continue
        frame = robot.model.frames[robot.model.getFrameId(link.name, pin.FrameType.BODY)]
        joint, sets, fats = int(frame.parentJoint), [], []
        for collision in link.collisions:
            origin = np.eye(4) if collision.origin is None else collision.origin
            T = frame.placement * pin.SE3(origin[:3, :3], origin[:3, 3])
            points, fat, distance = _shape(robot, collision.geometry)
            sets.append(points @ T.rotation.T + T.translation)
            fats.append(np.full(len(points), fat))
            solids.append(Solid(link.name, joint, T, distance))
        covers.append(_cover(link.name, joint, np.vstack(sets), np.concatenate(fats)))
    return covers, solids


def _cover(link: str, joint: int, points: Matrix, fat: NDArray[np.float64]) -> Cover:
    """The tree of balls over points (N, 3) that reach `fat` (N,) beyond themselves [m]."""
    levels = []
    members, sizes, known = np.arange(len(points)), np.array([len(points)]), 1
    while len(sizes):
        begin = np.cumsum(sizes) - sizes
        held, alone = points[members], sizes == 1
        centre = 0.5 * (np.minimum.reduceat(held, begin) + np.maximum.reduceat(held, begin))
        centre[alone] = held[begin[alone]]
        away = np.linalg.norm(held - np.repeat(centre, sizes, axis=0), axis=1)
        radius = np.maximum.reduceat(away + fat[members], begin)
        # points have no parts; all other balls of a level are split at once
        members, sizes = members[np.repeat(~alone, sizes)], sizes[~alone]
        members, sizes, children = _split(points, members, sizes)
        first, counts = np.full(len(alone), -1), np.zeros(len(alone), dtype=int)
        first[~alone], counts[~alone] = known + np.cumsum(children) - children, children
        known += len(sizes)
        levels.append((centre, radius, first, counts))
    return Cover(link, joint, *(np.concatenate(parts) for parts in zip(*levels, strict=True)))


def _split(points: Matrix, members: Indices, sizes: Indices) -> tuple[Indices, Indices, Indices]:
    """Split sets of points into up to `BRANCHES` parts each, across their longest sides.

    Parameters
    ----------
    members: (N,) indices of points, set by set.
    sizes: (S,) number of points of each set, 2 or more.

    Returns
    -------
    (N,) and (P,) the same for the parts, and (S,) number of parts of each set.
    """
    children = np.ones(len(sizes), dtype=int)
    if not len(sizes):
        return members, sizes, children
    owner = np.arange(len(sizes))
    for _ in range(BRANCHES.bit_length() - 1):
        begin, held = np.cumsum(sizes) - sizes, points[members]
        axis = np.argmax(np.maximum.reduceat(held, begin) - np.minimum.reduceat(held, begin), axis=1)
        place = np.repeat(np.arange(len(sizes)), sizes)
        members = members[np.lexsort((held[np.arange(len(held)), axis[place]], place))]
        halves = np.column_stack((sizes // 2, sizes - sizes // 2)).ravel()
        owner, sizes = np.repeat(owner, 2)[halves > 0], halves[halves > 0]
    return members, sizes, np.bincount(owner, minlength=len(children))


def _shape(robot: bp.Robot, geometry) -> tuple[Matrix, float, SignedDistance]:  # type: ignore[no-untyped-def]
    if geometry.box is not None:
        size = np.asarray(geometry.box.size, dtype=float)
        return _box_points(size), 0.0, lambda points: box_distance(points, size)
    if geometry.sphere is not None:
        radius = float(geometry.sphere.radius)
        return np.zeros((1, 3)), radius, lambda points: sphere_distance(points, radius)
    if geometry.cylinder is not None:
        radius, length = float(geometry.cylinder.radius), float(geometry.cylinder.length)
        return _cylinder_points(radius, length), 0.0, lambda points: cylinder_distance(points, radius, length)
    path = robot.urdf.mesh_path(geometry.mesh.filename)
    assert path is not None
    mesh = load_mesh(path)
    scale = np.full(3, 1.0 if geometry.mesh.scale is None else geometry.mesh.scale, dtype=float)
    factors, T_shape_file = mesh_frame(path, scale)
    mesh.apply_scale(factors)
    mesh.apply_transform(T_shape_file.homogeneous)
    points, _ = trimesh.sample.sample_surface(mesh, _ON_MESH, seed=0)
    planes = _hull_planes(np.asarray(mesh.vertices))
    return np.vstack((mesh.vertices, points)), 0.0, lambda p: hull_distance(p, planes)


def _hull_planes(points: Matrix) -> Matrix:
    """(F, 4) the outward normals of the convex hull of points (N, 3), and their distances from the origin [m]."""
    try:
        return np.asarray(ConvexHull(points).equations)
    except QhullError:  # a flat one has two sides, and its edges
        middle = np.mean(points, axis=0)
        u, v, n = np.linalg.svd(points - middle)[2]
        edges = ConvexHull((points - middle) @ np.column_stack((u, v))).equations
        normals = np.vstack((edges[:, :2] @ [u, v], n, -n))
        return np.column_stack((normals, np.append(edges[:, 2], [0.0, 0.0]) - normals @ middle))


def _box_points(size: Matrix) -> Matrix:
    axes = [np.linspace(-s / 2.0, s / 2.0, max(2, int(np.ceil(s / SPACING)) + 1)) for s in size]
    faces = []
    for axis in range(3):
        others = [axes[k] for k in range(3) if k != axis]
        u, v = (grid.ravel() for grid in np.meshgrid(*others, indexing="ij"))
        for side in (-size[axis] / 2.0, size[axis] / 2.0):
            face = np.empty((len(u), 3))
            face[:, axis] = side
            face[:, [k for k in range(3) if k != axis]] = np.column_stack((u, v))
            faces.append(face)
    return np.unique(np.vstack(faces), axis=0)


def _cylinder_points(radius: float, length: float) -> Matrix:
    around = max(12, int(np.ceil(2.0 * np.pi * radius / SPACING)))
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = np.column_stack((np.cos(angle), np.sin(angle)))
    heights = np.linspace(-length / 2.0, length / 2.0, max(2, int(np.ceil(length / SPACING)) + 1))
    side = [np.column_stack((radius * ring, np.full(around, z))) for z in heights]
    radii = np.linspace(0.0, radius, max(2, int(np.ceil(radius / SPACING)) + 1))[:-1]
    caps = [np.column_stack((r * ring, np.full(around, z))) for r in radii for z in (-length / 2.0, length / 2.0)]
    return np.vstack(side + caps)
