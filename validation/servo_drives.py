"""A servo driven by wishes that jump, push and run into limits, with an independent check of its steps.

The backhoe is driven among obstacles that stand still, obstacles that appear where the machine
can still stop, and obstacles that approach no faster than it can evade: a linear programme
over the joint rates gives that speed, of which `EVADED_PART` is used.
Distances are those of `surfaces`, without coal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import linprog

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.site import build_obstacle
from backhoe_planner.site.schema import obstacle_shapes
from validation.campaigns import call_for_all
from validation.habitats import load_machine
from validation.obstacles import Record, halfspace, random_obstacle
from validation.scenes import scene_of
from validation.signed_distances import SignedDistance, obstacle_distance
from validation.surfaces import LinkDistances, Nearest

CLEARANCE = 0.05  # m, of every scene
EVADED_PART = 0.5  # of the speed at which the machine can evade
EPISODE = 4000  # steps on one site
CLOSE = 0.004  # m of margin below which every step is checked
_SPARE = 0.02  # m beyond the machine's clearance from a new obstacle


def plain_obstacle(rng: np.random.Generator) -> Record:
    """A random obstacle for the backhoe with the scene's clearance; in a tenth of the cases deep ground."""
    if rng.random() < 0.1:
        return halfspace([0.0, 0.0, rng.uniform(-4.5, -1.0)], [0.0, 0.0, 1.0])
    record = random_obstacle("backhoe", rng)
    record.pop("clearance", None)
    return record


def free_posture(robot: bp.Robot, rng: np.random.Generator) -> Vector:
    """(n,) a random configuration whose links keep 2 cm from each other."""
    alone = bp.Proximity(robot)
    while np.min(alone.distances(q := robot.random_q(rng))) < 0.02:
        pass
    return q


@dataclass
class _Standing:
    """An obstacle on the site, its distance function and its displacement (3,) [m]."""

    spec: obstacle_shapes.ObstacleSpec
    distance: SignedDistance
    shift: Vector = field(default_factory=lambda: np.zeros(3))
    moves: bool = False
    velocity: Vector = field(default_factory=lambda: np.zeros(3))

    @property
    def place(self) -> Vector:
        """(3,) its approximate place; 4 m in front of the machine if its shape has none."""
        place = getattr(self.spec, "position", getattr(self.spec, "start", (4.0, 0.0, 0.0)))
        return np.array(place) + self.shift


