"""Figures of matplotlib: their common look, and their files."""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

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

    return Figure(figsize=(width, height), layout="constrained")


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


def save_figure(figure: Figure, path: str | os.PathLike[str], title: str) -> None:
    """Write `figure` under its title, whole or not at all, in the format of the suffix."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=12, weight="bold")
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure.savefig(drawn, format=Path(path).suffix[1:].lower(), dpi=_RESOLUTION)
    with whole_file(path, "wb") as stream:
        stream.write(drawn.getvalue())


def plain_text(text: str) -> str:
    """`text` in a form that matplotlib shows literally: not as a formula, and not left out of legends."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
