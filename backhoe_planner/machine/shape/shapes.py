"""Convex collision shapes: the only place where coal is called to make them (trees of many are in `trees`).

A `Piece` is a convex shape at a placement on a body. It has points and a radius that
bound it, so that how far it can travel is computed without coal.
"""

from __future__ import annotations

import contextlib
import pickle
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar

import coal
import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.machine.shape.thinning import enclosing_corners, most_neighbours

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

_SIDES = 32  # of the prism around a cylinder: its corners are 1 / cos(pi / 32) = 1.0049 radii from the axis
_FLAT = 1e-6  # m, or part of the largest extent if that is more: Qhull cannot build hulls of thinner points
_THICKNESS = 1e-3  # m given to flat points; chosen, small compared with any clearance
_THICKNESS_OF_SIZE = 1e-5  # or this part of the largest extent, if that is more: ten times `_FLAT`
_FAR = 1e3  # largest extents from the origin: further away, too few digits are left for the shape
_DEEP = 1e5  # m: beyond any site, and small enough that a point at the surface is exact to 1e-11 m
_NONSENSE = -1e7  # m: no two shapes are this deep inside each other
CONTACT = 1e-9  # m: distances below this are measured again, see `measure_again`
_TOLERANCE = 1e-12  # m, of coal's iterations: tests compare gradients with differences over 1e-6 rad
LOOSER = (1e-10, 1e-9, 1e-6)  # m, tolerances tried in turn if the first result is in doubt
_ITERATIONS = 256  # at most: twice coal's default, for that tolerance
_NEIGHBOURS = 254  # of a corner: coal counts them in one byte, and reserves one of its values
_EXCESS = 1e-3  # part of the distance from the centroid; chosen: a fifth of that of the prism around a cylinder
_Result = TypeVar("_Result", bound=Any)


@dataclass(frozen=True)
class Piece:
    """A convex shape on a body.

    Attributes
    ----------
    shape: coal's object.
    placement: T_body_shape.
    hull: (k, 3) points [m] in the body's frame; the piece lies within `radius` of
        their convex hull. Empty for a half-space, which is unbounded.
    radius: [m].
    prism: whether `hull` is one rim of a right prism, counter-clockwise as seen from the other rim, followed by
        the other rim.
    make_inner: makes `inner`; None if that is the shape itself.
    """

    shape: coal.CollisionGeometry
    placement: pin.SE3
    hull: Matrix
    radius: float = 0.0
    prism: bool = False
    make_inner: Callable[[], coal.CollisionGeometry | None] | None = None

    @cached_property
    def pose(self) -> tuple[Matrix, Vector]:
        """(3, 3) and (3,) the placement as arrays [m]; kept because Pinocchio takes long to make them."""
        return np.array(self.placement.rotation), np.array(self.placement.translation)

    @cached_property
    def inner(self) -> coal.CollisionGeometry | None:
        """A shape at the same place that is nowhere larger than the shape as written, which the piece contains.

        For a mesh that is not convex it is the surface alone: something wholly inside does not touch it. None if
        no triangle of the mesh belongs to the piece.
        """
        return self.shape if self.make_inner is None else self.make_inner()

    def shape_as_bytes(self) -> bytes:
        """The shape without its placement: equal for equal shapes, also of another process; takes some 30 us."""
        return pickle.dumps(_unbounded(self.shape))

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled: all but the bounding box that the shape may have by now, which is unreadable if infinite."""
        kept = {name: value for name, value in self.__dict__.items() if name != "inner"}
        if "shape" in kept:
            kept["shape"] = _unbounded(self.shape)
        return kept


def _unbounded(shape: coal.CollisionGeometry) -> coal.CollisionGeometry:
    """A copy without the bounding box that coal gives a shape at the first query that needs one."""
    found, new = shape.clone(), coal.Sphere(1.0)
    found.aabb_local, found.aabb_center, found.aabb_radius = new.aabb_local, new.aabb_center, new.aabb_radius
    return found


def _piece(
    shape: coal.CollisionGeometry,
    placement: pin.SE3,
    points: Matrix,
    *,
    radius: float = 0.0,
    prism: bool = False,
    make_inner: Callable[[], coal.CollisionGeometry | None] | None = None,
) -> Piece:
    """A piece bounded by balls of `radius` around `points` (k, 3) [m] in the shape's frame."""
    hull = points @ placement.rotation.T + placement.translation
    hull.setflags(write=False)
    return Piece(shape=shape, placement=placement, hull=hull, radius=radius, prism=prism, make_inner=make_inner)


