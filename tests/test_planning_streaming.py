"""A plan that is followed live: on time where nothing is in the way, held and resumed where something is."""

from __future__ import annotations

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine.robot import Robot
from backhoe_planner.planning.streaming import Followed, PlanFollower
from backhoe_planner.redundancy.servo import Servo
from backhoe_planner.site.obstacles import build_obstacles
from backhoe_planner.site.proximity import Proximity

START = [-0.3, 0.3, -0.9, -0.5]
END = [0.5, 0.1, -0.7, -0.6]
BALL = {"name": "ball", "shape": "sphere", "radius": 0.3, "position": [4.9, 0.6, -0.6]}


def empty_site(robot: Robot) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, START, strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
        }
    )


def smooth_motion(duration: float = 6.0) -> bp.Trajectory:
    """From START to END on a straight line, with rates that begin and end at 0."""
    time = np.linspace(0.0, duration, 301)
    part = 0.5 * (1.0 - np.cos(np.pi * time / duration))
    return bp.Trajectory.from_steps(time, np.array(START) + part[:, None] * (np.array(END) - START))


def followed(follower: PlanFollower, most: int) -> list[Followed]:
    found = []
    for _ in range(most):
        found.append(follower.step())
        if found[-1].done:
            break
    return found


def test_with_nothing_in_the_way_it_arrives_on_time(backhoe: Robot) -> None:
    servo = Servo(backhoe, empty_site(backhoe))
    steps = followed(PlanFollower(servo, smooth_motion()), 9000)
    assert steps[-1].done
    assert max(step.deviation for step in steps) < 0.01
    assert steps[-1].behind < 1.5
    np.testing.assert_allclose(steps[-1].state.q, END, atol=1e-3)


def test_held_by_what_turns_up_and_going_on_once_it_is_gone(backhoe: Robot) -> None:
    """A ball appears on the way: nothing is touched, the plan waits; taken away, the plan is finished."""
    servo = Servo(backhoe, empty_site(backhoe))
    follower = PlanFollower(servo, smooth_motion())
    followed(follower, 1200)
    servo.add(BALL)
    held = followed(follower, 6000)
    assert not held[-1].done
    assert held[-1].behind > 1.0
    scene = bp.scene_from_dict(
        {**empty_site(backhoe).model_dump(by_alias=True, exclude_none=True), "obstacles": [BALL]}
    )
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    margins = [float(np.min(proximity.distances(step.state.q) - proximity.clearance)) for step in held[::50]]
    assert -1e-6 <= min(margins) < 0.05
    servo.remove("ball")
    resumed = followed(follower, 12_000)
    assert resumed[-1].done
    np.testing.assert_allclose(resumed[-1].state.q, END, atol=1e-3)


def test_what_stays_on_the_plan_is_gone_round(backhoe: Robot) -> None:
    """A small ball is put on the way and stays: the plan is left, rejoined beyond it and finished, nothing touched."""
    ball = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [4.7, 0.4, -0.05]}
    scene = bp.scene_from_dict(
        {**empty_site(backhoe).model_dump(by_alias=True, exclude_none=True), "obstacles": [ball]}
    )
    proximity = Proximity(backhoe, build_obstacles(scene, backhoe))
    motion = smooth_motion()
    assert min(float(np.min(proximity.distances(q) - proximity.clearance)) for q in motion.q) < -0.1
    servo = Servo(backhoe, empty_site(backhoe))
    follower = PlanFollower(servo, motion)
    followed(follower, 1200)
    servo.add(ball)
    steps = followed(follower, 14_000)
    assert steps[-1].done
    assert max(step.deviation for step in steps) > 0.1
    margins = [float(np.min(proximity.distances(step.state.q) - proximity.clearance)) for step in steps[::20]]
    assert -1e-6 <= min(margins) < 0.02
    np.testing.assert_allclose(steps[-1].state.q, END, atol=1e-3)


def test_where_it_stands_elsewhere_it_goes_to_the_beginning_first(backhoe: Robot) -> None:
    servo = Servo(backhoe, empty_site(backhoe), q=[-0.1, 0.4, -1.0, -0.3])
    steps = followed(PlanFollower(servo, smooth_motion()), 12_000)
    assert steps[500].plan_time < 0.1
    assert steps[-1].done


def test_another_machines_plan_is_refused(planar4: Robot, panda: Robot) -> None:
    servo = Servo(planar4, bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict.fromkeys(planar4.joint_names, 0.3)},
            "task": {"goal": {"position": [1.0, 1.0, 0.0]}},
        }
    ), self_collision=False)  # fmt: skip
    motion = bp.Trajectory.from_steps(np.array([0.0, 1.0]), np.zeros((2, panda.n)))
    with pytest.raises(bp.InputError, match="another number of joints"):
        PlanFollower(servo, motion)
