"""The names of a sequence's legs above a figure's panels, in as many rows as are needed to keep them apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from backhoe_planner.planning import Plan
from backhoe_planner.show.plots.figure_file import plain_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE = 7.5  # pt of the letters
_LETTER = 0.62 * _SIZE  # pt, average width of a letter of DejaVu Sans, rounded up
_ROW = 1.3 * _SIZE  # pt from row to row
_BESIDE = 3.0  # pt between a name and its line
_ABOVE = 12.0  # pt above the panel, which leaves room for the panel's own remark


def label_rows(begins: Sequence[float], widths: Sequence[float]) -> list[int]:
    """The row of each name, so that no two overlap: the lowest that is free at its beginning, from 0.

    Parameters
    ----------
    begins: where the names begin, increasing.
    widths: widths of the names, in the same unit.
    """
    ends: list[float] = []
    rows = []
    for begin, width in zip(begins, widths, strict=True):
        row = next((row for row, end in enumerate(ends) if end <= begin), len(ends))
        ends[row : row + 1] = [begin + width]
        rows.append(row)
    return rows


def name_legs(axes: Axes, plan: Plan, *, width: float) -> float:
    """Write the name of each leg, and what it carries, above the leg's beginning.

    Parameters
    ----------
    width: width of the panel [pt].

    Returns
    -------
    Height of the names above the panel [pt]; 0 without legs.
    """
    if not plan.legs:
        return 0.0
    words = []
    for leg in plan.legs:
        carried = leg.problem.robot.carried
        words.append(leg.name if carried is None else f"{leg.name} (carries {carried[0]})")
    time = plan.trajectory.time
    scale = width / max(float(time[-1] - time[0]), 1e-9)
    begins = [scale * float(leg.begins - time[0]) for leg in plan.legs]
    widths = [_LETTER * len(one) + 2.0 * _BESIDE for one in words]
    rows = label_rows(begins, widths)
    for leg, one, row in zip(plan.legs, words, rows, strict=True):
        axes.annotate(
            plain_text(one), (leg.begins, 1.0), xycoords=("data", "axes fraction"),
            xytext=(_BESIDE, _ABOVE + row * _ROW), textcoords="offset points", fontsize=_SIZE, color="0.35",
            annotation_clip=True,
        )  # fmt: skip
    return _ABOVE + (max(rows) + 1) * _ROW
