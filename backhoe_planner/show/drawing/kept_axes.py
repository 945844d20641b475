"""The axis of the tip that a `tilt` of `keep` keeps, as an arrow, and where it may point, as a cone.

The arrow is fixed to the link that holds the tip. The cone stands still in its direction of the world and follows the
tip's position, so that the arrow leaves it where the condition is broken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.motion import Problem, TiltCone
from backhoe_planner.show.drawing.solids import Facets, facets, tube

_LENGTH = 1.3  # of the arrow, in the picture's scale; chosen, longer than a gripper from which it begins
_THICK = 0.018  # radius of the arrow, likewise; chosen, no thicker than the rods of critical points
_HEAD, _HEAD_WIDTH = 0.2, 3.0  # length of its head as a part of the arrow, and radius in radii of the arrow; chosen
_CONE = 0.85  # length of the cone as a part of the arrow; chosen, so that the head stands out
_AROUND = 48  # sides of the cone; chosen, it looks round
_WIDEST = 0.95 * np.pi  # rad of tolerance from which on no cone is drawn: nearly every direction is allowed


@dataclass(frozen=True, eq=False)
class KeptAxis:
    """The drawing of an axis that is kept.

    Attributes
    ----------
    legs: names of the legs in which it is kept; None if it is along the whole motion.
    joint: index of the Pinocchio joint that moves the tip.
    arrow: triangles in the frame of that joint [m].
    cone: triangles around the tip, with the axes of the world [m]; None if nearly every direction is allowed.
    """

    legs: tuple[str, ...] | None
    joint: int
    arrow: Facets
    cone: Facets | None

    def kept_in(self, legs: tuple[str, ...]) -> Flags:
        """(F,) whether the axis is kept in each of these legs."""
        return np.array([self.legs is None or leg in self.legs for leg in legs], dtype=bool)


def kept_axes(problem: Problem, scale: float) -> tuple[KeptAxis, ...]:
    """The drawings of all axes that a problem keeps; legs that keep the same share one.

    scale: of the picture [m].
    """
    found: dict[tuple[float, ...], tuple[TiltCone, list[str]]] = {}
    for part in problem.legs or (problem,):
        for cone in () if part.keep is None else part.keep.cones:
            if isinstance(cone, TiltCone):
                key = (*cone.tilt.axis.tolist(), *cone.tilt.direction.tolist(), cone.usable)
                found.setdefault(key, (cone, []))[1].append(part.name)
    frame = problem.robot.model.frames[problem.robot.tip_frame]
    turn, tip, length = frame.placement.rotation, frame.placement.translation, _LENGTH * scale
    return tuple(
        KeptAxis(
            legs=tuple(legs) if problem.legs else None,
            joint=int(frame.parentJoint),
            arrow=facets(_arrow(np.array(tip), turn @ cone.tilt.axis, length, _THICK * scale)),
            cone=_cone(cone.tilt.direction, cone.usable, _CONE * length),
        )
        for cone, legs in found.values()
    )


def _arrow(begin: Vector, direction: Vector, length: float, radius: float) -> trimesh.Trimesh:
    """An arrow from a place (3,) along a unit vector (3,)."""
    neck = begin + (1.0 - _HEAD) * length * direction
    shaft = tube(np.array([begin, neck]), radius, tolerance=0.0)
    head = trimesh.creation.cone(radius=_HEAD_WIDTH * radius, height=_HEAD * length, sections=16)
    turn = trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction)
    turn[:3, 3] = neck
    return trimesh.util.concatenate([shaft, head.apply_transform(turn)])


def _cone(direction: Vector, tolerance: float, length: float) -> Facets | None:
    """The surface of all lines of a length [m] at the angle `tolerance` [rad] from a unit vector (3,)."""
    if tolerance > _WIDEST:
        return None
    around = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    circle = np.column_stack((np.cos(around), np.sin(around), np.zeros(_AROUND)))
    rim: Matrix = np.sin(tolerance) * circle + [0.0, 0.0, np.cos(tolerance)]
    rim = length * rim @ trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction)[:3, :3].T
    index = np.arange(_AROUND)
    faces = np.column_stack((np.zeros(_AROUND, dtype=int), 1 + index, 1 + np.roll(index, -1)))
    return facets(trimesh.Trimesh(np.vstack((np.zeros(3), rim)), faces, process=False))