def box(size: Vector, placement: pin.SE3) -> Piece:
    """A box with the edge lengths `size` (3,) [m] along its own axes, centred at `placement` T_body_box."""
    edges = np.asarray(size, dtype=float)
    return _piece(coal.Box(*edges.tolist()), placement, 0.5 * edges * _CORNERS_OF_PRISM, prism=True)


class LateBox(Piece):
    """A box whose coal object is made at its first use, because most boxes around cells never need one.

    edges, R, t and hull are as for `box`.

    Parameters
    ----------
    edges: (3,) its edge lengths [m]; R, t: (3, 3), (3,) T_body_box [m].
    hull: (8, 3) its corners in the body's frame, in the order of `box` [m].
    """

    edges: Vector

    def __init__(self, edges: Vector, R: Matrix, t: Vector, hull: Matrix) -> None:
        self.__dict__.update(edges=edges, pose=(R, t), hull=hull)

    @cached_property
    def shape(self) -> coal.CollisionGeometry:
        """Coal's object."""
        return coal.Box(*self.edges.tolist())

    @cached_property
    def placement(self) -> pin.SE3:
        """T_body_shape."""
        return pin.SE3(*self.pose)


def sphere(radius: float, placement: pin.SE3) -> Piece:
    """A sphere of `radius` [m] about its frame's origin, at `placement` T_body_sphere."""
    return _piece(coal.Sphere(float(radius)), placement, np.zeros((1, 3)), radius=float(radius))


def capsule(radius: float, length: float, placement: pin.SE3) -> Piece:
    """All points within `radius` [m] of a segment of `length` [m] along z, centred at `placement` T_body_capsule."""
    ends = np.array([[0.0, 0.0, -length / 2.0], [0.0, 0.0, length / 2.0]])
    return _piece(coal.Capsule(float(radius), float(length)), placement, ends, radius=float(radius))


def cylinder(radius: float, length: float, placement: pin.SE3) -> Piece:
    """A cylinder of `radius` [m] and `length` [m] along z, centred at `placement` T_body_cylinder.

    It is measured as the regular prism of 32 sides around it, which is larger by at most
    0.49 % of the radius. On a round rim coal's iterations do not reach the precision that
    gradients need, and in penetration they may not converge; on a polytope they terminate.
    """
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    around = radius / np.cos(np.pi / _SIDES)
    rim = np.column_stack((around * np.cos(angle), around * np.sin(angle)))
    ends = [np.column_stack((rim, np.full(_SIDES, z))) for z in (-length / 2.0, length / 2.0)]
    points = np.vstack(ends)
    if is_flat(points):
        return convex(points, placement)
    low = np.arange(_SIDES)
    following, high = np.roll(low, -1), low + _SIDES
    sides = [np.column_stack((low, following, high[following])), np.column_stack((low, high[following], high))]
    fans = [np.column_stack((0 * low, following, low)), np.column_stack((0 * low + _SIDES, high, high[following]))]
    triangles = np.vstack((*sides, *(fan[1:-1] for fan in fans)))
    narrow = np.cos(np.pi / _SIDES)
    within = points * [narrow, narrow, 1.0]
    inner = partial(_polytope, within, triangles)
    return _piece(_polytope(points, triangles), placement, points, prism=True, make_inner=inner)


