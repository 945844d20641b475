"""The tilt of the tip: the angle between an axis of the tip and a direction in the world, whatever the heading.

With u the axis in the world and d the direction, the rotation vector e takes u to d the shortest way:

    e = (angle / sin(angle)) u x d,    angle = atan2(|u x d|, u . d)

It is across u and d. A turning of the tip about u changes nothing. At half a turn every vector across u will do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Vector, as_number, as_vector
from backhoe_planner.errors import InputError
from backhoe_planner.machine.kinematics.excess import excess_jacobians, excess_part

_NO_LENGTH = 1e-12  # of an axis, in any unit: a shorter one is 0 but for rounding
_SERIES = 1e-3  # rad below which a series is used: its error is of the fourth power, the other's 1e-16 over the third
_NO_SINE = 1e-9  # of an angle: its axis is lost in rounding below, and its series is exact to 1e-18


@dataclass(frozen=True, eq=False)
class Tilt:
    """An axis of the tip that points in a direction of the world, with the heading about it free.

    Attributes
    ----------
    axis: (3,) in the tip's frame, of any length but 0; stored with length 1.
    direction: (3,) in the world, likewise.
    tolerance: how large the angle between them may be [rad]: only the excess is an error.

    Raises
    ------
    InputError: one of them does not hold such numbers.
    """

    axis: Vector
    direction: Vector
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        for key in ("axis", "direction"):
            vector = as_vector(getattr(self, key), 3, key=key)
            largest = float(np.abs(vector).max())
            if largest < _NO_LENGTH:
                raise InputError("has no direction", key=key, found=vector.tolist(), allowed="any length but 0")
            unit = vector / largest  # the square of a large one is no number
            object.__setattr__(self, key, unit / np.linalg.norm(unit))
        object.__setattr__(self, "tolerance", as_number(self.tolerance, key="tolerance", least=0.0, most=np.pi))


@dataclass(frozen=True, eq=False)
class TiltBatch:
    """B tilts, of which some are not required.

    Attributes
    ----------
    axis: (B, 3) unit axes in the tip's frame; zeros where nothing is required, as in the other arrays.
    direction: (B, 3) unit directions in the world.
    tolerance: (B,) [rad].
    required: (B,) whether a tilt is required.
    """

    axis: Array
    direction: Array
    tolerance: Array
    required: Flags

    @classmethod
    def of(cls, tilts: Sequence[Tilt | None]) -> TiltBatch | None:
        """The same tilts as one batch; None if all are None."""
        if all(tilt is None for tilt in tilts):
            return None
        nothing = np.zeros(3)
        return cls(
            axis=np.array([nothing if tilt is None else tilt.axis for tilt in tilts]),
            direction=np.array([nothing if tilt is None else tilt.direction for tilt in tilts]),
            tolerance=np.array([0.0 if tilt is None else tilt.tolerance for tilt in tilts]),
            required=np.array([tilt is not None for tilt in tilts], dtype=bool),
        )

    def take(self, rows: Indices | Flags) -> TiltBatch:
        """The tilts at `rows`."""
        return TiltBatch(self.axis[rows], self.direction[rows], self.tolerance[rows], self.required[rows])

    @property
    def exact(self) -> TiltBatch | None:
        """The tilts without a tolerance, the others not required; None if there are none."""
        return self.only(self.tolerance == 0.0)

    def only(self, rows: Flags) -> TiltBatch | None:
        """The tilts at `rows` (B,), the others not required; None if none is left."""
        rows = rows & self.required
        if not rows.any():
            return None
        return TiltBatch(self.axis * rows[:, None], self.direction * rows[:, None], self.tolerance * rows, rows)

    def errors(self, rotation: Array) -> Array:
        """(B, 3) the rotation vectors to the required direction, as far as they exceed the tolerance [rad], world.

        Parameters
        ----------
        rotation: (B, 3, 3) R_world_tip.
        """
        turn = tilt_turns(self._placed(rotation), self.direction)
        return excess_part(turn, self.tolerance)[:, None] * turn

    def jacobians(self, rotation: Array, turning: Array) -> Array:
        """(B, 3, n) of `errors`: to first order, a step dq reduces an error by jacobian @ dq.

        Parameters
        ----------
        turning: (B, 3, n) Jacobians of the tip's angular velocity, world [rad/rad].
        """
        u = self._placed(rotation)
        found = turn_jacobians(u, self.direction)
        tolerant = np.flatnonzero(self.tolerance > 0.0)
        if len(tolerant):
            turn = tilt_turns(u[tolerant], self.direction[tolerant])
            found[tolerant] = excess_jacobians(turn, self.tolerance[tolerant]) @ found[tolerant]
        return np.asarray(found @ turning)

    def _placed(self, rotation: Array) -> Array:
        """(B, 3) the axes in the world; zeros where nothing is required."""
        return np.asarray(np.einsum("bij,bj->bi", rotation, self.axis))


def tilt_angles(u: Array, d: Vector) -> Vector:
    """(B,) angles between unit vectors `u` (B, 3) and a unit vector `d` (3,) [rad], 0 to pi."""
    return np.asarray(np.arctan2(_lengths(_cross(u, d)), u.dot(d)))


def tilt_turns(u: Array, d: Array) -> Array:
    """(B, 3) the shortest rotation vectors from unit vectors `u` to `d` (B, 3) [rad]; of half a turn, any one."""
    across = _cross(u, d)
    sine, cosine = _lengths(across), np.sum(u * d, axis=1)
    ratio = np.where(sine > _NO_SINE, np.arctan2(sine, cosine) / np.maximum(sine, _NO_SINE), 1.0)
    found = np.asarray(ratio[:, None] * across)
    opposite = np.flatnonzero((sine <= _NO_SINE) & (cosine < 0.0))
    if len(opposite):
        beside = np.eye(3)[np.argmin(np.abs(u[opposite]), axis=1)]
        any_ = _cross(u[opposite], beside)
        found[opposite] = np.pi * any_ / np.linalg.norm(any_, axis=1, keepdims=True)
    return found


def turn_jacobians(u: Array, d: Array) -> Array:
    """(B, 3, 3) minus the derivatives of `tilt_turns` with respect to a rotation of `u` about the world's axes.

    With s = u x d, c = u . d and f = angle / sin(angle), e = f s, and a rotation w gives du = w x u, so that
    ds = u (d . w) - c w and dc = s . w. At half a turn only the part along e is left.
    """
    s, c = _cross(u, d), np.sum(u * d, axis=1)
    sine = _lengths(s)
    angle = np.arctan2(sine, c)
    small, near_half = (sine <= _NO_SINE) & (c > 0.0), (sine <= _NO_SINE) & (c < 0.0)
    safe = np.where(sine > _NO_SINE, sine, 1.0)
    f = np.where(small, 1.0, angle / safe)
    # f' = (sin - angle cos) / sin^2, divided by another sine for df/dc; both lose their digits for small angles
    slope = np.where(angle > _SERIES, (safe - angle * c) / safe**3, 1.0 / 3.0 + angle**2 * (2.0 / 15.0))
    found = f[:, None, None] * (c[:, None, None] * np.eye(3) - u[:, :, None] * d[:, None, :])
    found += slope[:, None, None] * s[:, :, None] * s[:, None, :]
    if near_half.any():
        e = tilt_turns(u[near_half], d[near_half]) / np.pi
        found[near_half] = e[:, :, None] * e[:, None, :]
    return np.asarray(found)


def _cross(a: Array, b: Array) -> Array:
    """(B, 3) a x b of vectors (B, 3) or (3,); numpy's own takes ten times as long for few."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.T, b.T
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x]).T


def _lengths(vectors: Array) -> Vector:
    """(B,) lengths of vectors (B, 3)."""
    return np.asarray(np.sqrt(np.einsum("bi,bi->b", vectors, vectors)))
