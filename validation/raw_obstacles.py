"""The obstacles of a scene as convex parts, from the text of the scene file, without the planner's code.

A mesh becomes its triangles, a cell of a height map the ground below both of its splits into
triangles, and a point of a cloud the voxel that contains it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from backhoe_planner.arrays import Array, Matrix, Vector
from validation.convex_gaps import Body, Part, ball, block, drum, rod, solid_mesh, spread
from validation.raw_urdf import read_mesh, rotation_of

Record = dict[str, Any]

_DEEP = 3.0  # m of ground below the lowest height, deeper than any obstacle
_LEVELS = (0.0, 0.3, 0.8, 1.6)  # m below the surface, of the points measured first
_PRISM_TOP = np.array([[0, 1, 2]])


@dataclass(frozen=True, eq=False)
class RawObstacle:
    """An obstacle as written.

    Attributes
    ----------
    body: its parts in world axes at the place where it appears; None for a half-space.
    point, normal: of a half-space.
    """

    name: str
    shape: str
    clearance: float
    links: tuple[str, ...] | None
    appears_at: float
    velocity: Vector
    body: Body | None
    point: Vector
    normal: Vector

    def shift(self, time: Vector) -> Matrix:
        """(T, 3) its displacement at `time` (T,) [m]."""
        return np.maximum(time - self.appears_at, 0.0)[:, None] * self.velocity

    def below_plane(self, part: Part, rotation: Array, translation: Matrix) -> Vector:
        """(T,) exact distances of a part at T placements, relative to a half-space [m]."""
        height = np.min((np.einsum("tij,kj->tki", rotation, part.corners) - self.point) @ self.normal, axis=1)
        height += translation @ self.normal - part.radius
        if part.disc > 0.0:
            axis = part.corners[1] - part.corners[0]
            along = rotation @ (axis / np.linalg.norm(axis)) @ self.normal
            height -= part.disc * np.sqrt(np.maximum(1.0 - np.square(along), 0.0))
        return np.asarray(height)


def read_obstacle(record: Record, *, folder: Path, clearance: float) -> RawObstacle:
    """An obstacle from its record in the scene file.

    Parameters
    ----------
    folder: of its file.
    clearance: of the scene, for an obstacle without its own [m].
    """
    normal = np.array(record.get("normal", (0.0, 0.0, 1.0)), dtype=float)
    links = record.get("links")
    return RawObstacle(
        name=record["name"],
        shape=record["shape"],
        clearance=clearance if record.get("clearance") is None else float(record["clearance"]),
        links=None if links is None else tuple(links),
        appears_at=float(record.get("appears_at", 0.0)),
        velocity=np.array(record.get("velocity", (0.0, 0.0, 0.0)), dtype=float),
        body=None if record["shape"] == "halfspace" else Body(record["name"], _parts(record, folder)),
        point=np.array(record.get("point", (0.0, 0.0, 0.0)), dtype=float),
        normal=normal / np.linalg.norm(normal),
    )


def solid_of(zone: Record) -> Record:
    """The obstacle that a zone stands for: a ceiling, a floor or a cab."""
    plain = {"name": zone["name"], "clearance": zone.get("stop", 0.0), "links": zone.get("links")}
    if zone["kind"] == "cab":
        return {**plain, "shape": "box", **{key: zone[key] for key in ("size", "position", "rpy") if key in zone}}
    up = {"floor": 1.0, "ceiling": -1.0}[zone["kind"]]
    return {**plain, "shape": "halfspace", "point": [0.0, 0.0, zone["height"]], "normal": [0.0, 0.0, up]}


def _parts(record: Record, folder: Path) -> list[Part]:
    shape = record["shape"]
    if shape == "capsule":
        return [rod(np.array(record["from"]), np.array(record["to"]), record["radius"])]
    place, turn = np.array(record.get("position", (0.0, 0.0, 0.0)), dtype=float), turn_of(record)
    if shape == "sphere":
        return [ball(place, record["radius"])]
    if shape == "box":
        return [block(np.array(record["size"]), turn, place, points=300)]
    if shape == "cylinder":
        return [drum(record["radius"], record["length"], turn, place, points=200)]
    file = folder / record["file"]
    if shape == "mesh":
        mesh = read_mesh(file)
        vertices = np.asarray(mesh.vertices) * np.array(record.get("scale", 1.0))
        return solid_mesh(vertices @ turn.T + place, np.asarray(mesh.faces))
    if shape == "heightmap":
        return _ground(np.loadtxt(file, delimiter=",", ndmin=2), record["size"], turn, place)
    if shape == "pointcloud":
        return _voxels(read_cloud(file), float(record["resolution"]), turn, place)
    raise NotImplementedError(shape)


def turn_of(record: Record) -> Matrix:
    """(3, 3) the orientation of a record, by rpy or quaternion [w, x, y, z]."""
    if record.get("quaternion") is None:
        return rotation_of(np.array(record.get("rpy") or (0.0, 0.0, 0.0), dtype=float))
    w, x, y, z = np.array(record["quaternion"], dtype=float) / np.linalg.norm(record["quaternion"])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross)


def read_cloud(file: Path) -> Matrix:
    """(n, 3) the points of a PLY file, or of text with x, y, z in the first columns."""
    if file.suffix == ".ply":
        return np.asarray(trimesh.load(file, process=False).vertices, dtype=float)
    return np.loadtxt(file, delimiter=",", ndmin=2)[:, :3]


def cells(heights: Matrix, size: tuple[float, float]) -> list[Matrix]:
    """The four surface points (4, 3) of every cell of a height map: [0, 0], [0, 1], [1, 0], [1, 1]."""
    rows, columns = heights.shape
    x, y = (np.linspace(-0.5, 0.5, count) * extent for count, extent in ((columns, size[0]), (rows, size[1])))
    grid = np.dstack((*np.meshgrid(x, y), heights))
    return [grid[r : r + 2, c : c + 2].reshape(4, 3) for r in range(rows - 1) for c in range(columns - 1)]


def _ground(heights: Matrix, size: tuple[float, float], turn: Matrix, place: Vector) -> list[Part]:
    floor = float(heights.min()) - _DEEP
    found = []
    for cell in cells(heights, size):
        for triangle in ([0, 1, 2], [1, 3, 2], [0, 1, 3], [0, 3, 2]):
            top = cell[triangle]
            prism = np.vstack((top, top * [1.0, 1.0, 0.0] + [0.0, 0.0, floor]))
            surface = np.vstack((top, spread(top, _PRISM_TOP, 4)))
            # parts deep in the ground are near no point of its surface
            points = np.vstack([surface - [0.0, 0.0, depth] for depth in _LEVELS])
            found.append(Part(prism @ turn.T + place, 0.0, points @ turn.T + place))
    return found


def _voxels(points: Matrix, resolution: float, turn: Matrix, place: Vector) -> list[Part]:
    lowest = np.unique(np.floor(points / resolution), axis=0)
    edges = np.full(3, resolution)
    return [block(edges, turn, turn @ ((corner + 0.5) * resolution) + place, points=6) for corner in lowest]
