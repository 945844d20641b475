"""The least times from one configuration: no motion that the certificate accepts gets further in less."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, build_problem, drive_of
from backhoe_planner.proof import Certificate, certify_problem
from backhoe_planner.proof.least_times import LeastTimes, _needs_within, least_supplied

TOLERATED = 1.0099  # times a limit of the drive, of which the certificate accepts 1 % more


def problem_at(robot: bp.Robot, q: Vector, **keys: object) -> Problem:
    joints = {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))}
    return build_problem(
        robot, bp.scene_from_dict({"version": 1, "start": joints, "task": {"goal": joints}} | keys)
    )  # fmt: skip


def assert_no_faster(problem: Problem, motion: Trajectory) -> Certificate:
    """The certificate accepts the motion, and it is no faster than the least times to its end."""
    certificate = certify_problem(problem, motion)
    assert certificate.limits_kept, certificate.problems
    start, end, taken = motion.q[0], motion.q[-1], motion.duration
    for longest in (taken, 3.0 * taken):
        times = LeastTimes(problem, start, longest=longest)
        assert times.to_boxes(end[None], end[None])[0] <= taken + 1e-9
        down, up = times.reach(np.array([taken]))
        assert np.all(end - start <= up[0] + 1e-9)
        assert np.all(start - end <= down[0] + 1e-9)
    return certificate


# --- one joint with limits of velocity and acceleration -----------------------------------

SHARP = (0.89, 0.26, 2.18, 0.39, 0.94)  # periods: among random motions, some of those that get furthest
WAVY = (0.97, 0.21, 3.32, 0.29, 2.2, 0.29, 0.4, 2.12, 1.5, 2.69, 0.82, 0.44, 1.2, 0.82, 2.69, 1.5, 2.12, 0.4, 0.97)


def as_far_as_accepted(steps: Vector, velocity: float, acceleration: float) -> Trajectory:
    """Joint 1 goes as far as its sample times, `steps` apart [s], allow from rest to rest."""
    spans = np.minimum(np.concatenate((steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:])), SAMPLE_PERIOD)
    ramps = np.minimum(np.cumsum(spans[:-1]), np.cumsum(spans[:0:-1])[::-1])
    q = np.zeros((len(steps) + 1, 4))
    q[1:, 0] = np.cumsum(np.minimum(acceleration * ramps, velocity) * steps)
    return Trajectory.from_steps(np.append(0.0, np.cumsum(steps)), q)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("velocity", [1.0, 0.1])
@pytest.mark.parametrize("periods", [(1.0,), (1.0,) * 3, (1.0,) * 12, (1.0,) * 80, SHARP, WAVY])
def test_a_joint_at_its_limits_is_no_faster_than_its_least_time(
    planar4: bp.Robot, periods: tuple[float, ...], velocity: float, side: float
) -> None:
    limits = {"velocity": {"joint1": velocity}, "acceleration": {"joint1": 2.0}}
    problem = problem_at(planar4, np.zeros(4), limits=limits)
    motion = as_far_as_accepted(SAMPLE_PERIOD * np.array(periods), velocity, 2.0)
    motion = Trajectory.from_steps(motion.time, side * motion.q)
    certificate = assert_no_faster(problem, motion)
    assert max(certificate.velocity.ratio, certificate.acceleration.ratio) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("gap", "seconds"), [(2.0, 2.5), (0.32, 0.8)])
def test_the_least_time_of_a_joint_is_that_of_a_ramp_less_the_period(
    planar4: bp.Robot, gap: float, seconds: float
) -> None:
    """1 rad/s and 2 rad/s^2: 2 rad take 2 s and 0.5 s for the ramps; 0.32 rad take 2 sqrt(0.16) s."""
    times = LeastTimes(problem_at(planar4, np.zeros(4)), np.zeros(4), longest=9.0)
    box = np.array([[0.0, -gap, 0.0, 0.0], [0.0, gap, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    wide = np.array([0.0, 0.0, 0.1, 0.0])
    found = times.to_boxes(box - wide, box + wide)
    for one in found[:2]:
        assert seconds - SAMPLE_PERIOD - 2e-3 < one < seconds
    assert found[2] == 0.0
    down, up = times.reach(found[:1])
    assert gap - 1e-9 <= down[0, 1] == up[0, 1] < gap + 0.01


# --- joints with cylinders ------------------------------------------------------------

CYLINDERS = [way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)]  # ways of boom, stick, bucket


def hurried(problem: Problem, start: Vector, way: Vector, steps: int) -> Trajectory:
    """The joints move by `way` (n,) times one rate, as fast as the certificate accepts, from rest to rest."""
    drive, limits = drive_of(problem), problem.limits
    most = float(np.min(limits.velocity[way != 0.0] / np.abs(way[way != 0.0])))
    change = SAMPLE_PERIOD * float(np.min(limits.acceleration[way != 0.0] / np.abs(way[way != 0.0])))
    q = [start]
    for step in range(steps):
        rate = min(most, change * min(step + 1, steps - step))
        for _ in range(3):  # the drive's use is proportional to the rate, at nearly the same place
            ahead = q[-1] + rate * SAMPLE_PERIOD * way
            places = np.array([q[-1], 0.5 * (q[-1] + ahead), ahead])
            v = np.tile(rate * way, (3, 1))
            use = max(float(np.max(drive.flow_use(places, v))), float(np.max(drive.rod_speed_use(places, v))))
            rate *= min(1.0, TOLERATED / use)
        q.append(q[-1] + rate * SAMPLE_PERIOD * way)
    return Trajectory.from_steps(SAMPLE_PERIOD * np.arange(steps + 1.0), np.array(q))


@pytest.mark.parametrize(
    ("steps", "every"), [(1, 4), *(pytest.param(*case, marks=pytest.mark.long) for case in ((4, 4), (60, 1)))]
)
def test_no_accepted_motion_of_cylinders_is_faster_than_the_least_time(
    backhoe: bp.Robot, steps: int, every: int
) -> None:
    """Alone and together, each joint upwards and downwards; the longest ones use all of the pump or of a valve."""
    uses = []
    for moves in CYLINDERS[::every]:
        way = np.array([0.0, *moves])
        start = backhoe.middle - 0.3 * (backhoe.limits.upper - backhoe.limits.lower) * way
        problem = problem_at(backhoe, start)
        motion = hurried(problem, start, way, steps)
        use = certify_problem(problem, motion).hydraulics
        assert use is not None
        if use.kept:  # the others need more power than the engine has, which the least times leave out
            assert_no_faster(problem, motion)
            uses.append(use.ratio)
    assert len(uses) >= 5
    assert steps < 60 or sum(ratio > 1.005 for ratio in uses) >= 10


@pytest.mark.parametrize("seed", range(4))
def test_the_least_oil_of_a_stroke_is_that_of_its_cylinders(backhoe: bp.Robot, seed: int) -> None:
    """At most the piston's area, or the annulus, times the stroke, and hardly less."""
    rng, hydraulics = np.random.default_rng(seed), backhoe.hydraulics
    assert hydraulics is not None
    start = backhoe.middle + 0.3 * (backhoe.random_q(rng) - backhoe.middle)
    times = LeastTimes(problem_at(backhoe, start), start, longest=60.0)
    for cylinder, joint in zip(hydraulics.cylinders, hydraulics.joint_of.tolist(), strict=True):
        if np.count_nonzero(hydraulics.joint_of == joint) > 1:
            continue
        for side, sign in enumerate((1.0, -1.0)):
            end = start.copy()
            room = float(abs((backhoe.limits.upper if sign > 0.0 else backhoe.limits.lower)[joint] - start[joint]))
            end[joint] += sign * 0.7 * room
            between = hydraulics.lengths(start + np.linspace(0.0, 1.0, 2001)[:, None] * (end - start))
            rods = np.diff(between[:, hydraulics.cylinders.index(cylinder)])
            exact = float(np.sum(np.abs(rods) * np.where(rods > 0.0, cylinder.cap_area, cylinder.annulus_area)))
            found = float(times._oil[joint][side].at(np.array(0.7 * room)))
            assert 0.97 * exact <= found <= exact * (1.0 + 1e-9)


