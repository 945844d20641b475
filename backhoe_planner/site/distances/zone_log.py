"""Zones: how near to them the machine came, and how much slower it must move there.

A zone has three distances, stop <= slow <= warn. `stop` is the clearance of an obstacle, or
for a swing sector the distance to a joint limit. Between `slow` and `stop` the servo goes
slower; within `warn` the visit is only reported.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from backhoe_planner.arrays import Matrix, Vector, as_array, as_number
from backhoe_planner.errors import InputError
from backhoe_planner.machine import Robot
from backhoe_planner.site.distances.proximity import Proximity
from backhoe_planner.site.limits import joints_on_site, swing_sectors
from backhoe_planner.site.obstacles import build_obstacles
from backhoe_planner.site.scene_file import Scene
from backhoe_planner.site.schema.zone_kinds import ZoneSpec

Level = Literal["warn", "slow", "stop"]

_Key = tuple[str, Level]

_SLOWEST = 0.15  # part of the speed that is left at the stop distance, so that one can leave; chosen
# m or rad: a machine at its stop distance is not beyond it; a little more than `proof.clearances.KEPT_WITHIN`
_KEPT_WITHIN = 1.2e-4
_LEFT_AT = 0.01  # m or rad outside a distance at which a visit is over; chosen, more than a machine trembles
_MOST_MOMENTS = 10_000  # of one motion; chosen, 200 s at the period below
_SAMPLED_EVERY = 0.02  # s between moments: a link at 1 m/s moves by 2 cm


def pace(margin: float, room: float) -> float:
    """The part of the wished speed that is allowed near a zone, 0.15 to 1.

    It is 1 from `room` on, and falls along a cosine to 0.15 at the stop distance.

    Parameters
    ----------
    margin: distance to the stop distance [m or rad].
    room: the margin below which the speed falls [m or rad].
    """
    if margin >= room:
        return 1.0
    part = max(margin, 0.0) / room
    return _SLOWEST + (1.0 - _SLOWEST) * 0.5 * (1.0 - math.cos(math.pi * part))


@dataclass(frozen=True)
class Transgression:
    """One visit beyond one distance of one zone.

    Attributes
    ----------
    zone, kind: name and kind of the zone.
    level: which of its distances was passed.
    link: the link that was deepest; for a swing sector the joint.
    begin, end: of the visit [s].
    time: when it was deepest [s].
    depth: how far beyond the distance [m], for a swing sector [rad].
    """

    zone: str
    kind: str
    level: Level
    link: str
    begin: float
    end: float
    time: float
    depth: float

    @property
    def unit(self) -> str:
        """Unit of the depth."""
        return "rad" if self.kind == "swing_sector" else "m"

    def __str__(self) -> str:
        deep = f"{self.depth:.3f} {self.unit}"
        return f"{self.link} {deep} beyond the {self.level} distance of {self.zone} at {self.time:.2f} s"


class Motion(Protocol):
    """Joint positions over time."""

    @property
    def time(self) -> Vector:
        """(T,) [s]."""

    @property
    def q(self) -> Matrix:
        """(T, n) [rad or m]."""


class ZoneLog:
    """Records every visit to a scene's zones, sample by sample.

    It owns its working memory: do not share one between threads.

    Parameters
    ----------
    robot, scene: the machine, and the site with its zones.

    Raises
    ------
    SceneError: a zone does not fit the machine.

    Examples
    --------
    From a servo: ``state = servo.step(wish); log.note(state.time, state.q)``.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._robot = robot = joints_on_site(robot, scene)
        self._solids = tuple(obstacle for obstacle in build_obstacles(scene, robot) if obstacle.zone is not None)
        self._proximity = Proximity(self._robot, self._solids, self_collision=False)
        self._sectors = tuple(swing_sectors(robot, scene).values())
        self._zones: dict[str, ZoneSpec] = {zone.name: zone for zone in scene.zones}
        room = [0.0 if o.zone is None else o.zone.warn_distance - o.zone.stop for o in self._solids]
        self._warn = np.array(room)[self._proximity.owner] if len(self._proximity.pairs) else np.zeros(0)
        self._visits: dict[_Key, Transgression] = {}
        self._over: list[Transgression] = []
        self._last = -math.inf  # s

    @property
    def transgressions(self) -> tuple[Transgression, ...]:
        """All visits so far, including those not over yet, in the order in which they began."""
        return tuple(sorted([*self._over, *self._visits.values()], key=lambda visit: visit.begin))

    def note(self, time: float, q: object) -> dict[str, Level]:
        """Record a sample.

        Parameters
        ----------
        time: not before that of the last sample [s].
        q: (n,) joint positions [rad or m].

        Returns
        -------
        For every zone that the machine is too near to, the innermost distance that it has passed.

        Raises
        ------
        InputError: `q` does not fit the machine, or `time` is before that of the last sample.
        """
        posture = self._robot.check_q(q)
        time = as_number(time, key="time")
        if time < self._last:
            raise InputError("runs backwards", key="time", found=time, allowed=f"{self._last:g} s or later")
        self._last = time
        within: dict[str, Level] = {}
        kept: dict[_Key, Transgression] = {}
        for zone, link, distance in self._distances(posture):
            for level, limit in _limits(zone):
                visit = self._visits.pop((zone.name, level), None)
                depth = limit - distance
                beyond = depth > (_KEPT_WITHIN if level == "stop" else 0.0)
                if beyond:
                    within[zone.name] = level
                if visit is None and beyond:
                    visit = Transgression(zone.name, zone.kind, level, link, time, time, time, depth)
                elif visit is not None and depth > visit.depth:
                    visit = replace(visit, link=link, end=time, time=time, depth=depth)
                elif visit is not None and depth <= -_LEFT_AT:
                    self._over.append(visit)
                    visit = None
                if visit is not None:
                    kept[(zone.name, level)] = replace(visit, end=time) if beyond else visit
        self._over.extend(self._visits.values())
        self._visits = kept
        return within

    def _distances(self, q: Vector) -> Iterable[tuple[ZoneSpec, str, float]]:
        """The zones that are near, with the nearest link and its distance."""
        if len(self._proximity.pairs):
            near = self._proximity.at(q, margin=self._warn + 2.0 * _LEFT_AT)
            seen: set[int] = set()
            for row in np.argsort(near.distance, kind="stable").tolist():
                pair = int(near.pair[row])
                owner = int(self._proximity.owner[pair])
                if owner in seen:
                    continue
                seen.add(owner)
                zone = self._zones[self._solids[owner].name]
                yield zone, self._proximity.pairs[pair].link, float(near.distance[row])
        for sector in self._sectors:
            swing = float(q[0])
            yield sector, self._robot.joint_names[0], min(swing - sector.start, sector.end - swing)


