"""Newton-Raphson inverse kinematics within joint limits, with restarts.

The iteration is the paper's (q <- q + J^+ (x* - x(q))), with the damping of
Levenberg and Marquardt chosen from the error (Sugihara 2011, "Solvability-Unconcerned
Inverse Kinematics by the Levenberg-Marquardt Method"), and with joints that push
against a limit taken out of the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from backhoe_planner.machine.kinematics.kinematics import Configuration, Kinematics
from backhoe_planner.machine.kinematics.target import TipTarget, movable_rows
from backhoe_planner.machine.robot import Robot

__all__ = ["InverseKinematics", "solve_inverse_kinematics"]

Vector = NDArray[np.float64]

_ITERATIONS = 60
_SETTLED = 6  # of the attempts that did not arrive, the best are led on to their nearest pose
_ANGLE_WEIGHT = 1.0  # m per rad: a radian counts as a metre while converging


@dataclass(frozen=True)
class InverseKinematics:
    """What the search found.

    Attributes
    ----------
    reached: both errors are within the tolerance.
    q: (n,) the solution; where not reached, the configuration that comes nearest.
    position_error: [m]
    angle_error: [rad]
    attempts: starting points tried.
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
    kinematics: Kinematics | None = None,
) -> InverseKinematics:
    """A configuration within the limits that puts the tip on `target`.

    Parameters
    ----------
    target: position, and pitch or orientation where asked.
    start: (n,) where the first attempt begins; the middle of the ranges by default.
    rng: draws the other starting points; seeded with 0 by default.
    attempts: the most starting points.
    tolerance: on the position error [m] and the angle error [rad].
    kinematics: working memory to use.
    """
    kinematics = kinematics or Kinematics(robot)
    rng = rng or np.random.default_rng(0)
    guess = robot.middle if start is None else np.clip(start, robot.limits.lower, robot.limits.upper)
    ends: list[tuple[float, Vector]] = []
    for attempt in range(1, attempts + 1):
        q, at = _descend(robot, target, guess, kinematics, tolerance)
        position, angle = target.distances(at)
        if position <= tolerance and angle <= tolerance:
            return InverseKinematics(True, q, position, angle, attempt)
        ends.append((position + _ANGLE_WEIGHT * angle, q))
        guess = robot.random_q(rng)
    ends = sorted(ends, key=lambda end: end[0])[:_SETTLED]
    settled = [_nearest(robot, target, q, kinematics) for _, q in ends]
    q = min(settled, key=lambda q: float(np.sum(np.square(target.error(kinematics.at(q))))))
    position, angle = target.distances(kinematics.at(q))
    return InverseKinematics(position <= tolerance and angle <= tolerance, q, position, angle, attempts)


def _nearest(robot: Robot, target: TipTarget, start: Vector, kinematics: Kinematics) -> Vector:
    """(n,) where the squared error is least near `start`.

    Newton-Raphson crawls there: with an error that stays large, its J^T J is far from
    the second derivative of the squared error.
    """

    def cost(q: Vector) -> tuple[float, Vector]:
        at = kinematics.at(q)
        error = target.error(at)
        return 0.5 * float(error @ error), -target.jacobian(at).T @ error

    found = minimize(
        cost,
        start,
        jac=True,
        method="SLSQP",
        bounds=np.column_stack((robot.limits.lower, robot.limits.upper)),
        options={"ftol": 1e-15, "maxiter": 200},
    )
    return np.asarray(np.clip(found.x, robot.limits.lower, robot.limits.upper))


def _descend(
    robot: Robot, target: TipTarget, start: Vector, kinematics: Kinematics, tolerance: float
) -> tuple[Vector, Configuration]:
    """Iterate from `start` until converged, stuck, or out of iterations."""
    lower, upper = robot.limits.lower, robot.limits.upper
    q = np.array(start, dtype=float)
    at = kinematics.at(q)
    error = target.error(at)
    cost = float(error @ error)
    small = tolerance * 0.5
    stalled = 0
    for _ in range(_ITERATIONS):
        if np.sqrt(cost) <= small:
            break
        jacobian = target.jacobian(at)
        rows = movable_rows(jacobian)
        J, e = jacobian[rows], error[rows]
        gradient = J.T @ e
        free = ~(((q <= lower) & (gradient < 0.0)) | ((q >= upper) & (gradient > 0.0)))
        if not np.any(free) or float(np.linalg.norm(gradient[free])) < 1e-14:
            break
        step = _step(J, e, free, float(e @ e))
        # joints that the step drives into a limit stay there; the others try again
        for _ in range(robot.n):
            hit = free & (((q + step < lower) & (q <= lower)) | ((q + step > upper) & (q >= upper)))
            if not np.any(hit):
                break
            free &= ~hit
            if not np.any(free):
                break
            step = _step(J, e, free, float(e @ e))
        step = np.clip(step, -0.6, 0.6)
        moved = np.clip(q + step, lower, upper)
        at_moved = kinematics.at(moved)
        error_moved = target.error(at_moved)
        cost_moved = float(error_moved @ error_moved)
        stalled = stalled + 1 if cost_moved > 0.98 * cost else 0
        q, at, error, cost = moved, at_moved, error_moved, cost_moved
        if stalled > 8:
            break
    return q, at


def _step(J: NDArray[np.float64], e: Vector, free: NDArray[np.bool_], cost: float) -> Vector:
    """(n,) damped Newton step of the free joints."""
    step = np.zeros(J.shape[1])
    Jf = J[:, free]
    damping = min(cost, 1e-2) * 1e-1 + 1e-12
    if Jf.shape[1] >= Jf.shape[0]:
        step[free] = Jf.T @ np.linalg.solve(Jf @ Jf.T + damping * np.eye(Jf.shape[0]), e)
    else:
        step[free] = np.linalg.solve(Jf.T @ Jf + damping * np.eye(Jf.shape[1]), Jf.T @ e)
    return step
