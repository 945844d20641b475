"""Planning with the completed law: step by step, using only what is near.

First the tip moves straight to the goal. If it does not arrive, the joints are driven
towards configurations that put the tip on the goal. If the tip's straight line is blocked,
it also circulates along the surface of the blocking obstacle, in each sense in turn. The
first attempt that arrives ends the search.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.law import CompletedLaw
from backhoe_planner.machine import Configuration, JointLimits, TipTarget, movable_rows
from backhoe_planner.motion import Goal, hand_set_gains
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.site import Nearby, Obstruction

_AT_GOAL = 1e-4  # m and rad from the goal: chosen, far below what a machine can keep
_ARRIVED = 0.2 * _AT_GOAL  # m and rad left in the rows that the law controls; the other rows may add to it
_LONGEST = 40.0  # s of motion per attempt; chosen: long for a motion to a goal
_PATIENCE = 1.5  # s without progress after which an attempt counts as stuck; chosen
_PROGRESS = 0.002  # m (or rad) within the patience that counts as progress; chosen
_NOTICEABLE = 0.02  # part of the remaining distance that counts as progress, if that is more; chosen
_POSTURES_FIRST = 3  # tried before the tip circulates: they are quick to try, and give quick motions if they arrive
_STILL = 0.03  # m that the tip must move within the patience while it circulates; chosen: 2 cm/s
_LONGEST_TURN = 12.0  # s for which the tip circulates; chosen: a third of an attempt, so that time is left after it
_HOLD = 0.4  # s after the tip left a surface, when the surface no longer counts; chosen: 20 steps
_LEADS = 0.6  # part of the direction to the goal along a surface, from which it leads to the goal; chosen
_CLOSE = 0.1  # m of margin; chosen: pairs nearer than this define the surface
_BRAKING_PART = 0.5  # part of the acceleration limit; chosen: half is kept in reserve
_FADE = 0.05  # m and rad left, below which the terms in the null space fade out; chosen
_DAMPING = 1e-4  # of the inverse that estimates the joint rates: the square of a small singular value; chosen
_NEARER = 0.02  # m and rad by which the tip must be nearer than where it hit before it leaves a surface; chosen
_LEAST_AIM = 0.3  # m: nearer to the goal, the tip circulates as fast as from here; chosen
_INTO = 0.3  # part of the direction that points into the surface, so as not to lose it; chosen
_LEVEL = 0.9  # of a normal's vertical part: more is a floor or a ceiling, as its slope is below 26 deg; chosen
_TOUCHING = 0.01  # m added to margins as weights, so that what touches does not count alone; chosen
_SETTLE = 10.0  # 1/s: chosen, the rate at which a motion ends; five of its time constants are half a second


@dataclass(frozen=True)
class Attempt:
    """One attempt to reach a goal.

    Attributes
    ----------
    arrived: whether the machine is on the goal, at rest.
    stepper: the motion that was made.
    distance: of the tip from the goal at the end [m].
    obstruction: what is nearest to the machine at the end; None if nothing is near.
    way: how the goal was approached, in words.
    """

    arrived: bool
    stepper: Stepper
    distance: float
    obstruction: Obstruction | None
    way: str


class Sense(Enum):
    """The direction in which the tip circulates along a surface."""

    UP = "over the top"
    LEFT = "round the left"
    RIGHT = "round the right"
    DOWN = "underneath"


_Way = tuple[str, Vector | None, Sense | None]


def approach_goal(
    stepper: Stepper,
    goal: Goal,
    configurations: Sequence[Vector],
    *,
    work: Work,
    all_ways: bool = False,
    null_space: bool = True,
) -> Iterator[Attempt]:
    """Attempts to reach `goal`, the simplest first; ends once one arrives.

    For a goal that is given by the joints there is one attempt: straight in joint space.

    Parameters
    ----------
    stepper: a motion that is at rest; every attempt is a branch of it.
    configurations: (n,) each, with the tip on the goal [rad or m], the preferred one first.
    work: every step is subtracted from it; if no work or no time is left, the attempt
        ends where it is and no further one is begun.
    all_ways: whether to go on after an attempt that arrives.
    null_space: whether the null-space terms of the law are used; studies leave them out.
    """
    # an arm that moves in a level plane cannot go over the top or underneath
    level = not movable_rows(stepper.look()[0].jacobian[:3])[2]
    senses = [Sense.LEFT, Sense.RIGHT] if level else list(Sense)
    postures: list[_Way] = [(f"to posture {index}", q, None) for index, q in enumerate(configurations, start=1)]
    turns: list[_Way] = [(sense.value, None, sense) for sense in senses]
    straight: _Way = ("straight", None, None)
    ways = [straight, *postures[:_POSTURES_FIRST], *turns, *postures[_POSTURES_FIRST:]]
    if goal.q is not None:
        ways = [("straight for the joints", goal.q, None)]
    for number, (name, posture, sense) in enumerate(ways, start=1):
        branch = stepper.branch(attempt=number)
        if posture is None:
            attempt = _drive_tip(branch, goal, sense, name, work, null_space=null_space)
        else:
            attempt = _drive_joints(branch, posture, goal, name, work)
        yield attempt
        if (attempt.arrived and not all_ways) or work.law_steps <= 0 or work.brake.is_used_up():
            return


# --- moving the tip ---------------------------------------------------------------


def _drive_tip(stepper: Stepper, goal: Goal, sense: Sense | None, way: str, work: Work, *, null_space: bool) -> Attempt:
    problem = stepper.problem
    law = CompletedLaw(problem.robot, influence=problem.scene.influence, gains=hand_set_gains(problem))
    progress = _Progress()
    turning = _Turning(sense)
    arrived = False
    begun = stepper.time
    while stepper.time < begun + _LONGEST and _may_step(work):
        at, nearby = stepper.look()
        error, J = _task(goal.search_target, at)
        left = float(np.linalg.norm(error))
        if left < _ARRIVED and stepper.stopped():
            # `left` does not include rows that no joint can change in this posture
            arrived = max(goal.search_target.distances(at)) < _AT_GOAL
            stepper.stop()
            break
        wished = turning.direction(error, at, nearby, stepper, left)
        dq = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(len(J)), wished)
        xdot = wished * _pace(problem.limits, dq)
        primary, null = law.terms_unchecked(at, J, xdot, nearby)
        fade = min(1.0, left / _FADE) if null_space else 0.0
        if not stepper.advance(_within_rates(primary + fade * null, problem.limits), nearby, at.jacobian[:3]):
            break
        if turning.active:
            if turning.stuck(at.tip_position, stepper.time):
                break
            progress = _Progress()
        elif progress.stuck(left, stepper.time) and not turning.begin(nearby, stepper, left):
            break
    return _attempt(stepper, goal, arrived, way)


def _task(goal: TipTarget, at: Configuration) -> tuple[Vector, Matrix]:
    """Error and Jacobian of the rows that the joints can change and that are not satisfied yet."""
    error, J = goal.error(at), goal.jacobian(at)
    rows = movable_rows(J)
    if goal.pitch is not None and goal.rotation is None and error[3] == 0.0 and goal.pitch[1] > goal.pitch[0]:
        rows = rows & np.array([True, True, True, False])
    return error[rows], J[rows]


def _pace(limits: JointLimits, dq: Vector) -> float:
    """The rate at which the remaining joint motion `dq` (n,) shrinks [1/s], so that every joint can still brake."""
    size = np.abs(dq) + 1e-9
    braking = np.sqrt(2.0 * _BRAKING_PART * limits.acceleration / size)
    return float(min(np.min(limits.velocity / size), np.min(braking), _SETTLE))


def _within_rates(v: Vector, limits: JointLimits) -> Vector:
    """`v` (n,) scaled down until every joint is within its velocity limit."""
    ratio = float(np.max(np.abs(v) / limits.velocity))
    return v / ratio if ratio > 1.0 else v


class _Progress:
    """Notices when the remaining distance has stopped falling."""

    def __init__(self) -> None:
        self._best = np.inf
        self._since = 0.0

    def stuck(self, left: float, time: float) -> bool:
        """Whether `left` has not fallen noticeably for longer than `_PATIENCE`."""
        if left < self._best - max(_PROGRESS, _NOTICEABLE * left):
            self._best, self._since = left, time
        return time - self._since > _PATIENCE


class _Turning:
    """The circulation term: motion along the surface of the blocking obstacle.

    It begins when the straight motion is stuck. If the surface leads towards the goal,
    the tip follows it in that direction, otherwise in the given sense. It ends when the tip is
    nearer to the goal than at the beginning and the direction to the goal points away from the surface.
    """

    def __init__(self, sense: Sense | None) -> None:
        self._sense = sense
        self._hit: float | None = None
        self._normal = np.zeros(3)
        self._touched = 0.0
        self._begun = self._since = 0.0
        self._place: Vector | None = None

    @property
    def active(self) -> bool:
        """Whether the tip is circulating now."""
        return self._hit is not None

    def begin(self, nearby: Nearby, stepper: Stepper, left: float) -> bool:
        """Start to circulate; False if no sense is given, or nothing blocks the tip."""
        if self._sense is None or self._hit is not None:
            return False
        normal = _blocking_normal(nearby, stepper)
        if normal is None:
            return False
        self._hit, self._normal, self._touched = left, normal, stepper.time
        self._begun = self._since = stepper.time
        self._place = None
        return True

    def stuck(self, tip: Vector, time: float) -> bool:
        """Whether the tip at `tip` (3,) has hardly moved for `_PATIENCE`, or has circulated for too long."""
        if self._place is None or float(np.linalg.norm(tip - self._place)) > _STILL:
            self._place, self._since = tip, time
        return time - self._since > _PATIENCE or time - self._begun > _LONGEST_TURN

    def direction(self, error: Vector, at: Configuration, nearby: Nearby, stepper: Stepper, left: float) -> Vector:
        """(m,) the direction to go: along `error` (m,), or along the surface while circulating.

        Parameters
        ----------
        left: size of the error [m or rad].
        """
        if self._hit is None or self._sense is None:
            return error
        normal = _blocking_normal(nearby, stepper)
        if normal is not None:
            self._normal, self._touched = normal, stepper.time
        rows = min(len(error), 3)
        toward = np.zeros(3)
        toward[:rows] = error[:rows]
        into = float(toward @ self._normal)
        off_surface = normal is None and stepper.time - self._touched > _HOLD
        if left < self._hit - _NEARER and (into <= 0.0 or off_surface):
            self._hit = None
            return error
        size = max(float(np.linalg.norm(toward)), _LEAST_AIM)
        along = toward - into * self._normal
        if float(np.linalg.norm(along)) < _LEADS * float(np.linalg.norm(toward)):
            along = _tangent(self._normal, self._sense, at)
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        found = np.array(error)
        found[:rows] = (size * (along + _INTO * self._normal))[:rows]
        return found


def _tangent(normal: Vector, sense: Sense, at: Configuration) -> Vector:
    """(3,) a vector of any length along a surface in the given sense; `normal` (3,) points into the surface."""
    up = np.array([0.0, 0.0, 1.0])
    if sense in (Sense.LEFT, Sense.RIGHT):
        left = np.cross(normal, up) if abs(normal[2]) < _LEVEL else np.cross(up, at.tip_position - at.points[0])
        return np.asarray(left if sense is Sense.LEFT else -left)
    rise = up - normal[2] * normal
    if abs(normal[2]) > _LEVEL:  # on a floor or a ceiling, "over" means back towards the machine
        rise = at.points[0] - at.tip_position
        rise = rise - (rise @ normal) * normal
    return np.asarray(rise if sense is Sense.UP else -rise)


def _blocking_normal(nearby: Nearby, stepper: Stepper) -> Vector | None:
    """(3,) mean unit normal into the close obstacles while the shield is binding; None if it is not."""
    shielded = stepper.shielded
    if shielded is None or len(shielded.binding) == 0 or len(nearby) == 0:
        return None
    close = nearby.margin < _CLOSE
    if not np.any(close):
        return None
    weight = 1.0 / (np.maximum(nearby.margin[close], 0.0) + _TOUCHING)
    mean = weight @ nearby.normal[close]
    length = float(np.linalg.norm(mean))
    return mean / length if length > 1e-9 else None


# --- moving the joints --------------------------------------------------------------


def _drive_joints(stepper: Stepper, posture: Vector, goal: Goal, way: str, work: Work) -> Attempt:
    problem = stepper.problem
    free_tip = np.zeros((3, problem.robot.n))
    progress = _Progress()
    arrived = False
    begun = stepper.time
    while stepper.time < begun + _LONGEST and _may_step(work):
        _, nearby = stepper.look()
        dq = posture - stepper.q
        left = float(np.max(np.abs(dq)))
        if left < _ARRIVED and stepper.stopped():
            stepper.stop()
            arrived = True
            break
        if not stepper.advance(_pace(problem.limits, dq) * dq, nearby, free_tip) or progress.stuck(left, stepper.time):
            break
    return _attempt(stepper, goal, arrived, way)


def _may_step(work: Work) -> bool:
    """Subtract a step from the work; False if no step or no time is left."""
    work.law_steps -= 1
    return work.law_steps >= 0 and not work.brake.is_used_up()


def _attempt(stepper: Stepper, goal: Goal, arrived: bool, way: str) -> Attempt:
    if not arrived:
        stepper.stop()
    at, nearby = stepper.look()
    obstruction = None
    if len(nearby):
        row = int(np.argmin(nearby.margin))
        obstruction = stepper.proximity.pairs[int(nearby.pair[row])].at(float(nearby.distance[row]), time=stepper.time)
    return Attempt(arrived, stepper, goal.distances(at)[0], obstruction, way)