def convex(
    points: Matrix, placement: pin.SE3, *, surface: Matrix | None = None, around: ConvexHull | None = None
) -> Piece:
    """The convex hull of `points` (k, 3) [m] in the frame at `placement` T_body_hull; flat ones are thickened.

    If a corner has more neighbours than coal can count, such as the tip of a cone of 300 sides, the piece
    is a polytope with fewer faces around the hull, which sticks out of the hull by at most 0.1 % of the
    distance from the centroid.

    Parameters
    ----------
    surface: (m, 3, 3) triangles in that frame [m], if the hull is larger than what it contains; may be empty.
    around: the hull of the points if it is known: of 160,000 points it takes 2 s.
    """
    points = np.asarray(points, dtype=float)
    centre = points.mean(axis=0)
    if np.linalg.norm(centre) > _FAR * np.max(np.ptp(points, axis=0)):
        points, placement = points - centre, placement * pin.SE3(np.eye(3), centre)
        surface = None if surface is None else surface - centre
        around = None
    exact = hull(points) if around is None else around
    around = _countable(exact)
    if surface is None and around is not exact:
        surface = exact.points[exact.simplices]
    inner = None if surface is None else partial(_surface, surface)
    numbers = np.full(len(around.points), -1)
    numbers[around.vertices] = np.arange(len(around.vertices))
    edges = around.points[around.simplices[:, 1:]] - around.points[around.simplices[:, :1]]
    inward = np.einsum("ij,ij->i", np.cross(edges[:, 0], edges[:, 1]), around.equations[:, :3]) < 0.0
    triangles = numbers[np.where(inward[:, None], around.simplices[:, ::-1], around.simplices)]
    # coal could build the hull itself, but ends the process if Qhull reports an error
    return _piece(_polytope(around.points[around.vertices], triangles), placement, around.points, make_inner=inner)


def _polytope(points: Matrix, triangles: Array) -> coal.Convex:
    """Coal's shape with corners `points` (k, 3) [m] and `triangles` (m, 3) of their numbers, seen from outside."""
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in points:
        corners.append(point)
    for a, b, c in triangles.tolist():
        faces.append(coal.Triangle(a, b, c))
    return coal.Convex(corners, faces)


def surface_of(piece: Piece) -> Matrix | None:
    """(m, 3, 3) the triangles of the mesh around which a piece was made, in its shape's frame [m]; otherwise None."""
    make = piece.make_inner
    return make.args[0] if isinstance(make, partial) and make.func is _surface else None


