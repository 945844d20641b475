"""Level ground around the machine: a round sheet with a line every metre, fading out."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from trimesh.transformations import translation_matrix

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.show.drawing.drawing import draw, line_segments, mesh
from backhoe_planner.show.drawing.palette import UNTOUCHED, Rgba
from backhoe_planner.show.drawing.solids import Facets, sheet

# Colours and the following values are chosen by eye.
_LINE_COLOUR = (0.40, 0.40, 0.38)
_LINE_STRENGTH = 0.3  # opacity in the middle: visible, but fainter than any machine or obstacle
_LINE_STEP = 1.0  # m between lines, so that lengths can be read
_LINE_HEIGHT = 0.006  # m above the sheet, so that the two do not flicker
_SIDES = 120  # of the sheet's rim, which is almost invisible
_RINGS = np.array([0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0])  # parts of the distance to the rim, enough for fading


def opening_of(points: Matrix) -> Matrix:
    """(k, 2) the convex outline of points (m, 2), counterclockwise."""
    return np.asarray(points[ConvexHull(points).vertices])


def draw_ground(
    visualizer: Any, *, centre: Vector, radius: float, opacity: float, opening: Matrix | None = None,
    height: float = 0.0, colour: tuple[float, float, float] = UNTOUCHED,
) -> None:  # fmt: skip
    """Draw level ground.

    Parameters
    ----------
    visualizer: the node that becomes the ground.
    centre: (2,) middle of the sheet [m], world.
    radius: radius of the sheet [m].
    opacity: less than 1 if things beneath it should be visible.
    opening: (k, 2) convex outline, counterclockwise [m], of obstacles that are the ground there, so that the
        sheet is left out inside it; None for a whole sheet.
    height: z of the ground [m].
    """
    if opening is not None and np.linalg.norm(opening - centre, axis=1).max() > 0.9 * radius:
        opening = None
    rgba: Rgba = (*colour, min(opacity, 0.999))
    level = translation_matrix([0.0, 0.0, height])
    surface = visualizer["sheet"]
    draw(surface, mesh(_sheet(centre, radius, rgba, opening), rgba, behind=True), shadow=False, order=-2)
    surface.set_transform(level)
    lines = visualizer["lines"]
    draw(lines, line_segments(*_lines(centre, 0.85 * radius, opening)), shadow=False, order=-1)
    lines.set_transform(level)


def _strength(off: Vector) -> Vector:
    """Opacity factor, from 1 near the middle to 0 at the rim, where `off` is 1."""
    part = np.clip((1.0 - off) / 0.6, 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))


def _sheet(centre: Vector, radius: float, rgba: Rgba, opening: Matrix | None) -> Facets:
    middle = centre if opening is None else opening.mean(axis=0)
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES + 1)
    if opening is not None:
        corners = np.arctan2(*(opening - middle).T[::-1]) % (2.0 * np.pi)
        angle = np.unique(np.concatenate((angle, corners)))
    away = np.column_stack((np.cos(angle), np.sin(angle)))[::-1]  # rows run outward: in this order faces look up
    inner = np.zeros(len(angle)) if opening is None else _inside(middle, away, opening)[1]
    # from the middle along each direction to the rim
    along = away @ (centre - middle)
    outer = along + np.sqrt(along**2 + radius**2 - np.sum((centre - middle) ** 2))
    flat = middle + (inner + _RINGS[:, None] * (outer - inner))[..., None] * away
    strength = _strength(np.linalg.norm(flat - centre, axis=-1) / radius)
    return sheet(np.pad(flat, ((0, 0), (0, 0), (0, 1))), np.array([0.0, 0.0, 1.0]), rgba, strength)


def _lines(centre: Vector, radius: float, opening: Matrix | None) -> tuple[Matrix, Matrix]:
    """Ends (2k, 3) of the segments and their colours (2k, 4), paler towards the rim."""
    ends: list[Vector] = []
    for along, across in np.eye(2)[[[0, 1], [1, 0]]]:
        middle = float(across @ centre)
        for offset in np.arange(np.ceil((middle - radius) / _LINE_STEP), (middle + radius) / _LINE_STEP) * _LINE_STEP:
            start = offset * across
            half = np.sqrt(max(radius**2 - (offset - middle) ** 2, 0.0))
            stations = along @ centre + np.linspace(-half, half, 15)
            low, high = np.inf, -np.inf
            if opening is not None:
                low, high = (float(end[0]) for end in _inside(start, along[None], opening))
            if low < high:
                stations = np.unique(np.concatenate((stations, (low, high))))
            for a, b in pairwise(stations):
                if not low < 0.5 * (a + b) < high:
                    ends += [start + a * along, start + b * along]
    flat = np.array(ends)
    strength = _LINE_STRENGTH * _strength(np.linalg.norm(flat - centre, axis=1) / radius)
    points = np.column_stack((flat, np.full(len(flat), _LINE_HEIGHT)))
    return points, np.column_stack((np.broadcast_to(_LINE_COLOUR, (len(flat), 3)), strength))


def _inside(origin: Vector, directions: Matrix, polygon: Matrix) -> tuple[Vector, Vector]:
    """Where lines from `origin` (2,) along `directions` (k, 2) enter a convex polygon and leave it, (k,) each.

    For a line that misses the polygon, the value for leaving is less than the one for entering.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    outward = np.column_stack((edge[:, 1], -edge[:, 0]))
    height = np.einsum("ij,ij->i", polygon - origin, outward)
    speed = directions @ outward.T
    beside = (np.abs(speed) < 1e-12) & (height < 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        enters = np.where(speed < -1e-12, height / speed, -np.inf).max(axis=1)
        leaves = np.where(speed > 1e-12, height / speed, np.inf).min(axis=1)
    return np.asarray(enters), np.where(beside.any(axis=1), -np.inf, leaves)
