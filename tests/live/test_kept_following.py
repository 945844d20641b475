"""A follower and what is to be kept along its plan, where something stands in the way."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.live import Rejoining, RejoiningQuery, find_rejoining
from backhoe_planner.motion import Keep, keep_of

NAMES = ("swing", "boom", "stick", "bucket")
A, B = (0.0, 0.3, -1.5, -1.5), (1.0, 0.6, -1.2, -2.1)  # both at a pitch of -2.7
BAND = (-2.71, -2.69)


class AtOnce(Executor):
    """Runs what is asked of it before it answers."""

    def submit(self, function: Any, /, *args: Any, **keys: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*args, **keys))
        return future


def level_scene() -> bp.Scene:
    start, goal = ({"joints": dict(zip(NAMES, q, strict=True))} for q in (A, B))
    task = {"goal": goal, "keep": {"pitch": list(BAND)}}
    return bp.scene_from_dict({"version": 1, "start": start, "task": task})


def straight() -> bp.Trajectory:
    part = np.linspace(0.0, 1.0, 120)[:, None]
    blend = 10 * part**3 - 15 * part**4 + 6 * part**5
    return bp.Trajectory.from_steps(4.0 * part[:, 0], np.array(A) + blend * (np.array(B) - A))


def ball_on(robot: bp.Robot, motion: bp.Trajectory, above: float) -> dict[str, Any]:
    """In the middle of the tip's way, its centre `above` that [m]."""
    tip = bp.Kinematics(robot).at(motion.q[len(motion) // 2]).tip_position + np.array([0.0, 0.0, above])
    return {"name": "ball", "shape": "sphere", "radius": 0.15, "position": tip.tolist()}


@pytest.mark.parametrize("above", [0.15])
def test_a_follower_waits_rather_than_tips_the_bucket(backhoe: bp.Robot, above: float) -> None:
    """The ball pushes the bucket's side: sliding along it would tip the bucket by up to 10 degrees."""
    motion = straight()
    servo = bp.Servo(backhoe, level_scene(), 0.01)
    servo.add(ball_on(backhoe, motion, above))
    most, reasons = 0.0, set()
    with bp.PlanFollower(servo, motion, executor=AtOnce()) as follower:
        for _ in range(2000):
            told = follower.step()
            most = max(most, abs(float(told.state.q[1:].sum()) + 2.7))
            reasons.add(told.reason)
            if told.done:
                break
    assert told.done
    assert most < 0.01 + 1e-3
    assert any("would violate `keep`" in reason for reason in reasons)


def test_a_way_back_loses_no_more_than_is_lost_already(backhoe: bp.Robot) -> None:
    """The bucket stands 0.05 rad beyond the band: no further is it tipped."""
    motion, scene = straight(), level_scene()
    servo = bp.Servo(backhoe, scene, 0.01)
    servo.add(ball_on(backhoe, motion, 0.1))
    q = np.array([0.1, *A[1:3], A[3] + 0.06])
    query = RejoiningQuery(
        robot=backhoe,
        scene=scene,
        limits=backhoe.limits,
        obstacles=servo.snapshot(),
        q=q,
        motion=motion,
        since=1.0,
        seed=0,
    )
    found = find_rejoining(query)
    assert isinstance(found, Rejoining), found
    assert np.max(np.abs(found.motion.q[:, 1:].sum(axis=1) + 2.7)) <= 0.06 + 1e-5


def test_what_is_widened_holds_and_allows_no_more(backhoe: bp.Robot) -> None:
    keep = keep_of(backhoe, level_scene())
    assert isinstance(keep, Keep)
    q = np.array([*A[:3], A[3] + 0.06])
    wider = keep.widened(q)
    assert not keep.holds(q)
    assert wider.holds(q)
    assert not wider.holds(q + np.array([0.0, 0.0, 0.0, 1e-4]))
