"""Estimated costs of straight motions, by which the routes through a roadmap are compared."""

from __future__ import annotations

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem, Trajectory, cost_rate, drive_of
from backhoe_planner.planning.search.roadmap import Price, joint_time

_PLACES = 40  # of a motion, between which its length is counted; chosen


def price_of(problem: Problem, like: Trajectory, longest: float) -> Price:
    """The price of straight motions by the problem's objective, at the even pace of a motion that takes `longest` [s].

    The time is priced by `joint_time`. If only positive power counts, as for the work, a motion has to speed up once:
    with its length L in the metric of the mass matrix this needs (L / T)^2 / 2 in the time T. A step is priced by its
    share, the derivative dL L / T^2, with the length L of the motion `like`.
    """
    rate = problem.limits.velocity
    time = joint_time(rate)
    if problem.objective.is_time:
        return time
    drive = drive_of(problem)

    def kinetic(a: Matrix, b: Matrix) -> Vector:
        middle, step = 0.5 * (a + b), b - a
        inertia = drive.rigid_torques(middle, np.zeros_like(middle), step) - drive.gravity_torques(middle)
        return np.asarray(np.sqrt(np.maximum(np.sum(step * inertia, axis=1), 0.0)))

    q = like.at(np.linspace(0.0, like.duration, _PLACES))
    slower = longest / float(np.sum(time(q[:-1], q[1:])))
    speeding_up = problem.objective.is_positive_power
    each = float(np.sum(kinetic(q[:-1], q[1:]))) / longest**2 if speeding_up else 0.0

    def price(a: Matrix, b: Matrix) -> Vector:
        duration = slower * time(a, b)
        v = (b - a) / np.maximum(duration, 1e-12)[:, None]
        cost = cost_rate(problem, 0.5 * (a + b), v, np.zeros_like(v)) * duration
        return np.asarray(cost + each * kinetic(a, b)) if speeding_up else cost

    return price
