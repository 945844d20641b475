"""OMPL's own planners on the same problem, with the same check of motions and the same processor time.

The space is that of `planning.sample_path`: joint positions over their greatest rates, so that
lengths are times [s]. Goals are several clear configurations. The path that a planner finds in
its time is shortened, rounded and timed by the package itself, so that only the path is compared.

RRTConnect ends at its first path; it is restarted with other seeds until the time is over, and the
shortest path counts. The others improve their path for as long as they may; AORRTC searches anew for ever cheaper ones.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

import backhoe_planner as bp
from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.motion import Problem, Trajectory, build_problem, drive_of, time_way
from backhoe_planner.planning import (
    EFFORTS,
    Brake,
    JointPath,
    MotionCheck,
    OutOfTime,
    Work,
    World,
    blend,
    sample_path,
    shorten,
)

PLANNERS = ("RRTConnect", "RRTstar", "InformedRRTstar", "BITstar", "AORRTC")
SPARE = 0.002  # m kept beyond every clearance, as by the package's own search in narrow places
_MOST_GOALS = 12
_RANGE = 1.0  # s of joint time: the longest motion added to a tree
_POINTS = 24  # on a path, and
_STEPS = 8  # intermediate paths that are checked when one path is deformed into another


@dataclass(frozen=True, eq=False)
class Challenge:
    """A problem for OMPL: from one configuration to any of several.

    Attributes
    ----------
    start, goals: (n,) each, clear [rad or m].
    """

    problem: Problem
    proximity: bp.Proximity
    start: Vector
    goals: tuple[Vector, ...]

    def check(self, brake: Brake | None = None) -> MotionCheck:
        """A new check of motions with an empty memory."""
        ends = [self.start, *self.goals]
        return MotionCheck(self.problem, self.proximity, ends, spare=SPARE, brake=brake)


def pose_challenge(robot: bp.Robot, scene: bp.Scene, *, seed: int) -> Challenge | None:
    """The scene as a challenge, its goal as clear configurations; None if none is found."""
    problem = build_problem(robot, scene)
    assert problem.start_q is not None
    world = World(problem, seed=seed, work=Work(EFFORTS["normal"]))
    found = Challenge(problem, world.proximity, problem.start_q, _goal_postures(world))
    start_clear, *clear = found.check().ends_clear
    goals = tuple(goal for goal, is_clear in zip(found.goals, clear, strict=True) if is_clear)
    return replace(found, goals=goals) if start_clear and goals else None


def _goal_postures(world: World) -> tuple[Vector, ...]:
    """Up to a dozen clear configurations on the goals, the nearest first."""
    near, count = world.problem.start_q, world.work.effort.starting_points
    found: list[Vector] = []
    for goal in world.problem.goals:
        if goal.q is not None:
            found.append(goal.q)
        else:
            found += world.postures.at(goal.search_target, near=near, count=count).clear[:_MOST_GOALS]
    return tuple(found[:_MOST_GOALS])


@dataclass(frozen=True, eq=False)
class Found:
    """A path that a planner found.

    Attributes
    ----------
    way: the corners of the path.
    motion: along it, as fast as the limits allow.
    """

    way: JointPath
    motion: Trajectory


def solve(challenge: Challenge, planner: str, seconds: float, *, seed: int) -> Found | None:
    """The best path that one of `PLANNERS` finds in `seconds` of processor time; None if it finds none."""
    find = _restarts if planner == "RRTConnect" else partial(_improving, planner=planner)
    way = find(challenge, Brake(seconds), seed=seed)
    if way is None:
        return None
    check, problem = challenge.check(), challenge.problem
    way = shorten(check, way, seed=seed)
    return Found(way, time_way(blend(check, way), problem.limits, drive=drive_of(problem)))


def _restarts(challenge: Challenge, brake: Brake, *, seed: int) -> JointPath | None:
    check, limits = challenge.check(brake), challenge.problem.limits
    straight = [JointPath(np.array([challenge.start, goal])) for goal in challenge.goals]
    found: list[JointPath] = []
    try:
        found += [way for way in straight if check.segment_is_clear(*way.q)]
        for attempt in itertools.count() if not found else ():
            work = Work(EFFORTS["thorough"], brake)
            way = sample_path(check, challenge.start, challenge.goals, seed=1000 * seed + attempt, work=work)
            if way is None:
                break
            found += [way, shorten(check, way, seed=attempt)]
    except OutOfTime:
        pass
    return min(found, key=lambda way: way.length(limits), default=None)


def _improving(challenge: Challenge, brake: Brake, *, planner: str, seed: int) -> JointPath | None:
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    check, n = challenge.check(), len(challenge.start)
    rate = check.rate
    ends = np.array([challenge.start, *challenge.goals])
    limits = challenge.problem.limits
    low = np.where(np.isfinite(limits.lower), limits.lower, ends.min(axis=0) - 2.0 * np.pi)
    high = np.where(np.isfinite(limits.upper), limits.upper, ends.max(axis=0) + 2.0 * np.pi)
    space = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(low[joint] / rate[joint]) - 1e-9)
        bounds.setHigh(joint, float(high[joint] / rate[joint]) + 1e-9)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setMotionValidator(_validator(base, information, check, brake))
    information.setStateValidityChecker(base.AllValidStateValidityChecker(information))
    information.setup()
    definition = base.ProblemDefinition(information)
    definition.addStartState(_state(space, challenge.start / rate))
    targets = base.GoalStates(information)
    for goal in challenge.goals:
        targets.addState(_state(space, goal / rate))
    definition.setGoal(targets)
    definition.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
    search = getattr(geometric, planner)(information)
    if hasattr(search, "setRange"):
        search.setRange(_RANGE)
    search.setProblemDefinition(definition)
    search.setup()
    search.solve(base.PlannerTerminationCondition(brake.is_used_up))
    if not definition.hasExactSolution():
        return None
    corners = np.array([state[0:n] for state in definition.getSolutionPath().getStates()]) * rate
    corners[0] = challenge.start
    corners[-1] = min(challenge.goals, key=lambda goal: float(np.max(np.abs(goal - corners[-1]))))
    # scaling has moved the corners by rounding
    clear = all(check.segment_is_clear(a, b) for a, b in itertools.pairwise(corners))
    return JointPath(corners) if clear else None


def _state(space: Any, values: Vector) -> Any:
    state = space.allocState()
    state[0 : len(values)] = values.tolist()
    return state


def _validator(base: Any, information: Any, check: MotionCheck, brake: Brake) -> Any:
    rate = check.rate
    n = len(rate)

    class Validator(base.MotionValidator):  # type: ignore[misc]
        def checkMotion(self, a: Any, b: Any) -> bool:
            if brake.is_used_up():
                return False  # some planners check many motions before they ask whether to end
            return check.segment_is_clear(np.array(a[0:n]) * rate, np.array(b[0:n]) * rate)

    return Validator(information)


# --- the same path or another ---------------------------------------------------------


def can_be_moved(check: MotionCheck, a: Matrix, b: Matrix) -> bool:
    """Whether a path (A, n) can be deformed straight into another (B, n), clear all along.

    Both are compared at equal parts of their lengths. This is sufficient for one homotopy
    class, not necessary: two paths that cannot be deformed straight may still be in one.
    """
    first, second = _resampled(a, check.rate), _resampled(b, check.rate)
    if np.max(np.abs(first[-1] - second[-1]) / check.rate) > 0.05:
        return False
    for part in np.linspace(0.0, 1.0, _STEPS + 2)[1:-1]:
        between = (1.0 - part) * first + part * second
        if not all(check.segment_is_clear(p, q) for p, q in itertools.pairwise(between)):
            return False
    return True


def _resampled(way: Matrix, rate: Vector) -> Matrix:
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0) / rate, axis=1))))
    places = np.linspace(0.0, along[-1], _POINTS)
    return np.column_stack([np.interp(places, along, column) for column in way.T])


def same_end(rate: Vector, a: Matrix, b: Matrix) -> bool:
    """Whether two paths end in the same configuration, within 0.05 s of every joint."""
    return bool(np.max(np.abs(a[-1] - b[-1]) / rate) < 0.05)
