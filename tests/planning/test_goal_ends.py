"""The configurations at which a motion may end."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.motion import build_problem
from backhoe_planner.planning.search.goal_ends import GoalEnds


@pytest.mark.parametrize("apart", [0.0, 0.1, 0.4, 2.0])
def test_of_neighbouring_ends_within_a_time_the_soonest_are_kept(backhoe: bp.Robot, apart: float) -> None:
    middle = {"joints": dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))}
    problem = build_problem(backhoe, bp.scene_from_dict({"version": 1, "start": middle, "task": {"goal": middle}}))
    ends, rng = GoalEnds(problem, backhoe.middle), np.random.default_rng(3)
    ends.take([backhoe.random_q(rng) for _ in range(80)], [problem.goals[0]] * 80)
    longest = float(np.quantile(ends.least, 0.7))
    kept: list[int] = []  # the plain version: one after the other
    for index in sorted(range(80), key=lambda index: ends.least[index]):
        near = (np.max(np.abs(ends.postures[other] - ends.postures[index]) / backhoe.limits.velocity) for other in kept)
        if ends.least[index] <= longest and min(near, default=np.inf) > apart:
            kept.append(index)
    assert list(ends.within(longest, apart)) == kept
    assert len(kept) == 56 or apart > 0.0
