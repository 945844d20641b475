"""A second opinion on a motion: distances without coal, ten times finer in time.

Every link's collision shape is covered with points read from the URDF itself; each
obstacle is a signed distance function written out here. The least value over all points
and moments can only lie above the true distance, so a motion is refuted as soon as it
falls below what the certificate claims to have proven.

All points at all moments are looked at, though few one by one: the points of a link lie
in a tree of balls, the moments in windows. A signed distance changes by no more than a
point moves, so a ball and a window whose middle is far enough away are done with.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.machine import load_mesh, self_pairs
from backhoe_planner.site import scene_file

__all__ = ["Least", "least_distances", "refutations"]

Points = NDArray[np.float64]
Indices = NDArray[np.intp]
SignedDistance = Callable[[Points], NDArray[np.float64]]

SPACING = 0.04  # m between points on a surface at most
SPANS = np.array([64, 8, 1])  # moments in a window, from coarse to fine
BRANCHES = 8  # of a ball; also of a window
CHUNK = 20_000  # balls in windows at once
CLAIM_SLACK = 1e-6  # m below what is proven that a distance may be found, for rounding
CLEARANCE_SLACK = 2e-4  # m below the clearance: what the certificate takes for keeping it, doubled


@dataclass(frozen=True)
class Least:
    """The least distance found between two bodies, and when [m, s]."""

    link: str
    obstacle: str
    distance: float
    clearance: float
    time: float


@dataclass(frozen=True, eq=False)
class _Cover:
    """Points on all collision shapes of a link, as a tree of balls in the frame of its joint.

    A ball without children is a point; its radius is how far the shape reaches beyond it.
    """

    link: str
    joint: int
    centre: Points  # (M, 3)
    radius: NDArray[np.float64]  # (M,)
    first: Indices  # (M,) the first child, -1 where there is none
    children: Indices  # (M,) how many


@dataclass(frozen=True, eq=False)
class _Solid:
    """One collision shape of a link, as what others must not touch."""

    link: str
    joint: int
    T_joint_shape: pin.SE3
    signed_distance: SignedDistance  # in the frame of the shape


class _Track:
    """How a cover moves past something: rotation (T, 3, 3) and translation (T, 3) at every moment."""

    def __init__(self, cover: _Cover, rotation: Points, translation: Points) -> None:
        self.cover, self.rotation, self.translation = cover, rotation, translation
        count = len(translation)
        self.windows = -(-count // SPANS)
        self._first = np.concatenate(([0], np.cumsum(self.windows)[:-1]))
        middle = rotation @ cover.centre[0] + translation
        spreads = []
        for span, windows in zip(SPANS.tolist(), self.windows.tolist(), strict=True):
            mid = np.repeat(np.minimum(np.arange(windows) * span + span // 2, count - 1), span)[:count]
            # the norm of a difference of rotations is its Frobenius norm over the root of 2
            turned = np.sqrt(0.5 * np.sum(np.square(rotation - rotation[mid]), axis=(1, 2)))
            moved = np.linalg.norm(middle - middle[mid], axis=1) + cover.radius[0] * turned
            spreads.append(np.maximum.reduceat(moved, np.arange(windows) * span))
        self._spread = np.concatenate(spreads)

    def spread(self, level: Indices, window: Indices) -> NDArray[np.float64]:
        """(K,) how far any point of the cover is within a window from where it is at its middle [m]."""
        return np.asarray(self._spread[self._first[level] + window])


def refutations(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[str]:
    """What contradicts the plan's certificate, in words; empty where nothing does.

    Parameters
    ----------
    refine: moments looked at for every sample of the plan.
    itself: whether the machine is also held against itself.
    """
    proven = {entry.obstacle: entry.distance for entry in plan.certificate.clearances if entry.kind == "obstacle"}

    def floor(obstacle: str, clearance: float) -> float:
        allowed = clearance - CLEARANCE_SLACK if plan.verified else -np.inf
        claimed = proven.get(obstacle, -np.inf) - CLAIM_SLACK
        return allowed if obstacle.startswith("self: ") else max(allowed, claimed)

    found = []
    for least in _search(plan, refine=refine, itself=itself, floor=floor):
        told = f"{least.link} is {least.distance:.5f} m from {least.obstacle} at {least.time:.3f} s"
        claim = proven.get(least.obstacle, -np.inf)
        if least.distance < claim - CLAIM_SLACK and not least.obstacle.startswith("self: "):
            found.append(f"{told}, proven were {claim:.5f} m")
        if plan.verified and least.distance < least.clearance - CLEARANCE_SLACK:
            found.append(f"{told}, allowed are {least.clearance:.5f} m")
    return found


def least_distances(plan: bp.Plan, *, refine: int = 10, itself: bool = True) -> list[Least]:
    """The least distance of every link to every obstacle, and of the machine to itself."""
    return _search(plan, refine=refine, itself=itself, floor=lambda obstacle, clearance: np.inf)


def _search(plan: bp.Plan, *, refine: int, itself: bool, floor: Callable[[str, float], float]) -> list[Least]:
    """The least distances below `floor(obstacle, clearance)`; those above it are left out."""
    robot, scene, motion = plan.robot, plan.scene, plan.trajectory
    time = _finer(motion.time, refine)
    placements = _placements(robot, motion.at(time))
    covers, solids = _bodies(robot)
    tracks = [_Track(cover, *placements[cover.joint]) for cover in covers if cover.joint > 0]
    found = []
    for spec in scene.obstacles:
        distance = _obstacle(spec, scene)
        clearance = scene.clearance if spec.clearance is None else spec.clearance
        below = floor(spec.name, clearance)
        if below == -np.inf:
            continue
        shift = np.maximum(time - spec.appears_at, 0.0)[:, None] * np.array(spec.velocity)
        for track in tracks:
            link = track.cover.link
            if spec.links is not None and link not in spec.links:
                continue
            past = _Track(track.cover, track.rotation, track.translation - shift) if np.any(shift) else track
            least, moment = _least(past, distance, time >= spec.appears_at, below)
            if np.isfinite(least):
                found.append(Least(link, spec.name, least, clearance, float(time[moment])))
    return found + (_against_itself(robot, tracks, solids, placements, time, floor) if itself else [])


def _finer(time: NDArray[np.float64], refine: int) -> NDArray[np.float64]:
    steps = [np.linspace(a, b, refine, endpoint=False) for a, b in pairwise(time.tolist())]
    return np.concatenate([*steps, time[-1:]])


def _placements(robot: bp.Robot, q: Points) -> list[tuple[Points, Points]]:
    """Rotations (T, 3, 3) and translations (T, 3) of every joint's frame."""
    model = robot.model
    found = [(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)))]
    for joint in range(1, model.njoints):
        R_parent, p_parent = found[model.parents[joint]]
        T = model.jointPlacements[joint]
        slide, axis = np.split(np.asarray(model.joints[joint].createData().S, dtype=float).reshape(6), 2)
        angle = q[:, model.joints[joint].idx_q]
        cross = pin.skew(axis)
        # Rodrigues; of a prismatic joint the axis is 0
        turn = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1.0 - np.cos(angle))[:, None, None] * (cross @ cross)
        R_before = R_parent @ T.rotation
        moved = angle[:, None] * slide
        found.append((R_before @ turn, R_parent @ T.translation + p_parent + np.einsum("tij,tj->ti", R_before, moved)))
    return found


