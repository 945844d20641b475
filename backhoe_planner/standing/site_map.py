"""The site map: the cost of a cubic metre from every place, at its best heading, or why no machine can stand there."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Array, Matrix, Vector
from backhoe_planner.job import UNEVEN, Job, Worksite, off_ground_obstacles
from backhoe_planner.machine import Base
from backhoe_planner.site import build_obstacles, stands_in, starts_in
from backhoe_planner.standing.dig_area import DigArea
from backhoe_planner.standing.machine_footprint import MachineFootprint, axis_offset, convex_outline
from backhoe_planner.standing.reach_map import DumpTable, ReachMap, dump_table

LINE_STEP, GRID_STEP = 0.1, 0.4  # m between places on a trench's line, and on a grid; chosen
_HEADINGS = 13  # at a place; chosen, 13 degrees apart for a swing of 180
_SPARE = 0.03  # rad from the ends of the swing
_HEAP = 0.5  # m, least height of a heap
_TRUCK = 0.3  # m between the machine and a truck; chosen
SAME_SHARE = 0.02  # of the soil: places that dig so much less count as equal
_SAME_COST = 0.02  # of the cost: then the heading that reaches more dumps is taken; the map is no finer than that
_ENOUGH_DUMPS = 3  # reached from a heading: more is no reason to turn the machine; chosen
# the later, the closer to a usable place
REASONS = ("line", "reach", "dump", "edge", "unknown", "ground", "heap", "obstacle")
_WORDS = {
    "line": "not in line with the trench",
    "reach": "out of reach",
    "dump": "no dump in reach",
    "edge": "on the dig, or too near its edge",
    "unknown": "the ground there is not known: ground.low and ground.high leave it out, or the file does",
    "ground": "the ground is not level there",
    "heap": "on the heap or the truck",
    "obstacle": "in",
}


@dataclass(frozen=True, eq=False)
class Spot:
    """A place on a `SiteMap`, with its approximate cost, or why the machine cannot stand there.

    Attributes
    ----------
    base: of the machine, at its best heading; at any heading if it cannot stand there.
    cost: approximate objective per bank m^3 [s/m^3 or J/m^3]; nan if the machine cannot stand there.
    share: of the soil that the teeth reach from there.
    dumps: numbers of the places to dump that are used from there.
    reason: why the machine cannot stand there; empty if it can.
    why: the same in words.
    """

    base: Base
    cost: float
    share: float
    dumps: tuple[int, ...]
    reason: str = ""
    why: str = ""


@dataclass(frozen=True, eq=False)
class DumpPlace:
    """A place to dump.

    Attributes
    ----------
    place: (2,) position [m].
    table: for emptying the bucket there.
    keep_off: (k, 2) points [m] that the machine keeps `distance` [m] away from.
    """

    place: Vector
    table: DumpTable
    keep_off: Matrix
    distance: float

    @property
    def outline(self) -> Matrix:
        """(k, 2) convex outline of the area from which the machine keeps away [m]."""
        return convex_outline(self.keep_off, self.distance)


class SpotFinder:
    """Evaluates places.

    Parameters
    ----------
    job: its machine is to be placed.
    site: the job's worksite without obstacles.
    area: to be dug.
    reach: of the machine.
    """

    def __init__(self, job: Job, site: Worksite, area: DigArea, reach: ReachMap) -> None:
        self.area, self.reach, self.site = area, reach, site
        self.footprint = MachineFootprint(site.robot)
        self._job, self._obstacles = job, (
            *build_obstacles(job.site_scene, site.robot),
            *off_ground_obstacles(site.ground.off_ground, job.site_scene.clearance),
        )  # fmt: skip
        plane, base = site.plane, site.robot.base
        self._offset = axis_offset(plane.axis, base)
        self._zero = plane.heading(0.0) - base.heading
        self._sense = math.copysign(1.0, plane.heading(1.0) - plane.heading(0.0)) if plane.swings else 1.0
        self.dumps = _dump_places(job, site, float(area.soil.sum()), area.ground)

    def for_area(self, area: DigArea) -> SpotFinder:
        """The same finder for another part of the dig."""
        found = copy.copy(self)
        found.area = area
        foot = _heap_foot(self._job, float(area.soil.sum()))
        if self._job.dump.heap is not None:
            found.dumps = tuple(replace(dump, distance=foot) for dump in self.dumps)
        return found

    def at(self, axis: Vector, *, toward: Vector | None = None, dumps: Sequence[int] | None = None) -> Spot:
        """The best heading of a machine whose swing axis is at `axis` (2,) [m].

        Parameters
        ----------
        toward: (2,) the direction of digging; by default towards the middle of the dig.
        dumps: numbers of the places to dump that may be used; by default all.
        """
        area, reach = self.area, self.reach
        ahead = area.middle - axis if toward is None else toward
        target = math.atan2(ahead[1], ahead[0])
        off = area.points - axis
        r = np.hypot(off[:, 0], off[:, 1])
        angle = np.arctan2(off[:, 1], off[:, 0])
        reached = reach.reaches(r, area.z + self._job.dig.tolerance) & area.covered(axis)
        none = Base(tuple(axis - self._offset), 0.0)
        if not reached.any():
            return Spot(none, math.nan, 0.0, (), "reach", _WORDS["reach"])
        numbers = tuple(range(len(self.dumps))) if dumps is None else tuple(dumps)
        each = [self._dump_cost(axis, r, angle, number) for number in numbers]
        cost = np.array([one[0] for one in each]).reshape(len(numbers), len(r))
        bearing = np.array([one[1] for one in each])
        usable = np.isfinite(cost[:, reached]).any(axis=1) if len(numbers) else np.zeros(0, dtype=bool)
        best: Spot | None = None
        worst = Spot(none, math.nan, 0.0, (), "dump", _WORDS["dump"])
        lower, upper = float(reach.swings[0]) + _SPARE, float(reach.swings[1]) - _SPARE
        if lower >= upper:  # a machine that does not swing
            lower, upper = -_SPARE, _SPARE
        for swing in _swings_between(lower, upper):
            heading = _wrapped(target - self._zero - self._sense * float(swing))
            turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
            base = Base(tuple(axis - turn @ self._offset), heading)
            own = self._swings(angle, heading)
            within = reached & (own >= lower) & (own <= upper)
            there = self._swings(bearing, heading)
            can = usable & (there >= lower) & (there <= upper)
            share = float(area.soil[within].sum() / area.soil.sum())
            if share <= 0.0:
                worst = _later(worst, Spot(base, math.nan, 0.0, (), "reach", _WORDS["reach"]))
                continue
            if not can.any():
                worst = _later(worst, Spot(base, math.nan, share, (), "dump", _WORDS["dump"]))
                continue
            reason, name, clear = self._stands(base, [n for n, ok in zip(numbers, can, strict=True) if ok])
            if reason:
                why = f"{_WORDS[reason]} {name}".strip()
                worst = _later(worst, Spot(base, math.nan, share, (), reason, why))
                continue
            rows = [row for row, number in enumerate(numbers) if can[row] and number in clear]
            least = np.min(cost[rows], axis=0)
            fine = within & np.isfinite(least)
            value = float(area.soil[fine] @ least[fine] / area.soil[fine].sum()) if fine.any() else math.nan
            spot = Spot(base, value, share, tuple(numbers[row] for row in rows))
            if math.isfinite(value) and (best is None or _is_better(spot, best)):
                best = spot
        return worst if best is None else best

    def _swings(self, angle: Array, heading: float) -> Array:
        return self._sense * ((angle - heading - self._zero + np.pi) % (2.0 * np.pi) - np.pi)

    def _dump_cost(self, axis: Vector, r: Vector, angle: Vector, number: int) -> tuple[Vector, float]:
        """(C,) cost per m^3 of soil that is taken to a dump, and the dump's bearing [rad]."""
        dump = self.dumps[number]
        x, y = dump.place - axis
        bearing = math.atan2(y, x)
        turn = (angle - bearing + np.pi) % (2.0 * np.pi) - np.pi
        return self._job.objective_of(*self.reach.cycle(r, turn, dump.table, math.hypot(x, y))), bearing

    def _stands(self, base: Base, dumps: Sequence[int]) -> tuple[str, str, tuple[int, ...]]:
        """Why the machine cannot stand at a base, with the obstacle's name; and the dumps that it is clear of."""
        area, footprint = self.area, self.footprint
        near = footprint.distances(base, area.keep_off).min() if len(area.keep_off) else math.inf
        if near <= area.distance:
            return "edge", "", ()
        if reason := self._bad_ground(base):
            return reason, "", ()
        clear = tuple(
            number for number in dumps
            if footprint.distances(base, self.dumps[number].keep_off).min() > self.dumps[number].distance
        )  # fmt: skip
        if not clear:
            return "heap", "", ()
        found = stands_in(self.site.robot, self._obstacles, base=base, with_clearance=True)
        if found is not None:
            return "obstacle", f"the way of {found.obstacle}, with its {found.link}", ()
        start = self.site.problem.start_q
        found = None if start is None else starts_in(self.site.robot, self._obstacles, start, base=base)
        if found is not None:
            return "obstacle", f"the way of {found.obstacle}, with its {found.link} as the job starts", ()
        return "", "", clear

    def _bad_ground(self, base: Base) -> str:
        """Why the ground under the machine is not fit for it: not known, or not level with it; empty if it is fit."""
        if not self.footprint.outlines:
            return ""
        points = np.vstack(self.footprint.placed(base))
        heights = self.site.ground.height_at(points)
        if self._job.ground.file is None:
            heights = np.where(np.isfinite(heights), heights, self._job.ground.level or 0.0)
        if np.nanmax(np.abs(heights), initial=0.0) > UNEVEN:
            return "ground"
        return "" if np.isfinite(heights).all() else "unknown"


