"""The links of a URDF as convex collision pieces, and what is drawn of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import yourdfpy

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.machine.description.urdf import Urdf, se3
from backhoe_planner.machine.shape.convex import convex_cover, load_mesh
from backhoe_planner.machine.shape.shapes import Piece, box, convex, cylinder, sphere

# A link's mesh is taken as its convex hull unless the hull would close a cavity.
_LINK_HULL_EXCESS = 2.0  # times the mesh's volume: a solid link with recesses is below, an open bucket far above
_PIECES_PER_LINK_MESH = 8  # at most: every piece is one more pair with each obstacle


@dataclass(frozen=True)
class LinkPiece:
    """A convex collision piece of a link.

    Attributes
    ----------
    name: unique, ``link/0``, ``link/1``, ...
    link: the URDF link to which it belongs.
    joint: index of the Pinocchio joint that carries it; 0 stands still.
    piece: the shape, placed in the frame of that joint.
    """

    name: str
    link: str
    joint: int
    piece: Piece


@dataclass(frozen=True)
class Visual:
    """Something to draw.

    Attributes
    ----------
    link, joint: as in `LinkPiece`.
    placement: T_joint_visual.
    kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
    size: box edges (3,); cylinder (radius, length); sphere (radius,); mesh scale (3,).
    mesh: the file of a mesh.
    rgba: (4,) in 0..1, or None where the URDF gives no colour.
    """

    link: str
    joint: int
    placement: pin.SE3
    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    rgba: tuple[float, ...] | None


def _body(model: pin.Model, link: str) -> tuple[int, pin.SE3]:
    """Joint that carries a link, and T_joint_link."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return int(frame.parentJoint), frame.placement


def _mesh_scale(mesh: yourdfpy.Mesh) -> Vector:
    scale = 1.0 if mesh.scale is None else mesh.scale
    return np.broadcast_to(np.asarray(scale, dtype=float), (3,)).copy()


def link_pieces(urdf: Urdf, model: pin.Model) -> tuple[LinkPiece, ...]:
    """Convex pieces that contain the collision shape of every link, placed in the frames of the model's joints.

    Raises
    ------
    RobotError: a mesh is missing or cannot be read.
    """
    found = []
    for link in urdf.robot.links:
        if not link.collisions:
            continue
        joint, T_joint_link = _body(model, link.name)
        pieces: list[Piece] = []
        for collision in link.collisions:
            try:
                pieces += _pieces_of(urdf, collision.geometry, T_joint_link * se3(collision.origin))
            except InputError as error:
                raise RobotError(str(error), file=urdf.path, key=f"link {link.name!r} > collision") from error
        found += [LinkPiece(f"{link.name}/{k}", link.name, joint, piece) for k, piece in enumerate(pieces)]
    return tuple(found)


def _pieces_of(urdf: Urdf, geometry: yourdfpy.Geometry, placement: pin.SE3) -> list[Piece]:
    if geometry.box is not None:
        return [box(geometry.box.size, placement)]
    if geometry.sphere is not None:
        return [sphere(geometry.sphere.radius, placement)]
    if geometry.cylinder is not None:
        return [cylinder(geometry.cylinder.radius, geometry.cylinder.length, placement)]
    path = urdf.mesh_path(geometry.mesh.filename)
    if path is None:
        raise InputError("mesh file not found", found=geometry.mesh.filename)
    mesh = load_mesh(path)
    mesh.apply_scale(_mesh_scale(geometry.mesh))
    cover = convex_cover(mesh, pieces=_PIECES_PER_LINK_MESH, excess=_LINK_HULL_EXCESS)
    return [convex(points, placement) for points in cover]


def visuals_of(urdf: Urdf, model: pin.Model) -> tuple[Visual, ...]:
    """What the URDF has to draw of every link, placed in the frames of the model's joints."""
    colours = {
        material.name: tuple(float(c) for c in material.color.rgba)
        for material in urdf.robot.materials
        if material.color is not None
    }
    found = []
    for link in urdf.robot.links:
        if not link.visuals:
            continue
        joint, T_joint_link = _body(model, link.name)
        for visual in link.visuals:
            geometry = visual.geometry
            rgba = None
            if visual.material is not None:
                own = visual.material.color
                rgba = tuple(float(c) for c in own.rgba) if own is not None else colours.get(visual.material.name)
            mesh = None
            if geometry.box is not None:
                kind, size = "box", tuple(float(edge) for edge in geometry.box.size)
            elif geometry.cylinder is not None:
                kind, size = "cylinder", (float(geometry.cylinder.radius), float(geometry.cylinder.length))
            elif geometry.sphere is not None:
                kind, size = "sphere", (float(geometry.sphere.radius),)
            else:
                kind, size = "mesh", tuple(float(s) for s in _mesh_scale(geometry.mesh))
                mesh = urdf.mesh_path(geometry.mesh.filename)
            found.append(Visual(link.name, joint, T_joint_link * se3(visual.origin), kind, size, mesh, rgba))
    return tuple(found)
