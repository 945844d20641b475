"""A servo that starts from rest inside obstacles, inside itself, outside a limit, or both.

`Proximity` checks every step. If the servo does not get out, `another_way` searches for a way out
without code of the servo's own search.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linprog

import backhoe_planner as bp
from backhoe_planner.arrays import Vector
from backhoe_planner.site import build_obstacle
from validation.campaigns import call_for_all
from validation.habitats import load_machine
from validation.obstacles import name_all
from validation.scenes import scene_of
from validation.servo_drives import CLEARANCE, plain_obstacle

_KINDS = ("obstacle", "obstacle", "obstacle", "several obstacles", "itself", "limit", "limit and obstacle")
_RESTS = 9000  # steps, more than until the servo searches again
_LONGEST = 30.0  # s for one recovery
_WRONG = ("grew", "did not shrink", "not nearer", "deeper than at the start", "further outside")


class Start:
    """A configuration that violates a clearance, a joint limit, or both."""

    def __init__(self, robot: bp.Robot, rng: np.random.Generator, number: int) -> None:
        self.robot = robot
        self.kind = _KINDS[number % len(_KINDS)]
        alone = bp.Proximity(robot)
        while True:
            q = robot.random_q(rng)
            if "limit" in self.kind:
                joint, outside = int(rng.integers(robot.n)), float(rng.uniform(0.02, 0.15))
                up = rng.integers(2)
                q[joint] = robot.limits.upper[joint] + outside if up else robot.limits.lower[joint] - outside
            least = float(np.min(alone.distances(q)))
            if not (-0.2 < least < -0.02 if "itself" in self.kind else least >= 0.02):
                continue
            count = 0 if "obstacle" not in self.kind else int(rng.integers(1, 4)) if "several" in self.kind else 1
            obstacles = name_all([plain_obstacle(rng) for _ in range(count)])
            # a scene's start is within the limits; the servo then gets the real configuration as `q`
            within = robot.random_q(rng) if "limit" in self.kind else q
            self.q, self.scene = q, scene_of(robot, obstacles, start=within, clearance=CLEARANCE)
            self.proximity = bp.Proximity(
                robot, [build_obstacle(spec, folder=Path(), clearance=CLEARANCE) for spec in self.scene.obstacles]
            )
            self.deepest = self.depths(q)
            if not count or 0.02 < float(np.max(self.deepest[1:])) < 0.3:
                return

    def depths(self, q: Vector) -> Vector:
        """(1 + obstacles,) the deepest violation within the machine and with every obstacle [m]."""
        depth = self.proximity.clearance - self.proximity.distances(q)
        owner = self.proximity.owner
        found = [float(np.max(depth[owner == k], initial=0.0)) for k in range(-1, len(self.scene.obstacles))]
        return np.array(found)

    def outside(self, q: Vector) -> Vector:
        """(n,) the violation of every joint's limits [rad]."""
        limits = self.robot.limits
        return np.maximum(np.maximum(q - limits.upper, limits.lower - q), 0.0)


@dataclass(frozen=True)
class Recovery:
    """The result of one recovery.

    Attributes
    ----------
    out: whether nothing is violated any more.
    time: of the servo [s].
    counts: steps of each kind; those of `_WRONG` should be 0.
    q: (n,) the last configuration.
    left: (1 + obstacles,) the violations there [m].
    slowest: the longest processor time of a step [s].
    """

    out: bool
    time: float
    counts: Counter[str]
    q: Vector
    left: Vector
    slowest: float


def come_back(start: Start, wish: dict[str, Any]) -> Recovery:
    """Let the servo recover, and judge every step by `Proximity`.

    At every step, the deepest violation of every obstacle, of the machine itself and of
    every limit must fall, and a violation that is gone must stay gone. On a route that the
    servo says leads past places no shallower, the remaining length must fall instead, and
    nothing may be deeper than at the start.
    """
    servo = bp.Servo(start.robot, start.scene, q=start.q)
    before, before_out = start.depths(start.q), start.outside(start.q)
    to_go, resting, counts, slowest = None, 0, Counter[str](), 0.0
    done = False
    for _ in range(round(_LONGEST / servo.dt)):
        begun = time.process_time()
        state = servo.step(**wish)
        slowest = max(slowest, time.process_time() - begun)
        now, out = start.depths(state.q), start.outside(state.q)
        rests = bool(np.all(np.abs(state.v) < 1e-9))
        resting = resting + 1 if rests else 0
        if servo.way_to_go is not None:
            counts["steps on a way below"] += 1
            counts["deeper than at the start"] += bool((now > np.maximum(start.deepest, 1e-6) + 1e-7).any())
            counts["not nearer"] += to_go is not None and not rests and servo.way_to_go >= to_go
        else:
            counts["grew"] += bool((now > np.maximum(before, 1e-6) + 1e-9).any())
            counts["did not shrink"] += bool(((now >= before) & (before > 1e-6)).any()) and not rests
        counts["further outside"] += bool((out > before_out + 1e-9).any())
        to_go, before, before_out = servo.way_to_go, now, out
        done = bool((now <= 1e-6).all() and (out <= 1e-6).all())
        if done or resting > _RESTS:
            break
    return Recovery(done, servo.time, counts, state.q, before, slowest)


# --- another way out ---------------------------------------------------------------------


