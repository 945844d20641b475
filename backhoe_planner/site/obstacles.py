"""Obstacles as convex pieces, ready for distance queries.

Every solid is a set of convex pieces that contains it: meshes by `convex_cover`,
terrain by columns, point clouds by the voxels that hold a point. The signed distance
to an obstacle is the least over its pieces; inside one of several pieces the depth is
that of the piece.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray

from backhoe_planner.errors import InputError, SceneError, nearest_name
from backhoe_planner.machine import Robot, convex_cover, load_mesh, terrain_columns, voxel_boxes
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import scene_file

__all__ = ["Obstacle", "build_obstacle", "build_obstacles", "read_heights", "read_points", "swept", "zone_solid"]

Vector = NDArray[np.float64]

_TERRAIN_TOLERANCE = 0.02  # m of roughness that may be filled up
_TERRAIN_DEPTH = 50.0  # m below the lowest point
_MOST_PIECES = 20_000


@dataclass(frozen=True)
class Obstacle:
    """Something the machine must not touch.

    Attributes
    ----------
    name: as in the scene.
    pieces: convex, in world coordinates at the time of appearance.
    clearance: signed distance that must be kept [m].
    links: the only links that must keep it, or None for all.
    appears_at: time before which it is not there [s].
    velocity: (3,) from then on [m/s], world.
    spec: the scene's own record.
    zone: the scene's record of the zone of which this is the solid; None for an obstacle.
    """

    name: str
    pieces: tuple[shapes.Piece, ...]
    clearance: float
    links: tuple[str, ...] | None
    appears_at: float
    velocity: Vector
    spec: scene_file.ObstacleSpec
    zone: scene_file.ZoneSpec | None = None

    @property
    def slow(self) -> float:
        """Within this distance beyond the clearance the servo goes slower [m]."""
        return 0.0 if self.zone is None else self.zone.slow_distance - self.zone.stop

    @property
    def moves(self) -> bool:
        """Whether it has a velocity."""
        return bool(np.any(self.velocity))


def build_obstacles(scene: scene_file.Scene, robot: Robot) -> tuple[Obstacle, ...]:
    """Every obstacle of a scene, then every zone that is solid, checked against the machine's link names.

    Raises
    ------
    SceneError: a file is missing, empty or malformed, or `links` names no link.
    """
    built = []
    solids: list[tuple[str, scene_file.ObstacleSpec, scene_file.ZoneSpec | None]]
    solids = [(f"obstacles[{index}] ({spec.name})", spec, None) for index, spec in enumerate(scene.obstacles)]
    for index, zone in enumerate(scene.zones):
        if not isinstance(zone, scene_file.SwingSector):
            solids.append((f"zones[{index}] ({zone.name})", zone_solid(zone), zone))
    for key, spec, record in solids:
        for link in spec.links or ():
            if link not in robot.all_link_names:
                near = nearest_name(link, robot.all_link_names)
                raise SceneError(
                    "the machine has no such link",
                    file=scene.file,
                    key=f"{key}.links",
                    found=link,
                    allowed=", ".join(robot.link_names),
                    hint=f"did you mean {near!r}?" if near else None,
                )
        try:
            found = build_obstacle(spec, folder=scene.folder, clearance=scene.clearance)
            built.append(found if record is None else replace(found, zone=record))
        except SceneError:
            raise
        except InputError as error:
            raise SceneError(str(error), file=scene.file, key=f"{key}.file") from error
    return tuple(built)


def build_obstacle(spec: scene_file.ObstacleSpec, *, folder: Path, clearance: float) -> Obstacle:
    """One obstacle.

    Parameters
    ----------
    folder: where its file is looked for.
    clearance: for an obstacle that has none of its own [m].
    """
    pieces = _pieces(spec, folder)
    if len(pieces) > _MOST_PIECES:
        raise InputError(
            "is too fine to plan with",
            key=spec.name,
            found=f"{len(pieces)} convex pieces",
            allowed=f"up to {_MOST_PIECES}",
            hint="use a coarser resolution",
        )
    velocity = np.array(spec.velocity, dtype=float)
    velocity.setflags(write=False)
    return Obstacle(
        name=spec.name,
        pieces=tuple(pieces),
        clearance=clearance if spec.clearance is None else spec.clearance,
        links=spec.links,
        appears_at=spec.appears_at,
        velocity=velocity,
        spec=spec,
    )


def zone_solid(
    zone: scene_file.Ceiling | scene_file.Floor | scene_file.Wall | scene_file.Cab,
) -> scene_file.HalfSpace | scene_file.Box:
    """What a zone forbids, as an obstacle whose clearance is the stop distance."""
    if isinstance(zone, scene_file.Cab):
        return scene_file.Box(
            name=zone.name, shape="box", size=zone.size, position=zone.position, rpy=zone.rpy,
            clearance=zone.stop, links=zone.links,
        )  # fmt: skip
    if isinstance(zone, scene_file.Wall):
        point, normal = zone.plane
    else:
        point, normal = (0.0, 0.0, zone.height), (0.0, 0.0, 1.0 if isinstance(zone, scene_file.Floor) else -1.0)
    return scene_file.HalfSpace(
        name=zone.name, shape="halfspace", point=point, normal=normal, clearance=zone.stop, links=zone.links
    )


def swept(obstacle: Obstacle, start: float, end: float) -> Obstacle:
    """All the space that an obstacle takes up from time `start` to `end` [s], standing still.

    What bulges is taken a little larger: the hull of a ball's circumscribed octahedra.
    """
    ways = [obstacle.velocity * max(moment - obstacle.appears_at, 0.0) for moment in (start, end)]
    return replace(
        obstacle,
        pieces=tuple(_swept_piece(piece, *ways) for piece in obstacle.pieces),
        appears_at=0.0,
        velocity=np.zeros(3),
    )


def _swept_piece(piece: shapes.Piece, start: Vector, end: Vector) -> shapes.Piece:
    if not len(piece.hull):  # a half-space: the further of the two holds both
        normal = np.asarray(piece.shape.n)
        further = end if float((end - start) @ normal) > 0.0 else start
        return replace(piece, placement=pin.SE3(piece.placement.rotation, piece.placement.translation + further))
    around = (
        piece.radius * np.sqrt(3.0) * np.vstack((np.eye(3), -np.eye(3))) if piece.radius > 0.0 else np.zeros((1, 3))
    )
    points = (piece.hull[:, None, :] + around[None, :, :]).reshape(-1, 3)
    return shapes.convex(np.vstack((points + start, points + end)), pin.SE3.Identity())


def _pieces(spec: scene_file.ObstacleSpec, folder: Path) -> list[shapes.Piece]:
    if isinstance(spec, scene_file.Sphere):
        return [shapes.sphere(spec.radius, spec.placement)]
    if isinstance(spec, scene_file.Box):
        return [shapes.box(np.array(spec.size), spec.placement)]
    if isinstance(spec, scene_file.Cylinder):
        return [shapes.cylinder(spec.radius, spec.length, spec.placement)]
    if isinstance(spec, scene_file.Capsule):
        return [_capsule(spec)]
    if isinstance(spec, scene_file.HalfSpace):
        return [shapes.halfspace(np.array(spec.point), np.array(spec.normal))]
    if isinstance(spec, scene_file.Mesh):
        mesh = load_mesh(folder / spec.file)
        mesh.apply_scale(spec.scale)
        return [shapes.convex(points, spec.placement) for points in convex_cover(mesh)]
    if isinstance(spec, scene_file.HeightMap):
        columns = terrain_columns(
            read_heights(folder / spec.file), spec.size, tolerance=_TERRAIN_TOLERANCE, depth=_TERRAIN_DEPTH
        )
        return [shapes.convex(points, spec.placement) for points in columns]
    points = read_points(folder / spec.file)
    return [
        shapes.box(size, spec.placement * pin.SE3(np.eye(3), centre))
        for centre, size in voxel_boxes(points, spec.resolution)
    ]


def _capsule(spec: scene_file.Capsule) -> shapes.Piece:
    start, end = np.array(spec.start), np.array(spec.end)
    axis = end - start
    length = float(np.linalg.norm(axis))
    middle = 0.5 * (start + end)
    if length < 1e-9:
        return shapes.sphere(spec.radius, pin.SE3(np.eye(3), middle))
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis / length)
    return shapes.capsule(spec.radius, length, pin.SE3(turn.toRotationMatrix(), middle))


def read_heights(path: Path) -> Vector:
    """(rows, columns) heights [m] from a CSV without header.

    Raises
    ------
    InputError: missing, empty, ragged, fewer than 2 x 2, or not finite.
    """
    text = _read_text(path)
    rows = [line.replace(";", ",").split(",") for line in text.splitlines() if line.strip()]
    try:
        values = [[float(cell) for cell in (row if row[-1].strip() else row[:-1])] for row in rows]
    except ValueError as error:
        raise InputError(f"is not a table of numbers: {error}", file=path) from None
    widths = {len(row) for row in values}
    if len(widths) != 1:
        raise InputError("the rows have different lengths", file=path, found=sorted(widths))
    heights = np.array(values)
    if min(heights.shape) < 2:
        raise InputError("a height map needs at least 2 x 2 heights", file=path, found=str(heights.shape))
    if not np.all(np.isfinite(heights)):
        raise InputError("a height is not finite", file=path)
    return heights


def read_points(path: Path) -> Vector:
    """(n, 3) points [m] from a PLY, or from text with x, y, z in the first columns.

    Raises
    ------
    InputError: missing, empty, or without finite points.
    """
    if not path.is_file():
        raise InputError("no such file", file=path)
    if path.suffix.lower() in (".ply", ".obj", ".stl"):
        try:
            loaded = trimesh.load(path, process=False)
        except Exception as error:  # trimesh raises whatever its format readers run into
            raise InputError(f"is not a file of points that can be read: {error}", file=path) from error
        points = np.asarray(getattr(loaded, "vertices", np.zeros((0, 3))), dtype=float)
    else:
        points = _points_from_text(path)
    if len(points) == 0:
        raise InputError("holds no points", file=path)
    if not np.all(np.isfinite(points)):
        raise InputError("holds a point that is not finite", file=path)
    return points


def _points_from_text(path: Path) -> Vector:
    rows = []
    for number, line in enumerate(_read_text(path).splitlines(), start=1):
        cells = line.replace(",", " ").split()
        if not cells or cells[0].startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in cells[:3]])
        except ValueError:
            if number == 1:
                continue  # a header
            raise InputError("is not a number", file=path, key=f"line {number}", found=line.strip()) from None
        if len(rows[-1]) < 3:
            raise InputError("has fewer than three numbers", file=path, key=f"line {number}", found=line.strip())
    return np.array(rows, dtype=float).reshape(-1, 3)


def _read_text(path: Path) -> str:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from error
    if not text.strip():
        raise InputError("the file is empty", file=path)
    return text
