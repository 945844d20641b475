"""The lower bound of the work of a motion: its gain in potential energy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from machines import LENGTH, MASS, PENDULUM

import backhoe_planner as bp
from backhoe_planner.machine import GRAVITY, Dynamics, load_robot
from backhoe_planner.motion import build_problem, time_polyline, trajectory_costs
from backhoe_planner.proof import least_work
from backhoe_planner.proof.least_work import _PotentialEnergy
from validation.habitats import load_machine

TURNING_MAST = f"""<robot name="mast"><link name="base"/><link name="mast"/>
  <link name="load"><collision><geometry><sphere radius="0.01"/></geometry></collision>
    <inertial><mass value="{MASS}"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="tilt" type="revolute"><parent link="base"/><child link="mast"/><axis xyz="0 -1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1e5" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="mast"/><child link="load"/><axis xyz="1 0 0"/>
    <limit lower="-0.5" upper="2" effort="1e5" velocity="1"/></joint></robot>"""
LOW, HIGH = np.array([-0.5]), np.array([0.6])
GAIN = MASS * GRAVITY * LENGTH * float(np.sin(0.6) + np.sin(0.5))  # J


def to_height(folder: Path, start: float, end: float, **keys: object) -> bp.Problem:
    file = folder / "pendulum.urdf"
    file.write_text(PENDULUM)
    position = [LENGTH * np.cos(end), 0.0, 2.0 + LENGTH * np.sin(end)]
    content = {"version": 1, "start": {"joints": {"hinge": start}}, "task": {"goal": {"position": position}}}
    return build_problem(load_robot(file, tip="end"), bp.scene_from_dict(content | keys))


def test_the_bound_of_lifting_a_mass_is_m_g_h(tmp_path: Path) -> None:
    """Less 1 % twice and the millimetre at the goal; no motion needs less."""
    problem = to_height(tmp_path, -0.5, 0.6)
    found = least_work(problem, LOW, end=HIGH, boxes=1_000)
    assert found is not None
    assert 0.975 * GAIN < found < GAIN
    motion = time_polyline(np.array([LOW, HIGH]), problem.limits)
    assert found < trajectory_costs(problem, motion)["work"]


def test_the_bound_includes_the_payload(tmp_path: Path) -> None:
    found = least_work(to_height(tmp_path, -0.5, 0.6, payload=MASS), LOW, end=HIGH, boxes=1_000)
    assert found is not None
    assert 0.975 * 2.0 * GAIN < found < 2.0 * GAIN


def test_in_soil_there_is_no_bound(backhoe: bp.Robot) -> None:
    """What is dug or shed changes the load, so that the gain in height does not bound the work."""
    start, end = np.array([0.0, 0.2, -1.4, -0.9]), np.array([0.0, 0.6, -1.4, -0.9])
    named = [{"joints": dict(zip(backhoe.joint_names, q.tolist(), strict=True))} for q in (start, end)]
    content = {"version": 1, "start": named[0], "task": {"goal": named[1]}}
    for scene, bounded in ((content, True), (content | {"soil": {}}, False)):
        found = least_work(build_problem(backhoe, bp.scene_from_dict(scene)), start, end=end, boxes=100)
        assert (found is not None) is bounded


def test_the_bound_of_lowering_is_0(tmp_path: Path) -> None:
    assert least_work(to_height(tmp_path, 0.6, -0.5), HIGH, end=LOW, boxes=1_000) == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_no_configuration_on_the_goal_lifts_less_than_the_bound(backhoe: bp.Robot, seed: int) -> None:
    """Configurations with the same tip position, found by inverse kinematics, have no less potential energy."""
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
    gains = [
        energy(other.q) - energy(start)
        for other in (bp.solve_inverse_kinematics(backhoe, target, start=backhoe.random_q(rng)) for _ in range(10))
        if other.reached
    ]
    assert len(gains) >= 3
    assert found <= max(min(gains), 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_no_posture_in_a_box_has_less_potential_energy_than_its_bound(
    backhoe: bp.Robot, panda: bp.Robot, tmp_path: Path, seed: int
) -> None:
    """With and without a payload, of hinges and slides, in boxes from 1 cm or 10 mrad to 1 m or rad."""
    (tmp_path / "slide.urdf").write_text(TURNING_MAST)
    robot = (backhoe, panda, load_machine("telescope"), load_robot(tmp_path / "slide.urdf"))[seed]
    rng, payload = np.random.default_rng(seed), 0.0 if seed == 1 else 150.0
    start = dict.fromkeys(robot.joint_names, 0.1)
    load = {"payload": payload, "payload_at": [0.3, -0.2, 0.4]}
    content = {"version": 1, "start": {"joints": start}, "task": {"goal": {"joints": start}}} | load
    energy = _PotentialEnergy(build_problem(robot, bp.scene_from_dict(content)))
    exact = Dynamics(robot, payload=payload, payload_at=(0.3, -0.2, 0.4)).potential_energy
    for _ in range(40):
        middle = robot.random_q(rng)
        half = np.exp(rng.uniform(np.log(1e-2), 0.0)) * rng.uniform(0.3, 1.0, robot.n)
        half *= rng.integers(0, 2, robot.n) | (np.arange(robot.n) == rng.integers(robot.n))
        (least,) = energy.least((middle - half)[None], (middle + half)[None])
        corners = half * rng.choice([-1.0, 1.0], (40, robot.n)) * np.where(rng.integers(0, 2, (40, 1)), 1.0, 0.5)
        offset = energy.at(middle) - exact(middle)
        assert least <= min(exact(middle + d) for d in corners) + offset + 1e-6


def test_the_bound_of_the_potential_energy_of_a_mast_equals_a_hand_calculation(tmp_path: Path) -> None:
    """A mass that slides by s on a mast tilted by x from level: m g s sin x, or m g s x to second order at 0."""
    (tmp_path / "slide.urdf").write_text(TURNING_MAST)
    robot, half = load_robot(tmp_path / "slide.urdf"), np.array([0.4, 0.3])
    joints = {"joints": {"tilt": 0.0, "slide": 0.0}}
    scene = bp.scene_from_dict({"version": 1, "start": joints, "task": {"goal": joints}})
    energy = _PotentialEnergy(build_problem(robot, scene))
    (least,) = energy.least(-half[None], half[None])
    rest = 0.3 * 0.4**2 / 2.0 + 0.3 * 0.4**3 / 6.0
    assert least - energy.at(np.zeros(2)) == pytest.approx(-MASS * GRAVITY * (0.3 * 0.4 + rest), rel=1e-9)


@pytest.mark.parametrize("way", [0.002, 0.005, 0.007])
def test_the_bound_is_not_above_the_work_of_a_motion_of_three_samples(tmp_path: Path, way: float) -> None:
    """The sum over samples leaves out what the first and the last segment lift."""
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


def test_what_the_samples_leave_out_at_the_ends_equals_a_hand_calculation(tmp_path: Path) -> None:
    """Two half segments at a S = 0.4 rad/s: their lift, m g L a S^2, and the kinetic energy, m L^2 (a S)^2 / 2."""
    problem = to_height(tmp_path, -0.5, 0.6, limits={"acceleration": {"hinge": 20.0}})
    speed = 20.0 * 0.02
    lift, kinetic = MASS * GRAVITY * LENGTH * speed * 0.02, 0.5 * MASS * LENGTH**2 * speed**2
    assert _PotentialEnergy(problem).unsampled(problem, LOW) == pytest.approx(lift + kinetic, rel=1e-5)


def test_what_the_samples_leave_out_of_a_slide_on_a_mast_equals_a_hand_calculation(tmp_path: Path) -> None:
    """The mast lifts the mass at up to 2 m from its axis, where the slide ends; its inertia is that of the start."""
    (tmp_path / "slide.urdf").write_text(TURNING_MAST)
    robot = load_robot(tmp_path / "slide.urdf")
    joints = {"joints": {"tilt": 0.0, "slide": 0.5}}
    limits = {"acceleration": {"tilt": 5.0, "slide": 10.0}}
    content = {"version": 1, "start": joints, "task": {"goal": joints}, "limits": limits}
    problem = build_problem(robot, bp.scene_from_dict(content))
    tilt, slide = 5.0 * 0.02, 10.0 * 0.02
    lift = MASS * GRAVITY * (2.0 * tilt + slide) * 0.02
    kinetic = 0.5 * MASS * (0.5**2 * tilt**2 + slide**2)
    found = _PotentialEnergy(problem).unsampled(problem, np.array([0.0, 0.5]))
    assert found == pytest.approx(lift + kinetic, rel=1e-5)
