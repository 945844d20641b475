"""The lower bound of a motion's duration: against hand calculations and certified motions."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.machine import load_robot
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    SmoothWay,
    Trajectory,
    build_problem,
    drive_of,
    retime,
    time_polyline,
    time_way,
)
from backhoe_planner.proof import certify_problem, least_duration

Data = dict[str, Any]

ENOUGH = 1_000  # boxes
SAMPLED = 2.5 * SAMPLE_PERIOD  # s: by which the bound is below that of a continuous motion, at these limits

# a ball at 1 m from a continuous hinge
TURNTABLE = """<robot name="turntable"><link name="base"/>
  <link name="arm"><collision><origin xyz="1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit effort="1e5" velocity="1"/></joint>
  <joint name="end" type="fixed"><origin xyz="1 0 0"/><parent link="arm"/><child link="tip"/></joint></robot>"""


def problem_of(robot: bp.Robot, start: Vector, goal: Any, **keys: Any) -> bp.Problem:
    joints = {name: float(value) for name, value in zip(robot.joint_names, start, strict=True)}
    content = {"version": 1, "start": {"joints": joints}, "task": {"goal": goal}} | keys
    return build_problem(robot, bp.scene_from_dict(content))


def at_joints(robot: bp.Robot, q: Vector) -> Data:
    return {"joints": dict(zip(robot.joint_names, np.asarray(q).tolist(), strict=True))}


def at_pose(robot: bp.Robot, q: Vector, *, turned: bool = False) -> Data:
    at = bp.Kinematics(robot).at(q)
    content: Data = {"position": at.tip_position.tolist()}
    if turned and robot.has_pitch:
        content["pitch"] = at.pitch
    elif turned:
        content["quaternion"] = Rotation.from_matrix(at.tip_rotation).as_quat(scalar_first=True).tolist()
    return content


def rest_to_rest(distance: float, velocity: float, acceleration: float) -> float:
    """The least duration over a distance under limits of velocity and acceleration [s]."""
    if distance * acceleration <= velocity**2:
        return 2.0 * float(np.sqrt(distance / acceleration))
    return distance / velocity + velocity / acceleration


# --- hand calculations ---------------------------------------------------------------


@pytest.mark.parametrize(("angle", "seconds"), [(2.0, 2.5), (0.32, 0.8)])
def test_the_bound_of_one_joint_is_its_time_with_ramps(planar4: bp.Robot, angle: float, seconds: float) -> None:
    """1 rad/s and 2 rad/s^2: 2 rad take 2 s plus 0.5 s for the ramps; 0.32 rad, all ramp, 2 sqrt(0.16) s."""
    goal = at_joints(planar4, np.array([0.1, angle, 0.0, -0.1]))
    found = least_duration(problem_of(planar4, np.zeros(4), goal), np.zeros(4), known=10.0, boxes=ENOUGH)
    assert seconds - SAMPLED < found.duration < seconds


def test_the_bound_of_a_stretched_arm_is_that_of_its_first_joint(planar4: bp.Robot) -> None:
    """Full reach has one configuration: joint 1 alone turns, but the goal's tolerance of 1 mm lets the others bend."""
    there = np.array([1.5, 0.0, 0.0, 0.0])
    problem = problem_of(planar4, np.zeros(4), at_pose(planar4, there))
    found = least_duration(problem, np.zeros(4), known=4.0, end=there, boxes=16 * ENOUGH)
    assert rest_to_rest(1.5 - 0.05, 1.0, 2.0) - SAMPLED < found.duration < rest_to_rest(1.5, 1.0, 2.0)


def test_the_bound_lets_joints_share_a_motion(planar4: bp.Robot) -> None:
    """Every joint moves by 0.3 rad; with a tenth less each, the tip does not reach this pose."""
    folded = np.full(4, 0.3)
    problem = problem_of(planar4, np.zeros(4), at_pose(planar4, folded, turned=True))
    found = least_duration(problem, np.zeros(4), known=2.0, end=folded, boxes=ENOUGH)
    assert 0.9 * rest_to_rest(0.3, 1.0, 2.0) - SAMPLED < found.duration < rest_to_rest(0.3, 1.0, 2.0)


@pytest.mark.parametrize("at_once", [1, 128])
def test_boxes_that_are_not_halved_yet_are_kept(
    planar4: bp.Robot, monkeypatch: pytest.MonkeyPatch, at_once: int
) -> None:
    """The bound of the same motion, though a motion of 3 s is all that is known."""
    monkeypatch.setattr(sys.modules[least_duration.__module__], "_AT_ONCE", at_once)
    problem = problem_of(planar4, np.zeros(4), at_pose(planar4, np.full(4, 0.3), turned=True))
    found = least_duration(problem, np.zeros(4), known=3.0, boxes=ENOUGH)
    assert 0.0 < found.duration < rest_to_rest(0.3, 1.0, 2.0)


