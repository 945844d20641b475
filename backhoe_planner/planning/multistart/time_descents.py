"""Descents to the fastest motions."""

from __future__ import annotations

from backhoe_planner.arrays import Vector
from backhoe_planner.motion import Goal, Problem
from backhoe_planner.planning.descent.curve import JointCurve
from backhoe_planner.planning.descent.descent import Timed
from backhoe_planner.planning.descent.descent_of_time import DescentOfTime
from backhoe_planner.planning.multistart.counted_rounds import CountedRounds
from backhoe_planner.planning.multistart.incumbent import FoundMotion, Incumbent
from backhoe_planner.planning.multistart.motion_descents import FAR_OFF, FINE_PIECES, FINE_ROUNDS, MotionDescents
from backhoe_planner.planning.search.goal_ends import GoalEnds
from backhoe_planner.planning.world.world import World

_ROUNDS = 24  # of a descent at most; chosen, half of them end after 7
_LOOKS = (0, 4, 8)  # rounds after which it is checked whether a descent goes where another one has ended; chosen
_DEARER = 1.3  # times the best cost: hopeless then
LEAST_GAIN = 0.02  # part of the least time to a posture: a smaller gain is not worth a try


class TimeDescents(MotionDescents):
    """Descents for the least time.

    Parameters
    ----------
    ends: the postures on the goals.
    """

    def __init__(self, world: World, start: Vector, ends: GoalEnds, incumbent: Incumbent, *, time: float) -> None:
        descent = DescentOfTime(
            world.problem, world.proximity, world.kinematics, time=time, brake=world.work.brake,
            hurried=world.work.effort.is_hurried,
        )  # fmt: skip
        rounds = CountedRounds(world.work, descent)
        super().__init__(world, start, incumbent, rounds, time=time, most_rounds=_ROUNDS, looks=_LOOKS)
        self._ends = ends

    def refine(self) -> None:
        """Improve the best motion on a curve of more pieces, if enough rounds are left."""
        self.rounds.reserve(0)
        if self.best is None or self.rounds.left_of_cost < FINE_ROUNDS:
            return
        curve = JointCurve.fitted(self.best.motion, FINE_PIECES, self._problem.limits)
        self.descend_finely(self.best, curve, self.best.motion.duration, FINE_ROUNDS)

    def _falls_behind(self, here: Timed, rounds: int, best: FoundMotion) -> bool:
        return here.missed > FAR_OFF or here.cost > _DEARER * best.cost

    def _least_worth(self, curve: JointCurve, goal: Goal) -> float:
        """In a hurry, little more than the least time to the end, if that is fixed."""
        if not self._effort.is_hurried or not holds_end(self._problem, goal):
            return 0.0
        return (1.0 + LEAST_GAIN) * self._ends.least_to(curve.control[-1])

    def _even_curve(self, found: Timed) -> None:
        return None


def holds_end(problem: Problem, goal: Goal) -> bool:
    """Whether a goal leaves the end of a motion no freedom."""
    if goal.q is not None:
        return True
    if goal.search_target.position_tolerance:
        return False
    pitch, turned = goal.target.pitch, goal.target.rotation is not None
    more = 3 if turned else int(pitch is not None and pitch[0] == pitch[1])
    return bool(problem.robot.n <= 3 + more)