class Episode:
    """One site, and the events on it."""

    def __init__(self, robot: bp.Robot, distances: LinkDistances, rng: np.random.Generator) -> None:
        self.robot, self.distances, self.rng = robot, distances, rng
        self._data = robot.model.createData()
        q = free_posture(robot, rng)
        self.standing: dict[str, _Standing] = {}
        wanted = int(rng.integers(4, 21))
        while len(self.standing) < wanted:
            self._put_up(f"obstacle {len(self.standing)}", q[None])
        # records, so that the servo reads the same input as from a user
        scene = scene_of(robot, self._records, start=q, clearance=CLEARANCE)
        self.servo = bp.Servo(robot, scene, circulate=bool(rng.integers(2)))
        self.kind = "none"
        self._tip = bp.Kinematics(robot).at(q).tip_position.copy()
        self._tip_velocity = np.zeros(3)
        self._joint_velocity = np.zeros(robot.n)

    def _put_up(self, name: str, postures: Vector) -> _Standing | None:
        """Draw an obstacle that is clear of the machine in all configurations (W, n); None if the drawn one is not."""
        record = {"name": name, **plain_obstacle(self.rng)}
        scene = scene_of(self.robot, [record], start=postures[0], clearance=CLEARANCE)
        new = _Standing(scene.obstacles[0], obstacle_distance(scene.obstacles[0], scene))
        alone = {name: (new.distance, new.shift)}
        if any(self.distances.least(q, alone).distance <= CLEARANCE + _SPARE for q in postures):
            return None
        self.standing[name] = new
        return new

    @property
    def _records(self) -> list[Record]:
        return [one.spec.model_dump(by_alias=True, exclude_none=True) for one in self.standing.values()]

    # --- events ------------------------------------------------------------------

    def step(self, number: int) -> bp.ServoState:
        """The servo's next step, after the events that are due."""
        if number % int(self.rng.integers(1, 400)) == 0:
            self._change_wish()
        if number % 500 == 250:
            self._appear(f"new {number}")
        if number % 20 == 0:
            self._drive_movers()
        state = self.servo.step(**self._wish())
        self._tip = state.tip_position
        for name, one in self.standing.items():
            if one.moves:
                one.shift = self.servo.shift_of(name)
        return state

    def nearest(self, q: Vector) -> Nearest:
        """The obstacle nearest to the machine at `q` (n,), without coal."""
        return self.distances.least(q, {name: (one.distance, one.shift) for name, one in self.standing.items()})

    def _change_wish(self) -> None:
        rng, limit = self.rng, self.servo.limits.velocity
        self.kind = str(rng.choice(["tip", "joints", "push", "limit", "stretch", "zero", "jump"]))
        direction = rng.normal(size=3)
        self._tip_velocity = direction * rng.uniform(0.1, 3.0) / np.linalg.norm(direction)
        self._joint_velocity = rng.uniform(-1.5, 1.5, self.robot.n) * limit
        if self.kind == "limit":
            self._joint_velocity = np.sign(rng.normal(size=self.robot.n)) * limit * 2.0

    def _wish(self) -> dict[str, Any]:
        if self.kind in ("joints", "limit"):
            return {"joint_velocity": self._joint_velocity}
        velocity = self._tip_velocity
        if self.kind == "zero":
            velocity = np.zeros(3)
        elif self.kind == "jump":
            velocity = self.rng.normal(size=3) * 2.0
        elif self.kind == "push":
            ways = [one.place - self._tip for one in self.standing.values()]
            way = min(ways, key=lambda way: float(np.linalg.norm(way)))
            velocity = 1.5 * way / max(float(np.linalg.norm(way)), 1e-6)
        elif self.kind == "stretch":
            velocity = self._tip / np.linalg.norm(self._tip)
        return {"tip_velocity": velocity}

    def _appear(self, name: str) -> None:
        """Put an obstacle where the machine can still stop before it, if one fits."""
        new = self._put_up(name, stopping_line(self.servo))
        if new is not None:
            self.servo.add(build_obstacle(new.spec, folder=Path(), clearance=CLEARANCE))
            new.moves = bool(self.rng.integers(2)) and new.spec.shape != "halfspace"

    def _drive_movers(self) -> None:
        """Move obstacles towards the machine, no faster than it can evade."""
        movers = {name: one for name, one in self.standing.items() if one.moves}
        if not movers:
            return
        speed = EVADED_PART * self._evasion_speed(set(movers))
        for name, one in movers.items():
            if self.rng.random() < 0.05 or not one.velocity.any():
                pin.forwardKinematics(self.robot.model, self._data, self.servo.q)
                joint = int(self.rng.integers(2, self.robot.model.njoints))
                way = self._data.oMi[joint].translation - one.place + self.rng.normal(size=3) * 0.5
                one.velocity = way / max(float(np.linalg.norm(way)), 1e-6) * self.rng.uniform(0.05, 0.3)
            size = float(np.linalg.norm(one.velocity))
            self.servo.set_velocity(name, one.velocity * min(1.0, speed / size))

    def _evasion_speed(self, movers: set[str]) -> float:
        """The speed at which every mover nearby can be evaded at once, at most 1 [m/s].

        The greatest s for which joint rates within the limits let no margin to a standing
        obstacle fall faster than it would last for half a second, and every margin to a
        moving one grow by s (with 10 cm of it in reserve).
        """
        servo, limits, n = self.servo, self.servo.limits, self.robot.n
        # an obstacle with the velocity `shift` is displaced by it after one second
        shifted = [one.spec.model_copy(update={"velocity": tuple(one.shift)}) for one in self.standing.values()]
        obstacles = [build_obstacle(spec, folder=Path(), clearance=CLEARANCE) for spec in shifted]
        proximity = bp.Proximity(self.robot, obstacles)
        nearby = proximity.at(servo.q, time=1.0, margin=0.5)
        names = list(self.standing)
        owner = proximity.owner[nearby.pair]
        comes = np.array([index >= 0 and names[index] in movers for index in owner], dtype=bool)
        if not comes.any():
            return 1.0
        reserve = np.where(comes, np.maximum(nearby.margin - 0.1, 0.0), 2.0 * np.maximum(nearby.margin - 0.01, 0.0))
        high = np.maximum(np.minimum(limits.velocity, limits.upper - servo.q), 0.0)
        low = np.minimum(-np.minimum(limits.velocity, servo.q - limits.lower), 0.0)
        solved = linprog(
            [0.0] * n + [-1.0],
            A_ub=np.column_stack((-nearby.gradient, comes.astype(float))),
            b_ub=reserve,
            bounds=[*zip(low, high, strict=True), (0.0, 1.0)],
        )
        return float(solved.x[-1]) if solved.status == 0 else 0.0


