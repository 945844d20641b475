"""The safe velocity nearest to a wish: a small QP, and a check of its solution.

    min_v |v - v_w|_W   s.t.   rows of the braking path, rows of evasion

W weighs what the tip notices. The rows are only linear, so the braking path of the solution
is checked; if it is not clear, its rows are added and the problem is solved again.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from backhoe_planner.arrays import Array, Flags, Indices, Matrix, Vector
from backhoe_planner.law import (
    MOST_ITERATIONS,
    MOST_SOFT_ROWS,
    BindingSolution,
    QuadraticProgram,
    Rows,
    StackedRows,
    keeps_rows,
    soft_solution,
    solve_with_binding_rows,
)
from backhoe_planner.live.braking.braking_path import BrakingPath, JointState, PathClearance, braking_line
from backhoe_planner.live.braking.joint_bounds import TOLERANCE, VelocityRange, next_within
from backhoe_planner.live.braking.kept_rows import KeptRows
from backhoe_planner.live.clearance.evasion import Evasion
from backhoe_planner.live.clearance.pair_bounds import Awake, Near
from backhoe_planner.live.clearance.path_check import PathCheck
from backhoe_planner.live.planes.path_rows import rows_of_path
from backhoe_planner.live.recovery.recovery import ATTEMPTS, Recovery, RecoveryStep
from backhoe_planner.live.servo.kept_velocity import breaks, keeping
from backhoe_planner.native import compiled

_BINDING = 1e-5  # rad/s or m/s: a row that is kept with more to spare does not bind; the solver's tolerance is 1e-6
_UNCHANGED = 1e-12  # rad/s or m/s: a solution that differs by less is the same; rounding
_ATTEMPTS_IF_TORN = 2  # as `ATTEMPTS`, if something moves: chosen, the next step corrects again
_FREE = 0.005  # m^2: weight of the null space beside the tip; chosen, small beside the square of an arm's length
_SURE, _SURER = 0.9, 0.5  # parts of the blend at which a path is just clear; chosen, gaps are not quite linear
_LEAST_BLEND = 0.01  # part of the way from braking to a velocity: less is braking
_HELD = _BINDING, TOLERANCE, MOST_SOFT_ROWS, MOST_ITERATIONS
_NONE: Indices = np.zeros(0, dtype=np.intp)


class VelocityWish(NamedTuple):
    """The wished velocity of the joints in a step, and the velocities that they may have.

    Attributes
    ----------
    v: (n,) the wished velocity [rad/s or m/s].
    target: (n,) the next velocity towards v, if nothing is in the way [rad/s or m/s].
    task: (m, n) Jacobian of the wish for the tip; None if the wish is for the joints.
    null: (n,) the part of v in its null space [rad/s or m/s].
    for_tip: whether the wish is for the tip.
    range: the velocities that keep the joint limits.
    kept: the conditions to be kept; None if there are none.
    """

    v: Vector
    target: Vector
    task: Matrix | None
    null: Vector
    for_tip: bool
    range: VelocityRange
    kept: KeptRows | None = None


class SafeVelocity(NamedTuple):
    """The velocity of a step.

    Attributes
    ----------
    v: (n,) [rad/s or m/s].
    held_back: whether something is in the way of the wish.
    evading: whether something that moves is in the way.
    end: (n,) of its braking path [rad or m]; None if the machine brakes on the path of the step before.
    """

    v: Vector
    held_back: bool
    evading: bool
    end: Vector | None


class _NotClear(NamedTuple):
    """A velocity (n,) [rad/s or m/s] whose path is not proven clear after the last correction.

    Also the clearance of that path, and whether something that moves is in the way.
    """

    v: Vector
    clearance: PathClearance
    evading: bool


def velocity_program(
    wish: VelocityWish,
    target: Vector,
    low: Vector,
    high: Vector,
    rows: tuple[Rows, ...],
) -> QuadraticProgram:
    """The problem whose solution is the velocity nearest to `target` (n,), as the tip notices it.

    Only the tip's velocity at the target counts, not that of each joint: otherwise, if one joint
    could not follow, the others would still be driven on.

    Parameters
    ----------
    wish: gives the task and the null space.
    low, high: (n,) bounds of the velocity [rad/s or m/s].
    rows: that the velocity must keep.
    """
    if wish.task is None:
        return QuadraticProgram(_identity(len(target)), -target, low, high, rows)
    return QuadraticProgram(*cost_of_tip(wish.task, target, wish.null, _FREE), low, high, rows)


@lru_cache(maxsize=8)
def _identity(n: int) -> Matrix:
    """(n, n) the identity, read-only."""
    return np.eye(n)


@compiled
def cost_of_tip(task: Matrix, target: Vector, null: Vector, free: float, /) -> tuple[Matrix, Vector]:
    """H (n, n) and f (n,) of the cost 1/2 |task (x - target)|^2 + free/2 |x|^2 - free null^T x, for a task (m, n)."""
    H = task.T.dot(task)
    f = -H.dot(target)
    f -= free * null
    H.reshape(-1)[:: len(H) + 1] += free
    return H, f


@compiled
def velocity_within_rows(
    wish: Vector, task: Matrix | None, null: Vector, free: float, v: Vector, low: Vector, high: Vector, least: Vector,
    most: Vector, G: Matrix, h: Vector, changes: tuple[float, ...], fastest: tuple[float, ...], tolerance: float,
    most_iterations: int, /,
) -> tuple[Vector, int, int] | None:  # fmt: skip
    """(n,) the next velocity from v (n,) towards the part of the wish (n,) that soft rows and bounds allow.

    Also how many programs were solved for it, and the solver's iterations. None if more than that is needed.

    Parameters
    ----------
    task, null, free: of the cost, see `cost_of_tip`; without a task each joint's velocity counts alike.
    low, high: (n,) bounds of the next velocity; least, most: (n,) bounds however long it takes [rad/s or m/s].
    G, h: (K, n), (K,) of the rows G v <= h.
    changes, fastest, tolerance: see `next_within`.
    most_iterations: of the solver for one program.
    """
    steady = _nearest_within(wish, task, null, free, least, most, G, h, most_iterations)
    if steady is None:
        return None
    target, after, keeps = next_within(steady[0], v, low, high, changes, fastest, 1.0, G, h, tolerance)
    if keeps:
        return after, 1, steady[1]
    step = _nearest_within(target, task, null, free, low, high, G, h, most_iterations)
    return None if step is None else (step[0], 2, steady[1] + step[1])


@compiled
def velocity_held_as_before(
    pairs: Indices, gaps: Array, nearest: Indices, least: Matrix, bound: Vector, closely: Indices, required: Vector,
    classes: Indices, off: Vector, budget: Vector, stands: Flags | None, corner_rules: tuple[float, ...],
    planes: Matrix, joint: Indices, other: Indices | None, piece: Indices, corners: Array, mask: Matrix, T: Array,
    J: Array, drift: Vector, parts: int, start: Vector, end: Vector, q: Vector, target: Vector, dt: float,
    acceleration: tuple[float, ...], wish: Vector, task: Matrix | None, null: Vector, free: float, v: Vector,
    low: Vector, high: Vector, lowest: Vector, highest: Vector, changes: tuple[float, ...], fastest: tuple[float, ...],
    for_tip: bool, rules: tuple[float, ...], /,
) -> tuple[Vector | None, bool, int, int, int] | None:  # fmt: skip
    """The `velocity_within_rows` for the rows of the path of a step ago, if the `target` (n,) breaks any of them.

    None if it breaks none. Also whether the null space was left out, because a limit cuts the target of a wish for the
    tip; the number of rows; the programs and iterations. The velocity is None if more is needed.

    Parameters
    ----------
    pairs to parts, start, end: see `rows_of_path`, of the path of a step ago.
    q, target, dt, acceleration: see `braking_line`; they give the path that the rows are to hold for.
    wish to fastest: see `velocity_within_rows`, with `lowest` and `highest` for `least` and `most`.
    rules: the room below which a row binds, the tolerance of limits, and the most rows and iterations.
    """
    binding, tolerance, most_rows, most_iterations = rules
    _, now_end, look, _, slowest, sharper = braking_line(q, target, dt, acceleration)
    _, G, h = rows_of_path(
        pairs, gaps, nearest, least, bound, closely, required, classes, off, budget, stands, corner_rules, planes,
        joint, other, piece, corners, mask, T, J, drift, parts, target, look, slowest, sharper, start, end, q, now_end,
        dt,
    )  # fmt: skip
    if keeps_rows(G, h, target, -binding):
        return None
    is_cut = for_tip and bool(np.logical_or(target < low - tolerance, target > high + tolerance).any())
    if len(h) > most_rows:
        return None, is_cut, len(h), 0, 0
    found = velocity_within_rows(
        wish, task, np.zeros(len(null)) if is_cut else null, free, v, low, high, lowest, highest, G, h, changes,
        fastest, tolerance, int(most_iterations),
    )  # fmt: skip
    return (None, is_cut, len(h), 0, 0) if found is None else (found[0], is_cut, len(h), *found[1:])


def _nearest_within(
    target: Vector, task: Matrix | None, null: Vector, free: float, low: Vector, high: Vector, G: Matrix, h: Vector,
    most_iterations: int,
) -> tuple[Vector, int] | None:  # fmt: skip
    """(n,) the velocity nearest to the target (n,) within the bounds and rows, and the solver's iterations."""
    H, f = (_identity(len(target)), -target) if task is None else cost_of_tip(task, target, null, free)
    solved = soft_solution(H, f, low, high, G, h, most_iterations)
    return None if solved is None else (np.minimum(np.maximum(solved[0], low), high), solved[1])