def _limits(zone: ZoneSpec) -> list[tuple[Level, float]]:
    """The zone's distances from the outermost to the innermost; of equal distances only the innermost."""
    by_distance: dict[float, Level]
    by_distance = {zone.warn_distance: "warn", zone.slow_distance: "slow", zone.stop: "stop"}
    return [(level, distance) for distance, level in by_distance.items()]


def zone_log(robot: Robot, scene: Scene, trajectory: Motion) -> tuple[Transgression, ...]:
    """Every visit of a whole motion to the scene's zones.

    The motion is checked every 0.02 s, or at 10,000 even moments if it is longer than
    200 s; and at its own samples, unless these are more than twice as many.

    Parameters
    ----------
    robot, scene: the machine, and the site with its zones.
    trajectory: any motion with `time` (T,) [s] and `q` (T, n) [rad or m].

    Raises
    ------
    SceneError: a zone does not fit the machine.
    InputError: the motion has another number of joints.
    """
    robot = joints_on_site(robot, scene)
    time = as_array(getattr(trajectory, "time", None), None, key="trajectory.time")
    q = as_array(getattr(trajectory, "q", None), len(time), robot.n, key="trajectory.q")
    if not len(time) or (np.diff(time) < 0.0).any():
        raise InputError("are not moments in their order", key="trajectory.time", found=reprlib.repr(time.tolist()))
    if not scene.zones:
        return ()
    log = ZoneLog(robot, scene)
    count = min(max(int(np.ceil((time[-1] - time[0]) / _SAMPLED_EVERY)), 0), _MOST_MOMENTS) + 1
    even = np.linspace(time[0], time[-1], count)
    moments = np.unique(np.concatenate((even, time))) if len(time) < 2 * count else even
    for moment, posture in zip(
        moments, np.column_stack([np.interp(moments, time, column) for column in q.T]), strict=True
    ):
        log.note(float(moment), posture)
    return log.transgressions


def worst_first(visits: Iterable[Transgression]) -> list[Transgression]:
    """Visits sorted by innermost distance first, then by depth, deepest first."""
    order = {"stop": 0, "slow": 1, "warn": 2}
    return sorted(visits, key=lambda visit: (order[visit.level], -visit.depth))
