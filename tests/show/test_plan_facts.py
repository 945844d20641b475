"""The facts beside the picture of a plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from backhoe_planner.machine import Robot
from backhoe_planner.motion import Trajectory, build_problem
from backhoe_planner.planning import Plan, measure_motion
from backhoe_planner.proof import certify
from backhoe_planner.show.page.plan_facts import plan_facts
from backhoe_planner.site import scene_from_dict

START = [0.0, 0.4, -1.6, -0.9]


def test_a_page_says_how_long_a_motion_waits(backhoe: Robot) -> None:
    joints = dict(zip(backhoe.joint_names, START, strict=True))
    scene = scene_from_dict({"version": 1, "start": {"joints": joints}, "task": {"goal": {"joints": joints}}})
    problem, stands = (
        build_problem(backhoe, scene),
        Trajectory.from_steps(np.array([0.0, 9.25]), np.array([START, START])),
    )
    certificate = certify(backhoe, scene, stands)
    plan = Plan(
        problem=problem, method="auto", seed=0, trajectory=stands, certificate=certificate,
        metrics=measure_motion(problem, stands, certificate),
    )  # fmt: skip
    waits = replace(plan, findings=plan.findings.model_copy(update={"waits": 9.25}))
    assert ("Waits", "9.25 s", "until moving obstacles have passed") in plan_facts(waits)
    assert all(name != "Waits" for name, _, _ in plan_facts(plan))
