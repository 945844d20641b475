#!/usr/bin/env python
"""Whether a plan that is followed live arrives when something is put onto it: random obstacles, counted.

Random verified plans of the backhoe (goals and paths of `random_scenes`) are streamed
through a servo. When the machine is some way before a random place of the plan, a ball,
a box or a post appears there, and stays. Counted is how each drive ends; contacts by
distances without coal (`study_servo.SecondOpinion`), at every `--check`-th step and at
every step whose own margin is small; limits at every step. Where the machine does not
arrive, the planner is asked whether there was a way, from where it stands to the end of
the plan.

    python scripts/study_following.py [--placements 120] [--seed 0] [--check 10] [--save FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from independent import _bodies, _obstacle
from random_scenes import SiteKey, load_machine, random_site
from study_servo import SecondOpinion

import backhoe_planner as bp

SITES = [(kind, task) for kind in ("open", "cluttered", "narrow") for task in ("goal", "path")]
PER_PLAN = 5  # placements on every plan
LONGEST = 90.0  # s of one drive
BLOCKED = 16.0  # s of standing blocked after which a drive is ended,
BLOCKED_AT_END = 2.0  # where the end of the plan is taken
END_TAKEN = 0.2  # part of the obstacles on the end of a plan that are kept
CLOSE = 0.004  # m of margin below which every step is checked
SPARE = 0.02  # m beyond the clearance that the machine has of what appears


class Immediate(Executor):
    """Runs what it is given at once; keeps what every call took."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        begun = time.monotonic()
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:  # noqa: BLE001  as an executor does
            future.set_exception(error)
        self.times.append(time.monotonic() - begun)
        return future


class Opinion:
    """Signed distances without coal to the obstacles of a scene, each to the links that it counts for."""

    def __init__(self, robot: bp.Robot, scene: bp.Scene) -> None:
        self._parts = []
        for links in {spec.links for spec in scene.obstacles}:
            part = SecondOpinion(robot)
            part._covers = [cover for cover in part._covers if links is None or cover.link in links]
            known = {s.name: (_obstacle(s, scene), np.zeros(3)) for s in scene.obstacles if s.links == links}
            self._parts.append((part, known))

    def least(self, q: np.ndarray) -> tuple[float, str, str]:
        """(distance, link, obstacle) of the least; only exact below 0.3 m."""
        return min((part.least(q, known) for part, known in self._parts), default=(np.inf, "", ""))


def record(scene: bp.Scene) -> dict[str, Any]:
    return dict(scene.model_dump(by_alias=True, exclude_none=True))


def random_record(rng: np.random.Generator, place: np.ndarray) -> dict[str, Any]:
    """A ball, a box or a post about a place."""
    kind = int(rng.integers(3))
    if kind == 0:
        return {"name": "ball", "shape": "sphere", "radius": float(rng.uniform(0.1, 0.4)), "position": place.tolist()}
    if kind == 1:
        return {
            "name": "box", "shape": "box", "size": rng.uniform(0.15, 0.8, 3).tolist(), "position": place.tolist(),
            "rpy": rng.uniform(-np.pi, np.pi, 3).tolist(),
        }  # fmt: skip
    length = float(rng.uniform(1.0, 4.0))
    middle = place + np.array([0.0, 0.0, float(rng.uniform(-0.45, 0.45)) * length])
    return {
        "name": "post", "shape": "cylinder", "radius": float(rng.uniform(0.04, 0.15)), "length": length,
        "position": middle.tolist(),
    }  # fmt: skip


