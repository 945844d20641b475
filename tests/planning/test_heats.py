"""Which of many starts a search for the least work follows to the end.

The search is looked at from within: which descents gain late cannot be arranged from outside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from backhoe_planner.planning import EFFORTS, Work, World
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Timed
from backhoe_planner.planning.goal_postures import GoalPostures
from backhoe_planner.planning.motion_search import MotionSearch

# J of each start after 3 rounds, and after 6 more. The first seems best at first, the second is. The third is worse
# than 1.5 times that at the end, the last is 5 times the best even after 3 rounds.
COSTS = {0.2: (2.0, 1.4), 0.6: (3.0, 1.0), 1.0: (4.0, 1.6), 1.4: (10.0, 0.1)}


def test_the_start_is_followed_first_that_is_cheapest_after_more_rounds(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = [np.full(4, angle) for angle in COSTS]
    joints = {f"joint{k}": 0.0 for k in range(1, 5)}
    scene = {"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}, "objective": "work"}
    problem = build_problem(planar4, bp.scene_from_dict(scene))
    world = World(problem, seed=0, work=Work(EFFORTS["normal"]))
    search = MotionSearch(world, np.zeros(4), GoalPostures(tuple(ends), (problem.goals[0],) * 4), time=0.0)
    search._longest = 2.2  # s: the last start takes 1.9 s, and a seventh of it apart are told apart
    rounds_of: dict[float, list[int]] = {angle: [] for angle in COSTS}
    followed: list[float] = []
    motion = bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.zeros((2, 4)))

    def bend(curve: JointCurve, duration: float, _: Any, rounds: int, **__: Any) -> Timed:
        angle = float(curve.control[-1, 0])
        cost = COSTS[angle][min(len(rounds_of[angle]), 1)]
        rounds_of[angle].append(rounds)
        return Timed(curve, duration, motion, cost, 0.0, [])

    def descend(curve: JointCurve, *_: Any) -> bool:
        followed.append(float(curve.control[-1, 0]))
        return True

    monkeypatch.setattr(search, "_bend", bend)
    monkeypatch.setattr(search, "_descend", descend)
    starts = search._straight_starts()
    search._descend_cheapest((starts, len(starts)))
    assert len(starts) == 4
    assert rounds_of == {0.2: [3, 6], 0.6: [3, 6], 1.0: [3, 6], 1.4: [3]}
    assert followed == [0.6, 0.2]
