"""A follower refuses a plan of another machine or another site, and says what differs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

import backhoe_planner as bp
from backhoe_planner.live import PlanFollower, Servo
from backhoe_planner.machine import Robot

POST = {"name": "post", "shape": "cylinder", "radius": 0.1, "length": 2.0, "position": [-3.0, 0.0, 1.0]}
CONTENT: dict[str, Any] = {
    "version": 1,
    "start": {"joints": {"swing": 0.0, "boom": 0.3, "stick": -1.5, "bucket": -0.5}},
    "task": {"goal": {"joints": {"swing": 0.2, "boom": 0.3, "stick": -1.5, "bucket": -0.5}}},
    "obstacles": [POST],
}


@pytest.fixture(scope="module")
def swing(backhoe: Robot) -> bp.Plan:
    found = bp.plan(backhoe, bp.scene_from_dict(CONTENT), effort="quick")
    assert found.verified, found.message
    return found


def servo_in(robot: Robot, plan: bp.Plan, **changed: Any) -> Servo:
    return Servo(robot, bp.scene_from_dict(CONTENT | changed), 0.01, q=plan.trajectory.q[0])


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"obstacles": []}, "plan.scene.obstacles: .*found post; allowed: none"),
        ({"obstacles": [POST | {"name": "pole"}]}, "plan.scene.obstacles: .*found post; allowed: pole"),
        ({"obstacles": [POST | {"radius": 0.2}]}, r"plan.scene.obstacles\[post\].radius: .*found 0.1; allowed: 0.2"),
        ({"clearance": 0.2}, "plan.scene.clearance: .*found 0.05; allowed: 0.2"),
        ({"hold": {"swing": 0.0}}, "plan.robot: is a plan for other joints"),
    ],
)
def test_a_plan_of_another_site_is_refused(backhoe: Robot, swing: bp.Plan, changed: dict[str, Any], told: str) -> None:
    scene = bp.scene_from_dict(CONTENT | changed)
    servo = Servo(backhoe, scene, 0.01) if "hold" not in changed else Servo(backhoe, held(scene), 0.01)
    with pytest.raises(bp.InputError, match=told):
        PlanFollower(servo, swing)


def held(scene: bp.Scene) -> bp.Scene:
    """The scene with its start and goal only for the joints that are not held."""
    content = scene.to_dict()
    for joints in (content["start"]["joints"], content["task"]["goal"]["joints"]):
        joints.pop("swing", None)
    return bp.scene_from_dict(content)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            lambda robot: replace(robot, limits=replace(robot.limits, velocity=0.5 * robot.limits.velocity)),
            "plan.robot.limits.velocity: ",
        ),
        (lambda robot: replace(robot, urdf=replace(robot.urdf, sha256="0" * 64)), "plan.robot.urdf: "),
    ],
)
def test_a_plan_of_another_machine_is_refused(
    backhoe: Robot, swing: bp.Plan, change: Callable[[Robot], Robot], told: str
) -> None:
    with pytest.raises(bp.InputError, match=told):
        PlanFollower(servo_in(change(backhoe), swing), swing)


def test_the_order_of_obstacles_the_task_and_what_was_added_by_hand_may_differ(backhoe: Robot, swing: bp.Plan) -> None:
    servo = servo_in(backhoe, swing, name="another name", task={"goal": {"position": [4.0, 0.0, 0.0]}})
    servo.add(POST | {"name": "new", "position": [-3.0, 3.0, 1.0]})
    with PlanFollower(servo, swing) as follower:
        assert follower.step().plan_time > 0.0
