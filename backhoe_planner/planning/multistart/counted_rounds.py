"""Rounds of descents, counted: no more are made than the effort of a plan allows."""

from __future__ import annotations

from dataclasses import replace

from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Descent, Options, Timed
from backhoe_planner.planning.search.effort import Work


class CountedRounds:
    """The rounds of the descents of one search, which are subtracted from the work of its world.

    Parameters
    ----------
    descent: what makes the rounds.
    in_one: how many of them take as long as one for the time, and count as one of `Effort.descent_rounds`.
    """

    def __init__(self, work: Work, descent: Descent, *, in_one: int = 1) -> None:
        self._work, self._descent, self._in_one = work, descent, in_one
        self._reserved = 0  # of `Effort.descent_rounds`
        self._not_counted = 0  # rounds on coarse curves, which take less time, beyond those for which they count

    def reserve(self, rounds: int) -> None:
        """Keep so many of `Effort.descent_rounds` for later descents."""
        self._reserved = rounds

    @property
    def left(self) -> int:
        """How many of `Effort.descent_rounds` may be used now, without the reserved ones."""
        return self._work.descent_rounds - self._reserved

    @property
    def left_of_cost(self) -> int:
        """How many rounds of a descent these are."""
        return self.left * self._in_one

    @property
    def made(self) -> int:
        """How many rounds were made so far, fewer for those on coarse curves."""
        return self._descent.rounds - self._not_counted

    def run(
        self, curve: JointCurve, duration: float, goal: Goal, options: Options, *, coarse_in_one: int = 1
    ) -> Timed | None:  # fmt: skip
        """A descent of no more rounds than are left; see `Descent.run`.

        Parameters
        ----------
        coarse_in_one: how many rounds on a coarse curve take as long as one, and count as one.
        """
        before = self._descent.rounds
        rounds = min(options.most_rounds, self.left_of_cost)
        found = self._descent.run(curve, duration, goal, replace(options, most_rounds=rounds))
        made = self._descent.rounds - before
        self._work.descent_rounds -= -(-made // (self._in_one * coarse_in_one))
        self._not_counted += made - -(-made // coarse_in_one)
        return found
