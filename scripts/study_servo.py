#!/usr/bin/env python
"""Whether anything drives the servo into an obstacle: random steps with a second opinion.

The backhoe is driven by wishes that jump, push into obstacles, run into limits and into
singular poses, among obstacles that stand, obstacles that appear where the machine can
still stop, and obstacles that come towards it no faster than it can evade (a linear
programme over the joint rates says how fast that is; half of it is used). Distances are
computed without coal, from points on the links' surfaces and the obstacles' signed
distance functions (`independent`), at every `--check`-th step and at every step whose
own margin is small; limits, accelerations and finiteness at every step.

    python scripts/study_servo.py [--steps 200000] [--seed 0] [--check 10] [--save FILE]
    python scripts/study_servo.py --recoveries 20

With `--recoveries`, the machine starts from rest inside obstacles, inside itself, outside a
limit, or outside a limit and inside an obstacle, and every step is judged by `Proximity`.
Where the servo does not come out, a search that shares nothing with its own says whether
there is a way.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from independent import _bodies, _obstacle
from scipy.optimize import linprog

import backhoe_planner as bp
from backhoe_planner.live import Servo, ServoState
from backhoe_planner.site import Proximity, build_obstacle

EPISODE = 4000
CLEARANCE = 0.05
CLOSE = 0.004  # m of margin below which every step is checked
EVADED_PART = 0.5  # of the speed that the machine can evade at


class SecondOpinion:
    """Signed distances without coal, obstacle by obstacle."""

    def __init__(self, robot: bp.Robot) -> None:
        self._robot = robot
        self._data = robot.model.createData()
        covers, _ = _bodies(robot)
        self._covers = [cover for cover in covers if cover.joint > 0]

    def least(self, q: np.ndarray, obstacles: dict[str, tuple[Any, np.ndarray]]) -> tuple[float, str, str]:
        """(distance, link, obstacle) of the least signed distance; only exact below 0.3 m."""
        pin.forwardKinematics(self._robot.model, self._data, q)
        found = (np.inf, "", "")
        for cover in self._covers:
            placement = self._data.oMi[cover.joint]
            middle = placement.rotation @ cover.centre[0] + placement.translation
            leaves = cover.first < 0
            points = None
            for name, (distance, shift) in obstacles.items():
                rough = float(distance((middle - shift)[None])[0]) - float(cover.radius[0])
                if rough > min(0.3, found[0]):
                    continue
                if points is None:
                    points = cover.centre[leaves] @ placement.rotation.T + placement.translation
                exact = float((distance(points - shift) - cover.radius[leaves]).min())
                if exact < found[0]:
                    found = (exact, cover.link, name)
        return found


def random_spec(rng: np.random.Generator, name: str) -> dict[str, Any]:
    radius, angle = rng.uniform(1.5, 6.0), rng.uniform(-1.5, 1.5)
    place = [float(radius * np.cos(angle)), float(radius * np.sin(angle)), float(rng.uniform(-2.5, 3.5))]
    kind = int(rng.integers(4))
    if kind == 0:
        return {"name": name, "shape": "sphere", "radius": float(rng.uniform(0.1, 0.5)), "position": place}
    if kind == 1:
        size = rng.uniform(0.1, 1.2, 3).tolist()
        return {"name": name, "shape": "box", "size": size, "position": place, "rpy": rng.uniform(-3, 3, 3).tolist()}
    end = (np.array(place) + rng.uniform(-1.0, 1.0, 3)).tolist()
    if kind == 2:
        return {"name": name, "shape": "capsule", "radius": float(rng.uniform(0.05, 0.2)), "from": place, "to": end}
    depth = float(rng.uniform(-4.5, -1.0))
    if name.endswith("0"):
        return {"name": name, "shape": "halfspace", "point": [0.0, 0.0, depth], "normal": [0.0, 0.0, 1.0]}
    return {"name": name, "shape": "box", "size": [0.3, 3.0, 2.0], "position": place}


def scene_of(robot: bp.Robot, q: np.ndarray, obstacles: list[dict[str, Any]]) -> bp.Scene:
    return bp.scene_from_dict(
        {
            "version": 1,
            "start": {"joints": dict(zip(robot.joint_names, q.tolist(), strict=True))},
            "task": {"goal": {"position": [4.0, 0.0, 0.0]}},
            "clearance": CLEARANCE,
            "obstacles": obstacles,
        }
    )


class Episode:
    """One site, and what happens in it."""

    def __init__(self, robot: bp.Robot, opinion: SecondOpinion, rng: np.random.Generator) -> None:
        self.robot, self.opinion, self.rng = robot, opinion, rng
        self.known: dict[str, tuple[Any, np.ndarray]] = {}
        self.specs: dict[str, Any] = {}
        alone = Proximity(robot)
        while True:
            q = robot.random_q(rng)
            if np.all(alone.distances(q) > 0.02):
                break
        chosen = []
        empty = scene_of(robot, q, [])
        while len(chosen) < int(rng.integers(4, 21)):
            content = random_spec(rng, f"obstacle {len(chosen)}")
            if self._clear_of(q[None], content, empty, CLEARANCE + 0.02):
                chosen.append(content)
        self.scene = scene_of(robot, q, chosen)
        self.servo = Servo(robot, self.scene, circulate=bool(rng.integers(2)))
        for spec in self.scene.obstacles:
            self.specs[spec.name] = spec
            self.known[spec.name] = (_obstacle(spec, self.scene), np.zeros(3))
        self.movers: dict[str, np.ndarray] = {}
        self.kind = "none"
        self.count = 0
        self.tip = np.zeros(3)
        self.joints = np.zeros(robot.n)
        self.state: ServoState | None = None

    def _clear_of(self, poses: np.ndarray, content: dict[str, Any], scene: bp.Scene, least: float) -> bool:
        """Whether the machine keeps `least` from a new obstacle in all of some postures."""
        spec = bp.scene_from_dict({**scene.model_dump(by_alias=True, exclude_none=True), "obstacles": [content]})
        distance = _obstacle(spec.obstacles[0], spec)
        return all(self.opinion.least(q, {"new": (distance, np.zeros(3))})[0] > least for q in poses)

    # --- what happens ------------------------------------------------------------------

    def change_wish(self) -> None:
        rng, limits = self.rng, self.servo.limits
        self.kind = str(rng.choice(["tip", "joints", "push", "limit", "stretch", "zero", "jump"]))
        self.tip = rng.normal(size=3)
        self.tip *= rng.uniform(0.1, 3.0) / np.linalg.norm(self.tip)
        self.joints = rng.uniform(-1.5, 1.5, self.robot.n) * limits.velocity
        if self.kind == "limit":
            self.joints = np.sign(rng.normal(size=self.robot.n)) * limits.velocity * 2.0

    def wish(self) -> dict[str, Any]:
        rng = self.rng
        if self.kind == "zero":
            return {"tip_velocity": np.zeros(3)}
        if self.kind in ("joints", "limit"):
            return {"joint_velocity": self.joints}
        if self.kind == "jump":
            return {"tip_velocity": rng.normal(size=3) * 2.0}
        if self.kind == "push" and self.known:
            tip = self.servo._tip.position
            goals = [
                np.array(getattr(self.specs[n], "position", (4.0, 0.0, 0.0))) + s for n, (_, s) in self.known.items()
            ]
            goal = min(goals, key=lambda goal: float(np.linalg.norm(goal - tip)))
            way = goal - tip
            return {"tip_velocity": 1.5 * way / max(float(np.linalg.norm(way)), 1e-6)}
        if self.kind == "stretch":
            tip = self.servo._tip.position
            return {"tip_velocity": 1.0 * tip / np.linalg.norm(tip)}
        return {"tip_velocity": self.tip}

    def appear(self) -> bool:
        """Put an obstacle where the machine can still stop before it; whether it was put."""
        rng, servo = self.rng, self.servo
        name = f"new {self.count}"
        self.count += 1
        content = random_spec(rng, name)
        q, v = servo.q, servo.v
        braking = float(np.max(np.abs(v) / (0.8 * servo.limits.acceleration)))
        line = q + np.linspace(0.0, 1.0, 25)[:, None] * v * braking / 2.0
        if not self._clear_of(line, content, self.scene, CLEARANCE + 0.02):
            return False
        spec = bp.scene_from_dict(
            {**self.scene.model_dump(by_alias=True, exclude_none=True), "obstacles": [content]}
        ).obstacles[0]
        servo.add(build_obstacle(spec, folder=Path(), clearance=CLEARANCE))
        self.specs[name] = spec
        self.known[name] = (_obstacle(spec, self.scene), np.zeros(3))
        if rng.integers(2) and spec.shape != "halfspace":
            self.movers[name] = np.zeros(3)
        return True

    def drive_movers(self) -> None:
        """Let the movers come at the machine, no faster than it can evade them."""
        if not self.movers:
            return
        speed = EVADED_PART * self.evasion_speed()
        for name, velocity in self.movers.items():
            spec = self.specs[name]
            place = np.array(getattr(spec, "position", getattr(spec, "start", (0.0, 0.0, 0.0)))) + self.servo.shift_of(
                name
            )
            if self.rng.random() < 0.05 or not velocity.any():
                joint = int(self.rng.integers(2, self.robot.model.njoints))
                pin.forwardKinematics(self.robot.model, self.opinion._data, self.servo.q)
                way = self.opinion._data.oMi[joint].translation - place + self.rng.normal(size=3) * 0.5
                velocity = way / max(float(np.linalg.norm(way)), 1e-6) * self.rng.uniform(0.05, 0.3)
                self.movers[name] = velocity
            size = float(np.linalg.norm(velocity))
            self.servo.set_velocity(name, velocity * min(1.0, speed / size))

    def evasion_speed(self) -> float:
        """The speed at which every mover nearby can be evaded at once [m/s]."""
        servo, limits = self.servo, self.servo.limits
        obstacles = []
        for name, (_, shift) in self.known.items():
            spec = self.specs[name]
            built = build_obstacle(spec, folder=Path(), clearance=CLEARANCE)
            if np.any(shift):
                built = moved(built, shift)
            obstacles.append(built)
        nearby = Proximity(self.robot, obstacles).at(servo.q, margin=0.5)
        gap_up, gap_down = limits.upper - servo.q, servo.q - limits.lower
        high, low = np.minimum(limits.velocity, gap_up), -np.minimum(limits.velocity, gap_down)
        names = list(self.known)
        A, b = [], []
        some = False
        proximity_owner = Proximity(self.robot, obstacles).owner
        for row, pair in enumerate(nearby.pair):
            owner = int(proximity_owner[pair])
            comes = owner >= 0 and names[owner] in self.movers
            some |= comes
            A.append([*(-nearby.gradient[row]), 1.0 if comes else 0.0])
            b.append(
                2.0 * max(float(nearby.margin[row]) - 0.01, 0.0)
                if not comes
                else max(float(nearby.margin[row]) - 0.1, 0.0)
            )
        if not some:
            return 1.0
        n = self.robot.n
        solved = linprog(
            [0.0] * n + [-1.0],
            A_ub=A,
            b_ub=b,
            bounds=[*zip(np.minimum(low, 0.0), np.maximum(high, 0.0), strict=True), (0.0, 1.0)],
        )
        return float(solved.x[-1]) if solved.status == 0 else 0.0


def moved(obstacle: Any, shift: np.ndarray) -> Any:
    from dataclasses import replace

    pieces = tuple(
        replace(piece, placement=pin.SE3(piece.placement.rotation, piece.placement.translation + shift))
        for piece in obstacle.pieces
    )
    return replace(obstacle, pieces=pieces)


def run(robot: bp.Robot, steps: int, seed: int, every: int) -> dict[str, Any]:
    opinion = SecondOpinion(robot)
    counts: Counter[str] = Counter()
    statuses: Counter[str] = Counter()
    problems: list[str] = []
    least = (np.inf, "", "", 0)
    done, episode_number = 0, 0
    begun = time.monotonic()
    while done < steps:
        rng = np.random.default_rng([seed, episode_number])
        episode = Episode(robot, opinion, rng)
        servo, limits = episode.servo, episode.servo.limits
        episode_number += 1
        before = np.zeros(robot.n)
        for step in range(min(EPISODE, steps - done)):
            if step % int(rng.integers(1, 400)) == 0:
                episode.change_wish()
            if step % 500 == 250:
                counts["appeared"] += episode.appear()
            if step % 20 == 0:
                episode.drive_movers()
            state = servo.step(**episode.wish())
            for name in episode.movers:
                episode.known[name] = (episode.known[name][0], servo.shift_of(name))
            statuses[state.status.value] += 1
            counts["unproven"] += not state.proven
            where = f"episode {episode_number - 1}, step {step}, {episode.kind}"
            if not (
                np.isfinite(state.q).all() and np.isfinite(state.v).all() and np.isfinite(state.feedback_force).all()
            ):
                problems.append(f"not finite: {where}")
            if (np.abs(state.v - before) > limits.acceleration * servo.dt * (1.0 + 1e-9)).any():
                problems.append(f"acceleration: {where}")
            if (np.abs(state.v) > limits.velocity * (1.0 + 1e-9)).any():
                problems.append(f"velocity: {where}")
            if (state.q > limits.upper + 1e-9).any() or (state.q < limits.lower - 1e-9).any():
                problems.append(f"position: {where}")
            before = state.v
            if step % every == 0 or state.margin < CLOSE:
                distance, link, obstacle = opinion.least(state.q, episode.known)
                counts["checked"] += 1
                comes = obstacle in episode.movers
                if distance < least[0]:
                    least = (distance, link, obstacle, episode_number - 1)
                if distance < 0.0:
                    problems.append(f"contact: {where}: {link} with {obstacle}, {distance:.5f} m, moving: {comes}")
                elif distance < CLEARANCE - 1e-4:
                    counts["clearance of what moves cut" if episode.movers else "clearance of what stands cut"] += 1
        done += min(EPISODE, steps - done)
        print(f"{done} steps, {time.monotonic() - begun:.0f} s, {len(problems)} problems, least {least}", flush=True)
    return {
        "steps": done,
        "episodes": episode_number,
        "checked without coal": counts["checked"],
        "counts": dict(counts),
        "statuses": dict(statuses),
        "least distance": [float(least[0]), *least[1:]],
        "problems": len(problems),
        "first problems": problems[:20],
    }


def descended(robot: bp.Robot, proximity: Proximity, q: np.ndarray) -> float:
    """How deep the machine still is where steps of a linear programme over `Proximity`'s gradients end [m].

    A second opinion on whether the joints could do better: no dynamics, no braking, no
    promise but the deepest violation falling.
    """
    nearby, trust = proximity.at(q, margin=0.3), 0.02
    deepest = float(-np.min(nearby.margin))
    for _ in range(400):
        if deepest <= 0.0 or trust < 1e-5:
            break
        inside = nearby.margin < 0.0
        solved = linprog(
            [0.0] * robot.n + [-1.0],
            A_ub=np.column_stack((-nearby.gradient, inside.astype(float))),
            b_ub=nearby.margin + np.where(inside, deepest, 0.0),
            bounds=[
                *zip(
                    np.maximum(-trust, robot.limits.lower - q), np.minimum(trust, robot.limits.upper - q), strict=True
                ),
                (0.0, None),
            ],
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


class Start:
    """A posture that is closer to something than allowed, outside a limit, or both."""

    def __init__(self, robot: bp.Robot, rng: np.random.Generator, number: int) -> None:
        self.robot, self.number = robot, number
        self.kind = KINDS[number % len(KINDS)]
        alone = Proximity(robot)
        while True:
            q = robot.random_q(rng)
            outside = 0.0
            if "limit" in self.kind:
                joint, outside = int(rng.integers(robot.n)), float(rng.uniform(0.02, 0.15))
                up = rng.integers(2)
                q[joint] = robot.limits.upper[joint] + outside if up else robot.limits.lower[joint] - outside
            least = float(np.min(alone.distances(q)))
            if "itself" in self.kind:
                if not -0.2 < least < -0.02:
                    continue
            elif least < 0.02:
                continue
            obstacles = []
            if "obstacle" in self.kind:
                count = int(rng.integers(1, 4)) if "several" in self.kind else 1
                obstacles = [random_spec(rng, f"obstacle {number % 5 + 5 * k}") for k in range(count)]
            self.q, self.scene = q, scene_of(robot, q if outside == 0.0 else robot.random_q(rng), obstacles)
            self.proximity = Proximity(
                robot, [build_obstacle(spec, folder=Path(), clearance=CLEARANCE) for spec in self.scene.obstacles]
            )
            self.deepest = self.depths(q)
            if "obstacle" not in self.kind or 0.02 < float(np.max(self.deepest[1:])) < 0.3:
                return

    def depths(self, q: np.ndarray) -> np.ndarray:
        """(1 + obstacles,) of the machine itself and of every obstacle the deepest violation [m]."""
        depth = self.proximity.clearance - self.proximity.distances(q)
        owner = self.proximity.owner
        found = [float(np.max(depth[owner == k], initial=0.0)) for k in range(-1, len(self.scene.obstacles))]
        return np.array(found)

    def outside(self, q: np.ndarray) -> np.ndarray:
        """(n,) how far every joint is outside its limits [rad]."""
        limits = self.robot.limits
        return np.maximum(np.maximum(q - limits.upper, limits.lower - q), 0.0)


KINDS = ("obstacle", "obstacle", "obstacle", "several obstacles", "itself", "limit", "limit and obstacle")


def come_back(start: Start, wish: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Let the servo find its way back, and judge every step by `Proximity`.

    Of every step it is asked whether of every obstacle, of the machine itself and of
    every limit the deepest violation fell (what is gone stays gone). On a way that the servo says leads past
    what is no shallower, the length to go must fall instead, and nothing may be deeper
    than at the start.
    """
    servo = Servo(start.robot, start.scene, q=start.q)
    first, before, before_out = start.depths(start.q), start.depths(start.q), start.outside(start.q)
    to_go, resting, counts = None, 0, Counter[str]()
    slowest = 0.0
    for _ in range(round(seconds / servo.dt)):
        begun = time.process_time()
        state = servo.step(**wish)
        slowest = max(slowest, time.process_time() - begun)
        now, out = start.depths(state.q), start.outside(state.q)
        rests = bool(np.all(np.abs(state.v) < 1e-9))
        resting = resting + 1 if rests else 0
        on_the_way = servo.way_to_go is not None
        if on_the_way:
            counts["steps on a way below"] += 1
            counts["deeper than at the start"] += bool((now > np.maximum(first, 1e-6) + 1e-7).any())
            counts["not nearer"] += to_go is not None and not rests and servo.way_to_go >= to_go
        else:
            counts["grew"] += bool((now > np.maximum(before, 1e-6) + 1e-9).any())
            counts["did not shrink"] += bool(((now >= before) & (before > 1e-6)).any()) and not rests
        counts["further outside"] += bool((out > before_out + 1e-9).any())
        to_go = servo.way_to_go
        before, before_out = now, out
        done = bool((now <= 1e-6).all() and (out <= 1e-6).all())
        if done or resting > RESTS:
            break
    counts["at rest"] += resting > 0
    return {"out": done, "time": servo.time, "counts": counts, "q": state.q, "left": now, "slowest": slowest}


