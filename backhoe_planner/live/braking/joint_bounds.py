"""The joint velocities that a step may have: accelerations, rates, and room to brake before a limit."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.native import compiled

BRAKING = 0.8  # part of the acceleration that braking is planned with; chosen, the rest is left for corrections
RECOVERY = 1.0  # 1/s: speed of the return per amount of violation; chosen
SLOWEST_RECOVERY = 0.02  # m/s or rad/s: chosen, so that the return ends in finite time
FASTEST_RECOVERY = 0.25  # m/s or rad/s: chosen, so that the return begins gently
TOLERANCE = 1e-9  # rad, m, rad/s or m/s: far above rounding, and too little to matter

_RATES = RECOVERY, SLOWEST_RECOVERY, FASTEST_RECOVERY, TOLERANCE, BRAKING

Load = Callable[[Vector, Vector], float]


class VelocityRange(NamedTuple):
    """The joint velocities from which braking in proportion ends within the joint limits.

    Attributes
    ----------
    low, high: (n,) bounds of those that this step can reach [rad/s or m/s].
    least, most: (n,) bounds of all of them, however long it takes to reach them [rad/s or m/s].
    look: `BrakingPath.look` of the longest braking path that this step could begin [s].
    cuts_wish: whether the wish is outside.
    """

    low: Vector
    high: Vector
    least: Vector
    most: Vector
    look: float
    cuts_wish: bool


class JointBounds:
    """The changes that one step can make to the joint velocities.

    Parameters
    ----------
    limits: of the joints.
    dt: length of a step [s].
    load: see `Servo`; None if each joint has its own limits only.

    Attributes
    ----------
    limits, dt: as above.
    acceleration: (n,) that braking is planned with [rad/s^2 or m/s^2]; `braking` the same as numbers.
    change: (n,) by which a velocity can change in a step [rad/s or m/s]; `changes` the same as numbers.
    """

    def __init__(self, limits: JointLimits, dt: float, load: Load | None) -> None:
        self.limits, self.dt, self._load = limits, dt, load
        self.acceleration = BRAKING * limits.acceleration
        self.braking: tuple[float, ...] = tuple(self.acceleration.tolist())
        self.change = limits.acceleration * dt * (1.0 - 1e-9)
        self.changes: tuple[float, ...] = tuple(self.change.tolist())
        columns = limits.lower, limits.upper, limits.velocity, self.change, self.acceleration, 1.0 / self.acceleration
        self._joints = tuple(zip(*(column.tolist() for column in columns), strict=True))
        self.fastest: tuple[float, ...] = tuple(limits.velocity.tolist())
        self._ranges = list(zip(limits.lower.tolist(), limits.upper.tolist(), limits.velocity.tolist(), strict=True))

    @property
    def shares_load(self) -> bool:
        """Whether the joints share a capacity, such as the flow of a pump."""
        return self._load is not None

    def are_kept_at(self, q: Vector) -> bool:
        """Whether no joint of q (n,) is beyond its limits."""
        return all(
            low - TOLERANCE <= x <= up + TOLERANCE for x, (low, up, _) in zip(q.tolist(), self._ranges, strict=True)
        )

    def brake(self, v: Vector) -> Vector:
        """(n,) the next velocity while braking in proportion from v (n,)."""
        time = float((np.abs(v) / self.acceleration).max())
        return v * max(1.0 - self.dt / time, 0.0) if time > 0.0 else v

    def braking_time(self, v: Vector) -> float:
        """Time in which all joints, slowing in proportion from v (n,), come to rest [s]."""
        return float((np.abs(v) / self.acceleration).max())

    def towards(self, wish: Vector, v: Vector) -> Vector:
        """(n,) the next velocity on the straight line from v (n,) to the wish (n,), as far as acceleration allows."""
        return straight_towards(wish, v, self.changes)

    def velocity_range(self, q: Vector, v: Vector, wish: Vector) -> VelocityRange:
        """The velocities that the step from q, v (n,) may have. A joint beyond a limit must come back."""
        return VelocityRange(*reachable_velocities(q, v, wish, self.dt, self._joints, _RATES))

    def changes_of_end(self, q: Vector, v: Vector, end: Vector, look: float) -> Vector:
        """(n,) by how much the end of the braking path can change in a step from q, v (n,) [rad or m].

        end: (n,) of the present one [rad or m]; look: see `VelocityRange` [s].
        """
        return changes_of_end(q, v, end, self.changes, look, self.dt / BRAKING)

    def over_rates(self, q: Vector, v: Vector) -> float:
        """The factor by which joint velocities v (n,) at q (n,) exceed the joints' rates or the load; at least 1."""
        over = largest_part(v, self.fastest)
        return over if self._load is None else max(over, self._load(q.copy(), v.copy()))

    def next_towards(
        self, wish: Vector, q: Vector, v: Vector, *, low: Vector, high: Vector, G: Matrix, h: Vector
    ) -> tuple[Vector, Vector, bool]:
        """(n,), (n,) the next velocity towards the wish, and the same within bounds; whether it keeps bounds and rows.

        The wish is scaled down if it exceeds the joints' rates or the load, and the scaled wish keeps the rows, too.

        Parameters
        ----------
        wish, q, v: (n,) the wished velocity, and the joints' positions and velocities [rad/s or m/s, rad or m].
        low, high: (n,) bounds [rad/s or m/s].
        G, h: (K, n), (K,) of the rows G v <= h.
        """
        load = 1.0 if self._load is None else self._load(q.copy(), wish.copy())
        return next_within(wish, v, low, high, self.changes, self.fastest, load, G, h, TOLERANCE)

    def room_for(self, more: Vector, v: Vector) -> float:
        """The largest part, at most 1, of `more` (n,) that can be added to v (n,) within the joints' rates."""
        part = 1.0
        for add, rate, (_, _, fastest) in zip(more.tolist(), v.tolist(), self._ranges, strict=True):
            if abs(add) * part > 1e-12:
                part = min(part, max(fastest - math.copysign(1.0, add) * rate, 0.0) / abs(add))
        return part


