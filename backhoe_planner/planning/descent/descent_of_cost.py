"""Descent of another cost than the time: a curve costs what its motion in its own time t = T s does.

T may be as long as the longest time given. The program models how the cost in that time changes, see `own_time` and
`bend`; a step that costs more is shortened. A step that misses a clearance is taken once more with the clearances
linearised also where it went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import Kinematics
from backhoe_planner.motion import SAMPLE_PERIOD, Goal, Problem, motion_cost, time_evenly
from backhoe_planner.planning.descent.bend import Bend
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import (
    ENOUGH_ROUGH,
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
_SLOW = 2  # a descent ends after so many rounds in a row that gain too little, see `Options.enough`; chosen
# of a program at most; measured: of 2,700, those not solved after 200 were not after 600. With 200, one of 120 plans of
# the backhoe takes 4 instead of 27 s, as 280 kinks are crossed there, but four of 42 of the Panda cost 3 to 10 % more
_ITERATIONS_BENT = 300
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


@dataclass(eq=False)
class _Course:
    """One descent on its way.

    Attributes
    ----------
    looks: the places at which it checks clearances.
    goal: on which the end may move; None if the end is fixed.
    unit: by which the model divides costs, in the objective's unit.
    enough: part of the cost: a smaller gain is too little.
    now: the present curve.
    clear: the last that was clear, or the first.
    times_missed: factor on the price of what a curve misses.
    price: of a metre missed, in the objective's unit.
    before: the curve before the last step, as long as the model is that of it; else None.
    steps: tried so far.
    failed: how many of the last ones were not better.
    slow: how many of the last better ones gained too little.
    has_ended: whether no step should follow.
    """

    looks: Looks
    goal: Goal | None
    unit: float
    enough: float
    now: _State
    clear: _State
    times_missed: float
    price: float
    before: Timed | None = None
    steps: int = 0
    failed: int = 0
    slow: int = 0
    has_ended: bool = False

    @property
    def is_astray(self) -> bool:
        """Whether the present curve is not clear, and an earlier one is."""
        return is_astray(self.now.here, self.clear.here, self.looks)

    @property
    def costs_nothing(self) -> bool:
        """Whether the present curve is clear, and so cheap that its cost counts as nothing."""
        here = self.now.here
        return here.cost <= self.now.pricing.nothing and here.missed <= self.looks.allowed

    def worth(self, here: Timed) -> float:
        """The cost of a curve, with the price of what it misses."""
        return here.cost + self.price * here.missed

    def turn_back(self) -> None:
        """Go back to the last clear curve, but not with larger steps."""
        self.now, self.before = replace(self.clear, box=min(self.now.box, self.clear.box)), None

    def renew(self, **known: Any) -> None:
        """Replace these attributes of the state at the present curve, also where that is the last clear one."""
        was_clear = self.clear.here is self.now.here
        self.now = replace(self.now, **known)
        if was_clear:
            self.clear = replace(self.clear, **known)


@dataclass(frozen=True, eq=False)
class _Tried:
    """What came of trying a step.

    Attributes
    ----------
    there: the curve after it; None if there is none.
    gain: by how much its worth is less.
    part: of the step that is left after shortening.
    known: which places were checked when the present curve was seen, see `Looks.known`.
    noticed: whether the step went into an obstacle at a place that was not checked before.
    """

    there: Timed | None
    gain: float
    part: float
    known: tuple[int, int]
    noticed: bool


class DescentOfCost(Descent):
    """Descents to the cheapest motions; parameters and attributes as for `Descent`.

    Attributes
    ----------
    own_time: computes the cost of curves.
    """

    def __init__(
        self, problem: Problem, proximity: Proximity, kinematics: Kinematics, *, time: float, brake: Brake,
        hurried: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(problem, proximity, kinematics, time=time, brake=brake, hurried=hurried)
        self.own_time = OwnTime(problem, self._drive)

    def run(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed:
        """See `Descent.run`; every curve has a motion."""
        longest, objective = options.longest, self._problem.objective
        own_time = self.own_time.looked_at(fine=options.fine)
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
            enough = max(options.enough, ENOUGH_ROUGH) if left > 1 else options.enough
            one = replace(options, most_rounds=rounds, box=box, enough=enough)
            found, run = self._down(curve, duration, flow, run, one)
            if options.is_hopeless(found, options.most_rounds):
                break
            curve, duration, box = found.curve, found.duration, min(box, _NEXT_BOX)
        assert found is not None  # there is at least one flow
        return found, run

    def _down(self, curve: JointCurve, duration: float, flow: float, run: _Run, options: Options) -> tuple[Timed, _Run]:
        """One descent, for one of the soft flows; the result's cost is without rounded kinks."""
        exact = _Pricing(replace(run.own_time, soft_flow=flow), options.longest, late=run.late)
        course, begun = self._begun(curve, duration, exact, run, options), self.rounds
        while self.rounds - begun < options.most_rounds and not course.has_ended:
            if options.is_hopeless(course.now.here, course.steps):
                if not course.is_astray:
                    break
                course.turn_back()
                course.now = course.now.after_failure(1.0)
                continue
            if course.costs_nothing:
                break
            self._brake.check()
            self._learn(course)
            course.steps, self.rounds = course.steps + 1, self.rounds + 1
            tried = self._try(course)
            if tried.there is None or tried.gain <= 0.0:
                self._fail(course, tried)
            else:
                self._take(course, tried.there, tried)
        jumps = self._problem.objective.jumps
        if course.before is not None and jumps:
            course.now = replace(course.now, bend=self._bend_after(course.before, course.now, course.goal, course.unit))
        found = course.clear if course.is_astray else course.now
        curvature = found.bend.curvature * course.unit if jumps else None
        return exact.priced(found.here), replace(run, times_missed=course.times_missed, curvature=curvature)

    def _begun(self, curve: JointCurve, duration: float, exact: _Pricing, run: _Run, options: Options) -> _Course:
        """The beginning of a descent, with the curvature that a softer cost has shown."""
        goal = run.goal if run.goal.q is None else None
        looks = self._looks(curve, options.spare, options.density, goal)
        here = self._timed(self._within_cones(curve, looks), max(duration, SAMPLE_PERIOD), exact, looks)
        price, unit = run.times_missed * MISSED_WORTH * here.cost, max(here.cost, NO_COST)
        pricing = exact.rounded_off(here)
        here = pricing.priced(here)
        slope = pricing.slope(here, goal, unit)
        bend = Bend.smooth(*slope, here.curve.pieces, self._unit, options.box, here.duration)
        bend = bend if run.curvature is None else replace(bend, curvature=run.curvature / unit)
        state = _State(here, options.box, pricing, bend)
        return _Course(looks, goal, unit, options.enough, state, state, run.times_missed, price)

    def _learn(self, course: _Course) -> None:
        """Let the model learn from the last step, and make kinks narrower if the cost has become small."""
        goal, unit = course.goal, course.unit
        if course.before is not None:
            course.renew(bend=self._bend_after(course.before, course.now, goal, unit))
            course.before = None
        if course.now.pricing.width > _SOFTEST * course.now.pricing.suitable_width(course.now.here):
            course.now = now = course.now.narrower(goal, unit)
            last = now.pricing.priced(course.clear.here) if course.is_astray else now.here
            course.clear = replace(course.clear, here=last, pricing=now.pricing)

    def _try(self, course: _Course) -> _Tried:
        """A step, repaired if it misses a clearance, and shortened if it costs more."""
        looks, worst, known = course.looks, course.worth(course.now.here), course.looks.known
        there = self._step(course, below=worst)
        noticed = looks.known != known
        if there is None:
            return _Tried(None, -np.inf, 1.0, known, noticed)
        if noticed:  # the curve before may also go into a newly noticed obstacle
            seen, known = self._seen_anew(course.now.here, looks), looks.known
            course.renew(here=seen)
            worst = course.worth(seen)
        there, part = self._shortened(course, self._cleared(course, there))
        return _Tried(there, worst - there.cost - course.price * there.missed, part, known, noticed)

    def _fail(self, course: _Course, tried: _Tried) -> None:
        """Stay after a step that was not better: the next is shorter, and sees what this one went into."""
        looks, noticed = course.looks, tried.noticed
        course.failed += 1
        if course.failed >= STUCK and course.is_astray:
            course.turn_back()
        if tried.there is not None:
            looks.widen(tried.there.margins)
        if looks.known != tried.known:
            course.now, noticed = replace(course.now, here=self._seen_anew(course.now.here, looks)), True
        course.now = course.now.after_failure(1.0 if noticed else max(tried.part, _LEAST_PART))
        course.has_ended = course.now.box < _SMALLEST_BENT

    def _take(self, course: _Course, there: Timed, tried: _Tried) -> None:
        """Go on from the better curve `there`."""
        now = course.now
        if there.missed > max(now.here.missed, course.looks.allowed):
            # so far, going into an obstacle gains more than it costs
            course.times_missed = min(_MORE_MISSED * course.times_missed, _MOST_MISSED)
            course.price = course.times_missed * MISSED_WORTH * course.unit
        # a box far beyond the steps that are taken makes the program large
        around = max(_AROUND * self._length(now.here, there), SMALLEST_BOX)
        box = min(GROW * tried.part * now.box, LARGEST_BOX, around)
        course.before, course.now, course.failed = now.here, replace(now, here=there, box=box), 0
        if there.missed <= course.looks.allowed:
            course.clear = course.now
        course.slow = course.slow + 1 if tried.gain < course.enough * there.cost else 0
        course.has_ended = course.slow >= _SLOW and there.missed <= KEPT

    def estimates(self, curves: Sequence[JointCurve], durations: Vector, *, longest: float) -> Vector:
        """(C,) estimated costs of curves with the same pieces in their own times.

        Parameters
        ----------
        durations: (C,) of each [s]; longer if the limits require it.
        longest: the longest time that a motion may take [s].
        """
        T = self.own_time.least_durations(curves, durations, places=_PLACES_OF_LIMITS)
        late = np.maximum(T / longest - 1.0, 0.0)
        costs = self.own_time.costs(curves, T, width=LEAST_WIDTH, places=_PLACES_OF_ESTIMATE)
        return np.asarray(costs * (1.0 + _LATE * late))

    def _as_sampled(self, found: Timed, exact: _Pricing) -> Timed:
        """The same curve with its motion within all limits, and the cost of that."""
        motion = time_evenly(found.curve, found.duration, self._problem.limits, drive=self._drive)
        own_cost = exact.cost(found.curve, found.duration)  # that of `found` may be of a softer cost
        return replace(found, within_limits=motion, cost=motion_cost(self._problem, motion), own_cost=own_cost)

    def _shortened(self, course: _Course, there: Timed) -> tuple[Timed, float]:
        """The curve `there`, or one nearer to the present one if it costs more; and the part of the step that is left.

        The part is where the parabola through both costs, with the slope at the present curve, is least.
        """
        now, here, slope = course.now, course.now.here, course.now.bend.slope * course.unit
        worst, whole, part = course.worth(here), there, 1.0
        for _ in range(_SHORTENINGS):
            worse = course.worth(there) - worst
            if worse < 0.0:
                break
            falls = min(part * float(slope @ self._moved(here, whole, course.goal)), 0.0)
            least = -0.5 * falls / (worse - falls) if worse > falls else 0.0
            part *= float(np.clip(least, _SHORTEST, SHRINK))
            control = here.curve.control + part * (whole.curve.control - here.curve.control)
            duration = here.duration + part * (whole.duration - here.duration)
            self.rounds += 1
            shorter = self._on_goal(here.curve, control, course.goal, course.looks)
            if shorter is None:
                break
            there = self._timed(shorter, duration, now.pricing, course.looks, below=worst)
        return there, part

    def _cleared(self, course: _Course, there: Timed) -> Timed:
        """The curve `there`, or one after a step that also keeps the clearances linearised at `there`.

        The step is tried if `there` costs less but misses too much, and its curve is taken if it is better.
        """
        worst, worth = course.worth(course.now.here), course.worth(there)
        if not there.cost < worst <= worth:
            return there
        self.rounds += 1
        again = self._step(course, below=worst, beyond=there)
        return there if again is None or course.worth(again) >= worth else again

    def _bend_after(self, before: Timed, now: _State, goal: Goal | None, unit: float) -> Bend:
        """The model at the present curve from that at the curve `before`, which the state still has."""
        return now.bend.after(self._moved(before, now.here, goal), *now.pricing.slope(now.here, goal, unit))

    def _length(self, here: Timed, there: Timed) -> float:
        """The largest move of a control point from one curve to another [rad or m of the fastest joint]."""
        return float(np.max(np.abs(there.curve.control - here.curve.control) / self._unit))

    def _step(self, course: _Course, *, below: float, beyond: Timed | None = None) -> Timed | None:
        """The curve after the best small step, see `_timed`; None if there is none. For `beyond` see `_model`."""
        now, goal, looks = course.now, course.goal, course.looks
        model = self._model(now.here, goal, looks, now.box, beyond=beyond)
        missed, longest = course.times_missed * MISSED_PRICE, now.pricing.longest
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