def _depth_after_descent(start: Start, q: Vector) -> float:
    """The depth that remains after a descent by linear programmes over the gradients of `Proximity` [m].

    No dynamics, no braking: every step makes the deepest violation smaller.
    """
    robot, proximity = start.robot, start.proximity
    nearby, trust = proximity.at(q, margin=0.3), 0.02
    deepest = float(-np.min(nearby.margin))
    for _ in range(400):
        if deepest <= 0.0 or trust < 1e-5:
            break
        inside = nearby.margin < 0.0
        low, high = np.maximum(-trust, robot.limits.lower - q), np.minimum(trust, robot.limits.upper - q)
        solved = linprog(
            [0.0] * robot.n + [-1.0],
            A_ub=np.column_stack((-nearby.gradient, inside.astype(float))),
            b_ub=nearby.margin + np.where(inside, deepest, 0.0),
            bounds=[*zip(low, high, strict=True), (0.0, None)],
        )
        if solved.status != 0 or solved.x[-1] < 1e-7:
            break
        tried = q + solved.x[:-1]
        there = proximity.at(tried, margin=0.3)
        now = float(-np.min(there.margin)) if len(there) else -0.3
        if now < deepest:
            q, nearby, deepest, trust = tried, there, now, min(1.5 * trust, 0.02)
        else:
            trust *= 0.5
    return deepest


def another_way(start: Start, q: Vector, rng: np.random.Generator) -> str | None:
    """The kind of search that finds a way out never deeper than the start; None if none does.

    Descents by linear programmes from 20 configurations around; straight lines to 2000 clear
    configurations; and a tree of 3000 configurations grown from the start.
    """
    robot, limits, ceiling = start.robot, start.robot.limits, np.maximum(start.deepest, 0.0) + 1e-7
    low, high = np.minimum(limits.lower, start.q), np.maximum(limits.upper, start.q)

    def allowed(at: Vector) -> bool:
        return bool((start.depths(at) <= ceiling).all())

    def line(a: Vector, b: Vector) -> bool:
        count = max(int(np.max(np.abs(b - a)) / 0.02), 1)
        return all(allowed(a + part / count * (b - a)) for part in range(1, count + 1))

    for origin in () if start.outside(start.q).any() else (start.q, q):  # descents ignore limits
        if _depth_after_descent(start, origin) <= 0.0:
            return "descent"
        for _ in range(10):
            near = np.clip(origin + rng.normal(size=robot.n) * 0.05, low, high)
            if allowed(near) and _depth_after_descent(start, near) <= 0.0:
                return "descent from near by"
    clear = [at for at in (robot.random_q(rng) for _ in range(2000)) if np.all(start.depths(at) <= 0.0)]
    if not clear:
        return None
    if any(line(start.q, goal) for goal in clear):
        return "straight line"
    nodes = [start.q]
    for _ in range(3000):
        aim = rng.uniform(low, high)
        nearest = min(nodes, key=lambda at: float(np.sum((at - aim) ** 2)))
        tried = nearest + (aim - nearest) * min(1.0, 0.1 / float(np.max(np.abs(aim - nearest))))
        if line(nearest, tried):
            if np.all(start.depths(tried) <= 0.0):
                return "tree"
            nodes.append(tried)
    return None


@dataclass(frozen=True)
class RecoveryRecord:
    """The result of one recovery in short.

    Attributes
    ----------
    ending: the kind of the start and of the ending.
    note: what needs attention; empty if nothing does.
    way_out: [s], of the servo; 0 if it did not get out.
    slowest: the longest processor time of a step [s].
    """

    ending: str
    note: str
    way_out: float
    slowest: float


def recover(
    *, count: int, seed: int, jobs: int, folder: Path | None, watch: Callable[[int, RecoveryRecord], object]
) -> tuple[dict[str, Any], bool]:
    """The results of recoveries from a number of starts, and whether they were interrupted; see `Campaign`."""
    found, interrupted = call_for_all(
        partial(recover_from, seed=seed), range(count), result=RecoveryRecord, jobs=jobs, folder=folder, watch=watch
    )
    return {
        "starts": len(found),
        **dict(sorted(Counter(one.ending for one in found).items())),
        "longest way out [s]": max((one.way_out for one in found), default=0.0),
        "slowest step [ms]": 1e3 * max((one.slowest for one in found), default=0.0),
        "notes": [one.note for one in found if one.note],
    }, interrupted


def recover_from(number: int, *, seed: int) -> RecoveryRecord:
    """Let a servo recover from a start, by its number, with a random wish."""
    robot = load_machine("backhoe")
    rng = np.random.default_rng([seed, number, 7])
    start = Start(robot, rng, number)
    tip = {"tip_velocity": rng.normal(size=3)}
    found = come_back(start, tip if rng.integers(2) else {"joint_velocity": rng.uniform(-1, 1, robot.n)})
    ending = start.kind
    notes: list[str] = []
    if found.out:
        ending += ": out, on a way below" if found.counts["steps on a way below"] else ": out"
    else:
        ending += f": not out, another way: {another_way(start, found.q, rng)}"
        notes.append(ending)
    wrong = {key: found.counts[key] for key in _WRONG if found.counts[key]}
    if wrong:
        notes.append(f"wrong steps: {wrong}")
        ending += ", with wrong steps"
    if notes:
        depths = f"from {np.round(start.deepest, 4)} m to {np.round(found.left, 4)} m"
        notes = [f"case {number}, {start.kind}: {depths}", *notes]
    return RecoveryRecord(ending, ", ".join(notes), found.time if found.out else 0.0, found.slowest)
