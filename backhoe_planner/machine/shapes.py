"""Convex collision shapes: the one place where coal is called to make them.

A `Piece` is a convex shape at a place on a body. It knows points and a radius that
bound it, so that how far it can travel is computed without asking coal.
"""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

__all__ = ["Piece", "box", "capsule", "convex", "cylinder", "halfspace", "sphere"]

Vector = NDArray[np.float64]

_SIDES = 32


@dataclass(frozen=True)
class Piece:
    """A convex shape on a body.

    Attributes
    ----------
    shape: coal's object.
    placement: T_body_shape.
    hull: (k, 3) points [m] in the body's frame; the piece lies within `radius` of
        their convex hull. Empty for a half-space, which has no bound.
    radius: [m].
    """

    shape: coal.CollisionGeometry
    placement: pin.SE3
    hull: Vector
    radius: float = 0.0


def _piece(shape: coal.CollisionGeometry, placement: pin.SE3, points: Vector, radius: float = 0.0) -> Piece:
    hull = points @ placement.rotation.T + placement.translation
    hull.setflags(write=False)
    return Piece(shape=shape, placement=placement, hull=hull, radius=radius)


def box(size: Vector, placement: pin.SE3) -> Piece:
    """A box of full edge lengths `size` (3,) [m], centred on its frame."""
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return _piece(coal.Box(*(float(edge) for edge in size)), placement, signs * np.asarray(size, dtype=float))


def sphere(radius: float, placement: pin.SE3) -> Piece:
    """A sphere about its frame's origin [m]."""
    return _piece(coal.Sphere(float(radius)), placement, np.zeros((1, 3)), float(radius))


def capsule(radius: float, length: float, placement: pin.SE3) -> Piece:
    """All points within `radius` of a segment of `length` along z, centred [m]."""
    ends = np.array([[0.0, 0.0, -length / 2.0], [0.0, 0.0, length / 2.0]])
    return _piece(coal.Capsule(float(radius), float(length)), placement, ends, float(radius))


def cylinder(radius: float, length: float, placement: pin.SE3) -> Piece:
    """A cylinder of full `length` along z, centred [m].

    Measured as the regular prism of 32 sides around it, which is at most 0.49 % of
    the radius larger: coal's iterations on a round rim stop short of the precision
    that gradients need (and in penetration may not converge), on a polytope they end.
    """
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    around = radius / np.cos(np.pi / _SIDES)
    rim = np.column_stack((around * np.cos(angle), around * np.sin(angle)))
    ends = [np.column_stack((rim, np.full(_SIDES, z))) for z in (-length / 2.0, length / 2.0)]
    return convex(np.vstack(ends), placement)


def convex(points: Vector, placement: pin.SE3) -> Piece:
    """The convex hull of (k, 3) points [m] in the piece's frame."""
    corners = coal.StdVec_Vec3s()
    for point in np.asarray(points, dtype=float):
        corners.append(point)
    return _piece(coal.Convex.convexHull(corners, True, "Qt"), placement, np.asarray(points, dtype=float))


def halfspace(point: Vector, normal: Vector) -> Piece:
    """Solid where (x - point) . normal < 0; `normal` is a unit vector."""
    shape = coal.Halfspace(np.asarray(normal, dtype=float), float(np.dot(normal, point)))
    return Piece(shape=shape, placement=pin.SE3.Identity(), hull=np.zeros((0, 3)))
