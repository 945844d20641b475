"""Torques of motions by virtual work, against inverse dynamics and by hand, and refutations of spoiled plans."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import backhoe_planner as bp
from backhoe_planner.machine import Dynamics
from backhoe_planner.motion import Problem, build_problem
from validation.habitats import load_machine
from validation.independent_check import refutations
from validation.motion_loads import file_contradictions, motion_contradictions, torques_of
from validation.raw_urdf import read_raw_urdf

# 20 kg with its centre at 0.5 m and 1.5 kg m^2 about it; inertia about the hinge: 1.5 + 20 0.5^2 = 6.5 kg m^2
LEVER = """<robot name="lever"><link name="base"/>
<link name="arm"><inertial><origin xyz="0.5 0 0" rpy="0 0 1.5707963267948966"/><mass value="20"/>
<inertia ixx="0.7" iyy="0.2" izz="1.5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.5 0 0"/><geometry><box size="1 0.1 0.1"/></geometry></collision></link>
<link name="end"/><joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/>
<origin rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" velocity="1" effort="300" acceleration="4"/></joint>
<joint name="to_end" type="fixed"><parent link="arm"/><child link="end"/><origin xyz="1 0 0"/></joint></robot>"""


def posed(robot: bp.Robot, **keys: Any) -> Problem:
    """A task that begins and ends in the middle of the joints' ranges."""
    middle = {"joints": dict(zip(robot.joint_names, robot.middle.tolist(), strict=True))}
    return build_problem(robot, bp.scene_from_dict({"version": 1, "start": middle, "task": {"goal": middle}} | keys))


@pytest.mark.parametrize("name", ["backhoe", "panda", "telescope", "planar4"])
def test_virtual_work_gives_the_torques_of_inverse_dynamics(name: str) -> None:
    robot, rng = load_machine(name), np.random.default_rng(4)
    machine = read_raw_urdf(robot.urdf.path, find_mesh=robot.urdf.mesh_path, hold=robot.hold)
    q = np.array([robot.random_q(rng) for _ in range(6)])
    v, a = rng.normal(size=q.shape), 2.0 * rng.normal(size=q.shape)
    payload: dict[str, Any] = {"payload": 30.0, "payload_at": [0.1, -0.05, 0.2]}
    found = torques_of(machine, posed(robot, **payload), q, v, a)
    expected = Dynamics(robot, **payload).torques_along(q, v, a)
    np.testing.assert_allclose(found, expected, atol=1e-5 * float(np.max(np.abs(expected))))


def test_the_torque_of_a_lever_equals_a_hand_calculation(tmp_path: Path) -> None:
    """(6.5 + 4 1^2) a + 9.81 (20 0.5 + 4 1) cos q with a payload of 4 kg at 1 m, whatever its velocity."""
    file = tmp_path / "lever.urdf"
    file.write_text(LEVER)
    robot = bp.load_robot(file)
    q, v, a = np.array([[0.0], [0.6], [-1.1]]), np.array([[0.0], [2.0], [-1.0]]), np.array([[3.0], [-2.0], [0.5]])
    found = torques_of(read_raw_urdf(file), posed(robot, payload=4.0), q, v, a)
    np.testing.assert_allclose(found, 10.5 * a + 9.81 * 14.0 * np.cos(q), rtol=1e-5)


@pytest.fixture(scope="module")
def swing(backhoe: bp.Robot) -> bp.Plan:
    """A fast swing with a full bucket."""
    ends = ([0.0, 0.3, -1.6, -0.9], [1.2, 0.5, -1.2, -0.9])
    start, goal = ({"joints": dict(zip(backhoe.joint_names, end, strict=True))} for end in ends)
    content = {"version": 1, "start": start, "task": {"goal": goal}, "payload": 350.0, "objective": "time"}
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified
    return plan


