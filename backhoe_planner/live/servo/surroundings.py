"""The obstacles around the machine while it moves: they are added, removed and moved by name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Flags, Indices, Vector, as_number, as_vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.live.planes.separation import MACHINE, Separation
from backhoe_planner.machine import Cluster, Robot
from backhoe_planner.site import (
    Obstacle,
    Obstruction,
    Scene,
    build_obstacle,
    check_links,
    check_name,
    obstacle_from_dict,
    scan_body,
)
from backhoe_planner.site.schema import obstacle_shapes

_FARTHEST = 1000.0  # m or m/s: chosen, beyond any site; a larger number is a slip
_VOXELS = (0.001, 100.0)  # m: shortest and longest edge; chosen, an edge outside is a slip


_Told: TypeAlias = tuple[Literal["obstacle", "machine"], str, str, float]


@dataclass
class _Placed:
    """A present obstacle: its number in `Separation`, velocity (3,) [m/s], and shift (3,) since it was added [m]."""

    number: int
    obstacle: Obstacle
    velocity: Vector
    shift: Vector
    moves: bool


class Surroundings:
    """The obstacles by name; `separation` holds their pairs, P in all.

    Attributes
    ----------
    stands: (P,) whether the pair's obstacle stands still.
    speed: (P,) of the pair's obstacle [m/s].
    anything_moves: whether any obstacle does, also one that has no pairs.
    revision: how often an obstacle was added, removed, moved by hand or given another velocity.
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
        # cached results of `_tell`, valid as long as the pairs and the set of them that counts stay the same
        self._told: dict[int, _Told] = {}
        self._told_for: Vector | None = None
        self._sort()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles that are present now."""
        return tuple(self._placed)

    def snapshot(self) -> tuple[Obstacle, ...]:
        """The obstacles present now, each at its present position and velocity."""
        return tuple(
            replace(shifted(placed.obstacle, placed.shift), velocity=placed.velocity.copy())
            for placed in self._placed.values()
        )

    @property
    def waiting(self) -> tuple[Obstacle, ...]:
        """The obstacles that have not appeared yet; `appears_at` is the servo's time."""
        return tuple(self._waiting)

    def is_moving(self, name: str | None) -> bool:
        """Whether the obstacle of that name, or any if `name` is None, has a velocity."""
        return any(name is None or placed.obstacle.name == name for placed in self._movers)

    def name_of(self, pair: int) -> str:
        """Name of the obstacle of a pair; empty if the pair is -1, or of the machine alone."""
        return self._name_of.get(int(self._separation.owner[pair]), "") if 0 <= pair < len(self._separation) else ""

    def obstruction(self, pair: int, margin: float, now: float) -> Obstruction:
        """A pair's link and what it must not touch, with the `margin` [m] found at the time `now` [s]."""
        separation = self._separation
        if self._told_for is not separation.clearance:  # there are other pairs, or others count
            self._told_for, self._told = separation.clearance, {}
        told = self._told.get(pair)
        if told is None:
            told = self._told[pair] = self._tell(pair)
        kind, name, link, clearance = told
        return Obstruction(kind, name, link, margin + clearance, margin, now)

    def _tell(self, pair: int) -> _Told:
        """Kind and name of what a pair's link must not touch, the link, and the clearance to be kept [m]."""
        separation, pieces = self._separation, self._separation.own.pieces
        owner, clearance = int(separation.owner[pair]), float(separation.clearance[pair])
        link = pieces[separation.piece[pair]].link
        if owner == MACHINE:
            return "machine", pieces[separation.other_piece[pair]].link, link, clearance
        return "obstacle", self._name_of[owner], link, clearance

    def shift_of(self, name: str) -> Vector:
        """(3,) how far an obstacle has moved from where it was added [m]; InputError if there is none of that name."""
        return self._find(name).shift.copy()

    # --- new obstacles -----------------------------------------------------------------

    def build(self, obstacle: Obstacle | Mapping[str, Any]) -> Obstacle:
        """An obstacle that is ready to be added, see `Servo.add`."""
        if isinstance(obstacle, Mapping):
            spec = obstacle_from_dict(obstacle)
            obstacle = build_obstacle(spec, folder=self._scene.folder, clearance=self._scene.clearance)
        check_kind(obstacle, Obstacle, key="obstacle")
        check_links(self._robot, obstacle.links, key=f"{obstacle.name}.links")
        in_use = self._names_in_use()
        if obstacle.zone is not None and obstacle.name not in self._placed:
            in_use.pop(obstacle.zone.name, None)  # the zone itself, which was removed, is added again
        check_name(obstacle.name, in_use=in_use)
        return obstacle

    def build_scan(self, name: str, points: object, *, resolution: float, clearance: float | None) -> Obstacle | None:
        """The voxels that contain points (k, 3), as an obstacle; None without points. See `Servo.add_points`."""
        replaced = self._placed.get(name) if isinstance(name, str) else None
        is_scan = replaced is not None and isinstance(replaced.obstacle.spec, obstacle_shapes.PointCloud)
        check_name(name, in_use={} if is_scan else self._names_in_use("an obstacle that is no scan"))
        try:
            cloud = np.array(points, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError("are not points", key=f"points of {name}") from error
        if cloud.shape == (0,):  # an empty list
            return None
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise InputError("are not points", key=f"points of {name}", found=f"shape {cloud.shape}", allowed="(k, 3)")
        wrong = np.argwhere(~(np.abs(cloud) <= _FARTHEST)).tolist()
        if wrong:
            row, column = wrong[0]
            raise InputError(
                "is too far away" if np.isfinite(cloud[row, column]) else "is not finite",
                key=f"points of {name}: point {row + 1}, coordinate {column + 1}",
                found=f"{cloud[row, column]:g}",
                allowed=f"numbers of at most {_FARTHEST:g} m",
            )
        resolution = as_number(resolution, key="resolution", least=_VOXELS[0], most=_VOXELS[1])
        if clearance is not None:
            clearance = as_number(clearance, key="clearance", least=0.0, most=_FARTHEST)
        if len(cloud) == 0:
            return None
        try:
            body = scan_body(cloud, resolution, pin.SE3.Identity())
        except InputError as error:
            raise InputError(str(error), key=f"points of {name}") from error
        cluster = body if isinstance(body, Cluster) else None
        return Obstacle(
            name=name,
            pieces=() if isinstance(body, Cluster) else tuple(body),
            clearance=self._scene.clearance if clearance is None else clearance,
            links=None,
            appears_at=0.0,
            velocity=np.zeros(3),
            spec=obstacle_shapes.PointCloud(name=name, shape="pointcloud", file="", resolution=resolution),
            cluster=cluster,
        )

    # --- changes -----------------------------------------------------------------------

    def put(self, obstacles: Iterable[Obstacle], *, now: float) -> Indices:
        """Add obstacles at the time `now` [s]; return the indices of the pairs of those that appear at once."""
        numbered: dict[int, Obstacle] = {}
        for obstacle in obstacles:
            if obstacle.appears_at > 0.0:
                self._waiting.append(replace(obstacle, appears_at=obstacle.appears_at + now))
                continue
            number = self._next_number
            self._next_number += 1
            velocity = np.array(obstacle.velocity)
            self._placed[obstacle.name] = _Placed(number, obstacle, velocity, np.zeros(3), bool(velocity.any()))
            self._name_of[number] = obstacle.name
            numbered[number] = obstacle
        if not numbered:
            return np.zeros(0, dtype=np.intp)
        pairs = self._separation.add(numbered)
        for number, obstacle in numbered.items():
            self._separation.place_at(number, self._placed[obstacle.name].shift)
        self.revision += len(numbered)
        self._sort()
        return pairs

    def slow_from(self, pairs: Indices) -> Vector:
        """(K,) margin within which the obstacles of `pairs` (K,) slow the machine down [m]; 0 if they do not."""
        owners, place = np.unique(self._separation.owner[pairs], return_inverse=True)
        slow = [self._placed[self._name_of[number]].obstacle.slow for number in owners.tolist()]
        return np.array(slow, dtype=float)[place]

    def due(self, now: float) -> list[Obstacle]:
        """Take the obstacles that have appeared by `now` [s] off the waiting list, to be added."""
        if not self._waiting:
            return []
        due = [replace(obstacle, appears_at=0.0) for obstacle in self._waiting if obstacle.appears_at <= now]
        self._waiting = [obstacle for obstacle in self._waiting if obstacle.appears_at > now]
        return due

    def take_away(self, name: str) -> Flags:
        """Remove an obstacle, also one that has not appeared yet, and return which pairs are left, (P,)."""
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
        """Move an obstacle by `by` (3,) [m], and return the indices of its pairs."""
        placed = self._find(name)
        placed.shift[:] = _three(placed.shift + _three(by, "by"), "by")
        self.revision += 1
        return self._pairs(placed)

    def set_velocity(self, name: str, velocity: object) -> Indices:
        """Give an obstacle a velocity (3,) [m/s], and return the indices of its pairs."""
        placed = self._find(name)
        placed.velocity = _three(velocity, "velocity")
        placed.moves = bool(placed.velocity.any())
        self.revision += 1
        pairs = self._pairs(placed)
        self._separation.velocity[pairs] = placed.velocity
        for one in self._separation.clusters:
            if one.number == placed.number:
                one.speed = float(np.linalg.norm(placed.velocity))
                self._separation.places.note(one)
        self._sort()
        return pairs

    def drift(self, dt: float) -> None:
        """Let the obstacles that move, and the planes of their pairs, move on for dt [s]."""
        self._separation.planes[:, 3] += dt * self._separation.drift
        self._shifts += dt * self._velocities
        for one in self._separation.clusters:
            if one.speed > 0.0:
                one.covered -= dt * one.speed
                self._separation.places.note(one)

    def _find(self, name: str) -> _Placed:
        if check_kind(name, str, key="name") not in self._placed:
            if self._is_waiting(name):
                raise InputError("the obstacle has not appeared yet", key="name", found=name)
            there = ", ".join(self._placed)
            raise InputError("there is no obstacle of that name", key="name", found=name, allowed=there)
        return self._placed[name]

    def _names_in_use(self, obstacles: str = "an obstacle") -> dict[str, str]:
        """Every name that nothing new may have, with what has it; `obstacles` says what to call an obstacle."""
        names = [*self._placed, *(obstacle.name for obstacle in self._waiting)]
        return dict.fromkeys(names, obstacles) | {zone.name: "a zone of the scene" for zone in self._scene.zones}

    def _is_waiting(self, name: str) -> bool:
        return any(obstacle.name == name for obstacle in self._waiting)

    def _pairs(self, placed: _Placed) -> Indices:
        return np.asarray((self._separation.owner == placed.number).nonzero()[0])

    def _sort(self) -> None:
        """Find out which obstacles move."""
        velocity = self._separation.velocity
        self.stands = np.asarray(~velocity.any(axis=1))
        self.speed = np.sqrt((velocity**2).sum(axis=1))
        for placed in self._movers:
            self._stands_at(placed, placed.shift.copy())
        self._movers = [placed for placed in self._placed.values() if placed.moves]
        self.anything_moves = len(self._movers) > 0
        # one array for all moving obstacles, so that a step moves them at once; each obstacle holds its row of it
        self._velocities = np.array([placed.velocity for placed in self._movers]).reshape(-1, 3)
        self._shifts = np.array([placed.shift for placed in self._movers]).reshape(-1, 3)
        for placed, shift in zip(self._movers, self._shifts, strict=True):
            self._stands_at(placed, shift)

    def _stands_at(self, placed: _Placed, shift: Vector) -> None:
        placed.shift = shift
        self._separation.place_at(placed.number, shift)


def shifted(obstacle: Obstacle, by: Vector) -> Obstacle:
    """The same obstacle, shifted by `by` (3,) from where it was built [m]."""
    if not by.any():
        return obstacle
    pieces = tuple(
        replace(
            piece,
            placement=pin.SE3(piece.placement.rotation, piece.placement.translation + by),
            hull=piece.hull + by if len(piece.hull) else piece.hull,
        )
        for piece in obstacle.pieces
    )
    cluster = None if obstacle.cluster is None else obstacle.cluster.shifted(by)
    return replace(obstacle, pieces=pieces, cluster=cluster)


def _three(values: object, key: str) -> Vector:
    found = as_vector(values, 3, key=key)
    if not (np.abs(found) <= _FARTHEST).all():
        raise InputError(
            "is too long", key=key, found=found.tolist(), allowed=f"three numbers of at most {_FARTHEST:g}"
        )
    return found.copy()
