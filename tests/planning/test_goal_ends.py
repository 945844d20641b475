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


@pytest.mark.parametrize("most", [5, 20, 1000])
def test_of_many_ends_within_a_time_at_most_so_many_are_kept_and_they_are_far_apart(
    backhoe: bp.Robot, most: int
) -> None:
    middle = {"joints": dict(zip(backhoe.joint_names, backhoe.middle.tolist(), strict=True))}
    problem = build_problem(backhoe, bp.scene_from_dict({"version": 1, "start": middle, "task": {"goal": middle}}))
    ends, rng, alike = GoalEnds(problem, backhoe.middle), np.random.default_rng(3), 0.5 * backhoe.limits.velocity
    ends.take([backhoe.random_q(rng) for _ in range(80)], [problem.goals[0]] * 80)
    longest = float(np.quantile(ends.least, 0.7))
    kept = ends.many_within(longest, most=most, alike=alike)
    soon = [index for index in ends.order if ends.least[index] <= longest]
    assert len(kept) <= most
    assert kept[0] == soon[0]
    assert kept == [index for index in soon if index in kept]
    places = ends.at(kept) / alike
    apart = np.max(np.abs(places[:, None] - places[None]), axis=2)[~np.eye(len(kept), dtype=bool)]
    assert apart.min() > 0.005 * longest
    for index in set(soon) - set(kept):  # a dropped end has a sooner one nearby, no further than the kept ones
        off = np.max(np.abs(ends.at([index]) / alike - places), axis=1)
        assert any(
            ends.least[other] <= ends.least[index] for other, d in zip(kept, off, strict=True) if d <= apart.min()
        )
    if most == 1000:
        assert len(kept) > 40
