"""The machine as triangles: one set per link and colour."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from backhoe_planner.arrays import Matrix
from backhoe_planner.files.meshes.mesh_parts import check_all_read
from backhoe_planner.machine import KeyedRobot, Robot, Visual, mesh_frame
from backhoe_planner.show.drawing.palette import MACHINE, Rgba
from backhoe_planner.show.drawing.solids import Facets, facets, solid

_PLAIN: Rgba = (*MACHINE, 1.0)
_ODD = 100.0  # times as large or small: a shape is probably in other units than another one; chosen


@dataclass(frozen=True)
class LinkMesh:
    """The triangles of a link in one colour.

    Attributes
    ----------
    link: name of the link.
    joint: index of the Pinocchio joint that carries it; 0 does not move.
    rgba: colour.
    facets: triangles in the frame of that joint [m].
    """

    link: str
    joint: int
    rgba: Rgba
    facets: Facets


def machine_meshes(robot: Robot) -> tuple[tuple[LinkMesh, ...], tuple[str, ...]]:
    """The drawing of the machine, and in words what could not be drawn as its URDF specifies.

    A visual whose mesh cannot be read is replaced by the link's collision pieces. If the URDF has no visuals, the
    whole machine is. The last four machines are remembered: reading the meshes of a Panda takes most of the time of a
    page.
    """
    # the same for copies with the same shapes, such as with a tracking error or other limits
    return _machine_meshes(KeyedRobot(robot, (id(robot.visuals), id(robot.pieces))))


@lru_cache(maxsize=4)
def _machine_meshes(shaped: KeyedRobot[tuple[int, int]]) -> tuple[tuple[LinkMesh, ...], tuple[str, ...]]:
    robot = shaped.robot
    warnings: list[str] = []
    parts: dict[tuple[str, int, Rgba], list[trimesh.Trimesh]] = {}
    replaced: set[str] = set()
    for visual in robot.visuals:
        try:
            drawn = _visual(visual)
        except Exception as error:  # noqa: BLE001 (trimesh passes on whatever its format readers raise)
            replaced.add(visual.link)
            named = "not found" if visual.mesh is None else f"{visual.mesh.name}: {error}"
            warnings.append(
                f"link {visual.link}: the visual mesh cannot be read ({named}); its collision shape is drawn"
            )
            continue
        for rgba, mesh in drawn:
            parts.setdefault((visual.link, visual.joint, rgba), []).append(mesh)
    warnings += _odd_sizes(robot, parts)
    if not robot.visuals:
        warnings.append("the URDF has no visuals; the collision shapes are drawn")
        replaced.update(robot.link_names)
    for piece in robot.pieces:
        if piece.link in replaced:
            parts.setdefault((piece.link, piece.joint, _PLAIN), []).append(solid(piece.piece))
    found = tuple(
        LinkMesh(link, joint, rgba, facets(trimesh.util.concatenate(meshes)))
        for (link, joint, rgba), meshes in parts.items()
    )
    return found, tuple(warnings)


def _odd_sizes(robot: Robot, drawn: dict[tuple[str, int, Rgba], list[trimesh.Trimesh]]) -> list[str]:
    """Words about links that are drawn so much larger or smaller than they count as if in other units."""
    visible, counted = dict[str, list[Matrix]](), dict[str, list[Matrix]]()
    for (link, _, _), meshes in drawn.items():
        visible.setdefault(link, []).extend(np.asarray(mesh.bounds) for mesh in meshes)
    for piece in robot.pieces:
        hull, radius = piece.piece.hull, piece.piece.radius
        counted.setdefault(piece.link, []).append(np.array([hull.min(axis=0) - radius, hull.max(axis=0) + radius]))
    found = []
    for link in visible.keys() & counted.keys():
        ends = (np.stack(boxes) for boxes in (visible[link], counted[link]))
        sizes = [float(np.max(each[:, 1].max(axis=0) - each[:, 0].min(axis=0))) for each in ends]
        if max(sizes) > _ODD * min(sizes):
            found.append(
                f"link {link}: it is drawn {sizes[0]:.3g} m large, and its collision shape is {sizes[1]:.3g} m large; "
                "`scale` of its <mesh> takes the units of a file to metres"
            )
    return sorted(found)


def _visual(visual: Visual) -> list[tuple[Rgba, trimesh.Trimesh]]:
    """Meshes and their colours, in the frame of the visual's joint."""
    if visual.kind != "mesh":
        made = _primitive(visual)
        made.apply_transform(visual.placement.homogeneous)
        return [(_rgba(visual.rgba), made)]
    if visual.mesh is None:
        raise FileNotFoundError("mesh file not found")
    check_all_read(visual.mesh)
    scale, T_visual_file = mesh_frame(visual.mesh, np.asarray(visual.size))
    placement = (visual.placement * T_visual_file).homogeneous
    loaded = trimesh.load_scene(visual.mesh)
    found = []
    for mesh in loaded.dump():
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            continue
        rgba = _rgba(visual.rgba) if visual.rgba is not None else _own_colour(mesh)
        plain = trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)
        plain.merge_vertices(merge_tex=True, merge_norm=True)
        plain.apply_transform(placement)
        if np.linalg.det(np.diag(visual.size)) < 0.0:
            plain.invert()
        found.append((rgba, plain))
    if not found:
        raise ValueError("holds no triangles")
    return found


def _primitive(visual: Visual) -> trimesh.Trimesh:
    if visual.kind == "box":
        return trimesh.creation.box(extents=visual.size)
    if visual.kind == "cylinder":
        return trimesh.creation.cylinder(radius=visual.size[0], height=visual.size[1], sections=32)
    return trimesh.creation.icosphere(subdivisions=3, radius=visual.size[0])


def _own_colour(mesh: trimesh.Trimesh) -> Rgba:
    """The colour in the mesh file; for an image, its mean."""
    visual = mesh.visual
    if getattr(visual, "kind", None) == "texture":
        image = getattr(visual.material, "image", None)
        if image is not None:
            mean = np.asarray(image.convert("RGBA"), dtype=float).reshape(-1, 4).mean(axis=0)
            return _rgba(tuple(mean / 255.0))
    colour: NDArray[np.float64] | None = None
    if getattr(visual, "defined", False):
        colour = np.asarray(visual.main_color if hasattr(visual, "main_color") else visual.material.main_color, float)
    return _PLAIN if colour is None else _rgba(tuple(colour / 255.0))


def _rgba(colour: tuple[float, ...] | None) -> Rgba:
    if colour is None:
        return _PLAIN
    r, g, b, *rest = (round(float(part), 3) for part in colour)
    # an opacity of 0 in a URDF is more likely a mistake than intended
    return (r, g, b, rest[0] if rest and rest[0] > 0.0 else 1.0)
