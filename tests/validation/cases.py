"""Cases of campaigns that other processes can import."""

from __future__ import annotations

import math
import os
import signal
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Part:
    """A result with a field of every type that campaigns store."""

    number: int
    share: float
    ends: tuple[str, ...]
    whole: bool


def square(number: int, *, calls: Path) -> Part:
    """The square of a number; every call leaves a file."""
    (calls / f"{number}-{len(list(calls.iterdir()))}").touch()
    return Part(number * number, math.nan if number == 2 else 1.0 / 3.0, (str(number),), np.bool_(number > 1))  # type: ignore[arg-type]


def divisors(number: int) -> list[int]:
    """At most two divisors other than 1 and the number itself."""
    return [one for one in range(2, number) if number % one == 0][:2]


def die_at_three(number: int) -> int:
    """The number; at 3 the process dies."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number
