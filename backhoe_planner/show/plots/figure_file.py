"""Figures of matplotlib: their common look, and their files."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from backhoe_planner.files.extras import need_package
from backhoe_planner.files.output_file import check_ending, check_output, whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FORMATS = (".png", ".svg", ".pdf")
_RESOLUTION = 150  # dots per inch; chosen, text of 8 points is readable on a screen


def new_figure(path: str | os.PathLike[str], width: float, height: float, *, inputs: tuple[Path, ...]) -> Figure:
    """A figure of this size [inches] that can be written to `path`; call it before anything is computed.

    Raises
    ------
    OutputError: the suffix is not .png, .svg or .pdf, the folder cannot be written, or the file is one of `inputs`.
    InputError: matplotlib is not installed.
    """
    check_figure(path, inputs)
    need_package("matplotlib", extra="plots", what="figures")
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=_RESOLUTION, layout="constrained")


def check_figure(path: str | os.PathLike[str], inputs: Sequence[Path] = ()) -> None:
    """Check that a figure can be written to a file; see `new_figure`."""
    check_ending(path, _FORMATS, what="a figure")
    check_output(path, inputs)


def dress(axes: Axes) -> None:
    """Give axes the look of all figures: no box, a pale grid behind the curves, small numbers."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_axisbelow(True)
    axes.grid(color="0.92", linewidth=0.8)
    axes.tick_params(labelsize=8.5, color="0.6")


def say_above(axes: Axes, text: str, *, loc: Literal["left", "right"], **look: Any) -> None:
    """Write `text` above `axes`. At a fixed height: matplotlib otherwise measures all ticks at each drawing to find it.

    Parameters
    ----------
    look: keyword arguments of `Axes.set_title`.
    """
    axes.set_title(text, loc=loc, y=1.0, **look)


def save_figure(figure: Figure, path: str | os.PathLike[str], title: str, *, panels: Sequence[Axes] = ()) -> None:
    """Write `figure` under its title, whole or not at all, in the format of the suffix.

    Parameters
    ----------
    panels: axes, one above the other, whose labels at the left stand in one line.
    """
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, weight="bold")
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        if panels:
            _align_labels(figure, panels)
        figure.savefig(drawn, format=Path(path).suffix[1:].lower(), dpi=_RESOLUTION)
    with whole_file(path, "wb") as stream:
        stream.write(drawn.getvalue())


def _align_labels(figure: Figure, panels: Sequence[Axes]) -> None:
    """Lay out `figure` for good, and put the labels at the left of `panels` where the outermost of them stands.

    `Figure.align_ylabels` gives the same picture, but measures the ticks of all panels for each panel, several times.
    """
    from matplotlib.transforms import blended_transform_factory

    figure.draw_without_rendering()
    figure.set_layout_engine(None)
    labels = [axes.yaxis.label for axes in panels]
    outermost = min(label.get_transform().transform(label.get_position())[0] for label in labels)
    across = outermost / figure.bbox.width
    for axes in panels:
        axes.yaxis.set_label_coords(across, 0.5, blended_transform_factory(figure.transFigure, axes.transAxes))


def plain_text(text: str) -> str:
    """`text` in a form that matplotlib shows literally: not as a formula, and not left out of legends."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
