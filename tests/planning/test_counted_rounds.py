"""Rounds of descents: what each counts of the effort, and what is kept for later ones."""

from __future__ import annotations

from typing import Any

import pytest
from one_joint_search import END, START

from backhoe_planner.planning import EFFORTS, Work
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Options
from backhoe_planner.planning.multistart.counted_rounds import CountedRounds


class AllRounds:
    """Descents that make all rounds they may."""

    def __init__(self) -> None:
        self.rounds, self.given = 0, list[Options]()

    def run(self, curve: JointCurve, duration: float, goal: Any, options: Options) -> None:
        self.rounds += options.most_rounds
        self.given.append(options)


def counted(*, in_one: int = 1) -> tuple[CountedRounds, Work, list[Options]]:
    descent: Any = AllRounds()
    work = Work(EFFORTS["normal"])
    return CountedRounds(work, descent, in_one=in_one), work, descent.given


def run(rounds: CountedRounds, most: int, **how: Any) -> None:
    goal: Any = None
    rounds.run(JointCurve.straight(START, END, 6), 4.0, goal, Options(most, 0.003, 2, 0.1), **how)


@pytest.mark.parametrize(
    ("in_one", "coarse_in_one", "used", "made"),
    [
        (1, 1, 20, 20),
        (3, 1, 7, 20),  # three rounds count as one
        (6, 1, 4, 20),
        (3, 3, 3, 7),  # on a coarse curve nine, and three as one that is made
    ],
)
def test_rounds_for_another_cost_and_on_coarse_curves_count_less(
    in_one: int, coarse_in_one: int, used: int, made: int
) -> None:
    rounds, work, _ = counted(in_one=in_one)
    run(rounds, 20, coarse_in_one=coarse_in_one)
    assert work.descent_rounds == EFFORTS["normal"].descent_rounds - used
    assert rounds.made == made


def test_no_more_rounds_are_made_than_are_left_beside_the_reserved_ones() -> None:
    """Of 70 rounds for the time, 60 are reserved at first."""
    rounds, work, given = counted()
    rounds.reserve(60)
    assert rounds.left == 10
    run(rounds, 24)
    assert rounds.left == 0
    rounds.reserve(0)
    run(rounds, 24)
    assert [each.most_rounds for each in given] == [10, 24]
    assert work.descent_rounds == rounds.left == 36


def test_of_rounds_that_take_less_time_more_may_be_made() -> None:
    rounds, _, given = counted(in_one=3)
    rounds.reserve(65)
    assert (rounds.left, rounds.left_of_cost) == (5, 15)
    run(rounds, 80)
    assert given[0].most_rounds == 15
