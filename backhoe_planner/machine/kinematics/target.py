"""Targets for the tip: a position, perhaps with a pitch, an orientation or a tilt; one target or many."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import check_kind
from backhoe_planner.machine.kinematics.excess import excess, excess_jacobian, excess_jacobians, excess_part
from backhoe_planner.machine.kinematics.kinematics import Configuration, ConfigurationBatch, wrap_angle
from backhoe_planner.machine.kinematics.tilt import Tilt, TiltBatch

NO_SINE = 1e-12  # sine of an angle so small that it equals its sine
NEAR_HALF_TURN = -0.9  # cosine below which the symmetric part gives the rotation vector; chosen, 154 degrees
_NO_TURN = 1e-12  # rad: a smaller rotation has no axis
IMMOVABLE = 1e-9  # m/rad or rad/rad: rounding in a Jacobian of metres is 1e-15, a lever of 1 um is 1e-6


@dataclass(frozen=True)
class TipTarget:
    """A target pose of the tip, which may leave the pitch or the orientation free, and the position within a ball.

    Attributes
    ----------
    position: (3,) [m], world.
    pitch: (low, high) [rad], equal for a single angle; None if it is free.
    rotation: (3, 3) R_world_tip; None if the orientation is free.
    rotation_tolerance: how far the tip may be turned from `rotation` [rad]: only the excess is an error.
    position_tolerance: how far the tip may be from `position` [m]: only the excess is an error.
    tilt: how far an axis of the tip may be from a direction, beside a pitch or an orientation too; None if it is free.

    Raises
    ------
    InputError: one of them does not hold such numbers.
    """

    position: Vector
    pitch: tuple[float, float] | None = None
    rotation: Matrix | None = None
    rotation_tolerance: float = 0.0
    position_tolerance: float = 0.0
    tilt: Tilt | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", as_vector(self.position, 3, key="position"))
        # a path makes thousands of targets whose pitch is two numbers already: an array check would cost more
        if not (self.pitch is None or (isinstance(self.pitch, tuple) and _are_two_numbers(*self.pitch))):
            low, high = as_array(self.pitch, 2, key="pitch").tolist()
            object.__setattr__(self, "pitch", (low, high))
        if self.rotation is not None:
            object.__setattr__(self, "rotation", as_array(self.rotation, 3, 3, key="rotation"))
        if self.rotation_tolerance != 0.0:
            as_number(self.rotation_tolerance, key="rotation_tolerance", above=0.0)
        if self.position_tolerance != 0.0:
            as_number(self.position_tolerance, key="position_tolerance", above=0.0)
        if self.tilt is not None:
            check_kind(self.tilt, Tilt, key="tilt")

    def pitch_excess(self, pitch: float) -> float:
        """How far `pitch` is above (+) or below (-) the required range [rad]; 0 inside."""
        pitch = as_number(pitch, key="pitch")
        if self.pitch is None:
            return 0.0
        low, high = self.pitch
        off = wrap_angle(pitch - 0.5 * (low + high))
        return float(np.sign(off) * max(abs(off) - 0.5 * (high - low), 0.0))

    def error(self, at: Configuration) -> Vector:
        """(m,) target minus actual at a configuration: position [m], then angles [rad].

        The rows are 3 of position, then 1 of pitch (0 inside the required range) or 3 of the
        rotation vector, then 3 of the rotation vector of the tilt, in world axes; all vectors by as much as they
        are longer than their tolerance.
        """
        off = self.position - check_kind(at, Configuration, key="at").tip_position
        rows = [off if self.position_tolerance == 0.0 else excess(off, self.position_tolerance)]
        if self.rotation is not None:
            rows.append(excess(self._turn_from(at), self.rotation_tolerance))
        elif self.pitch is not None:
            rows.append(np.array([-self.pitch_excess(at.pitch)]))
        if self._tilts is not None:
            rows.append(self._tilts.errors(at.tip_rotation[None])[0])
        return np.concatenate(rows)

    def turn_to(self, other: TipTarget) -> float:
        """The angle between the orientations, or the middle pitches, of two targets [rad]; 0 if one has none."""
        check_kind(other, TipTarget, key="other")
        if self.rotation is not None and other.rotation is not None:
            return float(np.linalg.norm(pin.log3(self.rotation.T @ other.rotation)))
        if self.pitch is not None and other.pitch is not None:
            return abs(wrap_angle(0.5 * sum(other.pitch) - 0.5 * sum(self.pitch)))
        return 0.0

    def jacobian(self, at: Configuration) -> Matrix:
        """(m, n) of `error` at a configuration: to first order, a step dq reduces the error by jacobian @ dq."""
        check_kind(at, Configuration, key="at")
        if self._tilts is None:
            return self._pose_jacobian(at)
        tilting = self._tilts.jacobians(at.tip_rotation[None], at.jacobian[None, 3:])[0]
        return np.vstack((self._pose_jacobian(at), tilting))

    def distances(self, at: Configuration) -> tuple[float, float]:
        """Position error [m] and angle error [rad] at a configuration, both 0 or more."""
        error = self.error(at)
        return float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))

    def _pose_jacobian(self, at: Configuration) -> Matrix:
        """(m, n) of the rows of position, pitch and orientation."""
        moving = at.jacobian[:3]
        if self.position_tolerance != 0.0:
            moving = excess_jacobian(self.position - at.tip_position, self.position_tolerance) @ moving
        if self.rotation is not None:
            if self.rotation_tolerance == 0.0:
                return at.jacobian if self.position_tolerance == 0.0 else np.vstack((moving, at.jacobian[3:]))
            turning = excess_jacobian(self._turn_from(at), self.rotation_tolerance) @ at.jacobian[3:]
            return np.vstack((moving, turning))
        if self.pitch is not None:
            return np.vstack((moving, at.pitch_row))
        return moving

    @cached_property
    def _tilts(self) -> TiltBatch | None:
        """The tilt as a batch of one."""
        return TiltBatch.of([self.tilt])

    def _turn_from(self, at: Configuration) -> Vector:
        """(3,) rotation vector from the tip's orientation to the target's, in world axes [rad]."""
        assert self.rotation is not None
        return np.asarray(at.tip_rotation @ pin.log3(at.tip_rotation.T @ self.rotation))


def _are_two_numbers(*pitch: float) -> bool:
    return len(pitch) == 2 and all(isinstance(angle, float) and math.isfinite(angle) for angle in pitch)


@dataclass(frozen=True, eq=False)
class TargetBatch:
    """B targets of the tip; errors and Jacobians as of a `TipTarget`, for all at once.

    Attributes
    ----------
    position: (B, 3) [m], world.
    rotation: (B, 3, 3) R_world_tip; the identity where `has_rotation` is false.
    has_rotation: (B,) whether an orientation is required.
    rotation_tolerance: (B,) how far the tip may be turned from it [rad].
    position_tolerance: (B,) how far the tip may be from the position [m].
    pitch_middle, pitch_half: (B,) middle and half width of the required range of the pitch [rad].
    has_pitch: (B,) whether a pitch is required.
    tilts: the required tilts; None if none is required.
    """

    position: Array
    rotation: Array
    has_rotation: Flags
    rotation_tolerance: Array
    position_tolerance: Array
    pitch_middle: Array
    pitch_half: Array
    has_pitch: Flags
    tilts: TiltBatch | None = None

    @classmethod
    def of(cls, targets: Sequence[TipTarget]) -> TargetBatch:
        """The same targets as one batch."""
        ranges = [target.pitch for target in targets]
        has_rotation = np.array([target.rotation is not None for target in targets], dtype=bool)
        return cls(
            position=np.array([target.position for target in targets]).reshape(-1, 3),
            rotation=np.array([np.eye(3) if t.rotation is None else t.rotation for t in targets]).reshape(-1, 3, 3),
            has_rotation=has_rotation,
            rotation_tolerance=np.array([target.rotation_tolerance for target in targets]),
            position_tolerance=np.array([target.position_tolerance for target in targets]),
            pitch_middle=np.array([0.0 if r is None else 0.5 * (r[0] + r[1]) for r in ranges]),
            pitch_half=np.array([0.0 if r is None else 0.5 * (r[1] - r[0]) for r in ranges]),
            # if both are given, the orientation decides, as in `TipTarget`
            has_pitch=np.array([r is not None for r in ranges], dtype=bool) & ~has_rotation,
            tilts=TiltBatch.of([target.tilt for target in targets]),
        )

    def __len__(self) -> int:
        return len(self.position)

    def take(self, rows: Indices | Flags) -> TargetBatch:
        """The targets at `rows`."""
        tilts = None if self.tilts is None else self.tilts.take(rows)
        return replace(self, tilts=tilts, **{name: getattr(self, name)[rows] for name in _ARRAYS})

    def with_smaller_cones(self, part: Vector) -> TargetBatch:
        """The same targets, each with a `part` (B,) of its tolerances of orientation and tilt."""
        tilts = self.tilts
        return replace(
            self,
            rotation_tolerance=part * self.rotation_tolerance,
            tilts=None if tilts is None else replace(tilts, tolerance=part * tilts.tolerance),
        )

    def at_pitch(self, pitch: Array) -> TargetBatch:
        """The same positions, each with exactly the `pitch` (B,) [rad]."""
        yes, no, zero = np.ones(len(self), dtype=bool), np.zeros(len(self), dtype=bool), np.zeros(len(self))
        return replace(self, has_rotation=no, pitch_middle=np.array(pitch), pitch_half=zero, has_pitch=yes)

    def errors(self, at: ConfigurationBatch) -> Array:
        """(B, 7) target minus actual: position [m], rotation vector [rad], pitch [rad]; 0 where not required.

        (B, 10) if there are tilts: then follows their rotation vector [rad].
        """
        found = np.zeros((len(self), self._rows))
        found[:, :3] = self.position - at.tip_position
        if self.position_tolerance.any():
            found[:, :3] *= excess_part(found[:, :3], self.position_tolerance)[:, None]
        if self.has_rotation.any():
            turn = self._turns_from(at)
            part = excess_part(turn, self.rotation_tolerance)
            found[:, 3:6] = np.where(self.has_rotation[:, None], part[:, None] * turn, 0.0)
        if self.has_pitch.any():
            off = wrap_angle(at.pitch() - self.pitch_middle)
            above = np.sign(off) * np.maximum(np.abs(off) - self.pitch_half, 0.0)
            found[:, 6] = np.where(self.has_pitch, -above, 0.0)
        if self.tilts is not None:
            found[:, 7:] = self.tilts.errors(at.tip_rotation)
        return found

    def jacobians(self, at: ConfigurationBatch) -> Array:
        """(B, 7, n) or (B, 10, n) of `errors`: to first order, a step dq reduces an error by jacobian @ dq."""
        found = np.zeros((self._rows, at.q.shape[1], len(self))).transpose(
            2, 0, 1
        )  # the memory layout of what is copied in
        found[:, :3] = at.position_jacobian()
        rows = np.flatnonzero(self.position_tolerance > 0.0)
        if len(rows):
            off = self.position[rows] - at.tip_position[rows]
            found[rows, :3] = excess_jacobians(off, self.position_tolerance[rows]) @ found[rows, :3]
        if self.has_rotation.any():
            turning = at.rotation_jacobian()
            tolerant = np.flatnonzero(self.has_rotation & (self.rotation_tolerance > 0.0))
            if len(tolerant):
                beyond = excess_jacobians(self._turns_from(at)[tolerant], self.rotation_tolerance[tolerant])
                turning[tolerant] = beyond @ turning[tolerant]
            found[:, 3:6] = np.where(self.has_rotation[:, None, None], turning, 0.0)
        if self.has_pitch.any():
            found[:, 6] = np.where(self.has_pitch[:, None], at.pitch_rows(), 0.0)
        if self.tilts is not None:
            found[:, 7:] = self.tilts.jacobians(at.tip_rotation, at.rotation_jacobian())
        return found

    @property
    def _rows(self) -> int:
        return 7 if self.tilts is None else 10

    def _turns_from(self, at: ConfigurationBatch) -> Array:
        """(B, 3) rotation vectors from the tip's orientations to the targets', in world axes [rad]."""
        asked, tip = self.rotation.transpose(1, 2, 0), at.tip_rotation.transpose(1, 2, 0)
        turn = sum(asked[:, None, k] * tip[None, :, k] for k in range(3))
        return rotation_vectors(np.asarray(turn).transpose(2, 0, 1))


_ARRAYS = tuple(field.name for field in fields(TargetBatch) if field.name != "tilts")


def rotation_vectors(rotation: Array) -> Array:
    """(B, 3) rotation vectors of rotation matrices (B, 3, 3) [rad]."""
    # twice the axis times the sine, from the skew-symmetric part
    pairs = ((2, 1), (0, 2), (1, 0))
    twice = np.array([rotation[:, i, j] - rotation[:, j, i] for i, j in pairs])
    sine = 0.5 * np.sqrt(twice[0] ** 2 + twice[1] ** 2 + twice[2] ** 2)
    cosine = 0.5 * (rotation[:, 0, 0] + rotation[:, 1, 1] + rotation[:, 2, 2] - 1.0)
    ratio = np.where(sine > NO_SINE, np.arctan2(sine, cosine) / np.maximum(sine, NO_SINE), 1.0)
    found = (0.5 * ratio * twice).T
    half_turn = np.flatnonzero(cosine < NEAR_HALF_TURN)
    if len(half_turn):  # there the sine is too small to give the axis
        found[half_turn] = _near_half_turn(rotation[half_turn], twice[:, half_turn])
    return np.asarray(found)


def _near_half_turn(rotation: Array, twice: Array) -> Array:
    """(B, 3) rotation vectors near half a turn; `twice` (3, B) is twice the axis times the sine.

    The symmetric part is cos I + (1 - cos) a a^T. Its column of the axis's largest component gives the axis a.
    """
    count = np.arange(len(rotation))
    largest = np.argmax(rotation[:, [0, 1, 2], [0, 1, 2]], axis=1)
    column = rotation[count, :, largest] + rotation[count, largest]
    # the diagonal entry is 2 cos + 2 (1 - cos) a_k^2; 1 minus the trace, which is 1 + 2 cos, removes the 2 cos
    column[count, largest] += 1.0 - np.trace(rotation, axis1=1, axis2=2)
    axis = column / np.sqrt(np.einsum("bi,bi->b", column, column))[:, None]
    sine = 0.5 * np.einsum("bi,ib->b", axis, twice)
    cosine = 0.5 * (np.trace(rotation, axis1=1, axis2=2) - 1.0)
    return np.asarray(np.arctan2(sine, cosine)[:, None] * axis)


def rotation_matrices(turns: Matrix) -> Array:
    """(B, 3, 3) rotation matrices of rotation vectors (B, 3) [rad], by Rodrigues."""
    angle = np.sqrt(np.einsum("bi,bi->b", turns, turns))
    x, y, z = (turns / np.maximum(angle, _NO_TURN)[:, None]).T
    skew = np.zeros((len(turns), 3, 3))
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -z, y, -x
    skew -= skew.transpose(0, 2, 1)
    sine, versine = np.sin(angle)[:, None, None], (1.0 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * skew + versine * (skew @ skew))


def movable_rows(jacobian: Matrix) -> Flags:
    """(..., m) which rows of a task Jacobian (..., m, n) any joint can move; the z of a planar arm is not one."""
    return np.asarray(np.max(np.abs(jacobian), axis=-1) > IMMOVABLE)