def test_verified_plans_and_their_files_are_not_contradicted(swing: bp.Plan, tmp_path: Path) -> None:
    """Also a sequence with a payload on one leg, a rest, and limits of the scene."""
    robot = load_machine("planar4")
    legs = [
        {"name": "there", "goal": {"joints": dict.fromkeys(robot.joint_names, 0.4)}, "payload": 3.0},
        {"name": "rest", "wait": 0.5},
        {"name": "back", "goal": {"joints": dict.fromkeys(robot.joint_names, -0.1)}},
    ]
    limits = {
        "velocity_scale": 0.6,
        "acceleration": {robot.joint_names[0]: 0.5},
        "velocity": {robot.joint_names[1]: 0.3},
    }
    start = {"joints": dict.fromkeys(robot.joint_names, 0.0)}
    content = {"version": 1, "start": start, "task": {"sequence": legs}, "limits": limits}
    sequence = bp.plan(robot, bp.scene_from_dict(content), effort="quick")
    for plan in (swing, sequence):
        assert plan.verified
        assert motion_contradictions(plan) == []
        plan.save(tmp_path / "plan.json")
        assert file_contradictions(tmp_path / "plan.json") == []


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "torque"])
def test_a_certificate_that_says_too_little_of_a_limit_is_refuted(swing: bp.Plan, kind: str) -> None:
    (name, use), *_ = ((name, use) for name, use in swing.certificate.uses.items() if use.kind == kind)
    assert use.ratio > 0.5
    less: dict[str, Any] = {name: dataclasses.replace(use, ratio=0.97 * use.ratio)}
    wrong = dataclasses.replace(swing, certificate=dataclasses.replace(swing.certificate, **less))
    lines = refutations(wrong)
    assert lines
    said = f"said are {97.0 * use.ratio:.2f} %"
    assert all(f"{kind} of" in line and said in line for line in lines)


def test_a_certificate_of_another_motion_is_refuted(swing: bp.Plan) -> None:
    """The same motion in nine tenths of the time: 1.11 times the velocities, and 1.23 times the accelerations."""
    faster = bp.Trajectory.from_steps(0.9 * swing.trajectory.time, swing.trajectory.q)
    lines = refutations(dataclasses.replace(swing, trajectory=faster))
    for kind in ("velocity", "acceleration"):
        assert any(f"{kind} of" in line and "allowed are" in line for line in lines), kind


def spoil_place(said: dict[str, Any]) -> None:
    said["trajectory"]["q"][40][1] += 0.02


def spoil_rate(said: dict[str, Any]) -> None:
    said["trajectory"]["v"][40][2] += 0.01


def spoil_torque(said: dict[str, Any]) -> None:
    said["dynamics"]["torque"][40][1] *= 0.98


def spoil_use(said: dict[str, Any]) -> None:
    said["certificate"]["limits"]["acceleration"]["ratio"] *= 0.9


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoil_place, ["a velocity of", "an acceleration of", "allowed are"]),
        (spoil_rate, ["a velocity of", "is said, of the samples it is"]),
        (spoil_torque, ["boom at", "a torque of", "is said, of the samples it is"]),
        (spoil_use, ["an acceleration of", "said are"]),
    ],
)
def test_a_file_whose_samples_or_figures_are_spoiled_is_refuted(
    swing: bp.Plan, tmp_path: Path, spoil: Callable[[dict[str, Any]], None], words: list[str]
) -> None:
    file = tmp_path / "plan.json"
    swing.save(file)
    said = json.loads(file.read_text())
    spoil(said)
    file.write_text(json.dumps(said))
    lines = file_contradictions(file)
    assert all(any(word in line for line in lines) for word in words), lines


