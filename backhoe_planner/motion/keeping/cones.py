"""Conditions on the orientation of the tip, or of an axis of it: cones, in which no random configuration lies.

Orientation. The tip turns by at most L = sum_j |dq_j| over the hinges, so if its ends are at the
angles e_a, e_b from the required orientation, the angle is nowhere more than (e_a + e_b + L) / 2.
There is a better bound for short motions. The angular velocity sum_j dq_j a_j changes by at most
K = sum_{i<j} |dq_i| |dq_j|, so the orientation is nowhere further than K / 8 from a turn about
a fixed axis, and neither are its ends. That turn is a geodesic shorter than half a turn. On it
the angle from the required orientation is nowhere more than at the ends, if these are less than a
quarter turn away (balls of that radius are convex). So it is at most max(e_a, e_b) + K / 4.

Tilt. An axis u of the tip turns by at most L too, so the same first bound holds. As |u''| <= L^2, u is nowhere further
than L^2 / 8 from its chord. So its component along the direction d, cos(e), is at least the least of the ends less
L^2 / 8. Its component across d, sin(e), is convex in u, so that it is at most the greatest of the ends plus L^2 / 8,
which is the better bound for small angles, as long as e is below a quarter turn. First hinges that are parallel to d
and last hinges that are parallel to u do not change the angle, so they do not count.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import (
    BatchKinematics,
    Robot,
    TargetBatch,
    Tilt,
    TiltBatch,
    TipTarget,
    rotation_vectors,
    tilt_angles,
    tilt_turns,
)
from backhoe_planner.motion.keeping.conditions import KEPT_TO, UPRIGHT, Condition, reduction_beside, reduction_text

_MOST_DIGITS = 6  # of an angle in degrees; chosen: more is below what a condition may be missed by
_NO_LENGTH = 1e-12  # rad: a shorter turn has no direction
_EIGHTHS = 0.25 * np.pi * np.arange(8)
_OCTAGON: Matrix = np.column_stack((np.cos(_EIGHTHS), np.sin(_EIGHTHS)))


class Cone(Condition):
    """An angle of the tip's orientation is at most `tolerance` [rad].

    No random configuration is within a narrow cone by chance: whatever looks for configurations narrows its targets.

    Attributes
    ----------
    usable: what the tracking error leaves of the tolerance [rad].
    turning: (n,) 1 for joints that change the angle, 0 for the others.
    """

    unit = "rad"

    def __init__(self, robot: Robot, tolerance: float, turning: Vector) -> None:
        self.tolerance, self.turning = tolerance, turning
        self.room = 0.0 if robot.tube is None else float(turning @ robot.tube.joints)
        self.usable = max(tolerance - self.room, 0.0)
        self._batch = BatchKinematics(robot)

    @abstractmethod
    def angles(self, rotations: Array) -> Vector:
        """(B,) the angle at orientations of the tip (B, 3, 3) [rad]."""

    @abstractmethod
    def turns(self, rotations: Array) -> Array:
        """(B, 3) the rotation vectors in world axes that bring the tip into the middle of the cone [rad]."""

    @abstractmethod
    def narrowed(self, target: TipTarget, tolerance: float) -> TipTarget | None:
        """The target within the cone, or within as much of it as `tolerance` [rad]; itself if it cannot express it.

        None if an orientation of the target with its tolerance is nowhere within that.
        """

    @abstractmethod
    def narrowed_batch(self, targets: TargetBatch, tolerance: float | Vector) -> TargetBatch:
        """The targets, those without an orientation within `tolerance` [rad], also (B,); a pitch is required still."""

    def values(self, q: Matrix) -> Vector:
        """(B,) the angle [rad]."""
        return self.angles(self._batch.at(q).tip_rotation)

    def margins(self, values: Vector) -> Vector:
        """(B,) [rad]"""
        return np.asarray(self.tolerance - self.room - values)

    def lever(self, travel: Vector) -> Vector:
        """(n,) [rad/rad]"""
        return self.turning

    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """One margin; its gradient is 0 exactly in the middle of the cone."""
        at = self._batch.at(q)
        turns = self.turns(at.tip_rotation)
        angles = np.linalg.norm(turns, axis=1)
        axes = turns / np.where(angles > 0.0, angles, 1.0)[:, None]
        return self.margins(angles)[:, None], axes[:, None, :] @ at.rotation_jacobian()

    def facets(self, q: Matrix) -> tuple[Matrix, Array]:
        """Margins in several directions, the first of which is that of `rows`: planes around the cone.

        The single row of a configuration only limits steps away from the middle of the cone. Steps along the edge of a
        narrow cone, or from its middle, lead out of it as well.
        """
        at = self._batch.at(q)
        turns = self.turns(at.tip_rotation)
        directions = self._directions(turns)
        margins = self.tolerance - self.room - np.einsum("bkj,bj->bk", directions, turns)
        return margins, directions @ at.rotation_jacobian()

    @abstractmethod
    def _directions(self, turns: Array) -> Array:
        """(B, K, 3) unit vectors in all directions of `turns` (B, 3), the first along these, in world axes."""

    @property
    def allowed(self) -> str:
        """``5 deg``"""
        return f"{np.degrees(self.tolerance):.4g} deg{reduction_text(self)}"

    def _shown(self, value: float) -> tuple[str, str]:
        """An angle and what is allowed [deg]."""
        degrees = np.degrees([value, self.usable]).tolist()
        # so many digits that a tenth of a narrow cone shows
        digits = 1 if degrees[1] <= 0.0 else min(max(math.ceil(1.0 - math.log10(degrees[1])), 1), _MOST_DIGITS)
        rounding = float(np.degrees(KEPT_TO))
        angle, shown = beside_bounds(*degrees, places=f".{digits}f", bounds_as=".4g", rounding=rounding)
        return angle, shown


class RotationCone(Cone):
    """The tip is turned by at most `tolerance` [rad] from `rotation` (3, 3)."""

    name = "rotation"

    def __init__(self, robot: Robot, rotation: Matrix, tolerance: float) -> None:
        super().__init__(robot, tolerance, np.where(robot.prismatic, 0.0, 1.0))
        self.rotation = rotation

    def angles(self, rotations: Array) -> Vector:
        """(B,) angle of orientations of the tip (B, 3, 3) from the one to be kept [rad]."""
        turn = self.rotation @ np.swapaxes(rotations, 1, 2)
        sines = np.linalg.norm([turn[:, i, j] - turn[:, j, i] for i, j in ((1, 0), (2, 0), (2, 1))], axis=0)
        return np.asarray(np.arctan2(sines, np.trace(turn, axis1=1, axis2=2) - 1.0))

    def narrowed(self, target: TipTarget, tolerance: float) -> TipTarget | None:
        """The target; one without an exact orientation or a pitch within `tolerance` [rad] of the one to be kept.

        Of two balls of orientations, a ball that is in both: its middle is on the shortest turn between their middles.
        """
        if target.pitch is not None or (target.rotation is not None and target.rotation_tolerance == 0.0):
            return target
        if target.rotation is None:
            return replace(target, rotation=self.rotation, rotation_tolerance=tolerance)
        turn = rotation_vectors((self.rotation @ target.rotation.T)[None])[0]
        angle, own = float(np.linalg.norm(turn)), target.rotation_tolerance
        radius = min(0.5 * (own + tolerance - angle), own, tolerance)
        if radius < 0.0:
            return None
        part = min(max(own - radius, 0.0) / max(angle, _NO_LENGTH), 1.0)
        return replace(target, rotation=pin.exp3(part * turn) @ target.rotation, rotation_tolerance=radius)

    def narrowed_batch(self, targets: TargetBatch, tolerance: float | Vector) -> TargetBatch:
        """The targets, those without an orientation within `tolerance` [rad], also (B,), of the one to be kept."""
        open_ = ~targets.has_rotation
        return replace(
            targets,
            rotation=np.where(open_[:, None, None], self.rotation, targets.rotation),
            has_rotation=np.ones(len(targets), dtype=bool),
            rotation_tolerance=np.where(open_, tolerance, targets.rotation_tolerance),
        )

    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) [rad]"""
        angle = np.abs(delta) * self.turning
        whole = angle.sum(axis=1)
        bending = 0.5 * (whole**2 - np.square(angle).sum(axis=1))
        worst = np.maximum(before, after) + 0.25 * bending
        short = (worst < 0.5 * np.pi) & (whole < np.pi)
        bound = 0.5 * (before + after + whole)
        return self.margins(np.where(short, np.minimum(worst, bound), bound))

    def turns(self, rotations: Array) -> Array:
        """(B, 3) the rotation vectors to the orientation to be kept [rad], world."""
        return rotation_vectors(self.rotation @ np.swapaxes(rotations, 1, 2))

    def _directions(self, turns: Array) -> Array:
        """Along the axes of a cube."""
        along = _unit(turns, np.array([0.0, 0.0, 1.0]))
        beside = _unit(np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=1)]), along)
        axes = np.stack((along, beside, np.cross(along, beside)), axis=1)
        return np.concatenate((axes, -axes), axis=1)

    def widened(self, robot: Robot, by: float) -> RotationCone:
        """A wider cone."""
        return RotationCone(robot, self.rotation, self.tolerance + by)

    def describe(self, value: float, when: str = "") -> str:
        """``the tip is turned by 12.0 deg from the orientation to be kept at 2.40 s, allowed 5 deg``"""
        angle, shown = self._shown(value)
        words = f"the tip is turned by {angle} deg from the orientation to be kept{when}, allowed {shown} deg"
        return words + reduction_beside(self)


