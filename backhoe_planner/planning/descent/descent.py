"""Descent: a curve is bent, and its end moved on the goal, until its cost stops falling.

Each round linearises clearances and goal about the curve, and takes the step that solves a quadratic program
(sequential convex programming, Schulman et al. 2014), within a box (a trust region) that grows after a step that
lowered the cost and shrinks otherwise. The program contains the limits, linearised, with the duration T of the
curve's own time t = T s, in which the curve is run at an even pace.

If the cost is the time, the program minimises T, and a curve costs the duration of its fastest motion. For another
cost, T may be as long as the longest time given; the program models how the cost in that time changes, see `own_time`
and `bend`; and a step that costs more is shortened.

Missing a clearance has a high price. For the time, a step that misses one is judged only after a further step that
may repair it; for another cost, it is taken once more with the clearances linearised also where it went. If nothing
helps, the last clear curve is continued with smaller steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits, Kinematics, movable_rows
from backhoe_planner.motion import (
    SAMPLE_PERIOD,
    Goal,
    Problem,
    Trajectory,
    drive_of,
    motion_cost,
    time_curve,
    time_evenly,
)
from backhoe_planner.planning.descent.bend import Bend
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.kinks import LEAST_WIDTH, Kinks, suitable_width
from backhoe_planner.planning.descent.linear_model import PLACES_PER_PIECE, LinearModel
from backhoe_planner.planning.descent.looks import KEPT_PART, Looks
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.descent.own_time import OwnTime
from backhoe_planner.planning.descent.softening import soft_flows
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.site import ClearanceScreen, Proximity

_GRID_PER_PIECE = 6  # intervals on which a curve is timed; chosen: limits between them are corrected
_MISSED_PRICE = 20.0  # of a metre missed in the quadratic program, as a part of the cost: well above the possible gain
_CLEAR_FIRST = 10.0  # times both prices, if a curve has to get clear first; chosen: 50 leads further away
# times the price of missing after a step deeper into an obstacle, and times the first price at most; chosen
_MORE_MISSED, _MOST_MISSED = 4.0, 1e3
MISSED_WORTH = 6.0  # the same in the comparison of two curves; chosen among 3 to 20: the next step repairs a miss
_LARGEST_BOX, _SMALLEST_BOX = 0.6, 0.02  # rad or m of the fastest joint: most move of a control point in a step; chosen
_SMALLEST_BENT = 0.004  # the same for another cost than the time, whose curvature shrinks steps too; chosen
_AROUND = 3.0  # times the last step: the largest box of the next one, for another cost than the time; chosen
NO_COST = 1e-9  # in the objective's unit: a smaller cost counts as this
_GROW, _SHRINK = 1.5, 0.4  # factors on the box after a step that is taken, and after one that is not; chosen
_SHORTENINGS = 2  # of a step that costs more, if the cost is not the time; chosen: each takes half of a round
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
_SLOW = 2  # a descent for another cost than the time ends after so many rounds in a row that gain too little; chosen
_ENOUGH = 2e-3  # part of the cost: a round that gains less ends the descent
_ENOUGH_HURRIED = (
    0.01  # the same for a descent in a hurry; chosen: the last round, which gains less, is a fifth of its time
)
# the same for the gain that the program predicts for a clear curve in a hurry, which then ends; chosen: with 0.01
# motions take longer, for no less work
_ENOUGH_PROMISED = 0.005
_ENOUGH_BENT = 1e-3  # the same for another cost than the time, which keeps falling for longer; chosen
_ENOUGH_ROUGH = 0.01  # the same if a finer curve follows; chosen: with 0.004 to 0.02 motions cost as much
_UNEVEN = 1.1  # times the duration of its fastest motion, from which a curve is fitted to that motion; chosen
_KEPT = 1e-4  # m by which the last round may miss the spare beyond the clearance
_MENDED = 0.1  # m: a step that misses by less is judged only after another step; chosen
_STUCK = 2  # failed steps in a row, after which a curve that is not clear is replaced by the last clear one; chosen
_TO_GOAL_STEPS = 8  # of Newton's method; it doubles its digits with each
_ON_GOAL = 1e-8  # m and rad
_ITERATIONS = 2_000  # of the quadratic program at most; it takes some hundred
# the same for another cost than the time; measured: of 2,700 programs, those not solved after 200 were not after 600
_ITERATIONS_BENT = 300
_LEAST_PART = 0.25  # least part of a failed step, to which the box shrinks; chosen: another step may go elsewhere


@dataclass(frozen=True, eq=False)
class Timed:
    """A curve with a motion along it.

    Attributes
    ----------
    curve: over s.
    duration: T of the time t = T s in which limits are linearised [s]; that of the motion may be shorter.
    cost: of the motion, by the problem's objective.
    missed: the largest miss of a clearance with its spare at the checked places [m]; 0 or more.
    margins: at all checked places.
    own_cost: the cost of the curve in its own time, for comparison with curves of other descents; mostly less than
        `cost`, if that is the cost of a sampled motion; None if both are the same.
    within_limits: the motion along the curve that keeps all limits, the fastest if the cost is the time; None if it was
        not computed.
    """

    curve: JointCurve
    duration: float
    cost: float
    missed: float
    margins: Margins
    own_cost: float | None = None
    within_limits: Trajectory | None = None

    @cached_property
    def motion(self) -> Trajectory:
        """The motion within limits if there is one, otherwise over t; sampled when it is first asked for."""
        return time_evenly(self.curve, self.duration) if self.within_limits is None else self.within_limits


class Descent:
    """Descents among the same obstacles.

    Parameters
    ----------
    proximity: to the obstacles that count.
    kinematics: of the machine.
    time: at which the positions of the obstacles are taken [s].
    brake: checked in every round.
    hurried: whether a descent ends earlier, at larger gains, and considers only nearer obstacles.

    Attributes
    ----------
    rate: (n,) velocity limits of the joints [rad/s or m/s].
    rounds: how many were made so far; a repaired step counts as two.
    """

    def __init__(
        self, problem: Problem, proximity: Proximity, kinematics: Kinematics, *, time: float, brake: Brake,
        hurried: bool = False,
    ) -> None:  # fmt: skip
        self._problem, self._proximity, self._kinematics = problem, proximity, kinematics
        self._time, self._brake, self._hurried = time, brake, hurried
        self._drive = drive_of(problem)
        self._own_time = None if problem.objective.is_time else OwnTime(problem, self._drive)
        self.rate = rate = problem.limits.velocity
        self._unit = rate / float(np.max(rate))  # rad or m of each joint per unit of the box
        self._screens: dict[float, ClearanceScreen] = {}  # by the spare
        self._nothing = 0.0  # a cost that counts as nothing, in its unit
        self._width = LEAST_WIDTH  # by which kinks of the cost's rate are rounded off, in its unit per second
        self._longest = np.inf  # s that the motion of this descent may take
        self._curved: Matrix | None = None  # the curvature learnt with a softer cost, in its unit
        self._times_missed = 1.0  # factor on the price of what a curve of this descent misses
        self._rough = False  # whether this descent may end at larger gains
        self.rounds = 0

    def run(
        self, curve: JointCurve, duration: float, goal: Goal, *,
        most_rounds: int, spare: float, density: int, box: float, is_hopeless: Callable[[Timed, int], bool],
        longest: float = np.inf, unsampled: bool = False, rough: bool = False, clear_first: bool = False,
        fine: bool = False,
    ) -> Timed | None:  # fmt: skip
        """Bend a curve until its cost stops falling.

        Parameters
        ----------
        curve: from where the machine is to a goal; it need not be clear.
        duration: estimated duration [s]; at least a sample's period counts.
        goal: on which the end may move; a goal given by joints fixes the end.
        most_rounds: after which the descent ends, except for a few more if its motion takes too long.
        spare: to be kept beyond every clearance [m].
        density: places at which clearances are checked, for each place at which limits are.
        box: how far the first step may move a control point [rad or m of the fastest joint].
        longest: the longest time that the motion may take [s], if the time is not the cost; exceeded if no step helps.
        unsampled: whether the motion may break limits between the places where a step keeps them, and its cost may be
            inexact, if the time is not the cost; to correct both takes as long as two rounds.
        rough: whether the descent ends at larger gains, because a finer curve continues from its end; not for the time.
        clear_first: whether misses cost much more than usual, so that the curve gets out of an obstacle that
            is cheap to go through.
        fine: whether the cost is evaluated at more places, if it is not the time; for the last descents.
        is_hopeless: decides from a curve and the number of steps so far whether the descent is given up.

        Returns
        -------
        The best curve, not proven to be clear; None if the first has no motion.

        Raises
        ------
        OutOfTime: the budget is used up.
        """
        if self._own_time is not None:
            self._own_time = self._own_time.looked_at(fine=fine)
        self._rough, self._times_missed = rough, _CLEAR_FIRST if clear_first else 1.0
        down = partial(self._down, goal=goal, spare=spare, density=density)
        if self._own_time is None:
            return down(curve, duration, most_rounds=most_rounds, box=box, is_hopeless=is_hopeless, longest=longest)
        within = (1.0 - _TIME_SPARE) * longest
        duration = min(duration, within) if duration <= longest else duration
        flow = self._own_time.mean_flow(curve, duration) if self._problem.objective.jumps else 0.0
        flows = soft_flows(flow, first=unsampled, fine=fine, hurried=self._hurried)
        down = partial(self._down_softly, goal=goal, spare=spare, density=density)
        found = down(
            curve, duration, flows, most_rounds=most_rounds, box=box, is_hopeless=is_hopeless, longest=within
        )  # fmt: skip
        if found is None or unsampled:
            return found
        found = self._as_sampled(found)
        for _ in range(_HURRIES):
            if found.motion.duration <= longest or found.missed > KEPT_PART * spare:
                break
            within *= (1.0 - _TIME_SPARE) * longest / found.motion.duration
            sooner = down(
                found.curve, min(found.duration, within), flows[-1:], most_rounds=_HURRY_ROUNDS, box=_SMALLEST_BOX,
                is_hopeless=lambda here, rounds: False, longest=within,
            )  # fmt: skip
            if sooner is None:
                break
            found = self._as_sampled(sooner)
        return found

    def _down_softly(
        self, curve: JointCurve, duration: float, flows: Sequence[float], *,
        most_rounds: int, box: float, is_hopeless: Callable[[Timed, int], bool], **how: Any,
    ) -> Timed | None:  # fmt: skip
        """One descent for each of the soft `flows`, each from the result of the one before; see `_down`."""
        assert self._own_time is not None
        begun, found, self._curved, rough = self.rounds, None, None, self._rough
        for left, flow in zip(range(len(flows), 0, -1), flows, strict=True):
            rounds = most_rounds - (self.rounds - begun)
            if found is not None and rounds <= 0:
                break
            self._own_time, self._rough = replace(self._own_time, soft_flow=flow), rough or left > 1
            there = self._down(
                curve, duration, most_rounds=-(-rounds // left) if self._hurried else rounds, box=box,
                is_hopeless=is_hopeless, **how,
            )  # fmt: skip
            found = there or found
            if there is None or is_hopeless(there, most_rounds):
                break
            curve, duration, box = there.curve, there.duration, min(box, _NEXT_BOX)
        self._own_time, self._rough = replace(self._own_time, soft_flow=0.0), rough
        return found

    def _down(
        self, curve: JointCurve, duration: float, *,
        goal: Goal, most_rounds: int, spare: float, density: int, box: float,
        is_hopeless: Callable[[Timed, int], bool], longest: float,
    ) -> Timed | None:  # fmt: skip
        """One descent, see `run`; for another cost than the time, the result's cost is without rounded kinks."""
        free = goal if goal.q is None else None
        looks, self._longest, self._width = self._looks(curve, spare, density, free), longest, LEAST_WIDTH
        here = self._timed(self._within_cones(curve, looks), max(duration, SAMPLE_PERIOD), looks)
        if here is None:
            return None
        price = self._times_missed * MISSED_WORTH * here.cost
        unit = max(here.cost, NO_COST)
        bend = None
        if self._own_time is not None:
            here = self._rounded_off(here)
            bend = Bend.smooth(*self._slope(here, free, unit), curve.pieces, self._unit, box, here.duration)
            if self._curved is not None:
                bend = replace(bend, curvature=self._curved / unit)
        begun, steps, failed, slow = self.rounds, 0, 0, 0
        clear, box_then, bend_then = here, box, bend  # the last clear curve, with box and bend of that round
        before: Timed | None = None  # the curve before the last step, if `bend` is still that of it
        while self.rounds - begun < most_rounds:
            if is_hopeless(here, steps):
                if bend is None or here.missed <= looks.allowed or clear.missed > looks.allowed:
                    break
                here, box, before = clear, _SHRINK * min(box, box_then), None
                bend = None if bend_then is None else bend_then.stiffer(1.0 / _SHRINK)
                continue
            if bend is not None and here.cost <= self._nothing and here.missed <= looks.allowed:
                break
            self._brake.check()
            if bend is not None and before is not None:
                bend, before = self._learnt(bend, before, here, free, unit), None
                bend_then = bend if clear is here else bend_then
            if bend is not None and self._width > _SOFTEST * self._soft(here):
                here = self._rounded_off(here)
                clear = here if clear.missed > looks.allowed or here.missed <= looks.allowed else self._priced(clear)
                slope, curvature, kinks = self._slope(here, free, unit)
                bend = replace(bend, slope=slope, known=curvature, kinks=kinks)
            steps, self.rounds = steps + 1, self.rounds + 1
            worst, known = here.cost + price * here.missed, looks.known
            tried = there = self._step(here, free, looks, box, bend, below=worst)
            if there is here:
                break
            part, noticed = 1.0, False
            if there is not None and bend is None and worst <= there.cost + price * there.missed:
                there = self._mended(there, free, looks, box, below=worst)
            elif there is not None and bend is not None:
                if looks.known != known:  # the curve before may also go into a newly noticed obstacle
                    seen, noticed, known = self._seen_anew(here, looks), True, looks.known
                    here, clear = seen, seen if clear is here else clear
                    worst = here.cost + price * here.missed
                if there.cost < worst <= there.cost + price * there.missed:
                    there = self._cleared(here, there, free, looks, box, bend, price, below=worst)
                tried, part = self._shortened(here, there, free, looks, bend.slope * unit, price)
                there = tried
            gain = -np.inf if there is None else worst - there.cost - price * there.missed
            if there is None or gain <= 0.0:
                failed += 1
                if failed >= _STUCK and here.missed > looks.allowed >= clear.missed:
                    here, box, bend = clear, min(box, box_then), bend_then
                if tried is not None:
                    looks.widen(tried.margins)
                if looks.known != known:
                    here, noticed = self._seen_anew(here, looks), True
                if bend is not None:
                    part = 1.0 if noticed else max(part, _LEAST_PART)
                box *= part * _SHRINK
                bend = None if bend is None else bend.stiffer(1.0 / (part * _SHRINK))
                if box < (_SMALLEST_BOX if bend is None else _SMALLEST_BENT):
                    break
                continue
            if bend is None:
                there = self._in_its_own_time(there, price, looks)
            box = min(_GROW * part * box, _LARGEST_BOX)
            if bend is not None:  # a box far beyond the steps that are taken makes the program large
                box = min(box, max(_AROUND * self._length(here, there), _SMALLEST_BOX))
            if bend is not None and there.missed > max(here.missed, looks.allowed):
                # so far, going into an obstacle gains more than it costs
                self._times_missed = min(_MORE_MISSED * self._times_missed, _MOST_MISSED)
                price = self._times_missed * MISSED_WORTH * unit
            before, here, failed = here, there, 0
            if here.missed <= looks.allowed:
                clear, box_then, bend_then = here, box, bend
            slow = slow + 1 if gain < self._enough(bend) * here.cost else 0
            if slow >= (1 if bend is None else _SLOW) and here.missed <= _KEPT:
                break
        found = clear if here.missed > looks.allowed >= clear.missed else here
        if self._problem.objective.jumps:  # a less soft cost follows
            if bend is not None and before is not None:
                bend = self._learnt(bend, before, here, free, unit)
            learnt = bend if found is here else bend_then
            self._curved = None if learnt is None else learnt.curvature * unit
        if self._own_time is None:
            return found
        self._width = LEAST_WIDTH
        return self._priced(found)

    def estimates(self, curves: Sequence[JointCurve], durations: Vector, *, longest: float) -> Vector:
        """(C,) estimated costs of curves with the same pieces in their own times; not if the cost is the time.

        Parameters
        ----------
        durations: (C,) of each [s]; longer if the limits require it.
        longest: the longest time that a motion may take [s].
        """
        assert self._own_time is not None
        T = self._own_time.least_durations(curves, durations, places=_PLACES_OF_LIMITS)
        late = np.maximum(T / longest - 1.0, 0.0)
        costs = self._own_time.costs(curves, T, width=LEAST_WIDTH, places=_PLACES_OF_ESTIMATE)
        return np.asarray(costs * (1.0 + _LATE * late))

    def _soft(self, here: Timed) -> float:
        return float(suitable_width(max(here.cost, self._nothing), here.duration, len(self._unit)))

    def _rounded_off(self, here: Timed) -> Timed:
        """The same curve with the cost's kinks rounded off by a suitable width."""
        assert self._own_time is not None
        self._nothing = _NOTHING * self._own_time.gross(here.curve, here.duration)
        self._width = self._soft(here)
        return self._priced(here)

    def _priced(self, here: Timed) -> Timed:
        return replace(here, cost=self._own_cost(here.curve, here.duration))

    def _own_cost(self, curve: JointCurve, duration: float) -> float:
        """The cost of a curve in its own time, more if that is longer than allowed."""
        assert self._own_time is not None
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
            part *= float(np.clip(least, _SHORTEST, _SHRINK))
            control = here.curve.control + part * (whole.curve.control - here.curve.control)
            duration = here.duration + part * (whole.duration - here.duration)
            self.rounds += 1
            shorter = self._on_goal(here.curve, control, duration, goal, looks, below=worst)
            if shorter is None:
                break
            there = shorter
        return there, part

    def _enough(self, bend: Bend | None) -> float:
        """Part of the cost: a round that gains less ends the descent."""
        if bend is not None:
            return _ENOUGH_ROUGH if self._rough else _ENOUGH_BENT
        return _ENOUGH_HURRIED if self._hurried else _ENOUGH

    def _mended(self, there: Timed, goal: Goal | None, looks: Looks, box: float, *, below: float) -> Timed | None:
        """The curve after one more step, which repairs what the step before has missed, if that is little."""
        if there.missed >= _MENDED or there.cost >= below:
            return there
        self.rounds += 1
        return self._step(there, goal, looks, box, None, below=below)

    def _cleared(
        self, here: Timed, there: Timed, goal: Goal | None, looks: Looks, box: float, bend: Bend, price: float,
        *, below: float,
    ) -> Timed:  # fmt: skip
        """The curve `there`, or a better one after a step that also keeps the clearances linearised at `there`."""
        self.rounds += 1
        again = self._step(here, goal, looks, box, bend, below=below, beyond=there)
        worth = there.cost + price * there.missed
        return there if again is None or again.cost + price * again.missed >= worth else again

    def _seen_anew(self, here: Timed, looks: Looks) -> Timed:
        margins = looks.find_margins(here.curve, before=here.margins)
        return replace(here, missed=max(-margins.least, 0.0), margins=margins)

    def _slope(self, here: Timed, goal: Goal | None, unit: float) -> tuple[Vector, Matrix, Kinks]:
        """How the cost, divided by `unit`, changes with the control points that may move, and T.

        The slope, the known curvature, and the kinks.
        """
        assert self._own_time is not None
        moving = slice(1, here.curve.pieces + (goal is not None))
        found = self._own_time.slope(here.curve, here.duration, moving, width=self._width)
        if here.duration > self._longest:
            found.slope[-1] += _LATE * here.cost / self._longest
        return found.slope / unit, found.curvature / unit, found.kinks.over(unit)

    def _learnt(self, bend: Bend, before: Timed, here: Timed, goal: Goal | None, unit: float) -> Bend:
        """The model at the curve `here` from that at the curve `before`."""
        return bend.after(self._moved(before, here, goal), *self._slope(here, goal, unit))

    def _moved(self, here: Timed, there: Timed, goal: Goal | None) -> Vector:
        """The step from one curve to another, in the variables of `_slope`."""
        moved = (there.curve.control - here.curve.control)[1 : here.curve.pieces + (goal is not None)]
        return np.append(moved.ravel(), there.duration - here.duration)

    def _length(self, here: Timed, there: Timed) -> float:
        """The largest move of a control point from one curve to another [rad or m of the fastest joint]."""
        return float(np.max(np.abs(there.curve.control - here.curve.control) / self._unit))

    def _in_its_own_time(self, here: Timed, price: float, looks: Looks) -> Timed:
        """The same curve over the time of its fastest motion, if that is much shorter than T and costs no more."""
        if here.duration < _UNEVEN * here.motion.duration:
            return here
        curve = JointCurve.fitted(here.motion, here.curve.pieces, self._problem.limits)
        there = self._timed(curve, here.motion.duration, looks)
        if there is None or there.cost + price * there.missed > (1.0 + _ENOUGH) * (here.cost + price * here.missed):
            return here
        return there

    def _step(
        self, here: Timed, goal: Goal | None, looks: Looks, box: float, bend: Bend | None, *, below: float,
        beyond: Timed | None = None,
    ) -> Timed | None:  # fmt: skip
        """The curve after the best small step, see `_timed`; None if there is none, and `here` if that is good enough.

        The clearances are linearised at `here` and, if it is given, at the curve `beyond` as well.
        """
        curve = here.curve
        model = LinearModel(self._problem, curve, here.duration, end_moves=goal is not None, box=box * self._unit)
        model.keep_joint_limits()
        model.keep_drive_limits(self._drive)
        model.keep_clear(here.margins, looks.places)
        if beyond is not None:
            model.keep_clear(beyond.margins, looks.places, after=self._moved(here, beyond, goal)[:-1])
        if goal is not None:
            model.stay_on_goal(goal, self._kinematics.at(curve.control[-1]))
        most = _ITERATIONS if bend is None else _ITERATIONS_BENT
        missed = self._times_missed * _MISSED_PRICE
        x = model.best_step(missed, bend=bend, longest=self._longest, most_iterations=most)
        if x is None:
            return None
        control, duration = model.step(x)
        # not with a fixed end: the motion may then become much shorter nevertheless, because its own time is not T
        may_end = bend is None and self._hurried and goal is not None and here.missed <= looks.allowed
        if may_end and duration > (1.0 - _ENOUGH_PROMISED) * here.cost:
            return here
        return self._on_goal(curve, control, duration, goal, looks, below=below)

    def _on_goal(
        self, here: JointCurve, control: Matrix, duration: float, goal: Goal | None, looks: Looks, *, below: float
    ) -> Timed | None:
        """The curve with its end moved onto the goal, see `_timed`; None if that is impossible."""
        if goal is not None:
            end = self._onto(goal, control[-1], looks)
            if end is None:
                return None
            limits = self._problem.limits
            # a jump at the end alone would cost much
            control = np.clip(here.moved_to(control).ending_at(end).control, limits.lower, limits.upper)
        return self._timed(self._within_cones(here.moved_to(control), looks), duration, looks, below=below)

    def _within_cones(self, curve: JointCurve, looks: Looks) -> JointCurve:
        """The curve with its inner control points moved back into the cones that have to be kept."""
        cones = looks.cones
        return curve if cones is None else cones.moved(curve, self._problem.limits)

    def _timed(self, curve: JointCurve, duration: float, looks: Looks, *, below: float = np.inf) -> Timed | None:
        """The curve with its fastest motion; None if it has none.

        If that does not cost less than `below`, its clearances are not checked.
        """
        fastest: Trajectory | None = None
        if self._own_time is None:
            grid = np.linspace(0.0, 1.0, _GRID_PER_PIECE * curve.pieces + 1)
            fastest = time_curve(curve, grid, self._problem.limits, drive=self._drive)
            if fastest is None:
                return None
            cost = fastest.duration
        else:
            duration = self._own_time.least_duration(curve, duration)
            cost = self._own_cost(curve, duration)
        margins = Margins.none(curve.control.shape[1]) if cost >= below else looks.find_margins(curve)
        return Timed(curve, duration, cost, max(-margins.least, 0.0), margins, within_limits=fastest)

    def _looks(self, curve: JointCurve, spare: float, density: int, goal: Goal | None) -> Looks:
        if spare not in self._screens:
            self._screens[spare] = ClearanceScreen(self._proximity, time=self._time, spare=KEPT_PART * spare)
        return Looks(
            self._proximity, self._screens[spare], self._problem.keep,
            steps=density * PLACES_PER_PIECE * curve.pieces, spare=spare, time=self._time,
            hurried=self._hurried, fixed=list(curve.control[[0] if goal is not None else [0, -1]]),
        )  # fmt: skip

    def _onto(self, goal: Goal, q: Vector, looks: Looks) -> Vector | None:
        """(n,) joints near `q` (n,) on a goal, within the cones to be kept; None if Newton's method finds none."""
        kinematics, limits, cones = self._kinematics, self._problem.limits, looks.cones
        for _ in range(_TO_GOAL_STEPS):
            at = kinematics.at(q)
            error = goal.error(at)
            missing, G = (np.zeros(0), np.zeros((0, len(q)))) if cones is None else cones.missing(q[None])[:2]
            if float(np.max(np.abs(error))) <= _ON_GOAL and not len(missing):
                return q
            J = goal.jacobian(at)
            asked = movable_rows(J)
            J, error = np.vstack((J[asked], G)), np.concatenate((error[asked], missing))
            q = np.clip(q + step_onto(J, error, q, limits), limits.lower, limits.upper)
        return None


def step_onto(J: Matrix, error: Vector, q: Vector, limits: JointLimits) -> Vector:
    """(n,) the least step that corrects an error, by the joints that can move: none beyond a limit that it is at."""
    free = np.ones(len(q), dtype=bool)
    while True:
        step = np.zeros(len(q))
        step[free] = np.linalg.lstsq(J[:, free], error, rcond=1e-6)[0]
        held = ((q >= limits.upper) & (step > 0.0)) | ((q <= limits.lower) & (step < 0.0))
        if not held.any():
            return step
        free &= ~held
