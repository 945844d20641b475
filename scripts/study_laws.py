#!/usr/bin/env python
"""How often each law arrives, touches, and jumps, over seeded random planar scenes.

Every scene has 1 to 6 obstacles (balls, blocks, capsules) in the plane of the paper's
arm, a free start, and a goal that some free configuration reaches. The laws:

- pseudo-inverse: v = J^+ xdot alone;
- paper: equation (12) as printed, with the printed gains, 100 iterations;
- null space: the completed law without the shield;
- shield: the pseudo-inverse behind the shield, without null-space terms;
- straight: the completed law behind the shield, its first attempt alone;
- reactive: what `--method reactive` does, all of its attempts.

A law touches where its motion comes closer than 0 to anything by the independent check,
which measures without coal, ten times finer than the samples. Verified plans are held
against that check too. The results are in docs/measurements.md.

    python scripts/study_laws.py [--scenes 500] [--seed 5] [--save FILE.csv]
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

import backhoe_planner as bp
from backhoe_planner.law import CompletedLaw, run_iteration
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Plan, Stepper, Work, approach_goal, measure_motion
from backhoe_planner.planning.reactive.stepping import STEP
from backhoe_planner.proof import certify_problem
from validation.independent_check import least_distances, refutations
from validation.planar_scenes import random_planar_scene

NEAR = 1e-2  # m from the goal counts as arrived, for the laws that only approach it


@dataclass(frozen=True)
class Row:
    """The motion of one law on one scene."""

    scene: int
    law: str
    arrived: bool
    touched: bool
    largest_step: float
    seconds: float
    refuted: str = ""


def run_scene(index: int, seed: int) -> list[Row]:
    """Every law on one scene."""
    robot = bp.load_robot("example:planar4")
    scene = random_planar_scene(robot, np.random.default_rng([seed, index]))
    problem = build_problem(robot, scene)
    laws: dict[str, Callable[[Problem], tuple[bp.Trajectory, bool]]] = {
        "pseudo-inverse": lambda p: _unshielded(p, null_space=False),
        "paper": _paper,
        "null space": lambda p: _unshielded(p, null_space=True),
        "shield": lambda p: _first_attempt(p, null_space=False),
        "straight": lambda p: _first_attempt(p, null_space=True),
    }
    rows = []
    for name, law in laws.items():
        begun = time.perf_counter()
        motion, arrived = law(problem)
        seconds = time.perf_counter() - begun
        step = float(np.max(np.abs(np.diff(motion.q, axis=0)), initial=0.0))
        rows.append(Row(index, name, arrived, _touches(problem, motion), step, seconds))
    begun = time.perf_counter()
    plan = bp.plan(robot, scene, method="reactive")
    seconds = time.perf_counter() - begun
    refuted = "; ".join(refutations(plan)) if plan.verified else ""
    step = float(np.max(np.abs(np.diff(plan.trajectory.q, axis=0)), initial=0.0))
    rows.append(Row(index, "reactive", plan.verified, bool(refuted), step, seconds, refuted))
    return rows


def _touches(problem: Problem, motion: bp.Trajectory) -> bool:
    certificate = certify_problem(problem, motion)
    plan = Plan(problem, "reactive", 0, motion, certificate, measure_motion(problem, motion, certificate))
    # the paper's iterations are few and far apart, the others are samples 20 ms apart
    refine = 10 if len(motion) <= 101 else 2
    return any(least.distance < 0.0 for least in least_distances(plan, refine=refine))


def _unshielded(problem: Problem, *, null_space: bool) -> tuple[bp.Trajectory, bool]:
    """The law alone, in steps of 20 ms at the pace that the joint rates allow."""
    robot, goal = problem.robot, problem.goal
    assert goal is not None
    assert problem.start_q is not None
    kinematics, proximity = bp.Kinematics(robot), bp.Proximity(robot, problem.obstacles)
    law = CompletedLaw(robot, influence=problem.scene.influence, directionality=null_space)
    q = [problem.start_q]
    arrived = False
    for _ in range(2000):
        at = kinematics.at(q[-1])
        error = goal.error(at)[:2]
        if float(np.linalg.norm(error)) < 1e-3:
            arrived = True
            break
        nearby = proximity.at(at.q, margin=problem.scene.influence if null_space else -np.inf)
        v = law.wish(at, at.jacobian[:2], error * min(4.0, 0.6 / float(np.linalg.norm(error))), nearby).v
        fastest = float(np.max(np.abs(v) / problem.limits.velocity))
        q.append(q[-1] + STEP * v / max(1.0, fastest))
    return bp.Trajectory.from_steps(np.array([STEP * k for k in range(len(q))]), np.array(q)), arrived


def _paper(problem: Problem) -> tuple[bp.Trajectory, bool]:
    robot, goal = problem.robot, problem.goal
    assert goal is not None
    assert problem.start_q is not None
    kinematics = bp.Kinematics(robot)
    q = run_iteration(
        problem, problem.start_q, goal, proximity=bp.Proximity(robot, problem.obstacles), kinematics=kinematics
    )
    arrived = goal.distances(kinematics.at(q[-1]))[0] < NEAR
    return bp.Trajectory.from_steps(np.arange(len(q), dtype=float), q), arrived


def _first_attempt(problem: Problem, *, null_space: bool) -> tuple[bp.Trajectory, bool]:
    assert problem.goal is not None
    assert problem.start_q is not None
    stepper = Stepper(
        problem, problem.start_q, proximity=bp.Proximity(problem.robot, problem.obstacles),
        kinematics=bp.Kinematics(problem.robot),
    )  # fmt: skip
    attempts = approach_goal(stepper, problem.goal, [], work=Work(), null_space=null_space)
    attempt = next(iter(attempts))
    return attempt.stepper.trajectory(), attempt.arrived


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=500)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--save", type=Path)
    arguments = parser.parse_args()
    results = Parallel(n_jobs=arguments.jobs, return_as="generator_unordered")(
        delayed(run_scene)(index, arguments.seed) for index in range(arguments.scenes)
    )
    rows: list[Row] = []
    for done, result in enumerate(results, start=1):
        rows += result
        if sys.stderr.isatty():
            print(f"\r{done} of {arguments.scenes}", end="", file=sys.stderr)
    print(f"{arguments.scenes} scenes, seed {arguments.seed}")
    print(
        f"{'law':<16}{'arrives':>9}{'touches':>9}{'arrives, touches nothing':>26}{'step > 1 rad':>14}{'median s':>10}"
    )
    for law in dict.fromkeys(row.law for row in rows):
        mine = [row for row in rows if row.law == law]
        clean = [row.arrived and not row.touched for row in mine]
        print(
            f"{law:<16}{np.mean([r.arrived for r in mine]):>9.1%}{np.mean([r.touched for r in mine]):>9.1%}"
            f"{np.mean(clean):>26.1%}{np.mean([r.largest_step > 1.0 for r in mine]):>14.1%}"
            f"{np.median([r.seconds for r in mine]):>10.2f}"
        )
    refuted = [row for row in rows if row.refuted]
    print(f"verified plans refuted by the independent check: {len(refuted)}")
    for row in refuted:
        print(f"  scene {row.scene}: {row.refuted}")
    if arguments.save:
        with arguments.save.open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(Row.__dataclass_fields__)
            writer.writerows([tuple(vars(row).values()) for row in sorted(rows, key=lambda r: r.scene)])


if __name__ == "__main__":
    main()
