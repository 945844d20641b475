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

__all__ = ["Gauge", "Piece", "box", "capsule", "convex", "cylinder", "halfspace", "sphere", "transform"]

Vector = NDArray[np.float64]

_SIDES = 32
_NONSENSE = -1e7  # m: no two shapes are this deep inside each other
_CONTACT = 1e-9  # m: nearer to touching than this, coal's first answer is not believed
_TOLERANCE = 1e-12  # of coal's iterations [m]


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


def transform(rotation: Vector, translation: Vector) -> coal.Transform3s:
    """T_world_shape as coal wants it, of rotation (3, 3) and translation (3,) [m]."""
    return coal.Transform3s(rotation, translation)


class Gauge:
    """Signed distances between single pairs of shapes, without a geometry model around them.

    It owns its working memory: do not share one between threads.
    """

    def __init__(self) -> None:
        self._request = coal.DistanceRequest()
        self._request.gjk_max_iterations = self._request.epa_max_iterations = 256
        self._set_tolerance(_TOLERANCE)
        self._result = coal.DistanceResult()

    def measure(
        self,
        first: coal.CollisionGeometry,
        T_first: coal.Transform3s,
        second: coal.CollisionGeometry,
        T_second: coal.Transform3s,
    ) -> tuple[float, Vector, Vector, Vector]:
        """Signed distance [m], unit normal from the first to the second, and both witness points (3,).

        Where coal's iterations end without an answer, they are run again with a looser
        tolerance; if that gives no depth either, the shapes touch to within rounding,
        and 0 is said.
        """
        result = self._result
        result.clear()
        distance = coal.distance(first, T_first, second, T_second, self._request, result)
        if not (distance > _CONTACT or _NONSENSE < distance < -_CONTACT):
            distance = self._measure_again(first, T_first, second, T_second)
        # copies: coal's own memory is overwritten by the next measurement
        return (
            distance,
            np.array(result.normal),
            np.array(result.getNearestPoint1()),
            np.array(result.getNearestPoint2()),
        )

    def _measure_again(
        self,
        first: coal.CollisionGeometry,
        T_first: coal.Transform3s,
        second: coal.CollisionGeometry,
        T_second: coal.Transform3s,
    ) -> float:
        try:
            for tolerance in (1e-10, 1e-9, 1e-6):
                self._set_tolerance(tolerance)
                self._result.clear()
                distance = float(coal.distance(first, T_first, second, T_second, self._request, self._result))
                if distance > _NONSENSE:
                    return distance
        finally:
            self._set_tolerance(_TOLERANCE)
        return 0.0

    def _set_tolerance(self, tolerance: float) -> None:
        self._request.gjk_tolerance = self._request.epa_tolerance = tolerance
