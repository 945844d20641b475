"""Level ground around the machine: a round sheet with a line every metre, fading out."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from trimesh.transformations import translation_matrix

from backhoe_planner.show.drawing.drawing import line_segments, mesh, set_property
from backhoe_planner.show.drawing.palette import Rgba
from backhoe_planner.show.drawing.solids import Facets

__all__ = ["draw_ground", "opening_of"]

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_COLOUR = (0.78, 0.76, 0.70)
_LINE_COLOUR = (0.40, 0.40, 0.38)
_LINE_STRENGTH = 0.3
_LINE_STEP = 1.0  # m
_SIDES = 120
_RINGS = np.array([0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0])


def opening_of(points: Matrix) -> Matrix:
    """(k, 2) the convex outline of points (m, 2), counterclockwise."""
    return np.asarray(points[ConvexHull(points).vertices])


def draw_ground(
    visualizer: Any, *, centre: Vector, radius: float, opacity: float, opening: Matrix | None = None,
    height: float = 0.0, colour: tuple[float, float, float] = _COLOUR,
) -> None:  # fmt: skip
    """Draw level ground.

    Parameters
    ----------
    visualizer: the node that becomes the ground.
    centre: (2,) of the sheet [m].
    opacity: below 1 where something beneath it is to be seen.
    opening: (k, 2) convex and counterclockwise: where obstacles themselves are the
        ground, so that none is drawn; None for a whole sheet.
    height: z of the ground [m].
    """
    if opening is not None and np.linalg.norm(opening - centre, axis=1).max() > 0.9 * radius:
        opening = None
    rgba: Rgba = (*colour, min(opacity, 0.999))
    level = translation_matrix([0.0, 0.0, height])
    sheet = visualizer["sheet"]
    sheet.set_object(mesh(_sheet(centre, radius, rgba, opening), rgba, behind=True))
    sheet.set_transform(level)
    set_property(sheet, "castShadow", False)
    set_property(sheet, "renderOrder", -2)
    lines = visualizer["lines"]
    lines.set_object(line_segments(*_lines(centre, 0.85 * radius, opening)))
    lines.set_transform(level)
    set_property(lines, "castShadow", False)
    set_property(lines, "renderOrder", -1)


def _strength(off: Vector) -> Vector:
    """1 near the middle, 0 from `off` = 1 on."""
    part = np.clip((1.0 - off) / 0.6, 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def _sheet(centre: Vector, radius: float, rgba: Rgba, opening: Matrix | None) -> Facets:
    middle = centre if opening is None else opening.mean(axis=0)
    angle = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    if opening is not None:
        corners = np.arctan2(*(opening - middle).T[::-1]) % (2.0 * np.pi)
        angle = np.unique(np.concatenate((angle, corners)))
    away = np.column_stack((np.cos(angle), np.sin(angle)))
    inner = np.zeros(len(angle)) if opening is None else _ray_lengths(middle, away, opening)
    # from the middle along each direction to the rim
    along = away @ (centre - middle)
    outer = along + np.sqrt(along**2 + radius**2 - np.sum((centre - middle) ** 2))
    part = np.linspace(0.0, 1.0, len(_RINGS)) if opening is None else _RINGS
    distance = inner[None, :] + part[:, None] * (outer - inner)[None, :]
    flat = middle + distance[..., None] * away[None]
    points = np.column_stack((flat.reshape(-1, 2), np.zeros(flat.shape[0] * flat.shape[1])))
    alpha = rgba[3] * _strength(np.linalg.norm(points[:, :2] - centre, axis=1) / radius)
    count = len(angle)
    here, right = np.arange(count), (np.arange(count) + 1) % count
    faces = []
    for ring in range(len(part) - 1):
        a, b = ring * count, (ring + 1) * count
        faces += [np.column_stack((a + here, b + here, b + right)), np.column_stack((a + here, b + right, a + right))]
    return Facets(
        vertices=points,
        normals=np.broadcast_to([0.0, 0.0, 1.0], points.shape).copy(),
        faces=np.vstack(faces).astype(np.uint32),
        rgba=np.column_stack((np.broadcast_to(rgba[:3], (len(points), 3)), alpha)),
    )


def _ray_lengths(origin: Vector, away: Matrix, polygon: Matrix) -> Vector:
    """How far each ray from inside a convex polygon goes until it leaves it."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack((edge[:, 1], -edge[:, 0]))
    height = np.einsum("ij,ij->i", polygon - origin, normal)
    speed = away @ normal.T
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.where(speed > 1e-12, height / speed, np.inf)
    return np.asarray(length.min(axis=1))


def _lines(centre: Vector, radius: float, opening: Matrix | None) -> tuple[Matrix, Matrix]:
    """Ends (2k, 3) of the segments and their colours (2k, 4), paler towards the rim."""
    ends: list[Vector] = []
    for axis in (0, 1):
        across = np.array([0.0, 1.0]) if axis == 0 else np.array([1.0, 0.0])
        first = np.ceil((centre[1 - axis] - radius) / _LINE_STEP)
        last = np.floor((centre[1 - axis] + radius) / _LINE_STEP)
        for offset in np.arange(first, last + 1) * _LINE_STEP:
            half = np.sqrt(max(radius**2 - (offset - centre[1 - axis]) ** 2, 0.0))
            stations = centre[axis] + np.linspace(-half, half, 15)
            start = np.zeros(2)
            start[axis], start[1 - axis] = 0.0, offset
            along = 1.0 - across
            inside = None if opening is None else _crossing(start, along, opening)
            if inside is not None:
                stations = np.unique(np.concatenate((stations, inside)))
            for a, b in pairwise(stations):
                if inside is None or not inside[0] < 0.5 * (a + b) < inside[1]:
                    ends += [start + a * along, start + b * along]
    flat = np.array(ends)
    strength = _LINE_STRENGTH * _strength(np.linalg.norm(flat - centre, axis=1) / radius)
    points = np.column_stack((flat, np.full(len(flat), 0.006)))
    return points, np.column_stack((np.broadcast_to(_LINE_COLOUR, (len(flat), 3)), strength))


def _crossing(start: Vector, along: Vector, polygon: Matrix) -> tuple[float, float] | None:
    """Where a line is inside a convex polygon."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.column_stack((edge[:, 1], -edge[:, 0]))
    height = np.einsum("ij,ij->i", polygon - start, normal)
    speed = normal @ along
    flat = np.abs(speed) < 1e-12
    if np.any(flat & (height < 0.0)):
        return None
    low = float(np.max(height[speed < -1e-12] / speed[speed < -1e-12], initial=-np.inf))
    high = float(np.min(height[speed > 1e-12] / speed[speed > 1e-12], initial=np.inf))
    return (low, high) if high > low else None
