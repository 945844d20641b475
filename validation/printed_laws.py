"""How often each law arrives, touches and jumps, over seeded random scenes of planar4.

One point obstacle (`count_point_scenes`), by a recipe that puts an obstacle in the way in
every scene:

1. Start and goal configuration: every joint uniform within its limits (a half turn
   either way), no link in contact with another. The goal is the tip position of the
   second one; its orientation is free.
2. The obstacle: a random point of the arm at a random one of the first 25 iterations of
   the plain law, moved by up to 0.25 m in x and in y.
3. At the start, and at the configuration that gave the goal, the arm is outside the
   region: its centre lines are more than 0.5 m from the obstacle.

The distance of the links' centre lines to the point is measured on every motion, between
its samples too (the joints move linearly). Below 0.05 m the arm touches: half the thickness
of a link and the radius of the sphere that replaces the point for the completed law. The
laws as printed ignore joint limits, rates and contacts of the arm with itself; the
completed law keeps all of these, and here also 0.3 m from the point.

Several solid obstacles (`count_solid_scenes`, scenes by `random_planar_scene`): the effect
of the terms of the completed law on its first attempt, with the tip straight to the goal.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from rich.progress import track

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import ITERATIONS, CompletedLaw, Magnification, Push, Reference, paper_step
from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Stepper, Work, approach_goal
from backhoe_planner.site import Gains
from validation.obstacles import sphere
from validation.planar_scenes import random_planar_scene
from validation.scenes import scene_of
from validation.tables import Row, percent

Sample = tuple[Vector, float]  # joints (n,), and their distance to the obstacle [m]

REGION = 0.5  # m, within which the obstacle term acts
PUSH_SPEED = 0.2  # |xdot_o| per iteration [m]
ARRIVED = 0.01  # m
TOUCH = 0.05  # m from a centre line
REQUIRED = 0.3  # m from a centre line
JUMP = 1.0  # rad in one iteration
SPHERE = 0.01  # m, radius of the sphere that replaces the point for the completed law
PLAIN = Gains(s_e=0.2)


@dataclass(frozen=True)
class PointScene:
    """The joints at the start (4,), the tip at the goal (3,) and the point obstacle (3,)."""

    start: Vector
    goal: Vector
    obstacle: Vector


@dataclass(frozen=True)
class PrintedLaw:
    """The law as printed, with one choice of the details that the paper leaves open."""

    name: str
    gains: Gains
    magnification: Magnification = "printed"
    reference: Reference = "tip_referenced"


def printed_laws(joint_names: Sequence[str]) -> list[PrintedLaw]:
    """The plain pseudo-inverse, the obstacle term, and all four readings of the directionality."""
    first, second = joint_names[:2]
    turning = Gains(s_e=0.2, s_o=0.2, s_k={first: 0.01, second: 0.01})
    return [
        PrintedLaw("pseudo-inverse alone", PLAIN),
        PrintedLaw("obstacle term, as printed", Gains(s_e=0.2, s_o=0.2)),
        PrintedLaw("+ directionality, as printed (1/M, tip-referenced)", turning),
        PrintedLaw("+ directionality, 1/M, standard J_k", turning, "printed", "standard"),
        PrintedLaw("+ directionality, M, tip-referenced", turning, "norm_preserving", "tip_referenced"),
        PrintedLaw("+ directionality, M, standard J_k", turning, "norm_preserving", "standard"),
    ]


# --- the arm as line links, for the laws as printed ---------------------------------


def nearest_point(at: bp.Configuration, obstacle: Vector) -> tuple[float, Vector, int]:
    """Distance, critical point (3,) on the links' centre lines, index of its link."""
    begin, line = at.points[:-1], np.diff(at.points, axis=0)
    part = np.einsum("ki,ki->k", obstacle - begin, line) / np.einsum("ki,ki->k", line, line)
    points = begin + np.clip(part, 0.0, 1.0)[:, None] * line
    distances = np.linalg.norm(points - obstacle, axis=1)
    link = int(np.argmin(distances))
    return float(distances[link]), points[link], link


def push_away(at: bp.Configuration, obstacle: Vector) -> Push | None:
    """J_o and xdot_o of the critical point, None outside the region."""
    distance, point, link = nearest_point(at, obstacle)
    if distance >= REGION:
        return None
    J_o = at.J_world[:3] + np.cross(at.J_world[3:].T, point).T
    J_o[:, link + 1 :] = 0.0
    return Push(J_o=J_o, xdot_o=PUSH_SPEED * (point - obstacle) / distance)


def iterate(kinematics: bp.Kinematics, scene: PointScene, law: PrintedLaw, count: int = ITERATIONS) -> Matrix:
    """(count + 1, n) the joints from iteration to iteration of equation (12)."""
    goal = bp.TipTarget(scene.goal)
    found = [scene.start]
    for _ in range(count):
        at = kinematics.at(found[-1])
        push = push_away(at, scene.obstacle) if law.gains.s_o else None
        step = paper_step(at, goal, push, law.gains, magnification=law.magnification, reference=law.reference)
        if not np.all(np.abs(step) < 1e6):
            break
        found.append(found[-1] + step)
    return np.array(found)