@compiled
def largest_part(v: Vector, fastest: tuple[float, ...], /) -> float:
    """The largest ratio of |v| (n,) to the rates `fastest` of the joints; at least 1."""
    rates: list[float] = v.tolist()
    return max(1.0, *(abs(rate) / most for rate, most in zip(rates, fastest, strict=True)))


@compiled
def straight_towards(wish: Vector, v: Vector, changes: tuple[float, ...], /) -> Vector:
    """(n,) the velocity furthest on the straight line from v (n,) to the wish (n,) if each may change by `changes`."""
    rates = v.tolist()
    change = [wished - rate for wished, rate in zip(wish.tolist(), rates, strict=True)]
    part = 1.0
    for amount, largest in zip(change, changes, strict=True):
        if abs(amount) * part > largest:
            part = largest / abs(amount)
    return np.array([rate + part * amount for rate, amount in zip(rates, change, strict=True)])


@compiled
def next_within(
    wish: Vector, v: Vector, low: Vector, high: Vector, changes: tuple[float, ...], fastest: tuple[float, ...],
    load: float, G: Matrix, h: Vector, tolerance: float, /,
) -> tuple[Vector, Vector, bool]:  # fmt: skip
    """See `JointBounds.next_towards`.

    Parameters
    ----------
    changes, fastest: by how much each velocity may change, and the rates of the joints [rad/s or m/s].
    load: the part of the joints' shared capacity that the wish needs.
    """
    over = max(1.0, load, *(abs(rate) / most for rate, most in zip(wish.tolist(), fastest, strict=True)))
    if over > 1.0 and not np.count_nonzero(G.dot(wish / over) > h + tolerance):
        wish = wish / over
    target = straight_towards(wish, v, changes)
    after = np.minimum(np.maximum(target, low), high)
    off = float(np.abs(after - target).max())
    return target, after, off <= tolerance and not np.count_nonzero(G.dot(after) > h + tolerance)


@compiled
def changes_of_end(
    q: Vector, v: Vector, end: Vector, changes: tuple[float, ...], look: float, later: float, /
) -> Vector:
    """(n,) by how much the end of the braking path can change; see `JointBounds.changes_of_end`, `later` in [s]."""
    joints = zip(q.tolist(), v.tolist(), end.tolist(), changes, strict=True)
    # the end moves with the step, and with the change of velocity
    by = [abs(q + rate * look - end) + look * change + abs(rate) * later for q, rate, end, change in joints]
    return np.array(by)


@compiled
def reachable_velocities(
    q: Vector, v: Vector, wish: Vector, dt: float, joints: tuple[tuple[float, ...], ...], rates: tuple[float, ...], /
) -> tuple[Vector, Vector, Vector, Vector, float, bool]:
    """The fields of `VelocityRange` for a step of dt [s] from q, v (n,).

    Parameters
    ----------
    joints: for each of n joints its limits, its largest velocity, by how much its velocity can change in a step, the
        acceleration that braking is planned with, and the reciprocal of that.
    rates: RECOVERY, SLOWEST_RECOVERY, FASTEST_RECOVERY, TOLERANCE and BRAKING.
    """
    recovery, slowest, quickest, tolerance, braking = rates
    before = v.tolist()
    time = max([abs(rate) * joint[5] for rate, joint in zip(before, joints, strict=True)])
    look = dt + 0.5 * (time + dt / braking)
    lows, highs, reached_low, reached_high = [], [], [], []
    tight = cut = False
    each = zip(q.tolist(), before, wish.tolist(), joints, strict=True)
    for position, rate, wished, (lower, upper, fastest, change, _, _) in each:
        above, below, room = upper - position, position - lower, fastest * look
        high = fastest if above > room else above / look
        low = -fastest if below > room else -below / look
        down, up = rate - change, rate + change
        if above < -tolerance:
            high = -min(max(-recovery * above, slowest), quickest)
            low = min(low, high)
        elif below < -tolerance:
            low = min(max(-recovery * below, slowest), quickest)
            high = max(low, high)
        elif high < down or low > up:
            tight = True
        if wished > high + tolerance or wished < low - tolerance:
            cut = True
        highs.append(high)
        lows.append(low)
        reached_low.append(down if low < down else up if low > up else low)
        reached_high.append(down if high < down else up if high > up else high)
    if tight:
        # a joint needs all that is left of its range to brake: the others must not make its braking path longer
        caps = [joint[4] * max(time - dt, 0.0) for joint in joints]
        highs = [min(high, cap) for high, cap in zip(highs, caps, strict=True)]
        lows = [max(low, -cap) for low, cap in zip(lows, caps, strict=True)]
        changes = np.array([joint[3] for joint in joints])
        reached_low = np.clip(lows, v - changes, v + changes).tolist()
        reached_high = np.clip(highs, v - changes, v + changes).tolist()
    return np.array(reached_low), np.array(reached_high), np.array(lows), np.array(highs), look, cut
