"""The dig as the search for a place sees it: points with their soil, and where no machine may stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backhoe_planner.arrays import Array, Flags, Matrix, Vector
from backhoe_planner.job import Worksite

EDGE = 0.6  # m between machine and dig: 2 ft in OSHA 29 CFR 1926.651(j)(2), 0.6 m free of load in DIN 4124
_SPACING = 0.1  # m between points, at least
_MOST_POINTS = 400.0  # about, in all: points of a larger area are further apart; chosen
_ACROSS = 7  # points across the blade, as for the lanes
_FAN = 0.04  # rad between lanes, as for the lanes
_STEP = 0.1  # m of radius between positions of the blade


@dataclass(frozen=True, eq=False)
class DigArea:
    """The area to be dug.

    Attributes
    ----------
    site: the job, without obstacles.
    points: (C, 2) in the area [m].
    z: (C,) heights of the design there [m].
    soil: (C,) how much soil each point stands for [m^3].
    keep_off: (K, 2) points that the machine keeps `distance` [m] away from.
    ground: approximate height of the ground there [m].
    in_line: whether the area is only as wide as the bucket, so that the arm must dig along it.
    middle: (2,) of the area [m].
    direction: (2,) unit vector along the area; for a surface along its longer side.
    length: along `direction` [m].
    width: across it [m].
    """

    site: Worksite
    points: Matrix
    z: Vector
    soil: Vector
    keep_off: Matrix
    distance: float
    ground: float
    in_line: bool
    middle: Vector
    direction: Vector
    length: float
    width: float

    @property
    def outline(self) -> Matrix:
        """(k, 2) corners of a convex outline of the area [m]."""
        return self.site.design.outline

    @property
    def depth(self) -> float:
        """Greatest depth of the dig [m]."""
        return self.ground - float(self.z.min())

    def covered(self, axis: Vector) -> Flags:
        """(C,) whether the whole width of the bucket fits over each point, from a swing axis at `axis` (2,) [m]."""
        if self.in_line:
            return np.ones(len(self.points), dtype=bool)
        site, width = self.site, self.site.bucket.width
        off = self.points - axis
        middle = float(np.arctan2(*(self.middle - axis)[::-1]))
        aside = (np.arctan2(off[:, 1], off[:, 0]) - middle + np.pi) % (2.0 * np.pi) - np.pi
        half = min(float(np.abs(aside).max()), 0.5 * np.pi)
        lanes = middle + _FAN * np.arange(-int(half / _FAN), int(half / _FAN) + 1)
        far = float(np.max(np.hypot(*off.T)))
        r = np.arange(0.5, far + _STEP, _STEP)
        out = np.stack((np.cos(lanes), np.sin(lanes)), axis=-1)
        left = np.stack((-out[:, 1], out[:, 0]), axis=-1)
        across = width * np.linspace(-0.5, 0.5, _ACROSS)
        blade = axis + r[:, None, None] * out[:, None, None, :] + across[:, None] * left[:, None, None, :]
        inside = np.all(site.design.within(blade, site.job.dig.tolerance), axis=-1)
        along, side = off @ out.T, off @ left.T
        row = np.clip(np.round((along - r[0]) / _STEP).astype(int), 0, len(r) - 1)
        under = (np.abs(side) <= 0.5 * width) & inside[np.arange(len(lanes)), row]
        return np.asarray(under.any(axis=1))


def dig_area(site: Worksite) -> DigArea:
    """The area that the job of a worksite digs.

    The machine stands at least `EDGE` away from it. Beside a trench, and all around a surface, the distance is also at
    least the depth of the dig, so that the machine's load, which spreads at 45 degrees, does not bear on the wall.
    """
    outline = site.design.outline
    low, high = outline.min(axis=0), outline.max(axis=0)
    trench = site.job.dig.trench
    area = float(np.prod(high - low)) if trench is None else trench.length * trench.width
    spacing = max(_SPACING, float(np.sqrt(area / _MOST_POINTS)))
    middle = outline.mean(axis=0)
    if trench is not None:
        direction = (np.array(trench.end) - trench.start) / trench.length
        length, width = trench.length, trench.width
    else:
        sizes = np.maximum(high - low, site.job.dig.surface.cell if site.job.dig.surface else 0.0)
        direction = np.eye(2)[int(np.argmax(sizes))]
        length, width = float(sizes.max()), float(sizes.min())
    points = _grid(middle, direction, length, width, spacing)
    z = site.design.height(points)
    ground = site.ground.height_at(points)
    own = np.asarray(np.isfinite(z) & (ground - z > 0.0))
    points, z, ground = points[own], z[own], ground[own]
    depth = float((ground - z).max()) if len(z) else 0.0
    beside = max(EDGE, depth)
    if trench is not None:
        keep_off = _grid(middle, direction, length + 2.0 * EDGE, width + 2.0 * beside, spacing)
        distance = 0.0
    else:
        keep_off, distance = points, beside
    slack = site.job.dig.tolerance
    soil = (ground - z) * spacing**2
    return DigArea(
        site, points, z, soil, keep_off, distance, float(np.median(ground)) if len(ground) else 0.0,
        trench is not None and trench.width - site.bucket.width <= 2.0 * slack,
        middle, direction, length, width,
    )  # fmt: skip


def _grid(middle: Vector, direction: Vector, length: float, width: float, spacing: float) -> Matrix:
    """(k, 2) points in a rectangle, at the centres of cells of about `spacing` [m]."""
    left = np.array([-direction[1], direction[0]])
    u, v = (
        (np.arange(max(round(size / spacing), 1)) + 0.5) * size / max(round(size / spacing), 1) - 0.5 * size
        for size in (length, width)
    )
    grid: Array = middle + u[:, None, None] * direction + v[None, :, None] * left
    return np.asarray(grid.reshape(-1, 2))
