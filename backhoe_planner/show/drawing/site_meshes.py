"""The obstacles of a site as triangles, and their clearance shells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Cluster, clustered
from backhoe_planner.show.drawing.palette import SOIL, Rgba
from backhoe_planner.show.drawing.solids import Facets, cells, disc, facets, fattened, grid, solid, together
from backhoe_planner.site import Obstacle, Scene, read_heights
from backhoe_planner.site.schema import obstacle_shapes

_MOST_ROUNDED = 60  # pieces of one obstacle whose shells are rounded exactly; chosen, each costs milliseconds
_MOST_TRIANGLES = 40_000  # drawn per obstacle; chosen: some 3 MB of a page
_MANY_FAR = 50  # obstacles out of reach from which on they are drawn as one; chosen: a picture of 2,000 nodes is slow
_MOST_FAR = 200_000  # triangles of all that is drawn as one, if the shapes allow it; chosen: some 10 MB of a page
_MANY_NEAR = 100  # obstacles with nodes of their own from which on round ones have fewer triangles; chosen
_FEWEST = 200  # triangles of one of them; chosen, a car is still recognised

# colours, chosen by eye
_SLATE = (0.45, 0.52, 0.60)
_STEEL = (0.56, 0.59, 0.63)
_TIMBER = (0.52, 0.40, 0.29)
_UTILITY = (0.95, 0.62, 0.10)
_DANGER = (0.90, 0.25, 0.20)
_ZONE = (0.93, 0.46, 0.12)
_MOVING = (0.88, 0.36, 0.22)
_ROCK = (0.56, 0.53, 0.50)
_SCAN = (0.36, 0.56, 0.58)
_COLOURS = {
    "mesh": SOIL, "pointcloud": _SCAN, "sphere": _ROCK, "cylinder": _STEEL, "capsule": _STEEL,
}  # any other shape is slate  # fmt: skip
_LEVEL, _PIPE = 0.05, 0.3  # m: a box that ends below the first is ground, a capsule below the second is a pipe; chosen
_CREASE_OF_GROUND = 1.3  # rad: walls of a pit are edges, single rough cells are not; chosen
_SLENDER = 6.0  # times as high as wide: a more slender shape looks like a pole; chosen


@dataclass(frozen=True)
class SiteMesh:
    """The drawing of an obstacle, in world coordinates at the time of its appearance.

    Attributes
    ----------
    name: name of the obstacle.
    facets, rgba: triangles and colour of the obstacle.
    shell, shell_rgba: the surface at its clearance; None if the clearance is 0, and for scans and fine meshes.
    anchor: (3,) position of its label [m].
    bounds: (2, 3) lowest and highest corner [m]; None for an unbounded obstacle.
    one_sided: whether it is visible only from outside, as ground is from above.
    """

    name: str
    facets: Facets
    rgba: Rgba
    shell: Facets | None
    shell_rgba: Rgba
    anchor: Vector
    bounds: Vector | None
    one_sided: bool = False


def is_ground(obstacle: Obstacle) -> bool:
    """Whether an obstacle is the ground, so that no other ground needs to be drawn."""
    spec = obstacle.spec
    level = isinstance(spec, obstacle_shapes.HalfSpace) and spec.normal[2] > 0.7
    return obstacle.zone is None and (level or isinstance(spec, obstacle_shapes.HeightMap))


def drawn_as_one(obstacles: Sequence[Obstacle], *, centre: Vector, reach: float) -> tuple[Obstacle, ...]:
    """The obstacles that are far away and stay as they are, if there are so many that they are drawn as one.

    Parameters
    ----------
    centre, reach: (3,) middle of the machine, and the radius beyond which an obstacle is far away [m].
    """
    found = []
    for obstacle in obstacles:
        stays = not obstacle.moves and obstacle.appears_at == 0.0 and obstacle.spec.legs is None
        if obstacle.box_away_unchecked(centre) > reach and stays and obstacle.zone is None and not is_ground(obstacle):
            found.append(obstacle)
    return tuple(found) if len(found) > _MANY_FAR else ()


def mesh_of_many(obstacles: Sequence[Obstacle]) -> Facets:
    """The triangles of many obstacles, in their colours and without shells: simple where they would be too many."""
    most = max(_MOST_FAR // len(obstacles), _FEWEST)
    parts = [_simple(obstacle, most) for obstacle in obstacles]
    colours = np.array([_colour(obstacle, part) for obstacle, part in zip(obstacles, parts, strict=True)])
    drawn = facets(trimesh.util.concatenate(parts))
    rgba = np.empty((len(drawn.vertices), 4))
    rgba[drawn.faces] = np.repeat(colours, [len(part.faces) for part in parts], axis=0)[:, None]
    return replace(drawn, rgba=rgba)


def _simple(obstacle: Obstacle, most: int) -> trimesh.Trimesh:
    """The surface of an obstacle's pieces or cells, with about `most` triangles at most."""
    if obstacle.cluster is not None:
        return trimesh.Trimesh(*obstacle.cluster.drawing(most), process=False)
    return trimesh.util.concatenate([solid(piece, rough=True) for piece in obstacle.pieces])


