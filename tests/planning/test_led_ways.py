"""The best way around an obstacle is led to other postures, and descents lead to ends that are far from each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bar_scenes import BAR, STRETCHED, problem_of
from one_joint_search import DURATION, END, START, ended_search

import backhoe_planner as bp
from backhoe_planner.motion import OBJECTIVES, time_evenly
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart import cost_descents
from backhoe_planner.planning.multistart.first_rounds import FirstRounds
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start
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


@pytest.mark.parametrize(
    ("far", "cost", "begun"),
    [
        (True, 15.0, "abd"),
        (True, 21.0, "ab"),  # it costs more than twice as much as the first
        (False, 15.0, "ab"),  # the end is near those of the others
    ],
)
def test_one_more_descent_leads_to_an_end_that_is_far_from_those_of_the_others(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, far: bool, cost: float, begun: str
) -> None:
    """Four starts are clear after their first rounds; of three the normal effort descends to two motions."""
    world, _, search = ended_search(planar4)
    assert search.allowed_time is not None
    descents, goal = search._descents, world.problem.goals[0]
    elsewhere = END.copy()
    # the first joint moves the most mass, so that its velocity limit counts
    elsewhere[0] -= (0.2 if far else 0.1) * search.allowed_time * planar4.limits.velocity[0]
    ends = {"a": END, "b": END, "c": END, "d": elsewhere}
    starts = {name: Start(JointCurve.straight(START, end, 12), DURATION, goal, name) for name, end in ends.items()}
    costs = {"a": 10.0, "b": 11.0, "c": 12.0, "d": cost}
    rounds = FirstRounds([(costs[name], start) for name, start in starts.items()], [])
    monkeypatch.setattr(cost_descents, "after_first_rounds", lambda *_, **__: rounds)
    run = ""

    def descend(start: Start) -> bool:
        nonlocal run
        run += start.way
        motion = time_evenly(start.curve, DURATION)
        descents.ended.append(FoundMotion(motion, costs[start.way], goal, start.way, start.curve))
        return True

    monkeypatch.setattr(descents, "descend", descend)
    descents.descend_cheapest([PricedStart(start, 1.0) for start in starts.values()])
    assert run == begun


@pytest.mark.long
def test_a_way_around_obstacles_ends_in_the_posture_that_needs_little_work() -> None:
    """The only detour that is sampled ends with the wrist turned over, at 3.8 J; the best motion known needs 2.7 J."""
    robot = load_machine("panda")
    scene: Any = random_site(robot, SiteKey("panda", "narrow", "goal", 3, 515001)).scene
    plan = bp.plan(robot, with_objective(scene, "work"), seed=0)
    assert plan.verified
    assert plan.metrics.energy["work"] < 1.15 * 2.674
