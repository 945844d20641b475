"""The side section of what is dug: ground, design, pipes and the bucket, in one upright plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.job import JobPlan, nearest_columns
from backhoe_planner.machine import BatchKinematics, Robot
from backhoe_planner.motion import Problem
from backhoe_planner.site import Capsule, Obstacle

_BEYOND = 0.6  # m by which the section extends beyond what is dug; chosen
_UPRIGHT = 0.9  # vertical part of a pipe's axis from which it is not cut across; chosen


@dataclass(frozen=True, eq=False)
class Section:
    """An upright plane through the ground.

    Attributes
    ----------
    begin: (2,) x, y of its beginning [m].
    along: (2,) unit vector along the section.
    length: length of the section [m].
    """

    begin: Vector
    along: Vector
    length: float

    def stations(self, points: Matrix) -> tuple[Vector, Vector]:
        """Distances of points (F, 2+) along the section, and beside it [m]."""
        off = points[:, :2] - self.begin
        return off @ self.along, off @ np.array([-self.along[1], self.along[0]])


def section_of(plan: JobPlan) -> Section:
    """The section along a trench, from its nearer end; for other digs, through the middle and away from the machine."""
    axis = _axis(plan.robot)
    trench = plan.job.dig.trench
    if trench is not None:
        ends = np.array(sorted((trench.start, trench.end), key=lambda end: float(np.linalg.norm(end - axis))))
    else:
        rows, columns = np.nonzero(np.isfinite(plan.design))
        places = plan.start.low + plan.start.cell * np.column_stack((columns, rows))
        middle = places.mean(axis=0)
        away = (middle - axis) / max(float(np.linalg.norm(middle - axis)), 1e-9)
        reach = (places - middle) @ away
        ends = np.array([middle + reach.min() * away, middle + reach.max() * away])
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    begin = ends[0] - _BEYOND * along
    return Section(begin, along, float(np.linalg.norm(ends[1] - ends[0])) + 2.0 * _BEYOND)


def section_content(plan: JobPlan, problem: Problem, q: Matrix) -> dict[str, Any]:
    """The content for the page: heights at regular stations, crossings of the plane, the bucket per frame q (F, n)."""
    section, ground = section_of(plan), plan.start
    count = int(np.ceil(section.length / ground.cell)) + 1
    along = np.linspace(0.0, section.length, count)
    places = section.begin + along[:, None] * section.along
    row, column, _ = nearest_columns(places, ground.low, ground.cell, ground.shape)
    index = row * ground.shape[1] + column
    at = BatchKinematics(plan.robot).at(q)
    station, aside = section.stations(at.tip_position)
    return {
        "length": section.length,
        "axis": float(section.stations(_axis(plan.robot)[None])[0][0]),
        "columns": index,
        "start": ground.surface.ravel()[index],
        "design": plan.design.ravel()[index],
        "end": plan.end.surface.ravel()[index],
        "crossings": _crossings(problem.obstacles, section),
        "bucket": _outline(plan.robot),
        "towards": float(np.sign(section.along @ _heading(plan.robot, section))),
        "tip": {"station": station, "aside": aside, "z": at.tip_position[:, 2], "pitch": at.pitch()},
        "width": plan.job.dig.trench.width if plan.job.dig.trench is not None else ground.cell,
    }


def _axis(robot: Robot) -> Vector:
    """(2,) position of the swing axis [m]."""
    return np.asarray(BatchKinematics(robot).at(robot.middle[None]).origins[0, 0, :2])


def _heading(robot: Robot, section: Section) -> Vector:
    """(2,) vector from the swing axis outward to the middle of the section [m]."""
    return np.asarray(section.begin + 0.5 * section.length * section.along - _axis(robot))


def _outline(robot: Robot) -> Matrix:
    """(k, 2) outline of what the last joint carries, from the tip: along the line from pin to tip, and up from it."""
    q = robot.middle[None]
    at = BatchKinematics(robot).at(q)
    R, origin, tip = at.rotations[0, -1], at.origins[0, -1], at.tip_position[0]
    points = np.vstack([piece.piece.hull for piece in robot.pieces if piece.joint == robot.n] or [np.zeros((1, 3))])
    world = points @ R.T + origin
    axis = at.pitch_sense * at.axes[0, -1]
    forward = np.array([-axis[1], axis[0], 0.0])
    forward /= np.linalg.norm(forward)
    pitch = float(at.pitch()[0])
    off = world - tip
    level, up = off @ forward, off[:, 2]
    flat = np.column_stack((level * np.cos(pitch) + up * np.sin(pitch), -level * np.sin(pitch) + up * np.cos(pitch)))
    return np.asarray(flat[ConvexHull(flat).vertices]) if len(flat) > 2 else flat


def _crossings(obstacles: Sequence[Obstacle], section: Section) -> list[dict[str, Any]]:
    """The pipes that cross the plane: where, half axes of their cross section, and the required clearance."""
    found = []
    across = np.array([-section.along[1], section.along[0], 0.0])
    for obstacle in obstacles:
        spec = obstacle.spec
        if not isinstance(spec, Capsule):
            continue
        start, end = np.array(spec.start), np.array(spec.end)
        way = end - start
        length = float(np.linalg.norm(way))
        before, after = ((point[:2] - section.begin) @ across[:2] for point in (start, end))
        if length == 0.0 or before * after > 0.0 or before == after or abs(way[2]) > _UPRIGHT * length:
            continue
        place = start + before / (before - after) * way
        station = float((place[:2] - section.begin) @ section.along)
        slant = abs(float(way @ across)) / length
        found.append(
            {
                "name": obstacle.name,
                "station": station,
                "z": float(place[2]),
                "half": spec.radius / max(slant, 1e-3),
                "radius": spec.radius,
                "clearance": obstacle.clearance,
            }
        )
    return found
