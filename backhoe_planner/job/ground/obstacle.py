"""The ground as an obstacle, built in memory: the machine must not touch it when it moves through the air."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Vector, as_number
from backhoe_planner.errors import check_kind
from backhoe_planner.job.ground.grids import HeightGrid
from backhoe_planner.job.ground.off_ground import OffGround
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.machine import Cluster, Piece, TerrainSolid
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle, scan_body, terrain_body
from backhoe_planner.site.schema import obstacle_shapes

_SAME = 1e-6  # columns; rounding is less
_DEEP = 20.0  # m of ground beyond the grid; chosen: deeper than any arm reaches


def terrain_obstacle(
    terrain: Terrain, name: str, clearance: float, links: Sequence[str] | None = None, *, before: Obstacle | None = None
) -> Obstacle:
    """The present ground as one obstacle; its distances equal those of the same heights read from a file.

    Parameters
    ----------
    name, clearance, links: as in `Obstacle`.
    before: the obstacle of this ground at an earlier moment; its distance structures are reused wherever the
        heights are the same.

    Raises
    ------
    InputError: an argument is of another kind.
    """
    check_kind(terrain, Terrain, key="terrain")
    heights, width = terrain.surface, terrain.high - terrain.low
    size = (float(width[0]), float(width[1]))
    place = pin.SE3(np.eye(3), np.array([*(0.5 * (terrain.low + terrain.high)), 0.0]))
    cluster = None if before is None else check_kind(before, Obstacle, key="before").cluster
    if (
        cluster is not None
        and isinstance(cluster.solid, TerrainSolid)
        and cluster.placement == place
        and cluster.solid.is_over(heights, size)
    ):
        body = Cluster(cluster.solid.with_heights(heights), place)
    else:
        body = terrain_body(heights, size, place)
    spec = obstacle_shapes.HeightMap(
        name=name, shape="heightmap", file="", size=size, position=tuple(place.translation.tolist())
    )
    return _unmoved(spec, body, clearance, None if links is None else tuple(links))


def off_ground_obstacles(off_ground: OffGround | None, clearance: float) -> tuple[Obstacle, ...]:
    """What stands on the ground, one obstacle for each of the largest things; empty if nothing does.

    Parameters
    ----------
    clearance: distance to be kept from it [m].

    Raises
    ------
    InputError: an argument is of another kind.
    """
    if off_ground is None:
        return ()
    edge = check_kind(off_ground, OffGround, key="off_ground").edge
    found = []
    for name, keys in off_ground.things:
        body = scan_body(np.asarray(edge * (keys + 0.5), dtype=float), edge, pin.SE3.Identity())
        spec = obstacle_shapes.PointCloud(name=name, shape="pointcloud", file="", resolution=edge)
        found.append(_unmoved(spec, body, clearance))
    return tuple(found)


def ground_around(ground: Terrain, level: float, low: Vector, high: Vector, clearance: float) -> tuple[Obstacle, ...]:
    """Level ground beyond the grid of a terrain, as boxes on its sides; empty if the grid reaches far enough.

    Parameters
    ----------
    level: height z of the ground [m].
    low, high: (2,) least and greatest x, y of the area to be covered [m].
    clearance: distance to be kept from the boxes [m].
    """
    found = []
    for name, (start, end) in _sides(ground, low, high).items():
        length, width = (end - start).tolist()
        x, y = (0.5 * (end + start)).tolist()
        size, place = (length, width, _DEEP), (x, y, level - 0.5 * _DEEP)
        title = f"the ground {name} of what is known"
        box = shapes.box(np.array(size), pin.SE3(np.eye(3), np.array(place)))
        spec = obstacle_shapes.Box(name=title, shape="box", size=size, position=place)
        found.append(_unmoved(spec, [box], clearance))
    return tuple(found)


def ground_beyond(
    ground: Terrain, beyond: HeightGrid | None, low: Vector, high: Vector, clearance: float
) -> tuple[Obstacle, ...]:
    """The ground of a file beyond the grid of a terrain, on its sides; empty if the file goes no further.

    Parameters
    ----------
    beyond: the ground in the columns of the terrain and around them, without holes; None for none.
    low, high: (2,) least and greatest x, y of the area to be covered [m].
    clearance: distance to be kept from it [m].
    """
    if beyond is None:
        return ()
    found, last = [], np.array(beyond.z.shape[::-1]) - 1
    for name, ends in _sides(ground, np.maximum(low, beyond.low), np.minimum(high, beyond.high)).items():
        # whole columns that contain the side
        start, end = ((one - beyond.low) / beyond.cell for one in ends)
        first = np.clip(np.floor(start + _SAME), 0, last).astype(int)
        end = np.clip(np.ceil(end - _SAME), 0, last).astype(int)
        z = beyond.z[first[1] : end[1] + 1, first[0] : end[0] + 1]
        size = tuple((beyond.cell * (end - first)).tolist())
        place = pin.SE3(np.eye(3), np.array([*(beyond.low + 0.5 * beyond.cell * (first + end)), 0.0]))
        title = f"the ground {name} of what is modelled"
        spec = obstacle_shapes.HeightMap(
            name=title, shape="heightmap", file="", size=size, position=tuple(place.translation.tolist())
        )
        found.append(_unmoved(spec, terrain_body(z, size, place), clearance))
    return tuple(found)


def _sides(ground: Terrain, low: Vector, high: Vector) -> dict[str, tuple[Vector, Vector]]:
    """Name, and least and greatest x, y (2,) [m], of the rectangles that cover an area beyond the grid of a terrain."""
    (west, south), (east, north) = ground.low.tolist(), ground.high.tolist()
    (left, down), (right, up) = np.minimum(low, ground.low).tolist(), np.maximum(high, ground.high).tolist()
    sides = {
        "west": ((left, down), (west, up)), "east": ((east, down), (right, up)),
        "south": ((west, down), (east, south)), "north": ((west, north), (east, up)),
    }  # fmt: skip
    found = {name: (np.array(start), np.array(end)) for name, (start, end) in sides.items()}
    return {name: (start, end) for name, (start, end) in found.items() if (end - start).min() > ground.cell}


def _unmoved(
    spec: obstacle_shapes.ObstacleSpec, body: Cluster | Sequence[Piece], clearance: float,
    links: tuple[str, ...] | None = None,
) -> Obstacle:  # fmt: skip
    """An obstacle that is there from the start, and does not move."""
    return Obstacle(
        name=spec.name,
        pieces=() if isinstance(body, Cluster) else tuple(body),
        clearance=as_number(clearance, key="clearance", least=0.0),
        links=links,
        appears_at=0.0,
        velocity=np.zeros(3),
        spec=spec,
        cluster=body if isinstance(body, Cluster) else None,
    )
