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
_LATE = 10.0  # extra cost, as a part of the cost, of a motion that takes twice as long as it may, at first; chosen
# part of the longest time that a descent leaves unused: samples of a motion are slowed down by this if they exceed a
# limit between the places at which steps keep it; chosen: mostly less is needed
_TIME_SPARE = 1e-3
_HURRIES = 3  # tries to shorten a motion that nevertheless takes too long; chosen
_LATER = 4.0  # factor on the extra cost of being late in each of them: some motions save more than that; chosen
_HURRY_ROUNDS = 6  # of each of them at most; chosen
_SLOW = 2  # a descent ends after so many rounds in a row that gain too little; chosen
_ENOUGH_BENT = 1e-3  # part of the cost: a smaller gain is too little; the cost keeps falling for long; chosen
_ENOUGH_ROUGH = 0.01  # the same if a finer curve follows; chosen: with 0.004 to 0.02 motions cost as much
_ITERATIONS_BENT = 300  # of a program at most; measured: of 2,700, those not solved after 200 were not after 600
_LEAST_PART = 0.25  # least part of a failed step, to which the box shrinks; chosen: another step may go elsewhere


@dataclass(frozen=True, eq=False)
class _Pricing:
    """What curves cost in one descent.

    Attributes
    ----------
    own_time: of the curves.
    longest: the longest time that a motion may take [s].
    width: by which kinks of the cost's rate are rounded off, in its unit per second.
    nothing: a cost that counts as nothing, in its unit.
    late: extra cost, as a part of the cost, of a motion that takes twice as long as it may.
    """

    own_time: OwnTime
    longest: float
    width: float = LEAST_WIDTH
    nothing: float = 0.0
    late: float = _LATE

    def cost(self, curve: JointCurve, duration: float) -> float:
        """The cost of a curve in its own time, more if that is longer than allowed."""
        late = max(duration / self.longest - 1.0, 0.0)
        return self.own_time.cost(curve, duration, width=self.width) * (1.0 + self.late * late)

    def priced(self, here: Timed) -> Timed:
        """The same curve with its cost."""
        return replace(here, cost=self.cost(here.curve, here.duration))

    def slope(self, here: Timed, goal: Goal | None, unit: float) -> tuple[Vector, Matrix, Kinks]:
        """How the cost, divided by `unit`, changes with the control points that may move, and T.

        The slope, the known curvature, and the kinks.
        """
        moving = slice(1, here.curve.pieces + (goal is not None))
        found = self.own_time.slope(here.curve, here.duration, moving, width=self.width)
        if here.duration > self.longest:
            found.slope[-1] += self.late * here.cost / self.longest
        return found.slope / unit, found.curvature / unit, found.kinks.over(unit)

    def suitable_width(self, here: Timed) -> float:
        """The width that suits the cost of a curve."""
        return float(suitable_width(max(here.cost, self.nothing), here.duration, here.curve.control.shape[1]))

    def rounded_off(self, here: Timed) -> _Pricing:
        """The same with kinks rounded off by a width that suits the cost of a curve."""
        found = replace(self, nothing=_NOTHING * self.own_time.gross(here.curve, here.duration))
        return replace(found, width=found.suitable_width(here))


@dataclass(frozen=True, eq=False)
class _Run:
    """One run, and what its descents have shown so far.

    Attributes
    ----------
    goal: on which the end may move.
    own_time: of its curves; not softened.
    times_missed: factor on the price of what a curve misses.
    late: see `_Pricing`.
    curvature: learnt with a softer cost, in the objective's unit; None if none was.
    """

    goal: Goal
    own_time: OwnTime
    times_missed: float
    late: float = _LATE
    curvature: Matrix | None = None


