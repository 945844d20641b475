"""The work of one step of the servo, counted.

Every loop of a step is bounded by one of these counts, never by a clock. If a bound is reached,
less is known about a braking path, so it is not taken: the machine brakes along the path that
was proven before.
"""

from __future__ import annotations

from typing import NamedTuple

MOST_DISTANCES = 45  # measured by coal in a step, some 10 to 30 us each with its use; an ordinary step has up to 2
MOST_NEAR = 128  # pairs that act on the wish, plus all that slow down; chosen, an arm among people has up to 100
MOST_TOLD = 4  # pairs that are measured after a step to tell which one is too close; chosen
CLOSER_LOOK = 4  # distances for one pair with a plane for each part of its path, see `look_closely`


class StepWork(NamedTuple):
    """The counted work of one step of a servo.

    Attributes
    ----------
    rows: of the largest quadratic program that was solved.
    problems, iterations: number of such programs, and the solver's iterations in all of them.
    paths: number of braking paths that were checked.
    distances: number of pairs of bodies whose distance was measured.
    pairs: number of pairs that were near, so that they could act on the wish.
    """

    rows: int = 0
    problems: int = 0
    iterations: int = 0
    paths: int = 0
    distances: int = 0
    pairs: int = 0
