"""The obstacles around the machine while it is driven: they can be added, moved and taken away.

An obstacle is accepted only if the machine keeps its clearance on the whole path that it needs for braking. So an
obstacle that a person drops or drags never ends up inside the machine.

Zones, planes, terrain and scans belong to the site itself and cannot be changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError
from backhoe_planner.live import Servo, shifted
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.show.drawing.timeline import ITSELF, CriticalPoint, critical_points
from backhoe_planner.show.teleop.changes import Change
from backhoe_planner.site import (
    Obstacle,
    Proximity,
    build_obstacle,
    build_obstacles,
    check_links,
    check_name,
)
from backhoe_planner.site.schema import obstacle_shapes

_MOST = 40  # obstacles; chosen, each costs time in every step
_BRAKING = 0.6  # part of the acceleration; chosen, less than the servo's `BRAKING`, so that the servo can brake sooner
_SPARE = 0.004  # m beyond the clearance; chosen, twice the servo's `BUFFER`, so that the servo begins with no violation
_DEPTH = 10  # halvings of the braking path in the proof that there is room; 1024 parts


@dataclass
class _Standing:
    """One obstacle, and when it came to its present place.

    Attributes
    ----------
    obstacle: the obstacle as it was first added.
    since: when it came to its present place; 0 if it was there from the beginning [s].
    moved: whether it was elsewhere just before.
    gauge: measures the distances to it.
    gauged_at: (3,) its displacement when the gauge was made [m].
    """

    obstacle: Obstacle
    since: float
    moved: bool
    gauge: Proximity
    gauged_at: Vector


class LiveSite:
    """The obstacles of one servo, and the machine's distance to each.

    The object owns its working memory, like the servo: use both from one thread at a time.
    """

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._itself = Proximity(servo.robot, ())
        self._standing: dict[str, _Standing] = {}
        for obstacle in build_obstacles(servo.scene, servo.robot):
            self._standing[obstacle.name] = self._stand(obstacle, 0.0, np.zeros(3))
        self._of_scene = frozenset(self._standing)
        self._taken: dict[str, tuple[Obstacle, Vector]] = {}  # each with its displacement (3,) [m]

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All obstacles as they were first added, including those that have not appeared yet."""
        return tuple(standing.obstacle for standing in self._standing.values())

    def shift_of(self, name: str) -> Vector | None:
        """(3,) displacement of an obstacle [m]; None if it has not appeared yet."""
        return self._servo.shift_of(name) if name in self._servo.obstacles else None

    def may_be_moved(self, name: str) -> bool:
        """Whether an obstacle has appeared, does not move by itself, and is not a part of the site itself."""
        return name in self._servo.obstacles and not self._stays(name) and not self._standing[name].obstacle.moves

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the scene's obstacles that were taken away and may be put back."""
        return tuple(self._taken)

    @property
    def names(self) -> dict[str, str]:
        """Every name that a new obstacle may not have, with its owner."""
        return (
            dict.fromkeys(self._standing, "an obstacle")
            | dict.fromkeys(self._taken, "an obstacle that may be put back")
            | {zone.name: "a zone of the scene" for zone in self._servo.scene.zones}
        )

    def add(self, spec: obstacle_shapes.ObstacleSpec) -> None:
        """Add an obstacle.

        Raises
        ------
        InputError: the name is in use, a link is not one of the machine's, there are too many obstacles, or this one
            leaves the machine no room.
        """
        check_name(spec.name, in_use=self.names, key="add")
        self._check_count("add")
        check_links(self._servo.robot, spec.links, key="add")
        obstacle = build_obstacle(spec, folder=self._servo.scene.folder, clearance=self._servo.scene.clearance)
        self._put(obstacle, np.zeros(3))

    def move(self, name: str, to: object) -> None:
        """Put an obstacle at the displacement `to` (3,) from its first place [m].

        Raises
        ------
        InputError: no obstacle has that name, it may not be moved, or it would leave the machine no room.
        """
        self._check_free(name, "move")
        shift = np.array(to, dtype=float)
        obstacle = self._standing[name].obstacle
        if obstacle.moves:
            raise InputError("moves by itself", key=name)
        moved = replace(self._with_room(obstacle, shift), moved=True)
        self._servo.move(name, shift - self._servo.shift_of(name))
        self._standing[name] = moved

    def remove(self, name: str) -> None:
        """Take an obstacle away; an obstacle of the scene may be put back.

        Raises
        ------
        InputError: no obstacle has that name, or it is a part of the site itself.
        """
        self._check_free(name, "remove")
        shift = self._servo.shift_of(name)
        self._servo.remove(name)
        standing = self._standing.pop(name)
        if name in self._of_scene:
            self._taken[name] = standing.obstacle, shift

    def put_back(self, name: str) -> None:
        """Put an obstacle of the scene back to where it was taken away.

        Raises
        ------
        InputError: no obstacle of that name was taken away, there are too many obstacles, or this one would leave the
            machine no room.
        """
        if name not in self._taken:
            raise InputError("no obstacle of that name was taken away", key="put_back", found=name)
        self._check_count("put_back")
        self._put(*self._taken[name])
        del self._taken[name]

    def _put(self, obstacle: Obstacle, shift: Vector) -> None:
        standing = self._with_room(obstacle, shift)
        self._servo.add(replace(obstacle, appears_at=0.0))
        if shift.any():
            self._servo.move(obstacle.name, shift)
        self._standing[obstacle.name] = standing

    def nearest(self, q: Vector) -> dict[str, CriticalPoint | None]:
        """The critical points at q (n,) to every obstacle and to the machine itself; None if they are far away."""
        within = 2.0 * self._servo.scene.influence
        found: dict[str, CriticalPoint | None] = dict.fromkeys(self._standing)
        for name in self._servo.obstacles:
            standing = self._standing[name]
            time, sight = self._gauge_time(standing), within + standing.obstacle.clearance
            found[name] = critical_points(standing.gauge, (name,), q, time=time, within=sight)[0]
        if self._itself.pairs:
            found[ITSELF] = critical_points(self._itself, (ITSELF,), q, time=0.0, within=within)[0]
        return found

    def records(self, begun: float) -> tuple[list[dict[str, Any]], list[Change]]:
        """The obstacles as in a scene file, for a recording that began at `begun` [s].

        Returns
        -------
        The records, and the moves that a scene file cannot express.
        """
        records, moves = [], []
        for name, standing in self._standing.items():
            obstacle = standing.obstacle
            if obstacle.zone is not None:  # it stays, and the scene's zones contain it
                continue
            spec, appears = obstacle.spec, max(obstacle.appears_at, standing.since)
            shift = self.shift_of(name)
            if shift is not None:
                # back to its place when the recording began, or when it came to its present place
                spec = spec.moved(shift - obstacle.velocity * (self._servo.time - max(appears, begun)))
            content = spec.model_dump(mode="json", by_alias=True, exclude_unset=True)
            content["appears_at"] = max(appears - begun, 0.0)
            records.append(content)
            if standing.since > begun and standing.moved:
                moves.append(Change(standing.since - begun, name, "moved"))
        return records, moves

    # --- room -----------------------------------------------------------------------

    def _stand(self, obstacle: Obstacle, since: float, shift: Vector) -> _Standing:
        there = replace(shifted(obstacle, shift), appears_at=0.0)
        return _Standing(obstacle, since, False, Proximity(self._servo.robot, (there,), self_collision=False), shift)

    def _gauge_time(self, standing: _Standing) -> float:
        """The time at which the gauge's obstacle is where the servo's is [s]."""
        velocity = standing.obstacle.velocity
        speed = float(velocity @ velocity)
        if speed == 0.0:
            return 0.0
        return float((self._servo.shift_of(standing.obstacle.name) - standing.gauged_at) @ velocity) / speed

    def _with_room(self, obstacle: Obstacle, shift: Vector) -> _Standing:
        """An obstacle that now comes to `shift` (3,) from its first place [m]; InputError if it has no room."""
        servo = self._servo
        standing = self._stand(obstacle, servo.time, shift)
        q, v = servo.q, servo.v
        time = float((np.abs(v) / (_BRAKING * servo.limits.acceleration)).max())
        end = q + (0.5 * time + servo.dt) * v
        if not segment_is_clear(standing.gauge, q, end, depth=_DEPTH, spare=_SPARE):
            problem, allowed = "is too close to the machine, or to where it can stop", f"{obstacle.clearance:.2f} m"
            raise InputError(problem, key=obstacle.name, allowed=f"{allowed} of clearance")
        return standing

    def _stays(self, name: str) -> bool:
        obstacle = self._standing[name].obstacle
        return obstacle.zone is not None or obstacle.spec.is_land

    def _check_count(self, key: str) -> None:
        if len(self._standing) >= _MOST:
            raise InputError("there are enough obstacles", key=key, allowed=f"up to {_MOST}")

    def _check_free(self, name: str, key: str) -> None:
        """Check that an obstacle is there and is not a part of the site itself."""
        if name not in self._servo.obstacles:
            raise InputError("there is no obstacle of that name", key=key, found=name)
        if self._stays(name):
            what = "ground or terrain" if self._standing[name].obstacle.zone is None else "a zone"
            raise InputError(f"is {what} of the scene, which stays where it is", key=name)
