"""Descent of another cost than the time: a curve costs what its motion in its own time t = T s does.

T may be as long as the longest time given. The program models how the cost in that time changes, see `own_time` and
`bend`; a step that costs more is shortened. A step that misses a clearance is taken once more with the clearances
linearised also where it went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import SAMPLE_PERIOD, Goal, Problem, motion_cost, time_evenly
from backhoe_planner.planning.descent.bend import Bend
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
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH, Kinks, suitable_width
from backhoe_planner.planning.descent.looks import KEPT_PART, Looks
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.descent.softening import soft_flows
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.site import Proximity

_CLEAR_FIRST = 10.0  # times both prices, if a curve has to get clear first; chosen: 50 leads further away
# times the price of missing after a step deeper into an obstacle, and times the first price at most; chosen
_MORE_MISSED, _MOST_MISSED = 4.0, 1e3
# rad or m of the fastest joint: the smallest box, smaller than for the time, as curvature shrinks steps too; chosen
_SMALLEST_BENT = 0.004
_AROUND = 3.0  # times the last step: the largest box of the next one; chosen
NO_COST = 1e-9  # in the objective's unit: a smaller cost counts as this
_SHORTENINGS = 2  # of a step that costs more; chosen: each takes half of a round
_SHORTEST = 0.1  # least part of a step that one shortening leaves; chosen
_SOFTEST = 1.5  # times the suitable width of kinks, above which it is made narrower; chosen
# part of the cost of a motion if no energy were regained, below which its cost counts as nothing; chosen: below it the
# programs become ill-conditioned
_NOTHING = 1e-4
# places of each piece for comparing many curves: for the cost, and for limits, as accelerations are linear on a
# piece; chosen: the order of straight lines is the same as with twice as many
_PLACES_OF_ESTIMATE, _PLACES_OF_LIMITS = 2, 1
_NEXT_BOX = 0.1  # rad or m: largest box of the first step after a cost that jumps becomes less soft; chosen
_LATE = 10.0  # extra cost, as a part of the cost, of a motion that takes twice as long as it may; chosen
# part of the longest time that a descent leaves unused: samples of a motion are slowed down by this if they exceed a
# limit between the places at which steps keep it; chosen: mostly less is needed
_TIME_SPARE = 1e-3
_HURRIES = 3  # tries to shorten a motion that nevertheless takes too long; chosen
_HURRY_ROUNDS = 6  # of each of them at most; chosen
_SLOW = 2  # a descent ends after so many rounds in a row that gain too little; chosen
_ENOUGH_BENT = 1e-3  # part of the cost: a smaller gain is too little; the cost keeps falling for long; chosen
_ENOUGH_ROUGH = 0.01  # the same if a finer curve follows; chosen: with 0.004 to 0.02 motions cost as much
_ITERATIONS_BENT = 300  # of a program at most; measured: of 2,700, those not solved after 200 were not after 600
_LEAST_PART = 0.25  # least part of a failed step, to which the box shrinks; chosen: another step may go elsewhere


@dataclass(frozen=True, eq=False)
class _State:
    """A curve, the box of the step from it, and the model of its cost."""

    here: Timed
    box: float
    bend: Bend

    def after_failure(self, part: float) -> _State:
        """The state for a shorter step: `part` of the usual shrinking is left."""
        return replace(self, box=self.box * (part * SHRINK), bend=self.bend.stiffer(1.0 / (part * SHRINK)))


class DescentOfCost(Descent):
    """Descents to the cheapest motions; parameters and attributes as for `Descent`."""

    def __init__(
        self, problem: Problem, proximity: Proximity, kinematics: Kinematics, *, time: float, brake: Brake,
        hurried: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(problem, proximity, kinematics, time=time, brake=brake, hurried=hurried)
        self._own_time = OwnTime(problem, self._drive)
        self._nothing = 0.0  # a cost that counts as nothing, in its unit
        self._width = LEAST_WIDTH  # by which kinks of the cost's rate are rounded off, in its unit per second
        self._longest = np.inf  # s that the motion of this descent may take
        self._curved: Matrix | None = None  # the curvature learnt with a softer cost, in its unit
        self._times_missed = 1.0  # factor on the price of what a curve of this descent misses

    def run(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed | None:
        """See `Descent.run`."""
        longest, objective = options.longest, self._problem.objective
        self._own_time = self._own_time.looked_at(fine=options.fine)
        self._times_missed = _CLEAR_FIRST if options.clear_first else 1.0
        within = (1.0 - _TIME_SPARE) * longest
        duration = min(duration, within) if duration <= longest else duration
        flow = self._own_time.mean_flow(curve, duration) if objective.jumps else 0.0
        flows = soft_flows(flow, first=options.unsampled, fine=options.fine, hurried=self._hurried)
        found = self._down_softly(curve, duration, goal, flows, replace(options, longest=within))
        if found is None or options.unsampled:
            return found
        found = self._as_sampled(found)
        hurrying = replace(options, most_rounds=_HURRY_ROUNDS, box=SMALLEST_BOX, is_hopeless=lambda here, rounds: False)
        for _ in range(_HURRIES):
            if found.motion.duration <= longest or found.missed > KEPT_PART * options.spare:
                break
            within *= (1.0 - _TIME_SPARE) * longest / found.motion.duration
            sooner = self._down_softly(
                found.curve, min(found.duration, within), goal, flows[-1:], replace(hurrying, longest=within)
            )
            if sooner is None:
                break
            found = self._as_sampled(sooner)
        return found

    def _down_softly(
        self, curve: JointCurve, duration: float, goal: Goal, flows: Sequence[float], options: Options
    ) -> Timed | None:  # fmt: skip
        """One descent for each of the soft `flows`, each from the result of the one before; see `_down`."""
        begun, found, box, self._curved = self.rounds, None, options.box, None
        for left, flow in zip(range(len(flows), 0, -1), flows, strict=True):
            rounds = options.most_rounds - (self.rounds - begun)
            if found is not None and rounds <= 0:
                break
            self._own_time = replace(self._own_time, soft_flow=flow)
            rounds = -(-rounds // left) if self._hurried else rounds
            rough = options.rough or left > 1
            there = self._down(curve, duration, goal, replace(options, most_rounds=rounds, box=box, rough=rough))
            found = there or found
            if there is None or options.is_hopeless(there, options.most_rounds):
                break
            curve, duration, box = there.curve, there.duration, min(box, _NEXT_BOX)
        self._own_time = replace(self._own_time, soft_flow=0.0)
        return found

    def _down(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed | None:
        """One descent; the result's cost is without rounded kinks."""
        free = goal if goal.q is None else None
        looks = self._looks(curve, options.spare, options.density, free)
        self._longest, self._width = options.longest, LEAST_WIDTH
        here = self._timed(self._within_cones(curve, looks), max(duration, SAMPLE_PERIOD), looks)
        if here is None:
            return None
        price, unit = self._times_missed * MISSED_WORTH * here.cost, max(here.cost, NO_COST)
        enough = _ENOUGH_ROUGH if options.rough else _ENOUGH_BENT
        now = clear = self._first(self._rounded_off(here), free, unit, options.box)  # now, and when it was clear
        begun, steps, failed, slow = self.rounds, 0, 0, 0
        before: Timed | None = None  # the curve before the last step, if `now.bend` is still that of it
        while self.rounds - begun < options.most_rounds:
            if options.is_hopeless(now.here, steps):
                if not is_astray(now.here, clear.here, looks):
                    break
                now, before = replace(clear, box=min(now.box, clear.box)).after_failure(1.0), None
                continue
            if now.here.cost <= self._nothing and now.here.missed <= looks.allowed:
                break
            self._brake.check()
            if before is not None:
                now, before = replace(now, bend=self._learnt(now.bend, before, now.here, free, unit)), None
                clear = replace(clear, bend=now.bend) if clear.here is now.here else clear
            if self._width > _SOFTEST * self._soft(now.here):
                now = self._narrower(now, free, unit)
                last = self._priced(clear.here) if is_astray(now.here, clear.here, looks) else now.here
                clear = replace(clear, here=last)
            steps, self.rounds = steps + 1, self.rounds + 1
            worst, known = now.here.cost + price * now.here.missed, looks.known
            there = self._step(now, free, looks, below=worst)
            part, noticed = 1.0, looks.known != known
            if there is not None:
                if noticed:  # the curve before may also go into a newly noticed obstacle
                    seen, known = self._seen_anew(now.here, looks), looks.known
                    clear = replace(clear, here=seen) if clear.here is now.here else clear
                    now = replace(now, here=seen)
                    worst = seen.cost + price * seen.missed
                there = self._cleared(now, there, free, looks, price)
                there, part = self._shortened(now.here, there, free, looks, now.bend.slope * unit, price)
            gain = -np.inf if there is None else worst - there.cost - price * there.missed
            if there is None or gain <= 0.0:
                failed += 1
                if failed >= STUCK and is_astray(now.here, clear.here, looks):
                    now = replace(clear, box=min(now.box, clear.box))
                if there is not None:
                    looks.widen(there.margins)
                if looks.known != known:
                    now, noticed = replace(now, here=self._seen_anew(now.here, looks)), True
                now = now.after_failure(1.0 if noticed else max(part, _LEAST_PART))
                if now.box < _SMALLEST_BENT:
                    break
                continue
            if there.missed > max(now.here.missed, looks.allowed):
                # so far, going into an obstacle gains more than it costs
                self._times_missed = min(_MORE_MISSED * self._times_missed, _MOST_MISSED)
                price = self._times_missed * MISSED_WORTH * unit
            # a box far beyond the steps that are taken makes the program large
            around = max(_AROUND * self._length(now.here, there), SMALLEST_BOX)
            box = min(GROW * part * now.box, LARGEST_BOX, around)
            before, now, failed = now.here, replace(now, here=there, box=box), 0
            if there.missed <= looks.allowed:
                clear = now
            slow = slow + 1 if gain < enough * there.cost else 0
            if slow >= _SLOW and there.missed <= KEPT:
                break
        if before is not None and self._problem.objective.jumps:
            now = replace(now, bend=self._learnt(now.bend, before, now.here, free, unit))
        found = clear if is_astray(now.here, clear.here, looks) else now
        self._curved = found.bend.curvature * unit if self._problem.objective.jumps else None
        self._width = LEAST_WIDTH
        return self._priced(found.here)

    def _first(self, here: Timed, goal: Goal | None, unit: float, box: float) -> _State:
        """The state in which a descent begins, with the curvature that a softer cost has shown."""
        bend = Bend.smooth(*self._slope(here, goal, unit), here.curve.pieces, self._unit, box, here.duration)
        return _State(here, box, bend if self._curved is None else replace(bend, curvature=self._curved / unit))

    def _narrower(self, now: _State, goal: Goal | None, unit: float) -> _State:
        """The same state with kinks rounded off by a width that suits the cost now."""
        here = self._rounded_off(now.here)
        slope, curvature, kinks = self._slope(here, goal, unit)
        return replace(now, here=here, bend=replace(now.bend, slope=slope, known=curvature, kinks=kinks))

    def estimates(self, curves: Sequence[JointCurve], durations: Vector, *, longest: float) -> Vector:
        """(C,) estimated costs of curves with the same pieces in their own times.

        Parameters
        ----------
        durations: (C,) of each [s]; longer if the limits require it.
        longest: the longest time that a motion may take [s].
        """
        T = self._own_time.least_durations(curves, durations, places=_PLACES_OF_LIMITS)
        late = np.maximum(T / longest - 1.0, 0.0)
        costs = self._own_time.costs(curves, T, width=LEAST_WIDTH, places=_PLACES_OF_ESTIMATE)
        return np.asarray(costs * (1.0 + _LATE * late))

    def _soft(self, here: Timed) -> float:
        return float(suitable_width(max(here.cost, self._nothing), here.duration, len(self._unit)))

    def _rounded_off(self, here: Timed) -> Timed:
        """The same curve with the cost's kinks rounded off by a suitable width."""
        self._nothing = _NOTHING * self._own_time.gross(here.curve, here.duration)
        self._width = self._soft(here)
        return self._priced(here)

    def _priced(self, here: Timed) -> Timed:
        return replace(here, cost=self._own_cost(here.curve, here.duration))

    def _own_cost(self, curve: JointCurve, duration: float) -> float:
        """The cost of a curve in its own time, more if that is longer than allowed."""
        late = max(duration / self._longest - 1.0, 0.0)
        return self._own_time.cost(curve, duration, width=self._width) * (1.0 + _LATE * late)

    def _as_sampled(self, found: Timed) -> Timed:
        """The same curve with its motion within all limits, and the cost of that."""
        motion = time_evenly(found.curve, found.duration, self._problem.limits, drive=self._drive)
        own_cost = self._own_cost(found.curve, found.duration)  # that of `found` may be of a softer cost
        return replace(found, within_limits=motion, cost=motion_cost(self._problem, motion), own_cost=own_cost)

    def _shortened(
        self, here: Timed, there: Timed, goal: Goal | None, looks: Looks, slope: Vector, price: float
    ) -> tuple[Timed, float]:
        """The curve `there`, or one nearer to `here` if `there` costs more; and the part of the step that is left.

        The part is where the parabola through both costs, with `slope` (m,) at `here`, is least.
        """
        worst, whole, part = here.cost + price * here.missed, there, 1.0
        for _ in range(_SHORTENINGS):
            worse = there.cost + price * there.missed - worst
            if worse < 0.0:
                break
            falls = min(part * float(slope @ self._moved(here, whole, goal)), 0.0)
            least = -0.5 * falls / (worse - falls) if worse > falls else 0.0
            part *= float(np.clip(least, _SHORTEST, SHRINK))
            control = here.curve.control + part * (whole.curve.control - here.curve.control)
            duration = here.duration + part * (whole.duration - here.duration)
            self.rounds += 1
            shorter = self._on_goal(here.curve, control, duration, goal, looks, below=worst)
            if shorter is None:
                break
            there = shorter
        return there, part

    def _cleared(self, now: _State, there: Timed, goal: Goal | None, looks: Looks, price: float) -> Timed:
        """The curve `there`, or one after a step that also keeps the clearances linearised at `there`.

        The step is tried if `there` costs less but misses too much, and its curve is taken if it is better.
        """
        worst, worth = now.here.cost + price * now.here.missed, there.cost + price * there.missed
        if not there.cost < worst <= worth:
            return there
        self.rounds += 1
        again = self._step(now, goal, looks, below=worst, beyond=there)
        return there if again is None or again.cost + price * again.missed >= worth else again

    def _slope(self, here: Timed, goal: Goal | None, unit: float) -> tuple[Vector, Matrix, Kinks]:
        """How the cost, divided by `unit`, changes with the control points that may move, and T.

        The slope, the known curvature, and the kinks.
        """
        moving = slice(1, here.curve.pieces + (goal is not None))
        found = self._own_time.slope(here.curve, here.duration, moving, width=self._width)
        if here.duration > self._longest:
            found.slope[-1] += _LATE * here.cost / self._longest
        return found.slope / unit, found.curvature / unit, found.kinks.over(unit)

    def _learnt(self, bend: Bend, before: Timed, here: Timed, goal: Goal | None, unit: float) -> Bend:
        """The model at the curve `here` from that at the curve `before`."""
        return bend.after(self._moved(before, here, goal), *self._slope(here, goal, unit))

    def _length(self, here: Timed, there: Timed) -> float:
        """The largest move of a control point from one curve to another [rad or m of the fastest joint]."""
        return float(np.max(np.abs(there.curve.control - here.curve.control) / self._unit))

    def _step(
        self, now: _State, goal: Goal | None, looks: Looks, *, below: float, beyond: Timed | None = None
    ) -> Timed | None:  # fmt: skip
        """The curve after the best small step, see `_timed`; None if there is none. For `beyond` see `_model`."""
        model = self._model(now.here, goal, looks, now.box, beyond=beyond)
        missed = self._times_missed * MISSED_PRICE
        x = model.best_step(missed, bend=now.bend, longest=self._longest, most_iterations=_ITERATIONS_BENT)
        if x is None:
            return None
        control, duration = model.step(x)
        return self._on_goal(now.here.curve, control, duration, goal, looks, below=below)

    def _timed(self, curve: JointCurve, duration: float, looks: Looks, *, below: float = np.inf) -> Timed | None:
        """See `Descent._timed`; over the duration, or a longer one if the limits require it."""
        duration = self._own_time.least_duration(curve, duration)
        cost = self._own_cost(curve, duration)
        margins = Margins.none(curve.control.shape[1]) if cost >= below else looks.find_margins(curve)
        return Timed(curve, duration, cost, max(-margins.least, 0.0), margins)