def test_the_bound_includes_the_flow_of_the_pump(backhoe: bp.Robot) -> None:
    """Boom, stick and bucket together: the oil of all strokes over the pump's flow, from the cylinder lengths alone."""
    start, end = np.array([0.0, 0.2, -0.9, -0.2]), np.array([0.0, -0.5, -1.9, -1.6])
    hydraulics = backhoe.hydraulics
    assert hydraulics is not None
    strokes = hydraulics.lengths(end) - hydraulics.lengths(start)
    areas = [c.cap_area if s > 0.0 else c.annulus_area for c, s in zip(hydraulics.cylinders, strokes, strict=True)]
    seconds = float(np.abs(strokes) @ areas) / hydraulics.pump_flow
    limits = backhoe.limits
    alone = max(map(rest_to_rest, np.abs(end - start), limits.velocity, limits.acceleration))
    assert seconds > 1.1 * alone
    problem = problem_of(backhoe, start, at_joints(backhoe, end))
    found = least_duration(problem, start, known=20.0, boxes=ENOUGH)
    # the certificate allows the drive 1 % more, and the flow does not begin at once
    assert 0.98 * seconds < found.duration < 1.15 * seconds


def test_the_bound_of_a_continuous_joint_takes_the_shorter_turn(tmp_path: Any) -> None:
    """From 3 rad to -3 rad it turns by 0.283 rad onwards, not by 6 rad back; 1 rad/s is reached after 0.5 s."""
    file = tmp_path / "turntable.urdf"
    file.write_text(TURNTABLE)
    robot = load_robot(file)
    problem = problem_of(robot, np.array([3.0]), at_pose(robot, np.array([-3.0])))
    found = least_duration(problem, np.array([3.0]), known=9.0, boxes=ENOUGH)
    seconds = rest_to_rest(2.0 * np.pi - 6.0, 1.0, 2.0)
    assert seconds - SAMPLED < found.duration < seconds


def test_the_bound_of_several_goals_is_that_of_the_nearest(planar4: bp.Robot) -> None:
    far, near = np.array([1.5, 0.0, 0.5, 0.0]), np.array([0.0, -0.8, 0.5, 0.0])
    goals = [at_joints(planar4, far), at_joints(planar4, near)]
    alone, both = (
        least_duration(problem_of(planar4, np.zeros(4), goal), np.zeros(4), known=5.0, boxes=ENOUGH).duration
        for goal in (goals[1], goals)
    )
    assert both == pytest.approx(alone, abs=1e-9)


def test_the_bound_of_a_start_on_the_goal_is_0(planar4: bp.Robot) -> None:
    problem = problem_of(planar4, np.full(4, 0.2), at_pose(planar4, np.full(4, 0.2)))
    assert least_duration(problem, np.full(4, 0.2), known=3.0, boxes=ENOUGH).duration == 0.0
    assert least_duration(problem, np.full(4, 0.2), known=0.0, boxes=ENOUGH).duration == 0.0


# --- certified motions ---------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2, 3, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(4, 12))])
def test_no_certified_motion_is_faster_than_the_bound(
    planar4: bp.Robot, backhoe: bp.Robot, panda: bp.Robot, ur5: bp.Robot, seed: int
) -> None:
    """Straight in the joints, as fast as all limits allow, to a pose of the tip or its position."""
    robot = (backhoe, panda, planar4, ur5)[seed % 4]
    rng = np.random.default_rng([7, seed])
    start = robot.random_q(rng)
    end = start + rng.uniform(0.1, 0.7) * (robot.random_q(rng) - start)
    problem = problem_of(robot, start, at_pose(robot, end, turned=seed % 3 > 0))
    motion = retime(time_polyline(np.array([start, end]), problem.limits), problem.limits, drive=drive_of(problem))
    certificate = certify_problem(problem, motion)
    assert certificate.limits_kept
    assert certificate.tracking.done
    found = least_duration(problem, start, known=2.0 * motion.duration, boxes=ENOUGH)
    assert found.duration <= motion.duration
    # the bound with a known end holds too
    nearer = least_duration(problem, start, known=motion.duration, end=end, boxes=ENOUGH)
    assert nearer.duration <= motion.duration