@dataclass(frozen=True)
class DriveRecord:
    """The results of one site.

    Attributes
    ----------
    steps: of the drive.
    checked: those of them at which distances were measured without coal.
    counts, statuses: steps of each kind, and with each status of the servo.
    least: the least measured distance.
    problems: broken limits and contacts.
    """

    steps: int
    checked: int
    counts: dict[str, int]
    statuses: dict[str, int]
    least: Nearest
    problems: list[str]


def drive(
    *,
    steps: int,
    seed: int,
    every: int,
    jobs: int,
    folder: Path | None,
    watch: Callable[[int, DriveRecord], object],
) -> tuple[dict[str, Any], bool]:
    """Drive for a number of steps, site after site; return the problems and whether the run was interrupted.

    Parameters
    ----------
    every: steps between checks of distances, which are also checked if the servo's own
        margin is below `CLOSE`; limits, accelerations and finiteness at every step.
    jobs, folder, watch: see `Campaign`.
    """
    lengths = [min(EPISODE, steps - done) for done in range(0, steps, EPISODE)]
    call = partial(drive_on_site, seed=seed, every=every)
    found, interrupted = call_for_all(
        call, list(enumerate(lengths)), result=DriveRecord, jobs=jobs, folder=folder, watch=watch
    )
    counts, statuses = Counter[str](), Counter[str]()
    for one in found:
        counts.update(one.counts)
        statuses.update(one.statuses)
    least = min((one.least for one in found), key=lambda one: one.distance, default=Nearest(np.inf, "", ""))
    problems = [problem for one in found for problem in one.problems]
    return {
        "steps": sum(one.steps for one in found),
        "episodes": len(found),
        "checked without coal": sum(one.checked for one in found),
        "counts": dict(counts),
        "statuses": dict(statuses),
        "least distance": [float(least.distance), least.link, least.obstacle],
        "problems": len(problems),
        "first problems": problems[:20],
    }, interrupted


def drive_on_site(case: tuple[int, int], *, seed: int, every: int) -> DriveRecord:
    """Drive on one site, given its number and the number of steps."""
    number, length = case
    robot = load_machine("backhoe")
    episode = Episode(robot, LinkDistances(robot), np.random.default_rng([seed, number]))
    counts, statuses = Counter[str](), Counter[str]()
    problems: list[str] = []
    least, checked, before = Nearest(np.inf, "", ""), 0, np.zeros(robot.n)
    for step in range(length):
        state = episode.step(step)
        statuses[state.status.value] += 1
        counts["unproven"] += not state.proven
        where = f"episode {number}, step {step}, {episode.kind}"
        problems += [f"{problem}: {where}" for problem in broken_limits(episode.servo, state, before)]
        before = state.v
        if step % every == 0 or state.margin < CLOSE:
            checked += 1
            found = episode.nearest(state.q)
            least = min(least, found, key=lambda one: one.distance)
            if found.distance < 0.0:
                moves = episode.standing[found.obstacle].moves
                problems.append(
                    f"contact: {where}: {found.link} with {found.obstacle}, {found.distance:.5f} m, moving: {moves}"
                )
            elif found.distance < CLEARANCE - 1e-4:
                moving = any(one.moves for one in episode.standing.values())
                counts[f"clearance cut, {'something moves' if moving else 'everything stands'}"] += 1
    return DriveRecord(length, checked, dict(counts), dict(statuses), least, problems)


def stopping_line(servo: bp.Servo) -> Matrix:
    """(25, n) the configurations passed when the machine brakes now with 80 % of its limits."""
    braking = float(np.max(np.abs(servo.v) / (0.8 * servo.limits.acceleration)))
    return np.asarray(servo.q + np.linspace(0.0, 1.0, 25)[:, None] * servo.v * braking / 2.0)


def broken_limits(servo: bp.Servo, state: bp.ServoState, before: Vector) -> list[str]:
    """The limits that a step of the servo broke, in words; `before` has the rates (n,) at the previous step."""
    limits, found = servo.limits, []
    if not all(np.isfinite(part).all() for part in (state.q, state.v, state.feedback_force)):
        found.append("not finite")
    if (np.abs(state.v - before) > limits.acceleration * servo.dt * (1.0 + 1e-9)).any():
        found.append("acceleration")
    if (np.abs(state.v) > limits.velocity * (1.0 + 1e-9)).any():
        found.append("velocity")
    if (state.q > limits.upper + 1e-9).any() or (state.q < limits.lower - 1e-9).any():
        found.append("position")
    return found
