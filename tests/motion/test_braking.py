"""A motion that brakes along itself: known stopping times, within the accelerations, and never off its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import (
    DRIVE_TOLERANCE,
    SAMPLE_PERIOD,
    Drive,
    Trajectory,
    append_motion,
    brake_along,
    chord_sagitta,
    time_along,
)


def limits(*acceleration: float) -> JointLimits:
    one = np.ones(len(acceleration))
    return JointLimits(
        lower=-9.0 * one, upper=9.0 * one, velocity=9.0 * one, acceleration=np.array(acceleration), effort=one
    )


def trapezium(period: float = SAMPLE_PERIOD) -> Trajectory:
    """One joint over 1.5 rad: 1 rad/s^2 up to 1 rad/s after 1 s, 0.5 s of that, and 1 s to rest."""
    time = np.linspace(0.0, 2.5, round(2.5 / period) + 1)
    begin, end = np.clip(time, 0.0, 1.0), np.clip(time - 1.5, 0.0, 1.0)
    return Trajectory.from_steps(time, (0.5 * begin**2 + np.clip(time - 1.0, 0.0, 1.5) - 0.5 * end**2)[:, None])


def excess(motion: Trajectory, among: JointLimits) -> float:
    return float(np.max(np.abs(motion.corner_accelerations()) / among.acceleration)) - 1.0


@pytest.mark.parametrize("period", [SAMPLE_PERIOD, 0.0125])
@pytest.mark.parametrize(
    ("moment", "takes", "goes"),
    [(0.0, 0.0, 0.0), (0.5, 0.5, 0.125), (1.25, 1.0, 0.5), (1.5, 1.0, 0.5), (2.0, 0.5, 0.125)],
)
def test_one_joint_stops_after_its_velocity_over_its_acceleration(
    moment: float, takes: float, goes: float, period: float
) -> None:
    """v / a and v^2 / (2 a); where the motion itself brakes as hard as possible, it goes on as it is."""
    motion, joint = trapezium(period), limits(1.0)
    braked = brake_along(motion, moment, joint)
    assert braked is not None
    assert braked.duration - moment == pytest.approx(takes, abs=2.1 * SAMPLE_PERIOD)
    assert braked.q[-1, 0] - motion.at(moment)[0] == pytest.approx(goes, abs=1.1 * SAMPLE_PERIOD)
    # what follows may go back at once, as hard as the joint can
    back = Trajectory.from_steps(motion.time, braked.q[-1] - motion.q)
    assert excess(append_motion(braked, back), joint) <= 1e-6


def test_braking_that_begins_behind_the_last_moment_changes_nothing() -> None:
    braked = brake_along(trapezium(), 3.0, limits(1.0))
    assert braked is not None
    np.testing.assert_allclose(braked.q[:126], trapezium().q, atol=1e-12)
    assert np.all(braked.q[126:] == braked.q[125])


def test_a_joint_without_room_in_its_acceleration_makes_the_others_go_on() -> None:
    """The second joint brakes just at its limit until it turns round at 1 s: no pace can be lost before."""
    time = np.linspace(0.0, 2.0, 101)
    q = np.stack((time - 1.0, 0.25 * np.sin(0.5 * np.pi * time) ** 2), axis=1)
    fast = Trajectory.from_steps(time, q)
    tight = limits(99.0, float(np.max(np.abs(fast.corner_accelerations()[1:-1, 1]))))
    braked = brake_along(fast, 0.9, tight)
    assert braked is not None
    assert excess(braked.part(1, len(braked) - 1), tight) <= 1e-6
    assert braked.duration == pytest.approx(1.0, abs=1.1 * SAMPLE_PERIOD)
    free = brake_along(fast, 0.9, limits(99.0, 99.0))
    assert free is not None
    assert free.duration == pytest.approx(0.9 + 1.0 / 99.0, abs=1.1 * SAMPLE_PERIOD)


def smooth_motion(rng: np.random.Generator) -> tuple[Trajectory, JointLimits]:
    """Three joints on random sums of sines, from rest to rest, with just the accelerations that they need."""
    time = np.arange(0.0, rng.uniform(2.0, 4.0), rng.uniform(0.012, 0.02))
    along = time / time[-1]
    eased: Vector = along**3 * (10.0 - 15.0 * along + 6.0 * along**2)
    waves: Matrix = rng.uniform(-1.0, 1.0, (3, 4)) / np.arange(1.0, 5.0)
    q = np.stack([(np.sin(np.outer(eased, np.pi * np.arange(1.0, 5.0))) @ wave) for wave in waves], axis=1)
    motion = Trajectory.from_steps(time, q)
    return motion, limits(*np.max(np.abs(motion.corner_accelerations()), axis=0))


@pytest.mark.parametrize("seed", range(12))
def test_it_stays_on_the_path_within_the_accelerations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion, joints = smooth_motion(rng)
    sagitta = chord_sagitta(joints)
    for moment in np.linspace(0.05, 0.95, 7) * motion.duration:
        braked = brake_along(motion, float(moment), joints)
        assert braked is not None
        assert excess(braked, joints) <= 1e-6
        assert braked.duration <= motion.duration + 2.0 * SAMPLE_PERIOD
        before = motion.time <= moment
        np.testing.assert_array_equal(braked.q[: before.sum()], motion.q[before])
        np.testing.assert_array_equal(braked.time[: before.sum()], motion.time[before])
        dense = motion.at(np.linspace(moment, motion.duration, 4001))
        for q in braked.q[before.sum() :]:
            # beside the motion by two parabolas, and by half a step of the dense samples
            off = np.abs(dense - q) - 2.0 * sagitta - 0.5 * np.max(np.abs(np.diff(dense, axis=0)), axis=0)
            assert np.min(np.max(off, axis=1)) <= 1e-9


def test_a_motion_that_exceeds_the_accelerations_itself_is_not_braked() -> None:
    assert brake_along(trapezium(), 0.5, limits(0.5)) is None


@pytest.mark.parametrize("seed", range(6))
def test_it_keeps_the_torques_of_a_loaded_backhoe(backhoe: bp.Robot, seed: int) -> None:
    """A motion that just keeps its torques is braked within them, though its accelerations alone would allow more."""
    rng = np.random.default_rng([3, seed])
    drive = Drive(backhoe, payload=600.0)
    brisk = replace(backhoe.limits, acceleration=np.array([2.0, 3.0, 4.0, 6.0]))
    stations = np.linspace(0.0, 1.0, 5)
    # of these postures the load can be held
    ends = [q for q in (backhoe.random_q(rng) for _ in range(99)) if np.max(drive.static_use(q[None])) < 0.8]
    q = ends[0] + stations[:, None] * (ends[1] - ends[0])
    if np.max(drive.static_use(q)) > 0.9:
        pytest.skip("on the way it cannot be held")
    motion = time_along(stations, q, brisk, drive=drive)
    for moment in np.linspace(0.1, 0.9, 9) * motion.duration:
        braked = brake_along(motion, float(moment), brisk, drive=drive)
        assert braked is not None
        assert np.max(drive.use_along(braked.moments()).effort) <= 1.0 + DRIVE_TOLERANCE
        assert excess(braked, brisk) <= 1e-6
        assert braked.duration <= motion.duration + 2.0 * SAMPLE_PERIOD


@pytest.mark.parametrize("after", [0.1, 0.3])
def test_a_stop_within_one_step_keeps_the_torques(backhoe: bp.Robot, after: float) -> None:
    """The swing's acceleration is hardly limited, so that its joint could stand still at the next sample."""
    drive = Drive(backhoe, payload=600.0)
    quick = replace(backhoe.limits, acceleration=np.full(4, 1e3))
    stations = np.linspace(0.0, 1.0, 5)
    q = np.array([0.0, 0.4, -1.6, -0.9]) + stations[:, None] * np.array([1.5, 0.0, 0.0, 0.0])
    motion = time_along(stations, q, quick, drive=drive)
    assert np.max(drive.use_along(motion.moments()).effort) <= 1.0 + DRIVE_TOLERANCE
    free = brake_along(motion, after, quick)
    assert free is not None
    assert free.duration - after < SAMPLE_PERIOD
    assert np.max(drive.use_along(free.moments()).effort) > 1.5
    braked = brake_along(motion, after, quick, drive=drive)
    assert braked is not None
    assert np.max(drive.use_along(braked.moments()).effort) <= 1.0 + DRIVE_TOLERANCE


def test_what_is_at_rest_is_not_braked_whatever_its_drive(backhoe: bp.Robot) -> None:
    still = Trajectory.from_steps(np.array([0.0, 1.0, 2.0]), np.tile([0.0, 0.4, -1.6, -0.9], (3, 1)))
    for moment, takes in ((0.0, 0.0), (0.5, 1.0), (3.0, 2.0)):
        braked = brake_along(still, moment, backhoe.limits, drive=Drive(backhoe, payload=600.0))
        assert braked is not None
        assert braked.duration == takes
