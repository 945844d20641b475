"""Warnings of obstacles that a scene probably means otherwise."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import Robot, VoxelSolid, reach_ball
from backhoe_planner.site.fixed_parts import stands_in
from backhoe_planner.site.obstacles import Obstacle
from backhoe_planner.site.schema import obstacle_shapes

_FAR = 50.0  # times the machine's reach, beyond which an obstacle is probably given in other units; chosen
_TINY = 1e-3  # times the machine's reach, below which a mesh is probably given in other units; chosen
_SURVEYS = (obstacle_shapes.HeightMap, obstacle_shapes.PointCloud)


def obstacle_warnings(robot: Robot, obstacles: Iterable[Obstacle]) -> tuple[str, ...]:
    """Warnings of probable mistakes: obstacles in other units or at another place, and scans with gaps.

    A machine whose base the scene gives does not stand in an obstacle; see `check_standing`.

    Raises
    ------
    InputError: the file of a mesh is gone.
    """
    obstacles, (centre, radius) = tuple(obstacles), reach_ball(robot)
    found, out_of_reach, within_reach = list[str](), dict[str, float](), False
    for obstacle in obstacles:
        away = obstacle.box_away_unchecked(centre)
        if overhead := _ground_overhead(obstacle, centre + np.array([0.0, 0.0, radius])):
            found.append(overhead)
            continue
        if isinstance(obstacle.spec, _SURVEYS):
            within_reach |= away <= radius
            if radius < away <= _FAR * radius:
                out_of_reach[obstacle.name] = away
        if _FAR * radius < away < np.inf:
            found.append(
                f"{obstacle.name} is {away:,.0f} m away, {away / radius:,.0f} times as far as the machine reaches; "
                f"sizes, positions and points of files are in metres{_map_origin(obstacle)}"
            )
        if isinstance(obstacle.spec, obstacle_shapes.Mesh) and (words := _odd_size(obstacle, obstacle.spec, radius)):
            found.append(words)
        solid = None if obstacle.cluster is None else obstacle.cluster.solid
        if isinstance(solid, VoxelSolid) and (closed := solid.closed_edge()) > solid.finest:
            found.append(
                f"{obstacle.name} has gaps: many of its {len(solid):,} voxels of {solid.finest:g} m touch no other, "
                f"and what is between them counts as free; at a resolution of {closed:g} m most touch others; ground "
                "is better given as a heightmap, which has no gaps"
            )
    if out_of_reach and not within_reach:
        found.append(
            f"the machine reaches nothing of {', '.join(out_of_reach)}: the nearest part is "
            f"{min(out_of_reach.values()):.0f} m away; does the machine stand elsewhere on the survey?"
        )
    if (standing := stands_in(robot, obstacles)) is not None:
        found.append(
            f"{standing.link}, which does not move, stands in {standing.obstacle}: only parts that move keep away from "
            "obstacles; if the machine stands elsewhere, the scene can say where (base: {position: [x, y], heading: 0})"
        )
    return tuple(found)


def _ground_overhead(obstacle: Obstacle, top: Vector) -> str | None:
    """Words about ground all of which is over the machine's highest point `top` (3,) [m]; None about any other."""
    spec = obstacle.spec
    if not isinstance(spec, obstacle_shapes.HeightMap) or spec.placement.rotation[2, 2] <= 0.0:
        return None
    low, high = obstacle.bounds
    if low[2] <= top[2] or (low[:2] > top[:2]).any() or (high[:2] < top[:2]).any():
        return None
    x, y, z = spec.position
    below = f"`position: [{x:g}, {y:g}, {np.floor(z - high[2]):g}]`"
    return (
        f"{obstacle.name} ends {low[2] - top[2]:,.0f} m above the machine, and nothing below it is solid: are its "
        f"heights above the sea? {below} puts its highest point below 0, where the machine stands"
    )


def _odd_size(obstacle: Obstacle, spec: obstacle_shapes.Mesh, radius: float) -> str | None:
    """Words about a mesh that is so large or small as if it were in other units; None about any other one."""
    low, high = obstacle.bounds
    size = float(np.max(high - low))
    if _TINY * radius <= size <= _FAR * radius:
        return None
    scale = spec.frame(obstacle.folder)[0]
    used = " x ".join(dict.fromkeys(f"{factor:g}" for factor in scale))
    stated = "" if spec.scale is not None else ", which its file states" if used != "1" else ", as its file states none"
    times = f"{size / radius:,.0f}" if size > radius else f"{size / radius:.3g}"
    large = f"{size:,.0f} m" if size > 1.0 else f"{1000.0 * size:.2g} mm"
    return (
        f"{obstacle.name} ({spec.file}) is {large} large, {times} times as far as the machine reaches, "
        f"at a scale of {used}{stated}: `scale` is 0.001 for a file in millimetres, 1 for one in metres"
    )


def _map_origin(obstacle: Obstacle) -> str:
    """The key that puts the middle of a far file at its position, in words; "" for what has no such key."""
    spec = obstacle.spec
    if not isinstance(spec, (obstacle_shapes.Mesh, obstacle_shapes.PointCloud)):
        return ""
    low, high = obstacle.bounds
    middle = spec.placement.actInv(np.array([*(low + high)[:2] / 2.0, low[2]]))
    scale, turn = spec.frame(obstacle.folder) if isinstance(spec, obstacle_shapes.Mesh) else (np.ones(3), np.eye(3))
    found = np.round(turn.T @ middle / scale + spec.map_origin).astype(int).tolist()
    return f"; `map_origin: {found}` puts the middle of its file at its position"
