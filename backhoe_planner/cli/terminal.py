"""What the commands share: arguments, exit statuses, and where they print."""

from __future__ import annotations

import contextlib
import math
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import typer
from rich.console import Console
from rich.text import Text

if TYPE_CHECKING:
    from rich.table import Table

Urdf = Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or example:NAME.", show_default=False)]
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).", show_default=False)]
PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="A plan file (JSON).", show_default=False)]
PlanUrdf = Annotated[
    str | None, typer.Option("--urdf", metavar="URDF", help="Where the URDF lies now, if not where the plan says.")
]

VERIFIED, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130  # exit statuses; 130 is the shells' own for Ctrl-C
DEGREES = math.degrees(1.0)  # in a radian

OUT = Console(highlight=False, markup=False, emoji=False, soft_wrap=True)
ERR = Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


def print_error(message: str) -> None:
    """Print the one line about an error; in vain where the error stream cannot be written either."""
    try:
        ERR.print(Text("error: ", style="bold red") + Text(message))
        sys.stderr.flush()
    except OSError:
        let_go(sys.stderr)


def let_go(stream: TextIO) -> None:
    """Send what is still buffered nowhere: it would fail again when Python ends, with 120 as the exit status."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def print_warnings(warnings: Iterable[str]) -> None:
    """Print each of `warnings` once, to the error stream."""
    for warning in dict.fromkeys(warnings):
        ERR.print(f"warning: {warning}")


def table_of(*heads: str) -> Table:
    """An empty table with a column below each of the `heads`."""
    from rich.table import Table

    return Table(*heads, box=None, pad_edge=False)
