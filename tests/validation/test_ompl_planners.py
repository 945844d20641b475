"""OMPL's own planners on the same problem, and which of their paths are alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from validation.goal_runs import Best
from validation.ompl_planners import PLANNERS, Challenge, can_be_moved, pose_challenge, same_end, solve
from validation.ompl_runs import OWN, Run, table

# a ball of 0.1 m on two slides of 1 m/s, from -1 to 1 m each
GANTRY = """<robot name="gantry"><link name="base"/><link name="beam"/>
  <link name="ball"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="x" type="prismatic"><parent link="base"/><child link="beam"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="y" type="prismatic"><parent link="beam"/><child link="ball"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
POST = {"name": "post", "shape": "box", "size": [0.4, 0.4, 1.0], "position": [0.0, 0.0, 0.0]}
START, GOAL = np.array([-0.8, 0.0]), np.array([0.8, 0.0])


@pytest.fixture(scope="module")
def challenge(tmp_path_factory: pytest.TempPathFactory) -> Challenge:
    file = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    Path(file).write_text(GANTRY, encoding="utf-8")
    scene = bp.scene_from_dict(
        {
            "version": 1, "start": {"joints": {"x": -0.8, "y": 0.0}}, "clearance": 0.0, "obstacles": [POST],
            "task": {"goal": {"position": [0.8, 0.0, 0.0]}},
        }
    )  # fmt: skip
    found = pose_challenge(bp.load_robot(file), scene, seed=0)
    assert found is not None
    return found


def test_a_pose_goal_is_given_to_ompl_as_configurations(challenge: Challenge) -> None:
    assert len(challenge.goals) == 1
    assert challenge.goals[0] == pytest.approx(GOAL, abs=1e-6)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_path_leads_around_the_post_and_is_longer_than_the_shortest(challenge: Challenge, planner: str) -> None:
    found = solve(challenge, planner, 0.3, seed=0)
    assert found is not None
    way = found.way.q
    assert np.array_equal(way[0], START)
    assert np.array_equal(way[-1], challenge.goals[0])
    assert np.max(np.abs(way[:, 1])) > 0.2
    # the taut string around the corners of the post, which the ball's middle passes at 0.1 m
    away = np.hypot(0.6, 0.2)
    tangent, turn = np.sqrt(away**2 - 0.1**2), np.arctan2(0.2, 0.6) + np.arcsin(0.1 / away)
    shortest = 2.0 * (tangent + 0.1 * turn) + 0.4
    assert shortest < found.way.length(challenge.problem.limits) < 1.5 * shortest
    assert found.motion.duration > 1.6  # m at 1 m/s
    assert np.array_equal(found.motion.q[-1], way[-1])


def test_a_path_can_be_deformed_only_into_one_on_the_same_side(challenge: Challenge) -> None:
    check = challenge.check()
    left = np.array([START, [-0.4, 0.5], [0.4, 0.5], GOAL])
    wider = np.array([START, [-0.3, 0.8], [0.5, 0.7], GOAL])
    right = left * [1.0, -1.0]
    assert can_be_moved(check, left, wider)
    assert can_be_moved(check, wider, left)
    assert not can_be_moved(check, left, right)
    elsewhere = np.array([START, [-0.4, 0.5], [0.4, 0.5], [0.8, 0.2]])
    assert same_end(check.rate, left, right)
    assert not same_end(check.rate, left, elsewhere)
    assert not can_be_moved(check, left, elsewhere)


def test_the_table_compares_with_our_costs_and_the_best_known() -> None:
    best = Best()
    best.add("a", "1", 2.0, "known")
    best.add("b", "1", 3.0, "known")
    runs = [
        Run("a", "1", "BITstar", OWN, 0.3, 2.2, 4.0, end=True, moved=False),
        Run("b", "1", "BITstar", OWN, 0.3, None, 3.0),
    ]
    heads, _, line = ([cell.strip() for cell in text.strip("|").split("|")] for text in table(runs, best).splitlines())
    found = dict(zip(heads, line, strict=True))
    assert found["found"] == "50 %"
    assert found["/ best: median"] == "1.1"
    assert found["/ ours: median"] == "0.55"
    assert found["shorter than ours"] == "1"
    assert found["by another way"] == "1"
