"""The least time in which the joints get from rest at one place to rest at another.

It holds for every motion that the certificate accepts, so the certificate's tolerances for
sampled motions are added to the limits. With the period S of `SAMPLE_PERIOD`, a motion of the
duration T, and a limit a of the acceleration, no segment of the motion is faster than

    u <= a (t + 3 S / 2),    u <= a (T - t + 3 S / 2)          at any time t on it,

because each corner changes the velocity by at most a times the lesser of S and the adjacent half
segments, at the ends a whole one. Summed up over the segments, a joint gets no further than
a S^2 beyond a continuous motion of the duration T + S: the segments within S / 2
of either end of a ramp count twice, which gives the a S^2.

The oil that a cylinder takes from one joint position to another is the integral of its piston's
area over the rod's travel. However the other joints move, this joint passes every position
between. The certificate checks the flow at least every 0.025 rad of a joint, in the middle between
two such moments; the error of the midpoint rule is at most f'' d^3 / 24, and is subtracted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.machine import Hydraulics
from backhoe_planner.motion import DRIVE_TOLERANCE, SAMPLE_PERIOD, Problem
from backhoe_planner.native import compiled
from backhoe_planner.proof.limits import JOINTS_WITHIN

_LATE = 1.5 * SAMPLE_PERIOD  # s by which a sampled motion may be ahead of its ramps
_LOOKED_AT = 0.025  # rad or m of a joint between two moments at which the certificate checks the drive
_GRID = 0.004  # rad or m, step of the tables over a joint's range; chosen, well below `_LOOKED_AT`
_ABOVE = 1.0001  # times the greatest value at a grid point: values between grid points exceed it by less
_MOMENTS = 2000  # of a table over time; chosen: the bound loses a four-thousandth of the longest time
_MOST_TOGETHER = 4  # joints of which all combinations are considered; with more, each alone and all together
_REMEMBERED = 64  # latest needs that are kept, 2 MB; chosen: a plan uses some six of each joint several times
_ROUNDING = 1e-9  # part of the greatest need; far above the rounding of the sums
_BESIDE = 1e-6  # rad or m by which the certificate lets a joint be outside of its range; see `JOINTS_WITHIN`


@dataclass(frozen=True, eq=False)
class _Side:
    """What a joint needs to move away from its start to one side.

    Attributes
    ----------
    offset: (K,) distances from the start [rad or m], from 0.
    need: (K,) lower bound of the oil [m^3], or of the time at the valves' greatest speed [s].
    most: the greatest need per rad or m anywhere in the range.
    """

    offset: Vector
    need: Vector
    most: float

    def at(self, gap: Array) -> Array:
        """The need for a distance `gap`."""
        return np.asarray(np.interp(gap, self.offset, self.need))

    def reach(self, need: Array) -> Array:
        """The greatest distance for which `need` is enough [rad or m]."""
        # where the need does not rise for a while, the furthest distance counts
        rising = self.need + _ROUNDING * self.need[-1] * np.linspace(0.0, 1.0, len(self.need))
        found = np.interp(need + _ROUNDING * self.need[-1], rising, self.offset)
        return np.asarray(np.where(need >= self.need[-1], np.inf, found))


_Needs = tuple[tuple[_Side, _Side], tuple[_Side, _Side]]


@dataclass(frozen=True, eq=False)
class _Supply:
    """The most of a resource that a motion can use by time t in its first half: H(t); so 2 H(T / 2) in a duration T.

    Attributes
    ----------
    time: (K,) [s]; amount: (K,) never below H.
    """

    time: Vector
    amount: Vector

    def duration(self, need: Array) -> Array:
        """The least duration that gives `need` [s]; at most that of the table."""
        return np.asarray(2.0 * np.interp(0.5 * need, self.amount, self.time))

    def within(self, duration: Array) -> Array:
        """The most that a motion of `duration` [s] can have."""
        return np.asarray(2.0 * np.interp(0.5 * duration, self.time, self.amount))


class LeastTimes:
    """The least times from one configuration, for one problem's limits.

    Parameters
    ----------
    start: (n,) the configuration at rest at the start [rad or m].
    longest: the longest time that is considered [s]; it is the result if a motion needs more.
    """

    def __init__(self, problem: Problem, start: Vector, *, longest: float) -> None:
        limits = problem.limits
        self.start, self.longest = start, longest
        self._v, self._a = limits.velocity * (1.0 + JOINTS_WITHIN), limits.acceleration * (1.0 + JOINTS_WITHIN)
        self.lower, self.upper = limits.lower - _BESIDE, limits.upper + _BESIDE
        self._hydraulics = problem.robot.hydraulics
        self._oil: dict[int, tuple[_Side, _Side]] = {}  # for every joint with a cylinder: upwards, downwards
        self._slow: dict[int, tuple[_Side, _Side]] = {}
        self._supplies: dict[tuple[tuple[int, ...], tuple[int, ...]], _Supply] = {}
        self._valves: dict[tuple[int, int], _Supply] = {}
        if self._hydraulics is not None:
            self._flow = self._hydraulics.pump_flow * (1.0 + DRIVE_TOLERANCE)
            for joint in sorted(set(self._hydraulics.joint_of.tolist())):
                self._oil[joint], self._slow[joint] = self._needs(self._hydraulics, joint)
        self._halves = np.linspace(0.0, 0.5 * longest, _MOMENTS + 1)
        self._steps = np.diff(self._halves)
        self._rates = np.minimum(self._v[:, None], self._a[:, None] * (self._halves + _LATE))  # (n, K) of the joints
        self._all_amounts = np.zeros((3 ** len(self._oil) if len(self._oil) <= _MOST_TOGETHER else 0, _MOMENTS + 1))
        self._known_ways: set[int] = set()  # of boxes, whose supplies are in the table

    def to_boxes(self, lower: Matrix, upper: Matrix) -> Vector:
        """(B,) lower bound of the time from the start to rest in the box `lower` .. `upper` (B, n) [s]."""
        gap = np.maximum(np.maximum(lower - self.start, self.start - upper), 0.0)
        found = self._alone(gap).max(axis=1)
        if self._oil:
            side = np.where(lower > self.start, 0, np.where(upper < self.start, 1, 2))
            self._by_valves(found, side, gap)
            self._by_pump(found, side, gap)
        return np.asarray(np.minimum(found, self.longest))

    def _by_valves(self, found: Vector, side: Indices, gap: Matrix) -> None:
        """Raise the times `found` (B,) to those that the valves allow each joint by itself."""
        for joint, sides in self._slow.items():
            for way in (0, 1):
                rows = np.flatnonzero(side[:, joint] == way)
                need = sides[way].at(gap[rows, joint])
                found[rows] = np.maximum(found[rows], self._valve(joint, way).duration(need))

    def _by_pump(self, found: Vector, side: Indices, gap: Matrix) -> None:
        """Raise the times `found` (B,) to those that the pump allows the joints together."""
        needs = {
            joint: np.where(side[:, joint] == 0, up.at(gap[:, joint]), down.at(gap[:, joint]))
            for joint, (up, down) in self._oil.items()
        }
        joints = list(self._oil)
        if len(joints) <= _MOST_TOGETHER:
            way = np.ascontiguousarray(np.where(side[:, joints] < 2, side[:, joints] + 1, 0))
            need = np.column_stack([needs[joint] for joint in joints])
            np.maximum(found, least_supplied(need, way, self._amounts(way), self._halves), out=found)
            return
        for some, all_move in self._together(side):
            ways = side[:, some]
            need = np.sum([needs[joint] for joint in some], axis=0)
            code = ways @ (1 << np.arange(len(some)))
            for one in np.unique(code[all_move]).tolist():
                rows = np.flatnonzero(all_move & (code == one))
                supply = self._supply(some, tuple(ways[rows[0]].tolist()))
                found[rows] = np.maximum(found[rows], supply.duration(need[rows]))

    def _amounts(self, way: Indices) -> Matrix:
        """(3^J, K) the amounts of all supplies that occur with the ways of boxes (B, J), see `least_supplied`."""
        joints, power = list(self._oil), 3 ** np.arange(way.shape[1])
        for pattern in set((way @ power).tolist()) - self._known_ways:
            self._known_ways.add(pattern)
            digits = pattern // power % 3
            for some in _combinations(np.flatnonzero(digits).tolist()):
                row = int(digits[list(some)] @ power[list(some)])
                if not self._all_amounts[row, -1]:
                    ways = tuple((digits[list(some)] - 1).tolist())
                    self._all_amounts[row] = self._supply(tuple(joints[k] for k in some), ways).amount
        return self._all_amounts

    def _together(self, side: Indices) -> Iterator[tuple[tuple[int, ...], Flags]]:
        """Many joints that are considered together, and (B,) the boxes for which all of these move."""
        joints = list(self._oil)
        moves = side[:, joints] < 2
        for mask in np.unique(moves, axis=0):
            rows = (moves == mask).all(axis=1)
            moving = [joint for joint, asked in zip(joints, mask.tolist(), strict=True) if asked]
            yield from ((some, rows) for some in _combinations(moving))

    def reach(self, duration: Vector) -> tuple[Matrix, Matrix]:
        """(K, n), (K, n) how far each joint can move down and up, and stop, in `duration` (K,) [rad or m]."""
        peak = np.minimum(self._v, 0.5 * self._a * (duration[:, None] + SAMPLE_PERIOD))
        with np.errstate(divide="ignore", invalid="ignore"):
            ramp = np.where(peak > 0.0, peak / self._a, 0.0)
        most = peak * (duration[:, None] + SAMPLE_PERIOD - ramp) + self._a * SAMPLE_PERIOD**2
        down, up = most.copy(), most
        for joint in self._oil:
            for way, reached in enumerate((up, down)):
                for side, supply in (
                    (self._slow[joint][way], self._valve(joint, way)),
                    (self._oil[joint][way], self._supply((joint,), (way,))),
                ):
                    reached[:, joint] = np.minimum(reached[:, joint], side.reach(supply.within(duration)))
        return (
            np.minimum(down, np.maximum(self.start - self.lower, 0.0)),
            np.minimum(up, np.maximum(self.upper - self.start, 0.0)),
        )

    def _alone(self, gap: Array) -> Array:
        """(B, n) least time of each joint by itself, over the distance `gap` (B, n) [s]."""
        way = np.maximum(gap - self._a * SAMPLE_PERIOD**2, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            short = 2.0 * np.sqrt(way / self._a)
            found = np.where(way * self._a <= self._v**2, short, way / self._v + self._v / self._a)
        return np.asarray(np.where(way > 0.0, np.maximum(found - SAMPLE_PERIOD, 0.0), 0.0))

    def _needs(self, hydraulics: Hydraulics, joint: int) -> _Needs:
        """A joint's need of oil, and of time at the valves' greatest speed, each upwards and downwards."""
        most = (self._v[joint] + 1e-3) * (self.longest + SAMPLE_PERIOD)
        up, down = (min(most, max(room, 0.0)) for room in (self.upper[joint] - self.start[joint],
                                                          self.start[joint] - self.lower[joint]))  # fmt: skip
        return _needs_within(hydraulics, tuple(self.start.tolist()), joint, float(up), float(down))

    def _supply(self, joints: tuple[int, ...], ways: tuple[int, ...]) -> _Supply:
        """The oil that these `joints` can take, each moving in its direction in `ways`."""
        if (joints, ways) not in self._supplies:
            most = [self._oil[joint][way].most for joint, way in zip(joints, ways, strict=True)]
            self._supplies[joints, ways] = self._table_of(self._flow, list(joints), most)
        return self._supplies[joints, ways]

    def _valve(self, joint: int, way: int) -> _Supply:
        """The time at the valves' greatest speed that a joint can have; it grows no faster than time itself."""
        if (joint, way) not in self._valves:
            self._valves[joint, way] = self._table_of(1.0, [joint], [self._slow[joint][way].most])
        return self._valves[joint, way]

    def _table_of(self, limit: float, joints: list[int], most: list[float]) -> _Supply:
        rate = np.zeros(len(self._halves))
        for joint, per_joint in zip(joints, most, strict=True):
            rate += per_joint * self._rates[joint]
        np.minimum(rate, limit, out=rate)
        # the rate grows, so that the later of two neighbouring rates is never too low
        amount = np.zeros(len(rate))
        np.cumsum(rate[1:] * self._steps, out=amount[1:])
        return _Supply(self._halves, amount)


