"""Descent of the time: a curve costs the duration of its fastest motion.

The program minimises T. A step that misses a clearance is judged only after a further step that may repair it.
"""

from __future__ import annotations

import numpy as np

from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import SAMPLE_PERIOD, Drive, Goal, Trajectory, time_curve
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import (
    GROW,
    KEPT,
    LARGEST_BOX,
    MISSED_PRICE,
    MISSED_WORTH,
    SHRINK,
    SMALLEST_BOX,
    STUCK,
    Descent,
    Options,
    Timed,
    is_astray,
)
from backhoe_planner.planning.descent.looks import Looks
from backhoe_planner.planning.descent.margins import Margins

_GRID_PER_PIECE = 6  # intervals on which a curve is timed; chosen: limits between them are corrected
_ENOUGH = 2e-3  # part of the cost: a round that gains less ends the descent
# the same for a descent in a hurry; chosen: the last round, which gains less, is a fifth of its time
_ENOUGH_HURRIED = 0.01
# the same for the gain that the program predicts for a clear curve in a hurry, which then ends; chosen: with 0.01
# motions take longer, for no less work
_ENOUGH_PROMISED = 0.005
_UNEVEN = 1.1  # times the duration of its fastest motion, from which a curve is fitted to that motion; chosen
_MENDED = 0.1  # m: a step that misses by less is judged only after another step; chosen
_ITERATIONS = 2_000  # of the quadratic program at most; it takes some hundred


def fastest_along(curve: JointCurve, limits: JointLimits, drive: Drive) -> Trajectory | None:
    """The fastest motion along a curve; None if it has none."""
    grid = np.linspace(0.0, 1.0, _GRID_PER_PIECE * curve.pieces + 1)
    return time_curve(curve, grid, limits, drive=drive)


class DescentOfTime(Descent):
    """Descents to the fastest motions."""

    def run(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed | None:
        """See `Descent.run`."""
        free, longest, box = goal if goal.q is None else None, options.longest, options.box
        looks = self._looks(curve, options.spare, options.density, free)
        here = self._timed(self._within_cones(curve, looks), max(duration, SAMPLE_PERIOD), looks)
        if here is None:
            return None
        price = MISSED_WORTH * here.cost
        enough = _ENOUGH_HURRIED if self._hurried else _ENOUGH
        begun, steps, failed = self.rounds, 0, 0
        clear, box_then = here, box  # the last clear curve, with the box of that round
        while self.rounds - begun < options.most_rounds and not options.is_hopeless(here, steps):
            self._brake.check()
            steps, self.rounds = steps + 1, self.rounds + 1
            worst, known = here.cost + price * here.missed, looks.known
            tried = there = self._step(here, free, looks, box, below=worst, longest=longest)
            if there is here:
                break
            if there is not None and worst <= there.cost + price * there.missed:
                there = self._mended(there, free, looks, box, below=worst, longest=longest)
            gain = -np.inf if there is None else worst - there.cost - price * there.missed
            if there is None or gain <= 0.0:
                failed += 1
                if failed >= STUCK and is_astray(here, clear, looks):
                    here, box = clear, min(box, box_then)
                if tried is not None:
                    looks.widen(tried.margins)
                if looks.known != known:
                    here = self._seen_anew(here, looks)
                box *= SHRINK
                if box < SMALLEST_BOX:
                    break
                continue
            here, failed = self._in_its_own_time(there, price, looks), 0
            box = min(GROW * box, LARGEST_BOX)
            if here.missed <= looks.allowed:
                clear, box_then = here, box
            if gain < enough * here.cost and here.missed <= KEPT:
                break
        return clear if is_astray(here, clear, looks) else here

    def _step(
        self, here: Timed, goal: Goal | None, looks: Looks, box: float, *, below: float, longest: float
    ) -> Timed | None:  # fmt: skip
        """The curve after the best small step, see `_timed`; None if there is none, and `here` if that is good enough.

        Parameters
        ----------
        longest: T after the step [s].
        """
        model = self._model(here, goal, looks, box)
        x = model.best_step(MISSED_PRICE, bend=None, longest=longest, most_iterations=_ITERATIONS)
        if x is None:
            return None
        control, duration = model.step(x)
        # not with a fixed end: the motion may then become much shorter nevertheless, because its own time is not T
        may_end = self._hurried and goal is not None and here.missed <= looks.allowed
        if may_end and duration > (1.0 - _ENOUGH_PROMISED) * here.cost:
            return here
        curve = self._on_goal(here.curve, control, goal, looks)
        return None if curve is None else self._timed(curve, duration, looks, below=below)

    def _mended(
        self, there: Timed, goal: Goal | None, looks: Looks, box: float, *, below: float, longest: float
    ) -> Timed | None:  # fmt: skip
        """The curve after one more step, which repairs what the step before has missed, if that is little."""
        if there.missed >= _MENDED or there.cost >= below:
            return there
        self.rounds += 1
        return self._step(there, goal, looks, box, below=below, longest=longest)

    def _in_its_own_time(self, here: Timed, price: float, looks: Looks) -> Timed:
        """The same curve over the time of its fastest motion, if that is much shorter than T and costs no more."""
        if here.duration < _UNEVEN * here.motion.duration:
            return here
        curve = JointCurve.fitted(here.motion, here.curve.pieces, self._problem.limits)
        there = self._timed(curve, here.motion.duration, looks)
        if there is None or there.cost + price * there.missed > (1.0 + _ENOUGH) * (here.cost + price * here.missed):
            return here
        return there

    def _timed(self, curve: JointCurve, duration: float, looks: Looks, *, below: float = np.inf) -> Timed | None:
        """The curve with its fastest motion; None if it has none.

        If it does not cost less than `below`, its clearances are not checked.
        """
        fastest = fastest_along(curve, self._problem.limits, self._drive)
        if fastest is None:
            return None
        cost = fastest.duration
        margins = Margins.none(curve.control.shape[1]) if cost >= below else looks.find_margins(curve)
        return Timed(curve, duration, cost, max(-margins.least, 0.0), margins, within_limits=fastest)
