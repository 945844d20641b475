"""Panels for a plan without a motion: the posture at the start, with its limits and nearby obstacles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.digits import margin_text
from backhoe_planner.motion import Problem
from backhoe_planner.planning import Plan
from backhoe_planner.show.drawing.palette import PLOT_CYCLE
from backhoe_planner.show.drawing.timeline import Timeline
from backhoe_planner.show.plots.figure_file import plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BAR = 0.5  # height of a bar, for rows that are 1 apart; chosen
_ROW = 0.34  # inches for each row of a panel; chosen, a line of text and some space
_FRAME = 0.9  # inches of a panel around its rows; chosen


def posture_heights(problem: Problem, frames: Timeline) -> list[float]:
    """Heights of the panels that `draw_posture` fills [inches]."""
    rows = [problem.robot.n] + ([len(frames.obstacles)] if frames.obstacles else [])
    return [_FRAME + _ROW * count for count in rows]


def draw_posture(all_axes: list[Axes], plan: Plan, problem: Problem, frames: Timeline) -> None:
    """Draw the position of each joint in its range, and the margin to each obstacle, at the start of a plan."""
    _draw_joints(all_axes[0], plan, problem)
    if len(all_axes) > 1:
        _draw_margins(all_axes[1], plan, frames)


def _draw_joints(axes: Axes, plan: Plan, problem: Problem) -> None:
    """Ranges are drawn equally long, because some are angles and some lengths; without a range there is no bar."""
    rows, words = np.arange(plan.robot.n), []
    for joint, name in enumerate(plan.robot.joint_names):
        slides, q = bool(plan.robot.prismatic[joint]), float(plan.trajectory.q[0, joint])
        scale, unit = (1.0, "m") if slides else (np.degrees(1.0), "deg")
        low, high = float(problem.limits.lower[joint]), float(problem.limits.upper[joint])
        words.append(f"{plain_text(name)}  {scale * q:.4g} {unit}")
        if np.isfinite(low) and np.isfinite(high) and high > low:
            part = (q - low) / (high - low)
            axes.barh(joint, 1.0, _BAR, color="0.92")
            axes.plot([part], [joint], "o", color=PLOT_CYCLE[joint % len(PLOT_CYCLE)], markersize=8)
            for at, value, side in ((0.0, low, "left"), (1.0, high, "right")):
                axes.text(at, joint, f" {scale * value:.4g} ", fontsize=8, color="0.35", va="center", ha=side)
    axes.set_yticks(rows, words)
    axes.set_xticks([])
    axes.set_xlim(-0.01, 1.01)
    axes.invert_yaxis()
    axes.grid(visible=False)
    axes.set_title("joints at the start, within their ranges", loc="left", fontsize=9.5)


def _draw_margins(axes: Axes, plan: Plan, frames: Timeline) -> None:
    far = 2.0 * plan.scene.influence
    rows, margins = np.arange(len(frames.obstacles)), []
    for row in rows.tolist():
        margin = float(frames.margins(row)[0])
        shown = far if np.isnan(margin) else min(margin, far)
        margins.append(shown)
        inside = not np.isnan(margin) and margin < 0.0
        axes.barh(row, shown, _BAR, color="#b3261e" if inside else PLOT_CYCLE[0], alpha=0.3 if shown == far else 0.85)
        text = f"more than {far:.2g} m" if shown == far else f"{margin_text(margin, '.3f')} m"
        axes.annotate(
            text, (max(shown, 0.0), row), xytext=(4, 0), textcoords="offset points", fontsize=8.5, va="center"
        )
    axes.axvline(0.0, color="#b3261e", linewidth=1.1)
    axes.set_yticks(rows, [plain_text(name) for name in frames.obstacles])
    axes.set_xlim(min(0.0, *margins) * 1.1, 1.25 * far)
    axes.set_xlabel("margin [m]: distance beyond the required clearance", fontsize=9)
    axes.invert_yaxis()
    axes.set_title("distances at the start", loc="left", fontsize=9.5)
