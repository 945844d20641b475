"""The soil on a truck after each dump."""

from __future__ import annotations

from itertools import zip_longest
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh

from backhoe_planner.arrays import Vector
from backhoe_planner.job import Cycle, JobPlan, Terrain
from backhoe_planner.show.drawing.drawing import Track, draw, mesh
from backhoe_planner.show.drawing.palette import LOOSE_SOIL
from backhoe_planner.show.drawing.scene_graph import HIDDEN
from backhoe_planner.show.drawing.solids import facets
from backhoe_planner.show.job.job_frames import Part

_EVERY = 3  # every third column of the load is drawn: 15 cm apart
_SOON = 1e-3  # s in which one load replaces the other in the picture


def draw_truck_load(visualizer: Any, prefix: str, plan: JobPlan, parts: tuple[Part, ...], time: Vector) -> list[Track]:
    """Draw the load of the truck after each cycle, and return the tracks by which one load grows out of the last.

    Parameters
    ----------
    prefix: prefix of paths in the viewer's tree.
    parts: parts of the whole job, whose times (F,) [s] the tracks use.
    """
    truck = plan.job.dump.truck
    if truck is None:
        return []
    place = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, truck.bed.yaw), np.array(truck.bed.position)).homogeneous
    tracks, before = [], 0.0
    for cycle, following in zip_longest(plan.cycles, plan.cycles[1:]):
        if cycle.truck_load is None or not cycle.truck_load.loose.any():
            continue
        volume = cycle.truck_load.loose_volume
        own = _dump(cycle, parts)
        end = parts[-1].end + 1.0 if following is None else _gone(cycle, following, parts)
        first = before / volume
        moments = [own.begin - _SOON, own.begin, own.end, end - _SOON, end]
        high = np.interp(time, moments, [0.0, first, 1.0, 1.0, 0.0])
        name = f"cycle {cycle.number}"
        node = visualizer["site"]["load of the truck"][name]
        draw(node["soil"], mesh(facets(load_body(cycle.truck_load)), (*LOOSE_SOIL, 1.0)))
        node.set_transform(place)
        shown = np.where(high > 0.0, 1.0, HIDDEN)
        scale = np.column_stack((shown, shown, np.maximum(high, HIDDEN)))
        tracks.append(Track(f"{prefix}/site/load of the truck/{name}/soil", "scale", time, scale))
        before = 0.0 if following is not None and following.truck != cycle.truck else volume
    return tracks


def load_body(load: Terrain) -> trimesh.Trimesh:
    """The load as a closed surface, in the bed's axes, with its floor at z = 0."""
    rows, columns = (np.unique([*range(0, count, _EVERY), count - 1]) for count in load.shape)
    height = load.loose[np.ix_(rows, columns)]
    x, y = np.meshgrid(load.x[columns], load.y[rows])
    shape = height.shape
    top = np.arange(height.size).reshape(shape)
    square = np.stack((top[:-1, :-1], top[:-1, 1:], top[1:, 1:], top[1:, :-1]), axis=-1).reshape(-1, 4)
    around = np.concatenate((top[0, :-1], top[:-1, -1], top[-1, :0:-1], top[:0:-1, 0]))
    ahead, below = np.roll(around, -1), height.size
    faces = np.vstack((
        square[:, [0, 1, 2]], square[:, [0, 2, 3]], square[:, [0, 2, 1]] + below, square[:, [0, 3, 2]] + below,
        np.column_stack((around, around + below, ahead)), np.column_stack((ahead, around + below, ahead + below)),
    ))  # fmt: skip
    points = np.column_stack((x.ravel(), y.ravel(), height.ravel()))
    return trimesh.Trimesh(np.vstack((points, points * [1.0, 1.0, 0.0])), faces, process=False)


def _dump(cycle: Cycle, parts: tuple[Part, ...]) -> Part:
    return next(part for part in parts if part.cycle == cycle.number and part.name == "dump")


def _gone(cycle: Cycle, following: Cycle, parts: tuple[Part, ...]) -> float:
    """When the load of a cycle is no longer visible [s]: the next one is on top of it, or the truck has left."""
    if following.truck == cycle.truck:
        return _dump(following, parts).begin
    return max(part.end for part in parts if part.cycle == cycle.number)
