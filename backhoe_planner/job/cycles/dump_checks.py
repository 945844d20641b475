"""Checks of the dump before anything is planned; an error says what is wrong and what would be allowed."""

from __future__ import annotations

import math

import numpy as np

from backhoe_planner.arrays import Matrix
from backhoe_planner.digits import beside_bounds
from backhoe_planner.errors import SceneError
from backhoe_planner.job.cycles.dumping import empty_bed, postures_over, radii_of_dumps
from backhoe_planner.job.ground.grids import nearest_columns
from backhoe_planner.job.worksite.column_parts import parts_within
from backhoe_planner.job.worksite.worksite import Worksite
from backhoe_planner.site import Proximity


def check_dump(site: Worksite, allowed: Matrix) -> None:
    """Check the place where the soil is to go.

    Parameters
    ----------
    allowed: (rows, columns) heights down to which the soil is dug, see `allowed_heights` [m].

    Raises
    ------
    SceneError: a heap is within its edge distance, or a place is out of reach; or all trucks together take less than
        what must be dug.
    """
    heap, truck, job = site.job.dump.heap, site.job.dump.truck, site.job
    if heap is not None:
        for number, place in enumerate(heap.places):
            at = np.array(place)
            key = "dump.heap.at" if len(heap.places) == 1 else f"dump.heap.at[{number}]"
            low, high = site.ground.low, site.ground.high
            if (at < low).any() or (at > high).any():
                raise SceneError(
                    "lies beyond the ground that the job has", file=job.file, key=key, found=list(place),
                    allowed=f"{low.tolist()} to {high.tolist()}",
                    hint="ground.low and ground.high say how far it goes",
                )  # fmt: skip
            if bool(site.design.within(at, heap.edge_distance)):
                raise SceneError(
                    "lies within the edge distance of what is dug", file=job.file, key=key, found=list(place),
                    allowed=f"more than {heap.edge_distance:g} m from it, and the heap's own foot besides",
                    hint="move it away, or lower dump.heap.edge_distance",
                )  # fmt: skip
            row, column, _ = nearest_columns(at, low, site.ground.cell, site.ground.shape)
            if site.taken[row, column]:
                raise SceneError(
                    "is where something stands on the ground", file=job.file, key=key, found=list(place),
                    hint="move it away, or leave out the points there, if that will be gone",
                )  # fmt: skip
            _check_reach(site, at, 0.0, key)
    if truck is not None:
        x, y, z = truck.bed.position
        _check_reach(site, np.array([x, y]), z + truck.bed.size[2], "dump.truck.bed.position")
        loose = _least_loose(site, allowed)
        if loose > truck.capacity * truck.count:
            raise SceneError(
                "trucks take less than what is to be dug", file=job.file, key="dump.truck.count", found=truck.count,
                allowed=f"{math.ceil(loose / truck.capacity)} or more: {loose:.2f} m^3 of loose soil, "
                f"{truck.capacity:.2f} m^3 in each",
                hint="or dig less of it",
            )  # fmt: skip


def check_truck(site: Worksite) -> None:
    """Check the truck of a job on its own.

    Raises
    ------
    SceneError: its capacity is less than a bucketful or more than its bed holds; or it is on what is dug or in the
        machine.
    """
    truck, job = site.job.dump.truck, site.job
    if truck is None:
        return
    bucketful = site.bucket.capacity
    if truck.capacity < bucketful:
        least = beside_bounds(truck.capacity, bucketful, places=".6g", bounds_as=".2f")[1]
        raise SceneError(
            "takes less than one bucketful", file=job.file, key="dump.truck.capacity", found=truck.capacity,
            allowed=f"{least} m^3 or more: what the bucket holds", hint="or a smaller bucket.capacity",
        )  # fmt: skip
    empty_bed(site, truck)
    bed, start = truck.bed, site.problem.start_q
    turn = np.array([[math.cos(bed.yaw), -math.sin(bed.yaw)], [math.sin(bed.yaw), math.cos(bed.yaw)]])
    half = 0.5 * np.array(bed.size[:2])
    corners = np.array(bed.position[:2]) + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ turn.T
    share, _ = parts_within(site.nodes, site.ground.cell, corners)
    over = (share > 0.0) & (site.share > 0.0)
    if over.any():
        x, y = site.nodes[over][0].tolist()
        raise SceneError(
            "stands on what is dug", file=site.job.file, key="dump.truck.bed.position", found=list(bed.position),
            allowed=f"a place beside it: they meet at x {x:.2f}, y {y:.2f} m",
        )  # fmt: skip
    if start is not None:
        walls = [one for one in site.problem.obstacles if one.name in {wall["name"] for wall in bed.walls()}]
        near = Proximity(site.robot, walls).tightest(start)
        if near is not None and near.margin < 0.0 and near.name in {one.name for one in walls}:
            apart, least = beside_bounds(near.distance, near.distance - near.margin, bounds_as=".2f")
            raise SceneError(
                "stands in the machine, or too near to it", file=job.file, key="dump.truck.bed.position",
                found=f"{apart} m between {near.link} and the {near.name}",
                allowed=f"{least} m or more while the machine stands at its start",
            )  # fmt: skip


def _least_loose(site: Worksite, allowed: Matrix) -> float:
    """Loose soil that is dug if the design is only just met within its tolerance [m^3]."""
    ground, upper = site.ground, allowed + site.job.dig.tolerance
    bank = np.fmax(ground.bank - upper, 0.0)
    loose = np.clip(ground.surface - upper, 0.0, ground.loose)
    each = np.where(np.isfinite(allowed), (bank * ground.swell + loose) * site.share, 0.0)
    return float(each.sum()) * ground.cell**2


def _check_reach(site: Worksite, at: np.ndarray, top: float, key: str) -> None:
    """Raise SceneError if no bucket can be emptied over a place (2,) whose top is at a height [m]."""
    if len(postures_over(site, at, top)[0]):
        return
    off = at - site.plane.axis
    reached = radii_of_dumps(site, at, top)
    limits, swing = site.plane.limits, float(np.degrees(np.arctan2(off[1], off[0])))
    if reached:
        allowed = f"{reached[0]:.1f} to {reached[1]:.1f} m from the swing axis in this direction"
    else:
        allowed = f"swings of {np.degrees(limits.lower[0]):.0f} to {np.degrees(limits.upper[0]):.0f} degrees"
    raise SceneError(
        "is out of reach: the bucket cannot be emptied there", file=site.job.file, key=key,
        found=f"{float(np.linalg.norm(off)):.2f} m from the swing axis at {swing:.0f} degrees, {top:.2f} m high",
        allowed=allowed,
    )  # fmt: skip
