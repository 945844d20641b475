"""The end of the time to plan in."""

from __future__ import annotations

import time as clock

__all__ = ["DEFAULT_BUDGET", "OutOfTime", "check_deadline"]

DEFAULT_BUDGET = 10.0  # s


class OutOfTime(Exception):  # noqa: N818 - an outcome inside the planner, not an error
    """The deadline has passed in the middle of something."""


def check_deadline(deadline: float) -> None:
    """Go on only before `deadline`, on `time.monotonic`.

    Raises
    ------
    OutOfTime: it has passed.
    """
    if clock.monotonic() > deadline:
        raise OutOfTime
