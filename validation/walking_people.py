"""The servo among walking people: the time and work of its steps, and its contacts.

Some capsules of a person's size walk to and fro at a walking pace, most of them through the
machine, which is driven by wishes that jump. Other obstacles stand still. People who walk into
the machine cannot all be evaded; obstacles that stand still must never be touched.

A drive is the same at every repetition, and the shortest processor time of each step counts:
the additions by other processes, interrupts or a cold cache are not there each time.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.live import StepWork
from validation.step_times import collecting_only_new
from validation.tables import Row

_PEOPLE, _STANDING = 3, 4
_RADIUS = 0.25  # m
_MISSES = 0.3  # m from the point of the machine that a person walks to
_PACE = (0.2, 0.6)  # m/s, slow enough for people among machines
_TURNS_AFTER = 2400  # steps until a person turns: to the machine, back, and again
_WISHES_FOR = 300  # steps


class Walk(NamedTuple):
    """A drive among walking people.

    Attributes
    ----------
    times: (N,) of every step, the shortest over all repetitions [ms].
    once: (N,) of the first drive alone [ms].
    work: (N, 5) of every step, in the order of `StepWork`.
    evading: part of the steps in which the machine evaded a person.
    least: the least distance to standing obstacles, by `Proximity` every 10 steps [m].
    unproven: steps on the previous braking path.
    """

    times: NDArray[np.float64]
    once: NDArray[np.float64]
    work: NDArray[np.int64]
    evading: float
    least: float
    unproven: int


def walk_through(
    robot: bp.Robot, q: Vector, *, clearance: float, steps: int, seed: int, repetitions: int = 3, walkers: int = _PEOPLE
) -> Walk:
    """Drive a machine from q (n,), which must be clear, among people who walk through it."""
    rng = np.random.default_rng(seed)
    standing = _standing(robot, q, clearance, rng)
    drives = [
        _drive(robot, q, standing, clearance, steps, np.random.default_rng([seed, 1]), walkers, check=number == 0)
        for number in range(repetitions)
    ]
    first = drives[0]
    return first._replace(times=np.min([drive.times for drive in drives], axis=0))


def as_row(name: str, clearance: float, walk: Walk) -> Row:
    """One line of the table."""
    most = StepWork(*walk.work.max(axis=0).tolist())
    return {
        "machine": name,
        "clearance [m]": clearance,
        "median [ms]": float(np.median(walk.times)),
        "p99 [ms]": float(np.percentile(walk.times, 99)),
        "worst [ms]": float(walk.times.max()),
        "p99 once [ms]": float(np.percentile(walk.once, 99)),
        "worst once [ms]": float(walk.once.max()),
        "rows": most.rows,
        "iterations": most.iterations,
        "paths": most.paths,
        "distances": most.distances,
        "evading [%]": 100.0 * walk.evading,
        "unproven": walk.unproven,
        "least to what stands [m]": walk.least,
    }


def _scene(robot: bp.Robot, q: Vector, clearance: float, obstacles: list[dict[str, Any]]) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))},
            "task": {"goal": {"position": [1.0, 0.0, 0.5]}},
            "clearance": clearance,
            "obstacles": obstacles,
        }
    )


def _reach(robot: bp.Robot, q: Vector) -> float:
    """The approximate reach of the machine from its base [m]."""
    tip = bp.Kinematics(robot).at(q).tip_position
    return float(np.linalg.norm(tip[:2]))


def _standing(robot: bp.Robot, q: Vector, clearance: float, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Posts and boxes around the machine that are clear of it at q (n,)."""
    reach = _reach(robot, q)
    found: list[dict[str, Any]] = []
    while len(found) < _STANDING:
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 1.6) * reach + clearance
        size = rng.uniform(0.05, 0.15) * reach
        x, y, height = away * np.cos(angle), away * np.sin(angle), rng.uniform(0.5, 2.0)
        name = f"post {len(found)}"
        post: dict[str, Any] = {
            "name": name, "shape": "capsule", "radius": size, "from": [x, y, 0.0], "to": [x, y, height],
        }  # fmt: skip
        scene = _scene(robot, q, clearance, [post])
        if bp.Proximity(robot, bp.build_obstacles(scene, robot), self_collision=False).distances(q).min() > clearance:
            found.append(post)
    return found


def _place(robot: bp.Robot, q: Vector, clearance: float, rng: np.random.Generator) -> Vector:
    """(2,) the place of a person a step or two from the machine at q (n,)."""
    points = bp.Kinematics(robot).at(q).points
    while True:
        angle, away = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 2.0) + _RADIUS + clearance
        place = points[rng.integers(len(points)), :2] + away * np.array([np.cos(angle), np.sin(angle)])
        x, y = place.tolist()
        record = {"name": "one", "shape": "capsule", "radius": _RADIUS, "from": [x, y, 0.25], "to": [x, y, 1.6]}
        scene = _scene(robot, q, clearance, [record])
        alone = bp.Proximity(robot, bp.build_obstacles(scene, robot), self_collision=False)
        if 0.2 < alone.distances(q).min() - clearance < 1.0:
            return np.asarray(place)


def _drive(
    robot: bp.Robot,
    q: Vector,
    standing: list[dict[str, Any]],
    clearance: float,
    steps: int,
    rng: np.random.Generator,
    walkers: int,
    *,
    check: bool,
) -> Walk:
    scene = _scene(robot, q, clearance, standing)
    servo = bp.Servo(robot, scene)
    proximity = bp.Proximity(robot, bp.build_obstacles(scene, robot), self_collision=False)
    people = {f"person {number}": _place(robot, q, clearance, rng) for number in range(walkers)}
    for name, (x, y) in people.items():
        servo.add({"name": name, "shape": "capsule", "radius": _RADIUS, "from": [x, y, 0.25], "to": [x, y, 1.6]})
    comes = dict.fromkeys(people, False)
    kinematics = bp.Kinematics(robot)
    times: NDArray[np.float64] = np.zeros(steps)
    work: NDArray[np.int64] = np.zeros((steps, len(StepWork._fields)), dtype=np.int64)
    wish: dict[str, Any] = {}
    evading, unproven, least = 0, 0, np.inf
    with collecting_only_new():
        for step in range(steps):
            if step % _WISHES_FOR == 0:
                direction = rng.normal(size=3)
                wish = {"tip_velocity": 0.2 * direction / np.linalg.norm(direction)}
                if rng.integers(3) == 0:
                    wish = {"joint_velocity": 0.5 * rng.uniform(-1.0, 1.0, robot.n) * servo.limits.velocity}
            for number, (name, foot) in enumerate(people.items()):
                if step == 0 or (step + number * _TURNS_AFTER // walkers) % _TURNS_AFTER == 0:
                    comes[name] = not comes[name]
                    here = foot + servo.shift_of(name)[:2]
                    points = kinematics.at(servo.q).points
                    way = points[rng.integers(len(points)), :2] + rng.normal(size=2) * _MISSES - here
                    way *= (1.0 if comes[name] else -1.0) / np.linalg.norm(way)
                    servo.set_velocity(name, [*(rng.uniform(*_PACE) * way), 0.0])
            begun = time.thread_time_ns()
            state = servo.step(**wish)
            times[step] = (time.thread_time_ns() - begun) * 1e-6
            work[step] = servo.work
            unproven += not state.proven
            evading += state.status is bp.Status.EVADING
            if check and step % 10 == 0:
                least = min(least, float(proximity.distances(state.q).min()))
    if servo.last_error is not None:
        raise servo.last_error
    return Walk(times, times, work, evading / steps, least, unproven)
