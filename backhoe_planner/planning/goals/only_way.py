"""A machine with a single joint: between two of its configurations there is only one way, or two around a turn."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.planning.goals.goal_postures import GoalPostures
from backhoe_planner.planning.result.findings import Findings
from backhoe_planner.planning.world.outcome import Outcome, at_rest
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import KEPT_WITHIN
from backhoe_planner.site import ClearanceScreen, Obstruction

_STEP = 0.01  # rad or m between the places that are looked at; chosen: what is thinner is left to the search
_TURN = 2.0 * math.pi  # rad


def blocked_way(world: World, start: Vector, found: GoalPostures, *, time: float) -> Outcome | None:
    """The failure if something at rest stands in the only way of a single joint to each posture; otherwise None.

    The joint passes every position between start and end, so one that collides is a proof. A continuous joint comes to
    a pose of the tip from either side; to a position that the scene gives, from one. Goals with a tolerance of the tip,
    which may end before the obstacle, are left to the search.

    Parameters
    ----------
    start: (1,) where the machine is [rad or m].
    found: postures on the goals.
    time: at which the positions of the obstacles are taken [s].
    """
    problem = world.problem
    if problem.robot.n != 1 or problem.is_dynamic or any(goal.tolerance is not None for goal in found.goals):
        return None
    met: list[tuple[float, Obstruction]] = []
    for end in _ends(world, start, found):
        contact = _contact(world, float(start[0]), end, time)
        if contact is None:
            return None
        met.append(contact)
    name, unit = problem.robot.joint_names[0], problem.robot.joint_units[0]
    places = dict.fromkeys(f"with {name} at {q:.2f} {unit} {contact.describe()}" for q, contact in met)
    ways = "the only way there is" if len(places) == 1 else "all ways there are"
    message = f"{ways} blocked: {'; '.join(places)}"
    return Outcome(at_rest(start), "blocked", message, Findings(obstruction=met[0][1], left_out=found.left_out))


def _ends(world: World, start: Vector, found: GoalPostures) -> Iterator[float]:
    """Where motions to the postures end [rad or m]; for one of a continuous joint, on the next turn to either side.

    A continuous joint that turns further than once passes the same places again, so it is taken to end after a turn.
    """
    begin, turns = float(start[0]), bool(np.isinf(world.problem.limits.upper[0]))
    for q, goal in zip(found.clear, found.goals, strict=True):
        if turns and goal.q is None:
            further = (float(q[0]) - begin) % _TURN
            yield from (begin + further, begin + further - _TURN)
        elif turns:
            yield begin + min(max(float(q[0]) - begin, -_TURN), _TURN)
        else:
            yield float(q[0])


def _contact(world: World, begin: float, end: float, time: float) -> tuple[float, Obstruction] | None:
    """The first place between two positions of the joint at which it collides for certain, and with what."""
    count = math.ceil(abs(end - begin) / _STEP) + 1
    places = np.linspace(begin, end, count)[:, None]
    kept = ClearanceScreen(world.proximity, time=time).keeps(places)
    for q in places[~kept]:
        contact = world.proximity.tightest(q, time=time)
        if contact is not None and contact.margin < -KEPT_WITHIN:
            return float(q[0]), contact
    return None