def test_remembered_needs_and_all_boxes_at_once_change_no_least_time(backhoe: bp.Robot) -> None:
    """Each box by itself, with needs computed anew; the boxes are up, down and around the start in every joint."""
    rng, start = np.random.default_rng(6), backhoe.middle
    problem = problem_at(backhoe, start)
    middle = start + rng.uniform(-0.5, 0.5, (60, 4))
    half = rng.uniform(0.0, 0.3, (60, 4))
    _needs_within.cache_clear()
    found = [
        LeastTimes(problem, start, longest=longest).to_boxes(middle - half, middle + half)
        for longest in (3.0, 50.0, 60.0)
    ]
    assert 4 <= _needs_within.cache_info().currsize <= 2 * 4  # those for 50 s and 60 s are the same
    for longest, together in zip((3.0, 50.0, 60.0), found, strict=True):
        for row in range(0, 60, 7):
            _needs_within.cache_clear()
            alone = LeastTimes(problem, start, longest=longest)
            box = middle[row : row + 1] - half[row : row + 1], middle[row : row + 1] + half[row : row + 1]
            assert alone.to_boxes(*box)[0] == together[row]
    assert found[-1].min() < found[-1].max() < 60.0


def test_remembered_needs_belong_to_one_start(backhoe: bp.Robot) -> None:
    """From another start with the same room for a joint, what was remembered for the first one does not count."""
    first = backhoe.middle
    other = first + np.array([0.0, 0.2, -0.3, 0.4])
    ends = np.array([first + 0.1, first - 0.2, other + 0.3])
    after, alone = (LeastTimes(problem_at(backhoe, q), q, longest=50.0).to_boxes(ends, ends) for q in (first, other))
    _needs_within.cache_clear()
    np.testing.assert_array_equal(
        LeastTimes(problem_at(backhoe, other), other, longest=50.0).to_boxes(ends, ends), alone
    )
    assert not np.array_equal(after, alone)


def test_joints_that_share_a_supply_need_the_time_of_their_dearest_set() -> None:
    """Up to half of a motion the joints can have t, 2 t and both 2.5 t: needs of 2 and 4 take 2, 2 and both 2.4 s."""
    time = np.linspace(0.0, 10.0, 11)
    amounts = np.zeros((9, 11))
    amounts[1], amounts[3], amounts[4] = time, 2.0 * time, 2.5 * time
    need, way = np.array([[2.0, 4.0], [4.0, 0.0], [9.0, 9.0]]), np.array([[1, 1], [1, 0], [0, 0]])
    np.testing.assert_allclose(least_supplied(need, way, amounts, time), [2.4, 4.0, 0.0])
