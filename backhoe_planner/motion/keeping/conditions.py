"""Conditions on a whole motion: what each can say, and a band of the pitch and a height of the tip.

Each condition has a margin at every configuration, 0 or more where it holds, and a lower bound
of that margin on a straight motion of the joints between two configurations with margins m_a, m_b.

Pitch. The axis of the last joint is horizontal in every posture (`Robot.has_pitch`). A hinge
turns everything beyond it about its own axis, so every hinge is either parallel to the last
one or vertical (otherwise its turning would tip the last axis). The pitch is therefore linear in
the joints, c . q + c0 with c_j = 1, -1 or 0, and on a straight motion the bound min(m_a, m_b)
is exact, as long as the pitch does not go round the other way.

Height. The tip is nowhere further than r . b / 8 from the chord (`bend_weights`), so the margin
of its height is nowhere lower than min(m_a, m_b) - r . b / 8. Vertical hinges between the base and
the first joint of another kind do not change a height, so they do not count.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Protocol, runtime_checkable

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import (
    BatchKinematics,
    Kinematics,
    Robot,
    bend_weights,
    tip_tracking_error,
    wrap_angle,
)

_NOT_ROUND = 1e-3  # rad: chosen; two motions from one pitch to another differ by whole turns
KEPT_TO = 1e-6  # rad or m by which a condition may be missed; chosen: rounding of a motion's samples is far below
UPRIGHT = 1e-9  # tilt of an axis that counts as vertical, or as parallel to another, as in `Robot.has_pitch`


@runtime_checkable
class Condition(Protocol):
    """One condition to be kept.

    Attributes
    ----------
    name: ``pitch``, ``above``, ``below``, ``rotation`` or ``tilt``, as in the scene file.
    unit: of its margin.
    room: how much of the margin the machine's tracking error can use up [unit].
    """

    name: str
    unit: str
    room: float

    @abstractmethod
    def values(self, q: Matrix) -> Vector:
        """(B,) the limited quantity at the joints `q` (B, n) [unit]."""

    @abstractmethod
    def margins(self, values: Vector) -> Vector:
        """(B,) how far within the allowed range `values` (B,) are [unit], `room` deducted; negative outside."""

    @abstractmethod
    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) lower bounds of the margin on straight motions [unit].

        Parameters
        ----------
        before, after: (B,) the values at their ends [unit].
        delta: (B, n) the motions [rad or m].
        travel: (n,) see `tip_travel_bound` [m/rad].
        """

    @abstractmethod
    def lever(self, travel: Vector) -> Vector:
        """(n,) the most that the values change with each joint [unit per rad or m]; `travel` as above."""

    @abstractmethod
    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """(B, K) margins smooth in the joints `q` (B, n), the least of which is the margin; (B, K, n) gradients."""

    def facets(self, q: Matrix) -> tuple[Matrix, Array]:
        """The same, with further rows where `rows` limit a step only in the direction in which a limit is nearest."""
        return self.rows(q)

    def absolute(self, value: float) -> float:
        """A value as people count it [unit]."""
        return value

    @abstractmethod
    def widened(self, robot: Robot, by: float) -> Condition:
        """The same condition with `by` more allowed [unit]."""

    @property
    @abstractmethod
    def allowed(self) -> str:
        """What is allowed, in words: ``0 to 20 deg``."""

    @abstractmethod
    def describe(self, value: float, when: str = "") -> str:
        """The value and what is allowed, in words, with `when` between them."""


