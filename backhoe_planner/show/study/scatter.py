"""A picture of points in two metrics, as SVG: the points that no other beats are joined by a curve."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence

_WIDTH, _HEIGHT = 340.0, 230.0  # units of the picture, which is drawn as wide as its card
_LEFT, _RIGHT, _TOP, _BOTTOM = 52.0, 10.0, 8.0, 38.0  # room for numbers and names
_MOST_POINTS = 3000  # points drawn; chosen: more would hide each other and slow down the page
_TICKS = 4  # approximate number on each axis

Point = tuple[float, float, int, bool]


def scatter(x_name: str, y_name: str, points: Sequence[Point], *, best: int | None, forward: bool) -> str:
    """The picture as SVG.

    Parameters
    ----------
    points: x, y, number of the row, and whether no other row beats it.
    best: number of the row that gets a ring.
    forward: whether less of x is better, so that the curve is drawn from the least x.
    """
    front = sorted((point for point in points if point[3]), key=lambda one: one[0], reverse=not forward)
    others = [point for point in points if not point[3]]
    others = others[:: max(1, math.ceil(len(others) / _MOST_POINTS))]
    low_x, high_x = _ends([point[0] for point in points])
    low_y, high_y = _ends([point[1] for point in points])

    def place(x: float, y: float) -> tuple[float, float]:
        across = _LEFT + (x - low_x) / (high_x - low_x) * (_WIDTH - _LEFT - _RIGHT)
        up = (y - low_y) / (high_y - low_y) * (_HEIGHT - _TOP - _BOTTOM)
        return across, _HEIGHT - _BOTTOM - up

    parts = [f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{_text(f"{y_name} over {x_name}")}">']
    for tick in _ticks(low_x, high_x):
        x, _ = place(tick, low_y)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}"/>')
        parts.append(f'<text x="{x:.1f}" y="{_HEIGHT - _BOTTOM + 14:g}" text-anchor="middle">{tick:g}</text>')
    for tick in _ticks(low_y, high_y):
        _, y = place(low_x, tick)
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 5:g}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
    parts.append(f'<text x="{middle:g}" y="{_HEIGHT - 6:g}" text-anchor="middle">{_text(x_name)}</text>')
    curve = " ".join("{:.1f},{:.1f}".format(*place(x, y)) for x, y, _, _ in front)
    parts.append(f'<polyline class="curve" points="{curve}"/>')
    for kind, radius, some in (("row", 2.6, others), ("front", 3.4, front)):
        for x, y, number, _ in some:
            at = place(x, y)
            words = _text(f"row {number}: {x_name} {x:.4g}, {y_name} {y:.4g}")
            parts.append(
                f'<circle class="{kind}" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius}"><title>{words}</title></circle>'
            )
            if number == best:
                parts.append(f'<circle class="best" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="6.5"/>')
    parts.append("</svg>")
    return "".join(parts)


def _ends(values: Sequence[float]) -> tuple[float, float]:
    """The ends of an axis that contains all values, with some room."""
    low, high = min(values), max(values)
    room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - room, high + room


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers on an axis."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * k for k in (1.0, 2.0, 2.5, 5.0, 10.0) if power * k >= rough)
    first = math.ceil(low / step)
    return [float(f"{k * step:.12g}") for k in range(first, math.floor(high / step) + 1)]


def _text(text: str) -> str:
    return html.escape(text)