class TiltCone(Cone):
    """An axis of the tip is at most a tolerance [rad] from a direction of the world; the heading about it is free.

    Parameters
    ----------
    more: added to the tolerance of `tilt` [rad], which ends at half a turn: the tracking error may need more.
    """

    name = "tilt"

    def __init__(self, robot: Robot, tilt: Tilt, *, more: float = 0.0) -> None:
        at = BatchKinematics(robot).at(robot.middle[None, :])
        axis = at.tip_rotation[0] @ tilt.axis
        # a slide turns nothing, so that it may be among the first or last hinges
        first, last = (robot.prismatic | _are_parallel(at.axes[0], one) for one in (tilt.direction, axis))
        idle = np.logical_and.accumulate(first) | np.logical_and.accumulate(last[::-1])[::-1]
        super().__init__(robot, tilt.tolerance + more, np.where(idle | robot.prismatic, 0.0, 1.0))
        self.tilt = tilt
        self._direction = tilt.direction.tolist()
        self._hinges = np.where(robot.prismatic, 0.0, 1.0)

    def angles(self, rotations: Array) -> Vector:
        """(B,) angle of the tip's axis from the direction, at orientations of the tip (B, 3, 3) [rad]."""
        return tilt_angles(rotations @ self.tilt.axis, self.tilt.direction)

    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """One margin; of a single configuration without arrays of one, in a fifth of the time."""
        if len(q) != 1:
            return super().rows(q)
        at = self._batch.at(q)
        a, b, c = at.tip_rotation[0].dot(self.tilt.axis).tolist()
        d, e, f = self._direction
        across = (b * f - c * e, c * d - a * f, a * e - b * d)
        sine = math.hypot(*across)
        if sine <= _NO_LENGTH:
            return super().rows(q)
        margin = self.tolerance - self.room - math.atan2(sine, a * d + b * e + c * f)
        gradient = at.axes[0].dot(np.array(across)) * (self._hinges / sine)
        return np.array([[margin]]), gradient[None, None]

    def narrowed(self, target: TipTarget, tolerance: float) -> TipTarget | None:
        """The target with the axis within `tolerance` [rad]; itself if it has an orientation or another tilt."""
        given = target.tilt
        if target.rotation is not None and target.rotation_tolerance == 0.0:
            return target
        # a turn by the tolerance of an orientation tilts the axis by no more than that
        if (
            target.rotation is not None
            and self.angles(target.rotation[None])[0] > target.rotation_tolerance + tolerance
        ):
            return None
        if given is None:
            return replace(target, tilt=replace(self.tilt, tolerance=min(tolerance, np.pi)))
        same = np.array_equal(given.axis, self.tilt.axis) and np.array_equal(given.direction, self.tilt.direction)
        return replace(target, tilt=replace(given, tolerance=min(given.tolerance, tolerance))) if same else target

    def narrowed_batch(self, targets: TargetBatch, tolerance: float | Vector) -> TargetBatch:
        """The targets, those without an exact orientation with the axis within `tolerance` [rad], also (B,)."""
        open_ = ~targets.has_rotation | (targets.rotation_tolerance > 0.0)
        every = np.tile(open_[:, None], 3)
        tilts = TiltBatch(
            axis=np.where(every, self.tilt.axis, 0.0),
            direction=np.where(every, self.tilt.direction, 0.0),
            tolerance=np.where(open_, tolerance, 0.0),
            required=open_,
        )
        return replace(targets, tilts=tilts if open_.any() else None)

    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) [rad]"""
        whole = np.abs(delta) @ self.turning
        sagitta = whole**2 / 8.0
        bound = 0.5 * (before + after + whole)
        along = np.arccos(np.clip(np.minimum(np.cos(before), np.cos(after)) - sagitta, -1.0, 1.0))
        across = np.arcsin(np.clip(np.maximum(np.sin(before), np.sin(after)) + sagitta, 0.0, 1.0))
        across = np.where(bound < 0.5 * np.pi, across, np.pi)
        return self.margins(np.minimum(np.minimum(along, across), bound))

    def turns(self, rotations: Array) -> Array:
        """(B, 3) the shortest rotation vectors to the direction [rad], world."""
        axis = rotations @ self.tilt.axis
        return tilt_turns(axis, np.broadcast_to(self.tilt.direction, axis.shape))

    def _directions(self, turns: Array) -> Array:
        """In the plane across the direction of the world, along the sides of an octagon."""
        direction = self.tilt.direction
        any_ = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        along = _unit(turns, any_ / np.linalg.norm(any_))
        beside = np.cross(direction, along)
        return _OCTAGON[:, :1] * along[:, None] + _OCTAGON[:, 1:] * beside[:, None]

    def widened(self, robot: Robot, by: float) -> TiltCone:
        """A wider cone."""
        return TiltCone(robot, self.tilt, more=self.tolerance - self.tilt.tolerance + by)

    def describe(self, value: float, when: str = "") -> str:
        """``the tip is tilted by 12.0 deg at 2.40 s, allowed 5 deg``, and whether the axis has the wrong sign."""
        angle, shown = self._shown(value)
        words = f"the tip is tilted by {angle} deg{when}, allowed {shown} deg{reduction_beside(self)}"
        if self.usable < 0.5 * np.pi and np.pi - value <= self.usable:
            opposite = ", ".join(f"{0.0 - part:.4g}" for part in self.tilt.axis)
            words += f"; the opposite axis, [{opposite}], is within that"
        return words


def _unit(vectors: Array, otherwise: Vector) -> Array:
    """(B, 3) vectors (B, 3) with length 1; those without a length become `otherwise` (3,) or (B, 3)."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > _NO_LENGTH, vectors / np.maximum(length, _NO_LENGTH), otherwise)


def _are_parallel(axes: Matrix, direction: Vector) -> Flags:
    """(n,) whether unit vectors (n, 3) are parallel to one (3,), either way."""
    return np.asarray(np.abs(np.cross(axes, direction)).max(axis=1) < UPRIGHT)
