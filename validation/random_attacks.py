"""Random sites and motions around a random machine, many of them close to contact on purpose.

Sites have every obstacle shape of the scene file, moving and appearing obstacles, obstacles for
some links only, and obstacles with their own clearance. A motion is a straight joint motion from
waypoint to waypoint, without planning.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from validation.convex_gaps import Body
from validation.dense_sweep import Sweep, link_bodies
from validation.link_pairs import Pairs, find_pairs
from validation.random_machines import random_mesh, write_random_machine
from validation.raw_obstacles import RawObstacle, Record, read_obstacle, solid_of
from validation.raw_urdf import RawMachine, read_raw_urdf

TURNS = 5  # sites and motions for every machine
_CLEARANCE = 0.02  # m, of every scene
SHAPES = ("sphere", "box", "cylinder", "capsule", "halfspace", "mesh", "heightmap", "pointcloud")
_RATE, _SEGMENT = 0.5, 0.8  # rad/s or m/s at most, and the least s of a leg, so that rates are kept
_SUDDEN = 100.0  # rad/s^2 or m/s^2: reverses within 0.02 s, twice over; the attack is on distances
_SHORTEST, _MOST_SAMPLES = 0.4, 40  # s between two samples, and the largest number of samples
_GRAZES = (0.0, 0.0003, 0.003, 0.02)  # m beyond its clearance at which an obstacle is passed
_INSTANT = 1e-3  # s over which the speed of a point is measured
_STARTS = 5  # configurations tried as the first
_HALVINGS = 7  # between a clear and a touching configuration or place


@dataclass(frozen=True, eq=False)
class Attacked:
    """A machine twice: as read by the planner, and as written."""

    robot: bp.Robot
    raw: RawMachine
    bodies: dict[str, Body]
    pairs: Pairs

    def sweep(self, time: Vector, q: Matrix) -> Sweep:
        """The moving machine through samples (T,) and (T, n)."""
        return Sweep(self.raw, self.bodies, self.robot.joint_names, time, q)


@dataclass(frozen=True, eq=False)
class Attack:
    """A machine, a site and a motion, named by a seed."""

    seed: int
    machine: Attacked
    scene: bp.Scene
    obstacles: tuple[RawObstacle, ...]
    trajectory: bp.Trajectory


def random_attacked(seed: int, folder: Path) -> Attacked:
    """The machine of a seed; neighbouring seeds share one. In each, at least one link with a shape moves."""
    for turn in count():
        file = write_random_machine(np.random.default_rng([turn, seed // TURNS]), folder)
        raw = read_raw_urdf(file)
        bodies = link_bodies(raw)
        carriers = raw.bodies([joint.name for joint in raw.chain("tip")])
        if any(carriers[name] for name in bodies):
            break
    return Attacked(bp.load_robot(file, tip="tip"), raw, bodies, find_pairs(raw, bodies, "tip"))


def random_attack(seed: int, machine: Attacked, folder: Path) -> Attack:
    """Draw the site and the motion of a seed; files are written to `folder`."""
    draft = _Draft(seed, machine, folder)
    draft.draw()
    return draft.attack()


class _Draft:
    """A site and a motion while they are drawn."""

    def __init__(self, seed: int, machine: Attacked, folder: Path) -> None:
        self.seed, self.machine, self.folder = seed, machine, folder
        self.rng = np.random.default_rng([1, seed])
        self.records: list[Record] = []
        self.zones: list[Record] = []
        self.q = self._waypoints()
        self.time = self._timed(self.q)

    def draw(self) -> None:
        """Obstacles along the motion; then one of them, or the motion, is moved close to contact."""
        sweep = self.machine.sweep(self.time, self.q)
        for number in range(int(self.rng.choice(6, p=[0.15, 0.2, 0.25, 0.2, 0.1, 0.1]))):
            self.records.append(self._obstacle(number, sweep))
        if self.rng.random() < 0.15:
            self.zones.append(self._zone(sweep))
        turn = self.rng.random()
        if turn < 0.3 and self.records:
            self._graze(sweep)
        elif turn < 0.5:
            self._bisect()
        elif turn < 0.8:
            self._put_in_the_way(sweep)

    def attack(self) -> Attack:
        """The drawn site and motion."""
        names = self.machine.robot.joint_names
        content = {
            "version": 1,
            "tip": "tip",
            "start": {"joints": dict(zip(names, self.q[0].tolist(), strict=True))},
            "task": {"goal": {"position": [0.0, 0.0, 0.0]}},
            "clearance": _CLEARANCE,
            "objective": "velocity_norm",
            "limits": {"acceleration": dict.fromkeys(names, _SUDDEN)},
            "obstacles": self.records,
            "zones": self.zones,
        }
        return Attack(
            self.seed,
            self.machine,
            bp.scene_from_dict(content, folder=self.folder),
            tuple(self._raw(record) for record in (*self.records, *map(solid_of, self.zones))),
            self._sampled(),
        )

    def _sampled(self) -> bp.Trajectory:
        """The motion in 2 to 40 samples; in some attacks more than the waypoints, on the same path."""
        rng = np.random.default_rng([2, self.seed])
        coarse = bp.Trajectory.from_steps(self.time, self.q)
        most = np.minimum(np.diff(self.time) / _SHORTEST, _MOST_SAMPLES / len(self.time)).astype(int)
        parts = rng.integers(1, np.maximum(most, 1) + 1) if rng.random() < 0.4 else np.ones_like(most)
        legs = zip(self.time[:-1], self.time[1:], parts.tolist(), strict=True)
        time = np.concatenate([*(np.linspace(a, b, count, endpoint=False) for a, b, count in legs), self.time[-1:]])
        return bp.Trajectory.from_steps(time, coarse.at(time))

    def _raw(self, record: Record) -> RawObstacle:
        return read_obstacle(record, folder=self.folder, clearance=_CLEARANCE)

    # --- the motion ----------------------------------------------------------------------

    def _posture(self) -> Vector:
        return self.machine.robot.random_q(self.rng)

    def _clear_posture(self) -> Vector:
        """The first of a few configurations without contact between links, if there is one."""
        pairs = self.machine.pairs.counted
        for _ in range(_STARTS):
            q = self._posture()
            if not pairs or self._at(q, lambda sweep: sweep.between(pairs)) > 0.0:
                break
        return q

    def _waypoints(self) -> Matrix:
        rng = self.rng
        found = [self._clear_posture()]
        near = float(rng.choice([0.05, 0.2, 1.0]))
        for _ in range(int(rng.integers(1, 7))):
            found.append(found[-1] + near * (self._posture() - found[-1]))
        q = np.array(found)
        if rng.random() < 0.35:  # the bound on travel is sharpest for a single joint, and for the last one
            last = q.shape[1] - 1
            moving = np.arange(last + 1) == (last if rng.random() < 0.6 else rng.integers(last + 1))
            q = np.where(moving, q, q[0])
        if rng.random() < 0.05:  # beyond the joint limits, or another turn of a continuous joint
            q[-1] += rng.normal(0.0, 1.0, q.shape[1])
        return q

    def _timed(self, q: Matrix) -> Vector:
        legs = np.maximum(np.abs(np.diff(q, axis=0)).max(axis=1) / _RATE, _SEGMENT)
        return np.concatenate(([0.0], np.cumsum(legs * self.rng.uniform(1.0, 2.0, len(legs)))))

    def _bisect(self) -> None:
        """Put a waypoint at the edge between a clear and a touching configuration of two bodies."""
        rng = self.rng
        postures = np.array([self._posture() for _ in range(12)])
        body = self._pair_distance()
        if body is None:
            return
        apart = np.array([body(q) for q in postures])
        if not (np.any(apart > 0.0) and np.any(apart <= 0.0)):
            return
        clear, touching = postures[int(np.argmax(apart))], postures[int(np.argmin(apart))]
        for _ in range(_HALVINGS):
            middle = 0.5 * (clear + touching)
            clear, touching = (middle, touching) if body(middle) > 0.0 else (clear, middle)
        edge = clear if rng.random() < 0.6 else touching
        self.q = np.insert(self.q, int(rng.integers(1, len(self.q) + 1)), edge, axis=0)
        self.time = self._timed(self.q)

    def _pair_distance(self) -> Any:
        """A function for the distance of two bodies at a configuration; None if there are no two."""
        counted = list(self.machine.pairs.counted)
        standing = [obstacle for record in self.records if (obstacle := self._raw(record)).body is not None]
        if standing and (self.rng.random() < 0.5 or not counted):
            obstacle = standing[int(self.rng.integers(len(standing)))]
            return lambda q: self._at(q, lambda sweep: sweep.to_obstacle(obstacle))
        if not counted:
            return None
        pair = counted[int(self.rng.integers(len(counted)))]
        return lambda q: self._at(q, lambda sweep: sweep.between([pair]))

    def _at(self, q: Vector, least: Any) -> float:
        found = least(self.machine.sweep(np.zeros(1), q[None, :]))
        return np.inf if found is None else float(found.distance)

    # --- the site ------------------------------------------------------------------------

    def _obstacle(self, number: int, sweep: Sweep) -> Record:
        """An obstacle near a random point of a random link at a random moment."""
        rng = self.rng
        moment = float(rng.uniform(0.0, self.time[-1]))
        placed = sweep.placements(np.array([moment]))
        links = list(sweep.moving) or ["tip"]
        link = str(rng.choice(links))
        rotation, translation = placed[link]
        place = translation[0]
        if link in sweep.moving:
            place = place + rotation[0] @ rng.choice(sweep.moving[link].points)
        away = rng.normal(size=3)
        size = rng.uniform(0.05, 0.8, 3)
        place = place + away / np.linalg.norm(away) * (rng.uniform(0.05, 1.2) + 0.5 * np.max(size))
        record = {"name": f"obstacle {number}", **self._shape(number, place, away, size)}
        if rng.random() < 0.3:
            record["clearance"] = float(rng.choice([0.0, 0.005, 0.1, 0.4]))
        if rng.random() < 0.2:
            record["links"] = [
                str(name) for name in rng.choice(links, int(rng.integers(1, len(links) + 1)), replace=False)
            ]
        if rng.random() < 0.3:
            record["appears_at"] = float(rng.uniform(0.0, 1.1) * self.time[-1])
        if rng.random() < 0.3:
            velocity = rng.normal(0.0, 0.2, 3)
            record["velocity"] = velocity.tolist()
            _move(record, -velocity * max(moment - record.get("appears_at", 0.0), 0.0))
        return record

    def _zone(self, sweep: Sweep) -> Record:
        """A ceiling, a floor or a cab near the machine's place at some moment."""
        rng = self.rng
        heights = [float(p[0, 2]) for _, p in sweep.placements(rng.uniform(0.0, self.time[-1], 1)).values()]
        zone: Record = {"name": "zone", "kind": str(rng.choice(["ceiling", "floor", "cab"]))}
        zone["stop"] = float(rng.choice([0.0, 0.1]))
        if zone["kind"] == "cab":
            place = rng.normal(0.0, 0.8, 3)
            return {**zone, "size": rng.uniform(0.1, 0.6, 3).tolist(), "position": place.tolist()}
        beyond = max(heights) if zone["kind"] == "ceiling" else min(heights)
        return {**zone, "height": beyond + float(np.sign(beyond - np.mean(heights)) * rng.uniform(0.1, 0.6))}

    def _shape(self, number: int, place: Vector, away: Vector, size: Vector) -> Record:
        rng = self.rng
        shape = str(rng.choice(SHAPES))
        if shape == "halfspace":
            return {"shape": shape, "point": place.tolist(), "normal": (-away).tolist()}
        if shape == "capsule":
            half = 0.5 * rng.uniform(0.0, 1.0) * rng.normal(size=3)
            ends = {"from": (place - half).tolist(), "to": (place + half).tolist()}
            return {"shape": shape, **ends, "radius": float(0.4 * size[0])}
        record: Record = {"shape": shape, "position": place.tolist()}
        if rng.random() < 0.7:
            record["rpy"] = rng.uniform(-np.pi, np.pi, 3).tolist()
        elif rng.random() < 0.5:
            turn = rng.normal(size=4)
            record["quaternion"] = (turn / np.linalg.norm(turn)).tolist()
        if shape == "sphere":
            return {**record, "radius": float(0.5 * size[0])}
        if shape == "box":
            return {**record, "size": size.tolist()}
        if shape == "cylinder":
            return {**record, "radius": float(0.5 * size[0]), "length": float(size[1])}
        return {**record, **self._surveyed(shape, number, size)}

    def _surveyed(self, shape: str, number: int, size: Vector) -> Record:
        """An obstacle from a file: a mesh, a height map or a point cloud."""
        rng = self.rng
        if shape == "mesh":
            file = f"obstacle{number}.{rng.choice(['stl', 'obj', 'ply'])}"
            random_mesh(rng, hollow=0.2).export(self.folder / file)
            return {"file": file, "scale": float(size[0]) if rng.random() < 0.3 else size.tolist()}
        if shape == "heightmap":
            file = f"obstacle{number}.csv"
            heights = rng.normal(0.0, float(rng.choice([0.02, 0.1])), rng.integers(2, 6, 2)) - 0.1
            np.savetxt(self.folder / file, heights, delimiter=",", fmt="%.6f")
            return {"file": file, "size": (2.0 * size[:2]).tolist()}
        points = rng.uniform(-0.5, 0.5, (int(rng.integers(1, 25)), 3)) * size
        file = f"obstacle{number}.{rng.choice(['csv', 'xyz'])}"
        np.savetxt(self.folder / file, points, delimiter=",", fmt="%.6f")
        return {"file": file, "resolution": float(rng.uniform(0.03, 0.2))}

    def _graze(self, sweep: Sweep) -> None:
        """Move an obstacle until the machine passes it at about its clearance."""
        record = self.records[int(self.rng.integers(len(self.records)))]
        middle = sweep.placements(np.array([0.0]))["tip"][1][0]
        wanted = float(self.rng.choice(_GRAZES))
        away = np.array(record.get("position", record.get("from", record.get("point")))) - middle
        away = away / max(float(np.linalg.norm(away)), 1e-9)
        step, moved, clear = 0.4, 0.0, False
        for _ in range(_HALVINGS):
            obstacle = self._raw(record)
            least = sweep.to_obstacle(obstacle)
            if least is None:
                return
            missing = wanted + obstacle.clearance - least.distance
            if least.distance > 0.0 and abs(missing) < 1e-4:
                return
            clear = clear or least.distance > 0.0
            # away from the machine by the missing distance; out of a contact, whose depth is not known, by a step
            ahead = missing if least.distance > 0.0 else step
            _move(record, ahead * away)
            moved += ahead
            step *= 0.7 if clear else 1.3

    def _put_in_the_way(self, sweep: Sweep) -> None:
        """Put a small obstacle where the machine is fastest, between two samples: the motion passes through it."""
        rng = self.rng
        segment = int(rng.integers(len(self.time) - 1))
        share = rng.uniform(0.2, 0.8)
        moment = (1.0 - share) * self.time[segment] + share * self.time[segment + 1]
        placed = sweep.placements(np.array([moment, moment + _INSTANT]))
        fastest, place = 0.0, np.zeros(3)
        for link, body in sweep.moving.items():
            rotation, translation = placed[link]
            points = np.einsum("tij,pj->tpi", rotation, body.points) + translation[:, None]
            speed = np.linalg.norm(points[1] - points[0], axis=1)
            if np.max(speed) > fastest:
                fastest, place = float(np.max(speed)), points[0, int(np.argmax(speed))]
        size = rng.uniform(0.01, 0.06, 3)
        record: Record = {"name": "in the way", "shape": "box", "size": size.tolist(), "position": place.tolist()}
        if rng.random() < 0.5:
            record = {"name": "in the way", "shape": "sphere", "radius": float(size[0]), "position": place.tolist()}
        if rng.random() < 0.2:
            record["velocity"] = rng.normal(0.0, 0.2, 3).tolist()
            _move(record, -np.array(record["velocity"]) * moment)
        self.records.append({**record, "clearance": float(rng.choice([0.0, 0.01]))})


def _move(record: Record, step: Vector) -> None:
    """Move an obstacle by `step` (3,)."""
    for key in ("position", "from", "to", "point"):
        if key in record:
            record[key] = (np.array(record[key]) + step).tolist()
