"""A pace that is asked for may change at every step: the machine follows it as far as its accelerations allow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count, islice

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import Reference
from backhoe_planner.live.pace_ramp import PaceRamp
from backhoe_planner.live.servo.track import Track

DT = 0.02
NAMES = ("swing", "boom", "stick", "bucket")
A, B = (-0.3, 0.3, -0.9, -0.5), (0.0, 0.22, -0.82, -0.54)


def test_a_pace_changes_by_the_acceleration_over_the_rate_of_the_fastest_joint(backhoe: bp.Robot) -> None:
    """On a stretch of constant rates. The swing's acceleration narrows it: its rate is the largest part of its own."""
    rates = np.array([0.4, 0.1, 0.0, -0.1])
    motion = bp.Trajectory.from_steps(np.linspace(0.0, 4.0, 5), np.array(A) + np.linspace(0.0, 4.0, 5)[:, None] * rates)
    reference, acceleration = Reference(motion, backhoe.limits), np.array([0.5, 0.5, 0.5, 0.5])
    reference.clock = 2.0
    ramp = PaceRamp(acceleration, DT)
    change = 0.5 * DT / 0.4
    ramp.pace = 0.5
    assert ramp.towards(1.0, reference) == pytest.approx(0.5 + change)
    ramp.pace = 0.5
    assert ramp.towards(0.0, reference) == pytest.approx(0.5 - change)
    ramp.pace = 0.5
    assert ramp.towards(0.505, reference) == 0.505
    ramp.pace = 0.5 * change
    assert ramp.towards(0.0, reference) == 0.0


@pytest.fixture(scope="module")
def plan(backhoe: bp.Robot) -> bp.Plan:
    start, goal = ({"joints": dict(zip(NAMES, q, strict=True))} for q in (A, B))
    scene = bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": goal}})
    return bp.plan(backhoe, scene, effort="quick")


def in_turn() -> Iterator[float]:
    """1 and 0, step after step: every 0 takes back nearly all that the 1 before it gave."""
    return (float(step % 2 == 0) for step in count())


def held() -> Iterator[float]:
    """1 and 0 for half a second each: the machine runs on for some tenths of a second when 0 is asked for."""
    return (float(step % 100 < 50) for step in count())


@pytest.mark.parametrize(("paces", "certified"), [(in_turn, True), (held, False)])
def test_a_machine_stays_on_its_plan_at_any_paces(
    plan: bp.Plan, paces: Callable[[], Iterator[float]], certified: bool
) -> None:
    """It gets as far as a machine that only the accelerations hold back, computed with the track alone."""
    servo = bp.Servo(plan.robot, plan.scene, DT)
    track = Track(Reference(plan.trajectory, servo.limits), servo.limits, DT)
    q, v = servo.q, servo.v
    with bp.PlanFollower(servo, plan if certified else plan.trajectory) as follower:
        for pace in islice(paces(), 900):
            v = track.faster(q, v, pace)
            q = q + DT * v
            track.advance()
            state = follower.step(pace=pace)
            assert state.status.value in {"following", "waiting", "arrived"}
            assert state.deviation < 0.02  # a machine without a track brakes straight ahead; the plan bends
            assert state.plan_time >= 0.9 * track.reference.clock
            if state.done:
                break
    assert state.done == (paces is held)
