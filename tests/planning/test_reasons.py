"""The words for why no motion was found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import InverseKinematics
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.search.postures import PostureResult
from backhoe_planner.planning.world.outcome import no_posture

START: Any = {"joints": {"swing": 0.0, "boom": 0.4, "stick": -1.6, "bucket": -0.9}}


def scene_to(goal: Any) -> bp.Scene:
    return bp.scene_from_dict({"version": 1, "start": START, "task": {"goal": goal}})


@pytest.mark.parametrize(
    ("margin", "words"),
    [
        (-0.004, "at the goal stick is 0.096 m from rock, 0.004 m closer than allowed"),
        (
            0.001,
            "at the goal stick is 0.101 m from rock, 0.001 m more than the least allowed, but the planner"
            " keeps 3 mm more at the end of a motion",
        ),
    ],
)
def test_a_goal_with_too_little_clearance_is_reported_with_its_distance(
    backhoe: bp.Robot, margin: float, words: str
) -> None:
    problem = build_problem(backhoe, scene_to({"position": [4.0, 0.0, 0.8]}))
    world = World(problem, seed=0, work=Work(EFFORTS["quick"]))
    contact = bp.Obstruction("obstacle", "rock", "stick", 0.1 + margin, margin)
    found = PostureResult((), InverseKinematics(True, backhoe.middle, 0.0, 0.0, 1), contact, backhoe.middle[None])
    outcome = no_posture(world, found, problem.goals[0].target, "goal_in_collision", "goal")
    assert outcome is not None
    assert outcome.reason == "goal_in_collision"
    assert outcome.message == words


def test_the_shortfall_of_a_goal_gives_distance_and_angle(backhoe: bp.Robot) -> None:
    """With all joints in the middle the tip is 3 m above the goal and 0.1 rad from its pitch."""
    at = bp.Kinematics(backhoe).at(backhoe.middle)
    place = (at.tip_position - np.array([0.0, 0.0, 3.0])).tolist()
    goal = build_problem(backhoe, scene_to({"position": place, "pitch": float(at.pitch) + 0.1})).goals[0]
    assert goal.shortfall(at) == "the tip ends 3.000 m from the goal and 5.7 deg from the asked angle"
