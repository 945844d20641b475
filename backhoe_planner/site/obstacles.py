"""Obstacles as convex pieces, ready for distance queries.

Every solid is a set of convex pieces that contains it: meshes by `convex_cover`,
terrain by columns, point clouds by the voxels that contain a point. The signed distance
to an obstacle is the least over its pieces; inside one of several pieces the depth is
that of the piece. If there would be more than a few pieces, the solid is a `Cluster`,
which is measured as one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector, as_number, as_vector
from backhoe_planner.errors import InputError, SceneError, check_kind
from backhoe_planner.machine import Cluster, Robot, reach_ball
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site.known_clusters import body_of
from backhoe_planner.site.scene_file import Scene
from backhoe_planner.site.schema import obstacle_shapes
from backhoe_planner.site.schema.zone_kinds import SwingSector, ZoneSpec

_ALONG = 1e-12  # of a cosine: a normal that leans less is along an axis
_SWEPT_BOXES = 4_000  # cells of the grid that replaces a cluster that moves; chosen


@dataclass(frozen=True)
class Obstacle:
    """Something the machine must not touch.

    Attributes
    ----------
    name: as in the scene.
    pieces: convex, in world coordinates at the time of appearance; none if there is a cluster.
    clearance: signed distance that must be kept [m].
    links: the only links that must keep it, or None for all.
    appears_at: time at which it appears [s].
    velocity: (3,) from then on [m/s], world.
    spec: the scene's own record.
    zone: the scene's record of the zone whose solid this is; None for an obstacle.
    cluster: the solid if it has thousands of cells, in world coordinates at the time of appearance.
    folder: the folder to which the name of its file is relative.
    """

    name: str
    pieces: tuple[shapes.Piece, ...]
    clearance: float
    links: tuple[str, ...] | None
    appears_at: float
    velocity: Vector
    spec: obstacle_shapes.ObstacleSpec
    zone: ZoneSpec | None = None
    cluster: Cluster | None = None
    folder: Path = Path()

    def __post_init__(self) -> None:
        check_kind(self.name, str, key="name")
        pieces = tuple(check_kind(self.pieces, Iterable, key=f"{self.name}.pieces"))  # type: ignore[type-abstract]
        object.__setattr__(
            self, "pieces", tuple(check_kind(one, shapes.Piece, key=f"{self.name}.pieces") for one in pieces)
        )
        object.__setattr__(self, "clearance", as_number(self.clearance, key=f"{self.name}.clearance"))
        object.__setattr__(self, "appears_at", as_number(self.appears_at, key=f"{self.name}.appears_at"))
        object.__setattr__(self, "velocity", as_vector(self.velocity, 3, key=f"{self.name}.velocity"))

    def __repr__(self) -> str:
        """One line: name, shape and clearance."""
        return f"<Obstacle {self.name!r}: {self.spec.shape}, clearance {self.clearance:g} m>"

    @property
    def slow(self) -> float:
        """The distance beyond the clearance within which the servo goes slower [m]."""
        return 0.0 if self.zone is None else self.zone.slow_distance - self.zone.stop

    @cached_property
    def bounds(self) -> Matrix:
        """(2, 3) lowest and highest corner of a box around it where it appears [m]; infinite where it is unbounded."""
        if self.cluster is not None:
            return self.cluster.bounds
        ends = np.array([_bounds_of(piece) for piece in self.pieces])
        found = np.array([ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)])
        found.setflags(write=False)
        return found

    def box_away_unchecked(self, point: Vector) -> float:
        """How far the box around it is from a point (3,) [m]; 0 in the box."""
        low, high = self.bounds
        return float(np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0)))

    @property
    def moves(self) -> bool:
        """Whether it has a velocity."""
        return bool(np.any(self.velocity))

    @property
    def is_dynamic(self) -> bool:
        """Whether it moves, or appears later."""
        return self.moves or self.appears_at > 0.0


def as_obstacles(given: Iterable[Obstacle]) -> tuple[Obstacle, ...]:
    """Check obstacles that are passed to a public function or class.

    Raises
    ------
    InputError: it is a scene, or not several obstacles.
    """
    if isinstance(given, Scene):
        hint = "build_obstacles(scene, robot) makes the obstacles of a scene"
        raise InputError("is a scene", key="obstacles", found="Scene", allowed="several Obstacle", hint=hint)
    several = enumerate(check_kind(given, Iterable, key="obstacles"))  # type: ignore[type-abstract]
    return tuple(check_kind(one, Obstacle, key=f"obstacles[{index}]") for index, one in several)


def build_obstacles(scene: Scene, robot: Robot) -> tuple[Obstacle, ...]:
    """All obstacles of a scene, then all solid zones; `links` are checked against the machine.

    Raises
    ------
    SceneError: a file is missing, empty or malformed, or an entry of `links` is no link.
    """
    check_kind(scene, Scene, key="scene")
    check_kind(robot, Robot, key="robot")
    built = []
    solids: list[tuple[str, obstacle_shapes.ObstacleSpec, ZoneSpec | None]]
    solids = [(f"obstacles[{index}] ({spec.name})", spec, None) for index, spec in enumerate(scene.obstacles)]
    for index, zone in enumerate(scene.zones):
        if not isinstance(zone, SwingSector):
            solids.append((f"zones[{index}] ({zone.name})", zone.solid(scene.base.position), zone))
    for key, spec, of_zone in solids:
        check_links(robot, spec.links, key=f"{key}.links", file=scene.file)
        try:
            built.append(build_obstacle(spec, folder=scene.folder, clearance=scene.clearance, zone=of_zone))
        except InputError as error:
            raise SceneError(str(error), file=scene.file, key=f"{key}.file") from error
        cluster = built[-1].cluster
        if cluster is not None:
            cluster.prepare(*reach_ball(robot))
    return tuple(built)


def check_links(robot: Robot, links: Sequence[str] | None, *, key: str, file: str | Path | None = None) -> None:
    """Check the links for which an obstacle counts: all are the machine's, and one of them can touch it.

    Parameters
    ----------
    links: their names; None for all that have a shape.
    key, file: where the names are given, for the message.

    Raises
    ------
    SceneError: there is no such link, or none of the links both moves and has a shape.
    """
    for link in links or ():
        if link not in robot.all_link_names:
            raise SceneError.unknown_name(
                "the machine has no such link", link, names=robot.link_names, file=file, key=key
            )
    if links is not None and not set(links) & set(robot.moving_links):
        raise SceneError(
            "the obstacle has no effect: none of these links both moves and has a shape",
            file=file,
            key=key,
            found=", ".join(links) or "no link",
            allowed=", ".join(robot.moving_links),
        )


def build_obstacle(
    spec: obstacle_shapes.ObstacleSpec, *, folder: Path, clearance: float, zone: ZoneSpec | None = None
) -> Obstacle:
    """One obstacle, from its record.

    Parameters
    ----------
    folder: the folder to which the name of its file is relative.
    clearance: for an obstacle that has none of its own [m].
    zone: the zone whose solid it is, if any.

    Raises
    ------
    InputError: its file is missing, empty or malformed, or needs too many pieces.
    """
    body = _body(spec, folder)
    cluster = body if isinstance(body, Cluster) else None
    velocity = np.array(spec.velocity, dtype=float)
    velocity.setflags(write=False)
    return Obstacle(
        name=spec.name,
        pieces=() if isinstance(body, Cluster) else tuple(body),
        clearance=clearance if spec.clearance is None else spec.clearance,
        links=spec.links,
        appears_at=spec.appears_at,
        velocity=velocity,
        spec=spec,
        zone=zone,
        cluster=cluster,
        folder=folder,
    )


def _body(spec: obstacle_shapes.ObstacleSpec, folder: Path) -> list[shapes.Piece] | Cluster:
    """The pieces or the cluster of an obstacle; errors name its file."""
    try:
        return body_of(spec, folder)
    except InputError as error:
        file = getattr(spec, "file", None)
        if error.file is not None or file is None:
            raise
        raise InputError.of(error, file=folder / file, key=error.key) from error


def offset_at(obstacle: Obstacle, time: float) -> Vector:
    """(3,) how far an obstacle has moved by `time` [s] from where it appeared [m]."""
    return np.asarray(obstacle.velocity * max(time - obstacle.appears_at, 0.0))


def sweep(obstacle: Obstacle, start: float, end: float) -> Obstacle:
    """An obstacle at rest that contains all the space that `obstacle` takes up from time `start` to `end` [s].

    Round pieces become a little larger: a ball counts as the octahedron around it. A cluster becomes some
    larger boxes that contain it.
    """
    ways = [offset_at(obstacle, moment) for moment in (start, end)]
    pieces = obstacle.pieces if obstacle.cluster is None else obstacle.cluster.boxes(_SWEPT_BOXES)
    return replace(
        obstacle,
        pieces=tuple(_sweep_piece(piece, *ways) for piece in pieces),
        cluster=None,
        appears_at=0.0,
        velocity=np.zeros(3),
    )


def _sweep_piece(piece: shapes.Piece, start: Vector, end: Vector) -> shapes.Piece:
    """A convex piece that contains `piece` on its path from offset `start` to `end` (3,) [m]."""
    if not len(piece.hull):  # a half-space: the further of the two contains both
        normal = np.asarray(piece.shape.n)
        further = end if float((end - start) @ normal) > 0.0 else start
        return replace(piece, placement=pin.SE3(piece.placement.rotation, piece.placement.translation + further))
    around = np.zeros((1, 3))
    if piece.radius > 0.0:
        around = piece.radius * np.sqrt(3.0) * np.vstack((np.eye(3), -np.eye(3)))
    points = (piece.hull[:, None, :] + around[None, :, :]).reshape(-1, 3)
    return shapes.convex(np.vstack((points + start, points + end)), pin.SE3.Identity())


def _bounds_of(piece: shapes.Piece) -> Matrix:
    """(2, 3) lowest and highest corner of a box around a piece [m]; a half-space is bounded only along an axis."""
    if len(piece.hull):
        return np.array([piece.hull.min(axis=0) - piece.radius, piece.hull.max(axis=0) + piece.radius])
    found = np.array([np.full(3, -np.inf), np.full(3, np.inf)])
    normal = piece.placement.rotation @ piece.shape.n
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1.0 - _ALONG:
        face = normal @ piece.placement.translation + piece.shape.d
        found[int(normal[axis] > 0.0), axis] = face * normal[axis]
    return found
