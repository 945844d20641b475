"""How the cost of a fastest run changes with its curve, and what a descent learns of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix
from backhoe_planner.motion import OBJECTIVES, Problem, build_problem, drive_of, motion_cost, run_curve, time_curve
from backhoe_planner.planning.descent.bend import Bend
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.fastest_run import slope_of_cost

PIECES, PLACES = 8, 49
GRID = np.linspace(0.0, 1.0, 6 * PIECES + 1)


def problem_of(robot: bp.Robot, objective: str) -> Problem:
    goal = {"joints": dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))}
    start = {"joints": dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))}
    problem = build_problem(robot, bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": goal}}))
    return replace(problem, objective=OBJECTIVES[objective])


def bent_curve(robot: bp.Robot) -> JointCurve:
    rng = np.random.default_rng(4)
    wide = 0.25 * (robot.limits.upper - robot.limits.lower)
    straight = JointCurve.straight(robot.middle - wide, robot.middle + wide, PIECES)
    control = straight.control.copy()
    control[1:-1] += 0.1 * rng.uniform(-wide, wide, (PIECES - 1, robot.n))
    return JointCurve(control)


def central_differences(problem: Problem, curve: JointCurve) -> Matrix:
    drive, nudge = drive_of(problem), 2e-3

    def cost(control: Matrix) -> float:
        motion = time_curve(JointCurve(control), GRID, problem.limits, drive=drive)
        assert motion is not None
        return motion_cost(problem, motion)

    found = np.zeros_like(curve.control)
    for place in np.ndindex(*found[1:-1].shape):
        moved = np.zeros_like(found)
        moved[1:-1][place] = nudge
        found[1:-1][place] = (cost(curve.control + moved) - cost(curve.control - moved)) / (2.0 * nudge)
    return found


@pytest.mark.parametrize("objective", ["kinetic", "velocity_norm"])
def test_the_slope_of_the_cost_of_the_fastest_run_is_that_of_differences(planar4: bp.Robot, objective: str) -> None:
    """Differences of timed motions, whose samples and kinks make them wrong by some percent themselves."""
    problem, curve = problem_of(planar4, objective), bent_curve(planar4)
    run = run_curve(curve, GRID, problem.limits, drive=drive_of(problem))
    assert run is not None
    slope = slope_of_cost(problem, drive_of(problem), curve, run.law, PLACES)[1:-1].ravel()
    expected = central_differences(problem, curve)[1:-1].ravel()
    assert slope @ expected > 0.97 * np.linalg.norm(slope) * np.linalg.norm(expected)
    assert np.linalg.norm(slope) == pytest.approx(np.linalg.norm(expected), rel=0.1)


def test_a_step_through_a_quadratic_cost_teaches_its_curvature_along_it() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(10, 10))
    true = root @ root.T + np.eye(10)  # cost = x.H.x / 2 + f.x, so that the slope changes by H.step
    bend = Bend.smooth(rng.normal(size=10), 6, np.array([1.0, 0.5]), 0.25)
    for _ in range(3):
        step = rng.normal(size=10)
        bend = bend.after(step, bend.slope + true @ step)
        if step @ true @ step >= 0.2 * step @ bend.curvature @ step:
            np.testing.assert_allclose(bend.curvature @ step, true @ step, rtol=1e-8, atol=1e-8)
        assert np.linalg.eigvalsh(bend.curvature).min() > 0.0


def test_the_curvature_stays_positive_where_the_cost_bends_down() -> None:
    rng = np.random.default_rng(1)
    bend = Bend.smooth(rng.normal(size=10), 6, np.array([1.0, 0.5]), 0.25)
    for _ in range(20):
        step = rng.normal(size=10)
        bend = bend.after(step, bend.slope - 3.0 * step)
    assert np.linalg.eigvalsh(bend.curvature).min() > 0.0
