"""How the cost of the fastest run along a curve changes with its control points.

At every place some limit binds. Its use r of a moment with joints q, v, a stays 1 when the curve
is bent, and that says how the pace x = (ds/dt)^2 changes with the curve: with z = dx / x,

    r_q dq + r_v dv + r_a da = 0        v = q' sqrt(x)        a = q' x'/2 + q'' x

is one linear equation at each place. Where r_a q' is positive the run speeds up and x' is taken
from the place before, else from the one after, as the passes of `motion.timing.time_optimal` do.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.motion import Drive, Problem, TimeLaw, cost_rate
from backhoe_planner.planning.descent.curve import JointCurve, basis
from backhoe_planner.planning.descent.moment_slopes import moment_slopes

_ROUNDING = 1e-12  # size of an equation that is 0: the curve stays where it is
_STIFF = 1e-3  # part of an equation's size below which it does not tell the pace; chosen


def slope_of_cost(problem: Problem, drive: Drive, curve: JointCurve, law: TimeLaw, places: int) -> Matrix:
    """(L + 1, n) derivatives of the cost of the fastest run by the curve's control points [cost per rad or m].

    Parameters
    ----------
    drive: of the problem's machine.
    law: the fastest run, on a grid of equal steps.
    places: equally spaced, at which the cost and the limits are looked at; each is on the grid.
    """
    n, step = curve.control.shape[1], (len(law.grid) - 1) // (places - 1)
    x, h = law.x[::step], 1.0 / (places - 1)
    beside = np.concatenate((law.u[:1], law.u, law.u[-1:]))
    u = 0.5 * (beside[:-1] + beside[1:])[::step]
    rate = np.sqrt(x)
    weights = [basis(curve.pieces, places, derivative) for derivative in range(3)]
    q, first, second = (each @ curve.control for each in weights)
    values, slopes = moment_slopes(
        partial(_cost_and_use, problem, drive),
        q, first * rate[:, None], first * u[:, None] + second * x[:, None],
    )  # fmt: skip
    binding = 1 + np.argmax(values[:, 1:], axis=1)

    def by_curve_and_pace(of_moment: Matrix) -> tuple[Matrix, Vector, Vector]:
        """(K, (L + 1) n) by the control points, (K,) by z, and (K,) by ds/dt2, of values with these slopes (K, 3 n)."""
        of_q, of_v, of_a = of_moment[:, :n], of_moment[:, n : 2 * n], of_moment[:, 2 * n :]
        G = (
            weights[0][:, :, None] * of_q[:, None, :]
            + weights[1][:, :, None] * (rate[:, None] * of_v + u[:, None] * of_a)[:, None, :]
            + weights[2][:, :, None] * (x[:, None] * of_a)[:, None, :]
        )
        by_pace = 0.5 * rate * np.sum(of_v * first, axis=1) + x * np.sum(of_a * second, axis=1)
        return G.reshape(places, -1), by_pace, np.sum(of_a * first, axis=1)

    G, by_pace, by_speeding = by_curve_and_pace(slopes[:, 0])
    use, use_by_pace, use_by_speeding = by_curve_and_pace(slopes[np.arange(places), binding])
    A = np.diag(use_by_pace) + 0.5 / h * use_by_speeding[:, None] * _difference(use_by_speeding) * x
    size = np.maximum(np.linalg.norm(A, axis=1), _ROUNDING)
    A, use = A / size[:, None], use / size[:, None]

    time = np.full(places, h) / rate
    time[[0, -1]] *= 0.5
    cost_by_pace = time * (by_pace - 0.5 * values[:, 0])
    cost_by_pace += 0.5 / h * ((time * by_speeding) @ _central(places)) * x
    price = np.linalg.solve(A.T @ A + _STIFF**2 * np.eye(places), cost_by_pace)
    return np.asarray(time @ G - (A @ price) @ use).reshape(-1, n)


def _cost_and_use(problem: Problem, drive: Drive, q: Matrix, v: Matrix, a: Matrix) -> Matrix:
    """(K, 1 + U) what moments cost a second, and how much of every limit they use."""
    limits = problem.limits
    columns = [cost_rate(problem, q, v, a)[:, None], np.abs(v) / limits.velocity, np.abs(a) / limits.acceleration]
    if drive.limited:
        use = drive.use(q, v, a)
        columns += [use.effort, use.speeds]
    return np.column_stack(columns)


def _difference(speeding: Vector) -> Array:
    """(K, K) differences of neighbours, with the one before where `speeding` (K,) is positive, else the one after."""
    count = len(speeding)
    back = speeding > 0.0
    back[0], back[-1] = False, True
    row = np.arange(count)
    found = np.zeros((count, count))
    found[row, row] = np.where(back, 1.0, -1.0)
    found[row, row + np.where(back, -1, 1)] = np.where(back, -1.0, 1.0)
    return found


def _central(count: int) -> Array:
    """(K, K) differences per step of the places beside, one-sided at the ends."""
    row = np.arange(count)
    low, high = np.maximum(row - 1, 0), np.minimum(row + 1, count - 1)
    found = np.zeros((count, count))
    found[row, low], found[row, high] = -1.0 / (high - low), 1.0 / (high - low)
    return found