# --- measurements -----------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """The figures of one motion."""

    error: float  # of the tip at the end [m]
    arrival: int | None  # first sample on the goal
    closest: float  # centre lines to the point, also between the samples [m]
    at_samples: float  # the same at the samples only, as in the paper [m]
    largest_step: float  # of any joint in one sample [rad]

    @property
    def arrives(self) -> bool:
        """Whether the motion ends on the goal."""
        return self.error < ARRIVED


def measure(kinematics: bp.Kinematics, scene: PointScene, motion: Matrix) -> Outcome:
    """Measure a motion (T, n)."""
    configurations = [kinematics.at(q) for q in motion]
    errors = np.array([np.linalg.norm(scene.goal - at.tip_position) for at in configurations])
    distances = [nearest_point(at, scene.obstacle)[0] for at in configurations]
    closest = min(distances)
    for a, b in pairwise(zip(motion, distances, strict=True)):
        closest = _closest_between(kinematics, scene.obstacle, a, b, closest)
    there = np.flatnonzero(errors < ARRIVED)
    return Outcome(
        error=float(errors[-1]),
        arrival=int(there[0]) if len(there) else None,
        closest=closest,
        at_samples=min(distances),
        largest_step=float(np.max(np.abs(np.diff(motion, axis=0)), initial=0.0)),
    )


def _closest_between(
    kinematics: bp.Kinematics, obstacle: Vector, a: Sample, b: Sample, known: float, depth: int = 10
) -> float:
    """The least of `known` and the distance between two samples, to 1 mm."""
    (q_a, d_a), (q_b, d_b) = a, b
    travel = float(np.abs(q_b - q_a) @ np.arange(len(q_a), 0, -1))  # links of 1 m
    if depth == 0 or 0.5 * (d_a + d_b - travel) > known - 1e-3:
        return known
    q = 0.5 * (q_a + q_b)
    middle = (q, nearest_point(kinematics.at(q), obstacle)[0])
    known = _closest_between(kinematics, obstacle, a, middle, min(known, middle[1]), depth - 1)
    return _closest_between(kinematics, obstacle, middle, b, known, depth - 1)


# --- one point obstacle -------------------------------------------------------------


def random_point_scene(robot: bp.Robot, kinematics: bp.Kinematics, rng: np.random.Generator) -> PointScene:
    """A scene by the recipe above."""
    alone = bp.Proximity(robot)
    plain = PrintedLaw("plain", PLAIN)
    while True:
        start, end = (robot.random_q(rng) for _ in range(2))
        if np.min(alone.distances(start)) < 0.02 or np.min(alone.distances(end)) < 0.02:
            continue
        goal = kinematics.at(end).tip_position.copy()
        motion = iterate(kinematics, PointScene(start, goal, goal), plain, 25)
        points = kinematics.at(motion[rng.integers(1, len(motion))]).points
        along = rng.uniform(0.0, robot.n)
        link = int(along)
        obstacle = points[link] + (along - link) * (points[link + 1] - points[link])
        obstacle[:2] += rng.uniform(-0.25, 0.25, 2)
        if min(nearest_point(kinematics.at(q), obstacle)[0] for q in (start, end)) > REGION:
            return PointScene(start, goal, obstacle)


def as_scene(robot: bp.Robot, scene: PointScene) -> bp.Scene:
    """The same scene for the completed law, with a small sphere for the point."""
    point = {"name": "point", **sphere(SPHERE, scene.obstacle)}
    task = {"goal": {"position": scene.goal.tolist()}}
    return scene_of(robot, [point], start=scene.start, task=task, clearance=REQUIRED - SPHERE, influence=REGION)


def summary(name: str, runs: Sequence[Outcome]) -> Row:
    """One row of the table."""
    return {
        "law": name,
        "reaches the goal [%]": percent(run.arrives for run in runs),
        "touches [%]": percent(run.closest < TOUCH for run in runs),
        "nearer than 0.3 m [%]": percent(run.closest < REQUIRED for run in runs),
        "reaches without touching [%]": percent(run.arrives and run.closest >= TOUCH for run in runs),
        "reaches and keeps 0.3 m [%]": percent(run.arrives and run.closest >= REQUIRED for run in runs),
        "joint step over 1 rad [%]": percent(run.largest_step > JUMP for run in runs),
        "median largest step [rad]": float(np.median([run.largest_step for run in runs])),
    }


