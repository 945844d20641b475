"""An obstacle put onto a plan while a servo follows it.

Random verified plans of the backhoe (sites of `validation.sites`) are streamed through a
servo. Shortly before the machine reaches a random place of the plan, a ball, a box or a post
appears there and stays. Contacts are measured without coal. If the machine does not arrive,
the planner searches for a motion from its place to the end of the plan.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from itertools import count as numbers
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import numpy as np
import pinocchio as pin

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.campaigns import Campaign
from validation.habitats import load_machine
from validation.obstacles import Record, appearing_obstacle
from validation.servo_drives import CLOSE, broken_limits, stopping_line
from validation.signed_distances import obstacle_distance
from validation.sites import KINDS, SiteKey, random_site
from validation.surfaces import LinkDistances, Nearest, link_shapes

P = ParamSpec("P")
R = TypeVar("R")
D = TypeVar("D")

_SITES = [(kind, task) for kind in KINDS for task in ("goal", "path")]
_PER_PLAN = 5  # placements on every plan
_LONGEST = 90.0  # s of one drive
_BLOCKED = 16.0  # s of standing blocked after which a drive ends,
_BLOCKED_AT_END = 2.0  # if the end of the plan is occupied
_END_TAKEN = 0.2  # part of the obstacles on the end of a plan that are kept
_SPARE = 0.02  # m beyond the machine's clearance from a new obstacle


@dataclass(frozen=True)
class Followed(Generic[D]):
    """A campaign of drives: every drive, the figures of all, and whether it was interrupted."""

    drives: list[D]
    figures: dict[str, Any]
    interrupted: bool


class Immediate(Executor):
    """Runs every call at once and records its duration [s]."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Call `fn` and return a future that is done."""
        begun = time.monotonic()
        future: Future[R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  as an executor does
            future.set_exception(error)
        self.times.append(time.monotonic() - begun)
        return future


class SceneDistances:
    """Distances without coal from the obstacles of a scene to the links for which they count."""

    def __init__(self, robot: bp.Robot, scene: bp.Scene) -> None:
        still = np.zeros(3)
        self._parts = [
            (
                LinkDistances(robot, links=links),
                {spec.name: (obstacle_distance(spec, scene), still) for spec in scene.obstacles if spec.links == links},
            )
            for links in {spec.links for spec in scene.obstacles}
        ]

    def least(self, q: Vector) -> Nearest:
        """The least at `q` (n,); only exact below 0.3 m."""
        found = [part.least(q, obstacles) for part, obstacles in self._parts]
        return min(found, key=lambda one: one.distance, default=Nearest(np.inf, "", ""))


@dataclass(frozen=True)
class Drive:
    """The result of one drive.

    Attributes
    ----------
    site, turn, obstacle: the plan and the obstacle.
    arrived: at the end of the plan.
    status, reason: of the follower at the end.
    least_distance: to any obstacle, at the checked steps [m].
    problems: broken limits and contacts.
    seconds: in each status [s].
    late: later than planned [s].
    searches: times of the searches for a detour [s].
    end_taken: whether the obstacle is closer than its clearance to the end of the plan.
    planner: the planner's answer if the end is free but the drive did not arrive.
    other_posture: whether the planner's motion leads to another configuration.
    """

    site: str
    turn: int
    obstacle: str
    arrived: bool
    status: str
    reason: str
    least_distance: float
    problems: list[str]
    seconds: dict[str, float]
    late: float
    searches: list[float]
    end_taken: bool
    planner: str = ""
    other_posture: bool = False

    @property
    def ending(self) -> str:
        """The ending in a few words."""
        if self.arrived:
            return "arrived"
        return f"{self.status}, " + ("end taken" if self.end_taken else f"end free, planner: {self.planner}")


def places_on_machine(robot: bp.Robot, postures: Matrix, rng: np.random.Generator) -> Matrix:
    """(K, 3) a random point of a link in each configuration (K, n), more often of the outer links."""
    covers = [cover for cover in link_shapes(robot)[0] if cover.joint > 1]
    weights = np.square([float(cover.joint) for cover in covers])
    cover = covers[int(rng.choice(len(covers), p=weights / weights.sum()))]
    point, data = rng.choice(cover.points), robot.model.createData()
    found = []
    for q in postures:
        pin.forwardKinematics(robot.model, data, q)
        found.append(data.oMi[cover.joint].act(point))
    return np.array(found)


class Placement:
    """One obstacle on one plan, and the drive past it."""

    def __init__(self, plan: bp.Plan, rng: np.random.Generator) -> None:
        self.plan, self.rng, self.robot = plan, rng, plan.robot
        self.executor = Immediate()
        self.servo = bp.Servo(plan.robot, plan.scene, q=plan.trajectory.q[0])
        self.follower = bp.PlanFollower(self.servo, plan, executor=self.executor)
        self.obstacle = ""

    def put(self) -> bool:
        """Follow the plan until shortly before a random place and put an obstacle there; False if none fits."""
        plan, rng, servo = self.plan, self.rng, self.servo
        at = float(rng.uniform(0.15, 1.0)) * plan.trajectory.duration
        lead = float(rng.uniform(0.5, 3.0))
        while not self.follower.done and self.follower.step().plan_time < at - lead:
            pass
        line = stopping_line(servo)
        content = scene_content(plan.scene)
        for _ in range(30):
            (place,) = places_on_machine(self.robot, plan.trajectory.at(at)[None], rng)
            new = appearing_obstacle(place, rng)
            new["name"] = f"new {new['shape']}"
            self.scene = bp.scene_from_dict({**content, "obstacles": [*content.get("obstacles", []), new]})
            last = self.scene.model_copy(update={"obstacles": self.scene.obstacles[-1:]})
            alone = SceneDistances(self.robot, last)
            end = alone.least(plan.trajectory.q[-1]).distance
            if end < self.scene.clearance and rng.random() > _END_TAKEN:
                continue
            if all(alone.least(q).distance > self.scene.clearance + _SPARE for q in line):
                servo.add(new)
                self.obstacle, self.end_taken = new["name"], end < self.scene.clearance - 1e-4
                return True
        return False

    def drive(self, site: str, turn: int, *, every: int) -> Drive:
        """Follow the plan to its end, or until the drive will not arrive."""
        servo, distances = self.servo, SceneDistances(self.robot, self.scene)
        problems: list[str] = []
        statuses: Counter[str] = Counter()
        least, blocked, before = np.inf, 0.0, servo.v
        patience = _BLOCKED_AT_END if self.end_taken else _BLOCKED
        for step in range(int(_LONGEST / servo.dt)):
            followed = self.follower.step()
            state = followed.state
            statuses[followed.status.value] += 1
            problems += [f"{broken} at {state.time:.3f} s" for broken in broken_limits(servo, state, before)]
            before = state.v
            if (np.abs(state.v) > 1e-9).any() and (step % every == 0 or state.margin < CLOSE):
                found = distances.least(state.q)
                least = min(least, found.distance)
                if found.distance < 0.0:
                    what = f"{found.link} with {found.obstacle}, {found.distance:.5f} m"
                    problems.append(f"contact at {state.time:.3f} s: {what}")
            blocked = blocked + servo.dt if followed.status.value == "blocked" else 0.0
            if followed.done or blocked > patience:
                break
        way = None if followed.done or self.end_taken else self._way_from_here()
        return Drive(
            site=site,
            turn=turn,
            obstacle=self.obstacle,
            arrived=followed.done,
            status=followed.status.value,
            reason=followed.reason,
            least_distance=float(least),
            problems=problems,
            seconds={name: count * servo.dt for name, count in statuses.items()},
            late=followed.behind,
            searches=self.executor.times,
            end_taken=self.end_taken,
            planner="" if way is None else way.reason or way.verdict,
            other_posture=way is not None and way.verified and self._ends_elsewhere(way),
        )

    def _ends_elsewhere(self, way: bp.Plan) -> bool:
        return bool(np.abs(way.trajectory.q[-1] - self.plan.trajectory.q[-1]).max() > 1e-3)

    def _way_from_here(self) -> bp.Plan:
        """The planner's own answer, from the machine's place to the tip's pose at the end of the plan."""
        end = bp.Kinematics(self.robot).at(self.plan.trajectory.q[-1])
        content = scene_content(self.scene)
        content["start"] = {"joints": dict(zip(self.robot.joint_names, self.servo.q.tolist(), strict=True))}
        content["task"] = {"goal": {"position": end.tip_position.tolist(), "pitch": float(end.pitch)}}
        return bp.plan(self.robot, bp.scene_from_dict(content))


def scene_content(scene: bp.Scene) -> Record:
    """The scene as the content of a file, to be changed."""
    return dict(scene.model_dump(by_alias=True, exclude_none=True))


def place_obstacles(
    *,
    count: int,
    seed: int,
    every: int,
    jobs: int,
    folder: Path | None,
    watch: Callable[[int, Drive], object],
) -> Followed[Drive]:
    """Put obstacles onto plans and drive.

    Parameters
    ----------
    every: steps between checks of distances, which are also checked where the margin is small.
    jobs, folder, watch: see `Campaign`.
    """
    call = partial(place_on_site, seed=seed, every=every)
    with Campaign(call, list[Drive], jobs=jobs, folder=folder) as campaign:
        drives = campaign.first(numbers(1), count, most=_PER_PLAN, watch=watch)
    return Followed(drives, _figures(drives) if drives else {}, campaign.interrupted)


def place_on_site(number: int, *, seed: int, every: int) -> list[Drive]:
    """The drives past obstacles on the plan of a site, by its number; none if the plan is not verified."""
    drives: list[Drive] = []
    site, plan = random_plan("backhoe", number, seed=seed)
    if not plan.verified or plan.trajectory.duration < 2.0:
        return drives
    for turn in range(_PER_PLAN):
        placement = Placement(plan, np.random.default_rng([seed, number, turn]))
        if placement.put():
            drives.append(placement.drive(str(site), turn, every=every))
    return drives


def random_plan(machine: str, number: int, *, seed: int) -> tuple[SiteKey, bp.Plan]:
    """The plan of a random site of a machine, by its number, counted from 1, and the site's key."""
    robot = load_machine(machine)
    kind, task = _SITES[(number - 1) % len(_SITES)]
    site = random_site(robot, SiteKey(machine, kind, task, (number - 1) // len(_SITES), seed))
    return site.key, bp.plan(robot, site.scene, seed=seed)


def _figures(drives: list[Drive]) -> dict[str, Any]:
    went_round = [drive for drive in drives if "going_round" in drive.seconds]
    searches = [seconds for drive in drives for seconds in drive.searches]
    return {
        "placed": len(drives),
        "endings": dict(Counter(drive.ending for drive in drives)),
        "arrived by going round": sum(drive.arrived for drive in went_round),
        "went round": len(went_round),
        "problems": sum(len(drive.problems) for drive in drives),
        "least distance [m]": min(drive.least_distance for drive in drives),
        "searches": len(searches),
        "search [s], median, p90, longest": _spread(searches),
        "later than planned [s], median, p90, longest": _spread([drive.late for drive in drives if drive.arrived]),
    }


def _spread(values: list[float]) -> list[float]:
    return [float(np.quantile(values, part)) for part in (0.5, 0.9, 1.0)] if values else []
