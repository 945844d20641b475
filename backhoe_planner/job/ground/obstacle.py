"""The ground as an obstacle, built in memory: the machine must not touch it when it moves through the air."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Indices, Matrix, Vector, as_number
from backhoe_planner.errors import check_kind
from backhoe_planner.job.ground.grids import HeightGrid
from backhoe_planner.job.ground.off_ground import OffGround
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.machine import Cluster, Piece, TerrainSolid
from backhoe_planner.machine.shape import shapes
from backhoe_planner.site import Obstacle, scan_body, terrain_body
from backhoe_planner.site.schema import obstacle_shapes

GROUND_BEYOND = "the ground beyond what is modelled"
_UNDER_BORDER = 0.05  # m below the terrain that the ground beyond it is drawn under its border; chosen
_DEEP = 20.0  # m of ground beyond the grid; chosen: deeper than any arm reaches


def terrain_obstacle(terrain: Terrain, name: str, clearance: float, *, before: Obstacle | None = None) -> Obstacle:
    """The present ground as one obstacle; its distances equal those of the same heights read from a file.

    Parameters
    ----------
    name, clearance: as in `Obstacle`.
    before: the obstacle of this ground at an earlier moment; its distance structures are reused wherever the
        heights are the same.

    Raises
    ------
    InputError: an argument is of another kind.
    """
    check_kind(terrain, Terrain, key="terrain")
    heights, spec = terrain.surface, _height_map(name, terrain.low, terrain.high)
    size, place = spec.size, spec.placement
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
    return _unmoved(spec, body, clearance)


def kept_by_arm(ground: Obstacle, arm: tuple[str, ...], swung: tuple[str, ...]) -> tuple[Obstacle, ...]:
    """The ground for the links of an arm, and, without clearance, for those that only swing.

    A swing post comes no nearer to level ground than it stands. It must not touch what is higher.

    Parameters
    ----------
    arm, swung: both kinds of links, see `ArmPlane`; if none only swings, all keep the clearance.
    """
    if not swung:
        return (ground,)
    below = replace(ground, name=ground.name + _below(swung), clearance=0.0, links=swung)
    return (replace(ground, links=arm), below)


def is_below_swung(obstacle: Obstacle) -> bool:
    """Whether an obstacle is the ground once more, for links that only swing, see `kept_by_arm`."""
    return obstacle.clearance == 0.0 and obstacle.links is not None and obstacle.name.endswith(_below(obstacle.links))


def _below(swung: Sequence[str]) -> str:
    return f", below {' and '.join(swung)}"


def off_ground_obstacles(
    off_ground: OffGround | None, clearance: float, *, within: tuple[Vector, Vector] | None = None
) -> tuple[Obstacle, ...]:
    """What stands on the ground, one obstacle for each of the largest things; empty if nothing does.

    Parameters
    ----------
    clearance: distance to be kept from it [m].
    within: only of things that reach between these least and greatest x, y (2,) [m]; by default of all.

    Raises
    ------
    InputError: an argument is of another kind.
    """
    if off_ground is None:
        return ()
    edge = check_kind(off_ground, OffGround, key="off_ground").edge
    found = []
    for name, keys in off_ground.things if within is None else off_ground.things_within_unchecked(*within):
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
    (west, south), (east, north) = ground.low.tolist(), ground.high.tolist()
    least, most = np.minimum(low, ground.low), np.maximum(high, ground.high)
    sides = {
        "west": (least, (west, most[1])), "east": ((east, least[1]), most),
        "south": ((west, least[1]), (east, south)), "north": ((west, north), (east, most[1])),
    }  # fmt: skip
    found = []
    for name, (start, end) in sides.items():
        length, width = (np.asarray(end, dtype=float) - np.asarray(start, dtype=float)).tolist()
        if min(length, width) <= ground.cell:
            continue
        x, y = (0.5 * (np.asarray(end, dtype=float) + np.asarray(start, dtype=float))).tolist()
        size, place = (length, width, _DEEP), (x, y, level - 0.5 * _DEEP)
        title = f"the ground {name} of what is known"
        box = shapes.box(np.array(size), pin.SE3(np.eye(3), np.array(place)))
        spec = obstacle_shapes.Box(name=title, shape="box", size=size, position=place)
        found.append(_unmoved(spec, [box], clearance))
    return tuple(found)


def ground_beyond(
    ground: Terrain, beyond: HeightGrid | None, low: Vector, high: Vector, clearance: float
) -> tuple[Obstacle, ...]:
    """The ground of a file beyond the grid of a terrain, as one obstacle; empty if the file goes no further.

    Parameters
    ----------
    beyond: the ground in the columns of the terrain and around them, without holes; None for none.
    low, high: (2,) least and greatest x, y of the area to be covered [m].
    clearance: distance to be kept from it [m].
    """
    if beyond is None:
        return ()
    # whole columns, counted from the first
    area = np.stack((np.minimum(low, ground.low), np.maximum(high, ground.high))) - beyond.low
    first, last = np.clip(np.round(area / beyond.cell), 0, np.array(beyond.z.shape[::-1]) - 1).astype(int)
    z = beyond.z[first[1] : last[1] + 1, first[0] : last[0] + 1].copy()
    inner = np.round((np.stack((ground.low, ground.high)) - beyond.low) / beyond.cell).astype(int) - first
    (west, south), (east, north) = inner.tolist()
    if z.shape == (north - south + 1, east - west + 1):
        return ()
    # the terrain is an obstacle of its own: within its border, this one is deeper than any arm reaches
    z[max(south + 1, 0) : max(north, 0), max(west + 1, 0) : max(east, 0)] = z.min() - _DEEP
    ends = beyond.low + beyond.cell * np.stack((first, last))
    spec = _height_map(GROUND_BEYOND, *ends)
    return (_unmoved(spec, terrain_body(z, spec.size, spec.placement), clearance),)


def surface_beyond(beyond: Obstacle, most: int) -> tuple[Matrix, Indices]:
    """Vertices (k, 3) [m], world, and triangles (m, 3) of an obstacle of `ground_beyond`, down to the terrain's border.

    Parameters
    ----------
    most: triangles, about.
    """
    assert beyond.cluster is not None
    vertices, triangles = beyond.cluster.drawing(most)
    lowest = float(vertices[:, 2].min())
    sunk = vertices[:, 2] < lowest + 0.5 * _DEEP
    if (vertices[sunk, 2] > lowest).any():  # the terrain is nowhere within it
        return vertices, triangles
    triangles = triangles[~sunk[triangles].all(axis=1)]
    # at the border it goes on a little below the terrain
    corners, level = triangles.ravel(), np.where(sunk[triangles], np.inf, vertices[triangles, 2]).min(axis=1)
    beside = np.full(len(vertices), np.inf)
    np.minimum.at(beside, corners, np.repeat(level - _UNDER_BORDER, 3))
    found = vertices.copy()
    found[sunk, 2] = beside[sunk]
    used, index = np.unique(corners, return_inverse=True)
    return found[used], index.reshape(-1, 3)


def _height_map(name: str, low: Vector, high: Vector) -> obstacle_shapes.HeightMap:
    """Heights in memory, from the first x, y (2,) to the last [m]."""
    x, y = (0.5 * (low + high)).tolist()
    size = (float(high[0] - low[0]), float(high[1] - low[1]))
    return obstacle_shapes.HeightMap(name=name, shape="heightmap", file="", size=size, position=(x, y, 0.0))


def _unmoved(spec: obstacle_shapes.ObstacleSpec, body: Cluster | Sequence[Piece], clearance: float) -> Obstacle:
    """An obstacle for all links that is there from the start, and does not move."""
    return Obstacle(
        name=spec.name,
        pieces=() if isinstance(body, Cluster) else tuple(body),
        clearance=as_number(clearance, key="clearance", least=0.0),
        links=None,
        appears_at=0.0,
        velocity=np.zeros(3),
        spec=spec,
        cluster=body if isinstance(body, Cluster) else None,
    )
