"""Plans with something to keep, followed among balls that fly past and into the machine.

Plans of planar4, backhoe and Panda between random configurations, which keep the direction of the last link, the pitch
of the bucket or a cup upright, are streamed through a servo. One to three balls fly in straight lines at 0.05 to 2 m/s,
about half of them towards a point of a link where the plan has it at some moment. None comes near the links that only
the first joint moves, as these cannot give way. Fast balls cannot all be evaded. Distances are those of `Proximity`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import count as numbers
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from validation.campaigns import Campaign
from validation.habitats import load_machine
from validation.obstacles import Record, sphere
from validation.placements import Followed, Immediate, places_on_machine

_DT = 0.02  # s
_RADII = {"planar4": (0.08, 0.25), "backhoe": (0.15, 0.4), "panda": (0.04, 0.1)}  # m
_SPREAD = {"planar4": 1.5, "backhoe": 2.5, "panda": 0.4}  # m: of the places that balls pass which do not aim
_SPEEDS = 0.05, 2.0  # m/s, equally often at every scale
_SLOW = 0.55  # m/s: balls that most machines can evade
_SPARE = 0.1  # m beyond its clearance that a ball keeps from the machine at the start, and from its base always
_TRIES = 40  # tasks that are drawn for one plan
_BROKEN = 1e-3  # rad or m by which a condition counts as broken
_SHORTEST = 1.5  # s of a plan
_MARGIN = 0.3  # m of margin within which balls are measured


class _Ball(NamedTuple):
    """A ball as an entry of a scene, with its speed [m/s], and its distances as it moves."""

    record: Record
    speed: float
    proximity: bp.Proximity


@dataclass(frozen=True)
class BallDrive:
    """The result of one drive.

    Attributes
    ----------
    machine: its name.
    duration: as planned [s].
    speeds, distances: of each ball: its speed [m/s], and the least distance, only exact within `_MARGIN` [m].
    clearance: to be kept [m].
    lost: by how much a condition was broken the most [rad or m].
    arrived: at the end of the plan.
    late: later than planned [s].
    too_close, unproven: steps with a lost clearance, and without a proof of their own.
    """

    machine: str
    duration: float
    speeds: list[float]
    distances: list[float]
    clearance: float
    lost: float
    arrived: bool
    late: float
    too_close: int
    unproven: int

    @property
    def touched(self) -> list[float]:
        """The speeds of the balls that were touched [m/s]."""
        return [speed for speed, distance in zip(self.speeds, self.distances, strict=True) if distance < 0.0]


def follow_among_balls(
    *, count: int, seed: int, jobs: int, folder: Path | None, watch: Callable[[int, BallDrive], object]
) -> Followed[BallDrive]:
    """Follow `count` plans among balls; see `Campaign`."""
    with Campaign(partial(drive_among_balls, seed=seed), list[BallDrive], jobs=jobs, folder=folder) as campaign:
        drives = campaign.first(numbers(1), count, most=1, watch=watch)
    return Followed(drives, figures_of(drives) if drives else {}, campaign.interrupted)


def drive_among_balls(number: int, *, seed: int) -> list[BallDrive]:
    """The drive of a number; none if no plan was found."""
    machine = ("planar4", "backhoe", "panda")[number % 3]
    rng = np.random.default_rng([seed, number])
    plan = _random_plan(machine, rng, seed)
    if plan is None:
        return []
    balls = [_random_ball(machine, plan, rng) for _ in range(1 + number // 3 % 3)]
    keep = plan.problem.keep
    assert keep is not None
    servo = bp.Servo(plan.robot, plan.scene, _DT, q=plan.trajectory.q[0])
    for index, ball in enumerate(balls):
        servo.add({**ball.record, "name": f"ball {index}"})
    distances, lost, too_close, unproven = np.full(len(balls), np.inf), 0.0, 0, 0
    with bp.PlanFollower(servo, plan, executor=Immediate()) as follower:
        for step in range(int((4.0 * plan.trajectory.duration + 10.0) / _DT)):
            told = follower.step()
            state = told.state
            if state.margin < _MARGIN:
                now = [float(ball.proximity.distances(state.q, time=(step + 1) * _DT).min()) for ball in balls]
                distances = np.minimum(distances, now)
            lost = max(lost, -float(keep.margins(state.q).min()))
            too_close += state.status.value == "too_close"
            unproven += not state.proven
            if told.done:
                break
    return [
        BallDrive(
            machine=machine,
            duration=plan.trajectory.duration,
            speeds=[ball.speed for ball in balls],
            distances=distances.tolist(),
            clearance=plan.scene.clearance,
            lost=lost,
            arrived=told.done,
            late=told.behind,
            too_close=too_close,
            unproven=unproven,
        )
    ]


def _random_plan(machine: str, rng: np.random.Generator, seed: int) -> bp.Plan | None:
    robot = load_machine(machine) if machine != "panda" else bp.load_robot("example:panda", tip="panda_hand_tcp")
    for _ in range(_TRIES):
        content = _cup_task(rng) if machine == "panda" else _level_task(machine, robot, rng)
        try:
            plan = bp.plan(robot, bp.scene_from_dict({"version": 1, **content}), effort="quick", seed=seed)
        except bp.InputError:  # an end in a collision with itself, or out of reach
            continue
        if plan.verified and plan.trajectory.duration > _SHORTEST:
            return plan
    return None


def _cup_task(rng: np.random.Generator) -> Record:
    """A cup that is kept upright, in half of the cases with gentle accelerations."""

    def place() -> list[float]:
        angle, away = rng.uniform(-1.5, 1.5), rng.uniform(0.35, 0.65)
        return [float(away * math.cos(angle)), float(away * math.sin(angle)), float(rng.uniform(0.15, 0.6))]

    content: Record = {
        "tip": "panda_hand_tcp",
        "start": {"tip": {"position": place(), "rpy": [math.pi, 0.0, float(rng.uniform(-1.0, 1.0))]}},
        "task": {"goal": {"position": place()}, "keep": {"tilt": {"axis": [0, 0, -1], "tolerance": 0.1}}},
        "clearance": 0.03,
    }
    if rng.random() < 0.5:
        slow = {f"panda_joint{number}": 0.5 if number < 5 else 1.0 for number in range(1, 8)}
        content["limits"] = {"acceleration": slow}
    return content


def _level_task(machine: str, robot: bp.Robot, rng: np.random.Generator) -> Record:
    """A motion between two configurations in which the last link has the same direction in the arm's plane."""
    pitch = float(rng.uniform(-3.2, -2.2) if machine == "backhoe" else rng.uniform(-1.5, 1.5))
    keep: Record = {"pitch": [pitch - 0.1, pitch + 0.1]}
    if machine == "planar4":
        direction = [math.cos(pitch), math.sin(pitch), 0.0]
        keep = {"tilt": {"axis": [1, 0, 0], "direction": direction, "tolerance": 0.1}}

    def joints() -> dict[str, float]:
        while True:
            q = robot.random_q(rng)
            if machine == "backhoe":
                q[1:3] = rng.uniform(-0.2, 0.7), rng.uniform(-2.0, -0.5)
            q[3] = pitch - float(q[1:3].sum() if machine == "backhoe" else q[:3].sum())
            if ((q >= robot.limits.lower) & (q <= robot.limits.upper)).all():
                return dict(zip(robot.joint_names, q.tolist(), strict=True))

    return {"start": {"joints": joints()}, "task": {"goal": {"joints": joints()}, "keep": keep}, "clearance": 0.05}


