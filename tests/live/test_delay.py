"""What delays a machine along its plan is told from the first step on, and is what binds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from executors import Never

import backhoe_planner as bp

NAMES = ("swing", "boom", "stick", "bucket")
POSTURE = (0.0, 0.3, -1.5, -1.5)
CLEARANCE, ABOVE = 0.05, 0.02  # m; how far the machine is above the slab beyond its clearance


def swinging() -> bp.Trajectory:
    """The swing alone turns by 1 rad in 4 s, so that every point stays at its height."""
    part = np.linspace(0.0, 1.0, 120)
    q = np.tile(POSTURE, (120, 1))
    q[:, 0] = 10 * part**3 - 15 * part**4 + 6 * part**5
    return bp.Trajectory.from_steps(4.0 * part, q)


def swing_scene(**task: Any) -> bp.Scene:
    start, goal = ({"joints": dict(zip(NAMES, q, strict=True))} for q in (POSTURE, (1.0, *POSTURE[1:])))
    return bp.scene_from_dict({"version": 1, "start": start, "task": {"goal": goal, **task}, "clearance": CLEARANCE})


def add_slab(servo: bp.Servo) -> None:
    """A slab below the machine's whole way, at a distance that stays the same."""
    slab = {"name": "slab", "shape": "box", "size": [40.0, 40.0, 1.0], "position": [0.0, 0.0, -20.0]}
    servo.add(slab)
    apart = float(bp.Proximity(servo.robot, servo.snapshot(), self_collision=False).distances(servo.q).min())
    servo.move("slab", [0.0, 0.0, apart - CLEARANCE - ABOVE])


@pytest.mark.parametrize("speed", [0.0, 0.3])
@pytest.mark.parametrize("task", [{}, {"keep": {"pitch": [-2.75, -2.65]}}])
def test_the_first_slower_step_names_what_binds_and_not_what_is_nearest(
    backhoe: bp.Robot, speed: float, task: Any
) -> None:
    """The slab is nearer than the ball, but swinging comes no nearer to it: only the ball can hold the machine up."""
    motion = swinging()
    servo = bp.Servo(backhoe, swing_scene(**task), 0.02, q=motion.q[0])
    add_slab(servo)
    tip = bp.Kinematics(backhoe).at(motion.at(2.4)).tip_position
    outward = np.array([*tip[:2], 0.0]) / float(np.linalg.norm(tip[:2]))
    servo.add({"name": "ball", "shape": "sphere", "radius": 0.2, "position": (tip + 2.4 * speed * outward).tolist()})
    servo.set_velocity("ball", (-speed * outward).tolist())
    late, reasons, nearest = 0.0, [], set()
    with bp.PlanFollower(servo, motion, executor=Never()) as follower:
        for _ in range(150):
            step = follower.step()
            if step.behind > late + 0.02 * servo.dt:
                reasons.append(step.reason)
                if len(reasons) == 1 and step.state.nearest is not None:
                    nearest.add(step.state.nearest.obstacle)
            late = step.behind
    assert late > 0.2
    assert nearest == {"slab"}
    assert "bucket is held back by ball" in reasons[0] or "the clearance of bucket from ball" in reasons[0]
    assert all(reasons)


def test_without_anything_in_the_way_no_delay_is_told(backhoe: bp.Robot) -> None:
    """The slab is near all along, and delays nothing."""
    motion = swinging()
    servo = bp.Servo(backhoe, swing_scene(), 0.02, q=motion.q[0])
    add_slab(servo)
    with bp.PlanFollower(servo, motion, executor=Never()) as follower:
        steps = [follower.step() for _ in range(203)]
    assert steps[-1].done
    assert {step.reason for step in steps} == {""}
