"""The best motion of a search: which motion replaces it, and that it is proven."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from bar_scenes import BAR, STRETCHED, TURNED, Data, problem_of

import backhoe_planner as bp
from backhoe_planner.motion import OBJECTIVES, Problem, time_evenly
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent

AWAY: Data = BAR | {"position": [0.0, -8.0, 0.0]}
CLEAR = np.array([-0.2, 0.0, 0.0, 0.0])  # away from the bar, which `TURNED` is behind


def world_of(robot: bp.Robot, *obstacles: Data) -> tuple[World, Problem]:
    problem = replace(problem_of(robot, STRETCHED, TURNED, list(obstacles)), objective=OBJECTIVES["work"])
    return World(problem, seed=0, work=Work(EFFORTS["normal"])), problem


def found(problem: Problem, cost: float, duration: float, end: np.ndarray = TURNED) -> FoundMotion:
    return FoundMotion(time_evenly(JointCurve.straight(STRETCHED, end, 12), duration), cost, problem.goals[0], "")


@pytest.mark.parametrize(
    ("first", "second", "replaced"),
    [
        ((10.0, 4.0), (9.0, 5.0), True),
        ((10.0, 4.0), (10.0, 3.0), False),  # it costs no less
        ((10.0, 4.0), (5.0, 7.0), False),  # it takes too long
        ((10.0, 8.0), (20.0, 5.0), True),  # the first takes too long
        ((10.0, 8.0), (9.0, 7.0), True),  # both do
    ],
)
def test_a_motion_replaces_the_best_if_it_costs_less_or_the_best_takes_too_long(
    planar4: bp.Robot, first: tuple[float, float], second: tuple[float, float], replaced: bool
) -> None:
    world, problem = world_of(planar4, AWAY)
    incumbent = Incumbent(world, time=0.0, longest=6.0)
    assert not incumbent.has_improved
    motions = [found(problem, *each) for each in (first, second)]
    for motion in motions:
        assert incumbent.offer(motion)
    assert incumbent.best is motions[replaced]
    assert incumbent.has_improved


def test_a_motion_through_an_obstacle_is_never_the_best_and_a_dear_one_is_not_checked(planar4: bp.Robot) -> None:
    world, problem = world_of(planar4, BAR)
    incumbent = Incumbent(world, time=0.0)
    assert not incumbent.offer(found(problem, 10.0, 6.0))
    assert incumbent.best is None
    clear = found(problem, 20.0, 6.0, CLEAR)
    assert incumbent.offer(clear)
    assert not incumbent.offer(found(problem, 10.0, 6.0))
    assert incumbent.offer(found(problem, math.inf, 6.0))
    assert incumbent.best is clear


def test_a_motion_that_is_known_at_first_is_no_improvement(planar4: bp.Robot) -> None:
    world, problem = world_of(planar4, AWAY)
    known = found(problem, 10.0, 4.0)
    incumbent = Incumbent(world, time=0.0, longest=6.0, best=known)
    assert incumbent.offer(found(problem, 11.0, 4.0))
    assert incumbent.best is known
    assert not incumbent.has_improved
    assert incumbent.offer(found(problem, 9.0, 4.0))
    assert incumbent.has_improved