def _random_ball(machine: str, plan: bp.Plan, rng: np.random.Generator) -> _Ball:
    """A ball that is clear of the machine at the start of the plan, and of its base for as long as a drive takes."""
    robot, motion, flat = plan.robot, plan.trajectory, machine == "planar4"
    clear = plan.scene.clearance + _SPARE
    while True:
        speed = float(np.exp(rng.uniform(*np.log(_SPEEDS))))
        way = rng.normal(size=3) * [1.0, 1.0, 0.0 if flat else 1.0]
        velocity, when = speed * way / np.linalg.norm(way), float(rng.uniform(0.3, 1.2)) * motion.duration
        aim: Vector = rng.normal(size=3) * _SPREAD[machine] * [1.0, 1.0, 0.0 if flat else 1.0]
        if rng.random() < 0.5:
            (aim,) = places_on_machine(robot, motion.at(min(when, motion.duration))[None], rng)
        record = {**sphere(rng.uniform(*_RADII[machine]), aim - when * velocity), "velocity": velocity.tolist()}
        content: Record = {"version": 1, "start": {"joints": {}}, "task": {"goal": {"position": [1, 0, 0]}}}
        scene = bp.scene_from_dict(
            content | {"clearance": plan.scene.clearance, "obstacles": [record | {"name": "ball"}]}
        )
        proximity = bp.Proximity(robot, bp.build_obstacles(scene, robot), self_collision=False)
        if proximity.distances(motion.q[0]).min() < clear:
            continue
        base = ~proximity.moves[:, 1:].any(axis=1)
        times = np.arange(0.0, 6.0 * motion.duration + 10.0, 0.05).tolist()
        near = min(float(proximity.distances(motion.q[0], time=time)[base].min(initial=clear)) for time in times)
        if near >= clear:
            return _Ball(record, speed, proximity)


def figures_of(drives: list[BallDrive]) -> dict[str, Any]:
    """The figures of some drives."""
    late = [drive.late for drive in drives]
    return {
        "drives": len(drives),
        "not arrived in time": sum(not drive.arrived for drive in drives),
        "touched": sum(bool(drive.touched) for drive in drives),
        f"touched, by a ball slower than {_SLOW:g} m/s": sum(
            min(drive.touched, default=9.0) < _SLOW for drive in drives
        ),
        "depth of all touches [m]": sum(max(-min(drive.distances), 0.0) for drive in drives),
        "missing to clearances [m]": sum(max(drive.clearance - min(drive.distances), 0.0) for drive in drives),
        "broke what is kept": sum(drive.lost > _BROKEN for drive in drives),
        "by how much in all [rad or m]": sum(drive.lost for drive in drives),
        "steps too close": sum(drive.too_close for drive in drives),
        "steps unproven": sum(drive.unproven for drive in drives),
        "later than planned [s], median, p90": [float(np.quantile(late, part)) for part in (0.5, 0.9)],
    }
