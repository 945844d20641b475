"""The shield: the nearest joint velocity that is safe.

    min_v  (v - v_w)^T W (v - v_w)
    s.t.   g_i v + drift_i >= -gamma margin_i         every nearby pair       (soft)
           k_i v >= -gamma left_i                     every other condition   (soft)
           v within velocity, acceleration and braking limits of each joint   (hard)

W weighs the change by its effect on the tip: leaving the desired direction costs most, going
slower along it less, motion in the null space least.

gamma is 1.6 / T with T the time in which all joints together can be braked to rest, so
that braking in proportion, which keeps the joints' direction, stops within 80 % of
each margin. From a velocity that satisfies the rows, braking satisfies them again: the
problem stays solvable without slack as long as the obstacles hold still. Outside a
limit, or closer than the clearance, the bounds require motion back. A row that cannot
be satisfied costs a price instead of raising an error, and the missing speed is reported.
A row of nothing but rounding is ignored, see `soft_solution`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from operator import mul
from typing import NamedTuple, TypeAlias

import numpy as np

from backhoe_planner.arrays import Indices, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import check_kind
from backhoe_planner.law.binding_rows import soft_solution
from backhoe_planner.law.qp import Rows
from backhoe_planner.machine import JointLimits
from backhoe_planner.native import compiled
from backhoe_planner.site import Nearby

_WEIGHTS = 10.0, 1.0, 0.05  # in W: across the wish, along it, and of motion that leaves the tip in place; chosen
_STOPPING_PART = 1.6  # gamma T; chosen: 2 would stop exactly at the clearance, this stops within 80 % of each margin
_RECOVERY = 1.0  # 1/s: rate at which a violation of a clearance or limit is to be reduced; chosen
_FASTEST_RECOVERY = 0.25  # m/s or rad/s; chosen
_RATES = _STOPPING_PART, _RECOVERY, _FASTEST_RECOVERY
_NO_PAIRS: Indices = np.zeros(0, dtype=np.intp)
_FEW = 16  # rows; measured: up to here, finding those that can bind takes longer than solving with all of them
_MOST_ITERATIONS = 1000  # of the solver; an ordinary step takes up to 10
_MET = 1e-5  # m/s: a soft row that binds is violated by its force over its price, some 1e-6

JointTable: TypeAlias = tuple[tuple[float, ...], ...]


class Kept(NamedTuple):
    """What the shield needs of the conditions of a `Keep` at one configuration.

    Attributes
    ----------
    margin: (K,) margin of each condition; negative if it is not kept [each in its own unit].
    gradient: (K, n) of the margins with respect to the joints.
    """

    margin: Vector
    gradient: Matrix


class Shielded(NamedTuple):
    """The result of the shield.

    Attributes
    ----------
    v: (n,) joint velocity [rad/s or m/s].
    slack: the greatest violation of a row [m/s]; 0 if all are satisfied.
    binding: indices into the nearby pairs, of those that hold the motion back.
    """

    v: Vector
    slack: float
    binding: Indices


class Shield:
    """The filter that turns wished joint velocities into safe ones, for the joint limits of one machine.

    Parameters
    ----------
    limits: of the joints, already scaled.
    """

    def __init__(self, limits: JointLimits) -> None:
        self.limits = check_kind(limits, JointLimits, key="limits")
        self._n = len(limits.velocity)
        self._per_acceleration: list[float] = (1.0 / limits.acceleration).tolist()
        self._dt = math.nan
        self._joints: JointTable

    def velocity_bounds(self, q: Vector, v_before: Vector, dt: float) -> tuple[Vector, Vector]:
        """(n,), (n,) the joint velocities that keep every joint limit, with room to brake.

        A joint at distance `gap` from a limit may move towards it at the speed from
        which it stops within the gap, this step included. Beyond a limit it must come
        back. The acceleration limit takes precedence over all of this.

        Parameters
        ----------
        q, v_before: (n,) joint positions, and the velocity in the last step.
        dt: length of the step [s].
        """
        q, v_before = as_vector(q, self._n, key="q"), as_vector(v_before, self._n, key="v_before")
        return self._bounds(q, v_before, as_number(dt, key="dt", above=0.0))

    def _bounds(self, q: Vector, v_before: Vector, dt: float) -> tuple[Vector, Vector]:
        low, high, _, _ = _range(v_before, q, v_before, dt, self._joints_at(dt))
        return np.array(low), np.array(high)

    def _joints_at(self, dt: float) -> JointTable:
        """The data of each joint for a step of dt [s].

        These are its range, the part of it in which there is room to brake from full speed, and its limits.
        """
        if dt != self._dt:
            self._dt, self._joints = dt, self._joints_of(dt)
        return self._joints

    def _joints_of(self, dt: float) -> JointTable:
        limits = self.limits
        velocity, a = limits.velocity, limits.acceleration
        room = 0.5 * velocity * velocity / a + 1.5 * dt * velocity
        columns = limits.lower, limits.upper, limits.lower + room, limits.upper - room, velocity, a, a * dt
        return tuple(zip(*(column.tolist() for column in columns), self._per_acceleration, strict=True))

    def braking_time(self, v: Vector) -> float:
        """Time in which all joints come to rest, braking in proportion [s]."""
        return self._braking_time(as_vector(v, self._n, key="v"))

    def _braking_time(self, v: Vector) -> float:
        return float(max(map(mul, map(abs, v.tolist()), self._per_acceleration)))

    def stopping_time(self, v: Vector) -> float:
        """1 / gamma [s]: the margin that is needed for a rate of approach, divided by that rate."""
        return self.braking_time(v) / _STOPPING_PART

    def stopping_time_unchecked(self, v: Vector) -> float:
        """`stopping_time` without checks, for callers in a loop whose arguments are right by construction."""
        return self._braking_time(v) / _STOPPING_PART

    def filter(
        self,
        wish: Vector,
        *,
        q: Vector,
        v_before: Vector,
        dt: float,
        nearby: Nearby,
        J_tip: Matrix,
        extra_margin: Vector | float = 0.0,
    ) -> Shielded:
        """The safe velocity nearest to `wish` (n,).

        Parameters
        ----------
        q, v_before: (n,) joint positions, and the velocity in the last step.
        dt: length of the step [s].
        nearby: the pairs that must keep apart.
        J_tip: (3, n) position Jacobian of the tip.
        extra_margin: (K,) or one number, distance to be kept on top of the clearance [m].

        Raises
        ------
        InputError: an argument has the wrong kind or shape; the message names it.
        """
        wish = as_vector(wish, self._n, key="wish")
        check_kind(nearby, Nearby, key="nearby")
        J_tip = as_array(J_tip, 3, self._n, key="J_tip")
        if isinstance(extra_margin, float):
            as_number(extra_margin, key="extra_margin")
        else:
            extra_margin = as_array(extra_margin, *np.shape(extra_margin) and (len(nearby),), key="extra_margin")
        return self.filter_unchecked(
            wish,
            q=as_vector(q, self._n, key="q"),
            v_before=as_vector(v_before, self._n, key="v_before"),
            dt=as_number(dt, key="dt", above=0.0),
            nearby=nearby,
            J_tip=J_tip,
            extra_margin=extra_margin,
        )

    def filter_unchecked(
        self,
        wish: Vector,
        *,
        q: Vector,
        v_before: Vector,
        dt: float,
        nearby: Nearby,
        J_tip: Matrix,
        extra_margin: Vector | float = 0.0,
        kept: Kept | None = None,
    ) -> Shielded:
        """`filter` without checks, for callers in a loop whose arguments are right by construction.

        Parameters
        ----------
        kept: conditions to be kept besides the clearances.
        """
        is_kept, low_high, time, bound = step_conditions(
            wish,
            q,
            v_before,
            dt,
            self._joints_at(dt),
            nearby.margin,
            extra_margin,
            nearby.gradient,
            nearby.drift,
            _RATES,
        )
        keep = None if kept is None else self._keep_rows(kept, time, dt)
        if is_kept and (keep is None or keep.are_kept_by(wish)):
            return Shielded(wish, 0.0, _NO_PAIRS)
        # without bounds, the wish violates only a condition in `keep`
        low, high = self._bounds(q, v_before, dt) if low_high is None else low_high
        H, f, G, h, pairs = nearest_safe_program(wish, J_tip, nearby.gradient, bound, low, high, _WEIGHTS, _FEW)
        rows, most = (G, h) if keep is None else (np.concatenate((G, keep.G)), np.concatenate((h, keep.h)))
        solution = soft_solution(H, f, low, high, rows, most, _MOST_ITERATIONS)
        x = self._braked(v_before, dt) if solution is None else solution[0]
        v = np.minimum(np.maximum(x, low), high)
        if len(pairs) == 0:
            return Shielded(v, 0.0, pairs)
        over = G.dot(v)
        over -= h
        slack = float(over[over.argmax()])
        return Shielded(v, slack if slack > _MET else 0.0, pairs[over > -_MET])

    def _braked(self, v: Vector, dt: float) -> Vector:
        time = self._braking_time(v)
        return v * max(1.0 - dt / time, 0.0) if time > 0.0 else v

    def _keep_rows(self, kept: Kept, braking_time: float, dt: float) -> Rows:
        """The rows -k v <= gamma left."""
        return Rows("keep", -kept.gradient, _approach_rates(kept.margin, braking_time, dt))


@compiled
def step_conditions(
    wish: Vector, q: Vector, v_before: Vector, dt: float, joints: JointTable, margin: Vector, extra: Vector | float,
    gradient: Matrix, drift: Vector, rates: tuple[float, float, float], /,
) -> tuple[bool, Matrix | None, float, Vector]:  # fmt: skip
    """The conditions on the velocity of a step, and whether `wish` (n,) keeps them.

    Parameters
    ----------
    q, v_before, dt: as in `Shield.filter`.
    joints: for each of n joints the lower and upper limit, the two positions between which there is room to brake
        from full speed, the largest velocity and acceleration, the greatest change of velocity in a step, and
        1 / acceleration.
    margin, gradient, drift: (K,), (K, n), (K,) as in `Nearby`.
    extra: (K,) or one number, subtracted from the margins [m].
    rates: gamma T, the rate of recovery [1/s], and its greatest speed [m/s or rad/s].

    Returns
    -------
    Whether the wish keeps all; if not, (2, n) bounds of the velocity [rad/s or m/s]; the longer time in which all
    joints come to rest, from `v_before` or from the wish [s]; (K,) how fast each margin may shrink [m/s].
    """
    lows, highs, time, within = _range(wish, q, v_before, dt, joints)
    bound = _approach_rates(margin - extra, time, dt)
    bound += drift
    if within and len(margin):
        left = gradient.dot(wish)
        left += bound
        within = bool(left[left.argmin()] >= 0.0)
    return within, None if within else np.array((lows, highs)), time, bound


def _range(
    wish: Vector, q: Vector, v_before: Vector, dt: float, joints: JointTable
) -> tuple[list[float], list[float], float, bool]:
    """The bounds of the velocity, n numbers each, the time [s], whether the wish is within; see `step_conditions`."""
    lead, within, time = 1.5 * dt, True, 0.0
    lows, highs = [], []
    # for a handful of joints plain numbers take a fraction of the time of arrays
    each = zip(q.tolist(), v_before.tolist(), wish.tolist(), joints, strict=True)
    for position, rate, wished, (least, most, first, last, velocity, a, change, per) in each:
        low, high = rate - change, rate + change
        if first < position < last:  # usually there is room to brake from full speed
            upper, lower = velocity, -velocity
        else:
            upper = min(velocity, _stoppable(most - position, a, lead))
            lower = -min(velocity, _stoppable(position - least, a, lead))
        slowest, fastest = low, high
        if lower > low:
            low = lower if lower < fastest else fastest
        if upper < high:
            high = upper if upper > slowest else slowest
        if high < low:
            high = low
        lows.append(low)
        highs.append(high)
        if not low <= wished <= high:
            within = False
        before, after = abs(rate) * per, abs(wished) * per
        if before > time:
            time = before
        if after > time:
            time = after
    return lows, highs, time, within


@compiled
def nearest_safe_program(
    wish: Vector, J_tip: Matrix, gradient: Matrix, bound: Vector, low: Vector, high: Vector,
    weights: tuple[float, float, float], few: int, /,
) -> tuple[Matrix, Vector, Matrix, Vector, Indices]:  # fmt: skip
    """The program of the velocity nearest to `wish` (n,): W and its linear cost, and the rows -g v <= bound.

    It has those of the K rows `gradient` (K, n), `bound` (K,) that can bind between `low` and `high` (n,). If there
    are no more than `few`, it has all of them.

    Parameters
    ----------
    J_tip: (3, n) position Jacobian of the tip.
    weights: in W: across the wish, along it, and of motion that leaves the tip in place.

    Returns
    -------
    (n, n) W, (n,) -W wish, (R, n) and (R,) the rows, (R,) their indices among the K.
    """
    n, (across, along, free) = len(wish), weights
    tip = J_tip.dot(wish)
    speed2 = float(tip.dot(tip))
    # the tip's three directions, and the direction of the wish, each with its weight
    rows = np.empty((4, n))
    rows[:3] = J_tip
    tip.dot(J_tip, out=rows[3])
    tip_weights, anywhere = _constant_weights(across, free, n)
    by = tip_weights.copy()
    if speed2 > 1e-12:
        by[3] = (along - across) / speed2
    H = np.asarray((rows.T * by).dot(rows))
    H += anywhere
    G = -gradient
    if len(bound) <= few:
        return H, -H.dot(wish), G, bound, _numbers(len(bound))
    middle = 0.5 * (low + high)
    fastest = np.abs(G).dot(high - middle)
    fastest += G.dot(middle)
    pairs = (bound <= fastest).nonzero()[0]
    return H, -H.dot(wish), G.take(pairs, axis=0), bound.take(pairs), pairs


@lru_cache(maxsize=32)
def _constant_weights(across: float, free: float, n: int) -> tuple[Vector, Matrix]:
    """(4,) weights of the tip's three directions and 0 for a fourth, (n, n) of all motion; do not modify them."""
    return np.array((across, across, across, 0.0)), free * np.eye(n)


@lru_cache(maxsize=_FEW)
def _numbers(count: int) -> Indices:
    """0, 1, ..., `count` - 1; do not modify it."""
    return np.arange(count)


def _approach_rates(margin: Vector, braking_time: float, dt: float) -> Vector:
    """(K,) gamma margin: how fast margins (K,) may shrink; for a negative margin, minus the speed of recovery."""
    bound = margin * (_STOPPING_PART / max(braking_time, _STOPPING_PART * 2.0 * dt))
    if len(margin) and margin[margin.argmin()] < 0.0:
        bound = np.where(margin >= 0.0, bound, -np.minimum(-_RECOVERY * margin, _FASTEST_RECOVERY))
    return bound


def _stoppable(gap: float, a: float, lead: float) -> float:
    """Speed towards a joint's limit from which braking at `a` stops within `gap`.

    The joint goes on for `lead` [s] before it brakes: the step itself and half of
    the next. Beyond the limit the result is minus the speed of recovery.
    """
    if gap < 0.0:
        return -min(-_RECOVERY * gap, _FASTEST_RECOVERY)
    return a * (math.sqrt(lead**2 + 2.0 * gap / a) - lead)
