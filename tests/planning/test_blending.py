"""Rounded corners and the motion along them, against hand calculations and limits."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bar_scenes import STRETCHED, TURNED, across_bar, problem_of

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Robot, travel_bounds
from backhoe_planner.motion import SmoothWay, Trajectory, chord_sagitta, time_way
from backhoe_planner.motion.timing import timing
from backhoe_planner.planning import JointPath, MotionCheck, Work, blend, sample_path, shorten
from backhoe_planner.site import Proximity

# legs of different lengths and directions, a right angle and a turn back among them
CORNERS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.8, 0.0, 0.0, 0.0],
        [0.8, 0.5, -0.3, 0.0],
        [0.2, 0.6, 0.4, 0.5],
        [0.3, 0.7, 0.4, 0.9],
    ]
)


def open_field(robot: Robot, *, near: Callable[[Matrix], bool] | None = None) -> MotionCheck:
    problem = problem_of(robot, STRETCHED, STRETCHED, [])
    return MotionCheck(problem, Proximity(robot, (), self_collision=False), [STRETCHED], spare=0.0, near=near)


@pytest.fixture(scope="module")
def smooth(planar4: Robot) -> SmoothWay:
    return blend(open_field(planar4), JointPath(CORNERS.copy()))


def on_polyline(q: Vector) -> bool:
    for a, b in itertools.pairwise(CORNERS):
        t = float(np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
        if np.max(np.abs(q - a - t * (b - a))) < 1e-6:
            return True
    return False


def over_limits(trajectory: Trajectory, robot: Robot) -> tuple[float, float]:
    """Largest use of velocity and acceleration limits."""
    limits = robot.limits
    return (
        float(np.max(np.abs(trajectory.segment_velocities()) / limits.velocity)),
        float(np.max(np.abs(trajectory.accelerations()) / limits.acceleration)),
    )


# --- the curve --------------------------------------------------------------------------


def test_the_cut_of_a_right_angle_equals_a_hand_calculation(planar4: Robot) -> None:
    """Two legs of 1 s: d is 0.95 s, and halfway the parabola is d/2 from each leg."""
    rate = planar4.limits.velocity
    corners = np.zeros((3, 4))
    corners[1:, 0] = rate[0]
    corners[2, 1] = rate[1]
    way = blend(open_field(planar4), JointPath(corners))
    np.testing.assert_allclose(way.stations, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(way.cuts, [0.0, 0.95, 0.0])
    np.testing.assert_allclose(way.knots, [0.0, 0.05, 1.95, 2.0])
    np.testing.assert_allclose(way(1.0) / rate, [1.0 - 0.95 / 4.0, 0.95 / 4.0, 0.0, 0.0])
    np.testing.assert_allclose(way(1.0, 1) / rate, [0.5, 0.5, 0.0, 0.0])
    np.testing.assert_allclose(way(1.0, 2) / rate, [-1.0 / 1.9, 1.0 / 1.9, 0.0, 0.0])


def test_the_blended_path_keeps_its_ends_and_has_no_stop_between_them(smooth: SmoothWay) -> None:
    np.testing.assert_allclose(smooth(0.0), CORNERS[0], atol=1e-12)
    np.testing.assert_allclose(smooth(smooth.length), CORNERS[-1], atol=1e-12)
    np.testing.assert_array_equal(smooth.stops, [0.0, smooth.length])
    assert np.all(smooth.cuts[1:-1] > 0.0)
    assert np.all(np.diff(smooth.stations) >= smooth.cuts[1:] + smooth.cuts[:-1] - 1e-12)


def test_position_and_slope_are_continuous(smooth: SmoothWay) -> None:
    for knot in smooth.knots[1:-1]:
        for order in (0, 1):
            before, after = smooth(np.array([knot - 1e-9, knot + 1e-9]), order)
            np.testing.assert_allclose(before, after, atol=1e-7)


@pytest.mark.parametrize("order", [0, 1])
def test_derivatives_agree_with_central_differences(smooth: SmoothWay, order: int) -> None:
    s = np.linspace(1e-3, smooth.length - 1e-3, 301)
    s = s[np.min(np.abs(s[:, None] - smooth.knots), axis=1) > 2e-5]
    assert len(s) > 250
    h = 1e-5
    differences = (smooth(s + h, order) - smooth(s - h, order)) / (2.0 * h)
    np.testing.assert_allclose(smooth(s, order + 1), differences, atol=1e-7)


def test_one_station_gives_a_vector_and_many_give_a_matrix(smooth: SmoothWay) -> None:
    s = np.array([0.1, 0.4])
    for order in (0, 1, 2):
        assert smooth(s, order).shape == (2, 4)
        np.testing.assert_array_equal(smooth(0.4, order), smooth(s, order)[1])


def test_a_corner_next_to_an_obstacle_is_cut_less(planar4: Robot) -> None:
    """The polyline goes round a bar, which limits how far the corners are cut."""
    problem, proximity = across_bar(planar4)
    check = MotionCheck(problem, proximity, [STRETCHED, TURNED], spare=0.01)
    tighter = 0
    for seed in range(4):
        way = sample_path(check, STRETCHED, [TURNED], seed=seed, work=Work())
        assert way is not None
        way = shorten(check, way, seed=seed)
        near, free = blend(check, way), blend(open_field(planar4), way)
        assert np.all(near.cuts <= free.cuts)
        tighter += int(np.sum(near.cuts < free.cuts))
        curve = near(np.linspace(0.0, near.length, 2000))
        distances = [proximity.distances(q) - proximity.clearance for q in curve]
        assert np.min(np.array(distances)[:, proximity.owner >= 0]) >= 0.01 - 1e-9
    assert tighter > 0


def test_a_corner_that_cannot_be_cut_without_collision_is_a_stop(planar4: Robot) -> None:
    way = blend(open_field(planar4, near=lambda q: all(map(on_polyline, q))), JointPath(CORNERS.copy()))
    np.testing.assert_array_equal(way.cuts, 0.0)
    np.testing.assert_array_equal(way.stops, way.stations)
    trajectory = time_way(way, planar4.limits)
    for corner in CORNERS:
        (at,) = np.flatnonzero(np.max(np.abs(trajectory.q - corner), axis=1) < 1e-9)
        if 0 < at < len(trajectory) - 1:  # as slow as one sample from rest can be
            slow = planar4.limits.acceleration * 0.02
            assert np.all(np.abs(trajectory.v[at]) <= slow)
    assert all(on_polyline(q) for q in trajectory.q)


def test_a_path_of_no_length_takes_no_time(planar4: Robot) -> None:
    way = blend(open_field(planar4), JointPath(np.array([STRETCHED, STRETCHED])))
    trajectory = time_way(way, planar4.limits)
    assert trajectory.duration == 0.0
    np.testing.assert_array_equal(trajectory.q, [STRETCHED])


# --- the motion along it ----------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.02, 0.3, 2.5])
def test_the_duration_of_a_straight_path_equals_a_hand_calculation(planar4: Robot, angle: float) -> None:
    """Joint 1 alone, from rest to rest, at full acceleration and at most full rate."""
    goal = np.array([angle, 0.0, 0.0, 0.0])
    way = blend(open_field(planar4), JointPath(np.array([STRETCHED, goal])))
    trajectory = time_way(way, planar4.limits)
    rate, gain = planar4.limits.velocity[0], planar4.limits.acceleration[0]
    reached = min(rate, np.sqrt(gain * angle))
    assert trajectory.duration == pytest.approx(angle / reached + reached / gain, rel=2e-3)
    velocity, acceleration = over_limits(trajectory, planar4)
    assert max(velocity, acceleration) <= 1.0
    np.testing.assert_array_equal(trajectory.q[[0, -1]], [STRETCHED, goal])


def test_the_motion_keeps_to_the_path_and_its_limits_and_is_nearly_always_at_a_limit(
    planar4: Robot, smooth: SmoothWay
) -> None:
    trajectory = time_way(smooth, planar4.limits)
    velocity, acceleration = over_limits(trajectory, planar4)
    assert max(velocity, acceleration) <= 1.0
    dense = smooth(np.linspace(0.0, smooth.length, 20_000))
    for q in trajectory.q:
        assert np.min(np.max(np.abs(dense - q), axis=1)) < 2e-4
    np.testing.assert_allclose(trajectory.q[[0, -1]], CORNERS[[0, -1]], atol=1e-12)
    np.testing.assert_array_equal(trajectory.v[[0, -1]], 0.0)
    # nearly always, some limit is nearly used in full
    use = np.maximum(
        np.max(np.abs(trajectory.v) / planar4.limits.velocity, axis=1),
        np.max(np.abs(trajectory.accelerations()) / planar4.limits.acceleration, axis=1),
    )
    assert np.mean(use[2:-2] > 0.9) > 0.8
    stopping = time_way(SmoothWay(smooth.corners, smooth.stations, np.zeros(len(CORNERS))), planar4.limits)
    assert trajectory.duration < 0.9 * stopping.duration


@pytest.mark.parametrize(
    "any_robot",
    ["planar4", "backhoe", *(pytest.param(name, marks=pytest.mark.long) for name in ("panda", "ur5"))],
    indirect=True,
)
def test_between_samples_the_motion_is_off_the_path_by_no_more_than_the_sagitta(any_robot: Robot) -> None:
    """The sagitta of a chord moves no link further than its travel bound."""
    rng = np.random.default_rng(5)
    limits = any_robot.limits
    middle = any_robot.random_q(rng)
    corners = np.clip(middle + 0.3 * rng.normal(size=(5, any_robot.n)), limits.lower, limits.upper)
    steps = np.linalg.norm(np.diff(corners, axis=0) / limits.velocity, axis=1)
    cuts = np.zeros(5)
    cuts[1:-1] = 0.5 * np.minimum(steps[:-1], steps[1:])
    way = SmoothWay(corners, np.concatenate(([0.0], np.cumsum(steps))), cuts)
    trajectory = time_way(way, limits)
    assert max(over_limits(trajectory, any_robot)) <= 1.0
    halfway = 0.5 * (trajectory.q[:-1] + trajectory.q[1:])
    s = np.linspace(0.0, way.length, 100_000)
    dense = way(s)
    for q in halfway[:: max(len(halfway) // 15, 1)]:
        off = np.abs(dense - q)
        nearest = off[int(np.argmin(np.max(off / chord_sagitta(limits), axis=1)))]
        assert np.all(nearest <= 1.1 * chord_sagitta(limits) + 3e-5)
    assert np.max(travel_bounds(any_robot) @ chord_sagitta(limits)) < 0.01  # m


def test_without_a_time_law_the_motion_stops_in_the_corners(
    planar4: Robot, smooth: SmoothWay, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_answer(*_: Any, **__: Any) -> None:
        return None

    monkeypatch.setattr(timing, "time_path", no_answer)
    trajectory = time_way(smooth, planar4.limits)
    assert max(over_limits(trajectory, planar4)) <= 1.0
    for corner in CORNERS:
        assert np.min(np.max(np.abs(trajectory.q - corner), axis=1)) < 1e-9
    assert all(on_polyline(q) for q in trajectory.q)
