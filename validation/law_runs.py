"""Each law on the same seeded random planar scenes: whether it arrives, touches and jumps.

The scenes are those of `planar_scenes`. The laws:

- pseudo-inverse: v = J^+ xdot alone;
- paper: equation (12) as printed, with the printed gains, 100 iterations;
- null space: the completed law without the shield;
- shield: the pseudo-inverse behind the shield, without null-space terms;
- straight: only the first attempt of the completed law behind the shield;
- reactive: the plan of `--method reactive` with all its attempts.

A motion touches if a distance of the independent check is below 0.
Verified plans are checked by it as a whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import backhoe_planner as bp
from backhoe_planner.law import CompletedLaw, run_iteration
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Plan, measure_motion
from backhoe_planner.proof import certify_problem
from validation.independent_check import least_distances, refutations
from validation.planar_scenes import random_planar_scene
from validation.printed_laws import ARRIVED, JUMP, first_attempt
from validation.tables import Row, percent

PERIOD = 0.02  # s between the samples of a law that is driven without the shield


@dataclass(frozen=True)
class Run:
    """The motion of one law on one scene; `refuted` has what contradicts a verified plan."""

    scene: int
    law: str
    arrived: bool
    touched: bool
    largest_step: float
    seconds: float
    refuted: str = ""


def run_scene(index: int, seed: int) -> list[Run]:
    """Every law on one scene."""
    robot = bp.load_robot("example:planar4")
    problem = build_problem(robot, random_planar_scene(robot, np.random.default_rng([seed, index])))
    laws: dict[str, Callable[[], tuple[bp.Trajectory, bool]]] = {
        "pseudo-inverse": lambda: _unshielded(problem, null_space=False),
        "paper": lambda: _printed(problem),
        "null space": lambda: _unshielded(problem, null_space=True),
        "shield": lambda: first_attempt(problem, null_space=False),
        "straight": lambda: first_attempt(problem),
    }
    runs = []
    for name, law in laws.items():
        begun = time.perf_counter()
        motion, arrived = law()
        seconds = time.perf_counter() - begun
        runs.append(Run(index, name, arrived, _touches(problem, motion), _largest_step(motion), seconds))
    begun = time.perf_counter()
    plan = bp.plan(robot, problem.scene, method="reactive")
    seconds = time.perf_counter() - begun
    refuted = "; ".join(refutations(plan)) if plan.verified else ""
    step = _largest_step(plan.trajectory)
    return [*runs, Run(index, "reactive", plan.verified, bool(refuted), step, seconds, refuted)]


def share_table(runs: Sequence[Run]) -> list[Row]:
    """One row for every law."""
    laws = {law: [run for run in runs if run.law == law] for law in dict.fromkeys(run.law for run in runs)}
    return [
        {
            "law": law,
            "arrives [%]": percent(run.arrived for run in mine),
            "touches [%]": percent(run.touched for run in mine),
            "arrives and touches nothing [%]": percent(run.arrived and not run.touched for run in mine),
            "joint step over 1 rad [%]": percent(run.largest_step > JUMP for run in mine),
            "median [s]": float(np.median([run.seconds for run in mine])),
        }
        for law, mine in laws.items()
    ]


def _largest_step(motion: bp.Trajectory) -> float:
    return float(np.max(np.abs(np.diff(motion.q, axis=0)), initial=0.0))


def _touches(problem: Problem, motion: bp.Trajectory) -> bool:
    certificate = certify_problem(problem, motion)
    plan = Plan(problem, "reactive", 0, motion, certificate, measure_motion(problem, motion, certificate))
    # the paper's iterations are few and far apart; the other samples are 20 ms apart
    refine = 10 if len(motion) <= 101 else 2
    return any(least.distance < 0.0 for least in least_distances(plan, refine=refine))


def _unshielded(problem: Problem, *, null_space: bool) -> tuple[bp.Trajectory, bool]:
    """The motion of the law alone, as fast as the joint rates allow, and whether it arrives."""
    robot, goal = problem.robot, problem.goals[0].target
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
        q.append(q[-1] + PERIOD * v / max(1.0, fastest))
    return bp.Trajectory.from_steps(PERIOD * np.arange(len(q), dtype=float), np.array(q)), arrived


def _printed(problem: Problem) -> tuple[bp.Trajectory, bool]:
    """The motion by equation (12), one iteration per second, and whether it ends on the goal."""
    robot, goal = problem.robot, problem.goals[0].target
    assert problem.start_q is not None
    kinematics, proximity = bp.Kinematics(robot), bp.Proximity(robot, problem.obstacles)
    q = run_iteration(problem, problem.start_q, goal, proximity=proximity, kinematics=kinematics)
    arrived = goal.distances(kinematics.at(q[-1]))[0] < ARRIVED
    return bp.Trajectory.from_steps(np.arange(len(q), dtype=float), q), arrived
