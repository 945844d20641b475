"""What stands around the machine while it moves: obstacles that come, go and move, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Vector
from backhoe_planner.errors import InputError
from backhoe_planner.live.braking.separation import MACHINE, Separation
from backhoe_planner.machine import Robot, voxel_boxes
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle, Scene, build_obstacle, obstacle_from_dict, obstacle_shapes

_FARTHEST = 1000.0  # m
_VOXELS = (0.001, 100.0)  # m


@dataclass
class _Placed:
    """An obstacle that is there: its number among the pairs, and how far it has moved since [m]."""

    number: int
    obstacle: Obstacle
    velocity: Vector
    shift: Vector


class Surroundings:
    """The obstacles of a scene, and what becomes of them; their pairs are those of `separation`.

    Attributes
    ----------
    stands: (P,) of every pair whether its obstacle stands still.
    speed: (P,) of every pair's obstacle [m/s].
    anything_moves: whether any obstacle does, also one that no link minds.
    revision: how often anything was put there, taken away, moved by hand or given another velocity.
    """

    def __init__(self, robot: Robot, scene: Scene, separation: Separation) -> None:
        self._robot, self._scene, self._separation = robot, scene, separation
        self._placed: dict[str, _Placed] = {}
        self._waiting: list[Obstacle] = []
        self._next_number = 0
        self._name_of: dict[int, str] = {}
        self._movers: list[_Placed] = []
        self.stands: Flags
        self.speed: Vector
        self.revision = 0
        self._sort()

    @property
    def names(self) -> tuple[str, ...]:
        """Of what is there now."""
        return tuple(self._placed)

    def snapshot(self) -> tuple[Obstacle, ...]:
        """What is there now, each where it is now, with its present velocity."""
        return tuple(
            replace(
                placed.obstacle,
                pieces=tuple(_shifted(piece, placed.shift) for piece in placed.obstacle.pieces)
                if placed.shift.any()
                else placed.obstacle.pieces,
                velocity=placed.velocity.copy(),
            )
            for placed in self._placed.values()
        )

    def is_moving(self, name: str | None) -> bool:
        """Whether there is an obstacle of that name, or any, that has a velocity."""
        return any(name is None or placed.obstacle.name == name for placed in self._movers)

    def name_of(self, pair: int) -> str:
        """What the machine's link must not touch in this pair, in words."""
        owner = int(self._separation.owner[pair])
        return f"the machine itself ({self._separation.inner_link(pair)})" if owner == MACHINE else self._name_of[owner]

    def shift_of(self, name: str) -> Vector:
        """(3,) how far an obstacle has moved from where it was put [m]; InputError if there is none of that name."""
        return self._find(name).shift.copy()

    # --- what is to be put there -------------------------------------------------------

    def build(self, obstacle: Obstacle | Mapping[str, Any]) -> Obstacle:
        """An obstacle ready to be put there, see `Servo.add`."""
        if isinstance(obstacle, Mapping):
            spec = obstacle_from_dict(obstacle)
            for link in spec.links or ():
                if link not in self._robot.all_link_names:
                    raise InputError("the machine has no such link", key=f"{spec.name}.links", found=link)
            obstacle = build_obstacle(spec, folder=self._scene.folder, clearance=self._scene.clearance)
        if obstacle.name in self._placed or self._is_waiting(obstacle.name):
            raise InputError("there is an obstacle of that name", key="name", found=obstacle.name)
        return obstacle

    def build_scan(self, name: str, points: object, *, resolution: float, clearance: float | None) -> Obstacle | None:
        """Voxels in which points (k, 3) lie, as an obstacle; None without points. See `Servo.add_points`."""
        if not isinstance(name, str) or not name:
            raise InputError("is no name", key="name", found=name)
        if self._is_waiting(name) or (
            name in self._placed and not isinstance(self._placed[name].obstacle.spec, obstacle_shapes.PointCloud)
        ):
            raise InputError("there is an obstacle of that name, which is no scan", key="name", found=name)
        try:
            cloud = np.array(points, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError("are not points", key=name) from error
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise InputError("are not points", key=name, found=f"shape {cloud.shape}", allowed="(k, 3)")
        if not (np.abs(cloud) <= _FARTHEST).all():
            raise InputError("lie too far away", key=name, allowed=f"numbers of at most {_FARTHEST:g} m")
        resolution = number_within("resolution", resolution, *_VOXELS)
        if clearance is not None:
            clearance = number_within("clearance", clearance, 0.0, _FARTHEST)
        if len(cloud) == 0:
            return None
        boxes = voxel_boxes(cloud, resolution)
        return Obstacle(
            name=name,
            pieces=tuple(shapes.box(size, pin.SE3(np.eye(3), centre)) for centre, size in boxes),
            clearance=self._scene.clearance if clearance is None else clearance,
            links=None,
            appears_at=0.0,
            velocity=np.zeros(3),
            spec=obstacle_shapes.PointCloud(name=name, shape="pointcloud", file="", resolution=resolution),
        )

    # --- changes -----------------------------------------------------------------------

    def put(self, obstacle: Obstacle, *, now: float) -> Indices:
        """Indices of the new pairs; none where the obstacle only appears after `now` [s]."""
        if obstacle.appears_at > 0.0:
            self._waiting.append(replace(obstacle, appears_at=obstacle.appears_at + now))
            return np.zeros(0, dtype=np.intp)
        number = self._next_number
        self._next_number += 1
        self._placed[obstacle.name] = _Placed(number, obstacle, np.array(obstacle.velocity), np.zeros(3))
        self._name_of[number] = obstacle.name
        pairs = self._separation.add(number, obstacle)
        self._separation.place_at(number, self._placed[obstacle.name].shift)
        self.revision += 1
        self._sort()
        return pairs

    def due(self, now: float) -> list[Obstacle]:
        """What appears by now, to be put there."""
        if not self._waiting:
            return []
        due = [replace(obstacle, appears_at=0.0) for obstacle in self._waiting if obstacle.appears_at <= now]
        self._waiting = [obstacle for obstacle in self._waiting if obstacle.appears_at > now]
        return due

    def take_away(self, name: str) -> Flags:
        """(P,) which of the pairs are left. What is still to appear is taken away as well."""
        if self._is_waiting(name):
            self._waiting = [obstacle for obstacle in self._waiting if obstacle.name != name]
            return np.ones(len(self._separation), dtype=bool)
        placed = self._find(name)
        self._movers = [mover for mover in self._movers if mover is not placed]
        del self._placed[name], self._name_of[placed.number]
        kept = self._separation.remove(placed.number)
        self.revision += 1
        self._sort()
        return kept

    def move(self, name: str, by: object) -> Indices:
        """Indices of the pairs of an obstacle that now stands elsewhere."""
        placed = self._find(name)
        placed.shift[:] = _three(placed.shift + _three(by, "by"), "by")
        self.revision += 1
        return self._pairs(placed)

    def set_velocity(self, name: str, velocity: object) -> Indices:
        """Indices of the pairs of an obstacle that now moves otherwise."""
        placed = self._find(name)
        placed.velocity = _three(velocity, "velocity")
        self.revision += 1
        pairs = self._pairs(placed)
        self._separation.velocity[pairs] = placed.velocity
        self._sort()
        return pairs

    def drift(self, dt: float) -> None:
        """Let what moves move on for dt [s]; the planes of its pairs with it."""
        self._separation.offset += dt * self._separation.drift
        self._shifts += dt * self._velocities

    def _find(self, name: str) -> _Placed:
        if name not in self._placed:
            if self._is_waiting(name):
                raise InputError("the obstacle has not appeared yet", key="name", found=name)
            there = ", ".join(self._placed)
            raise InputError("there is no obstacle of that name", key="name", found=name, allowed=there)
        return self._placed[name]

    def _is_waiting(self, name: str) -> bool:
        return any(obstacle.name == name for obstacle in self._waiting)

    def _pairs(self, placed: _Placed) -> Indices:
        return np.asarray((self._separation.owner == placed.number).nonzero()[0])

    def _sort(self) -> None:
        """Tell what moves from what stands."""
        velocity = self._separation.velocity
        self.stands = np.asarray(~velocity.any(axis=1))
        self.speed = np.sqrt((velocity**2).sum(axis=1))
        for placed in self._movers:
            self._stands_at(placed, placed.shift.copy())
        self._movers = [placed for placed in self._placed.values() if placed.velocity.any()]
        self.anything_moves = len(self._movers) > 0
        # one array for all that moves, of which each holds its row
        self._velocities = np.array([placed.velocity for placed in self._movers]).reshape(-1, 3)
        self._shifts = np.array([placed.shift for placed in self._movers]).reshape(-1, 3)
        for placed, shift in zip(self._movers, self._shifts, strict=True):
            self._stands_at(placed, shift)

    def _stands_at(self, placed: _Placed, shift: Vector) -> None:
        placed.shift = shift
        self._separation.place_at(placed.number, shift)


def _shifted(piece: shapes.Piece, by: Vector) -> shapes.Piece:
    hull = piece.hull + by if len(piece.hull) else piece.hull
    placement = pin.SE3(piece.placement.rotation, piece.placement.translation + by)
    return replace(piece, placement=placement, hull=hull)


def _three(values: object, key: str) -> Vector:
    try:
        found = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        found = np.full(1, np.nan)
    if found.shape != (3,) or not (np.abs(found) <= _FARTHEST).all():
        raise InputError("is not a vector", key=key, found=values, allowed=f"three numbers of at most {_FARTHEST:g}")
    return found


def number_within(key: str, value: object, least: float, most: float) -> float:
    """A number between two bounds, or an error that names it.

    Raises
    ------
    InputError: it is none.
    """
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not least <= found <= most:
        raise InputError("is not a number in its range", key=key, found=value, allowed=f"{least:g} to {most:g}")
    return found