RESTS = 9000  # steps: longer than the servo takes until it searches again


def another_way(start: Start, q: np.ndarray, rng: np.random.Generator) -> str | None:
    """Whether a search that shares nothing with the servo's finds a way out that is never deeper than the start.

    Descents by linear programmes from 20 postures around; straight lines to 2000 clear
    postures; and a tree of 3000 postures grown from the start.
    """
    robot, limits, ceiling = start.robot, start.robot.limits, start.deepest + 1e-7
    low, high = np.minimum(limits.lower, start.q), np.maximum(limits.upper, start.q)

    def allowed(at: np.ndarray) -> bool:
        return bool((start.depths(at) <= np.maximum(ceiling, 1e-7)).all())

    def line(a: np.ndarray, b: np.ndarray) -> bool:
        count = max(int(np.max(np.abs(b - a)) / 0.02), 1)
        return all(allowed(a + part / count * (b - a)) for part in range(1, count + 1))

    for origin in () if start.outside(start.q).any() else (start.q, q):  # descents do not care for limits
        if descended(robot, start.proximity, origin) <= 0.0:
            return "descent"
        for _ in range(10):
            near = np.clip(origin + rng.normal(size=robot.n) * 0.05, low, high)
            if allowed(near) and descended(robot, start.proximity, near) <= 0.0:
                return "descent from near by"
    clear = [at for at in (robot.random_q(rng) for _ in range(2000)) if np.all(start.depths(at) <= 0.0)]
    if not clear:
        return None
    for goal in clear:
        if line(start.q, goal):
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


