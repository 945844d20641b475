"""The links of a URDF as convex collision pieces, and the shapes to draw."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, RobotError
from backhoe_planner.files.meshes.mesh_axes import along_file_axes, mesh_axes, upright
from backhoe_planner.machine.description.urdf import Urdf, se3
from backhoe_planner.machine.description.urdf_tree import Geometry, Mesh
from backhoe_planner.machine.shape.cover_cache import mesh_cover
from backhoe_planner.machine.shape.shapes import Piece, box, convex, cylinder, sphere

# volume of a mesh's hull over the mesh's own, up to which the hull represents the link: a solid link with recesses
# is below, an open bucket, whose cavity the hull would close, far above
_LINK_HULL_EXCESS = 2.0
# times the distances between joints, added up: a mesh of another size is probably in other units; chosen
_LARGE, _TINY = 50.0, 1e-4
_PIECES_PER_LINK_MESH = 8  # at most; chosen, few because each is one more pair with every obstacle


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


@dataclass(frozen=True, eq=False)
class LinkSolid:
    """A convex solid of a link, in the frame of the link.

    Attributes
    ----------
    link: the URDF link to which it belongs.
    T_link_solid: its placement on the link.
    piece_at: returns the piece at a placement T_body_solid.
    cached: whether its corners came from the cache folder; None if it is not a piece of a mesh.
    """

    link: str
    T_link_solid: pin.SE3
    piece_at: Callable[[pin.SE3], Piece]
    cached: bool | None = None


class _Solid(NamedTuple):
    piece_at: Callable[[pin.SE3], Piece]
    cached: bool | None = None
    T_shape_file: pin.SE3 | None = None  # of the file of a mesh in its shape; None if they are the same
    size: float = 0.0  # of a whole mesh, along its longest axis [m]; 0 if it is not a piece of one


@dataclass(frozen=True)
class Visual:
    """A shape to draw.

    Attributes
    ----------
    link, joint: as in `LinkPiece`.
    placement: T_joint_visual.
    kind: ``box``, ``cylinder``, ``sphere`` or ``mesh``.
    size: box edges (3,); cylinder (radius, length); sphere (radius,); mesh scale (3,).
    mesh: the file of a mesh.
    rgba: (4,) in 0..1, or None if the URDF gives no colour.
    """

    link: str
    joint: int
    placement: pin.SE3
    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    rgba: tuple[float, ...] | None


def _body(model: pin.Model, link: str) -> tuple[int, pin.SE3]:
    """Pinocchio's joint that carries a link, and T_joint_link."""
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    return int(frame.parentJoint), frame.placement


def _mesh_scale(mesh: Mesh) -> Vector:
    return np.full(3, 1.0 if mesh.scale is None else mesh.scale, dtype=float)


def mesh_frame(path: Path, scale: Vector) -> tuple[Vector, pin.SE3]:
    """How the coordinates of a mesh file of a link become those of its shape in the URDF, as in RViz.

    Parameters
    ----------
    scale: (3,) the URDF's factors, along the axes of the shape.

    Returns
    -------
    (3,) the factors along the axes of the file, with its unit [m]; and T_shape_file, which turns y of a glTF upwards.

    Raises
    ------
    InputError: see `mesh_axes`.
    """
    axes = mesh_axes(path)
    return axes.unit * along_file_axes(scale, axes.up), pin.SE3(upright(axes.up), np.zeros(3))


