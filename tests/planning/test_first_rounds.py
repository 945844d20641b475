"""The first rounds of several starts, and a curve that leaves an obstacle that is cheap to go through."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import OBJECTIVES, build_problem
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Options, Timed
from backhoe_planner.planning.descent.descent_of_cost import DescentOfCost
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.multistart.cost_descents import CostDescents
from backhoe_planner.planning.multistart.first_rounds import Field, GivesUp, after_first_rounds
from backhoe_planner.planning.multistart.incumbent import Incumbent
from backhoe_planner.planning.multistart.start_prices import Start
from backhoe_planner.planning.multistart.straight_lines import STRAIGHT
from backhoe_planner.planning.search.effort import Brake
from validation.goal_runs import with_objective
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site


def starts_at(*places: float) -> list[Start]:
    """One start for each place, which is also its name."""
    goal: Any = None
    return [Start(JointCurve(np.full((3, 1), at)), 1.0, goal, str(at)) for at in places]


class Rounds:
    """Rounds with known costs and missing clearances: at first, and once clearance counts most."""

    def __init__(self, first: dict[str, tuple[float, float]], out: dict[str, tuple[float, float] | None]) -> None:
        self.first, self.out, self.pushed = first, out, list[str]()

    def __call__(
        self, start: Start, rounds: int, *, gives_up: GivesUp, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        if clear_first:
            self.pushed.append(start.way)
        known = (self.out if clear_first else self.first)[start.way]
        if known is None:
            return None
        return Timed(start.curve, 1.0, *known, margins=Margins.none(4))


def test_much_cheaper_starts_in_an_obstacle_are_pushed_out_and_ranked_by_their_new_cost() -> None:
    """10 J that lack 0.01 m count as 10.6 J; of 3, 4, 6.9 and 9 J in obstacles, three are below 7/10 of 10 J."""
    first = {"1.0": (10.0, 0.01), "2.0": (4.0, 0.3), "3.0": (3.0, 0.2), "4.0": (6.9, 0.1), "5.0": (9.0, 0.2)}
    rounds = Rounds(first, {"2.0": (8.0, 0.0), "3.0": None, "4.0": (7.0, 0.05)})
    found = after_first_rounds(starts_at(1.0, 2.0, 3.0, 4.0, 5.0), rounds, far_off=0.06, pushed=4)
    assert rounds.pushed == ["3.0", "2.0", "4.0"]
    assert [(cost, start.way) for cost, start in found.clear] == [(8.0, "2.0"), (pytest.approx(10.6), "1.0")]
    assert [(cost, start.way) for cost, start in found.blocked] == [
        (3.0, "3.0"), (4.0, "2.0"), (6.9, "4.0"), (9.0, "5.0"),
    ]  # fmt: skip
    assert found.least_blocked == 3.0
    again = Rounds(first, {"3.0": None})
    assert len(after_first_rounds(starts_at(1.0, 2.0, 3.0), again, far_off=0.06, pushed=1).clear) == 1
    assert again.pushed == ["3.0"]


def test_a_start_falls_behind_if_it_costs_much_more_than_another_one_after_as_many_rounds() -> None:
    """5/6 more after a round and a half, 5/8 after two; misses count six times, and costs below 2 J alike."""
    start = starts_at(1.0)[0]

    def at(cost: float, missed: float = 0.0) -> Timed:
        return Timed(start.curve, 1.0, cost, missed, margins=Margins.none(4))

    field = Field(little=2.0)
    assert not any(field.falls_behind(at(cost), rounds) for rounds, cost in ((0.0, 50.0), (1.5, 30.0), (2.0, 10.0)))
    field.end(at(10.0))
    assert not field.falls_behind(at(1e3), 1.0)  # too soon
    assert not field.falls_behind(at(54.9), 1.5)
    field.end(at(54.9))
    assert field.falls_behind(at(55.1), 1.5)
    field.end(at(55.1))
    assert not field.falls_behind(at(16.2), 2.0)
    field.end(at(1.0, missed=0.3))  # it stays in an obstacle: its costs do not count
    assert field.falls_behind(at(15.0, missed=0.015), 2.0)
    field.end(None)
    assert not field.falls_behind(at(16.2), 2.0)
    assert not field.falls_behind(at(1e3), 2.0)  # it was cheaper before
    field.end(at(16.2))
    assert field.falls_behind(at(14.2), 3.0)  # the cheapest had ended by then: 5/12 more than its last cost
    little = Field(little=2.0)
    assert not little.falls_behind(at(0.1), 1.5)  # none is before it
    little.end(at(0.1))
    assert not little.falls_behind(at(3.6), 1.5)
    little.end(None)
    assert little.falls_behind(at(3.7), 1.5)


def test_a_start_that_stays_in_an_obstacle_is_pushed_for_some_rounds_only() -> None:
    """It gives up in the fifth round with more than four fifths of its first miss, but not with less."""
    ended: dict[str, list[int]] = {"stays": [], "leaves": []}

    def bend(
        start: Start, rounds: int, *, gives_up: GivesUp, density: int = 1, clear_first: bool = False
    ) -> Timed | None:  # fmt: skip
        blocked = Timed(start.curve, 1.0, 1.0, 0.5, margins=Margins.none(4))
        if not clear_first:
            return replace(blocked, cost=10.0, missed=0.0) if start.way == "clear" else blocked
        left = 0.45 if start.way == "stays" else 0.35
        made = next((k for k in range(rounds) if gives_up(blocked if k < 1 else replace(blocked, missed=left), k)), -1)
        ended[start.way].append(made)
        return blocked

    starts = [replace(start, way=way) for start, way in zip(starts_at(1.0, 2.0, 3.0), ("clear", *ended), strict=True)]
    after_first_rounds(starts, bend, far_off=0.06, pushed=2, field=Field(0.0))
    after_first_rounds(starts, bend, far_off=0.06, pushed=2)
    assert ended == {"stays": [5, -1], "leaves": [-1, -1]}


def test_no_cost_is_blocked_if_all_starts_get_clear() -> None:
    found = after_first_rounds(starts_at(1.0), Rounds({"1.0": (10.0, 0.0)}, {}), far_off=0.06, pushed=4)
    assert [cost for cost, _ in found.clear] == [10.0]
    assert found.blocked == []
    assert found.least_blocked == np.inf


def test_a_curve_leaves_an_obstacle_only_if_clearance_comes_first(backhoe: bp.Robot) -> None:
    """A level swing costs little but passes the bucket through a ball of 0.5 m; going past costs several times that."""
    start = backhoe.middle
    end = start.copy()
    end[0] += 1.2
    at_half = Kinematics(backhoe).at(0.5 * (start + end)).tip_position
    ball = {"name": "ball", "shape": "sphere", "radius": 0.5, "position": at_half.tolist()}
    content: Any = {
        "version": 1,
        "start": {"joints": dict(zip(backhoe.joint_names, start.tolist(), strict=True))},
        "task": {"goal": {"joints": dict(zip(backhoe.joint_names, end.tolist(), strict=True))}},
        "obstacles": [ball],
    }
    problem = replace(build_problem(backhoe, bp.scene_from_dict(content)), objective=OBJECTIVES["work"])
    proximity = bp.Proximity(backhoe, problem.obstacles)
    missed = {}
    for clear_first in (False, True):
        descent = DescentOfCost(problem, proximity, Kinematics(backhoe), time=0.0, brake=Brake())
        options = Options(
            14, spare=0.003, density=3, box=0.25, is_hopeless=lambda here, rounds: here.missed <= 0.0015, longest=12.0,
            unsampled=True, clear_first=clear_first,
        )  # fmt: skip
        found = descent.run(JointCurve.straight(start, end, 12), 12.0, problem.goals[0], options)
        assert found is not None
        missed[clear_first] = found.missed
    assert missed[True] <= 0.0015
    assert missed[False] > 0.1


def test_the_first_rounds_of_a_straight_line_are_twice_as_many_on_a_coarse_curve_and_count_less(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six rounds on 6 pieces count as two; three of a sampled way on 12 pieces count as three."""
    start, end = backhoe.middle, backhoe.middle + 0.3
    joints = [dict(zip(backhoe.joint_names, q.tolist(), strict=True)) for q in (start, end)]
    content: Any = {"version": 1, "start": {"joints": joints[0]}, "task": {"goal": {"joints": joints[1]}}}
    problem = replace(build_problem(backhoe, bp.scene_from_dict(content)), objective=OBJECTIVES["work"])
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    goal = problem.goals[0]
    descents = CostDescents(world, start, Incumbent(world, time=0.0, longest=12.0), time=0.0)
    descent = descents._descent
    run, made = descent.run, list[tuple[int, int]]()

    def note(curve: JointCurve, duration: float, goal: Any, options: Options) -> Timed | None:
        made.append((curve.pieces, options.most_rounds))
        descent.rounds += options.most_rounds
        return run(curve, duration, goal, replace(options, most_rounds=0))

    monkeypatch.setattr(descent, "run", note)
    counted = [0]
    for way in (STRAIGHT, "sampled"):
        line = Start(JointCurve.straight(start, end, 12), 6.0, goal, way)
        found = descents._few_rounds(line, 3, gives_up=lambda here, rounds: False)
        assert found is not None
        np.testing.assert_allclose(found.curve.control[[0, -1]], [start, end], atol=1e-9)
        assert found.curve.pieces == 12
        counted.append(descents.rounds.made)
    assert made == [(6, 6), (12, 3)]
    assert np.diff(counted).tolist() == [2, 3]


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_swing_past_a_single_obstacle_needs_little_work(seed: int) -> None:
    """A motion of 4 J is known; from sampled detours these seeds ended at 79, 16 and 16 J."""
    robot = load_machine("backhoe")
    scene: Any = random_site(robot, SiteKey("backhoe", "open", "goal", 0, 1002)).scene
    plan = bp.plan(robot, with_objective(scene, "work"), seed=seed)
    assert plan.verified
    assert plan.metrics.energy["work"] < 8.0
