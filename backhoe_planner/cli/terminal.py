"""Where the command line prints, and the exit statuses it ends with."""

from __future__ import annotations

import math
from collections.abc import Iterable

from rich.console import Console

__all__ = ["BAD_INPUT", "DEGREES", "ERR", "FAILED", "INTERRUPTED", "OUT", "VERIFIED", "print_warnings"]

VERIFIED, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
DEGREES = 180.0 / math.pi  # in a radian

OUT = Console(highlight=False, markup=False, soft_wrap=True)
ERR = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)


def print_warnings(warnings: Iterable[str]) -> None:
    """Each of `warnings` once, to the error stream."""
    for warning in dict.fromkeys(warnings):
        ERR.print(f"warning: {warning}")
