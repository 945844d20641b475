"""The map of a site as a figure."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.show.plots.figure_file import dress, new_figure, plain_text, save_figure
from backhoe_planner.show.standing.site_sketch import (
    COSTS,
    DIG,
    GIVEN,
    HEAP,
    MACHINE,
    OBSTACLE,
    THINGS,
    WHOLE,
    WHY,
    Machine,
    Sketch,
    colour,
    name_place,
    sketch_of,
)
from backhoe_planner.standing import StandPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BODY = "#c9ced3"  # of the machine, below the costs
_BELOW = -38.0  # points from the map down to the legend: the numbers and the name of the axis are between; chosen
_LONGER, _LEAST = 9.0, 4.5  # inches along the longer side of the map, and at least along the other; chosen


def plot_stand(plan: StandPlan, path: str | os.PathLike[str]) -> None:
    """Write the map of a site, coloured by cost, as a figure.

    Raises
    ------
    OutputError: the suffix is not .png, .svg or .pdf, the folder cannot be written, or the file is one of the job's.
    InputError: matplotlib is not installed.
    """
    sketch = sketch_of(plan)
    size = sketch.high - sketch.low
    width, height = np.maximum(_LONGER * size / size.max(), _LEAST)
    figure = new_figure(path, float(width) + 1.6, float(height) + 1.3, inputs=plan.job.files)
    axes = figure.subplots()
    dress(axes)
    _draw(axes, sketch)
    axes.set_aspect("equal")
    axes.set_xlim(sketch.low[0], sketch.high[0])
    axes.set_ylim(sketch.low[1], sketch.high[1])
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if np.isfinite(plan.map.cost).any():
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LinearSegmentedColormap, Normalize

        least, most = (sketch.scale * cost for cost in sketch.range)
        scale = ScalarMappable(Normalize(least, most), LinearSegmentedColormap.from_list("costs", COSTS))
        figure.colorbar(scale, ax=axes, shrink=0.7, label=f"{sketch.unit} from there, about")
    save_figure(figure, path, f"{plain_text(plan.job.name or 'job')}: where to stand")


def _draw(axes: Axes, sketch: Sketch) -> None:
    from matplotlib.patches import Patch, Polygon
    from matplotlib.transforms import ScaledTranslation

    for cell in sketch.cells:
        finite = np.isfinite(cell.spot.cost)
        shade = colour(sketch, cell.spot.cost) if finite else WHY[cell.spot.reason][0]
        pale = finite and cell.spot.share < WHOLE
        axes.add_patch(Polygon(cell.corners, facecolor=shade, edgecolor="none", alpha=0.35 if pale else 1.0, zorder=1))
    for outline in sketch.heaps:
        axes.add_patch(Polygon(outline, facecolor=HEAP, edgecolor="none", alpha=0.6, zorder=2))
    for outline in sketch.digs:
        axes.add_patch(Polygon(outline, facecolor=DIG, edgecolor="#4d3a26", linewidth=0.8, alpha=0.85, zorder=3))
    for outline in (*sketch.things, *(one for _, one in sketch.obstacles)):
        axes.add_patch(Polygon(outline, facecolor=OBSTACLE, edgecolor="none", alpha=0.5, zorder=4))
    for name, outline in sketch.obstacles:
        place = name_place(sketch, outline)
        if place is not None:
            axes.annotate(plain_text(name), place, fontsize=8, color="#3b4650", ha="center", zorder=7)
    if sketch.given is not None:
        _machine(axes, sketch.given, GIVEN, filled=False)
    for machine in sketch.machines:
        _machine(axes, machine, MACHINE, filled=True)
    seen = {cell.spot.reason for cell in sketch.cells if cell.spot.reason}
    handles = [Patch(facecolor=shade, label=words) for reason, (shade, words) in WHY.items() if reason in seen]
    handles += [Patch(facecolor=DIG, label="dug"), Patch(facecolor=HEAP, label="heap or truck")]
    if sketch.things:
        handles.append(Patch(facecolor=OBSTACLE, alpha=0.5, label=THINGS))
    if any(cell.spot.share < WHOLE for cell in sketch.cells if np.isfinite(cell.spot.cost)):
        handles.append(Patch(facecolor=colour(sketch, sketch.range[0]), alpha=0.35, label="pale: reaches a part only"))
    if sketch.given is not None:
        handles.append(Patch(facecolor="none", edgecolor=GIVEN, linestyle="--", label="the given place"))
    below = axes.transAxes + ScaledTranslation(0.0, _BELOW / 72.0, axes.figure.dpi_scale_trans)
    axes.legend(
        handles=handles, fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, 0.0), bbox_transform=below, ncols=3,
        frameon=False,
    )  # fmt: skip


def _machine(axes: Axes, machine: Machine, shade: str, *, filled: bool) -> None:
    from matplotlib.patches import Polygon

    # all rims are below all faces, so that only the common outline of overlapping parts remains
    level, style, face = (0.4, "-", _BODY) if filled else (0.2, "--", "white")
    for outline in machine.outlines:
        axes.add_patch(
            Polygon(outline, facecolor="none", edgecolor=shade, linestyle=style, linewidth=1.6, zorder=level)
        )
        axes.add_patch(Polygon(outline, facecolor=face, edgecolor="none", zorder=level + 0.1))
    if filled:
        (x, y), (to_x, to_y) = machine.axis.tolist(), machine.digs.tolist()
        arrow = {"arrowstyle": "->", "color": shade, "linewidth": 1.4}
        axes.annotate("", (to_x, to_y), xytext=(x, y), zorder=6, arrowprops=arrow)
        axes.plot(x, y, "o", color="white", markeredgecolor=shade, markersize=11, zorder=7)
        axes.annotate(machine.label, (x, y), fontsize=8, ha="center", va="center", zorder=8)
