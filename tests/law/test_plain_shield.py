"""The shield, whose steps skip needless work, gives the same answers as its equations written plainly."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import crowd

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import QuadraticProgram, Rows, Shield, solve_program
from backhoe_planner.machine import JointLimits, Kinematics, Robot
from backhoe_planner.site import Nearby

DT = 0.02


def plain_bounds(limits: JointLimits, q: Vector, v: Vector, dt: float) -> tuple[Vector, Vector]:
    """(n,), (n,) rates from which a joint stops within the gap to its limit, braking after 1.5 dt.

    They are a (sqrt(t^2 + 2 gap / a) - t) with t = 1.5 dt; beyond the limit it comes back at 1 / s, 0.25 at most. The
    acceleration limit takes precedence.
    """
    a, lead = limits.acceleration, 1.5 * dt

    def towards(gap: Vector) -> Vector:
        inside = a * (np.sqrt(lead**2 + 2.0 * np.maximum(gap, 0.0) / a) - lead)
        return np.minimum(np.where(gap < 0.0, -np.minimum(-gap, 0.25), inside), limits.velocity)

    slowest, fastest = v - a * dt, v + a * dt
    low = np.clip(-towards(q - limits.lower), slowest, fastest)
    return low, np.maximum(np.clip(towards(limits.upper - q), slowest, fastest), low)


def plain_answer(
    limits: JointLimits, wish: Vector, q: Vector, v: Vector, nearby: Nearby, J_tip: Matrix, extra: float
) -> Vector:
    """(n,) the solution of the whole program, from the module's text.

    Rows with no entry above 1e-5 m/rad are left out.
    """
    low, high = plain_bounds(limits, q, v, DT)
    time = float(np.max(np.abs([v, wish]) / limits.acceleration))
    margin = nearby.margin - extra
    bound = np.where(margin < 0.0, -np.minimum(-margin, 0.25), margin * 1.6 / max(time, 2.0 * 1.6 * DT)) + nearby.drift
    tip = J_tip @ wish
    along = np.outer(tip, tip) / max(float(tip @ tip), 1e-12)
    W = J_tip.T @ (10.0 * (np.eye(3) - along) + along) @ J_tip + 0.05 * np.eye(len(wish))
    counts = np.abs(nearby.gradient).max(axis=1, initial=0.0) > 1e-5
    rows = Rows("clearance", -nearby.gradient[counts], bound[counts])
    program = QuadraticProgram(W, -W @ wish, low, high, (rows,))
    found = solve_program(program)
    assert found is not None
    return np.clip(found.x, low, high)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_the_shields_answer_equals_that_of_the_whole_program(any_robot: Robot, seed: int) -> None:
    robot, limits = any_robot, any_robot.limits
    rng, kinematics, shield = np.random.default_rng(seed), Kinematics(any_robot), Shield(any_robot.limits)
    proximity = crowd(robot, 30, seed, moving=True)
    answers = []
    for _ in range(100):
        q = robot.random_q(rng)
        if rng.random() < 0.3:  # at a limit, or beyond it
            joint = int(rng.integers(robot.n))
            edge = (limits.lower, limits.upper)[int(rng.integers(2))][joint]
            q[joint] = edge + rng.uniform(-0.03, 0.03) if np.isfinite(edge) else q[joint]
        v = rng.choice([0.03, 1.0]) * rng.uniform(-1.0, 1.0, robot.n) * limits.velocity
        near = rng.random() < 0.7
        wish = v + rng.uniform(-1.0, 1.0, robot.n) * limits.acceleration * DT if near else -v
        nearby = proximity.at(q, time=0.5, margin=float(rng.choice([0.2, 1.5])))
        J = kinematics.at(q).jacobian[:3]
        low, high = shield.velocity_bounds(q, v, DT)
        for ours, plain in zip((low, high), plain_bounds(limits, q, v, DT), strict=True):
            np.testing.assert_allclose(ours, plain, atol=1e-12)
        found = shield.filter(wish, q=q, v_before=v, dt=DT, nearby=nearby, J_tip=J, extra_margin=0.002)
        np.testing.assert_allclose(found.v, plain_answer(limits, wish, q, v, nearby, J, 0.002), atol=1e-5)
        answers.append((found.v is wish, len(found.binding) > 0, len(nearby) > 16))
    untouched, held_back, many = np.sum(answers, axis=0).tolist()
    assert untouched > 0
    assert held_back > 0
    assert many > 0