class Placement:
    """One obstacle on one plan, and the drive."""

    def __init__(self, plan: bp.Plan, rng: np.random.Generator) -> None:
        self.plan, self.rng, self.robot = plan, rng, plan.robot
        self.executor = Immediate()
        self.servo = bp.Servo(plan.robot, plan.scene, q=plan.trajectory.q[0])
        self.follower = bp.PlanFollower(self.servo, plan, executor=self.executor)

    def put(self) -> bool:
        """Drive up to some way before a place, and put an obstacle there; False where none fits."""
        plan, rng, servo = self.plan, self.rng, self.servo
        duration = plan.trajectory.duration
        at = float(rng.uniform(0.15, 1.0)) * duration
        lead = float(rng.uniform(0.5, 3.0))
        while not self.follower.done and self.follower.step().plan_time < at - lead:
            pass
        braking = float(np.max(np.abs(servo.v) / (0.8 * servo.limits.acceleration)))
        line = servo.q + np.linspace(0.0, 1.0, 25)[:, None] * servo.v * braking / 2.0
        for _ in range(30):
            content = random_record(rng, self._place_on_machine(plan.trajectory.at(at)))
            self.scene = bp.scene_from_dict(
                {**record(plan.scene), "obstacles": [*record(plan.scene).get("obstacles", []), content]}
            )
            alone = Opinion(self.robot, self.scene.model_copy(update={"obstacles": self.scene.obstacles[-1:]}))
            clearance = self.scene.clearance
            taken = alone.least(plan.trajectory.q[-1])[0] < clearance
            if taken and rng.random() > END_TAKEN:
                continue
            if all(alone.least(q)[0] > clearance + SPARE for q in line):
                servo.add(content)
                self.opinion, self.alone, self.name = Opinion(self.robot, self.scene), alone, content["name"]
                return True
        return False

    def _place_on_machine(self, q: np.ndarray) -> np.ndarray:
        """(3,) a random point of a link, the outer ones more often."""
        data = self.robot.model.createData()
        pin.forwardKinematics(self.robot.model, data, q)
        covers = [cover for cover in _bodies(self.robot)[0] if cover.joint > 1]
        cover = covers[int(self.rng.choice(len(covers), p=_weights([cover.joint for cover in covers])))]
        points = cover.centre[cover.first < 0]
        return np.asarray(data.oMi[cover.joint].act(points[int(self.rng.integers(len(points)))]))

    def drive(self, every: int) -> dict[str, Any]:
        servo, limits = self.servo, self.servo.limits
        problems: list[str] = []
        statuses: Counter[str] = Counter()
        least, blocked, before = np.inf, 0.0, servo.v
        patience = BLOCKED_AT_END if self.end_taken() else BLOCKED
        begun = time.monotonic()
        checking = 0.0
        for step in range(int(LONGEST / servo.dt)):
            said = self.follower.step()
            state = said.state
            statuses[said.status.value] += 1
            if (np.abs(state.v - before) > limits.acceleration * servo.dt * (1.0 + 1e-9)).any():
                problems.append(f"acceleration at {state.time:.3f} s")
            if (np.abs(state.v) > limits.velocity * (1.0 + 1e-9)).any():
                problems.append(f"velocity at {state.time:.3f} s")
            if (state.q > limits.upper + 1e-9).any() or (state.q < limits.lower - 1e-9).any():
                problems.append(f"position at {state.time:.3f} s")
            moved = bool((np.abs(state.v) > 1e-9).any())
            if moved and (step % every == 0 or state.margin < CLOSE):
                now = time.monotonic()
                distance, link, obstacle = self.opinion.least(state.q)
                checking += time.monotonic() - now
                least = min(least, distance)
                if distance < 0.0:
                    problems.append(f"contact at {state.time:.3f} s: {link} with {obstacle}, {distance:.5f} m")
            before = state.v
            blocked = blocked + servo.dt if said.status.value == "blocked" else 0.0
            if said.done or blocked > patience:
                break
        return {
            "arrived": said.done,
            "status": said.status.value,
            "reason": said.reason,
            "least distance": float(least),
            "problems": problems,
            "seconds": {name: count * servo.dt for name, count in statuses.items()},
            "longer than planned [s]": said.behind,
            "searches [s]": self.executor.times,
            "wall [s]": time.monotonic() - begun - checking,
        }

    def end_taken(self) -> bool:
        """Whether what appeared is closer than its clearance to the end of the plan."""
        return self.alone.least(self.plan.trajectory.q[-1])[0] < self.scene.clearance - 1e-4

    def way_from_here(self, *, budget: float) -> bp.Plan:
        """The planner's own answer: from where the machine stands to the tip's pose at the end of the plan."""
        end = bp.Kinematics(self.robot).at(self.plan.trajectory.q[-1])
        content = record(self.scene)
        content["start"] = {"joints": dict(zip(self.robot.joint_names, self.servo.q.tolist(), strict=True))}
        content["task"] = {"goal": {"position": end.tip_position.tolist(), "pitch": float(end.pitch)}}
        return bp.plan(self.plan.robot, bp.scene_from_dict(content), budget=budget)


def _weights(joints: list[int]) -> np.ndarray:
    weights = np.array(joints, dtype=float) ** 2
    return weights / weights.sum()


def run(placements: int, seed: int, every: int) -> dict[str, Any]:
    robot = load_machine("backhoe")
    found: list[dict[str, Any]] = []
    number = 0
    while len(found) < placements:
        kind, task = SITES[number % len(SITES)]
        site = random_site(robot, SiteKey("backhoe", kind, task, number // len(SITES), seed))
        number += 1
        plan = bp.plan(robot, site.scene, seed=seed)
        if not plan.verified or plan.trajectory.duration < 2.0:
            continue
        for turn in range(PER_PLAN):
            placement = Placement(plan, np.random.default_rng([seed, number, turn]))
            if len(found) == placements or not placement.put():
                continue
            result = {"site": str(site.key), "turn": turn, "obstacle": placement.name} | placement.drive(every)
            if not result["arrived"]:
                result["end taken"] = placement.end_taken()
                way = None if result["end taken"] else placement.way_from_here(budget=10.0)
                result["planner"] = "" if way is None else way.reason or way.verdict
                if way is not None and way.verified:
                    result["to another posture"] = bool(
                        np.abs(way.trajectory.q[-1] - plan.trajectory.q[-1]).max() > 1e-3
                    )
            found.append(result)
            shown = {key: value for key, value in result.items() if key not in ("searches [s]", "seconds")}
            print(len(found), json.dumps(shown), flush=True)
    return summary(found) | {"placements": found}


def summary(found: list[dict[str, Any]]) -> dict[str, Any]:
    searches = [seconds for result in found for seconds in result["searches [s]"]]
    late = [result["longer than planned [s]"] for result in found if result["arrived"]]
    went_round = sum("going_round" in result["seconds"] for result in found)
    endings = Counter(
        "arrived" if result["arrived"]
        else f"{result['status']}, end taken" if result["end taken"]
        else f"{result['status']}, end free, planner: {result['planner']}"
        for result in found
    )  # fmt: skip
    return {
        "placed": len(found),
        "endings": dict(endings),
        "arrived by going round": sum(r["arrived"] and "going_round" in r["seconds"] for r in found),
        "went round": went_round,
        "problems": sum(len(result["problems"]) for result in found),
        "least distance [m]": min(result["least distance"] for result in found),
        "searches": len(searches),
        "search [s], median, p90, longest": _spread(searches),
        "later than planned [s], median, p90, longest": _spread(late),
    }


def _spread(values: list[float]) -> list[float]:
    return [float(np.quantile(values, part)) for part in (0.5, 0.9, 1.0)] if values else []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--placements", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    found = run(arguments.placements, arguments.seed, arguments.check)
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=2) + "\n")
    del found["placements"]
    print(json.dumps(found, indent=2))
    raise SystemExit(1 if found["problems"] else 0)


if __name__ == "__main__":
    main()
