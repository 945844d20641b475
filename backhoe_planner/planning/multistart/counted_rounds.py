"""Rounds of descents, counted: no more are made than the effort of a plan allows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from backhoe_planner.motion import Goal
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Descent, Timed
from backhoe_planner.planning.world.world import World

_ROUNDS_IN_ONE = 3  # rounds for another cost that count as one for the time, as no curve is timed in them; measured
_SOFTENED = 2  # times more rounds for a cost that jumps, which is softened ever less in turn; measured
_SLOWER = 1.5  # times the duration of a start, that a descent from it may take while no longest time is known; chosen


class CountedRounds:
    """The rounds of the descents of one search, which are subtracted from the work of its world.

    Rounds for another cost than the time take less of the processor's time: several of them count as one of
    `Effort.descent_rounds`.

    Parameters
    ----------
    time: at which the positions of the obstacles are taken [s].

    Attributes
    ----------
    descent: what makes the rounds.
    more: factor on the rounds of each descent, because the cost jumps.
    """

    def __init__(self, world: World, *, time: float) -> None:
        self._work, objective = world.work, world.problem.objective
        self.descent = Descent(
            world.problem, world.proximity, world.kinematics, time=time, brake=world.work.brake,
            hurried=world.work.effort.is_hurried,
        )  # fmt: skip
        self.more = _SOFTENED if objective.jumps else 1
        self._in_one = 1 if objective.is_time else _ROUNDS_IN_ONE * self.more
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
        """How many rounds of a descent for the problem's cost these are."""
        return self.left * self._in_one

    @property
    def made(self) -> int:
        """How many rounds were made so far, fewer for those on coarse curves."""
        return self.descent.rounds - self._not_counted

    def run(
        self, curve: JointCurve, duration: float, goal: Goal, rounds: int, *,
        spare: float, density: int, box: float, is_hopeless: Callable[[Timed, int], bool], longest: float,
        unsampled: bool = False, rough: bool = False, clear_first: bool = False, fine: bool = False,
        in_one: int = 1,
    ) -> Timed | None:  # fmt: skip
        """At most so many rounds of a descent, and no more than are left; see `Descent.run`.

        Parameters
        ----------
        longest: the longest time that the motion may take [s]; if it is infinite, one and a half times `duration`.
        in_one: how many rounds on a coarse curve take as long as one, and count as one.
        """
        before = self.descent.rounds
        found = self.descent.run(
            curve, duration, goal,
            most_rounds=min(rounds, self.left_of_cost), spare=spare, density=density, box=box, is_hopeless=is_hopeless,
            longest=longest if np.isfinite(longest) else _SLOWER * duration,
            unsampled=unsampled, rough=rough, clear_first=clear_first, fine=fine,
        )  # fmt: skip
        made = self.descent.rounds - before
        self._work.descent_rounds -= -(-made // (self._in_one * in_one))
        self._not_counted += made - -(-made // in_one)
        return found