def _surface(triangles: Matrix) -> coal.CollisionGeometry | None:
    """Coal's shape of triangles (m, 3, 3) [m] with nothing inside; None without triangles."""
    if not len(triangles):
        return None
    found = coal.BVHModelOBBRSS()
    corners = np.ascontiguousarray(triangles.reshape(-1, 3))
    found.beginModel(len(triangles), len(corners))
    found.addVertices(corners)
    found.addTriangles(np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    found.endModel()
    return found


def _countable(around: ConvexHull) -> ConvexHull:
    """A hull, or, if a corner has too many neighbours, one with fewer faces that contains it."""
    found, excess = around, _EXCESS
    while len(found.vertices) > _NEIGHBOURS and most_neighbours(found) > _NEIGHBOURS:
        found = hull(enclosing_corners(around, excess))
        excess *= 2.0
    return found


def cube(edge: float) -> coal.CollisionGeometry:
    """Coal's object of a cube with an `edge` [m] around its frame's origin."""
    return coal.Box(edge, edge, edge)


def thin_triangle(corners: Matrix) -> coal.CollisionGeometry:
    """Coal's object of a triangle with `corners` (3, 3) [m]; no hull is built, because thousands of them are made."""
    points = coal.StdVec_Vec3s()
    for point in corners:
        points.append(point)
    return coal.Convex(points, _BOTH_SIDES)


_BOTH_SIDES = coal.StdVec_Triangle()
_BOTH_SIDES.append(coal.Triangle(0, 1, 2))
_BOTH_SIDES.append(coal.Triangle(0, 2, 1))


def is_flat(points: Matrix) -> bool:
    """Whether `points` (k, 3) [m] are so nearly in one plane, line or point that no hull can be built of them."""
    extents = np.ptp(points @ _axes(points).T, axis=0)
    return len(points) < 4 or bool(np.min(extents) < flatness(float(np.max(extents))))


def flatness(extent: float) -> float:
    """The thickness below which points with the largest `extent` count as flat, both [m]."""
    return _FLAT * max(1.0, extent)


def thicken(points: Matrix, *, thickness: float = _THICKNESS) -> Matrix:
    """(c, 3) corners of the flat prism, or of the thin box, around flat `points` (k, 3) [m].

    In each direction in which the points are flat, it has a `thickness` [m], by default one millimetre, or
    1e-5 of their largest extent if that is more.
    """
    axes = _axes(points)
    along = points @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    thickness = max(thickness, _THICKNESS_OF_SIZE * float(np.max(high - low)))
    thin = high - low < thickness
    low, high = np.where(thin, low - 0.5 * thickness, low), np.where(thin, high + 0.5 * thickness, high)
    outline = None if np.count_nonzero(thin) > 1 else _outline(along[:, ~thin])
    if outline is None:
        return _box_corners(low, high) @ axes
    prism = np.empty((2 * len(outline), 3))
    prism[:, ~thin] = np.tile(outline, (2, 1))
    prism[:, thin] = np.repeat([low[thin], high[thin]], len(outline), axis=0)
    return prism @ axes


def _axes(points: Matrix) -> Matrix:
    """(3, 3) the principal axes of points (k, 3), one in each row."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=len(points) < 3)[2])


def _outline(points: Matrix) -> Matrix | None:
    """(c, 2) corners of the convex hull of points (k, 2) in order; None if it cannot be built."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return None


def _box_corners(low: Vector, high: Vector) -> Matrix:
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


# corners of a cube with half edges of 1, in the order of `Piece.prism`
_CORNERS_OF_PRISM = _box_corners(-np.ones(3), np.ones(3))[[0, 4, 6, 2, 1, 5, 7, 3]]


def hull(points: Matrix) -> ConvexHull:
    """The convex hull of `points` (k, 3) [m]; flat ones are thickened, and those that Qhull rejects are rounded."""
    from scipy.spatial import ConvexHull, QhullError

    if is_flat(points):
        points = thicken(points)
    size = float(np.max(np.ptp(points, axis=0)))
    centre = points.mean(axis=0)
    for merged_within in (0.0, 1e-9 * size, 1e-7 * size):
        apart = points
        if merged_within:  # Qhull fails on points that nearly coincide
            apart = centre + merged_within * np.unique(np.round((points - centre) / merged_within), axis=0)
        with contextlib.suppress(QhullError):
            return ConvexHull(apart)
    axes = _axes(points)
    along = points @ axes.T
    return ConvexHull(_box_corners(along.min(axis=0), along.max(axis=0)) @ axes)


def moved(piece: Piece, T: pin.SE3) -> Piece:
    """The same piece in another frame; `T` maps the piece's frame into it."""
    hull = piece.hull @ T.rotation.T + T.translation
    return replace(piece, placement=T * piece.placement, hull=hull)


def halfspace(point: Vector, normal: Vector) -> Piece:
    """Solid where (x - point) . normal < 0: `point` (3,) [m] on its face, `normal` (3,) the unit vector out of it."""
    shape = coal.Halfspace(np.asarray(normal, dtype=float), float(np.dot(normal, point)))
    return Piece(shape=shape, placement=pin.SE3.Identity(), hull=np.zeros((0, 3)))


def transform(rotation: Matrix, translation: Vector) -> coal.Transform3s:
    """T_world_shape for coal, of `rotation` (3, 3) and `translation` (3,) [m]."""
    return coal.Transform3s(rotation, translation)


def prepare(request: coal.DistanceRequest) -> None:
    """Set a `request` so that coal iterates until distances are right to 1e-12 m."""
    request.gjk_max_iterations = request.epa_max_iterations = _ITERATIONS
    request.gjk_tolerance = request.epa_tolerance = _TOLERANCE


def within(first: Piece, T_first: pin.SE3, second: Piece, T_second: pin.SE3, margin: float) -> bool:
    """Whether the inner shapes of two pieces, at T_first and T_second in one frame, are within `margin` [m]."""
    if first.inner is None or second.inner is None:
        return False
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.security_margin = margin
    T_1, T_2 = (transform(T.rotation, T.translation) for T in (T_first, T_second))
    return bool(coal.collide(first.inner, T_1, second.inner, T_2, request, result))


def faces_of(piece: Piece) -> Vector:
    """(15,) the axes (3, 3) of a piece that is a box, its middle (3,) and half edges (3,), in the body's frame [m].

    A half-space is a box that extends beyond any site. For pieces of other shapes the numbers are nan.
    """
    shape = piece.shape
    if isinstance(shape, coal.Halfspace):
        normal, level = np.array(shape.n), float(shape.d)
        axes = np.linalg.svd(normal[:, None])[0]
        axes[:, 0] = normal
        return np.concatenate((axes.reshape(-1), (level - _DEEP) * normal, (_DEEP, np.inf, np.inf)))
    if not isinstance(shape, coal.Box):
        return np.full(15, np.nan)
    R, t = piece.pose
    return np.concatenate((R.reshape(-1), t, shape.halfSide))


def in_doubt(distance: Any) -> Any:
    """Whether to measure a `distance` [m] again, a number or an array: it is near 0, absurdly deep, or nan."""
    return (abs(distance) <= CONTACT) | (distance <= _NONSENSE) | (distance != distance)


def rows_in_doubt(distances: Vector) -> list[int]:
    """Which of many distances (K,) to measure again; see `in_doubt`."""
    if len(distances) == 0 or distances[distances.argmin()] > CONTACT:  # the common case first; nan counts as least
        return []
    found: list[int] = in_doubt(distances).nonzero()[0].tolist()
    return found


def measure(model: pin.GeometryModel, geometry: pin.GeometryData, index: int) -> Any:
    """Coal's result for one pair of a geometry model, at the present placements."""
    result = pin.computeDistance(model, geometry, index)
    distance = result.min_distance
    if distance > CONTACT or not in_doubt(distance):  # the common case first: this is called millions of times
        return result
    return measure_pair_again(model, geometry, index)


def measure_distances(model: pin.GeometryModel, geometry: pin.GeometryData, pairs: Iterable[int]) -> list[float]:
    """The signed distances of some pairs, at the present placements [m]."""
    distances, compute = [], pin.computeDistance
    for index in pairs:
        distance = compute(model, geometry, index).min_distance
        if not distance > CONTACT and in_doubt(distance):
            distance = measure_pair_again(model, geometry, index).min_distance
        distances.append(distance)
    return distances


def measure_pair_again(model: pin.GeometryModel, geometry: pin.GeometryData, index: int) -> Any:
    """Coal's result for one pair at looser tolerances, if the first result is in doubt; see `measure_again`."""
    return measure_again(geometry.distanceRequests[index], lambda: pin.computeDistance(model, geometry, index))


def measure_again(request: coal.DistanceRequest, measure: Callable[[], _Result]) -> _Result:
    """The result of `measure`, which calls coal with `request`, at looser tolerances.

    If faces are flush to within the tolerance, coal's iterations can end early: with an
    infinite depth, or with a distance of 1e-12 m between boxes that are half a metre
    inside each other. If looser tolerances give no depth either, the shapes touch to within
    rounding, and the distance is 0.
    """
    try:
        for tolerance in LOOSER:
            request.gjk_tolerance = request.epa_tolerance = tolerance
            result = measure()
            if result.min_distance > _NONSENSE:
                return result
    finally:
        request.gjk_tolerance = request.epa_tolerance = _TOLERANCE
    result.min_distance = 0.0
    return result


class Gauge:
    """Signed distances between single pairs of shapes, without a geometry model around them.

    It owns its working memory: do not share one between threads.
    """

    def __init__(self) -> None:
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        prepare(self._request)

    def measure(
        self,
        first: coal.CollisionGeometry,
        T_first: coal.Transform3s,
        second: coal.CollisionGeometry,
        T_second: coal.Transform3s,
    ) -> tuple[float, Vector, Vector, Vector]:
        """Signed distance [m], unit normal from the first to the second, and both witness points (3,) [m], world.

        Parameters
        ----------
        first, second: coal's shapes.
        T_first, T_second: T_world_shape of each, from `transform`.
        """

        def measure() -> coal.DistanceResult:
            self._result.clear()
            coal.distance(first, T_first, second, T_second, self._request, self._result)
            return self._result

        result = measure()
        distance = result.min_distance
        if not distance > CONTACT and in_doubt(distance):
            result = measure_again(self._request, measure)
            distance = result.min_distance
        # copies: coal's own memory is overwritten by the next measurement
        return (
            distance,
            np.array(result.normal),
            np.array(result.getNearestPoint1()),
            np.array(result.getNearestPoint2()),
        )
