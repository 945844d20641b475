"""The derivatives of how much of its drive's limits a machine uses, compared with central differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.arrays import Array
from backhoe_planner.motion import Drive, build_problem, drive_of

_STEP = 1e-6  # of q, v and a


def moments(robot: bp.Robot, count: int, seed: int) -> tuple[Array, Array, Array]:
    """(count, n) q, v and a each: joints well inside their limits, and half to twice of the greatest rates."""
    rng, n = np.random.default_rng(seed), robot.n
    q = robot.limits.lower + rng.uniform(0.05, 0.95, (count, n)) * (robot.limits.upper - robot.limits.lower)
    rate = rng.choice((-1.0, 1.0), (count, n)) * rng.uniform(0.5, 2.0, (count, n))
    return q, rate * robot.limits.velocity, rng.uniform(-1.0, 1.0, (count, n)) * robot.limits.acceleration


def central_differences(drive: Drive, q: Array, v: Array, a: Array) -> Array:
    """(K, U, 3 n) the derivatives of `ratios` by q, v and a."""
    here, n = np.hstack((q, v, a)), q.shape[1]
    found = []
    for column in range(3 * n):
        sides = []
        for sign in (1.0, -1.0):
            moved = here.copy()
            moved[:, column] += sign * _STEP
            sides.append(drive.ratios(moved[:, :n], moved[:, n : 2 * n], moved[:, 2 * n :]))
        found.append((sides[0] - sides[1]) / (2.0 * _STEP))
    return np.moveaxis(np.array(found), 0, -1)


def scene_of(robot: bp.Robot, **more: Any) -> bp.Scene:
    joints = dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))
    return bp.scene_from_dict({"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}, **more})


@pytest.mark.parametrize(
    "more", [{}, {"payload": 300.0}, {"payload": 100.0, "soil": {"surface": 3.0}}], ids=["empty", "loaded", "digging"]
)
def test_slopes_of_torques_speeds_flow_and_power_equal_central_differences(
    backhoe: bp.Robot, more: dict[str, Any]
) -> None:
    drive = drive_of(build_problem(backhoe, scene_of(backhoe, **more)))
    assert drive.hydraulics is not None
    q, v, a = moments(backhoe, 40, 4)
    slopes, differences = drive.ratio_slopes(q, v, a), central_differences(drive, q, v, a)
    assert slopes.shape == (40, 2 * backhoe.n + 2, 3 * backhoe.n)
    # against the soil they are differences themselves, to one side
    np.testing.assert_allclose(
        slopes, differences, rtol=5e-3 if drive.digs else 1e-5, atol=1e-3 if drive.digs else 1e-6
    )
    power = slopes[:, -1]
    assert np.any(power != 0.0)
    assert np.any(power == 0.0)  # some joints drive their load, others are driven by it


def test_slopes_of_the_efforts_of_motors_equal_central_differences(panda: bp.Robot) -> None:
    drive = drive_of(build_problem(panda, scene_of(panda, payload=2.0)))
    q, v, a = moments(panda, 6, 5)
    slopes = drive.ratio_slopes(q, v, a)
    assert slopes.shape == (6, panda.n, 3 * panda.n)
    np.testing.assert_allclose(slopes, central_differences(drive, q, v, a), rtol=1e-5, atol=1e-6)


def test_at_rest_the_slopes_of_speeds_and_flow_are_those_of_a_joint_that_begins_to_move(backhoe: bp.Robot) -> None:
    """One joint alone at a velocity v uses its slope times v of rod speed and flow, as both grow in proportion to v."""
    drive = drive_of(build_problem(backhoe, scene_of(backhoe)))
    n, still = backhoe.n, np.zeros((1, backhoe.n))
    q = backhoe.middle[None]
    slopes = drive.ratio_slopes(q, still, still)[0]
    for joint in range(n):
        v = still.copy()
        v[0, joint] = 0.1
        use = drive.use(q, v, still)
        assert 0.1 * slopes[n + joint, n + joint] == pytest.approx(use.rod_speed[0, joint])
        assert 0.1 * slopes[2 * n, n + joint] == pytest.approx(use.flow[0])


def test_the_use_of_the_drive_is_that_of_the_moments_given_last(backhoe: bp.Robot) -> None:
    """A use is kept for a second call with equal moments, not for others, and cannot be written to."""
    drive, here, there = Drive(backhoe), moments(backhoe, 5, 1), moments(backhoe, 5, 2)
    first = drive.use(*here)
    for other in (there, (here[0], here[1], there[2]), (here[0], there[1], here[2])):
        np.testing.assert_array_equal(drive.use(*other).effort, Drive(backhoe).use(*other).effort)
    again = drive.use(*(each.copy() for each in here))
    assert again is first
    with pytest.raises(ValueError, match="read-only"):
        again.power[0] = 1.0
