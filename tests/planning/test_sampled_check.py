"""Sampled checks: motions proven clear pass, and motions that pass are at most a little too near."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bar_scenes import STRETCHED, TURNED, across_bar, problem_of

import backhoe_planner as bp
from backhoe_planner.planning import EFFORTS, MotionCheck, SampledCheck, Work, find_distinct, places, sample_path
from backhoe_planner.site import Proximity

APART = {
    False: 0.04,
    True: 0.08,
}  # m between two samples, hurried or not: midway a distance is less by half of it at most


@pytest.mark.parametrize(
    "any_robot",
    ["planar4", "backhoe", pytest.param("panda", marks=pytest.mark.long), pytest.param("ur5", marks=pytest.mark.long)],
    indirect=True,
)
@pytest.mark.parametrize("hurried", [False, True])
def test_sampled_checks_agree_with_proofs_and_dense_measurements(any_robot: bp.Robot, hurried: bool) -> None:
    """Random segments and corners among balls."""
    rng = np.random.default_rng(11)
    reach = 3.0 if any_robot.n == 4 else 0.6
    places = reach * rng.normal(size=(8, 3))
    places[:, 0] = np.abs(places[:, 0])
    obstacles: list[dict[str, Any]] = [
        {"name": f"{k}", "shape": "sphere", "radius": 0.1 * reach, "position": place}
        for k, place in enumerate(places.tolist())
    ]
    q_0 = any_robot.random_q(rng)
    problem = problem_of(any_robot, q_0, q_0, obstacles)
    proximity = Proximity(problem.robot, problem.obstacles)
    proof = MotionCheck(problem, proximity, [q_0], spare=0.0)
    look = SampledCheck(problem, proximity, [q_0], spare=0.0, hurried=hurried)
    count = {True: 0, False: 0}
    still = np.zeros(any_robot.n)
    t = np.linspace(0.0, 1.0, 60)[:, None]
    for _ in range(25):
        a = any_robot.random_q(rng)
        b, c = (np.clip(a + 0.3 * rng.normal(size=any_robot.n), any_robot.limits.lower, any_robot.limits.upper)
                for _ in range(2))  # fmt: skip
        for clear, proven, curve in (
            (look.segment_is_clear(a, b), proof.segment_is_clear(a, b), a + t * (b - a)),
            (
                look.corner_is_clear(a, b, c, sagitta=still),
                proof.corner_is_clear(a, b, c, sagitta=still),
                (1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c,
            ),
        ):
            least = min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in curve)
            assert clear or not proven
            assert least >= -0.5 * APART[hurried] if clear else least < 0.01
            count[clear] += 1
    assert min(count.values()) >= 10


@pytest.mark.parametrize("margin", [0.0, 1e-5, 0.004])
def test_a_start_with_less_than_the_spare_clearance_can_be_left(planar4: bp.Robot, margin: float) -> None:
    """A ball beside the stretched arm, at its clearance plus `margin` from link 3; elsewhere the spare is kept."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.2, "position": [2.5, -0.26 - margin, 0.0]}
    problem, proximity = across_bar(planar4, ball)
    check = SampledCheck(problem, proximity, [STRETCHED, TURNED], spare=0.02)
    assert check.ends_clear == [True, True]
    way = sample_path(check, STRETCHED, [TURNED], seed=0, work=Work(EFFORTS["normal"]))
    assert way is not None
    obstacles_alone = Proximity(problem.robot, problem.obstacles, self_collision=False)
    for q in way.q:
        margins = obstacles_alone.distances(q) - obstacles_alone.clearance
        assert np.min(margins) >= (0.02 if np.linalg.norm(q) > 0.5 else 0.0) - 1e-6
    into_the_ball = np.array([0.0, 0.0, -0.1, 0.0])
    assert not check.segment_is_clear(STRETCHED, into_the_ball)


def test_a_motion_is_checked_at_its_ends_and_then_in_the_order_of_van_der_corput() -> None:
    """Fifths, which fall between the halvings, come in the order of the eighths of their number."""
    assert places(1) == (1.0, 0.0)
    assert places(4) == (1.0, 0.0, 0.5, 0.25, 0.75)
    assert places(5) == (1.0, 0.0, 0.8, 0.4, 0.2, 0.6)


def test_of_neighbouring_configurations_the_first_is_kept() -> None:
    """A chain in steps of 0.9: one of two neighbours is kept, unless near a known one. All joints have to be near."""
    chain = np.array([[0.9 * k, 0.0] for k in range(5)])
    assert find_distinct(chain, 1.0) == [0, 2, 4]
    assert find_distinct(chain, 1.0, np.array([[-0.5, 0.0]])) == [1, 3]
    assert find_distinct(np.array([[0.0, 0.0], [0.0, 1.1], [0.0, 0.2]]), 1.0) == [0, 1]
    assert find_distinct(np.zeros((0, 2)), 1.0, chain) == []


def test_the_distinct_configurations_are_those_of_the_definition() -> None:
    """One after the other, each compared with all that were kept before; some are exactly as far apart as that."""
    rng = np.random.default_rng(8)
    for count, known, n in ((60, 0, 3), (60, 20, 1), (200, 30, 7), (300, 0, 3), (300, 70, 4), (500, 10, 2)):
        q, before = (np.asarray(0.1 * rng.integers(0, 4, size=(size, n)), dtype=float) for size in (count, known))
        kept, expected = list(before), []
        for row, one in enumerate(q):
            if all(np.max(np.abs(one - other)) > 0.1 for other in kept):
                kept.append(one)
                expected.append(row)
        assert find_distinct(q, 0.1, before) == expected
        assert 0 < len(expected) < count or (known and not expected)