class PitchBand(Condition):
    """The pitch stays within [low, high] [rad]; its values are counted from the middle of that range.

    Attributes
    ----------
    row: (n,) c, the derivative of the pitch, the same in every posture [rad/rad].
    half: half of the range, less the room for the tracking error [rad]; negative if that leaves nothing.
    """

    name = "pitch"
    unit = "rad"

    def __init__(self, robot: Robot, low: float, high: float) -> None:
        self.low, self.high = low, high
        at = Kinematics(robot).at(robot.middle)
        self.row = at.pitch_row
        self._offset = at.pitch - float(self.row @ at.q) - 0.5 * (low + high)
        self.room = 0.0 if robot.tube is None else float(np.abs(self.row) @ robot.tube.joints)
        self.half = 0.5 * (high - low) - self.room

    def unwrapped(self, q: Matrix) -> Vector:
        """(...) pitch from the middle of the band, with whole turns, at the joints `q` (..., n) [rad]: linear in q."""
        return np.asarray(q @ self.row + self._offset)

    def values(self, q: Matrix) -> Vector:
        """(B,) pitch from the middle of the band [rad], in [-pi, pi)."""
        return np.asarray(wrap_angle(self.unwrapped(q)))

    def counted(self, pitch: Vector) -> Vector:
        """(B,) pitches above the horizontal [rad], converted to values from the middle of the band."""
        return np.asarray(wrap_angle(pitch - 0.5 * (self.low + self.high)))

    def margins(self, values: Vector) -> Vector:
        """(B,) [rad]"""
        return np.asarray(self.half - np.abs(values))

    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) [rad] exact, because the pitch is linear; at least -pi if it goes round the other way."""
        found = np.minimum(self.margins(before), self.margins(after))
        round_ = np.abs(before + delta @ self.row - after) > _NOT_ROUND
        return np.asarray(np.where(round_, self.margins(np.full(len(found), np.pi)), found))

    def lever(self, travel: Vector) -> Vector:
        """(n,) [rad/rad]"""
        return np.abs(self.row)

    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """The margins from below and from above."""
        off = self.values(q)
        margins = np.column_stack((self.half + off, self.half - off))
        return margins, np.tile((self.row, -self.row), (len(q), 1, 1))

    def absolute(self, value: float) -> float:
        """The pitch above the horizontal [rad]."""
        return value + 0.5 * (self.low + self.high)

    def widened(self, robot: Robot, by: float) -> PitchBand:
        """Widened on both sides, with the same middle."""
        return PitchBand(robot, self.low - by, self.high + by)

    @property
    def allowed(self) -> str:
        """``0 to 20 deg``"""
        return f"{np.degrees(self.low):.4g} to {np.degrees(self.high):.4g} deg{reduction_text(self)}"

    def describe(self, value: float, when: str = "") -> str:
        """``the pitch of the bucket is 31.0 deg at 2.40 s, allowed 0 to 20 deg``"""
        pitch, low, high = self.absolute(value), self.low + self.room, self.high - self.room
        degrees = np.degrees([pitch, low, high]).tolist()
        shown, *ends = beside_bounds(*degrees, places=".1f", bounds_as=".4g", rounding=float(np.degrees(KEPT_TO)))
        allowed = f"{ends[0]} to {ends[1]} deg" if low <= high else "no pitch"
        return f"the pitch of the bucket is {shown} deg{when}, allowed {allowed}{reduction_beside(self)}"


class HeightBound(Condition):
    """The tip's height z [m] is not below (`sense` 1) or not above (-1) a `limit` [m]."""

    unit = "m"

    def __init__(self, robot: Robot, limit: float, sense: float) -> None:
        self.limit, self.sense = limit, sense
        self.name = "above" if sense > 0.0 else "below"
        self.room = tip_tracking_error(robot)
        self._batch = BatchKinematics(robot)
        self._turning = np.where(robot.prismatic, 0.0, 1.0)
        axes = self._batch.at(robot.middle[None, :]).axes[0]
        upright = (np.abs(axes[:, :2]).max(axis=1) < UPRIGHT) & ~robot.prismatic
        leading = np.logical_and.accumulate(upright | robot.prismatic)
        self._lifting = np.where(upright & leading, 0.0, 1.0)

    def values(self, q: Matrix) -> Vector:
        """(B,) z of the tip [m]."""
        return np.asarray(self._batch.at(q).tip_position[:, 2])

    def margins(self, values: Vector) -> Vector:
        """(B,) [m]"""
        return np.asarray(self.sense * (values - self.limit) - self.room)

    def lower_bounds(self, before: Vector, after: Vector, delta: Matrix, travel: Vector) -> Vector:
        """(B,) [m]"""
        sagitta = bend_weights(delta * self._lifting, self._turning) @ travel / 8.0
        return np.asarray(np.minimum(self.margins(before), self.margins(after)) - sagitta)

    def lever(self, travel: Vector) -> Vector:
        """(n,) [m/rad]"""
        return np.asarray(travel * self._lifting)

    def rows(self, q: Matrix) -> tuple[Matrix, Array]:
        """One margin."""
        at = self._batch.at(q)
        return self.margins(at.tip_position[:, 2])[:, None], self.sense * at.position_jacobian()[:, 2:]

    def widened(self, robot: Robot, by: float) -> HeightBound:
        """The same bound with its limit moved outward [m]."""
        return HeightBound(robot, self.limit - self.sense * by, self.sense)

    @property
    def allowed(self) -> str:
        """``at least 0.50 m``"""
        return f"at {'least' if self.sense > 0.0 else 'most'} {self.limit:.4g} m{reduction_text(self)}"

    def describe(self, value: float, when: str = "") -> str:
        """``the tip is 0.30 m high at 2.40 s, allowed at least 0.50 m``"""
        limit = self.limit + self.sense * self.room
        height, shown = beside_bounds(value, limit, places=".3f", bounds_as=".4g", rounding=KEPT_TO)
        allowed = f"at {'least' if self.sense > 0.0 else 'most'} {shown} m"
        return f"the tip is {height} m high{when}, allowed {allowed}{reduction_beside(self)}"


def reduction_text(condition: Condition) -> str:
    """How much the tracking error reduces the allowed range, as the end of a sentence."""
    return f" less {_room(condition)} for the tracking error" if condition.room > 0.0 else ""


def reduction_beside(condition: Condition) -> str:
    """The same, after a range that is reduced already."""
    return f" ({_room(condition)} less for the tracking error)" if condition.room > 0.0 else ""


def _room(condition: Condition) -> str:
    return f"{np.degrees(condition.room):.2g} deg" if condition.unit == "rad" else f"{condition.room:.3f} m"
