"""Starts that go through obstacles: kept once they cannot get clear, and led around along sampled detours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bar_scenes import BAR, STRETCHED, TURNED, Data, problem_of

import backhoe_planner as bp
from backhoe_planner.machine import GRAVITY
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.goals.allowed_time import bound_for_allowed_time
from backhoe_planner.planning.goals.cost_search import CostSearch
from backhoe_planner.planning.goals.goal_postures import GoalPostures, find_goal_postures
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.incumbent import Incumbent
from backhoe_planner.planning.multistart.lift import Lift
from backhoe_planner.planning.multistart.start_prices import PricedStart, Start
from backhoe_planner.planning.multistart.ways import Ways
from backhoe_planner.planning.search.goal_ends import GoalEnds

PIECES = 60  # so many that a curve follows a detour to within millimetres
# a second bar, further along the arc
SECOND = BAR | {"name": "second", "size": [0.6, 0.1, 1.0], "position": [0.6, 3.6, 0.0], "rpy": [0, 0, 1.4]}


def line_through(robot: bp.Robot, *obstacles: Data, turned: float = 1.5) -> tuple[World, Ways, Start]:
    """The straight line by which the stretched arm sweeps across the obstacles, and ways among them."""
    end = TURNED * (turned / TURNED[0])
    problem = replace(problem_of(robot, STRETCHED, end, list(obstacles)), objective=OBJECTIVES["velocity_norm"])
    world = World(problem, seed=3, work=Work(EFFORTS["normal"]))
    ends = GoalEnds(problem, STRETCHED)
    ends.take([end], [problem.goals[0]])
    start = Start(JointCurve.straight(STRETCHED, end, PIECES), 6.0, problem.goals[0], "straight")
    return world, Ways(world, STRETCHED, ends, time=0.0, hurried=False), start


def margins(world: World, curve: JointCurve) -> np.ndarray:
    """The least margin at each of 101 places of a curve; 1 m if nothing is near."""
    proximity = world.proximity
    return np.array(
        [float(np.min(proximity.at(q, margin=1.0).margin, initial=1.0)) for q in curve(np.linspace(0.0, 1.0, 101))]
    )


@pytest.mark.parametrize(("obstacles", "turned"), [([BAR], 1.5), ([BAR, SECOND], 1.9)])
def test_a_blocked_start_is_led_around_every_obstacle_and_stays_as_it_is_elsewhere(
    planar4: bp.Robot, obstacles: list[Data], turned: float
) -> None:
    world, ways, line = line_through(planar4, *obstacles, turned=turned)
    before = margins(world, line.curve)
    runs = np.count_nonzero(np.diff((before < 0.0).astype(int)) == 1)
    assert runs == len(obstacles)
    assert before.min() < -0.05
    around = ways.around(line, 0)
    assert around is not None
    assert margins(world, around.curve).min() > -0.01
    np.testing.assert_allclose(around.curve.control[[0, -1]], line.curve.control[[0, -1]], atol=1e-12)
    # near both ends only the first joint moves, as along the line
    first = around.curve(np.linspace(0.0, 0.1, 5))
    assert np.abs(first[:, 1:]).max() < 0.02
    assert (around.goal, around.duration) == (line.goal, line.duration)


def test_a_clear_start_and_one_that_ends_in_an_obstacle_have_no_detour(planar4: bp.Robot) -> None:
    far = BAR | {"position": [0.0, -3.0, 0.0]}
    _, ways, line = line_through(planar4, far)
    assert ways.around(line, 0) is None
    _, ways, line = line_through(planar4, BAR)
    halfway = replace(line, curve=JointCurve.straight(STRETCHED, 0.4 * TURNED, PIECES))
    assert ways.around(halfway, 0) is None


def test_starts_that_stay_in_an_obstacle_are_handed_out_once_the_cheapest_first(planar4: bp.Robot) -> None:
    """Both ends are fixed and a wall is between them, as wide as the arm is long: a few rounds do not lead past it."""
    wall: Data = {
        "name": "wall",
        "shape": "box",
        "size": [8.0, 0.1, 1.0],
        "position": [4.1, 2.0, 0.0],
        "rpy": [0, 0, 0.6],
    }
    world, _, line = line_through(planar4, wall)
    descents = CostDescents(world, STRETCHED, Incumbent(world, time=0.0, longest=6.0), time=0.0)
    short = replace(line, curve=JointCurve.straight(STRETCHED, TURNED, 8))
    control = short.curve.control.copy()
    control[4, 3] += 0.3
    bent = replace(short, curve=short.curve.moved_to(control))
    descents.descend_cheapest([PricedStart(short, 1.0), PricedStart(bent, 2.0)])
    found = descents.take_blocked()
    assert len(found) == 2
    assert [cost for cost, _ in found] == sorted(cost for cost, _ in found)
    assert descents.take_blocked() == []


def test_without_a_proven_fast_motion_a_route_round_the_bar_says_how_long_a_motion_may_take(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No start has a duration before: it is three times the bound, or half as long again, as often as needed."""
    monkeypatch.setattr(CostSearch, "_find_fast", lambda _: [])
    world, _, _ = line_through(planar4, BAR)
    found = find_goal_postures(world, world.problem.goals, near=STRETCHED, time=0.0)
    assert isinstance(found, GoalPostures)
    search = CostSearch(world, STRETCHED, found, time=0.0)
    assert search.run() == ""
    assert search.best is not None
    assert search.allowed_time is not None
    assert search.best.motion.duration <= search.allowed_time
    steps = np.log(search.allowed_time / (3.0 * bound_for_allowed_time(world.problem, STRETCHED))) / np.log(1.5)
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert steps > -1e-9
    assert search.best.curve is not None
    assert margins(world, search.best.curve).min() > -1e-4


def test_a_cost_is_near_the_lift_up_to_a_twentieth_and_what_is_worth_a_search(backhoe: bp.Robot) -> None:
    """Raising the boom lifts known masses; going down lifts nothing."""
    low, high = backhoe.middle, backhoe.middle.copy()
    high[1] += 0.3
    joints = dict(zip(backhoe.joint_names, low.tolist(), strict=True))
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}}
    lift = Lift(bp.build_problem(backhoe, bp.scene_from_dict(content)))
    lifted = lift.least(low, [high])
    assert lifted > 1_000.0
    assert lift.worth == pytest.approx(2e-4 * GRAVITY * sum(i.mass for i in list(backhoe.model.inertias)[1:]), rel=1e-6)
    assert lift.is_near(1.049 * lifted, low, [high])
    assert not lift.is_near(1.051 * lifted + lift.worth, low, [high])
    assert lift.is_near(0.9 * lift.worth, high, [low])
    assert not lift.is_near(1.1 * lift.worth, high, [low])