@pytest.fixture(scope="module")
def cut(backhoe: bp.Robot) -> bp.Plan:
    """A quick cut through firm soil."""
    ways = [([4.4, 0.3], 0.05, [-2.3, -1.0]), ([3.9, 0.27], -0.15, [-2.3, -1.0]), ([3.3, 0.23], -0.15, [-2.7, -1.2])]
    path = {"waypoints": [{"position": [*at, z], "pitch": pitch} for at, z, pitch in ways], "tolerance": 0.02}
    soil = {"cohesion": 12000.0, "adhesion": 500.0}
    content = {"version": 1, "task": {"path": path}, "soil": soil, "objective": "time"}
    plan = bp.plan(backhoe, bp.scene_from_dict(content), effort="quick")
    assert plan.verified
    assert plan.certificate.hydraulics is not None
    return plan


def test_a_cut_through_soil_and_its_file_are_not_contradicted(cut: bp.Plan, tmp_path: Path) -> None:
    assert motion_contradictions(cut) == []
    cut.save(tmp_path / "plan.json")
    assert file_contradictions(tmp_path / "plan.json") == []


def test_soil_that_is_harder_than_that_of_the_certificate_is_refuted(cut: bp.Plan) -> None:
    """Of rock, with a cohesion of 1 MPa, no backhoe cuts 0.15 m in seconds."""
    own = cut.scene.soil
    assert own is not None

    def lines(cohesion: float) -> list[str]:
        soil = own.model_copy(update={"cohesion": cohesion})
        problem = dataclasses.replace(cut.problem, scene=cut.scene.model_copy(update={"soil": soil}))
        return motion_contradictions(dataclasses.replace(cut, problem=problem))

    assert any("torque of" in line and "said are" in line for line in lines(30000.0))
    for kind in ("torque", "engine power"):
        assert any(f"{kind} of" in line and "allowed are" in line for line in lines(1e6)), kind


def test_a_cut_in_nine_tenths_of_the_time_asks_too_much_of_the_pump(cut: bp.Plan) -> None:
    assert cut.certificate.hydraulics is not None
    assert cut.certificate.hydraulics.kind == "pump flow"
    assert cut.certificate.hydraulics.ratio > 0.95
    faster = bp.Trajectory.from_steps(0.9 * cut.trajectory.time, cut.trajectory.q)
    lines = motion_contradictions(dataclasses.replace(cut, trajectory=faster))
    assert any("pump flow of" in line and "allowed are" in line for line in lines), lines


def test_a_certificate_that_says_too_little_of_the_pump_is_refuted(cut: bp.Plan) -> None:
    use = cut.certificate.hydraulics
    assert use is not None
    less = dataclasses.replace(cut.certificate, hydraulics=dataclasses.replace(use, ratio=0.98 * use.ratio))
    said = f"said are {98.0 * use.ratio:.2f} %"
    assert any(said in line for line in refutations(dataclasses.replace(cut, certificate=less)))


def spoil_soil(said: dict[str, Any]) -> None:
    said["scene"]["soil"]["cohesion"] *= 2.0


def spoil_power(said: dict[str, Any]) -> None:
    powers = said["dynamics"]["power"]
    powers[int(np.argmax(powers))] *= 0.98


def spoil_pump(said: dict[str, Any]) -> None:
    powers = said["dynamics"]["hydraulic_power"]
    powers[int(np.argmax(powers))] *= 0.98


def spoil_flow(said: dict[str, Any]) -> None:
    said["certificate"]["limits"]["hydraulics"]["ratio"] *= 0.98


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (spoil_soil, "a torque of"),
        (spoil_power, "all joints at"),
        (spoil_pump, "the pump at"),
        (spoil_flow, "a pump flow of"),
    ],
)
def test_a_file_that_says_too_little_of_soil_or_oil_is_refuted(
    cut: bp.Plan, tmp_path: Path, spoil: Callable[[dict[str, Any]], None], words: str
) -> None:
    file = tmp_path / "plan.json"
    cut.save(file)
    said = json.loads(file.read_text())
    spoil(said)
    file.write_text(json.dumps(said))
    lines = file_contradictions(file)
    assert any(words in line for line in lines), lines