def _later(one: Spot, other: Spot) -> Spot:
    """Of two places where the machine cannot stand, the one that is closer to being usable."""
    return other if REASONS.index(other.reason) > REASONS.index(one.reason) else one


def _is_better(spot: Spot, best: Spot) -> bool:
    """Whether a heading is better than another at the same place: by reach, then by cost, then by number of dumps."""
    if abs(spot.share - best.share) > SAME_SHARE:
        return spot.share > best.share
    if abs(spot.cost - best.cost) > _SAME_COST * best.cost:
        return spot.cost < best.cost
    return min(len(spot.dumps), _ENOUGH_DUMPS) > min(len(best.dumps), _ENOUGH_DUMPS)


def _swings_between(lower: float, upper: float) -> Vector:
    """Swing angles at which digging is possible [rad], the straightest first."""
    if upper <= 2.0 * _SPARE:
        return np.zeros(1)
    found = np.linspace(lower, upper, _HEADINGS)
    return np.asarray(found[np.argsort(np.abs(found), kind="stable")])


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def _dump_places(job: Job, site: Worksite, bank: float, ground: float) -> tuple[DumpPlace, ...]:
    heap, truck = job.dump.heap, job.dump.truck
    if heap is not None:
        # the place that is reached soonest takes all soil that it has room for: each may become the whole heap
        foot = _heap_foot(job, bank)
        # the bucket must be emptied over the heaps as they are at the end, each with its part of the soil
        each = math.tan(job.soil.repose) * _heap_foot(job, bank / len(heap.places))
        table = dump_table(site, ground + max(_HEAP, each))
        return tuple(DumpPlace(np.array(at), table, np.array([at]), foot) for at in heap.places)
    assert truck is not None
    x, y, z = truck.bed.position
    length, width, height = truck.bed.size
    ahead = np.array([math.cos(truck.bed.yaw), math.sin(truck.bed.yaw)])
    left = np.array([-ahead[1], ahead[0]])
    u, v = (np.linspace(-0.5, 0.5, max(int(size / 0.2), 2)) * size for size in (length, width))
    bed = (np.array([x, y]) + u[:, None, None] * ahead + v[None, :, None] * left).reshape(-1, 2)
    table = dump_table(site, z + height)
    return tuple(
        DumpPlace(np.array([x, y]) + part * length * ahead, table, bed, _TRUCK) for part in (0.0, -0.25, 0.25)
    )  # fmt: skip


