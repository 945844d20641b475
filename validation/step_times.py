"""One obstacle course of the backhoe on which the steps of the law and of the servo are timed.

All times are in microseconds on the processor, which other processes do not lengthen.
Measured beside them, on the same configurations, are the Pinocchio and coal calls alone over
all pairs, and a step of Pink with its collision barrier on the same model and pairs, where
Pink is installed (pip install pin-pink "qpsolvers[daqp]").
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.law import CompletedLaw
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Stepper
from validation.obstacles import course_obstacle, name_all
from validation.scenes import scene_of

Times = NDArray[np.float64]

START = np.array([0.0, 0.4, -1.6, -0.9])
SPARE = 0.05  # m beyond every clearance that the start keeps


def obstacle_course(robot: bp.Robot, count: int, rng: np.random.Generator) -> Problem:
    """The backhoe among `count` obstacles in its reach, none of which it touches at the start."""
    while True:
        obstacles = name_all([course_obstacle(index, rng) for index in range(count)])
        problem = build_problem(robot, scene_of(robot, obstacles, start=START))
        proximity = bp.Proximity(robot, problem.obstacles)
        if np.all(proximity.distances(START) > proximity.clearance + SPARE):
            return problem


@dataclass(frozen=True)
class StepTimes:
    """The times of many steps.

    Attributes
    ----------
    times: (steps,) of every part and of the whole step.
    configurations: (n,) each, on the way.
    rows: nearby pairs in a step, in the mean.
    """

    times: dict[str, Times]
    configurations: list[Vector]
    rows: float


def time_law(problem: Problem, steps: int, rng: np.random.Generator) -> StepTimes:
    """Time the parts of the law's steps, on the way from one random goal of the tip to the next."""
    robot = problem.robot
    assert problem.start_q is not None
    proximity, kinematics = bp.Proximity(robot, problem.obstacles), bp.Kinematics(robot)
    stepper = Stepper(problem, problem.start_q, proximity=proximity, kinematics=kinematics)
    law = CompletedLaw(robot, influence=problem.scene.influence)
    times, configurations, rows = np.empty((steps, 4)), [], 0
    goal = kinematics.at(robot.random_q(rng)).tip_position
    for count in range(steps):
        if count % 200 == 0:
            goal = kinematics.at(robot.random_q(rng)).tip_position
        begun = time.thread_time()
        at, nearby = stepper.look()
        looked = time.thread_time()
        error = goal - at.tip_position
        size = float(np.linalg.norm(error))
        J = at.jacobian[:3]
        primary, null = law.terms_unchecked(at, J, error * min(1.0, 0.6 / max(size, 1e-9)), nearby)
        wished = time.thread_time()
        stepper.advance(primary + null, nearby, J)
        done = time.thread_time()
        times[count] = looked - begun, wished - looked, done - wished, done - begun
        configurations.append(stepper.q)
        rows += len(nearby)
    names = ("proximity and kinematics", "law", "shield and proof of the step", "whole step")
    return StepTimes(dict(zip(names, 1e6 * times.T, strict=True)), configurations, rows / steps)


def time_servo(servo: bp.Servo, steps: int, moving: int, rng: np.random.Generator) -> StepTimes:
    """Time the servo's steps on the processor and on the clock; every 20th configuration is kept.

    The wish changes every 300 steps between tip and joint velocities. The first `moving`
    obstacles go to and fro.
    """
    times, configurations = np.empty((steps, 2)), []
    wish: dict[str, Vector] = {}
    for count in range(steps):
        if count % 300 == 0:
            if rng.integers(3):
                tip = rng.normal(size=3)
                wish = {"tip_velocity": tip * rng.uniform(0.2, 1.0) / np.linalg.norm(tip)}
            else:
                wish = {"joint_velocity": rng.uniform(-1.0, 1.0, servo.robot.n) * servo.limits.velocity}
        if count % 4000 == 0:
            for name in servo.obstacles[:moving]:
                way = servo.shift_of(name)
                direction = rng.normal(size=3) if not way.any() else -way
                servo.set_velocity(name, 0.05 * direction / np.linalg.norm(direction))
        begun, begun_on_processor = time.perf_counter(), time.thread_time()
        state = servo.step(**wish)
        times[count] = time.thread_time() - begun_on_processor, time.perf_counter() - begun
        if count % 20 == 0:
            configurations.append(state.q)
    return StepTimes(dict(zip(("processor", "clock"), 1e6 * times.T, strict=True)), configurations, float("nan"))


def time_libraries(problem: Problem, configurations: list[Vector]) -> Times:
    """Time the Pinocchio and coal calls alone, all pairs measured."""
    model, data = problem.robot.model, problem.robot.model.createData()
    geometry_model, geometry = bp.Proximity(problem.robot, problem.obstacles).geometry
    found = []
    for q in configurations:
        begun = time.thread_time()
        pin.computeJointJacobians(model, data, q)
        pin.updateGeometryPlacements(model, data, geometry_model, geometry)
        pin.computeDistances(geometry_model, geometry)
        found.append(1e6 * (time.thread_time() - begun))
    return np.array(found)


def time_pink(problem: Problem, configurations: list[Vector], pairs: int) -> Times | None:
    """Time Pink's step with a frame task and its collision barrier; None without Pink."""
    try:
        import pink
        from pink.barriers import SelfCollisionBarrier
        from pink.tasks import FrameTask
    except ImportError:
        return None
    model, tip = problem.robot.model, problem.robot.tip
    geometry_model, geometry = bp.Proximity(problem.robot, problem.obstacles).geometry
    configuration = pink.Configuration(
        model, model.createData(), configurations[0], collision_model=geometry_model, collision_data=geometry
    )
    task = FrameTask(tip, position_cost=1.0, orientation_cost=0.0)
    barrier = SelfCollisionBarrier(n_collision_pairs=pairs, gain=20.0, safe_displacement_gain=1.0, d_min=0.05)
    task.set_target(configuration.get_transform_frame_to_world(tip))
    found = []
    for q in configurations:
        begun = time.thread_time()
        configuration.update(q)
        try:
            pink.solve_ik(configuration, [task], 0.02, solver="daqp", barriers=[barrier])
        except Exception:  # noqa: BLE001  Pink raises where its problem has no solution
            continue
        found.append(1e6 * (time.thread_time() - begun))
    return np.array(found)


def percentiles(times: Times) -> dict[str, float]:
    """The median and the 95th and 99th percentile."""
    return dict(zip(("median", "p95", "p99"), np.percentile(times, [50, 95, 99]).tolist(), strict=True))
