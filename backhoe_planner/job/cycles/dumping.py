"""Where the soil goes: postures over a heap or a truck, and the load there afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from backhoe_planner.arrays import Flags, Matrix, Vector
from backhoe_planner.errors import InputError, SceneError
from backhoe_planner.job.ground.grids import nearest_columns
from backhoe_planner.job.ground.heaps import Refusal, deposited
from backhoe_planner.job.ground.obstacle import kept_by_arm, terrain_obstacle
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.job.ground.truck_bed import Bed
from backhoe_planner.job.schema.work import Heap
from backhoe_planner.job.schema.work import Truck as Trucks
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.machine import travel_times
from backhoe_planner.site import Obstacle

OPEN = -1.2  # rad: the pitch at which the bucket is empty; chosen, its plate is then at 110 degrees
POURS_AT = -0.1  # m of radius from the bucket's pin to where the soil falls, approximately, as the pitch passes -pi/2
_ABOVE = 0.15  # m from the teeth of the open bucket to the soil below, beyond the clearance; chosen
_HIGHER = (0.0, 0.25, 0.5, 0.8, 1.2)  # m, tried in turn in addition to that
_TILTS = (0.0, 0.25, 0.5)  # rad from level at which the bucket may arrive
_ALONG_BED = (0.0, -0.5, 0.5, -1.0, 1.0)  # of the room along a bed: places to dump a bucketful; chosen
_EVEN = 0.15  # m by which a place may be higher than the lowest and still count as low; chosen
_RADII = np.arange(1.0, 12.0, 0.1)  # m from the swing axis at which dumping is tried, for messages
_GROUND, _TRUCK = "the ground", "the truck"


@dataclass(frozen=True, eq=False)
class Truck:
    """The truck that is at the site.

    Attributes
    ----------
    number: number of the truck, from 1.
    bed: its bed with the load.
    """

    number: int
    bed: Bed


@dataclass(frozen=True, eq=False)
class SiteState:
    """The part of the site that changes from cycle to cycle.

    Attributes
    ----------
    ground: the ground as it is.
    grounds: the ground as obstacles, see `ground_obstacles`.
    truck: the present truck with its load; None for a heap.
    load: the truck's load as an obstacle.
    """

    ground: Terrain
    grounds: tuple[Obstacle, ...]
    truck: Truck | None = None
    load: Obstacle | None = None

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """All of these obstacles."""
        return self.grounds if self.load is None else (*self.grounds, self.load)

    @property
    def truck_load(self) -> Terrain | None:
        """The load of the truck, in the axes of its bed; None for a heap."""
        return None if self.truck is None else self.truck.bed.load


@dataclass(frozen=True, eq=False)
class Dumping:
    """One place at which a bucketful can be dumped.

    Attributes
    ----------
    place: (3,) the top of what is there afterwards [m], world.
    arrivals: (k, n) postures with the bucket level above the place, the lowest first.
    openings: (k, n) the same postures with the bucket open.
    number: number of the truck, from 1; 0 for a heap.
    """

    place: Vector
    arrivals: Matrix
    openings: Matrix
    number: int


@dataclass(frozen=True)
class NoDump:
    """Why a bucketful cannot be dumped anywhere.

    Attributes
    ----------
    reason: ``full``, or ``unreachable`` if the bucket cannot be emptied over any place that has room.
    words: the same in a sentence.
    """

    reason: Literal["full", "unreachable"]
    words: str


class DumpSite(Protocol):
    """A place where soil is dumped."""

    def first(self, ground: Terrain, grounds: tuple[Obstacle, ...]) -> SiteState:
        """The site before the first cycle."""

    def options(self, state: SiteState, volume: float, start: Vector) -> list[Dumping] | NoDump:
        """Places at which `volume` [m^3] of loose soil can be dumped, the soonest reached from `start` (n,) first.

        If there is none, the reason.
        """

    def dumped(self, state: SiteState, place: Vector, volume: float, number: int) -> SiteState | str:
        """The site after `volume` [m^3] was dumped at `place` (2,) [m]; or the reason why that is impossible.

        Parameters
        ----------
        number: number of the truck.
        """


class HeapDump:
    """Soil dumped on the ground.

    Parameters
    ----------
    site: the worksite.
    heap: the places of the heap.
    """

    def __init__(self, site: Worksite, heap: Heap) -> None:
        self._site, self._heap = site, heap
        self._clear_of: Flags = site.design.within(site.nodes, heap.edge_distance) | site.taken
        # the last ground, and what heaps on it came to, by place and volume: what is chosen is not poured again
        self._poured: tuple[Terrain | None, dict[tuple[float, ...], Terrain | Refusal]] = (None, {})

    def first(self, ground: Terrain, grounds: tuple[Obstacle, ...]) -> SiteState:
        """See `DumpSite`."""
        return SiteState(ground, grounds)

    def options(self, state: SiteState, volume: float, start: Vector) -> list[Dumping] | NoDump:
        """See `DumpSite`."""
        found: list[Dumping] = []
        full = ""
        beyond: tuple[Vector, float] | None = None  # the first place that is out of reach
        for at in self._heap.places:
            place = np.array(at)
            after = self._deposited(state.ground, place, volume)
            if isinstance(after, Refusal):
                full = full or after.reason
                continue
            top = _height(after, place)
            arrivals, openings = postures_over(self._site, place, top)
            if not len(arrivals):
                beyond = beyond or (place, top)
                continue
            found.append(Dumping(np.array([*at, top]), arrivals, openings, 0))
        limits = self._site.problem.limits
        if not found:
            if full or beyond is None:
                return NoDump("full", full)
            return NoDump("unreachable", _out_of_reach(self._site, *beyond))
        return sorted(found, key=lambda one: float(travel_times(one.arrivals[0] - start, limits)))

    def dumped(self, state: SiteState, place: Vector, volume: float, number: int) -> SiteState | str:
        """See `DumpSite`."""
        after = self._deposited(state.ground, place, volume)
        if isinstance(after, Refusal):
            return after.reason
        return SiteState(after, ground_obstacles(self._site, after, before=state.grounds))

    def _deposited(self, ground: Terrain, place: Vector, volume: float) -> Terrain | Refusal:
        """The ground after `volume` [m^3] was dumped at `place` (2,) [m]; or why that is impossible."""
        if ground is not self._poured[0]:
            self._poured = (ground, {})
        known, key = self._poured[1], (*place.tolist(), volume)
        if key not in known:
            known[key] = deposited(ground, place, volume, clear_of=self._clear_of)
        return known[key]


class TruckDump:
    """Soil loaded on trucks, one after the other.

    Parameters
    ----------
    site: the worksite.
    trucks: the place and the capacity of the trucks.
    """

    def __init__(self, site: Worksite, trucks: Trucks) -> None:
        self._site, self._trucks = site, trucks
        self._empty = empty_bed(site, trucks)
        length = trucks.bed.size[0]
        # keep the bucket's width away from the walls: next to them, half of the falling soil would miss the bed
        room = max(0.5 * length - 0.6 * site.bucket.width, 0.0)
        own = [np.array([part * room, 0.0, trucks.bed.size[2]]) for part in _ALONG_BED]
        # on the upper edge of the walls, world
        self._places = [np.asarray(self._empty.placement.act(place)) for place in own]

    def first(self, ground: Terrain, grounds: tuple[Obstacle, ...]) -> SiteState:
        """See `DumpSite`."""
        return self._with(SiteState(ground, grounds), Truck(1, self._empty))

    def options(self, state: SiteState, volume: float, start: Vector) -> list[Dumping] | NoDump:
        """See `DumpSite`."""
        assert state.truck is not None
        truck = self._truck_for(state.truck, volume)
        if isinstance(truck, str):
            return NoDump("full", truck)
        found = []
        for place in self._places:
            after = truck.bed.loaded(place[:2], volume)
            assert isinstance(after, Bed)
            top = after.top_at(place[:2])
            arrivals, openings = postures_over(self._site, place[:2], max(top, float(place[2])))
            if len(arrivals):
                found.append(Dumping(np.array([*place[:2], top]), arrivals, openings, truck.number))
        if not found:
            return NoDump("unreachable", f"over the truck's bed: {_out_of_reach(self._site, place[:2], top)}")
        limits = self._site.problem.limits
        # the lowest load first, so that the bed fills evenly
        lowest = min(one.place[2] for one in found)
        return sorted(
            found,
            key=lambda one: (
                bool(one.place[2] > lowest + _EVEN), float(travel_times(one.arrivals[0] - start, limits))
            ),
        )  # fmt: skip

    def dumped(self, state: SiteState, place: Vector, volume: float, number: int) -> SiteState | str:
        """See `DumpSite`."""
        assert state.truck is not None
        now = state.truck.number
        if number not in (now, now + 1) or number > self._trucks.count:
            return f"truck {number} does not come after truck {now} of {self._trucks.count}"
        truck = state.truck if number == now else Truck(number, self._empty)
        bed = truck.bed.loaded(place, volume)
        if isinstance(bed, Refusal):
            most, would = truck.bed.capacity, truck.bed.volume + volume
            return f"truck {number} takes {most:.2f} m^3, with this bucketful it would hold {would:.2f} m^3"
        return self._with(state, Truck(number, bed))

    def _truck_for(self, truck: Truck, volume: float) -> Truck | str:
        """The truck that takes the next bucketful; or a message that all are full."""
        given = self._trucks
        if volume <= truck.bed.room:
            return truck
        if truck.number < given.count:
            return Truck(truck.number + 1, self._empty)
        which = "the truck is" if given.count == 1 else f"all {given.count} trucks are"
        what = f"{which} full: {truck.bed.volume:.2f} of {given.capacity:.2f} m^3, and a bucketful is {volume:.2f} m^3"
        return f"{what} (dump.truck.count says how many trucks come)"

    def _with(self, state: SiteState, truck: Truck) -> SiteState:
        load = truck.bed.load_obstacle(_TRUCK, self._site.problem.scene.clearance, before=state.load)
        return replace(state, truck=truck, load=load)


def empty_bed(site: Worksite, trucks: Trucks) -> Bed:
    """The bed of a truck that has just arrived.

    Raises
    ------
    SceneError: the size is not that of a bed, or the capacity is more than it holds heaped.
    """
    given = trucks.bed
    try:
        return Bed.empty(
            given.position, given.size, yaw=given.yaw, capacity=trucks.capacity, repose=site.job.soil.repose
        )
    except InputError as error:
        key = "dump.truck.capacity" if error.key == "capacity" else "dump.truck.bed.size"
        raise SceneError.of(error, file=site.job.file, key=key) from None


def postures_over(site: Worksite, place: Vector, top: float) -> tuple[Matrix, Matrix]:
    """(k, n) postures with the bucket level over a place (2,) [m], and (k, n) with the bucket open; from low to high.

    Parameters
    ----------
    top: height of what is there afterwards [m].
    """
    plane, bucket, n = site.plane, site.bucket, site.robot.n
    off = place - plane.axis
    swing = swing_towards(site, off)
    limits = site.problem.limits
    arrivals, openings = [], []
    radius = float(np.hypot(*off)) - POURS_AT + bucket.length * float(np.cos(OPEN))
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


def radii_of_dumps(site: Worksite, place: Vector, top: float) -> tuple[float, float] | None:
    """Least and greatest distance from the swing axis [m] at which a bucket can be emptied; None if there is none.

    Parameters
    ----------
    place: (2,) a place in the direction to be checked [m].
    top: height of what is there [m].
    """
    off = place - site.plane.axis
    ahead = off / max(float(np.linalg.norm(off)), 1e-9)
    reached = [r for r in _RADII.tolist() if len(postures_over(site, site.plane.axis + r * ahead, top)[0])]
    return (min(reached), max(reached)) if reached else None


def _out_of_reach(site: Worksite, place: Vector, top: float) -> str:
    radii = radii_of_dumps(site, place, top)
    where = f"the bucket cannot be emptied over x {place[0]:.2f}, y {place[1]:.2f} m, {top:.2f} m high"
    if radii is None:
        return f"{where}: it cannot be emptied anywhere in this direction"
    return f"{where}: in this direction it can be emptied {radii[0]:.1f} to {radii[1]:.1f} m from the swing axis"


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
    """The sense in which the pitch changes with the last joint, 1 or -1."""
    ahead = q.copy()
    ahead[-1] += 1e-3
    pitches = site.plane.place(np.array([q, ahead]))[2]
    return float(np.sign((pitches[1] - pitches[0] + np.pi) % (2.0 * np.pi) - np.pi))


def ground_obstacles(site: Worksite, ground: Terrain, *, before: Sequence[Obstacle] = ()) -> tuple[Obstacle, ...]:
    """The ground for the arm, then for links that only swing; structures built for the ground `before` are reused."""
    known = before[0] if before else None
    found = terrain_obstacle(ground, _GROUND, site.problem.scene.clearance, before=known)
    return kept_by_arm(found, site.plane.arm, site.plane.swung)


def dump_of(site: Worksite) -> DumpSite:
    """The dump of a job: a heap or trucks."""
    heap, truck = site.job.dump.heap, site.job.dump.truck
    if heap is not None:
        return HeapDump(site, heap)
    assert truck is not None
    return TruckDump(site, truck)


def _height(ground: Terrain, place: Vector) -> float:
    """The highest ground within two columns of a place (2,) [m]."""
    row, column, _ = nearest_columns(place, ground.low, ground.cell, ground.shape)
    return float(ground.surface[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].max())