class VelocityFilter:
    """Chooses velocities whose braking path is proven clear.

    Parameters
    ----------
    check: the check of the machine's braking paths.
    recovery: finds the way out if the machine is closer to something than allowed.

    Attributes
    ----------
    evasion: the rows of what moved in the last step.
    """

    def __init__(self, check: PathCheck, recovery: Recovery) -> None:
        self._joints, self._bounds = check.joints, check.bounds
        self._check, self._recovery = check, recovery
        self._evasion = Evasion(check)
        self.evasion = self._evasion.nothing

    def choose(self, state: JointState, wish: VelocityWish, near: Near) -> SafeVelocity:
        """The velocity nearest to the wish whose braking path is proven clear; braking if there is none."""
        if len(self._bounds.inside) or self._recovery.held_outside(state.q):
            return self._recover(state, wish, near)
        low, high, *_ = wish.range
        awake = self._check.awake(state, wish.range.look)
        self.evasion = self._evasion.find(near, low, high, wish.kept)
        if wish.kept is not None:
            wish = wish._replace(kept=wish.kept._replace(early=self.evasion.early))
        torn = self._is_torn(awake)
        found = self._corrected(state, wish, awake, torn=torn)
        return found if isinstance(found, SafeVelocity) else self._partly(state, wish, awake, found, torn=torn)

    def _is_torn(self, awake: Awake) -> bool:
        """Whether something moves that may demand a velocity which something at rest forbids."""
        bounds = self._bounds
        return bounds.anything_moves and (
            len(self.evasion.rows.h) > 0 or int(np.count_nonzero(bounds.stands.take(awake.pairs))) < len(awake.pairs)
        )

    def _corrected(
        self, state: JointState, wish: VelocityWish, awake: Awake, *, torn: bool
    ) -> SafeVelocity | _NotClear:
        """The velocity nearest to the wish, corrected by the rows of its path until that is clear."""
        check, evasion = self._check, self.evasion.rows
        held_back = evading = False
        straight = None
        held = self._held_as_before(state, wish, evasion, torn=torn)
        if held is not None:
            # what held the machine back a step ago mostly still does: the path at the wish need not be checked first
            start, held_back, evading = 1, True, not evasion.are_kept_by(wish.target, TOLERANCE)
            v, wish = held
        else:
            start = 0
            v, wish = self._within_limits(state, wish)
        most = start + (_ATTEMPTS_IF_TORN if torn else ATTEMPTS)
        for attempt in range(start, most):
            late = not evasion.are_kept_by(v, TOLERANCE)
            path = check.path(state.q, v)
            found = check.clearance(awake, path, by_rows=attempt > 0)
            if (found.free if attempt == 0 else found.clear) and not late:
                return self._accept(path, awake, found, held_back=held_back, evading=evading)
            if attempt == 0 and found.clear and not late:
                straight = path, found
            if attempt and found.stands_clear and self._bounds.anything_moves:
                # one correction a step is enough for moving obstacles: they move on, and the next step corrects again
                return self._accept(path, awake, found, evading=evading)
            nearer = v
            if attempt < most - 1:
                nearer = self._within_rows(state, wish, (*check.rows(awake, path, found, firm=torn), evasion))
                evading |= late
                held_back = True
            if np.count_nonzero(np.abs(nearer - v) < _UNCHANGED) == len(v):
                if found.stands_clear:
                    return self._accept(path, awake, found, evading=evading)
                break
            v = nearer
        if straight is not None:  # only the buffer is missing, and demanding it found nothing better
            return self._accept(straight[0], awake, straight[1], evading=evading)
        return _NotClear(v, found, evading)

    def _partly(
        self, state: JointState, wish: VelocityWish, awake: Awake, missed: _NotClear, *, torn: bool
    ) -> SafeVelocity:
        """The part of the way from braking to a velocity at which what stands is clear; braking if there is none."""
        (v, found, evading), (low, high, *_) = missed, wish.range
        brake = self._braking(state.v)
        brakes = torn and np.abs(v - brake).max() < _UNCHANGED  # that path was checked last
        blend = 0.0 if brakes else self._part_of_the_way(awake, found)
        for part in (_SURE * blend, _SURER * blend) if blend > _LEAST_BLEND else ():
            path = self._check.path(state.q, np.minimum(np.maximum(brake + part * (v - brake), low), high))
            found = self._check.clearance(awake, path)
            if found.stands_clear:
                return self._accept(path, awake, found, evading=evading)
        return SafeVelocity(self._joints.brake(state.v), True, evading, None)

    def _held_as_before(
        self, state: JointState, wish: VelocityWish, evasion: Rows, *, torn: bool
    ) -> tuple[Vector, VelocityWish] | None:
        """The result of `_within_limits` with the rows of the path that was taken a step ago.

        None if there are no rows, or if the wish keeps them.
        """
        check, joints = self._check, self._joints
        if not (torn or len(evasion.h) or joints.shares_load or wish.kept is not None):
            path = check.path_before()
            if path is None:
                return None
            asked: tuple[Any, ...] = (
                *path, state.q, wish.target, joints.dt, joints.braking, wish.v, wish.task, wish.null, _FREE, state.v,
                *wish.range[:4], joints.changes, joints.fastest, wish.for_tip, _HELD,
            )  # fmt: skip
            held = velocity_held_as_before(*asked)
            if held is None:
                return None
            v, is_cut, rows, problems, iterations = held
            if v is not None:
                check.note(BindingSolution(v, _NONE, rows, problems, iterations))
                return v, wish._replace(null=np.zeros(len(v))) if is_cut else wish
        before = check.rows_before(state.q, wish.target, firm=torn)
        if not before or all(block.are_kept_by(wish.target, -_BINDING) for block in (*before, evasion)):
            return None
        return self._within_limits(state, wish, (*before, evasion))

    def _part_of_the_way(self, awake: Awake, found: PathClearance) -> float:
        """The part of the way from braking to a velocity at which static obstacles are just clear, for linear gaps.

        found: the clearance of the velocity's path.
        """
        bounds, pairs = self._bounds, awake.pairs
        short = (found.bound < bounds.required.take(pairs)) & bounds.stands.take(pairs)
        missing = (bounds.required.take(pairs) - found.bound)[short]
        room = np.maximum(bounds.room_of_braking(pairs[short]), 0.0)
        return float((room / (room + missing)).min(initial=1.0))

    def _accept(
        self, path: BrakingPath, awake: Awake, found: PathClearance, *, held_back: bool = True, evading: bool = False
    ) -> SafeVelocity:
        self._bounds.accept(awake.pairs, found)
        if held_back:
            self._check.keep(path)
        else:
            self._check.forget()
        return SafeVelocity(path.v, held_back, evading, path.end)

    def _recover(self, state: JointState, wish: VelocityWish, near: Near) -> SafeVelocity:
        """The velocity of the way out. The distances proven for it must be kept from now on."""
        bounds, clearance = self._bounds, self._check.separation.clearance
        pairs = bounds.inside
        low, high = self._recovery.slow_bounds(state.q, state.v, wish.range.low, wish.range.high)
        awake = self._check.awake(state, wish.range.look)
        self.evasion = self._evasion.find(near, low, high, wish.kept)
        step = RecoveryStep(
            state=state,
            low=low,
            high=high,
            target=np.minimum(np.maximum(wish.target, low), high),
            brake=self._braking(state.v),
            awake=awake,
            evasion=self.evasion.rows,
            kept=wish.kept,
        )
        depth, found = self._recovery.choose(pairs, bounds.stands, step)
        bounds.set_distance(pairs, clearance[pairs] - depth)
        if found is None:
            return SafeVelocity(self._joints.brake(state.v), True, False, None)
        bounds.require(pairs, clearance[pairs] - np.maximum(found.level, 0.0))
        out, bound = self._recovery.clear_again(pairs, found)
        bounds.set_proven(out, bound)
        if len(out):  # from now on these must keep their clearance
            bounds.inside = pairs[~np.isin(pairs, out)]
        return self._accept(found.path, awake, found.clearance)

    def _braking(self, v: Vector) -> Vector:
        """(n,) the next velocity while braking from v (n,), within the change that a step allows."""
        change = self._joints.change
        return np.minimum(np.maximum(self._joints.brake(v), v - change), v + change)

    def _within_limits(
        self, state: JointState, wish: VelocityWish, rows: tuple[Rows, ...] = ()
    ) -> tuple[Vector, VelocityWish]:
        """(n,) the next velocity towards the wish, or towards the part of it that joint limits and rows allow.

        Also the wish, without its null space if a limit cuts it.
        """
        target, (low, high, *_) = wish.target, wish.range
        kept = wish.kept
        if kept is not None and (
            rows or breaks(kept.ahead, target, TOLERANCE) or breaks(kept.early, target, TOLERANCE)
        ):
            return self._within_rows(state, wish, rows), wish
        # a joint that changes by all it can is at its bound, and rounding must not decide on which side
        for rate, least, most in zip(target.tolist(), low.tolist(), high.tolist(), strict=True):
            if not least - TOLERANCE <= rate <= most + TOLERANCE:
                break
        else:
            v = self._within_rows(state, wish, rows) if rows else np.minimum(np.maximum(target, low), high)
            return v, wish
        if wish.for_tip:
            # if each joint were clipped on its own, the others would lead the tip elsewhere
            wish = wish._replace(null=np.zeros(len(target)))
        elif not rows:
            return np.minimum(np.maximum(target, low), high), wish
        return self._within_rows(state, wish, rows), wish

    def _within_rows(self, state: JointState, wish: VelocityWish, rows: tuple[Rows, ...]) -> Vector:
        """(n,) the next velocity towards the part of the wish that rows and limits allow.

        The velocity that can be reached in the end is found first: taking the nearest one in each
        single step, within the joints' accelerations, need not lead there.
        """
        if wish.kept is not None:
            return self._keeping(state, wish, wish.kept, rows)
        low, high, least, most, *_ = wish.range
        stacked, joints = StackedRows.of(rows, len(low)), self._joints
        if stacked.soft == stacked.total <= MOST_SOFT_ROWS and not joints.shares_load:
            found = velocity_within_rows(
                wish.v, wish.task, wish.null, _FREE, state.v, low, high, least, most, stacked.G, stacked.high,
                joints.changes, joints.fastest, TOLERANCE, MOST_ITERATIONS,
            )  # fmt: skip
            if found is not None:
                v, problems, iterations = found
                self._check.note(BindingSolution(v, _NONE, stacked.total, problems, iterations))
                return v
        steady, kept = self._solve(state, velocity_program(wish, wish.v, least, most, rows), stacked)
        target, v, keeps = self._joints.next_towards(
            steady, state.q, state.v, low=low, high=high, G=stacked.G, h=stacked.high
        )
        if keeps:
            return v
        return self._solve(state, velocity_program(wish, target, low, high, rows), stacked, first=kept)[0]

    def _keeping(self, state: JointState, wish: VelocityWish, kept: KeptRows, rows: tuple[Rows, ...]) -> Vector:
        """(n,) as `_within_rows`, among what is `kept` if the rows leave room for it, otherwise as near to it."""
        low, high, least, most, *_ = wish.range
        steady = self._solve_keeping(state, velocity_program(wish, wish.v, least, most, rows), kept)
        everything = StackedRows.of((*rows, kept.ahead), len(low))
        target, v, keeps = self._joints.next_towards(
            steady, state.q, state.v, low=low, high=high, G=everything.G, h=everything.high
        )
        if keeps and not breaks(kept.early, v, TOLERANCE):
            return v
        return self._solve_keeping(state, velocity_program(wish, target, low, high, rows), kept)

    def _solve_keeping(self, state: JointState, program: QuadraticProgram, kept: KeptRows) -> Vector:
        solution = solve_with_binding_rows(keeping(program, kept.ahead, kept.early))
        self._check.note(solution)
        v = self._joints.brake(state.v) if solution is None else solution.x[: len(program.f)]
        return np.minimum(np.maximum(v, program.low), program.high)

    def _solve(
        self, state: JointState, program: QuadraticProgram, stacked: StackedRows, *, first: Indices | None = None
    ) -> tuple[Vector, Indices | None]:
        """(n,) the solution within its bounds, or braking if there is none; and the rows that were kept."""
        solution = solve_with_binding_rows(program, first=first, stacked=stacked)
        self._check.note(solution)
        x = self._joints.brake(state.v) if solution is None else solution.x
        return np.minimum(np.maximum(x, program.low), program.high), None if solution is None else solution.kept