def site_mesh(obstacle: Obstacle, scene: Scene, *, centre: Vector, reach: float, among: int = 1) -> SiteMesh:
    """The drawing of one obstacle.

    Parameters
    ----------
    centre: (3,) middle of the machine [m]; a plane is drawn around it.
    reach: radius up to which a plane is drawn [m].
    among: the number of obstacles that are drawn; round ones have fewer triangles among many.
    """
    rough = among > _MANY_NEAR
    spec = obstacle.spec
    if isinstance(spec, obstacle_shapes.HalfSpace):
        return _plane(obstacle, spec, centre, reach)
    if obstacle.cluster is not None:
        return _cluster(obstacle, obstacle.cluster)
    if isinstance(spec, obstacle_shapes.HeightMap):
        return _ground(obstacle, _terrain(spec, scene))
    if isinstance(spec, obstacle_shapes.Mesh):
        drawn = _reduced(spec.loaded(scene.folder))
        drawn.apply_transform(spec.placement.homogeneous)
        drawn = trimesh.Trimesh(drawn.vertices, drawn.faces)
    else:
        drawn = trimesh.util.concatenate([solid(piece, rough=rough) for piece in obstacle.pieces])
    low, high = drawn.bounds
    anchor = np.array([*(0.5 * (low + high))[:2], high[2]])
    if isinstance(spec, obstacle_shapes.Capsule) and high[2] - low[2] < 0.5 * max(high[0] - low[0], high[1] - low[1]):
        anchor = np.array([*spec.start[:2], spec.start[2] + spec.radius])  # a pipe: its end is easier to see
    rgba = _colour(obstacle, drawn)
    shell = None if obstacle.clearance == 0.0 else facets(_reduced(_shell(obstacle, rough=rough)))
    return SiteMesh(
        name=obstacle.name, facets=facets(drawn), rgba=rgba, shell=shell, shell_rgba=(*rgba[:3], 0.16),
        anchor=np.asarray(anchor, dtype=float), bounds=np.asarray(drawn.bounds, dtype=float),
    )  # fmt: skip


def _cluster(obstacle: Obstacle, cluster: Cluster) -> SiteMesh:
    """A solid of thousands of cells as one surface, simplified if it has too many triangles."""
    drawn = trimesh.Trimesh(*cluster.drawing(_MOST_TRIANGLES), process=False)
    low, high = drawn.bounds
    anchor = np.array([*(0.5 * (low + high))[:2], high[2]])
    if isinstance(obstacle.spec, obstacle_shapes.HeightMap):
        return _ground(obstacle, drawn)
    return SiteMesh(
        name=obstacle.name, facets=facets(drawn), rgba=_colour(obstacle, drawn), shell=None,
        shell_rgba=(0.0, 0.0, 0.0, 0.0), anchor=anchor, bounds=np.asarray(drawn.bounds, dtype=float),
    )  # fmt: skip


def _ground(obstacle: Obstacle, surface: trimesh.Trimesh) -> SiteMesh:
    """Uneven ground; the surface at its clearance is the ground itself, lifted."""
    drawn = facets(surface, _CREASE_OF_GROUND)
    lifted = replace(drawn, vertices=drawn.vertices + np.array([0.0, 0.0, obstacle.clearance]))
    return SiteMesh(
        name=obstacle.name, facets=drawn, rgba=(*SOIL, 1.0),
        shell=None if obstacle.clearance == 0.0 else lifted, shell_rgba=(*SOIL, 0.16),
        anchor=surface.vertices[np.argmax(surface.vertices[:, 2])], bounds=surface.bounds, one_sided=True,
    )  # fmt: skip


