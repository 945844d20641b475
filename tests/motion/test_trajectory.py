"""Samples of a motion: velocities and accelerations by hand, and refused samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from backhoe_planner.errors import InputError
from backhoe_planner.motion import Trajectory

# one joint: 1 rad in the first second, 2 rad in the next half second
TIME = np.array([0.0, 1.0, 1.5])
Q = np.array([[0.0], [1.0], [3.0]])


def test_velocities_between_and_at_samples_equal_a_hand_calculation() -> None:
    motion = Trajectory.from_steps(TIME, Q)
    np.testing.assert_allclose(motion.segment_velocities(), [[1.0], [4.0]])
    np.testing.assert_allclose(motion.v, [[0.0], [2.5], [0.0]])
    assert motion.duration == 1.5
    assert len(motion) == 3


def test_accelerations_begin_and_end_at_rest() -> None:
    motion = Trajectory.from_steps(TIME, Q)
    # from rest over 1 s; from 1 to 4 rad/s over 0.75 s; to rest over 0.5 s
    np.testing.assert_allclose(motion.accelerations(), [[1.0], [4.0], [-8.0]])


def test_a_change_of_velocity_takes_no_longer_than_a_period() -> None:
    motion = Trajectory.from_steps(TIME, Q)
    np.testing.assert_allclose(motion.velocity_changes(), [[1.0], [3.0], [-4.0]])
    np.testing.assert_allclose(motion.corner_accelerations(), [[50.0], [150.0], [-200.0]])
    dense = Trajectory.from_steps(0.01 * TIME, Q)  # 10 ms and 5 ms apart: less than a period
    np.testing.assert_array_equal(dense.corner_accelerations(), dense.accelerations())


def test_a_motion_of_one_sample_is_at_rest() -> None:
    motion = Trajectory.from_steps(np.zeros(1), np.array([[0.3, -0.2]]))
    assert motion.duration == 0.0
    assert motion.segment_velocities().shape == (0, 2)
    np.testing.assert_array_equal(motion.accelerations(), [[0.0, 0.0]])
    np.testing.assert_array_equal(motion.corner_accelerations(), [[0.0, 0.0]])
    np.testing.assert_array_equal(motion.at(5.0), [0.3, -0.2])


def test_a_motion_is_linear_between_samples_and_at_rest_outside() -> None:
    motion = Trajectory.from_steps(TIME, Q)
    np.testing.assert_allclose(motion.at(0.25), [0.25])
    np.testing.assert_allclose(motion.at(1.25), [2.0])
    np.testing.assert_allclose(motion.at(-1.0), [0.0])
    np.testing.assert_allclose(motion.at(9.0), [3.0])


def test_samples_cannot_be_changed_and_are_copies() -> None:
    q = Q.copy()
    motion = Trajectory.from_steps(TIME, q)
    q[0] = 7.0
    assert motion.q[0, 0] == 0.0
    with pytest.raises(ValueError):
        motion.q[0, 0] = 1.0


@pytest.mark.parametrize(
    ("time", "q", "v", "key"),
    [
        ([], np.zeros((0, 1)), np.zeros((0, 1)), "trajectory.time"),
        ([0.0, 0.0], np.zeros((2, 1)), np.zeros((2, 1)), "trajectory.time"),
        ([0.0, 1.0, 0.5], np.zeros((3, 1)), np.zeros((3, 1)), "trajectory.time"),
        ([0.0, np.nan], np.zeros((2, 1)), np.zeros((2, 1)), "trajectory.time"),
        ([0.0, 1.0], np.array([[0.0], [np.inf]]), np.zeros((2, 1)), "trajectory.q"),
        ([0.0, 1.0], np.zeros((2, 1)), np.array([[0.0], [np.nan]]), "trajectory.v"),
        ([0.0, 1.0], np.zeros((3, 1)), np.zeros((3, 1)), "trajectory"),
        ([0.0, 1.0], np.zeros((2, 1)), np.zeros((2, 2)), "trajectory"),
        ([0.0, 1.0], np.zeros(2), np.zeros(2), "trajectory.q"),
    ],
)
def test_bad_samples_are_refused(time: list[float], q: NDArray[np.float64], v: NDArray[np.float64], key: str) -> None:
    with pytest.raises(InputError) as caught:
        Trajectory(time=np.array(time), q=q, v=v)
    assert caught.value.key == key