@pytest.mark.parametrize("seed", [0, 3, 4, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 5))])
def test_the_fastest_straight_joint_motions_are_just_above_the_bound(backhoe: bp.Robot, seed: int) -> None:
    """Timed with velocities, accelerations and pump at their limits, then sped up as far as the certificate allows."""
    rng = np.random.default_rng([11, seed])
    start = backhoe.random_q(rng)
    end = start + rng.uniform(0.2, 0.8) * (backhoe.random_q(rng) - start)
    problem = problem_of(backhoe, start, at_joints(backhoe, end))
    length = float(np.max(np.abs(end - start) / problem.limits.velocity))
    way = SmoothWay(np.array([start, end]), np.array([0.0, length]), np.zeros(2))
    motion = time_way(way, problem.limits, drive=drive_of(problem))
    found = least_duration(problem, start, known=1.5 * motion.duration, boxes=ENOUGH)
    assert 0.8 * motion.duration < found.duration
    hurried = [Trajectory.from_steps(part * motion.time, motion.q) for part in np.arange(0.97, 1.0001, 0.002)]
    kept = [faster.duration for faster in hurried if certify_problem(problem, faster).limits_kept]
    assert kept
    assert found.duration <= min(kept)


@pytest.mark.parametrize("seed", range(8))
def test_uneven_samples_do_not_make_a_motion_faster_than_the_bound(planar4: bp.Robot, seed: int) -> None:
    """A certified motion of one joint goes as far as its sample times allow: each corner is as sharp as
    `Trajectory.corner_accelerations` allows, with segments of all lengths from far below to far above its period."""
    rng = np.random.default_rng([3, seed])
    steps = np.exp(rng.uniform(np.log(0.2 * SAMPLE_PERIOD), np.log(4.0 * SAMPLE_PERIOD), rng.integers(2, 40)))
    spans = np.minimum(np.concatenate((steps[:1], 0.5 * (steps[:-1] + steps[1:]), steps[-1:])), SAMPLE_PERIOD)
    # 1 rad/s and 2 rad/s^2
    rate = np.minimum(np.minimum(2.0 * np.cumsum(spans[:-1]), 2.0 * np.cumsum(spans[:0:-1])[::-1]), 1.0)
    time, q = np.append(0.0, np.cumsum(steps)), np.zeros((len(steps) + 1, 4))
    q[1:, 0] = np.cumsum(rate * steps)
    problem = problem_of(planar4, q[0], at_joints(planar4, q[-1]))
    motion = Trajectory.from_steps(time, q)
    certificate = certify_problem(problem, motion)
    assert certificate.acceleration.kept
    assert certificate.velocity.kept
    assert certificate.acceleration.ratio == pytest.approx(1.0, abs=1e-6)
    assert least_duration(problem, q[0], known=3.0 * motion.duration, boxes=ENOUGH).duration <= motion.duration


# --- tightness -----------------------------------------------------------------------


def test_a_motion_at_its_joint_limits_is_bounded_within_2_percent(panda: bp.Robot) -> None:
    """Joint 1 alone turns the arm by 2.5 rad, in the time of a full ramp."""
    start = np.array([-1.25, 0.3, 0.0, -1.2, 0.0, 1.6, 0.5])
    end = start + np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    problem = problem_of(panda, start, at_joints(panda, end))
    seconds = rest_to_rest(2.5, float(panda.limits.velocity[0]), float(panda.limits.acceleration[0]))
    found = least_duration(problem, start, known=seconds, end=end, boxes=ENOUGH)
    assert 0.98 * seconds - SAMPLE_PERIOD < found.duration <= seconds
    assert found.settled


def test_more_boxes_raise_the_bound(panda: bp.Robot) -> None:
    start, end = np.array([0.0, 0.2, 0.0, -1.5, 0.0, 1.7, 0.0]), np.array([1.2, 0.6, -0.3, -1.0, 0.4, 1.2, 0.9])
    problem = problem_of(panda, start, at_pose(panda, end))
    few, some, many = (least_duration(problem, start, known=2.0, end=end, boxes=count) for count in (1, 1_000, 4_000))
    assert few.duration < some.duration < many.duration
    assert not few.settled
    assert many.boxes > some.boxes >= 1_000


def test_the_bound_does_not_depend_on_the_order_of_goals(backhoe: bp.Robot) -> None:
    """Boxes are spent where the bound is lowest, not on the first goals."""
    rng = np.random.default_rng([7, 1])
    start, ends = backhoe.random_q(rng), [backhoe.random_q(rng) for _ in range(4)]
    goals = [{"position": bp.Kinematics(backhoe).at(q).tip_position.tolist()} for q in ends]
    joints = dict(zip(backhoe.joint_names, start.tolist(), strict=True))
    found = []
    for order in (goals, goals[::-1]):
        scene = bp.scene_from_dict({"version": 1, "start": {"joints": joints}, "task": {"goal": order}})
        found.append(least_duration(build_problem(backhoe, scene), start, known=4.0, boxes=1_500).duration)
    assert found[0] == pytest.approx(found[1], rel=1e-12)
    assert found[0] > 0.0
