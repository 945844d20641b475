"""The best way around an obstacle is led to other postures on the goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bar_scenes import BAR, STRETCHED, problem_of

import backhoe_planner as bp
from backhoe_planner.motion import OBJECTIVES, time_evenly
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.start_prices import PricedStart
from backhoe_planner.planning.multistart.straight_lines import STRAIGHT
from validation.goal_runs import with_objective
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

BENT = np.array([1.4, 0.4, -0.8, 0.4])  # within reach in many postures
LONGEST = 8.0  # s that a motion around the bar may take
AROUND = "around an obstacle"


def search_with_best(robot: bp.Robot, way: str, effort: Any) -> tuple[CostSearch, FoundMotion]:
    """A search around the bar to a position, which has not begun but knows a motion, and that motion."""
    problem = replace(problem_of(robot, STRETCHED, BENT, [BAR]), objective=OBJECTIVES["velocity_norm"])
    world = World(problem, seed=3, work=Work(EFFORTS[effort]))
    found = find_goal_postures(world, problem.goals, near=STRETCHED, time=0.0)
    assert isinstance(found, GoalPostures)
    search = CostSearch(world, STRETCHED, found, time=0.0, longest=LONGEST)
    control = JointCurve.straight(STRETCHED, BENT, EFFORTS[effort].pieces).control.copy()
    control[3:-3, 1] -= 1.0  # bent on the way
    curve = JointCurve(control)
    best = FoundMotion(time_evenly(curve, LONGEST), 100.0, problem.goals[0], way, curve)
    search._incumbent.best = best
    return search, best


@pytest.mark.parametrize(
    ("way", "effort", "factors", "turns"),
    [
        (AROUND, "normal", [1.0], 1),  # no other posture is better
        (AROUND, "normal", [0.99], 1),  # a gain of 1 % is too little
        (AROUND, "normal", [0.9, 1.0], 2),
        (AROUND, "normal", [0.5, 0.5, 0.5], 3),  # and no fourth
        (STRAIGHT, "normal", [], 0),
        (AROUND, "quick", [], 0),
    ],
)
def test_the_best_way_around_an_obstacle_is_led_to_other_postures_while_that_gains(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, way: str, effort: str, factors: list[float], turns: int
) -> None:
    search, best = search_with_best(planar4, way, effort)
    bests, all_starts, left = [best], list[Sequence[PricedStart]](), iter(factors)

    def descend_cheapest(chosen: Sequence[PricedStart]) -> None:
        all_starts.append(chosen)
        curve = chosen[0].start.curve
        bests.append(replace(best, cost=next(left) * bests[-1].cost, curve=curve))
        search._incumbent.best = bests[-1]

    monkeypatch.setattr(search._descents, "descend_cheapest", descend_cheapest)
    search._lead_elsewhere()
    assert len(all_starts) == turns
    for led, starts in zip(bests, all_starts, strict=False):
        assert led.curve is not None
        for start in (one.start for one in starts):
            end = start.curve.control[-1]
            assert min(np.abs(end - posture).max() for posture in search.ends.postures) < 1e-12
            assert np.abs(end - led.curve.control[-1]).max() > 0.01  # another one
            np.testing.assert_array_equal(start.curve.control[0], STRETCHED)
            # it keeps the way: the nearer to the start, the less it is moved
            moved = np.abs(start.curve.control - led.curve.control).max(axis=1)
            assert (np.diff(moved) >= -1e-12).all()
            assert (start.way, start.duration, start.goal) == (AROUND, LONGEST, best.goal)


@pytest.mark.long
def test_a_way_around_obstacles_ends_in_the_posture_that_needs_little_work() -> None:
    """The only detour that is sampled ends with the wrist turned over, at 3.8 J; the best motion known needs 2.7 J."""
    robot = load_machine("panda")
    scene: Any = random_site(robot, SiteKey("panda", "narrow", "goal", 3, 515001)).scene
    plan = bp.plan(robot, with_objective(scene, "work"), seed=0)
    assert plan.verified
    assert plan.metrics.energy["work"] < 1.15 * 2.674