@dataclass(frozen=True, eq=False)
class _State:
    """A curve, the box of the step from it, what it costs, and the model of its cost."""

    here: Timed
    box: float
    pricing: _Pricing
    bend: Bend

    def narrower(self, goal: Goal | None, unit: float) -> _State:
        """The same with kinks rounded off by a width that suits the cost now."""
        pricing = self.pricing.rounded_off(self.here)
        here = pricing.priced(self.here)
        slope, curvature, kinks = pricing.slope(here, goal, unit)
        bend = replace(self.bend, slope=slope, known=curvature, kinks=kinks)
        return replace(self, here=here, pricing=pricing, bend=bend)

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

    def run(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed:
        """See `Descent.run`; every curve has a motion."""
        longest, objective = options.longest, self._problem.objective
        own_time = self._own_time.looked_at(fine=options.fine)
        within = (1.0 - _TIME_SPARE) * longest
        duration = min(duration, within) if duration <= longest else duration
        flow = own_time.mean_flow(curve, duration) if objective.jumps else 0.0
        flows = soft_flows(flow, first=options.unsampled, fine=options.fine, hurried=self._hurried)
        run = _Run(goal, own_time, times_missed=_CLEAR_FIRST if options.clear_first else 1.0)
        found, run = self._down_softly(curve, duration, flows, run, replace(options, longest=within))
        if options.unsampled:
            return found
        found = self._as_sampled(found, _Pricing(own_time, within))
        hurrying = replace(options, most_rounds=_HURRY_ROUNDS, box=SMALLEST_BOX, is_hopeless=lambda here, rounds: False)
        for _ in range(_HURRIES):
            if found.motion.duration <= longest or found.missed > KEPT_PART * options.spare:
                break
            within *= (1.0 - _TIME_SPARE) * longest / found.motion.duration
            run = replace(run, late=_LATER * run.late)
            found, run = self._down_softly(
                found.curve, min(found.duration, within), flows[-1:], run, replace(hurrying, longest=within)
            )
            found = self._as_sampled(found, _Pricing(own_time, within))
        return found

    def _down_softly(
        self, curve: JointCurve, duration: float, flows: Sequence[float], run: _Run, options: Options
    ) -> tuple[Timed, _Run]:
        """One descent for each of the soft `flows`, each from the result of the one before; see `_down`."""
        begun, found, box, run = self.rounds, None, options.box, replace(run, curvature=None)
        for left, flow in zip(range(len(flows), 0, -1), flows, strict=True):
            rounds = options.most_rounds - (self.rounds - begun)
            if found is not None and rounds <= 0:
                break
            rounds = -(-rounds // left) if self._hurried else rounds
            rough = options.rough or left > 1
            one = replace(options, most_rounds=rounds, box=box, rough=rough)
            found, run = self._down(curve, duration, flow, run, one)
            if options.is_hopeless(found, options.most_rounds):
                break
            curve, duration, box = found.curve, found.duration, min(box, _NEXT_BOX)
        assert found is not None  # there is at least one flow
        return found, run

    def _down(self, curve: JointCurve, duration: float, flow: float, run: _Run, options: Options) -> tuple[Timed, _Run]:
        """One descent, for one of the soft flows; the result's cost is without rounded kinks."""
        goal, times_missed = run.goal, run.times_missed
        free = goal if goal.q is None else None
        looks = self._looks(curve, options.spare, options.density, free)
        exact = _Pricing(replace(run.own_time, soft_flow=flow), options.longest, late=run.late)
        here = self._timed(self._within_cones(curve, looks), max(duration, SAMPLE_PERIOD), exact, looks)
        price, unit = times_missed * MISSED_WORTH * here.cost, max(here.cost, NO_COST)
        enough = _ENOUGH_ROUGH if options.rough else _ENOUGH_BENT
        now = clear = self._first(here, exact, free, unit, options.box, run.curvature)  # now, and when it was clear
        begun, steps, failed, slow = self.rounds, 0, 0, 0
        before: Timed | None = None  # the curve before the last step, if `now.bend` is still that of it
        while self.rounds - begun < options.most_rounds:
            if options.is_hopeless(now.here, steps):
                if not is_astray(now.here, clear.here, looks):
                    break
                now, before = replace(clear, box=min(now.box, clear.box)).after_failure(1.0), None
                continue
            if now.here.cost <= now.pricing.nothing and now.here.missed <= looks.allowed:
                break
            self._brake.check()
            if before is not None:
                now, before = replace(now, bend=self._bend_after(before, now, free, unit)), None
                clear = replace(clear, bend=now.bend) if clear.here is now.here else clear
            if now.pricing.width > _SOFTEST * now.pricing.suitable_width(now.here):
                now = now.narrower(free, unit)
                last = now.pricing.priced(clear.here) if is_astray(now.here, clear.here, looks) else now.here
                clear = replace(clear, here=last, pricing=now.pricing)
            steps, self.rounds = steps + 1, self.rounds + 1
            worst, known = now.here.cost + price * now.here.missed, looks.known
            there = self._step(now, free, looks, times_missed, below=worst)
            part, noticed = 1.0, looks.known != known
            if there is not None:
                if noticed:  # the curve before may also go into a newly noticed obstacle
                    seen, known = self._seen_anew(now.here, looks), looks.known
                    clear = replace(clear, here=seen) if clear.here is now.here else clear
                    now = replace(now, here=seen)
                    worst = seen.cost + price * seen.missed
                there = self._cleared(now, there, free, looks, times_missed, price)
                there, part = self._shortened(now, there, free, looks, unit, price)
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
                times_missed = min(_MORE_MISSED * times_missed, _MOST_MISSED)
                price = times_missed * MISSED_WORTH * unit
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
            now = replace(now, bend=self._bend_after(before, now, free, unit))
        found = clear if is_astray(now.here, clear.here, looks) else now
        curvature = found.bend.curvature * unit if self._problem.objective.jumps else None
        return exact.priced(found.here), replace(run, times_missed=times_missed, curvature=curvature)

    def _first(
        self, here: Timed, exact: _Pricing, goal: Goal | None, unit: float, box: float, curvature: Matrix | None
    ) -> _State:  # fmt: skip
        """The state in which a descent begins, with the curvature that a softer cost has shown."""
        pricing = exact.rounded_off(here)
        here = pricing.priced(here)
        bend = Bend.smooth(*pricing.slope(here, goal, unit), here.curve.pieces, self._unit, box, here.duration)
        bend = bend if curvature is None else replace(bend, curvature=curvature / unit)
        return _State(here, box, pricing, bend)

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

    def _as_sampled(self, found: Timed, exact: _Pricing) -> Timed:
        """The same curve with its motion within all limits, and the cost of that."""
        motion = time_evenly(found.curve, found.duration, self._problem.limits, drive=self._drive)
        own_cost = exact.cost(found.curve, found.duration)  # that of `found` may be of a softer cost
        return replace(found, within_limits=motion, cost=motion_cost(self._problem, motion), own_cost=own_cost)

    def _shortened(
        self, now: _State, there: Timed, goal: Goal | None, looks: Looks, unit: float, price: float
    ) -> tuple[Timed, float]:
        """The curve `there`, or one nearer to the present one if it costs more; and the part of the step that is left.

        The part is where the parabola through both costs, with the slope at the present curve, is least.
        """
        here, slope = now.here, now.bend.slope * unit
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
            shorter = self._on_goal(here.curve, control, goal, looks)
            if shorter is None:
                break
            there = self._timed(shorter, duration, now.pricing, looks, below=worst)
        return there, part

    def _cleared(
        self, now: _State, there: Timed, goal: Goal | None, looks: Looks, times_missed: float, price: float
    ) -> Timed:  # fmt: skip
        """The curve `there`, or one after a step that also keeps the clearances linearised at `there`.

        The step is tried if `there` costs less but misses too much, and its curve is taken if it is better.
        """
        worst, worth = now.here.cost + price * now.here.missed, there.cost + price * there.missed
        if not there.cost < worst <= worth:
            return there
        self.rounds += 1
        again = self._step(now, goal, looks, times_missed, below=worst, beyond=there)
        return there if again is None or again.cost + price * again.missed >= worth else again

    def _bend_after(self, before: Timed, now: _State, goal: Goal | None, unit: float) -> Bend:
        """The model at the present curve from that at the curve `before`, which the state still has."""
        return now.bend.after(self._moved(before, now.here, goal), *now.pricing.slope(now.here, goal, unit))

    def _length(self, here: Timed, there: Timed) -> float:
        """The largest move of a control point from one curve to another [rad or m of the fastest joint]."""
        return float(np.max(np.abs(there.curve.control - here.curve.control) / self._unit))

    def _step(
        self, now: _State, goal: Goal | None, looks: Looks, times_missed: float, *, below: float,
        beyond: Timed | None = None,
    ) -> Timed | None:  # fmt: skip
        """The curve after the best small step, see `_timed`; None if there is none. For `beyond` see `_model`."""
        model = self._model(now.here, goal, looks, now.box, beyond=beyond)
        missed, longest = times_missed * MISSED_PRICE, now.pricing.longest
        x = model.best_step(missed, bend=now.bend, longest=longest, most_iterations=_ITERATIONS_BENT)
        if x is None:
            return None
        control, duration = model.step(x)
        curve = self._on_goal(now.here.curve, control, goal, looks)
        return None if curve is None else self._timed(curve, duration, now.pricing, looks, below=below)

    def _timed(
        self, curve: JointCurve, duration: float, pricing: _Pricing, looks: Looks, *, below: float = np.inf
    ) -> Timed:  # fmt: skip
        """The curve with its cost over the duration, or over a longer one if the limits require it.

        If it does not cost less than `below`, its clearances are not checked.
        """
        duration = pricing.own_time.least_duration(curve, duration)
        cost = pricing.cost(curve, duration)
        margins = Margins.none(curve.control.shape[1]) if cost >= below else looks.find_margins(curve)
        return Timed(curve, duration, cost, max(-margins.least, 0.0), margins)