@lru_cache(maxsize=_REMEMBERED)
def _needs_within(hydraulics: Hydraulics, start: tuple[float, ...], joint: int, up: float, down: float) -> _Needs:
    """The needs of a joint over the distances `up` and `down` from `start` (n,) [rad or m]; see `LeastTimes._needs`."""
    offsets = [np.linspace(0.0, end, int(np.ceil(end / _GRID)) + 2) for end in (up, down)]
    below, above = start[joint] - offsets[1][::-1], start[joint] + offsets[0]
    swept: tuple[list[Vector], list[Vector]] = ([], [])
    slow: tuple[list[Vector], list[Vector]] = ([], [])
    for way, sign in enumerate((1.0, -1.0)):
        for x in (above, below):
            q = np.tile(start, (len(x), 1))
            q[:, joint] = x
            v = np.zeros_like(q)
            v[:, joint] = sign
            swept[way].append(np.nan_to_num(hydraulics.total_flow(q, v)))
            limit = hydraulics.velocity_limits(q)
            speed = (limit.positive if way == 0 else limit.negative)[:, joint]
            slow[way].append(np.nan_to_num(1.0 / ((1.0 + DRIVE_TOLERANCE) * speed)))
    found = []
    for upwards, downwards in (swept, slow):
        # integrate upwards above the start, downwards below it; the greatest value is over the whole range
        most = [_ABOVE * max(float(np.max(part)) for part in way) for way in (upwards, downwards)]
        found.append((
            _Side(offsets[0], _integral(offsets[0], upwards[0]), most[0]),
            _Side(offsets[1], _integral(offsets[1], downwards[1][::-1]), most[1]),
        ))  # fmt: skip
    return found[0], found[1]


