"""Two motions joined with a stop, and without one: the sum of both while both move, slowed where it exceeds a limit."""

from __future__ import annotations

import numpy as np
import pytest

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import SAMPLE_PERIOD, Trajectory, append_motion, overlap, slow_where_needed


def ramp(time: Vector) -> Vector:
    """From 0 at 0 s to 1 at 1 s, at rest before and after: 3 t^2 - 2 t^3, at most 1.5 1/s and 6 1/s^2."""
    t = np.clip(time, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def motion(begin: float, end: float) -> Trajectory:
    """A joint from `begin` to `end` in one second."""
    time = np.linspace(0.0, 1.0, 51)
    return Trajectory.from_steps(time, (begin + (end - begin) * ramp(time))[:, None])


def limits(velocity: float, acceleration: float) -> JointLimits:
    one = np.ones(1)
    return JointLimits(
        lower=-9.0 * one, upper=9.0 * one, velocity=velocity * one, acceleration=acceleration * one, effort=one
    )


@pytest.mark.parametrize(
    ("rest", "time", "q"),
    [
        ([], [0.0, 1.0, 2.0, 4.0, 5.0], [0.0, 0.5, 1.0, 2.0, 2.5]),
        ([0.25], [0.0, 1.0, 2.0, 2.25, 4.25, 5.25], [0.0, 0.5, 1.0, 1.0, 2.0, 2.5]),
        ([0.25, 0.75], [0.0, 1.0, 2.0, 2.25, 2.75, 4.75, 5.75], [0.0, 0.5, 1.0, 1.0, 1.0, 2.0, 2.5]),
    ],
)
def test_with_a_stop_the_second_motion_begins_at_the_last_sample_at_rest(
    rest: list[float], time: list[float], q: list[float]
) -> None:
    first = Trajectory.from_steps(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [0.5], [1.0]]), begins=(0, 1))
    second = Trajectory.from_steps(np.array([0.0, 2.0, 3.0]), np.array([[1.0], [2.0], [2.5]]))
    joined = append_motion(first, second, rest=rest)
    assert joined.time.tolist() == time
    assert joined.q[:, 0].tolist() == q
    assert joined.begins == (0, 1)


@pytest.mark.parametrize("duration", [0.3, 0.313])
def test_while_both_move_the_joints_are_at_the_sum_of_both(duration: float) -> None:
    """q_1(t) + q_2(t - t_2) - q_E from 1 over 2 to -1 rad; 0.313 s is between two samples of the second motion."""
    joined, shared = overlap(motion(1.0, 2.0), motion(2.0, -1.0), duration)
    assert joined.duration == pytest.approx(2.0 - duration, abs=1e-12)
    expected = 1.0 + ramp(joined.time) - 3.0 * ramp(joined.time - (1.0 - duration))
    np.testing.assert_allclose(joined.q[:, 0], expected, atol=1e-4)
    both = (joined.time >= 1.0 - duration - 1e-9) & (joined.time <= 1.0 + 1e-9)
    assert np.flatnonzero(both).tolist() == list(range(shared.start, shared.stop))


def test_a_joined_motion_within_its_limits_is_not_slowed() -> None:
    """On the way back the accelerations of both motions add up to 12 rad/s^2."""
    joined, shared = overlap(motion(0.0, 1.0), motion(1.0, 0.0), 0.3)
    found = slow_where_needed(joined, shared, limits(1.6, 12.1))
    assert found is not None
    assert found[0] is joined


@pytest.mark.parametrize(("to", "velocity", "acceleration"), [(0.0, 9.0, 8.0), (2.0, 1.52, 9.0)])
def test_a_joined_motion_is_slowed_only_where_the_sum_exceeds_a_limit(
    to: float, velocity: float, acceleration: float
) -> None:
    """Back, braking and speeding up add 6 and 6 rad/s^2; on, the speeds of both add up to more than 1.5 rad/s."""
    joined, shared = overlap(motion(0.0, 1.0), motion(1.0, to), 0.6 if to else 0.3)
    found = slow_where_needed(joined, shared, limits(velocity, acceleration))
    assert found is not None
    slower, _ = found
    rates = np.diff(slower.q[:, 0]) / np.diff(slower.time)
    assert np.max(np.abs(rates)) <= velocity * (1.0 + 1e-6)
    around = np.concatenate(([0.0], rates, [0.0]))
    assert np.max(np.abs(np.diff(around))) <= acceleration * SAMPLE_PERIOD * (1.0 + 1e-6)
    assert joined.duration < slower.duration < 1.2 * joined.duration
    # far from where both move, the samples keep their times
    np.testing.assert_array_equal(slower.time[: shared.start - 10], joined.time[: shared.start - 10])
    late = len(joined) - shared.stop - 10
    np.testing.assert_allclose(np.diff(slower.time[-late:]), np.diff(joined.time[-late:]), atol=1e-9)
    np.testing.assert_array_equal(slower.q[-late:], joined.q[-late:])
