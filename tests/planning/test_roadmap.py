"""Roadmaps: configurations within reach, and distinct clear paths, the cheapest first."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bar_scenes import STRETCHED, TURNED, across_bar, problem_of
from machines import Axis, load_chain

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem
from backhoe_planner.planning import EFFORTS, JointPath, Reach, Roadmap, SampledCheck, beyond_limits, joint_time
from backhoe_planner.site import Proximity
from validation.goal_runs import with_objective
from validation.habitats import load_machine
from validation.sites import SiteKey, random_site

LONGEST = 8.0  # s


def ways_across(
    robot: bp.Robot, *, seed: int = 0, longest: float = LONGEST, known: tuple[Matrix, ...] = (), most: int = 6
) -> tuple[Problem, Proximity, list[JointPath]]:
    problem, proximity = across_bar(robot)
    check = SampledCheck(problem, proximity, [STRETCHED, TURNED], spare=0.002)
    reach = Reach(problem.limits, STRETCHED, TURNED[None, :], longest)
    price = joint_time(problem.limits.velocity)
    roadmap = Roadmap(check, reach, nodes=400, rng=np.random.default_rng(seed), price=price, known=known)
    return problem, proximity, list(itertools.islice(roadmap.ways(), most))


def price_of(problem: Problem, way: JointPath) -> float:
    return float(np.sum(joint_time(problem.limits.velocity)(way.q[:-1], way.q[1:])))


@pytest.mark.parametrize(
    ("beyond", "within"),
    [(0.49, True), (0.51, False)],  # 1 rad/s and 2 rad/s^2 in 3 s: 2.5 rad in all, 1.5 of them to the end
)
def test_reach_extends_beyond_start_and_end_as_far_as_time_allows(
    planar4: bp.Robot, beyond: float, within: bool
) -> None:
    reach = Reach(planar4.limits, STRETCHED, TURNED[None, :], 3.0)
    before, after = np.zeros(4), TURNED.copy()
    before[0], after[0] = -beyond, 1.5 + beyond
    aside = 0.5 * TURNED
    aside[2] = 1.25 + beyond - 0.5  # 2.5 rad there and back, to within a hundredth
    assert reach.holds(np.array([before, after, aside])).tolist() == [within] * 3
    lower, upper = reach.box()
    assert bool(lower[0] <= -beyond and 1.5 + beyond <= upper[0]) is within


def test_ranges_of_drawing_are_widened_only_at_joint_limits(planar4: bp.Robot) -> None:
    lower, upper = planar4.limits.lower, planar4.limits.upper
    low, high = beyond_limits(planar4.limits, np.array([lower, lower + 0.1]), np.array([upper - 0.1, upper]))
    wide = upper - lower - 0.1
    np.testing.assert_allclose(low, [lower - 0.25 * wide, lower + 0.1], atol=1e-12)
    np.testing.assert_allclose(high, [upper - 0.1, upper + 0.25 * wide], atol=1e-12)


def test_reach_holds_configurations_on_the_way_to_any_of_several_ends(planar4: bp.Robot) -> None:
    reach = Reach(planar4.limits, STRETCHED, np.array([TURNED, -TURNED]), 3.0)
    assert reach.holds(np.array([-0.5 * TURNED, 0.5 * TURNED, 1.5 * TURNED])).tolist() == [True, True, False]
    assert Reach(planar4.limits, STRETCHED, TURNED[None, :]).holds(np.full((1, 4), 3.0)).all()


def test_paths_of_a_roadmap_are_clear_and_within_reach_with_the_cheapest_first(planar4: bp.Robot) -> None:
    problem, proximity, ways = ways_across(planar4)
    assert len(ways) == 6
    reach = Reach(problem.limits, STRETCHED, TURNED[None, :], LONGEST)
    for way in ways:
        np.testing.assert_array_equal(way.q[[0, -1]], [STRETCHED, TURNED])
        assert reach.holds(way.q).all()
        between = np.vstack([np.linspace(a, b, 60) for a, b in itertools.pairwise(way.q)])
        assert min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in between) > 0.0
    prices = [price_of(problem, way) for way in ways]
    assert prices == sorted(prices)


def test_no_path_of_a_roadmap_is_near_an_earlier_one_all_along(planar4: bp.Robot) -> None:
    problem, _, ways = ways_across(planar4)
    rate = problem.limits.velocity
    for index, way in enumerate(ways):
        for earlier in ways[:index]:
            places = np.vstack([np.linspace(a, b, 200) for a, b in itertools.pairwise(earlier.q)])
            length = float(np.sum(np.max(np.abs(np.diff(earlier.q, axis=0)) / rate, axis=1)))
            apart = [float(np.min(np.max(np.abs(places - q) / rate, axis=1))) for q in way.q]
            assert max(apart) > 0.14 * length  # 0.15, less the spacing of the places on the earlier path


def test_a_known_path_is_not_returned_again(planar4: bp.Robot) -> None:
    problem, _, ways = ways_across(planar4, most=1)
    _, _, others = ways_across(planar4, known=(ways[0].q,), most=1)
    rate = problem.limits.velocity
    away = [float(np.min(np.max(np.abs(ways[0].q - q) / rate, axis=1))) for q in others[0].q]
    assert max(away) > 0.5  # s; the path takes more than 4 s


def test_the_same_seed_gives_the_same_paths(planar4: bp.Robot) -> None:
    once, again, other = (ways_across(planar4, seed=seed)[2] for seed in (1, 1, 2))
    for a, b in zip(once, again, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
    assert any(a.q.shape != b.q.shape or (a.q != b.q).any() for a, b in zip(once, other, strict=False))


def test_no_path_longer_than_allowed_is_returned(planar4: bp.Robot) -> None:
    # 1.5 rad take 2 s straight through the bar
    assert ways_across(planar4, longest=2.01)[2] == []


def test_a_cost_of_upward_motion_is_avoided(planar4: bp.Robot) -> None:
    """There are no obstacles; raising the second joint costs ten times as much as other motions."""
    problem = problem_of(planar4, STRETCHED, TURNED, [])
    check = SampledCheck(problem, Proximity(problem.robot, []), [STRETCHED, TURNED], spare=0.0)
    reach = Reach(problem.limits, STRETCHED, TURNED[None, :], 6.0)
    time = joint_time(problem.limits.velocity)

    def price(a: Matrix, b: Matrix) -> Vector:
        return np.asarray(time(a, b) + 10.0 * np.maximum(b[:, 1] - a[:, 1], 0.0))

    def raised(way: JointPath) -> float:
        return float(np.sum(np.maximum(np.diff(way.q[:, 1]), 0.0)))

    # it has to come up again after going down, which costs as much as going down has saved
    roadmap = Roadmap(check, reach, nodes=600, rng=np.random.default_rng(0), price=price)
    way = next(roadmap.ways())
    plain = Roadmap(check, reach, nodes=600, rng=np.random.default_rng(0), price=time)
    cheap = [float(np.sum(price(one.q[:-1], one.q[1:]))) for one in itertools.islice(plain.ways(), 6)]
    assert float(np.sum(price(way.q[:-1], way.q[1:]))) <= min(cheap)
    assert raised(way) < 0.3


def test_a_joint_limit_is_one_configuration_of_a_roadmap(tmp_path: Path) -> None:
    """With one joint from 0 to 1 m, a quarter or so of what is drawn lies at the limit where the motion begins."""
    robot = load_chain(tmp_path, [Axis("prismatic", "0 0 1", 0.0, 1.0)], ball=0.1)
    start, end = np.zeros(1), np.array([0.5])
    problem = problem_of(robot, start, end, [])
    check = SampledCheck(problem, Proximity(robot, []), [start, end], spare=0.0)
    price = joint_time(problem.limits.velocity)
    reach = Reach(problem.limits, start, end[None, :], 2.0)
    roadmap = Roadmap(check, reach, nodes=400, rng=np.random.default_rng(0), price=price)
    drawn = roadmap._q[2:, 0]  # without the start and the end
    assert np.count_nonzero(drawn == 0.0) == 1
    assert len(np.unique(drawn)) == len(drawn)


@pytest.mark.long
def test_a_detour_past_another_side_of_the_obstacles_is_found() -> None:
    """Sampled paths of this seed lead to 3.82 s; past another side of the obstacles it takes 2.77 s."""
    robot = load_machine("planar4")
    scene: Any = random_site(robot, SiteKey("planar4", "open", "goal", 0, 504)).scene
    plan = bp.plan(robot, with_objective(scene, "time"), seed=1)
    assert plan.verified
    assert plan.metrics.duration < 1.03 * 2.77


def test_efforts_without_a_roadmap_reserve_no_rounds_for_its_paths() -> None:
    """Such rounds would only refine a curve."""
    for effort in EFFORTS.values():
        more = (effort.way_rounds, effort.led_rounds, effort.hop_rounds)
        assert [rounds > 0 for rounds in more] == 3 * [effort.dull_searches > 0]
