"""Loads at rest by virtual work, against inverse dynamics, and refutations of loads that are too heavy."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import Problem, build_problem
from validation.habitats import load_machine
from validation.held_loads import drive_of, greatest_torques, holding_torques, unheld_loads
from validation.independent_check import refutations
from validation.raw_urdf import read_raw_urdf

LEVER = """<robot name="lever"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.5 0 0"/><mass value="20"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
<link name="end"/><joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-2" upper="2" velocity="1" effort="300"/></joint>
<joint name="to_end" type="fixed"><parent link="arm"/><child link="end"/><origin xyz="1 0 0"/></joint></robot>"""


@pytest.mark.parametrize("name", ["backhoe", "panda", "telescope"])
def test_virtual_work_gives_the_torques_of_inverse_dynamics(name: str) -> None:
    robot = load_machine(name)
    machine = read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)
    rng, still, offset = np.random.default_rng(4), np.zeros(robot.n), np.array([0.1, -0.05, 0.2])
    dynamics = Dynamics(robot, payload=30.0, payload_at=offset)
    for _ in range(4):
        q = robot.random_q(rng)
        found = holding_torques(machine, robot, q, payload=30.0, payload_at=offset)
        np.testing.assert_allclose(found, dynamics.torques(q, still, still), rtol=1e-6, atol=1e-4)


def test_cylinders_hold_as_much_as_their_moment_arms_say(backhoe: bp.Robot) -> None:
    rng = np.random.default_rng(5)
    machine = read_raw_urdf(backhoe.urdf.path, find_mesh=backhoe.urdf.mesh_path, hold=backhoe.hold)
    assert backhoe.hydraulics is not None
    for _ in range(4):
        q = backhoe.random_q(rng)
        limits = backhoe.hydraulics.torque_limits(q)
        for sign, limit in ((1.0, limits.positive), (-1.0, limits.negative)):
            found = greatest_torques(drive_of(backhoe, machine), q[None, :], np.full((1, 4), sign), np.full(4, np.inf))
            np.testing.assert_allclose(found[0], limit, rtol=1e-5, atol=1.0)


def test_a_lever_that_is_too_weak_for_its_load_is_refuted_at_the_end_where_it_is(tmp_path: Path) -> None:
    """Stretched out level it needs 9.81 (20 0.5 + m) N m of 300, and a half of that at 60 degrees."""
    file = tmp_path / "lever.urdf"
    file.write_text(LEVER)
    robot = bp.load_robot(file)
    task = {"goal": {"joints": {"hinge": 0.0}}}
    content = {"version": 1, "start": {"joints": {"hinge": np.pi / 3.0}}, "task": task}
    plan = bp.plan(robot, bp.scene_from_dict(content | {"payload": 20.0}), effort="quick")
    assert plan.verified
    assert refutations(plan) == []
    heavier = build_problem(robot, bp.scene_from_dict(content | {"payload": 22.0}))
    end = plan.trajectory.duration
    said = f"hinge needs {9.81 * 32.0:.6g} of 300 N m or N to hold its load at {end:.3f} s"
    assert unheld_loads(heavier, plan.trajectory) == [said]
    assert said in refutations(dataclasses.replace(plan, problem=heavier))


def test_the_load_of_a_leg_counts_where_the_leg_begins_and_ends(tmp_path: Path) -> None:
    """The lever rests stretched out level; with the load of that leg, or a heavier one, it is too weak there."""
    file = tmp_path / "lever.urdf"
    file.write_text(LEVER)
    robot = bp.load_robot(file)
    content = {"version": 1, "start": {"joints": {"hinge": 1.0}}}

    def problem(payload: float) -> Problem:
        legs = [
            {"name": "out", "goal": {"joints": {"hinge": 0.0}}},
            {"name": "load", "wait": 1.0, "payload": payload},
            {"name": "up", "goal": {"joints": {"hinge": 1.2}}},
        ]
        return build_problem(robot, bp.scene_from_dict(content | {"task": {"sequence": legs}}))

    plan = bp.plan(robot, problem(20.0).scene, effort="quick")
    assert plan.verified
    assert refutations(plan) == []
    times = [plan.trajectory.time[row] for row in (plan.legs[1].first, plan.legs[1].last)]
    said = unheld_loads(problem(21.0), plan.trajectory)
    assert said == [f"hinge needs {9.81 * 31.0:.6g} of 300 N m or N to hold its load at {time:.3f} s" for time in times]
