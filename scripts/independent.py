"""A second opinion on a motion: distances without coal, ten times finer in time.

Every link's collision shape is covered with points read from the URDF itself; each
obstacle is a signed distance function written out here. The least value over all points
and moments can only lie above the true distance, so a motion is refuted as soon as it
falls below what the certificate claims to have proven.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.machine.collision_model import self_pairs
from backhoe_planner.machine.convex import load_mesh
from backhoe_planner.site import scene as schema

__all__ = ["Least", "least_distances", "refutations"]

Points = NDArray[np.float64]
SignedDistance = Callable[[Points], NDArray[np.float64]]

SPACING = 0.04  # m between points on a surface at most
STRIDE = 40  # moments between two that are looked at first
CHUNK = 64  # moments at once
FAR = 0.5  # m beyond which a link need not be looked at closely


@dataclass(frozen=True)
class Least:
    """The least distance found between two bodies, and when [m, s]."""

    link: str
    obstacle: str
    distance: float
    clearance: float
    time: float


@dataclass(frozen=True)
class _Body:
    """One collision shape of a link: points on it, and its own signed distance function."""

    link: str
    joint: int
    T_joint_shape: pin.SE3
    points: Points  # in the frame of the joint
    fat: float  # the shape reaches this far beyond the points
    signed_distance: SignedDistance  # in the frame of the shape


def refutations(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[str]:
    """What contradicts the plan's certificate, in words; empty where nothing does.

    Parameters
    ----------
    refine: moments looked at for every sample of the plan.
    itself: whether the machine is also held against itself, which takes longest.
    """
    proven = {entry.obstacle: entry for entry in plan.certificate.clearances}
    found = []
    for least in least_distances(plan, refine=refine, itself=itself):
        claim = proven.get(least.obstacle)
        if claim is not None and least.distance < claim.value - 1e-6 and not least.obstacle.startswith("self: "):
            found.append(
                f"{least.link} is {least.distance:.5f} m from {least.obstacle} at {least.time:.3f} s, "
                f"proven were {claim.value:.5f} m"
            )
        if plan.verified and least.distance < least.clearance - 2e-4:
            found.append(
                f"{least.link} is {least.distance:.5f} m from {least.obstacle} at {least.time:.3f} s, "
                f"allowed are {least.clearance:.5f} m"
            )
    return found


def least_distances(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[Least]:
    """The least distance of every link to every obstacle, and of the machine to itself."""
    robot, scene, motion = plan.robot, plan.scene, plan.trajectory
    bodies = _bodies(robot)
    time = _finer(motion.time, refine)
    placements = _placements(robot, motion.at(time))
    found = []
    for spec in scene.obstacles:
        distance = _obstacle(spec, scene)
        clearance = scene.clearance if spec.clearance is None else spec.clearance
        for body in bodies:
            if body.joint == 0 or (spec.links is not None and body.link not in spec.links):
                continue
            shift = np.maximum(time - spec.appears_at, 0.0)[:, None] * np.array(spec.velocity)
            least, moment = _least(body, placements[body.joint], shift, distance, time >= spec.appears_at)
            if np.isfinite(least):
                found.append(Least(body.link, spec.name, least, clearance, float(time[moment])))
    return found + (_against_itself(robot, bodies, placements, time) if itself else [])


def _finer(time: NDArray[np.float64], refine: int) -> NDArray[np.float64]:
    steps = [np.linspace(a, b, refine, endpoint=False) for a, b in pairwise(time.tolist())]
    return np.concatenate([*steps, time[-1:]])


def _placements(robot: bp.Robot, q: Points) -> list[tuple[Points, Points]]:
    """Rotations (T, 3, 3) and translations (T, 3) of every joint's frame."""
    data = robot.model.createData()
    rotations = np.empty((robot.model.njoints, len(q), 3, 3))
    translations = np.empty((robot.model.njoints, len(q), 3))
    for row, joints in enumerate(q):
        pin.forwardKinematics(robot.model, data, joints)
        for joint in range(robot.model.njoints):
            rotations[joint, row] = data.oMi[joint].rotation
            translations[joint, row] = data.oMi[joint].translation
    return list(zip(rotations, translations, strict=True))