def count_point_scenes(count: int, seed: int) -> list[Row]:
    """The table of every law over `count` scenes with one point obstacle."""
    robot = bp.load_robot("example:planar4")
    kinematics = bp.Kinematics(robot)
    rng = np.random.default_rng(seed)
    laws = printed_laws(robot.joint_names)
    first, all_ways = "completed law, straight for the goal", "completed law, all attempts"
    runs: dict[str, list[Outcome]] = {name: [] for name in (*(law.name for law in laws), first, all_ways)}
    for _ in track(range(count), "point obstacle", transient=True, disable=not sys.stdout.isatty()):
        scene = random_point_scene(robot, kinematics, rng)
        for law in laws:
            runs[law.name].append(measure(kinematics, scene, iterate(kinematics, scene, law)))
        problem = build_problem(robot, as_scene(robot, scene))
        plan = bp.plan(robot, problem.scene, method="reactive")
        planned = np.asarray(plan.trajectory.q)
        straight = planned if plan.findings.way == "straight" else first_attempt(problem)[0].q
        runs[first].append(measure(kinematics, scene, straight))
        runs[all_ways].append(measure(kinematics, scene, planned))
    return [summary(name, found) for name, found in runs.items()]


def first_attempt(problem: Problem, *, null_space: bool = True) -> tuple[bp.Trajectory, bool]:
    """The completed law's first attempt, straight to the goal, and whether it arrives."""
    attempts = approach_goal(stepper_at_start(problem), problem.goals[0], [], work=Work(), null_space=null_space)
    attempt = next(iter(attempts))
    return attempt.stepper.trajectory(), attempt.arrived


def stepper_at_start(problem: Problem) -> Stepper:
    """A stepper at rest at the start."""
    assert problem.start_q is not None
    return Stepper(
        problem,
        problem.start_q,
        proximity=bp.Proximity(problem.robot, problem.obstacles),
        kinematics=bp.Kinematics(problem.robot),
    )


# --- several solid obstacles ----------------------------------------------------------


@dataclass(frozen=True)
class Terms:
    """The active null-space terms of the completed law."""

    name: str
    obstacle: bool
    directionality: bool


TERMS = (
    Terms("primary term and shield", obstacle=False, directionality=False),
    Terms("+ directionality term", obstacle=False, directionality=True),
    Terms("+ obstacle term", obstacle=True, directionality=False),
    Terms("+ both (gains: auto)", obstacle=True, directionality=True),
)


def drive(problem: Problem, terms: Terms, *, longest: float = 60.0) -> tuple[bool, float]:
    """Drive by the completed law with some of its terms, straight to the goal: (arrived, duration [s])."""
    stepper = stepper_at_start(problem)
    limits = problem.limits
    law = CompletedLaw(problem.robot, influence=problem.scene.influence, directionality=terms.directionality)
    best, since = np.inf, 0.0
    while stepper.time < longest:
        at, nearby = stepper.look()
        error, J = problem.goals[0].error(at)[:2], at.jacobian[:2]
        left = float(np.linalg.norm(error))
        if left < 2e-5 and stepper.stopped():
            stepper.stop()
            return True, stepper.time
        dq = np.abs(J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(2), error)) + 1e-9
        pace = min(float(np.min(limits.velocity / dq)), float(np.min(np.sqrt(1.2 * limits.acceleration / dq))), 4.0)
        acting = nearby if terms.obstacle else nearby.only(np.zeros(len(nearby), dtype=bool))
        wish = law.wish(at, J, pace * error, acting)
        v = wish.primary + min(1.0, left / 0.05) * wish.null
        v = v / max(1.0, float(np.max(np.abs(v) / limits.velocity)))
        if left < best - 0.002:
            best, since = left, stepper.time
        if not stepper.advance(v, nearby, at.jacobian[:3]) or stepper.time - since > 1.5:
            break
    return False, stepper.time


def count_solid_scenes(count: int, seed: int) -> list[Row]:
    """The table of the completed law's terms over `count` scenes with solid obstacles."""
    robot = bp.load_robot("example:planar4")
    rng = np.random.default_rng(seed)
    arrived: dict[str, list[bool]] = {terms.name: [] for terms in TERMS}
    durations: dict[str, list[float]] = {terms.name: [] for terms in TERMS}
    for _ in track(range(count), "solid obstacles", transient=True, disable=not sys.stdout.isatty()):
        problem = build_problem(robot, random_planar_scene(robot, rng))
        for terms in TERMS:
            done, duration = drive(problem, terms)
            arrived[terms.name].append(done)
            durations[terms.name].append(duration)
    table = np.array([arrived[terms.name] for terms in TERMS])
    alone, everywhere = table & (np.sum(table, axis=0) == 1), np.all(table, axis=0)
    return [
        {
            "completed law, first attempt": name,
            "arrives [%]": percent(arrived[name]),
            "only this one [scenes]": int(np.sum(only)),
            "mean duration where all arrive [s]": _mean(np.array(durations[name])[everywhere]),
        }
        for name, only in zip(arrived, alone, strict=True)
    ]


def _mean(values: Vector) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
