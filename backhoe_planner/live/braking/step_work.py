"""The work of one step of the servo, counted.

Every loop of a step is bounded by one of these counts, never by a clock. Where a bound is
reached, less is known of a braking path, so that it is not taken: the machine brakes on the
one that was proven before.
"""

from __future__ import annotations

from typing import NamedTuple

MOST_DISTANCES = 41  # of coal in a step, each some 10 to 30 us with what is made of it; an ordinary step has up to 2
MOST_NEAR = 128  # pairs that act on the wish, and all that slow down; chosen, an arm among people has up to 100
CLOSER_LOOK = 4  # of them for one pair with a plane for each part of its path, see `Separation.closer_look`


class StepWork(NamedTuple):
    """What a step took.

    Attributes
    ----------
    rows: of the largest quadratic program that was solved.
    problems, iterations: such programs, and the solver's iterations in all of them.
    paths: braking paths that were checked.
    distances: pairs of bodies whose distance was measured.
    pairs: that were near, so that they could act on the wish.
    """

    rows: int = 0
    problems: int = 0
    iterations: int = 0
    paths: int = 0
    distances: int = 0
    pairs: int = 0
