"""Smooths resolved stretches: removes the grid's steps, within the null space.

A route through the layered graph jumps from grid value to grid value. Here every sample
is moved within its null space, q_k + N_k z_k, so that the cost

    sum_k w_k |q_{k+1} - q_k|^2,  w_k = 1 / (arc length from k to k + 1)

falls: Gauss-Newton on z, a banded system, with the tip put back on the path after each
step. A sample that would come too near to something, or move too far from its neighbour, is
held back by a growing price on its own z. A new stretch is accepted only if it is cheaper,
clear, continuous, and within the limits.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch
from backhoe_planner.motion import Problem, TipPath, step_lengths
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.planning.stretches.kept_cones import kept_targets
from backhoe_planner.planning.stretches.step_bounds import StepBounds
from backhoe_planner.planning.stretches.stretch import NEARER, Stretch
from backhoe_planner.proof import path_segment_is_clear
from backhoe_planner.site import Proximity

Mask = NDArray[np.bool_]

ENOUGH = 1e-3  # relative fall of the cost below which it is not lowered further; chosen
ROOM = 0.005  # m of margin that is not used up; chosen
_ROUNDS = 20  # steps of Gauss-Newton at most; chosen
_LARGEST_MOVE = 0.3  # rad or m that a sample moves in one round; chosen: the null space changes little within it
_LEAST_STEP = 1e-6  # m of arc length: far below any spacing, so that no weight is infinite


def smooth_stretch(
    problem: Problem,
    path: TipPath,
    stretch: Stretch,
    *,
    proximity: Proximity,
    time: float = 0.0,
    free_start: bool = False,
    free_end: bool = False,
    brake: Brake | None = None,
) -> Stretch:
    """A stretch with the same tip positions and a cost that is not higher.

    Parameters
    ----------
    stretch: a clear stretch of `path`.
    time: at which the positions of the obstacles are taken [s].
    free_start, free_end: whether the joints may change at the first and at the last sample too.
    brake: ends the search early; the best so far is kept. By default none.
    """
    brake = brake or Brake()
    q = stretch.q
    if len(q) < 3:
        return stretch
    kinematics = BatchKinematics(problem.robot)
    targets = kept_targets(problem, path, stretch.stations)
    strict = strict_targets(targets)
    weights = 1.0 / step_lengths(stretch.stations, q, least=_LEAST_STEP)
    held = np.zeros(len(q), dtype=bool)
    held[0], held[-1] = not free_start, not free_end
    price = np.zeros(len(q))
    floor = margins_to_keep(_margins(proximity, q, time))
    cost = _cost(weights, q)
    bounds = StepBounds(path, stretch, problem.joint_steps)
    for _ in range(_ROUNDS):
        N = null_bases(kinematics, strict, q)
        if N.shape[2] == 0 or brake.is_used_up():
            break
        z = _step(weights, q, N, price, held)
        moved, reached = solve_batch(kinematics, targets, q + np.einsum("knr,kr->kn", N, z), iterations=8)
        moved[held] = q[held]
        bad = ~(reached | held)
        bad |= _margins(proximity, moved, time, floor=floor) < floor
        bad |= bounds.broken(moved) & ~held
        if not bad.any() and _cost(weights, moved) < cost:
            bad |= _beside_blocked(proximity, moved, time)
            if not bad.any():
                before, q, cost = cost, moved, _cost(weights, moved)
                floor = np.maximum(floor, margins_to_keep(_margins(proximity, q, time)))
                price *= 0.3
                if before - cost < ENOUGH * cost:
                    break
                continue
        price = _raised(price, weights, bad)
    return Stretch(stretch.stations, q)


def _beside_blocked(proximity: Proximity, q: Matrix, time: float) -> Flags:
    """(K,) which of the samples q (K, n) are at an end of a segment that is not clear."""
    blocked = np.array([not path_segment_is_clear(proximity, a, b, time=time) for a, b in pairwise(q)])
    return np.asarray(np.append(blocked, False) | np.append(False, blocked))


def _raised(price: Vector, weights: Vector, bad: Flags) -> Vector:
    """(K,) the prices of moving samples, raised at and beside the `bad` ones (K,); at all samples if none is bad."""
    scale = np.concatenate((weights[:1], np.maximum(weights[1:], weights[:-1]), weights[-1:]))
    near = bad.copy()
    near[:-1] |= bad[1:]
    near[1:] |= bad[:-1]
    rises = near if bad.any() else np.ones(len(bad), dtype=bool)
    return np.where(rises, np.maximum(10.0 * price, 0.1 * scale), price)


def margins_to_keep(margins: Vector) -> Vector:
    """(K,) the margins that samples keep when they are moved [m]: of small `margins` (K,) all but rounding.

    So the certificate accepts them as clear, however often they are moved.
    """
    return np.asarray(np.minimum(margins, np.clip(margins, 0.0, ROOM) - NEARER))


def _cost(weights: Vector, q: Matrix) -> float:
    return float(np.sum(weights * np.sum(np.diff(q, axis=0) ** 2, axis=1)))


def strict_targets(targets: TargetBatch) -> TargetBatch:
    """The targets without the pitch ranges and cones of orientations and tilts: only what must be met exactly."""
    return replace(
        targets,
        has_pitch=targets.has_pitch & (targets.pitch_half < 1e-9),
        has_rotation=targets.has_rotation & (targets.rotation_tolerance == 0.0),
        tilts=None if targets.tilts is None else targets.tilts.exact,
    )


def _margins(proximity: Proximity, q: Matrix, time: float, floor: Vector | None = None) -> Vector:
    """(K,) least margin of each sample [m], or a lower bound of it above `floor` (K,)."""
    found = np.full(len(q), np.inf)
    wanted = np.full(len(q), ROOM) if floor is None else floor
    for row, joints in enumerate(q):
        lower, _ = proximity.lower_bounds(joints, time=time, floor=proximity.clearance + wanted[row])
        lower = np.where(proximity.appears_at <= time, lower, np.inf)
        found[row] = np.min(lower - proximity.clearance, initial=np.inf)
    return found


def null_bases(kinematics: BatchKinematics, targets: TargetBatch, q: Matrix) -> NDArray[np.float64]:
    """(K, n, r) orthonormal bases of the null spaces at q (K, n); r is the least dimension of all samples."""
    J = targets.jacobians(kinematics.at(q))
    _, size, Vt = np.linalg.svd(J)
    rank = int(np.max(np.sum(size > 1e-6, axis=1)))
    return np.asarray(np.swapaxes(Vt[:, rank:, :], 1, 2))


def _step(weights: Vector, q: Matrix, N: NDArray[np.float64], price: Vector, held: Mask) -> Matrix:
    """(K, r) the Gauss-Newton step z in null-space coordinates.

    Parameters
    ----------
    N: (K, n, r) bases of the null spaces. price: (K,) added to the weight of each z. held: (K,) samples that stay.
    """
    from scipy.linalg import solveh_banded

    count, r = len(q), N.shape[2]
    pull = weights[:, None] * np.diff(q, axis=0)
    force = np.zeros_like(q)
    force[:-1] += pull
    force[1:] -= pull
    gradient = np.einsum("knr,kn->kr", N, force)
    diagonal = np.zeros(count)
    diagonal[:-1] += weights
    diagonal[1:] += weights
    diagonal = diagonal + price
    diagonal[held] = 1e12 * float(np.max(diagonal))
    coupling = -weights[:, None, None] * np.einsum("kna,knb->kab", N[:-1], N[1:])
    band = np.zeros((2 * r, count * r))
    band[0] = np.repeat(diagonal, r) * (1.0 + 1e-9)
    for a in range(r):
        for b in range(r):
            # entry (r k + a, r (k + 1) + b), kept in the lower form at row r k + a
            band[r + b - a, a : (count - 1) * r : r] = coupling[:, a, b]
    z = solveh_banded(band, gradient.ravel(), lower=True).reshape(count, r)
    largest = float(np.max(np.abs(z)))
    return np.asarray(z * min(1.0, _LARGEST_MOVE / max(largest, 1e-12)))
