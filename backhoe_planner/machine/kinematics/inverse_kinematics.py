"""Newton-Raphson inverse kinematics within joint limits, for one target or for many.

The iteration is the paper's (q <- q + J^+ (x* - x(q))), with the damping of
Levenberg and Marquardt chosen from the error (Sugihara 2011, "Solvability-Unconcerned
Inverse Kinematics by the Levenberg-Marquardt Method"). Joints that push against a limit
are left out of the step. `solve_batch` runs it for many targets at once, each from a guess
of the caller. `solve_inverse_kinematics` runs it for one target with restarts, and finds
the nearest pose if the target is out of reach.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector, as_count, as_number
from backhoe_planner.errors import check_kind
from backhoe_planner.machine.bounded_minimum import minimum_within
from backhoe_planner.machine.kinematics.kinematics import BatchKinematics, ConfigurationBatch, Kinematics, place_chain
from backhoe_planner.machine.kinematics.target import (
    IMMOVABLE,
    NEAR_HALF_TURN,
    NO_SINE,
    TargetBatch,
    TipTarget,
    movable_rows,
)
from backhoe_planner.machine.robot import Robot
from backhoe_planner.native import compiled

_ITERATIONS = 40  # steps; most searches converge quadratically in a few, damping near singularities slows them down
_ITERATIONS_OF_ONE = 60  # steps: a single target gets more, because nothing else will find it
_LARGEST_STEP = 0.6  # rad or m; chosen: over longer steps the Jacobian changes too much
_STALLED_AT = 0.98  # part of the squared error: a step that leaves more than this is no progress; chosen
_MOST_STALLED = 8  # such steps in a row; fewer would end searches that slide along a limit
_DAMPING = 0.1  # times the squared error (Sugihara's weight)
_MOST_DAMPED_ERROR = 1e-2  # squared error beyond which the damping does not grow; chosen, an error of 0.1 m
_LEAST_DAMPING = 1e-12  # keeps the equations solvable if no joint can move a row
# what a compiled search has to know, in the order of its record
_SETTINGS = (
    _STALLED_AT, float(_MOST_STALLED), _DAMPING, _MOST_DAMPED_ERROR, _LEAST_DAMPING, _LARGEST_STEP, IMMOVABLE, NO_SINE,
    NEAR_HALF_TURN,
)  # fmt: skip
_SETTLED = 6  # if no attempt arrives, this many of the best are refined to the nearest pose; chosen


@dataclass(frozen=True)
class InverseKinematics:
    """The configuration that `solve_inverse_kinematics` found, and how near to the target it is.

    Attributes
    ----------
    reached: both errors are within the tolerance.
    q: (n,) the solution [rad or m]; if not reached, the configuration that comes nearest.
    position_error: [m]
    angle_error: [rad]
    attempts: number of starting points that were tried.
    """

    reached: bool
    q: Vector
    position_error: float
    angle_error: float
    attempts: int


def solve_inverse_kinematics(
    robot: Robot,
    target: TipTarget,
    *,
    start: Vector | None = None,
    rng: np.random.Generator | None = None,
    attempts: int = 60,
    tolerance: float = 1e-8,
    angle_weight: float = 1.0,
) -> InverseKinematics:
    """A configuration within the limits that puts the tip on `target`, or the nearest that is found.

    Parameters
    ----------
    robot: the machine whose tip is placed.
    target: position, and pitch, orientation or tilt if required.
    start: (n,) where the first attempt begins [rad or m]; the middle of the ranges by default.
    rng: draws the other starting points; by default a generator with seed 0.
    attempts: the greatest number of starting points.
    tolerance: on the position error [m] and the angle error [rad].
    angle_weight: if the target is out of reach: the position error that counts as much as an angle error of one
        radian [m]. With a large one, the nearest configuration has almost the required angles.

    Raises
    ------
    InputError: an argument is of the wrong kind; the message names it.
    """
    kinematics, batch = Kinematics(robot), BatchKinematics(robot)
    check_kind(target, TipTarget, key="target")
    rng = np.random.default_rng(0) if rng is None else check_kind(rng, np.random.Generator, key="rng")
    attempts, tolerance = as_count(attempts, key="attempts", least=1), as_number(tolerance, key="tolerance", above=0.0)
    angle_weight = as_number(angle_weight, key="angle_weight", above=0.0)
    guesses = (robot.middle if start is None else robot.check_q(start, what="start"))[None, :]
    ends: list[Vector] = []
    while len(ends) < attempts:
        targets = TargetBatch.of([target] * len(guesses))
        found, reached = solve_batch(batch, targets, guesses, tolerance=tolerance, iterations=_ITERATIONS_OF_ONE)
        if reached.any():
            first = int(np.argmax(reached))
            return InverseKinematics(
                True, found[first], *target.distances(kinematics.at(found[first])), len(ends) + first + 1
            )
        ends += list(found)
        # few at first, because most targets need few; then more and more at once, which is cheaper for each
        count = min(2 * len(ends), attempts - len(ends))
        guesses = np.array([robot.random_q(rng) for _ in range(count)])

    def miss(q: Vector) -> float:
        position, angle = target.distances(kinematics.at(q))
        return position + angle_weight * angle

    settled = [_nearest(target, q, kinematics, angle_weight) for q in sorted(ends, key=miss)[:_SETTLED]]
    q = min(settled, key=lambda q: _squared(target, kinematics, q, angle_weight)[0])
    position, angle = target.distances(kinematics.at(q))
    return InverseKinematics(position <= tolerance and angle <= tolerance, q, position, angle, attempts)


def _nearest(target: TipTarget, start: Vector, kinematics: Kinematics, angle_weight: float) -> Vector:
    """(n,) the configuration near `start` with the least squared error.

    Newton-Raphson would be slow here: if the error stays large, J^T J is far from the second
    derivative of the squared error.
    """
    limits = kinematics.robot.limits
    found = minimum_within(
        lambda q: _squared(target, kinematics, q, angle_weight), start, limits.lower, limits.upper,
        ftol=1e-15, jac=True,
    )  # fmt: skip
    return np.asarray(np.clip(found, limits.lower, limits.upper))


def _squared(target: TipTarget, kinematics: Kinematics, q: Vector, angle_weight: float) -> tuple[float, Vector]:
    """Half the squared error at `q` (n,), with a radian counted as `angle_weight` metres, and (n,) its gradient."""
    at = kinematics.at(q)
    error = target.error(at)
    weighted = error * np.where(np.arange(len(error)) < 3, 1.0, angle_weight**2)
    return 0.5 * float(error @ weighted), -target.jacobian(at).T @ weighted


def solve_batch(
    kinematics: BatchKinematics,
    targets: TargetBatch,
    guesses: Array,
    *,
    tolerance: float = 1e-8,
    iterations: int = _ITERATIONS,
) -> tuple[Array, Flags]:
    """Configurations within the limits that put the tip on B targets, each searched from its own guess.

    There are no restarts: the caller chooses the guesses, so that one batch can yield all
    branches of a solution.

    Parameters
    ----------
    kinematics: of the machine whose tip is placed.
    targets: B targets.
    guesses: (B, n) where each search begins [rad or m]; they are clipped to the limits.
    tolerance: on the norm of the position error [m] and the angle errors [rad] together.
    iterations: the greatest number of steps of one search.

    Returns
    -------
    (B, n) where each search ended [rad or m], and (B,) whether it arrived.
    """
    limits = kinematics.robot.limits
    guesses = np.array(guesses, dtype=float)
    turned = bool(targets.has_rotation.any())
    partly = turned and not targets.has_rotation.all()
    tolerant = targets.position_tolerance.any() or (turned and targets.rotation_tolerance.any())
    if not (partly or tolerant or targets.has_pitch.any() or targets.tilts is not None):
        rotation = np.ascontiguousarray(targets.rotation if turned else targets.rotation[:0])
        return solve_poses(
            guesses, targets.position, rotation, *kinematics.chain, limits.lower, limits.upper,
            (tolerance, *_SETTINGS), iterations,
        )  # fmt: skip
    return _search(kinematics.at, targets, guesses, limits.lower, limits.upper, tolerance, iterations)


@compiled
def solve_poses(
    guesses: Matrix, position: Matrix, rotation: Array, factors: Matrix, slides: Vector, tip: Matrix, lower: Vector,
    upper: Vector, settings: tuple[float, ...], iterations: int, /,
) -> tuple[Array, Flags]:  # fmt: skip
    """`solve_batch` of exact poses, or of positions alone: (B, n) where each search ends, (B,) whether it arrives.

    Parameters
    ----------
    guesses: (B, n); they are clipped to the limits.
    position: (B, 3) [m].
    rotation: (B, 3, 3), or (0, 3, 3) if only positions are asked.
    factors, slides, tip: of the chain, as for `chain_placements`.
    lower, upper: (n,) limits [rad or m].
    settings: the tolerance, then `_SETTINGS`.
    """
    count, turned = len(guesses), len(rotation) > 0
    nothing, none = np.zeros(count), np.zeros(count, dtype=bool)
    targets = TargetBatch(
        position, rotation if turned else np.tile(np.eye(3), (count, 1, 1)), np.full(count, turned), nothing, nothing,
        nothing, nothing, none,
    )  # fmt: skip

    def place(q: Array) -> ConfigurationBatch:
        return place_chain(q, factors, slides, tip, prismatic=slides != 0.0, sense=0.0, pin=None)

    return _search(place, targets, guesses, lower, upper, settings[0], iterations)


def _search(
    place: Callable[[Array], ConfigurationBatch], targets: TargetBatch, guesses: Array, lower: Vector, upper: Vector,
    tolerance: float, iterations: int,
) -> tuple[Array, Flags]:  # fmt: skip
    """`solve_batch`, with the function that places the machine and the limits (n,)."""
    q = np.clip(guesses, lower, upper)
    reached = np.zeros(len(q), dtype=bool)
    # the searches that go on: their numbers, configurations and targets, and below their progress
    going, x, here = np.arange(len(q)), q, targets
    cost_before, stalled = np.full(len(q), np.inf), np.zeros(len(q), dtype=int)
    for iteration in range(iterations + 1):
        if not len(going):
            break
        at = place(x)
        error = here.errors(at)
        cost = np.einsum("bi,bi->b", error, error)
        arrived = np.sqrt(cost) <= tolerance
        reached[going[arrived]] = True
        stalled = np.where(cost > _STALLED_AT * cost_before, stalled + 1, 0)
        cost_before = cost
        # one that is not at numbers ends too: it would drop rows of the other searches' Jacobians
        left = ~arrived & (stalled <= _MOST_STALLED) & (cost < np.inf)
        if iteration == iterations or not left.any():
            break
        J = here.jacobians(at).transpose(1, 2, 0)  # the searches run along the last axis, along which numpy is fast
        if not left.all():
            going, x, here, error, J = going[left], x[left], here.take(left), error[left], J.compress(left, axis=2)
            cost_before, stalled = cost_before[left], stalled[left]
        rows = movable_rows(J.reshape(len(J), -1))
        step = _limited_step(J[rows], error[:, rows], x, lower, upper)
        q[going] = x = np.clip(x + step, lower, upper)
    return q, reached


def _limited_step(J: Array, error: Array, q: Array, lower: Array, upper: Array) -> Array:
    """(B, n) damped Newton steps [rad or m], without joints that are at a limit and would move beyond it.

    J: (m, n, B); error: (B, m); q: (B, n).
    """
    cost = np.einsum("bi,bi->b", error, error)
    damping = np.minimum(cost, _MOST_DAMPED_ERROR) * _DAMPING + _LEAST_DAMPING
    error, q = np.ascontiguousarray(error.T), np.ascontiguousarray(q.T)
    step = damped_steps(J, error, damping)
    at_lower, at_upper = q <= lower[:, None], q >= upper[:, None]
    free = np.ones(q.shape, dtype=bool)
    for _ in range(len(q) - 1 if at_lower.any() or at_upper.any() else 0):
        hit = free & ((at_lower & (step < 0.0)) | (at_upper & (step > 0.0)))
        todo = np.flatnonzero(hit.any(axis=0))
        if not len(todo):
            break
        free &= ~hit
        step[:, todo] = damped_steps(J[:, :, todo] * free[:, todo], error[:, todo], damping[todo])
    step = np.where(free, step, 0.0)
    return np.asarray(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP).T)


@compiled
def damped_steps(J: Array, error: Array, damping: Vector, /) -> Array:
    """(n, B) the steps J^T (J J^T + damping I)^-1 error of J (m, n, B), error (m, B) and damping (B,).

    They are solved by elimination for all B at once, without pivots, which a positive definite matrix does not need.
    """
    count = len(J)
    square = np.einsum("inb,jnb->ijb", J, J)
    square.reshape(count * count, -1)[:: count + 1] += damping
    x = error.copy()
    for row in range(count):
        below = square[row + 1 :, row] / square[row, row]
        square[row + 1 :, row + 1 :] -= below[:, None] * square[row, row + 1 :]
        x[row + 1 :] -= below * x[row]
    for row in range(count - 1, -1, -1):
        x[row] /= square[row, row]
        x[:row] -= square[:row, row] * x[row]
    return np.asarray(np.einsum("inb,ib->nb", J, x))
