"""Where the soil goes: postures over a heap or a truck, and what lies there afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.job.ground.heaps import Refusal, deposited
from backhoe_planner.job.ground.obstacle import terrain_obstacle
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.schema.work import Heap
from backhoe_planner.job.worksite import Worksite
from backhoe_planner.machine import JointLimits
from backhoe_planner.site import Obstacle

OPEN = -1.2  # rad: the pitch at which the bucket is empty; chosen, its plate then stands at 110 degrees
_POURS_AT = -0.1  # m of radius from the bucket's pin to where the soil falls, about: while the pitch goes through -pi/2
_ABOVE = 0.15  # m from the teeth of the open bucket to what lies there, beyond the clearance; chosen
_HIGHER = (0.0, 0.25, 0.5, 0.8, 1.2)  # m, tried beyond that in turn
_TILTS = (0.0, 0.25, 0.5)  # rad from level at which the bucket may arrive
_HEAP = 0.5  # m that a heap is high on the average, for estimates
_GROUND = "the ground"


@dataclass(frozen=True, eq=False)
class Site:
    """What changes on the site from cycle to cycle.

    Attributes
    ----------
    ground: as it is.
    obstacle: the same as an obstacle for all links.
    """

    ground: Terrain
    obstacle: Obstacle

    @classmethod
    def of(cls, ground: Terrain, *, clearance: float, before: Site | None = None) -> Site:
        """The ground with its obstacle; what was built for the ground `before` is used again."""
        earlier = None if before is None else before.obstacle
        return cls(ground, terrain_obstacle(ground, _GROUND, clearance, before=earlier))


@dataclass(frozen=True, eq=False)
class Dumping:
    """One place at which a bucketful can be dumped.

    Attributes
    ----------
    place: (3,) the top of what lies there afterwards [m], world.
    arrivals: (k, n) postures with the bucket level over it, the lowest first.
    openings: (k, n) the same with the bucket open.
    after: the ground with it.
    truck: number of the truck, from 1; 0 for a heap.
    """

    place: Vector
    arrivals: Matrix
    openings: Matrix
    after: Terrain
    truck: int


class HeapDump:
    """Soil dumped on the ground.

    Parameters
    ----------
    site: the job on its machine.
    heap: where.
    """

    def __init__(self, site: Worksite, heap: Heap) -> None:
        self._site, self._heap = site, heap
        self._clear_of: Flags = site.design.within(site.nodes, heap.edge_distance)

    def near(self, start: Vector) -> tuple[Vector, Vector] | None:
        """(n,), (n,) postures, level and open, in which soil is dumped, soon reached from `start` (n,); for estimates."""
        level, limits = self._site.ground, self._site.problem.limits
        found = []
        for place in self._heap.places:
            row, column = _cell_of(level, np.array(place))
            arrivals, openings = postures_over(self._site, np.array(place), float(level.surface[row, column]) + _HEAP)
            found += list(zip(arrivals[:1], openings[:1], strict=True))
        return min(found, key=lambda ends: travel_time(ends[0] - start, limits), default=None)

    def options(self, ground: Terrain, volume: float, start: Vector) -> list[Dumping] | str:
        """Places at which `volume` [m^3] of loose soil can be dumped, the soonest reached from `start` (n,) first.

        Where there is none, why.
        """
        found: list[Dumping] = []
        refused = ""
        for place in self._heap.places:
            after = deposited(ground, place, volume, clear_of=self._clear_of)
            if isinstance(after, Refusal):
                refused = refused or after.reason
                continue
            row, column = _cell_of(after, np.array(place))
            around = after.surface[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
            top = float(around.max())
            arrivals, openings = postures_over(self._site, np.array(place), top)
            if not len(arrivals):
                refused = refused or f"the bucket cannot be emptied over x {place[0]:.2f}, y {place[1]:.2f} m: out of reach"
                continue
            found.append(Dumping(np.array([*place, top]), arrivals, openings, after, 0))
        if not found:
            return refused
        limits = self._site.problem.limits
        return sorted(found, key=lambda one: travel_time(one.arrivals[0] - start, limits))


def postures_over(site: Worksite, place: Vector, top: float) -> tuple[Matrix, Matrix]:
    """(k, n) postures with the bucket level over a place (2,) [m], and (k, n) with it open; from low to high.

    Parameters
    ----------
    top: height of what lies there afterwards [m].
    """
    plane, bucket, n = site.plane, site.bucket, site.robot.n
    off = place - plane.axis
    swing = swing_towards(site, off)
    limits = site.problem.limits
    arrivals, openings = [], []
    radius = float(np.hypot(*off)) - _POURS_AT + bucket.length * float(np.cos(OPEN))
    for higher in _HIGHER:
        z = top + site.problem.scene.clearance + _ABOVE + higher
        opened = plane.joints(swing, np.array([radius]), np.array([z]), np.array([OPEN]))[0]
        if np.isnan(opened).any():
            continue
        sense = _bucket_sense(site, opened)
        for tilt in _TILTS:
            level = opened.copy()
            level[n - 1] += sense * (bucket.level_pitch + tilt - OPEN)
            if limits.lower[n - 1] <= level[n - 1] <= limits.upper[n - 1]:
                arrivals.append(level)
                openings.append(opened)
                break
    return np.array(arrivals).reshape(-1, n), np.array(openings).reshape(-1, n)


def swing_towards(site: Worksite, off: Vector) -> float:
    """The swing angle at which the arm's plane goes through a point `off` (2,) from the swing axis [rad]."""
    plane = site.plane
    if not plane.swings:
        return 0.0
    zero = plane.heading(0.0)
    turn = plane.heading(1.0) - zero
    angle = (float(np.arctan2(off[1], off[0])) - zero + np.pi) % (2.0 * np.pi) - np.pi
    return angle / turn


def _bucket_sense(site: Worksite, q: Vector) -> float:
    """By how much the pitch rises with the last joint, 1 or -1."""
    ahead = q.copy()
    ahead[-1] += 1e-3
    pitches = site.plane.place(np.array([q, ahead]))[2]
    return float(np.sign((pitches[1] - pitches[0] + np.pi) % (2.0 * np.pi) - np.pi))


def travel_time(step: Vector, limits: JointLimits) -> float:
    """The least time for a `step` (n,) of the joints from rest to rest, by their rates and accelerations [s]."""
    way = np.abs(step)
    ramps = way * limits.acceleration < limits.velocity**2
    slow = 2.0 * np.sqrt(way / limits.acceleration)
    fast = way / limits.velocity + limits.velocity / limits.acceleration
    return float(np.max(np.where(ramps, slow, fast)))


def _cell_of(ground: Terrain, place: Vector) -> tuple[int, int]:
    column, row = np.clip(np.round((place - ground.low) / ground.cell), 0, np.array(ground.shape[::-1]) - 1).astype(int)
    return int(row), int(column)


def of_links(obstacle: Obstacle, links: Sequence[str]) -> Obstacle:
    """The same obstacle for some links alone."""
    from dataclasses import replace

    return replace(obstacle, links=tuple(links))


def dump_of(site: Worksite) -> HeapDump:
    """Where the soil of a job goes."""
    heap = site.job.dump.heap
    assert heap is not None
    return HeapDump(site, heap)
