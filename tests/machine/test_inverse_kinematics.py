"""Inverse kinematics: reachable targets are reached, the others approached."""

from __future__ import annotations

import numpy as np
import pytest

from backhoe_planner.machine import Configuration, Kinematics, Robot, TipTarget, solve_inverse_kinematics

COUNT = 100


def target_at(at: Configuration, asked: str) -> TipTarget:
    if asked == "pitch":
        return TipTarget(at.tip_position, pitch=(at.pitch, at.pitch))
    return TipTarget(at.tip_position, rotation=at.tip_rotation if asked == "pose" else None)


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("planar4", "position"),
        ("backhoe", "position"),
        ("backhoe", "pitch"),
        pytest.param("ur5", "position", marks=pytest.mark.long),
        pytest.param("ur5", "pose", marks=pytest.mark.long),
        ("panda", "position"),
        ("panda", "pose"),
    ],
)
def test_99_of_100_reachable_targets_are_reached_to_a_micrometre_within_the_limits(
    name: str, asked: str, request: pytest.FixtureRequest
) -> None:
    robot: Robot = request.getfixturevalue(name)
    kinematics = Kinematics(robot)
    rng = np.random.default_rng(20)
    reached = 0
    for _ in range(COUNT):
        target = target_at(kinematics.at(robot.random_q(rng)), asked)
        found = solve_inverse_kinematics(robot, target, rng=rng)
        assert np.all(robot.limits.lower <= found.q)
        assert np.all(found.q <= robot.limits.upper)
        position, angle = target.distances(kinematics.at(found.q))
        assert (found.position_error, found.angle_error) == (position, angle)
        reached += position <= 1e-6 and angle <= 1e-6
    assert reached >= 0.99 * COUNT


def test_a_target_beyond_the_arm_is_approached_along_its_ray(planar4: Robot) -> None:
    """Four links of 1 m reach 4 m: a target at 6 m is missed by 2 m."""
    for angle in (0.0, 1.0, -2.5):
        ray = np.array([np.cos(angle), np.sin(angle), 0.0])
        found = solve_inverse_kinematics(planar4, TipTarget(6.0 * ray), rng=np.random.default_rng(1))
        assert not found.reached
        np.testing.assert_allclose(Kinematics(planar4).at(found.q).tip_position, 4.0 * ray, atol=1e-6)
        assert found.position_error == pytest.approx(2.0, abs=1e-9)


def test_a_target_out_of_the_plane_is_missed_by_its_height(planar4: Robot) -> None:
    found = solve_inverse_kinematics(planar4, TipTarget(np.array([2.0, 1.0, 0.3])), rng=np.random.default_rng(1))
    assert not found.reached
    np.testing.assert_allclose(Kinematics(planar4).at(found.q).tip_position, [2.0, 1.0, 0.0], atol=1e-6)
    assert found.position_error == pytest.approx(0.3, abs=1e-9)


def test_the_backhoe_stretches_towards_a_target_20_m_away(backhoe: Robot) -> None:
    """When stretched, arm and target are on one line through the boom's foot.

    The stick cannot be stretched fully (-0.1745), so boom foot to bucket pin is the
    third side of a triangle of 2.4 and 1.8, and the bucket lies in line with it.
    """
    found = solve_inverse_kinematics(backhoe, TipTarget(np.array([20.0, 0.0, 0.49])), rng=np.random.default_rng(1))
    stick = np.sqrt(2.4**2 + 1.8**2 + 2.0 * 2.4 * 1.8 * np.cos(0.1745))
    assert not found.reached
    tip = Kinematics(backhoe).at(found.q).tip_position
    np.testing.assert_allclose(tip, [0.535 + stick + 0.95, 0.0, 0.49], atol=1e-5)
    assert found.q[0] == pytest.approx(0.0, abs=1e-6)
    assert found.q[2] == pytest.approx(-0.1745)


def test_the_backhoe_swings_to_its_limit_towards_a_target_behind_it(backhoe: Robot) -> None:
    found = solve_inverse_kinematics(backhoe, TipTarget(np.array([-3.0, 20.0, 0.49])), rng=np.random.default_rng(1))
    assert not found.reached
    assert found.q[0] == pytest.approx(backhoe.limits.upper[0])


def test_a_target_with_a_pitch_range_is_reached_within_it(backhoe: Robot) -> None:
    target = TipTarget(np.array([4.2, 1.0, -1.0]), pitch=(-2.2, -1.2))
    found = solve_inverse_kinematics(backhoe, target)
    at = Kinematics(backhoe).at(found.q)
    assert found.reached
    assert -2.2 - 1e-8 <= at.pitch <= -1.2 + 1e-8
    np.testing.assert_allclose(at.tip_position, target.position, atol=1e-8)


@pytest.mark.parametrize("position", [[2.0, 1.0, 0.0], [6.0, 0.0, 0.0]])
def test_the_same_generator_gives_the_same_result(planar4: Robot, position: list[float]) -> None:
    target = TipTarget(np.array(position))
    first, second = (
        solve_inverse_kinematics(planar4, target, rng=np.random.default_rng(5), attempts=10) for _ in range(2)
    )
    np.testing.assert_array_equal(first.q, second.q)
    assert (first.reached, first.attempts) == (second.reached, second.attempts)


def test_results_without_a_generator_are_reproducible(ur5: Robot) -> None:
    target = TipTarget(Kinematics(ur5).at(ur5.random_q(np.random.default_rng(2))).tip_position)
    np.testing.assert_array_equal(solve_inverse_kinematics(ur5, target).q, solve_inverse_kinematics(ur5, target).q)


def test_a_start_at_the_solution_is_the_solution(any_robot: Robot) -> None:
    kinematics = Kinematics(any_robot)
    q = any_robot.random_q(np.random.default_rng(3))
    found = solve_inverse_kinematics(any_robot, TipTarget(kinematics.at(q).tip_position), start=q)
    assert (found.reached, found.attempts) == (True, 1)
    np.testing.assert_array_equal(found.q, q)


def test_a_start_outside_the_limits_is_moved_inside_without_changing_the_argument(planar4: Robot) -> None:
    start = np.array([5.0, 0.1, 0.1, 0.1])
    found = solve_inverse_kinematics(planar4, TipTarget(np.array([2.0, 1.0, 0.0])), start=start)
    assert found.reached
    assert np.all(np.abs(found.q) <= planar4.limits.upper)
    assert start[0] == 5.0


def test_a_start_near_a_solution_gives_a_nearby_one(backhoe: Robot) -> None:
    q = np.array([0.3, 0.4, -1.6, -0.9])
    near = Kinematics(backhoe).at(q).tip_position + np.array([0.01, 0.0, 0.0])
    found = solve_inverse_kinematics(backhoe, TipTarget(near), start=q)
    assert found.reached
    assert np.max(np.abs(found.q - q)) < 0.05