@compiled
def least_supplied(need: Matrix, way: Indices, amounts: Matrix, time: Vector, /) -> Vector:
    """(B,) the least durations in which J joints get what they need from one supply, by all sets of joints that move.

    Parameters
    ----------
    need: (B, J) of each joint.
    way: (B, J) 1 for upwards, 2 for downwards, 0 for a joint that need not move.
    amounts: (3^J, K) what each set of joints can have by a `time` in the first half of a motion, never decreasing; the
        set with `way` has the row sum_j way_j 3^j, with 0 for those that are not in it.
    time: (K,) [s].
    """
    found = np.zeros(len(need))
    power = 3 ** np.arange(way.shape[1])
    for count in range(1, way.shape[1] + 1):
        for some in combinations(range(way.shape[1]), count):
            columns = list(some)
            moving = np.flatnonzero((way[:, columns] > 0).all(axis=1))
            rows = way[moving][:, columns] @ power[columns]
            for row in np.unique(rows).tolist():
                here = moving[rows == row]
                asked = np.sum([need[here, joint] for joint in columns], axis=0)
                found[here] = np.maximum(found[here], 2.0 * np.interp(0.5 * asked, amounts[row], time))
    return found


def _integral(x: Vector, density: Vector) -> Vector:
    """(K,) lower bound of the need up to each x (K,), if `density` (K,) is needed per rad or m."""
    step = x[1] - x[0]
    if step == 0.0:
        return np.zeros(len(x))
    bend = np.zeros(len(x))
    bend[1:-1] = np.abs(np.diff(density, 2)) / step**2 if len(x) > 2 else 0.0
    reach = int(np.ceil(_LOOKED_AT / step))
    bend = _greatest_beside(bend, reach + 1)
    sure = density - bend * (_LOOKED_AT**2 / 24.0 + step**2 / 12.0)
    sure = np.where(_greatest_beside((sure < 0.0).astype(float), reach) > 0.0, 0.0, sure)
    total = np.append(0.0, np.cumsum(0.5 * (sure[1:] + sure[:-1]) * step))
    slope = float(np.max(np.abs(np.diff(sure)), initial=0.0)) / step
    return np.asarray(np.maximum(total - slope * step**2 / 8.0, 0.0))


def _greatest_beside(values: Vector, reach: int) -> Vector:
    """(K,) the greatest of `values` (K,) within `reach` places."""
    padded = np.pad(values, reach, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1))


def _combinations(joints: list[int]) -> Iterator[tuple[int, ...]]:
    """The sets of joints that are considered together."""
    if len(joints) > _MOST_TOGETHER:
        yield from ((joint,) for joint in joints)
        yield tuple(joints)
        return
    for count in range(1, len(joints) + 1):
        yield from combinations(joints, count)
