"""Rounds of descents: what each counts of the effort, and what is kept for later ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bar_scenes import STRETCHED, TURNED, problem_of

import backhoe_planner as bp
from backhoe_planner.motion import OBJECTIVES
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.counted_rounds import CountedRounds


def counted(robot: bp.Robot, objective: str, monkeypatch: pytest.MonkeyPatch) -> tuple[CountedRounds, Work, list[Any]]:
    """Rounds among no obstacles, of descents that make all they may, with the arguments of each."""
    problem = replace(problem_of(robot, STRETCHED, TURNED, []), objective=OBJECTIVES[objective])
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    rounds, given = CountedRounds(world, time=0.0), list[Any]()

    def make_all(*_: Any, most_rounds: int, **how: Any) -> None:
        rounds.descent.rounds += most_rounds
        given.append({"most_rounds": most_rounds, **how})

    monkeypatch.setattr(rounds.descent, "run", make_all)
    return rounds, world.work, given


def run(rounds: CountedRounds, most: int, *, longest: float = np.inf, in_one: int = 1) -> None:
    curve, goal = JointCurve.straight(STRETCHED, TURNED, 6), None
    rounds.run(
        curve, 4.0, goal, most, spare=0.003, density=2, box=0.1, is_hopeless=lambda here, rounds: False,  # type: ignore[arg-type]
        longest=longest, in_one=in_one,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("objective", "in_one", "used", "made"),
    [
        ("time", 1, 20, 20),
        ("work", 1, 7, 20),  # three rounds count as one
        ("hydraulic", 1, 4, 20),  # six for a cost that jumps
        ("work", 3, 3, 7),  # on a coarse curve nine, and three as one that is made
    ],
)
def test_rounds_for_another_cost_and_on_coarse_curves_count_less(
    backhoe: bp.Robot, monkeypatch: pytest.MonkeyPatch, objective: str, in_one: int, used: int, made: int
) -> None:
    rounds, work, _ = counted(backhoe, objective, monkeypatch)
    run(rounds, 20, in_one=in_one)
    assert work.descent_rounds == EFFORTS["normal"].descent_rounds - used
    assert rounds.made == made


def test_no_more_rounds_are_made_than_are_left_beside_the_reserved_ones(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 70 rounds for the time, 60 are reserved at first."""
    rounds, work, given = counted(planar4, "time", monkeypatch)
    rounds.reserve(60)
    assert rounds.left == 10
    run(rounds, 24)
    assert rounds.left == 0
    rounds.reserve(0)
    run(rounds, 24)
    assert [each["most_rounds"] for each in given] == [10, 24]
    assert work.descent_rounds == rounds.left == 36


@pytest.mark.parametrize(("longest", "given"), [(np.inf, 6.0), (5.0, 5.0)])
def test_a_motion_may_take_half_as_long_again_while_no_longest_time_is_known(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, longest: float, given: float
) -> None:
    rounds, _, how = counted(planar4, "work", monkeypatch)
    run(rounds, 3, longest=longest)
    assert how[0]["longest"] == given