def link_solids(urdf: Urdf) -> tuple[tuple[LinkSolid, ...], tuple[str, ...]]:
    """Convex solids that contain the collision shape of every link. Dividing a mesh for the first time takes long.

    If no link of the URDF has a collision shape, the visuals are used instead.

    Returns
    -------
    The solids; and warnings in words about links that have a visual and no collision shape, and about meshes that
    may be in other units.

    Raises
    ------
    RobotError: a mesh is missing or cannot be read.
    """
    links = urdf.robot.links
    drawn = not any(link.collisions for link in links)
    kind = "visual" if drawn else "collision"
    found, bare, odd = [], [], dict[str, None]()
    apart = sum(float(np.linalg.norm(se3(joint.origin).translation)) for joint in urdf.robot.joints)
    for link in links:
        shapes = link.visuals if drawn else link.collisions
        if link.visuals and not shapes:
            bare.append(link.name)
        for shape in shapes:
            try:
                solids = _solids_of(urdf, shape.geometry)
            except InputError as error:
                raise RobotError(str(error), file=urdf.named, key=f"link {link.name!r} > {kind}") from error
            size = max((solid.size for solid in solids), default=0.0)
            mesh = shape.geometry.mesh
            if mesh is not None and apart and not _TINY * apart <= size <= _LARGE * apart:
                odd[f"{link.name} ({mesh.filename}, {size:.2g} m)"] = None
            for solid in solids:
                placement = se3(shape.origin) * (solid.T_shape_file or pin.SE3.Identity())
                found.append(LinkSolid(link.name, placement, solid.piece_at, solid.cached))
    warnings = []
    if drawn and found:
        warnings.append("no link has a <collision>: what is drawn of the links is taken as their shape")
    if bare:
        warnings.append(
            f"links that are drawn but have no <collision>, so that nothing is proven of them: {', '.join(bare)}"
        )
    if odd:
        warnings.append(
            f"links whose meshes do not fit the distances between the joints, in all {apart:.2g} m: {', '.join(odd)}; "
            "`scale` of their <mesh> takes the units of the file to metres"
        )
    return tuple(found), tuple(warnings)


def link_pieces(solids: Iterable[LinkSolid], model: pin.Model) -> tuple[LinkPiece, ...]:
    """The solids as collision pieces, placed in the frames of the model's joints."""
    found: list[LinkPiece] = []
    numbers: Counter[str] = Counter()
    for solid in solids:
        joint, T_joint_link = _body(model, solid.link)
        name = f"{solid.link}/{numbers[solid.link]}"
        found.append(LinkPiece(name, solid.link, joint, solid.piece_at(T_joint_link * solid.T_link_solid)))
        numbers[solid.link] += 1
    return tuple(found)


def _solids_of(urdf: Urdf, geometry: Geometry) -> list[_Solid]:
    if geometry.box is not None:
        return [_Solid(partial(box, geometry.box.size))]
    if geometry.sphere is not None:
        return [_Solid(partial(sphere, geometry.sphere.radius))]
    if geometry.cylinder is not None:
        return [_Solid(partial(cylinder, geometry.cylinder.radius, geometry.cylinder.length))]
    assert geometry.mesh is not None
    path = urdf.mesh_path(geometry.mesh.filename)
    if path is None:
        raise InputError("mesh file not found", found=geometry.mesh.filename)
    scale, T_shape_file = mesh_frame(path, _mesh_scale(geometry.mesh))
    cover = mesh_cover(path, scale, pieces=_PIECES_PER_LINK_MESH, excess=_LINK_HULL_EXCESS)
    size = float(np.ptp(np.vstack(cover.pieces), axis=0).max())
    return [
        _Solid(partial(convex, points, surface=surface), cover.cached, T_shape_file, size)
        for points, surface in zip(cover.pieces, cover.surfaces, strict=True)
    ]


def visuals_of(urdf: Urdf, model: pin.Model) -> tuple[Visual, ...]:
    """The shapes to draw of every link, placed in the frames of the model's joints."""
    colours = {material.name: material.color for material in urdf.robot.materials}
    found = []
    for link in urdf.robot.links:
        joint, T_joint_link = _body(model, link.name)
        for visual in link.visuals:
            geometry, material = visual.geometry, visual.material
            colour = None if material is None else material.color or colours.get(material.name)
            rgba = None if colour is None else tuple(map(float, colour.rgba))
            mesh = None
            if geometry.box is not None:
                kind, size = "box", geometry.box.size
            elif geometry.cylinder is not None:
                kind, size = "cylinder", np.array([geometry.cylinder.radius, geometry.cylinder.length])
            elif geometry.sphere is not None:
                kind, size = "sphere", np.array([geometry.sphere.radius])
            else:
                assert geometry.mesh is not None
                kind, size, mesh = "mesh", _mesh_scale(geometry.mesh), urdf.mesh_path(geometry.mesh.filename)
            placement, edges = T_joint_link * se3(visual.origin), tuple(map(float, size))
            found.append(Visual(link.name, joint, placement, kind, edges, mesh, rgba))
    return tuple(found)