def _least(track: _Track, distance: SignedDistance, present: NDArray[np.bool_], below: float) -> tuple[float, int]:
    """The least distance over all points and moments, and its moment; infinite where it is not under `below`.

    A branch and bound over balls and windows at once: whatever is left when a distance
    is known may lie under it.
    """
    cover, count = track.cover, len(track.translation)
    window = np.arange(track.windows[0])
    window = window[present[np.minimum((window + 1) * SPANS[0], count) - 1]]
    level, node = np.zeros_like(window), np.zeros_like(window)
    bound = np.full(len(window), -np.inf)
    least, moment, upper = np.inf, 0, below
    while len(window):
        kept = bound <= upper
        level, window, node, bound = level[kept], window[kept], node[kept], bound[kept]
        rest = None
        if len(window) > CHUNK:
            order = np.argpartition(bound, CHUNK)
            now, later = order[:CHUNK], order[CHUNK:]
            rest = (level[later], window[later], node[later], bound[later])
            level, window, node = level[now], window[now], node[now]
        row = np.minimum(window * SPANS[level] + SPANS[level] // 2, count - 1)
        middles = np.einsum("kij,kj->ki", track.rotation[row], cover.centre[node]) + track.translation[row]
        value = distance(middles)
        radius, point, here = cover.radius[node], cover.first[node] < 0, present[row]
        spread = track.spread(level, window)
        done = point & ((level == len(SPANS) - 1) | ((spread == 0.0) & here))
        if np.any(here):
            upper = min(upper, float(np.min(np.where(point, value - radius, value + radius)[here])))
        hits = np.flatnonzero(done & here)
        if len(hits):
            best = int(hits[np.argmin(value[hits] - radius[hits])])
            if value[best] - radius[best] < min(least, below):
                least, moment = float(value[best] - radius[best]), int(row[best])
        lower = value - radius - spread
        open_ = ~done & (lower <= upper)
        in_time = open_ & (level < len(SPANS) - 1) & (point | (spread > radius))
        in_space = open_ & ~in_time
        parts = [_in_time(level[in_time], window[in_time], node[in_time], lower[in_time], present)]
        parts.append(_in_space(level[in_space], window[in_space], node[in_space], lower[in_space], cover))
        if rest is not None:
            parts.append(rest)
        level, window, node, bound = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return least, moment


_Items = tuple[Indices, Indices, Indices, NDArray[np.float64]]


def _in_time(
    level: Indices, window: Indices, node: Indices, lower: NDArray[np.float64], present: NDArray[np.bool_]
) -> _Items:
    """Every window in its parts."""
    finer = np.repeat(level + 1, BRANCHES)
    part = (window[:, None] * BRANCHES + np.arange(BRANCHES)).ravel()
    kept = part * SPANS[finer] < len(present)
    last = np.minimum((part + 1) * SPANS[finer], len(present)) - 1
    kept &= present[last]  # what has appeared stays
    return finer[kept], part[kept], np.repeat(node, BRANCHES)[kept], np.repeat(lower, BRANCHES)[kept]


def _in_space(level: Indices, window: Indices, node: Indices, lower: NDArray[np.float64], cover: _Cover) -> _Items:
    """Every ball in its parts."""
    child = (cover.first[node][:, None] + np.arange(BRANCHES)).ravel()
    kept = (np.arange(BRANCHES) < cover.children[node][:, None]).ravel()
    repeated = (np.repeat(values, BRANCHES)[kept] for values in (level, window))
    finer_level, finer_window = repeated
    return finer_level, finer_window, child[kept], np.repeat(lower, BRANCHES)[kept]


def _against_itself(
    robot: bp.Robot,
    tracks: list[_Track],
    solids: list[_Solid],
    placements: list[tuple[Points, Points]],
    time: NDArray[np.float64],
    floor: Callable[[str, float], float],
) -> list[Least]:
    links = {(robot.pieces[a].link, robot.pieces[b].link) for a, b in self_pairs(robot)}
    links |= {(b, a) for a, b in links}
    present = np.ones(len(time), dtype=bool)
    found = []
    for track in tracks:
        for inner in solids:
            cover, name = track.cover, f"self: {inner.link}"
            below = floor(name, 0.0)
            if cover.joint <= inner.joint or (cover.link, inner.link) not in links or below == -np.inf:
                continue
            R, p = inner.T_joint_shape.rotation, inner.T_joint_shape.translation
            if inner.joint == 0:
                least, moment = _least(track, _at(inner.signed_distance, R, p), present, below)
            else:
                R_inner, p_inner = placements[inner.joint]
                R_shape, p_shape = R_inner @ R, R_inner @ p + p_inner
                relative = _Track(
                    cover,
                    np.swapaxes(R_shape, 1, 2) @ track.rotation,
                    np.einsum("tji,tj->ti", R_shape, track.translation - p_shape),
                )
                least, moment = _least(relative, inner.signed_distance, present, below)
            if np.isfinite(least):
                found.append(Least(cover.link, name, least, 0.0, float(time[moment])))
    return found


def _at(distance: SignedDistance, rotation: Points, place: Points) -> SignedDistance:
    """The signed distance to the same shape, placed."""
    return lambda points: distance((points - place) @ rotation)


# --- the machine's shapes, from the URDF itself --------------------------------------


@lru_cache(maxsize=8)
def _bodies(robot: bp.Robot) -> tuple[list[_Cover], list[_Solid]]:
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
            solids.append(_Solid(link.name, joint, T, distance))
        covers.append(_cover(link.name, joint, np.vstack(sets), np.concatenate(fats)))
    return covers, solids


def _cover(link: str, joint: int, points: Points, fat: NDArray[np.float64]) -> _Cover:
    """The tree of balls over points (N, 3) that reach `fat` (N,) beyond themselves [m]."""
    centre, radius, first, children = [], [], [], []
    queue, known = deque([np.arange(len(points))]), 1
    while queue:
        members = queue.popleft()
        held = points[members]
        middle = 0.5 * (held.min(axis=0) + held.max(axis=0))
        centre.append(middle)
        radius.append(float(np.max(np.linalg.norm(held - middle, axis=1) + fat[members])))
        parts = _split(points, members)
        first.append(known if parts else -1)
        children.append(len(parts))
        queue.extend(parts)
        known += len(parts)
    return _Cover(link, joint, np.array(centre), np.array(radius), np.array(first), np.array(children))


def _split(points: Points, members: Indices) -> list[Indices]:
    """Up to `BRANCHES` parts, each cut across its longest side; none of a single point."""
    parts = [members]
    while len(parts) < BRANCHES:
        halved = []
        for part in parts:
            if len(part) == 1:
                halved.append(part)
                continue
            axis = int(np.argmax(np.ptp(points[part], axis=0)))
            order = part[np.argsort(points[part, axis], kind="stable")]
            halved += [order[: len(order) // 2], order[len(order) // 2 :]]
        if len(halved) == len(parts):
            break
        parts = halved
    return parts if len(parts) > 1 else []


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


def _obstacle(spec: scene_file.ObstacleSpec, scene: bp.Scene) -> SignedDistance:
    if isinstance(spec, scene_file.HalfSpace):
        point, normal = np.array(spec.point), np.array(spec.normal)
        return lambda points: (points - point) @ normal
    if isinstance(spec, scene_file.Capsule):
        start, end = np.array(spec.start), np.array(spec.end)
        return lambda points: capsule_distance(points, start, end, spec.radius)
    rotation, place = spec.placement.rotation, spec.placement.translation

    def local(points: Points) -> Points:
        return (points - place) @ rotation

    if isinstance(spec, scene_file.Sphere):
        return lambda points: np.linalg.norm(points - place, axis=1) - spec.radius
    if isinstance(spec, scene_file.Box):
        size = np.array(spec.size)
        return lambda points: box_distance(local(points), size)
    if isinstance(spec, scene_file.Cylinder):
        return lambda points: cylinder_distance(local(points), spec.radius, spec.length)
    if isinstance(spec, scene_file.Mesh):
        mesh = load_mesh(scene.folder / spec.file)
        mesh.apply_scale(spec.scale)
        return lambda points: -trimesh.proximity.signed_distance(mesh, local(points))
    raise NotImplementedError(f"no second opinion on a {spec.shape}")