def recoveries(robot: bp.Robot, count: int, seed: int) -> dict[str, Any]:
    """Starts inside obstacles, inside itself, outside limits, from rest, with any wish."""
    counts: Counter[str] = Counter()
    notes: list[str] = []
    longest = slowest = 0.0
    for number in range(count):
        rng = np.random.default_rng([seed, number, 7])
        start = Start(robot, rng, number)
        wish = (
            {"tip_velocity": rng.normal(size=3)} if rng.integers(2) else {"joint_velocity": rng.uniform(-1, 1, robot.n)}
        )
        found = come_back(start, wish, seconds=30.0)
        seen, said = found["counts"], start.kind
        slowest = max(slowest, found["slowest"])
        if found["out"]:
            longest = max(longest, found["time"])
            said += ": out, on a way below" if seen["steps on a way below"] else ": out"
        else:
            way = another_way(start, found["q"], rng)
            said += ": not out, and no way is found" if way is None else f": not out, {way}"
            notes.append(
                f"case {number}: from {np.round(start.deepest, 4)} m to {np.round(found['left'], 4)} m, {said}"
            )
        wrong = {
            key: seen[key]
            for key in ("grew", "did not shrink", "not nearer", "deeper than at the start", "further outside")
            if seen[key]
        }
        if wrong:
            notes.append(f"case {number}: {np.round(start.deepest, 4)} m, {said}, {wrong}")
            said += ", with wrong steps"
        counts[said] += 1
        if (number + 1) % 20 == 0:
            print(number + 1, dict(counts), notes, flush=True)
    return {
        "starts": count,
        **dict(sorted(counts.items())),
        "longest way out [s]": longest,
        "slowest step [ms]": 1e3 * slowest,
        "notes": notes,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--check", type=int, default=10)
    parser.add_argument("--recoveries", type=int, default=0, help="starts that are violated, instead of the steps")
    parser.add_argument("--save", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    if arguments.recoveries:
        print(json.dumps(recoveries(bp.load_robot("example:backhoe"), arguments.recoveries, arguments.seed), indent=2))
        return
    found = run(bp.load_robot("example:backhoe"), arguments.steps, arguments.seed, arguments.check)
    print(json.dumps(found, indent=2))
    if arguments.save:
        arguments.save.write_text(json.dumps(found, indent=2) + "\n")
    raise SystemExit(1 if found["problems"] else 0)


if __name__ == "__main__":
    main()