def _reduced(surface: trimesh.Trimesh) -> trimesh.Trimesh:
    """The surface, with fewer triangles if it has too many to be drawn."""
    if len(surface.faces) <= _MOST_TRIANGLES:
        return surface
    return trimesh.Trimesh(*clustered(surface.vertices, surface.faces, _MOST_TRIANGLES), process=False)


def _shell(obstacle: Obstacle, *, rough: bool) -> trimesh.Trimesh:
    pieces = obstacle.pieces
    if len(pieces) <= _MOST_ROUNDED:
        grown_pieces = [fattened(piece.hull, piece.radius + obstacle.clearance, rough=rough) for piece in pieces]
        return trimesh.util.concatenate(grown_pieces)
    boxes = []  # too many to round: use boxes around them, a little larger than the true shell
    for piece in pieces:
        grown = piece.radius + obstacle.clearance
        low, high = piece.hull.min(axis=0) - grown, piece.hull.max(axis=0) + grown
        boxes.append(trimesh.creation.box(bounds=np.array([low, high])))
    return trimesh.util.concatenate(boxes)


def _colour(obstacle: Obstacle, drawn: trimesh.Trimesh) -> Rgba:
    low, high = drawn.bounds
    wide = float((high - low)[:2].max())
    shape = obstacle.spec.shape
    if obstacle.zone is not None:
        return (*_ZONE, 0.3)
    if obstacle.is_dynamic:
        return (*_MOVING, 1.0)
    if shape == "box" and high[2] <= _LEVEL:  # ground next to or under the work
        return (*SOIL, 0.42)
    if shape == "capsule" and high[2] <= _PIPE:
        return (*_UTILITY, 1.0)
    if shape in ("cylinder", "capsule") and high[2] - low[2] > _SLENDER * wide:
        return (*_TIMBER, 1.0)
    return (*_COLOURS.get(shape, _SLATE), 1.0)


def _plane(obstacle: Obstacle, spec: obstacle_shapes.HalfSpace, centre: Vector, reach: float) -> SiteMesh:
    normal, point = np.array(spec.normal), np.array(spec.point)
    middle = centre - normal * float((centre - point) @ normal)
    if is_ground(obstacle):
        rgba: Rgba = (*SOIL, 0.95 if obstacle.links is None else 0.6)
        fade = 0.6
    elif obstacle.zone is not None:
        rgba, fade = (*_ZONE, 0.05), 0.5
    else:
        overhead = normal[2] < -0.5
        rgba, fade = ((*_DANGER, 0.3), 0.35) if overhead else ((*_SLATE, 0.35), 0.8)
    shell_rgba: Rgba = (*rgba[:3], 0.22)
    shell = None
    if obstacle.clearance > 0.0:
        shell = disc(middle + normal * obstacle.clearance, normal, reach, shell_rgba, fade_from=0.35)
    # a label in the middle would hide the machine, and so would one behind it
    aside = np.cross(normal, [0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.6, 0.8, 0.0])
    aside = -aside if aside[0] < 0.0 else aside
    sheet = disc(middle, normal, reach, rgba, fade_from=fade)
    if obstacle.zone is not None:  # several overlapping sheets would be one haze; lines show where each is
        sheet = together(sheet, grid(middle, normal, 0.85 * reach, (*_ZONE, 0.75)))
    return SiteMesh(
        name=obstacle.name,
        facets=sheet,
        rgba=rgba,
        shell=shell,
        shell_rgba=shell_rgba,
        anchor=middle + 0.33 * reach * aside / np.linalg.norm(aside),
        bounds=None,
    )


def _terrain(spec: obstacle_shapes.HeightMap, scene: Scene) -> trimesh.Trimesh:
    heights = read_heights(scene.folder / spec.file)
    rows, columns = heights.shape
    x = np.linspace(-spec.size[0] / 2.0, spec.size[0] / 2.0, columns)
    y = np.linspace(-spec.size[1] / 2.0, spec.size[1] / 2.0, rows)
    xs, ys = np.meshgrid(x, y)
    faces = cells(np.arange(rows * columns).reshape(rows, columns))
    surface = trimesh.Trimesh(np.column_stack((xs.ravel(), ys.ravel(), heights.ravel())), faces, process=False)
    surface.apply_transform(spec.placement.homogeneous)
    return surface
