"""The features of a goal over boxes of configurations, to second order with a proven remainder.

The features of a goal are a vector z(q): the tip's position, two directions that are
fixed to it, its pitch. From the middle c of a box, with d = q - c,

    z(q) = z(c) + J d + d^T H d / 2 + R,    |R| <= sum_k r_k (C_k^3 - C_(k-1)^3) / 6

with C_k the sum of |d_i| over the hinges up to joint k, and r_k the greatest distance of the point from
the axis of joint k within the box. For a slide k, 3 |d_k| C_(k-1)^2 replaces the difference. All joints
count from the base; x_ij = a_i x x_j if hinge i is not further out than joint j, and no derivative is
longer than the one by its outermost joint alone.

`box_tests` draws the conclusions for a box from its features.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from backhoe_planner.arrays import Array, Indices, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, Robot, TipTarget, tip_travel_bound, wrap_angle
from backhoe_planner.motion import ANGLE_TOLERANCE, JOINT_TOLERANCE, Goal, Problem
from backhoe_planner.native import compiled

_LEVER = 0.5  # m: a direction that is off by 1 rad counts as a tip that is off by this; chosen
_LOOSE = 0.2  # rad: chosen; with a larger tolerance the orientation is not tested, and the position more closely
_SAME_ROW = 1e-9  # rad/rad: derivatives of the pitch that differ by less are the same
_POSTURES = 8  # configurations in which the derivative of the pitch is compared
_ROUNDING = 1e-9  # m: far above that of a chain of ten joints, some 1e-14


@dataclass(frozen=True, eq=False)
class Features:
    """The features of a goal, to second order, over B boxes around `middle`; m features in g groups.

    Attributes
    ----------
    middle: (B, n) of the boxes [rad or m].
    error: (B, m) the features on the goal minus those at the middle.
    J: (B, m, n); H: (B, m, n, n) first and second derivatives at the middle.
    slack: (B, g) the goal's tolerance plus the remainder, as a length for each group.
    group: (m,) the group of each feature.
    """

    middle: Matrix
    error: Matrix
    J: Array
    H: Array
    slack: Matrix
    group: Indices

    @property
    def tests(self) -> tuple[Matrix, Array, Array, Matrix, Indices]:
        """Error, J, H, slack and group: what the compiled tests take."""
        return self.error, self.J, self.H, self.slack, self.group


class GoalRegion(Protocol):
    """A goal: the configurations with which a motion may end."""

    def features(self, lower: Matrix, upper: Matrix) -> Features:
        """The features over the boxes `lower` .. `upper` (B, n) [rad or m]."""


class _TipGoal:
    """The tip within `off` [m] of a position, with its pitch within `turned` [rad] of the required range."""

    def __init__(self, robot: Robot, target: TipTarget, turned: float, off: float) -> None:
        self._turned, self._off = turned, off
        self._kinematics = BatchKinematics(robot)
        self._target = target
        self._hinge = np.where(robot.prismatic, 0.0, 1.0)
        self._reach = tip_travel_bound(robot)
        self._pitch_row = None if target.pitch is None else _constant_pitch_row(self._kinematics)
        self._group = np.array([0, 0, 0] + [1] * (self._pitch_row is not None))

    def features(self, lower: Matrix, upper: Matrix) -> Features:
        """See `GoalRegion`."""
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        at, target = self._kinematics.at(middle), self._target
        arms = at.tip_position[:, None, :] - at.origins
        terms = _point(at.axes, arms, half, hinge=self._hinge, bound=self._reach)
        error, J, H = target.position - at.tip_position, terms.J, terms.H
        slack = (self._off + terms.rest + _ROUNDING)[:, None]
        if self._pitch_row is not None:
            assert target.pitch is not None
            low, high = target.pitch
            off = wrap_angle(0.5 * (low + high) - at.pitch())
            spread = half @ np.abs(self._pitch_row)
            allowed = 0.5 * (high - low) + self._turned + _ROUNDING
            # if the box spans more than a turn, the pitch is ambiguous
            sure = np.abs(off) + spread + allowed < np.pi
            error = np.column_stack((error, _LEVER * off))
            J = np.concatenate((J, np.broadcast_to(_LEVER * self._pitch_row, (len(J), 1, J.shape[2]))), axis=1)
            H = np.concatenate((H, np.zeros((len(J), 1, *H.shape[2:]))), axis=1)
            slack = np.column_stack((slack, np.where(sure, _LEVER * allowed, np.inf)))
        return Features(middle, error, J, H, slack, self._group)


class _PoseGoal:
    """The tip within `off` [m] of a position and within `turned` [rad] of an orientation.

    The body of a joint in the middle of the arm is placed from both ends: by the inner joints from the
    base, and by the outer joints back from the goal. Each side has half of the joints, so that the
    remainder, which grows with the third power of their total travel, is about an eighth.
    """

    def __init__(self, robot: Robot, target: TipTarget, turned: float, off: float) -> None:
        assert target.rotation is not None
        self._turned, self._off = turned, off
        self._kinematics = BatchKinematics(robot)
        self._position, self._rotation = target.position, target.rotation
        self._hinge = np.where(robot.prismatic, 0.0, 1.0)
        self._meet = robot.n // 2
        self._group = np.repeat(np.arange(3), 3)
        axis = robot.joint_axes[self._meet]
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        self._directions = (axis, across / np.linalg.norm(across))

    def features(self, lower: Matrix, upper: Matrix) -> Features:
        """See `GoalRegion`."""
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        at, meet = self._kinematics.at(middle), self._meet
        inner, outer = np.arange(meet + 1), np.arange(self._kinematics.robot.n - 1, meet, -1)
        # the rotation from the tip's orientation at the middle of the box to that on the goal
        turn = self._rotation @ np.swapaxes(at.tip_rotation, 1, 2)
        point = at.origins[:, meet]
        lever = point - at.tip_position
        error = [self._position + _turned(turn, lever) - point]
        axes, hinge = at.axes[:, inner], self._hinge[inner]
        back_axes, back_hinge = _turned(turn, at.axes[:, outer]), self._hinge[outer]
        front = [_point(axes, point[:, None, :] - at.origins[:, inner], half[:, inner], hinge=hinge)]
        back_arms = _turned(turn, point[:, None, :] - at.origins[:, outer])
        back = [_point(back_axes, back_arms, half[:, outer], hinge=back_hinge)]
        away = np.linalg.norm(lever, axis=1) + np.einsum("bn,bn->b", back[0].longest, half[:, outer])
        slack = [self._off + self._turned * away + front[0].rest + back[0].rest + _ROUNDING]
        for own in self._directions:
            direction = at.rotations[:, meet] @ own
            goal = _turned(turn, direction)
            error.append(_LEVER * (goal - direction))
            front.append(_direction(axes, direction, half[:, inner], hinge=hinge))
            back.append(_direction(back_axes, goal, half[:, outer], hinge=back_hinge))
            slack.append(_LEVER * (self._turned + front[-1].rest + back[-1].rest) + _ROUNDING)
        count, n = middle.shape
        J, H = np.zeros((count, 9, n)), np.zeros((count, 9, n, n))
        for index, (own_terms, other) in enumerate(zip(front, back, strict=True)):
            rows, weight = slice(3 * index, 3 * index + 3), _LEVER if index else 1.0
            J[:, rows, : meet + 1] = weight * own_terms.J
            H[:, rows, : meet + 1, : meet + 1] = weight * own_terms.H
            # back from the goal a joint turns the inner bodies in the opposite sense; z is the difference of the sides
            J[:, rows, meet + 1 :] = weight * other.J[:, :, ::-1]
            H[:, rows, meet + 1 :, meet + 1 :] = -weight * other.H[:, :, ::-1, ::-1]
        return Features(middle, np.concatenate(error, axis=1), J, H, np.stack(slack, axis=1), self._group)


class _JointGoal:
    """The joints at the configuration `q` (n,) [rad or m]."""

    def __init__(self, q: Vector) -> None:
        self._q = q

    def features(self, lower: Matrix, upper: Matrix) -> Features:
        """See `GoalRegion`."""
        middle = 0.5 * (lower + upper)
        count, n = middle.shape
        return Features(
            middle, self._q - middle, np.broadcast_to(np.eye(n), (count, n, n)), np.zeros((count, n, n, n)),
            np.full((count, n), JOINT_TOLERANCE + _ROUNDING), np.arange(n),
        )  # fmt: skip


def goal_regions(problem: Problem) -> tuple[GoalRegion, ...]:
    """The goals of a problem, of which a motion must reach one; empty if it has a path."""
    return tuple(_region_of(problem.robot, goal) for goal in problem.goals)


def _region_of(robot: Robot, goal: Goal) -> GoalRegion:
    if goal.q is not None:
        return _JointGoal(goal.q)
    allowed = ANGLE_TOLERANCE if goal.rotation_tolerance is None else goal.rotation_tolerance
    off = goal.allowed_off
    if goal.target.rotation is None:
        return _TipGoal(robot, goal.target, allowed, off)
    if allowed > _LOOSE or robot.n < 2:
        return _TipGoal(robot, TipTarget(goal.target.position), allowed, off)
    return _PoseGoal(robot, goal.target, allowed, off)


def _constant_pitch_row(kinematics: BatchKinematics) -> Vector | None:
    """(n,) the derivative of the pitch if it is constant; otherwise None, and the pitch is not tested."""
    rng = np.random.default_rng(0)
    rows = kinematics.at(np.array([kinematics.robot.random_q(rng) for _ in range(_POSTURES)])).pitch_rows()
    return rows[0] if np.ptp(rows, axis=0).max() < _SAME_ROW else None


@dataclass(frozen=True, eq=False)
class VectorTerms:
    """A vector that k joints move, to second order, over B boxes; joints from the base of their chain.

    Attributes
    ----------
    J: (B, 3, k); H: (B, 3, k, k) derivatives in the middle.
    rest: (B,) an upper bound on the length of the remainder of third order.
    longest: (B, k) an upper bound on the length of the first derivatives in the box.
    """

    J: Array
    H: Array
    rest: Vector
    longest: Matrix


def _point(axes: Array, arms: Array, half: Matrix, *, hinge: Vector, bound: Vector | None = None) -> VectorTerms:
    """The terms of a point, from the joints' `axes` and its `arms` from them (B, k, 3), in boxes of half widths `half`.

    half: (B, k); hinge: (k,) 1, or 0 for a slide; bound: (k,) its greatest distance from each hinge's axis anywhere.
    """
    return vector_terms(np.where(hinge[:, None] > 0.0, cross(axes, arms), axes), axes, half, hinge=hinge, bound=bound)


def _direction(axes: Array, vector: Matrix, half: Matrix, *, hinge: Vector) -> VectorTerms:
    """The terms of a unit `vector` (B, 3); the rest is as in `_point`."""
    first = cross(axes, vector[:, None, :]) * hinge[:, None]
    return vector_terms(first, axes, half, hinge=hinge, bound=np.ones(len(hinge)))


def vector_terms(first: Array, axes: Array, half: Matrix, *, hinge: Vector, bound: Vector | None = None) -> VectorTerms:
    """The terms of a vector with the first derivatives `first` (B, k, 3); the rest is as in `_point`."""
    most = np.full(len(hinge), np.inf) if bound is None else bound
    return VectorTerms(np.swapaxes(first, 1, 2), *second_order(first, axes, half, hinge, most))


@compiled
def second_order(
    first: Array, axes: Array, half: Matrix, hinge: Vector, bound: Vector, /
) -> tuple[Array, Vector, Matrix]:
    """H, `rest` and `longest` of the `VectorTerms` of a vector; the arguments are those of `vector_terms`."""
    count, k = half.shape
    second = np.zeros((count, 3, k, k))
    longest = np.empty((count, k))
    moved = np.zeros(count)  # travel due to the joints further out
    for joint in reversed(range(k)):
        here = np.sqrt(np.einsum("bi,bi->b", first[:, joint], first[:, joint]))
        if hinge[joint]:
            longest[:, joint] = np.minimum(here + moved, bound[joint])
            turned = np.swapaxes(cross(axes[:, joint, None, :], first[:, joint:]), 1, 2)
            second[:, :, joint, joint:] = turned
            second[:, :, joint:, joint] = turned
        else:
            longest[:, joint] = here
        moved = moved + longest[:, joint] * half[:, joint]
    angle = half * hinge
    up_to = np.cumsum(angle, axis=1)
    before = up_to - angle
    terms = np.where(hinge > 0.0, up_to**3 - before**3, 3.0 * half * before**2)
    return second, np.einsum("bk,bk->b", longest, terms) / 6.0, longest


def _turned(turn: Array, vectors: Array) -> Array:
    """Vectors (B, 3) or (B, k, 3), each row turned by its `turn` (B, 3, 3)."""
    return np.asarray(np.einsum("bij,b...j->b...i", turn, vectors))


def cross(a: Array, b: Array) -> Array:
    """The vector product along the last axis; numpy's own takes several times as long."""
    a, b = np.broadcast_arrays(a, b)
    found = np.empty(a.shape)
    found[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    found[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    found[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return found
