"""The lower bound of the work of a motion: what it lifts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from machines import LENGTH, MASS, PENDULUM

import backhoe_planner as bp
from backhoe_planner.machine import GRAVITY, Dynamics, load_robot
from backhoe_planner.motion import build_problem, time_polyline, trajectory_costs
from backhoe_planner.proof import least_work

LOW, HIGH = np.array([-0.5]), np.array([0.6])
GAIN = MASS * GRAVITY * LENGTH * float(np.sin(0.6) + np.sin(0.5))  # J


def to_height(folder: Path, start: float, end: float, **keys: object) -> bp.Problem:
    file = folder / "pendulum.urdf"
    file.write_text(PENDULUM)
    position = [LENGTH * np.cos(end), 0.0, 2.0 + LENGTH * np.sin(end)]
    content = {"version": 1, "start": {"joints": {"hinge": start}}, "task": {"goal": {"position": position}}}
    return build_problem(load_robot(file, tip="end"), bp.scene_from_dict(content | keys))


def test_a_mass_that_is_lifted(tmp_path: Path) -> None:
    """m g times the height, less 1 % twice, and the millimetre at the goal; no motion does with less."""
    problem = to_height(tmp_path, -0.5, 0.6)
    found = least_work(problem, LOW, end=HIGH, boxes=1_000)
    assert found is not None
    assert 0.975 * GAIN < found < GAIN
    motion = time_polyline(np.array([LOW, HIGH]), problem.limits)
    assert found < trajectory_costs(problem, motion)["work"]


def test_a_payload_is_lifted_too(tmp_path: Path) -> None:
    found = least_work(to_height(tmp_path, -0.5, 0.6, payload=MASS), LOW, end=HIGH, boxes=1_000)
    assert found is not None
    assert 0.975 * 2.0 * GAIN < found < 2.0 * GAIN


def test_what_goes_down_may_cost_nothing(tmp_path: Path) -> None:
    assert least_work(to_height(tmp_path, 0.6, -0.5), HIGH, end=LOW, boxes=1_000) == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_no_posture_on_the_goal_lifts_less(backhoe: bp.Robot, seed: int) -> None:
    """Postures with the same tip, found by inverse kinematics, are all as high."""
    rng = np.random.default_rng([5, seed])
    ends = sorted((backhoe.random_q(rng) for _ in range(4)), key=lambda q: bp.Kinematics(backhoe).at(q).tip_position[2])
    start, end = ends[0], ends[-1]
    target = bp.TipTarget(bp.Kinematics(backhoe).at(end).tip_position)
    joints = dict(zip(backhoe.joint_names, start.tolist(), strict=True))
    goal = {"position": target.position.tolist()}
    scene = bp.scene_from_dict({"version": 1, "start": {"joints": joints}, "task": {"goal": goal}})
    found = least_work(build_problem(backhoe, scene), start, end=end, boxes=600)
    assert found is not None
    energy = Dynamics(backhoe).potential_energy
    for _ in range(10):
        other = bp.solve_inverse_kinematics(backhoe, target, start=backhoe.random_q(rng))
        if other.reached:
            assert found <= max(energy(other.q) - energy(start), 0.0)


@pytest.mark.parametrize("way", [0.002, 0.005, 0.007])
def test_a_motion_of_few_samples_is_not_said_to_be_impossible(tmp_path: Path, way: float) -> None:
    """What the first and the last segment lift is not in the sum over the samples."""
    end = np.array([0.1 + way])
    problem = to_height(tmp_path, 0.1, float(end[0]), limits={"acceleration": {"hinge": 20.0}}, objective="work")
    found = least_work(problem, np.array([0.1]), end=end, boxes=100)
    step = 1.001 * float(np.sqrt(way / (2.0 * 20.0)))  # s: both segments reach their speed at 20 rad/s^2
    motion = bp.Trajectory.from_steps(np.array([0.0, step, 2.0 * step]), np.array([[0.1], [0.1 + 0.5 * way], end]))
    certificate = bp.certify(problem.robot, problem.scene, motion)
    assert certificate.velocity.kept
    assert certificate.acceleration.kept
    assert found is not None
    assert found <= trajectory_costs(problem, motion)["work"]
