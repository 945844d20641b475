"""Conditions to be kept along a whole motion, such as the pitch of a full bucket."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector, as_array, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.machine import Robot, TipTarget, tip_travel_bound
from backhoe_planner.motion.keeping.conditions import KEPT_TO, Condition, PitchBand
from backhoe_planner.motion.keeping.cones import Cone

_SEARCHED = 0.9  # part of a cone that inverse kinematics uses; chosen, so that rounding never leaves it
TO_THE_RIM = 0.9999  # the same where that part has no room; chosen: the rest is more than inverse kinematics is off
_NEWTON = 20  # steps of a projection; chosen: near the solution, each step doubles the correct digits
# rad or m inside the allowed range that a projection aims for, if its middle is not nearer; chosen, more than a step
# misses near it
_INTO = 1e-4
_DAMPED = 1e-9  # damping of a projection, rad^2 or m^2; chosen: far below the effect of any joint
_LONGEST_STEP = 0.5  # rad or m of a joint in one step of a projection; chosen: beyond it the gradient says little
_MOST_PARTS = 256  # parts of one straight motion; chosen: a motion still undecided is too tight to be worth more


class Keep:
    """All conditions to be kept along a motion.

    Parameters
    ----------
    robot: the machine.
    conditions: at least one.

    Attributes
    ----------
    conditions: all of them.
    band: the condition on the pitch, None if the pitch is free.
    cones: the conditions on angles of the orientation, in which no configuration is by chance.

    A planner needs `margins` and `gradients` of a configuration, `segment_holds` of a straight
    motion of the joints, and `narrowed` for the target of inverse kinematics.
    """

    def __init__(self, robot: Robot, conditions: Sequence[Condition]) -> None:
        self.robot = check_kind(robot, Robot, key="robot")
        given = tuple(check_kind(conditions, Iterable, key="conditions"))  # type: ignore[type-abstract]
        if not given:
            raise InputError("are too few", key="conditions", found=0, allowed="1 or more")
        for index, one in enumerate(given):
            if not isinstance(one, Condition):
                raise InputError("is no condition", key=f"conditions[{index}]", found=type(one).__name__)
        self.conditions: tuple[Condition, ...] = given
        self.band = next((one for one in self.conditions if isinstance(one, PitchBand)), None)
        self.cones = tuple(one for one in self.conditions if isinstance(one, Cone))
        self._travel = tip_travel_bound(robot)
        # as long as `rows_each`: a band has a row for each of its ends
        self._into = np.concatenate([np.full(1 + isinstance(one, PitchBand), _into(one)) for one in given])

    def margins(self, q: Vector) -> Vector:
        """(K,) margins of all conditions at the joints `q` (n,), 0 or more if they hold [rad or m]; smooth in `q`."""
        return self.rows_each(self.robot.check_q(q)[None])[0][0]  # type: ignore[no-any-return]

    def gradients(self, q: Vector) -> Matrix:
        """(K, n) gradients of `margins` with respect to the joints."""
        return self.rows_each(self.robot.check_q(q)[None])[1][0]  # type: ignore[no-any-return]

    def rows_each(self, q: Matrix) -> tuple[Matrix, Array]:
        """(N, K) `margins` at each of `q` (N, n), and their (N, K, n) `gradients`."""
        q = as_array(q, None, self.robot.n, key="q")
        margins, gradients = zip(*(condition.rows(q) for condition in self.conditions), strict=True)
        return np.concatenate(margins, axis=1), np.concatenate(gradients, axis=1)

    def facets_each(self, q: Matrix) -> tuple[Matrix, Array, Indices]:
        """(N, K) margins at each of `q` (N, n) in several directions of every cone, and their (N, K, n) gradients.

        The least margin of a condition is that of `margins`. The third result has the index of the condition of each
        row, (K,).
        """
        q = as_array(q, None, self.robot.n, key="q")
        margins, gradients = zip(*(condition.facets(q) for condition in self.conditions), strict=True)
        owner = np.repeat(np.arange(len(margins)), [each.shape[1] for each in margins])
        return np.concatenate(margins, axis=1), np.concatenate(gradients, axis=1), owner

    def holds(self, q: Vector) -> bool:
        """Whether every condition holds at the joints `q` (n,)."""
        return bool(self.holds_each(self.robot.check_q(q)[None, :])[0])

    def holds_each(self, q: Matrix) -> Flags:
        """(N,) whether every condition holds at each of `q` (N, n)."""
        q = as_array(q, None, self.robot.n, key="q")
        return np.asarray(np.all([one.margins(one.values(q)) >= -KEPT_TO for one in self.conditions], axis=0))

    def broken(self, q: Vector) -> str:
        """The conditions that do not hold at the joints `q` (n,), in words; empty if all hold."""
        found = []
        at = self.robot.check_q(q)[None, :]
        for condition in self.conditions:
            value = condition.values(at)
            if float(condition.margins(value)[0]) < -KEPT_TO:
                found.append(condition.describe(float(value[0])))
        return " and ".join(found)

    def segment_holds(self, q_a: Vector, q_b: Vector) -> bool:
        """Whether all conditions are proven to hold on the straight motion from `q_a` (n,) to `q_b` (n,)."""
        q_a, q_b = self.robot.check_q(q_a, what="q_a"), self.robot.check_q(q_b, what="q_b")
        return all(self._holds_between(condition, q_a, q_b) for condition in self.conditions)

    def motion_holds(self, q: Matrix) -> bool:
        """Whether all conditions are proven to hold on straight motions through `q` (T, n)."""
        q = as_array(q, None, self.robot.n, key="q")
        return self.holds(q[0]) and all(self.segment_holds(a, b) for a, b in pairwise(q))

    def corner_holds(self, q_a: Vector, corner: Vector, q_b: Vector, *, sagitta: Vector) -> bool:
        """Whether all is proven to hold on the parabola from `q_a` to `q_b` whose end tangents meet at `corner`.

        Parameters
        ----------
        sagitta: (n,) how far the joints may be off the parabola [rad or m].
        """
        check_q = self.robot.check_q
        q_a, q_b, corner = check_q(q_a, what="q_a"), check_q(q_b, what="q_b"), check_q(corner, what="corner")
        sagitta = check_q(sagitta, what="sagitta")
        return all(
            # a band of the pitch is convex in the joints, and parabola and chords are within the triangle
            self._holds_between(one, q_a, corner) and self._holds_between(one, corner, q_b)
            if isinstance(one, PitchBand)
            else self._holds_round(one, q_a, corner, q_b, sagitta)
            for one in self.conditions
        )

    def widened(self, q: Vector) -> Keep:
        """The same conditions, each widened by as much as the joints `q` (n,) miss it, and no more."""
        at = self.robot.check_q(q)[None, :]
        missed = [max(-float(one.margins(one.values(at))[0]), 0.0) for one in self.conditions]
        return Keep(
            self.robot,
            [
                one.widened(self.robot, by + KEPT_TO) if by > 0.0 else one
                for one, by in zip(self.conditions, missed, strict=True)
            ],
        )

    def with_narrower_cone(self, by: float) -> Keep | None:
        """The same conditions, with every cone narrower by `by` [rad]; None if that is most of one."""
        by = as_number(by, key="by", least=0.0)
        if not self.cones or any(2.0 * by > one.usable for one in self.cones):
            return None
        return Keep(
            self.robot, [one.widened(self.robot, -by) if isinstance(one, Cone) else one for one in self.conditions]
        )

    def with_wider_cones(self, least: float) -> Keep:
        """The same conditions, with every cone in which less than `least` [rad] is usable as wide as that."""
        least = as_number(least, key="least", least=0.0, most=np.pi)
        return Keep(
            self.robot,
            [
                one.widened(self.robot, least - one.usable) if isinstance(one, Cone) and one.usable < least else one
                for one in self.conditions
            ],
        )

    def project(self, q: Vector, lower: Vector, upper: Vector) -> Vector | None:
        """A configuration (n,) near `q` (n,) where all conditions hold, within `lower` and `upper` (n,), or None.

        Takes Newton steps of least length on the conditions that do not hold, to a little inside the allowed range.
        """
        lower, upper = as_vector(lower, self.robot.n, key="lower"), as_vector(upper, self.robot.n, key="upper")
        found = np.clip(self.robot.check_q(q), lower, upper)
        for _ in range(_NEWTON):
            of_each = [condition.rows(found[None]) for condition in self.conditions]
            margins = np.concatenate([margin[0] for margin, _ in of_each])
            if margins.min() >= -KEPT_TO:
                return found
            rows = margins < 0.0
            G = np.concatenate([gradient[0] for _, gradient in of_each])[rows]
            step = least_step_unchecked(G, (self._into - margins)[rows])
            longest = float(np.max(np.abs(step), initial=0.0))
            found = np.clip(found + step * min(1.0, _LONGEST_STEP / max(longest, _LONGEST_STEP)), lower, upper)
        return found if self.holds(found) else None

    def narrowed(self, target: TipTarget, *, to_the_rim: bool = False) -> TipTarget | None:
        """The target combined with the conditions, as far as a target can express them; None if they contradict.

        to_the_rim: whether all of a cone may be used, not just the part in which a search has room.
        """
        check_kind(target, TipTarget, key="target")
        part = TO_THE_RIM if to_the_rim else _SEARCHED
        for condition in self.conditions:
            if isinstance(condition, PitchBand) and target.rotation is None:
                pitch = _common(target.pitch, (condition.low + condition.room, condition.high - condition.room))
                if pitch is None:
                    return None
                target = replace(target, pitch=pitch)
            elif isinstance(condition, Cone):
                within = condition.narrowed(target, part * condition.usable)
                if within is None:
                    return None
                target = within
        return target

    def _holds_between(self, condition: Condition, q_a: Vector, q_b: Vector) -> bool:
        delta = q_b - q_a
        ends = condition.values(np.array([q_a, q_b]))
        if float(np.min(condition.margins(ends))) < -KEPT_TO:
            return False
        places, values = np.array([0.0, 1.0]), ends
        while True:
            parts = np.diff(places)[:, None] * delta
            bounds = condition.lower_bounds(values[:-1], values[1:], parts, self._travel)
            open_ = bounds < -KEPT_TO
            if not open_.any():
                return True
            if isinstance(condition, PitchBand) or len(places) > _MOST_PARTS:
                return False  # the bound of a pitch is exact: halving would not change it
            middles = 0.5 * (places[:-1] + places[1:])[open_]
            measured = condition.values(q_a + middles[:, None] * delta)
            if float(np.min(condition.margins(measured))) < -KEPT_TO:
                return False
            places = np.append(places, middles)
            order = np.argsort(places)
            places, values = places[order], np.append(values, measured)[order]

    def _holds_round(self, condition: Condition, q_a: Vector, corner: Vector, q_b: Vector, sagitta: Vector) -> bool:
        first, second = corner - q_a, q_b - corner
        lever = condition.lever(self._travel)
        spare = float(lever @ sagitta)
        change = float(lever @ (2.0 * np.maximum(np.abs(first), np.abs(second))))  # dq/dt is linear in t
        places = np.array([0.0, 1.0])
        while len(places) <= _MOST_PARTS:
            t = places[:, None]
            values = condition.values(q_a + t * (2.0 * first + t * (second - first)))
            margins = condition.margins(values) - spare
            if float(np.min(margins)) < -KEPT_TO:
                return False
            open_ = 0.5 * (margins[:-1] + margins[1:] - change * np.diff(places)) < -KEPT_TO
            if not open_.any():
                return True
            places = np.sort(np.append(places, (0.5 * (places[:-1] + places[1:]))[open_]))
        return False


def least_step_unchecked(G: Matrix, missing: Vector) -> Vector:
    """(n,) the shortest step by which values with gradients G (K, n) grow by what is `missing` (K,), to first order."""
    if len(G) == 1:
        return np.asarray(G[0] * (missing[0] / (G[0].dot(G[0]) + _DAMPED)))
    return np.asarray(G.T @ np.linalg.solve(G @ G.T + _DAMPED * np.eye(len(G)), missing))


def _into(condition: Condition) -> float:
    """How far inside the allowed range a projection onto a condition aims [rad or m]: not beyond its middle."""
    if isinstance(condition, PitchBand):
        return min(_INTO, 0.5 * max(condition.half, 0.0))
    return min(_INTO, 0.5 * condition.usable) if isinstance(condition, Cone) else _INTO


def _common(asked: tuple[float, float] | None, kept: tuple[float, float]) -> tuple[float, float] | None:
    """The part of the `asked` range of pitches within the `kept` one [rad]; None if there is none. Pitches wrap."""
    low, high = kept
    if low > high:
        return None
    if asked is None:
        return kept
    for turn in (0.0, 2.0 * np.pi, -2.0 * np.pi):
        begin, end = max(asked[0] + turn, low), min(asked[1] + turn, high)
        if begin <= end:
            return begin, end
    return None
