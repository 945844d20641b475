"""First paths of a search: which are alike, and how their ends stay on a goal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bar_scenes import problem_of

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.planning import MotionCheck
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import step_onto
from backhoe_planner.planning.multistart.alike import KnownCurves
from backhoe_planner.site import Proximity

LEFT, RIGHT = np.array([1.5, 0.0, 0.0, 0.0]), np.array([-1.5, 0.0, 0.0, 0.0])
# the stretched arm (4 m) hits it halfway; with the last joint bent by 0.4 rad the tip is at 3.94 m and passes
POST: dict[str, Any] = {"name": "post", "shape": "sphere", "radius": 0.1, "position": [4.07, 0.0, 0.0]}


def bending(angle: float) -> JointCurve:
    """A curve from left to right with the last joint bent by this angle halfway."""
    control = np.linspace(LEFT, RIGHT, 13)
    control[3:10, 3] = angle
    return JointCurve(control)


def known_at(robot: bp.Robot, *obstacles: dict[str, Any]) -> KnownCurves:
    problem = problem_of(robot, LEFT, RIGHT, list(obstacles))
    proximity = Proximity(problem.robot, problem.obstacles)
    return KnownCurves(problem.limits, lambda: MotionCheck(problem, proximity, [LEFT], spare=0.0))


def test_the_cheapest_similar_curve_counts(planar4: bp.Robot) -> None:
    known = known_at(planar4)
    assert known.least_alike(bending(0.4)) == np.inf
    known.add(bending(0.5), 7.0)
    assert known.least_alike(bending(0.4)) == 7.0
    known.add(bending(0.3), 5.0)
    assert known.least_alike(bending(0.4)) == 5.0
    assert known.least_alike(bending(2.5)) == np.inf  # far from both, if nothing is in between


def test_an_obstacle_between_two_curves_makes_them_different(planar4: bp.Robot) -> None:
    free, blocked = known_at(planar4), known_at(planar4, POST)
    for known in (free, blocked):
        known.add(bending(0.4), 1.0)
        assert known.least_alike(bending(0.42)) == 1.0
    assert free.least_alike(bending(-0.4)) == 1.0
    assert blocked.least_alike(bending(-0.4)) == np.inf


@pytest.mark.parametrize(
    ("q", "step"),
    [
        ([0.0, 0.0], [0.1, 0.1]),  # the least step is shared by both
        ([1.0, 0.0], [0.0, 0.2]),  # joint 1 is at its limit: the other takes all of it
        ([1.0, 2.0], [0.0, 0.0]),  # both are: no step
    ],
)
def test_a_step_back_onto_the_goal_uses_the_joints_that_are_not_at_a_limit(q: list[float], step: list[float]) -> None:
    one: Vector = np.ones(2)
    limits = JointLimits(lower=-one, upper=np.array([1.0, 2.0]), velocity=one, acceleration=one, effort=one)
    found = step_onto(np.array([[1.0, 1.0]]), np.array([0.2]), np.array(q), limits)
    np.testing.assert_allclose(found, step, atol=1e-12)