def _least(
    body: _Body,
    placement: tuple[Points, Points],
    shift: Points,
    distance: SignedDistance,
    present: NDArray[np.bool_],
) -> tuple[float, int]:
    """Least distance of one body over time, and the row at which it was found.

    Every `STRIDE`-th moment is looked at first; then all moments between two of them,
    unless the body moved too little in between to come below what was found.
    """
    if not np.any(present):
        return np.inf, 0
    rotation, translation = placement
    count = len(translation)

    def at(rows: NDArray[np.intp]) -> NDArray[np.float64]:
        found = np.full(len(rows), np.inf)
        for first in range(0, len(rows), CHUNK):
            chunk = rows[first : first + CHUNK]
            points = body.points @ np.swapaxes(rotation[chunk], 1, 2) + (translation[chunk] - shift[chunk])[:, None]
            values = distance(points.reshape(-1, 3)).reshape(len(chunk), -1)
            found[first : first + CHUNK] = values.min(axis=1) - body.fat
        found[~present[rows]] = np.inf
        return found

    centre = body.points.mean(axis=0)
    radius = float(np.max(np.linalg.norm(body.points - centre, axis=1))) + body.fat
    marks = np.unique(np.append(np.arange(0, count, STRIDE), count - 1))
    middles = rotation[marks] @ centre + translation[marks] - shift[marks]
    rough = distance(middles) - radius
    if not np.any(present[marks]):
        return np.inf, 0
    coarse = np.full(len(marks), np.inf)
    near = np.flatnonzero(rough <= max(FAR, float(np.min(rough[present[marks]])) + 2.0 * radius))
    coarse[near] = at(marks[near])
    coarse[np.isinf(coarse) & present[marks]] = rough[np.isinf(coarse) & present[marks]]
    best = int(np.argmin(coarse))
    least, moment = float(coarse[best]), int(marks[best])
    corners = body.points[:: max(1, len(body.points) // 40)]
    tracks = corners @ np.swapaxes(rotation[marks], 1, 2) + (translation[marks] - shift[marks])[:, None]
    moved = np.max(np.linalg.norm(np.diff(tracks, axis=0), axis=2), axis=1) * 1.5 + 0.01
    left, right = coarse[:-1], coarse[1:]
    open_windows = np.flatnonzero(np.minimum(left, right) - moved < least)
    rows = [np.arange(marks[window] + 1, marks[window + 1]) for window in open_windows]
    # an obstacle may appear between two marks
    rows += [np.flatnonzero(present)[:STRIDE]]
    fine = np.unique(np.concatenate(rows)).astype(np.intp)
    if len(fine):
        values = at(fine)
        if float(values.min()) < least:
            least, moment = float(values.min()), int(fine[int(np.argmin(values))])
    return least, moment


def _against_itself(
    robot: bp.Robot, bodies: list[_Body], placements: list[tuple[Points, Points]], time: NDArray[np.float64]
) -> list[Least]:
    links = {(robot.pieces[a].link, robot.pieces[b].link) for a, b in self_pairs(robot)}
    links |= {(b, a) for a, b in links}
    found = []
    for outer in bodies:
        for inner in bodies:
            if outer.joint <= inner.joint or (outer.link, inner.link) not in links:
                continue
            R_outer, p_outer = placements[outer.joint]
            R_inner, p_inner = placements[inner.joint]
            R_shape = R_inner @ inner.T_joint_shape.rotation
            p_shape = R_inner @ inner.T_joint_shape.translation + p_inner
            rotation = np.swapaxes(R_shape, 1, 2) @ R_outer
            translation = np.einsum("tji,tj->ti", R_shape, p_outer - p_shape)
            least, moment = _least(
                outer, (rotation, translation), np.zeros((len(time), 3)), inner.signed_distance,
                np.ones(len(time), dtype=bool),
            )  # fmt: skip
            if np.isfinite(least):
                found.append(Least(outer.link, f"self: {inner.link}", least, 0.0, float(time[moment])))
    return found


# --- the machine's shapes, from the URDF itself --------------------------------------


def _bodies(robot: bp.Robot) -> list[_Body]:
    found = []
    for link in robot.urdf.robot.links:
        frame = robot.model.frames[robot.model.getFrameId(link.name, pin.FrameType.BODY)]
        for collision in link.collisions:
            origin = np.eye(4) if collision.origin is None else collision.origin
            T = frame.placement * pin.SE3(origin[:3, :3], origin[:3, 3])
            points, fat, distance = _shape(robot, collision.geometry)
            found.append(
                _Body(link.name, int(frame.parentJoint), T, points @ T.rotation.T + T.translation, fat, distance)
            )
    return found


def _shape(robot: bp.Robot, geometry) -> tuple[Points, float, SignedDistance]:  # type: ignore[no-untyped-def]
    if geometry.box is not None:
        size = np.asarray(geometry.box.size, dtype=float)
        return _box_points(size), 0.0, lambda points: box_distance(points, size)
    if geometry.sphere is not None:
        radius = float(geometry.sphere.radius)
        return np.zeros((1, 3)), radius, lambda points: np.linalg.norm(points, axis=1) - radius
    if geometry.cylinder is not None:
        radius, length = float(geometry.cylinder.radius), float(geometry.cylinder.length)
        return _cylinder_points(radius, length), 0.0, lambda points: cylinder_distance(points, radius, length)
    path = robot.urdf.mesh_path(geometry.mesh.filename)
    assert path is not None
    mesh = load_mesh(path)
    if geometry.mesh.scale is not None:
        mesh.apply_scale(geometry.mesh.scale)
    points, _ = trimesh.sample.sample_surface(mesh, 1500, seed=0)
    hull = mesh.convex_hull
    return np.vstack((mesh.vertices, points)), 0.0, lambda p: _hull_distance(p, hull)


def _box_points(size: Points) -> Points:
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


def _cylinder_points(radius: float, length: float) -> Points:
    around = max(12, int(np.ceil(2.0 * np.pi * radius / SPACING)))
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = np.column_stack((np.cos(angle), np.sin(angle)))
    heights = np.linspace(-length / 2.0, length / 2.0, max(2, int(np.ceil(length / SPACING)) + 1))
    side = [np.column_stack((radius * ring, np.full(around, z))) for z in heights]
    radii = np.linspace(0.0, radius, max(2, int(np.ceil(radius / SPACING)) + 1))[:-1]
    caps = [np.column_stack((r * ring, np.full(around, z))) for r in radii for z in (-length / 2.0, length / 2.0)]
    return np.vstack(side + caps)


# --- signed distance functions --------------------------------------------------------


def box_distance(points: Points, size: Points) -> NDArray[np.float64]:
    """(K,) exact signed distance of points (K, 3) to a box of full edges `size`, centred."""
    off = np.abs(points) - size / 2.0
    return np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(np.max(off, axis=1), 0.0)


def cylinder_distance(points: Points, radius: float, length: float) -> NDArray[np.float64]:
    """(K,) exact signed distance to a cylinder along z, centred."""
    off = np.column_stack((np.hypot(points[:, 0], points[:, 1]) - radius, np.abs(points[:, 2]) - length / 2.0))
    return np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(np.max(off, axis=1), 0.0)


def capsule_distance(points: Points, start: Points, end: Points, radius: float) -> NDArray[np.float64]:
    """(K,) exact signed distance to a capsule."""
    axis = end - start
    square = float(axis @ axis)
    part = np.clip((points - start) @ axis / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    return np.linalg.norm(points - start - part[:, None] * axis, axis=1) - radius


def _hull_distance(points: Points, hull: trimesh.Trimesh) -> NDArray[np.float64]:
    """(K,) largest distance over the planes of a convex hull: never above the true distance."""
    offsets = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0])
    return np.max(points @ hull.face_normals.T - offsets, axis=1)


def _obstacle(spec: schema.ObstacleSpec, scene: bp.Scene) -> SignedDistance:
    if isinstance(spec, schema.HalfSpace):
        point, normal = np.array(spec.point), np.array(spec.normal)
        return lambda points: (points - point) @ normal
    if isinstance(spec, schema.Capsule):
        start, end = np.array(spec.start), np.array(spec.end)
        return lambda points: capsule_distance(points, start, end, spec.radius)
    rotation, place = spec.placement.rotation, spec.placement.translation

    def local(points: Points) -> Points:
        return (points - place) @ rotation

    if isinstance(spec, schema.Sphere):
        return lambda points: np.linalg.norm(points - place, axis=1) - spec.radius
    if isinstance(spec, schema.Box):
        size = np.array(spec.size)
        return lambda points: box_distance(local(points), size)
    if isinstance(spec, schema.Cylinder):
        return lambda points: cylinder_distance(local(points), spec.radius, spec.length)
    if isinstance(spec, schema.Mesh):
        mesh = load_mesh(scene.folder / spec.file)
        mesh.apply_scale(spec.scale)
        return lambda points: -trimesh.proximity.signed_distance(mesh, local(points))
    raise NotImplementedError(f"no second opinion on a {spec.shape}")
