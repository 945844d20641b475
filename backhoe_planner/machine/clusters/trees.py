"""Trees of coal with thousands of cells: the distance of a convex shape from all of them at once.

A tree is queried with a reach, beyond which it does not search: nearby it takes tens
of microseconds. Some of coal's results for trees need correction, which is done here:

- The descent ends early only if `min_distance` of the result is set before.
- Normal and witness points run from the tree to the shape, whatever the order of the arguments.
- Coal puts an upright box around the shape in the frame of the query, which is large for a long link that
  is askew. So trees of cubes are queried in the frame of the shape, in which the box is as small as possible.
- If the shape touches a cell, `distance` gives the depth in the first cell it finds. All
  touched cells come from `collide`; the depth here is that of the deepest.
"""

from __future__ import annotations

from typing import NamedTuple

import coal
import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine.shape.shapes import LOOSER, in_doubt, prepare

_MOST_CONTACTS = 1_000_000  # cells that a shape touches at once; beyond any tree
_HERE = coal.Transform3s(np.eye(3), np.zeros(3))
LEAST_REACH = 1e-6  # m: so that contact is found at any reach
_DEEPEST = -1e7  # m: no two shapes are this deep inside each other


class Reading(NamedTuple):
    """A measured distance.

    Attributes
    ----------
    distance: signed [m].
    normal: (3,) unit vector from the first body to the second, also in penetration.
    point, other_point: (3,) the critical point of the first body, and its witness point on the second [m].
    """

    distance: float
    normal: Vector
    point: Vector
    other_point: Vector

    @classmethod
    def of_compiled(cls, found: tuple[Vector] | tuple[()] | None) -> tuple[bool, Reading | None]:
        """Whether a compiled function knows the distance, and the distance if there is one within its reach.

        found: (10,) all numbers of the reading; () if it takes coal, None if nothing is within reach.
        """
        if not found:
            return found is None, None
        numbers = found[0]
        return True, cls(float(numbers[0]), numbers[1:4], numbers[4:7], numbers[7:])


class Tree:
    """One tree of coal.

    Parameters
    ----------
    of_cubes: whether its cells are cubes, which coal compares with an upright box around a shape.
    most_touched: of so many cells that a shape touches the deepest is looked for.
    """

    def __init__(
        self, tree: coal.CollisionGeometry, *, of_cubes: bool = False, most_touched: int = _MOST_CONTACTS
    ) -> None:
        self._tree, self._of_cubes, self._most_touched = tree, of_cubes, most_touched

    def measure(self, shape: coal.CollisionGeometry, T_tree_shape: coal.Transform3s, reach: float) -> Reading | None:
        """The distance from `shape` to the cells if it is less than `reach` [m]; otherwise None.

        The result is in the frame of the tree, with its normal from the shape to the nearest cell.
        """
        reach = max(reach, LEAST_REACH)
        result = self._distance(shape, T_tree_shape, reach)
        distance = result.min_distance
        if distance >= reach:
            return None
        found = self._read(result, T_tree_shape, distance)
        if distance > 0.0 and not in_doubt(distance):
            return found
        deepest, touches = self._deepest(shape, T_tree_shape)
        if deepest is not None:
            return deepest
        if not touches:
            # nothing touches, but the iterations broke down, such as on a slender triangle of a wall
            for tolerance in LOOSER:
                result = self._distance(shape, T_tree_shape, reach, tolerance)
                if result.min_distance >= reach:
                    return None
                if result.min_distance > 2.0 * tolerance:
                    return self._read(result, T_tree_shape, result.min_distance - tolerance)
        # they touch to within rounding
        distance = 0.0 if in_doubt(distance) else distance
        normal = found.normal
        if not np.isfinite(normal).all() or abs(float(normal @ normal) - 1.0) > 1e-6:
            normal = np.array([0.0, 0.0, -1.0])
        middle = np.nan_to_num(found.other_point)
        return Reading(distance, normal, middle, middle)

    def depth(self, shape: coal.CollisionGeometry, T_tree_shape: coal.Transform3s) -> Reading | None:
        """The depth of `shape` in the deepest of the cells that it touches, as `measure`; None if it touches none."""
        return self._deepest(shape, T_tree_shape)[0]

    def _deepest(self, shape: coal.CollisionGeometry, T_tree_shape: coal.Transform3s) -> tuple[Reading | None, bool]:
        """`depth`, and whether the shape touches at all."""
        touch, contacts = coal.CollisionRequest(), coal.CollisionResult()
        touch.num_max_contacts, touch.enable_contact = self._most_touched, True
        coal.collide(self._tree, _HERE, shape, T_tree_shape, touch, contacts)
        deepest = None
        for contact in contacts.getContacts():
            depth = contact.penetration_depth
            if depth > _DEEPEST and (deepest is None or depth < deepest.penetration_depth):
                deepest = contact
        if deepest is None:
            return None, contacts.isCollision()
        return Reading(
            deepest.penetration_depth,
            -np.array(deepest.normal),
            np.array(deepest.getNearestPoint2()),
            np.array(deepest.getNearestPoint1()),
        ), True

    def _read(self, result: coal.DistanceResult, T_tree_shape: coal.Transform3s, distance: float) -> Reading:
        """The result of coal in the frame of the tree, with `distance` [m]."""
        normal, point, other_point = (
            np.array(found) for found in (-result.normal, result.getNearestPoint2(), result.getNearestPoint1())
        )
        if self._of_cubes:
            R, t = T_tree_shape.getRotation(), T_tree_shape.getTranslation()
            normal, point, other_point = R.dot(normal), R.dot(point) + t, R.dot(other_point) + t
        return Reading(distance, normal, point, other_point)

    def _distance(
        self, shape: coal.CollisionGeometry, T_tree_shape: coal.Transform3s, reach: float,
        tolerance: float | None = None,
    ) -> coal.DistanceResult:  # fmt: skip
        """The result of coal within a reach [m], to `tolerance` or the usual one [m]."""
        # not shared, because several threads use the same obstacles and the trees in them
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        prepare(request)
        if tolerance is not None:
            request.gjk_tolerance = request.epa_tolerance = tolerance
        result.min_distance = reach
        if self._of_cubes:
            coal.distance(self._tree, T_tree_shape.inverse(), shape, _HERE, request, result)
        else:
            coal.distance(self._tree, _HERE, shape, T_tree_shape, request, result)
        return result


def voxel_tree(centres: Matrix, edge: float) -> Tree:
    """A tree of cubes with an `edge` [m] around `centres` (n, 3), odd multiples of half an edge on each axis."""
    return Tree(coal.makeOctree(centres, edge), of_cubes=True)


def surface_tree(vertices: Matrix, triangles: Indices, *, most_touched: int = _MOST_CONTACTS) -> Tree:
    """A tree of triangles (m, 3) between `vertices` (k, 3) [m]; nothing is solid between them. See `Tree`."""
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(triangles), len(vertices))
    tree.addVertices(np.ascontiguousarray(vertices, dtype=float))
    tree.addTriangles(np.ascontiguousarray(triangles, dtype=np.uint32))
    tree.endModel()
    return Tree(tree, most_touched=most_touched)


def transform(rotation: Array, translation: Vector) -> coal.Transform3s:
    """T_tree_shape of `rotation` (3, 3) and `translation` (3,) [m]."""
    return coal.Transform3s(rotation, translation)
