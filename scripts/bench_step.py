#!/usr/bin/env python
"""How long one reactive step takes on the backhoe with ten obstacles.

The machine drives its tip from one random goal to the next among ten seeded obstacles.
Timed are the parts of a step (proximity and kinematics, the law, the shield, the proof
of the step) and the whole; in the same run, as yardsticks, the Pinocchio and coal calls
alone on the same configurations, and a step of Pink with its collision barrier on the
same model and pairs, where Pink is installed (pip install pin-pink "qpsolvers[daqp]").
The results are in docs/measurements.md.

    python scripts/bench_step.py [--steps 5000] [--obstacles 10] [--save FILE] [--against FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import backhoe_planner as bp
from backhoe_planner.law import CompletedLaw
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Stepper
from backhoe_planner.site import Proximity

Samples = dict[str, list[float]]


def random_site(robot: bp.Robot, count: int, rng: np.random.Generator) -> Problem:
    """The backhoe among `count` obstacles inside its reach, none of which it touches at the start."""
    start = np.array([0.0, 0.4, -1.6, -0.9])
    while True:
        obstacles: list[dict[str, Any]] = []
        for index in range(count):
            radius, angle = rng.uniform(2.5, 6.0), rng.uniform(-1.3, 1.3)
            place = [float(radius * np.cos(angle)), float(radius * np.sin(angle)), float(rng.uniform(-2.5, 3.0))]
            name = f"obstacle {index}"
            if index % 3 == 0:
                obstacles.append({"name": name, "shape": "sphere", "radius": 0.3, "position": place})
            elif index % 3 == 1:
                obstacles.append({"name": name, "shape": "box", "size": [0.5, 0.5, 0.5], "position": place})
            else:
                end = [place[0], place[1], place[2] + 1.0]
                obstacles.append({"name": name, "shape": "capsule", "radius": 0.1, "from": place, "to": end})
        scene = bp.scene_from_dict(
            {
                "version": 1,
                "start": {"joints": dict(zip(robot.joint_names, start.tolist(), strict=True))},
                "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
                "obstacles": obstacles,
            }
        )
        problem = build_problem(robot, scene)
        proximity = Proximity(robot, problem.obstacles)
        if np.all(proximity.distances(start) > proximity.clearance + 0.05):
            return problem


def measure(problem: Problem, steps: int, rng: np.random.Generator) -> tuple[Samples, list[np.ndarray], float]:
    """Times of each part [us], the configurations that were passed, and rows per step."""
    robot = problem.robot
    assert problem.start_q is not None
    proximity, kinematics = Proximity(robot, problem.obstacles), bp.Kinematics(robot)
    stepper = Stepper(problem, problem.start_q, proximity=proximity, kinematics=kinematics)
    law = CompletedLaw(robot, influence=problem.scene.influence)
    times: Samples = {name: [] for name in ("look", "law", "step (shield and proof)", "whole step")}
    passed, rows = [], 0
    goal = kinematics.at(robot.random_q(rng)).tip_position
    for count in range(steps):
        if count % 200 == 0:
            goal = kinematics.at(robot.random_q(rng)).tip_position
        begun = time.perf_counter()
        at, nearby = stepper.look()
        looked = time.perf_counter()
        error = goal - at.tip_position
        size = float(np.linalg.norm(error))
        wish = law.wish(at, at.jacobian[:3], error * min(1.0, 0.6 / max(size, 1e-9)), nearby)
        wished = time.perf_counter()
        stepper.advance(wish.v, nearby, at.jacobian[:3])
        done = time.perf_counter()
        parts = (looked - begun, wished - looked, done - wished, done - begun)
        for name, part in zip(times, parts, strict=True):
            times[name].append(1e6 * part)
        passed.append(stepper.q)
        rows += len(nearby)
    return times, passed, rows / steps


def libraries_alone(problem: Problem, passed: list[np.ndarray]) -> list[float]:
    """Time of the Pinocchio and coal calls alone, all pairs measured [us]."""
    proximity = Proximity(problem.robot, problem.obstacles)
    model, data = problem.robot.model, problem.robot.model.createData()
    geometry_model, geometry = proximity.geometry
    found = []
    for q in passed:
        begun = time.perf_counter()
        pin.computeJointJacobians(model, data, q)
        pin.updateGeometryPlacements(model, data, geometry_model, geometry)
        pin.computeDistances(geometry_model, geometry)
        found.append(1e6 * (time.perf_counter() - begun))
    return found


def pink_alone(problem: Problem, passed: list[np.ndarray], pairs: int) -> list[float] | None:
    """Time of Pink's step with a frame task and its collision barrier [us]; None without Pink."""
    try:
        import pink
        from pink.barriers import SelfCollisionBarrier
        from pink.tasks import FrameTask
    except ImportError:
        return None
    proximity = Proximity(problem.robot, problem.obstacles)
    model = problem.robot.model
    geometry_model, geometry = proximity.geometry
    configuration = pink.Configuration(
        model, model.createData(), passed[0], collision_model=geometry_model, collision_data=geometry
    )
    task = FrameTask(problem.robot.tip, position_cost=1.0, orientation_cost=0.0)
    barrier = SelfCollisionBarrier(n_collision_pairs=pairs, gain=20.0, safe_displacement_gain=1.0, d_min=0.05)
    task.set_target(configuration.get_transform_frame_to_world(problem.robot.tip))
    found = []
    for q in passed:
        begun = time.perf_counter()
        configuration.update(q)
        try:
            pink.solve_ik(configuration, [task], 0.02, solver="daqp", barriers=[barrier])
        except Exception:  # noqa: BLE001  Pink raises where its problem has no solution
            continue
        found.append(1e6 * (time.perf_counter() - begun))
    return found


def summary(samples: list[float]) -> dict[str, float]:
    median, p95, p99 = np.percentile(samples, [50, 95, 99])
    return {"median": float(median), "p95": float(p95), "p99": float(p99)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--obstacles", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    parser.add_argument("--against", type=Path, help="figures saved before, to compare with")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    problem = random_site(bp.load_robot("example:backhoe"), arguments.obstacles, rng)
    measure(problem, 200, np.random.default_rng(1))  # warm up
    times, passed, rows = measure(problem, arguments.steps, rng)
    pairs = len(Proximity(problem.robot, problem.obstacles).pairs)
    results = {name: summary(samples) for name, samples in times.items()}
    results["Pinocchio and coal alone"] = summary(libraries_alone(problem, passed))
    print(f"{arguments.obstacles} obstacles, {pairs} pairs, {rows:.1f} rows per step, {arguments.steps} steps")
    pink = pink_alone(problem, passed[:1000], max(1, round(rows)))
    if pink:
        results["Pink with barrier"] = summary(pink)
    before = json.loads(arguments.against.read_text()) if arguments.against else {}
    print(f"{'':<28}{'median':>9}{'p95':>9}{'p99':>9}  [us]" + ("   median before" if before else ""))
    for name, row in results.items():
        line = f"{name:<28}{row['median']:>9.1f}{row['p95']:>9.1f}{row['p99']:>9.1f}"
        print(line + (f"{before[name]['median']:>23.1f}" if name in before else ""))
    if not pink:
        print("Pink is not installed: no comparison with it")
    ratio = results["whole step"]["median"] / results["Pinocchio and coal alone"]["median"]
    print(f"a whole step costs {ratio:.2f} times the library calls over all pairs")
    if arguments.save:
        arguments.save.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
