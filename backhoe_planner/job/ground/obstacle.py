"""The ground as an obstacle, from memory: what the machine must not touch on its way through the air."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import as_number
from backhoe_planner.errors import check_kind
from backhoe_planner.job.ground.terrain import Terrain
from backhoe_planner.machine import TerrainSolid
from backhoe_planner.site import Obstacle, terrain_body
from backhoe_planner.site.schema import obstacle_shapes


def terrain_obstacle(
    terrain: Terrain, name: str, clearance: float, links: Sequence[str] | None = None, *, before: Obstacle | None = None
) -> Obstacle:
    """The ground as it is, as one obstacle; its distances are those of the same heights from a file.

    Parameters
    ----------
    name, clearance, links: as of `Obstacle`.
    before: the obstacle of this ground at an earlier moment; what it has built to measure distances is taken
        over wherever the heights are the same.

    Raises
    ------
    InputError: an argument is no such thing.
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
        solid = cluster.solid.with_heights(heights)
        body = cluster.with_solid(solid, cluster.solid.changes_to(solid))
    else:
        body = terrain_body(heights, size, place)
    return Obstacle(
        name=name,
        pieces=(),
        clearance=as_number(clearance, key="clearance", least=0.0),
        links=None if links is None else tuple(links),
        appears_at=0.0,
        velocity=np.zeros(3),
        spec=obstacle_shapes.HeightMap(
            name=name, shape="heightmap", file="", size=size, position=tuple(place.translation.tolist())
        ),
        cluster=body,
    )
