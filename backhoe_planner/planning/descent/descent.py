"""Descent: a curve is bent, and its end moved on the goal, until its cost stops falling.

Each round linearises clearances and goal about the curve, and takes the step that solves a quadratic program
(sequential convex programming, Schulman et al. 2014), within a box (a trust region) that grows after a step that
lowered the cost and shrinks otherwise. The program contains the limits, linearised, with the duration T of the
curve's own time t = T s, in which the curve is run at an even pace.

Missing a clearance has a high price. If no step helps a curve that misses one, the last clear curve is continued with
smaller steps. What is minimised is the time (`DescentOfTime`) or another cost (`DescentOfCost`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits, Kinematics, movable_rows
from backhoe_planner.motion import Goal, Problem, Trajectory, drive_of, time_evenly
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.linear_model import PLACES_PER_PIECE, LinearModel
from backhoe_planner.planning.descent.looks import KEPT_PART, Looks
from backhoe_planner.planning.descent.margins import Margins
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.site import ClearanceScreen, Proximity

MISSED_PRICE = 20.0  # of a metre missed in the quadratic program, as a part of the cost: well above the possible gain
MISSED_WORTH = 6.0  # the same in the comparison of two curves; chosen among 3 to 20: the next step repairs a miss
LARGEST_BOX, SMALLEST_BOX = 0.6, 0.02  # rad or m of the fastest joint: most move of a control point in a step; chosen
GROW, SHRINK = 1.5, 0.4  # factors on the box after a step that is taken, and after one that is not; chosen
KEPT = 1e-4  # m by which the last round may miss the spare beyond the clearance
# part of the cost: a descent for another cost than the time ends after two rounds in a row that gain less, as the cost
# keeps falling for long. The second if a finer curve follows: with 0.004 to 0.02 motions cost as much; chosen
ENOUGH, ENOUGH_ROUGH = 1e-3, 0.01
STUCK = 2  # failed steps in a row, after which a curve that is not clear is replaced by the last clear one; chosen
_TO_GOAL_STEPS = 8  # of Newton's method; it doubles its digits with each
_ON_GOAL = 1e-8  # m and rad


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


@dataclass(frozen=True, eq=False)
class Options:
    """How one descent is made.

    Attributes
    ----------
    most_rounds: after which the descent ends, except for a few more if its motion takes too long.
    spare: to be kept beyond every clearance [m].
    density: places at which clearances are checked, for each place at which limits are.
    box: how far the first step may move a control point [rad or m of the fastest joint].
    is_hopeless: decides from a curve and the number of steps so far whether the descent is given up.
    longest: the longest T, if the time is the cost, otherwise the longest time that the motion may take [s]; exceeded
        if no step helps.

    For another cost than the time:

    unsampled: whether the motion may break limits between the places where a step keeps them, and its cost may be
        inexact; to correct both takes as long as two rounds.
    enough: part of the cost: the descent ends after two rounds in a row that gain less.
    clear_first: whether misses cost much more than usual, so that the curve gets out of an obstacle that
        is cheap to go through.
    fine: whether the cost is evaluated at more places; for the last descents.
    """

    most_rounds: int
    spare: float
    density: int
    box: float
    is_hopeless: Callable[[Timed, int], bool] = lambda here, rounds: False
    longest: float = np.inf
    unsampled: bool = False
    enough: float = ENOUGH
    clear_first: bool = False
    fine: bool = False


class Descent(ABC):
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
        self.rate = rate = problem.limits.velocity
        self._unit = rate / float(np.max(rate))  # rad or m of each joint per unit of the box
        self._screens: dict[float, ClearanceScreen] = {}  # by the spare
        self.rounds = 0

    @abstractmethod
    def run(self, curve: JointCurve, duration: float, goal: Goal, options: Options) -> Timed | None:
        """Bend a curve until its cost stops falling.

        Parameters
        ----------
        curve: from where the machine is to a goal; it need not be clear.
        duration: estimated duration [s]; at least a sample's period counts.
        goal: on which the end may move; a goal given by joints fixes the end.

        Returns
        -------
        The best curve, not proven to be clear; None if the first has no motion.

        Raises
        ------
        OutOfTime: the budget is used up.
        """

    def _model(
        self, here: Timed, goal: Goal | None, looks: Looks, box: float, *, beyond: Timed | None = None
    ) -> LinearModel:  # fmt: skip
        """What a small step has to keep.

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
        return model

    def _moved(self, here: Timed, there: Timed, goal: Goal | None) -> Vector:
        """The step from one curve to another, in the variables of the program."""
        moved = (there.curve.control - here.curve.control)[1 : here.curve.pieces + (goal is not None)]
        return np.append(moved.ravel(), there.duration - here.duration)

    def _seen_anew(self, here: Timed, looks: Looks) -> Timed:
        """The same curve with the margins at all places that are known by now."""
        margins = looks.find_margins(here.curve, before=here.margins)
        return replace(here, missed=max(-margins.least, 0.0), margins=margins)

    def _on_goal(self, here: JointCurve, control: Matrix, goal: Goal | None, looks: Looks) -> JointCurve | None:
        """The curve with these control points, its end moved onto the goal; None if that is impossible."""
        if goal is not None:
            end = self._onto(goal, control[-1], looks)
            if end is None:
                return None
            limits = self._problem.limits
            # a jump at the end alone would cost much
            control = np.clip(here.moved_to(control).ending_at(end).control, limits.lower, limits.upper)
        return self._within_cones(here.moved_to(control), looks)

    def _within_cones(self, curve: JointCurve, looks: Looks) -> JointCurve:
        """The curve with its inner control points moved back into the cones that have to be kept."""
        cones = looks.cones
        return curve if cones is None else cones.moved(curve, self._problem.limits)

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


def is_astray(here: Timed, clear: Timed, looks: Looks) -> bool:
    """Whether the curve `here` is not clear, and that of an earlier round, `clear`, is."""
    return here.missed > looks.allowed >= clear.missed


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
