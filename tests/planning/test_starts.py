"""Curves at which descents start, with joints that move early or late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import OBJECTIVES, build_problem
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent_of_cost import DescentOfCost
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start, StartPrices
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.site import ClearanceScreen, Proximity
from validation.goal_runs import with_objective
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

PIECES, LONGEST = 12, 20.0


def test_paced_starts_have_the_same_ends_and_early_or_even_or_late_joints(backhoe: bp.Robot) -> None:
    middle = {"joints": dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))}
    scene = bp.scene_from_dict({"version": 1, "start": middle, "task": {"goal": middle}})
    problem = replace(build_problem(backhoe, scene), objective=OBJECTIVES["work"])
    proximity = Proximity(backhoe, problem.obstacles)
    descent = DescentOfCost(problem, proximity, Kinematics(backhoe), time=0.0, brake=Brake())
    screen = ClearanceScreen(proximity, time=0.0)
    longest = 6.0  # s: short, so that starts count as far apart
    prices = StartPrices(descent, screen, longest=longest)
    u = np.linspace(0.0, 1.0, PIECES + 1)
    paces = [part * part * (3.0 - 2.0 * part) for part in (np.minimum(2.0 * u, 1.0), u, np.maximum(2.0 * u - 1.0, 0.0))]
    rng, cheaper, several = np.random.default_rng(5), 0, 0
    for _ in range(6):
        start, end = backhoe.random_q(rng), backhoe.random_q(rng)
        line = Start(JointCurve.straight(start, end, PIECES), 1.0, problem.goals[0], "straight")
        paced = prices.paced(list(prices.in_order([line])))
        assert [one.price for one in paced] == sorted(one.price for one in paced)
        for found in (one.start for one in paced):
            control = found.curve.control
            np.testing.assert_allclose(control[[0, -1]], [start, end], atol=1e-12)
            for joint in range(backhoe.n):
                parts = (control[:, joint] - start[joint]) / (end[joint] - start[joint])
                assert any(np.allclose(parts, pace, atol=1e-9) for pace in paces)
        controls = [one.start.curve.control / descent.rate for one in paced]
        for k, one in enumerate(controls):
            assert all(np.max(np.abs(one - other)) > 0.15 * longest for other in controls[:k])
        prices_of = []
        for curve in (line.curve, *(each.start.curve for each in paced)):
            cost = descent.estimates([curve], np.array([longest]), longest=longest)[0]
            prices_of.append(cost * (2.0 - np.mean(screen.keeps(curve(np.linspace(0.0, 1.0, 25))))))
        np.testing.assert_allclose([one.price for one in paced], prices_of[1:])
        if paced:
            assert max(prices_of[1:]) <= 3.0 * min(prices_of) * (1.0 + 1e-12)
            cheaper += prices_of[1] < prices_of[0]
            several += len(paced) > 1
    assert cheaper >= 3
    assert several >= 1


def test_starts_are_in_order_of_price_and_the_chosen_are_cheap_and_far_apart(
    backhoe: bp.Robot,
) -> None:
    middle = {"joints": dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))}
    ball = {"name": "ball", "shape": "sphere", "radius": 1.0, "position": [3.0, 1.0, 0.5]}
    content = {"version": 1, "start": middle, "task": {"goal": middle}, "obstacles": [ball]}
    problem = replace(build_problem(backhoe, bp.scene_from_dict(content)), objective=OBJECTIVES["work"])
    proximity = Proximity(backhoe, problem.obstacles)
    descent = DescentOfCost(problem, proximity, Kinematics(backhoe), time=0.0, brake=Brake())
    screen = ClearanceScreen(proximity, time=0.0)
    prices = StartPrices(descent, screen, longest=LONGEST)
    rng = np.random.default_rng(7)
    ends = [backhoe.random_q(rng) for _ in range(11)]
    lines = [
        Start(JointCurve.straight(ends[0], end, PIECES), time, problem.goals[0], "straight")
        for end, time in zip([*ends[1:], ends[1]], [1.0] * 9 + [1.5 * LONGEST, 1.0], strict=True)
    ]
    blocked = [1.0 - np.mean(screen.keeps(one.curve(np.linspace(0.0, 1.0, 25)))) for one in lines]
    assert max(blocked) > 0.1
    expected = [
        float(descent.estimates([one.curve], np.array([max(one.duration, LONGEST)]), longest=LONGEST)[0]) * (1.0 + part)
        for one, part in zip(lines, blocked, strict=True)
    ]
    found = list(prices.in_order(lines))
    assert [one.price for one in found] == pytest.approx(sorted(expected))
    assert [one.start for one in found] == [lines[index] for index in np.argsort(expected, kind="stable")]
    chosen = prices.cheapest(found, 20)
    assert chosen[0] is found[0]
    assert chosen[-1].price <= 1.5 * found[0].price
    controls = [one.start.curve.control / descent.rate for one in chosen]
    assert all(np.max(np.abs(one - other)) > 0.15 * LONGEST for k, one in enumerate(controls) for other in controls[:k])


def test_spread_starts_are_taken_at_equal_steps_of_the_prices_below_three_times_the_least() -> None:
    """Of eight lines, 5 s of joint time apart and at most 20 s long, seven are fair; nearer than 3 s counts as near."""
    goal: Any = None
    descent: Any = SimpleNamespace(rate=np.ones(1))
    screen: Any = None
    prices = StartPrices(descent, screen, longest=LONGEST)
    lines = [JointCurve.straight(np.zeros(1), np.array([5.0 * k]), 3) for k in range(8)]
    cost = [1.0, 1.5, 1.6, 2.0, 2.5, 2.9, 3.0, 3.1]
    priced = [
        PricedStart(Start(line, 1.0, goal, str(k)), price)
        for k, (line, price) in enumerate(zip(lines, cost, strict=True))
    ]
    fair = prices.fair(iter(priced))
    assert [one.start.way for one in fair] == list("0123456")
    assert [one.start.way for one in prices.spread(fair, 3)] == list("036")
    assert [one.start.way for one in prices.spread(fair, 20)] == list("0123456")
    near = JointCurve.straight(np.zeros(1), np.array([12.5]), 3)  # 2.5 s from two of them
    assert [one.start.way for one in prices.spread(fair, 3, known=[lines[0], near])] == list("15")
    assert prices.fair(iter([])) == prices.spread([], 3) == []


def test_starts_far_from_each_other_are_taken_first_and_nearer_ones_until_there_are_enough() -> None:
    """Lines of at most 20 s of joint time; nearer than 1.6 s counts as near at first, then nearer than 0.8 s."""
    goal: Any = None
    descent: Any = SimpleNamespace(rate=np.ones(1))
    screen: Any = None
    prices = StartPrices(descent, screen, longest=LONGEST)
    priced = [
        PricedStart(Start(JointCurve.straight(np.zeros(1), np.array([end]), 3), 1.0, goal, str(end)), 1.0 + 0.1 * k)
        for k, end in enumerate([5.0, 6.0, 5.5, 9.0, 12.0, 10.0])
    ]

    def ways(count: int, known: Sequence[JointCurve] = ()) -> list[str]:
        return [one.start.way for one in prices.spaced(priced, count, known=known)]

    assert ways(2) == ["5.0", "9.0"]
    assert ways(3) == ["5.0", "9.0", "12.0"]
    assert ways(4) == ["5.0", "9.0", "12.0", "6.0"]
    assert ways(9) == ["5.0", "9.0", "12.0", "6.0", "10.0"]  # 5.5 is nearer than 0.8 s to two others
    assert ways(9, [JointCurve.straight(np.zeros(1), np.array([9.5]), 3)]) == [
        "5.0",
        "12.0",
        "6.0",
    ]  # 1 s counts as near
    in_half_seconds = StartPrices(descent, screen, longest=LONGEST, alike=np.full(1, 0.5))
    assert len(in_half_seconds.spaced(priced, 9)) == 6
    assert prices.spaced([], 3) == []


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_arm_is_lowered_before_it_unfolds(seed: int) -> None:
    """From the straight line two of these seeds ended at 3,000 J, with the stick held out; 198 J are known."""
    robot = load_machine("telescope")
    scene: Any = random_site(robot, SiteKey("telescope", "open", "goal", 0, 861)).scene
    plan = bp.plan(robot, with_objective(scene, "work"), seed=seed)
    assert plan.verified
    assert plan.metrics.energy["work"] < 1.4 * 198.0
