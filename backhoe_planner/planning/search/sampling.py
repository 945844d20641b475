"""A route from one configuration to any of several, by sampling in joint space.

Straight lines are tried first, then RRTConnect (Kuffner and LaValle 2000) of OMPL with
motion checks that are proofs. Joints are weighted by their velocity limits, so lengths
are approximate times.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.machine import JointLimits
from backhoe_planner.motion import Keep
from backhoe_planner.planning.search.chart import Chart
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.search.first_order import FirstOrder
from backhoe_planner.planning.search.kept_trees import KeptTrees
from backhoe_planner.planning.search.motion_check import MotionCheck
from backhoe_planner.planning.search.reach import Reach, beyond_limits

_RANGE = 1.0  # s: the longest motion that is added to a tree; chosen
_OF_PROJECTION = 3  # sampled checks of motions, as which a projection counts: it takes as long; measured
# least length of such a motion, for slow machines, and largest, as parts of the box's diagonal; chosen, so that trees
# cross the box in some hundred motions, and branch
_LEAST_OF_BOX, _MOST_OF_BOX = 0.025, 0.4


@dataclass(frozen=True, eq=False)
class JointPath:
    """Straight motions from configuration to configuration.

    Attributes
    ----------
    q: (K, n) corners, the start first [rad or m].
    """

    q: Matrix

    def __post_init__(self) -> None:
        self.q.setflags(write=False)

    def length(self, limits: JointLimits) -> float:
        """Euclidean norm of the joint times (at full velocity), added up over the segments [s]."""
        return float(np.sum(np.linalg.norm(np.diff(self.q, axis=0) / limits.velocity, axis=1)))


def sample_path(
    check: MotionCheck,
    start: Vector,
    goals: Sequence[Vector],
    *,
    seed: int,
    work: Work,
    most_motions: int | None = None,
    straight: bool = True,
    keep: Keep | None = None,
) -> JointPath | None:
    """A route that keeps every clearance and joint limit, as far as `check` proves it; or None.

    The same input and seed give the same route. OMPL's global seed is set.

    Parameters
    ----------
    check: made for `start` and `goals`, in this order.
    start: (n,) where the route begins [rad or m].
    goals: (n,) each, where it may end; those that are not clear are left out.
    seed: of the sampling, not negative.
    work: every motion that the sampling checks is subtracted from it.
    most_motions: after so many the sampling is given up; by default `Effort.motions_per_search`,
        0 for the straight motions alone.
    straight: whether straight motions to the goals are tried first.
    keep: what the corners of a route satisfy, if it is narrower than what `check` requires of its motions.

    Returns
    -------
    The route to the goal that was reached first; None if none was found, no end is clear, or no work is left.

    Raises
    ------
    OutOfTime: the budget of the brake of `check` is used up.
    """
    if not check.ends_clear[0]:
        return None
    order = sorted(
        (index for index in range(len(goals)) if check.ends_clear[index + 1]),
        key=lambda index: float(np.max(np.abs(goals[index] - start) / check.rate)),
    )
    band = None if check.problem.keep is None else check.problem.keep.band
    open_goals = [goals[index] for index in order]
    if band is not None:  # a goal a whole turn of the pitch from the start cannot be reached within the band
        open_goals = [goal for goal in open_goals if abs(float(band.row @ (goal - start))) < np.pi]
    for goal in open_goals if straight else ():
        if check.segment_is_clear(start, goal):
            return JointPath(np.array([start, goal]))
    most_motions = work.effort.motions_per_search if most_motions is None else most_motions
    if not open_goals or min(most_motions, work.motions) <= 0:
        return None
    search, keep = _Search(check, work, most_motions), keep or check.problem.keep
    if keep is not None and keep.cones:
        return search.run_kept(keep, start, open_goals, seed)
    return search.run(start, open_goals, seed)


# OMPL has one seed and one log level for the whole process: one search at a time
_OMPL = threading.Lock()


class _Search:
    """One run of RRTConnect, in the coordinates of a `Chart`.

    No exception passes through OMPL: the first one makes OMPL stop, and is raised again
    afterwards. Nothing that OMPL owns is kept here, because it would never be freed.
    """

    def __init__(self, check: MotionCheck, work: Work, most_motions: int) -> None:
        self._check = check
        self._work = work
        self._until = max(work.motions - most_motions, 0)  # motions left at which the search ends
        self._rate = check.rate
        self._chart = Chart(check)
        self._raised: BaseException | None = None

    def run_kept(self, keep: Keep, start: Vector, goals: list[Vector], seed: int) -> JointPath | None:
        """The same with samples projected onto the conditions of `keep`, without OMPL."""

        def allows(a: Vector, b: Vector) -> bool:
            self._work.motions -= 1
            return self._check.segment_is_clear(a, b)

        limits = self._check.problem.limits
        lower, upper = Reach(limits, start, np.array(goals)).box()

        of_projection = 1 if self._check.proves else _OF_PROJECTION

        def project(q: Vector) -> Vector | None:
            self._work.motions -= of_projection
            found = keep.project(q, lower, upper)
            self._check.brake.check()
            return found

        trees = KeptTrees(
            rate=self._rate, project=project, limits_at=partial(FirstOrder.at, keep), allows=allows, ended=self._ended
        )
        q = trees.connect(start, goals, lower, upper, np.random.default_rng(seed))
        return None if q is None else JointPath(q)

    def run(self, start: Vector, goals: list[Vector], seed: int) -> JointPath | None:
        from ompl import util

        with _OMPL:
            level = util.getLogLevel()
            util.setLogLevel(util.LogLevel.LOG_NONE)
            try:
                found = self._solve(start, goals, seed)
            finally:
                util.setLogLevel(level)
                raised, self._raised = self._raised, None
        if raised is not None:
            raise raised
        return found

    def _solve(self, start: Vector, goals: list[Vector], seed: int) -> JointPath | None:
        from ompl import base, geometric, util

        util.RNG.setSeed(seed + 1)  # 0 would mean a seed from the clock
        n = len(start)
        self._chart.begin_at(start)
        limits = self._check.problem.limits
        low, high = self._chart.box(*beyond_limits(limits, *Reach(limits, start, np.array(goals)).box()))
        # OMPL waits forever for an end outside the box
        goals = [goal for goal in goals if self._is_within(low, high, goal)]
        if not goals or not self._is_within(low, high, start):
            return None
        space = base.RealVectorStateSpace(n)
        bounds = base.RealVectorBounds(n)
        for joint in range(n):
            bounds.setLow(joint, float(low[joint]))
            bounds.setHigh(joint, float(high[joint]))
        space.setBounds(bounds)
        space_information = base.SpaceInformation(space)
        space_information.setMotionValidator(_validator(base, space_information, n, self._allows))
        space_information.setStateValidityChecker(base.AllValidStateValidityChecker(space_information))
        space_information.setup()
        definition = base.ProblemDefinition(space_information)
        definition.addStartState(self._state(space, start))
        targets = base.GoalStates(space_information)
        for goal in goals:
            targets.addState(self._state(space, goal))
        definition.setGoal(targets)
        planner = geometric.RRTConnect(space_information)
        across = float(np.linalg.norm(high - low))
        planner.setRange(min(max(_RANGE, _LEAST_OF_BOX * across), _MOST_OF_BOX * across))
        planner.setProblemDefinition(definition)
        planner.setup()
        planner.solve(base.PlannerTerminationCondition(self._ended))
        if self._raised is not None or not definition.hasExactSolution():
            return None
        corners = [state[0:n] for state in definition.getSolutionPath().getStates()]
        q = self._chart.joints(np.array(corners))
        q[0] = start
        q[-1] = min(goals, key=lambda goal: float(np.max(np.abs(goal - q[-1]))))
        # the scaling has moved the corners by rounding; only a proof shows that they are still clear
        clear = not self._check.proves or all(self._check.segment_is_clear(a, b) for a, b in itertools.pairwise(q))
        return JointPath(q) if clear else None

    def _is_within(self, low: Vector, high: Vector, q: Vector) -> bool:
        place = self._chart.place(q)
        return bool(((low <= place) & (place <= high)).all())

    def _state(self, space: Any, q: Vector) -> Any:
        state = space.allocState()
        state[0 : len(q)] = self._chart.place(q).tolist()
        return state

    def _allows(self, a: list[float], b: list[float]) -> bool:
        """Whether OMPL may move from `a` to `b`, in the chart's coordinates."""
        self._work.motions -= 1
        if self._raised is not None:
            return False
        try:
            return self._check.segment_is_clear(self._chart.joints(np.array(a)), self._chart.joints(np.array(b)))
        except BaseException as raised:  # noqa: BLE001 - raised again after OMPL has stopped
            self._raised = raised
            return False

    def _ended(self) -> bool:
        """Whether OMPL is to stop."""
        return self._raised is not None or self._work.motions <= self._until


def _validator(base: Any, space_information: Any, n: int, allows: Callable[[list[float], list[float]], bool]) -> Any:
    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any) -> bool:
            return allows(a[0:n], b[0:n])

    return Validator(space_information)