def _heap_foot(job: Job, bank: float) -> float:
    """The radius of a heap of all the soil that is dug [m]."""
    return float((3.0 * bank * job.soil.swell / (math.pi * math.tan(job.soil.repose))) ** (1.0 / 3.0))


@dataclass(frozen=True, eq=False)
class SiteMap:
    """Costs by place on a grid that is aligned with the dig.

    Attributes
    ----------
    spots: (rows, columns) places; rows are numbered across the dig, columns along it.
    x, y: (rows, columns) of the swing axis [m].
    cell: distance between columns, and between rows [m].
    along: (2,) unit vector from column to column.
    outline: (k, 2) corners of a convex outline of the dig [m].
    """

    spots: tuple[tuple[Spot, ...], ...]
    x: Matrix
    y: Matrix
    cell: tuple[float, float]
    along: Vector
    outline: Matrix

    @property
    def cost(self) -> Matrix:
        """(rows, columns) approximate cost per bank m^3 [s/m^3 or J/m^3]; nan where the machine cannot stand."""
        return np.array([[spot.cost for spot in row] for row in self.spots])

    @property
    def share(self) -> Matrix:
        """(rows, columns) part of the soil that is reached."""
        return np.array([[spot.share for spot in row] for row in self.spots])


def site_map(finder: SpotFinder, told: Callable[[int, int], object]) -> SiteMap:
    """Evaluate all places around the dig.

    Parameters
    ----------
    told: called with the number of rows that are done, and of all rows.
    """
    area = finder.area
    far = finder.reach.farthest
    step = LINE_STEP if area.in_line else GRID_STEP
    half_u, half_v = 0.5 * area.length + far, 0.5 * area.width + far
    u = step * np.arange(-math.ceil(half_u / step), math.ceil(half_u / step) + 1)
    v = GRID_STEP * np.arange(-math.ceil(half_v / GRID_STEP), math.ceil(half_v / GRID_STEP) + 1)
    left = np.array([-area.direction[1], area.direction[0]])
    grid = area.middle + u[None, :, None] * area.direction + v[:, None, None] * left
    rows = []
    for index, row in enumerate(grid):
        if area.in_line and abs(v[index]) > 1e-9:
            rows.append(tuple(_off_line(axis) for axis in row))
        else:
            rows.append(tuple(finder.at(axis) for axis in row))
        told(index + 1, len(grid))
    return SiteMap(tuple(rows), grid[..., 0], grid[..., 1], (step, GRID_STEP), area.direction, area.outline)


def _off_line(axis: Vector) -> Spot:
    return Spot(Base(tuple(axis), 0.0), math.nan, 0.0, (), "line", _WORDS["line"])
