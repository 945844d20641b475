"""Common parts of the commands: arguments, exit statuses, and output streams."""

from __future__ import annotations

import contextlib
import math
import os
import sys
import threading
import time as clock
from collections.abc import Iterable
from contextlib import AbstractContextManager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TextIO, cast

import typer

if TYPE_CHECKING:
    from typing import Self

    from rich.console import Console
    from rich.status import Status
    from rich.table import Table

Urdf = Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or example:NAME.", show_default=False)]
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="A scene file (YAML).", show_default=False)]
PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="A plan file (JSON).", show_default=False)]
PlanUrdf = Annotated[
    str | None, typer.Option("--urdf", metavar="URDF", help="Where the URDF lies now, if not where the plan says.")
]

# exit statuses; the last two are the shells' own for Ctrl-C and for a pipe that nobody reads
VERIFIED, FAILED, BAD_INPUT, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141
DEGREES = math.degrees(1.0)  # in a radian
_FIRST_LINE, _NEXT_LINE = 3.0, 10.0  # s from the beginning, and from each line of a log to the next; chosen
_LOG_WIDTH = 1_000  # characters in a line of a log, which has no edge; chosen, more than any table has
_FORCING = {"FORCE_COLOR", "TTY_COMPATIBLE"}  # environment variables that make rich treat any stream as a terminal


class Stream:
    """The output or the error stream, to which lines are printed.

    rich takes a twentieth of the time of a simple plan to load. So it prints only tables, and text that is coloured
    or moves on a terminal.

    Parameters
    ----------
    name: stdout or stderr.
    """

    def __init__(self, name: Literal["stdout", "stderr"]) -> None:
        self._name = name

    @cached_property
    def console(self) -> Console:
        """rich's, on the same stream."""
        from rich.console import Console

        console = Console(
            stderr=self._name == "stderr", highlight=False, markup=False, emoji=False, soft_wrap=True
        )  # fmt: skip
        if not console.is_terminal:
            console.width = _LOG_WIDTH
        return console

    @property
    def is_terminal(self) -> bool:
        """Whether a person reads the stream as it is printed, and sees colours."""
        may_be = self._stream.isatty() or not _FORCING.isdisjoint(os.environ)
        return may_be and self.console.is_terminal

    def print(self, line: str | Table = "") -> None:
        """Print a line, or a table."""
        if isinstance(line, str) and "console" not in self.__dict__:  # otherwise a status line may be moving
            self._stream.write(line + "\n")
            self._stream.flush()
        else:
            self.console.print(line)

    def print_coloured(self, words: str, style: str, rest: str = "") -> None:
        """Print `words`, on a terminal in a style of rich, followed by the plain `rest` of the line."""
        if self.is_terminal:
            from rich.text import Text

            self.console.print(Text.assemble((words, style), rest))
        else:
            self.print(words + rest)

    def status(self, words: str, *, quiet: bool = False) -> AbstractContextManager[Status | PlainStatus | None]:
        """Show what is going on, while the context lasts: by a moving line if a person reads it, or by lines of a log.

        Parameters
        ----------
        quiet: whether to show nothing; the context is then None.
        """
        if quiet:
            return contextlib.nullcontext()
        return self.console.status(words) if self.is_terminal else PlainStatus(self, words)

    @property
    def _stream(self) -> TextIO:
        return cast(TextIO, getattr(sys, self._name))


class PlainStatus:
    """Lines of a log that show what is going on: one soon after the beginning, and then one now and then.

    Parameters
    ----------
    stream: to which they are printed.
    words: what is going on.
    """

    def __init__(self, stream: Stream, words: str) -> None:
        self._stream, self._words = stream, words
        self._begun, self._ended = 0.0, threading.Event()
        self._lines = threading.Thread(target=self._print_lines, daemon=True)

    def update(self, words: str) -> None:
        """Say in the next line that something else is going on."""
        self._words = words

    def __enter__(self) -> Self:
        self._begun = clock.monotonic()
        self._lines.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._lines.join()

    def _print_lines(self) -> None:
        """Print until the end, or until the stream cannot be written any more."""
        wait = _FIRST_LINE
        with contextlib.suppress(OSError, ValueError):
            while not self._ended.wait(wait):
                self._stream.print(f"{self._words} ({clock.monotonic() - self._begun:.0f} s)")
                wait = _NEXT_LINE


OUT, ERR = Stream("stdout"), Stream("stderr")


def print_verdict(failure: str) -> None:
    """Print that a result is verified, or its `failure` in words."""
    OUT.print_coloured(failure or "verified", "bold red" if failure else "bold green")


def print_error(message: str) -> None:
    """Print one line about an error; without effect if the error stream cannot be written either."""
    try:
        ERR.print_coloured("error: ", "bold red", message)
        sys.stderr.flush()
    except OSError:
        let_go(sys.stderr)


def let_go(stream: TextIO) -> None:
    """Discard buffered output, because writing it would fail again when Python ends, with exit status 120."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def print_warnings(warnings: Iterable[str]) -> None:
    """Print each of `warnings` once, to the error stream."""
    for warning in dict.fromkeys(warnings):
        ERR.print(f"warning: {warning}")


def table_of(*heads: str) -> Table:
    """An empty table with a column below each of the `heads`; too wide cells go on in the next line."""
    from rich.table import Column, Table

    return Table(*(Column(head, overflow="fold") for head in heads), box=None, pad_edge=False)
