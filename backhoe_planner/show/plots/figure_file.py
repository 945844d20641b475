"""A matplotlib figure as a file: the format by its suffix, whole or not at all."""

from __future__ import annotations

import importlib.util
import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from backhoe_planner.errors import InputError, OutputError
from backhoe_planner.files.output_file import check_writable, whole_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_FORMATS = (".png", ".svg", ".pdf")
_RESOLUTION = 150  # dots per inch: text of 8 points is readable on a screen


def check_figure_file(path: str | os.PathLike[str]) -> None:
    """That a figure can be drawn and written; call it before anything is drawn.

    Raises
    ------
    OutputError: the suffix is none of .png, .svg, .pdf, or the folder cannot be written.
    InputError: matplotlib is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMATS:
        raise OutputError(
            "a figure cannot be written in this format", file=os.fspath(path), found=suffix or "no suffix",
            allowed=", ".join(_FORMATS),
        )  # fmt: skip
    check_writable(path)
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("figures need matplotlib", hint="pip install backhoe_planner[plots]")


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write `figure`, whole or not at all, in the format of the suffix."""
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure.savefig(drawn, format=Path(path).suffix[1:].lower(), dpi=_RESOLUTION)
    with whole_file(path, "wb") as stream:
        stream.write(drawn.getvalue())


def plain_text(text: str) -> str:
    """`text` as matplotlib shows it literally: no formulas, nothing left out of legends."""
    escaped = text.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped
