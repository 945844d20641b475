"""Whether the goals of all legs are within reach, before any leg is planned.

The legs before an impossible one may take long to plan. A few starting points of inverse kinematics tell that a goal
is within reach; only where none of them arrives is the leg's own search asked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import BatchKinematics, TargetBatch, solve_batch, solve_inverse_kinematics
from backhoe_planner.planning.goals.goal_postures import find_goal_postures
from backhoe_planner.planning.search.effort import Work
from backhoe_planner.planning.sequence.leg import DoneLeg, Leg
from backhoe_planner.planning.sequence.leg_planning import LegPlanner
from backhoe_planner.planning.world.outcome import Outcome, at_rest
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import certify_motion

_GUESSES = 24  # starting points for a goal; chosen, a millisecond; as many as a leg's own search has at least


def first_out_of_reach(legs: Sequence[Leg], planner: LegPlanner) -> DoneLeg | None:
    """The first leg, at rest, if a later one has all of its goals out of reach: the message names that one; else None.

    Goals given by joints and legs with ready motions are left out: their ends are known.
    """
    start: Vector | None = None
    for leg in legs[1:]:
        if leg.motion is not None or any(goal.q is not None for goal in leg.problem.goals) or not leg.problem.goals:
            continue
        if _reaches_one(leg, planner.seed):
            continue
        start = _start(legs[0]) if start is None else start
        world = World(leg.problem.beginning(start), seed=planner.seed, work=Work(planner.effort, planner.brake))
        found = find_goal_postures(world, world.problem.goals, near=start, time=0.0)
        if isinstance(found, Outcome) and found.reason == "unreachable":
            words = f"not begun, because leg {leg.name!r} cannot be done: {found.message}"
            outcome = Outcome(at_rest(start), "unreachable", words, found.findings)
            return DoneLeg(legs[0].problem, outcome, certify_motion(legs[0].problem, outcome.trajectory))
    return None


def _reaches_one(leg: Leg, seed: int) -> bool:
    robot, rng = leg.problem.robot, np.random.default_rng(seed)
    guesses = np.array([robot.middle, *(robot.random_q(rng) for _ in range(_GUESSES - 1))])
    kinematics = BatchKinematics(robot)
    return any(
        solve_batch(kinematics, TargetBatch.of([goal.target] * _GUESSES), guesses)[1].any()
        for goal in leg.problem.goals
    )


def _start(leg: Leg) -> Vector:
    """(n,) where the first leg may begin [rad or m], whether that is clear or not."""
    problem = leg.problem
    if problem.start_q is not None:
        return problem.start_q
    target = problem.begin_target
    assert target is not None
    return solve_inverse_kinematics(problem.robot, target).q
