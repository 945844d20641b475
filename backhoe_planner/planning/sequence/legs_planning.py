"""`plan_legs`: plans legs together, with the end of each chosen with the later legs in mind."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.errors import InputError, check_kind
from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, motion_cost
from backhoe_planner.planning.reactive.stepping import Watcher
from backhoe_planner.planning.result.plan_file import Method
from backhoe_planner.planning.search.effort import EFFORTS, Brake, Effort, OutOfTime, Work
from backhoe_planner.planning.sequence.chain import Chain
from backhoe_planner.planning.sequence.going_over import go_over, rests_between
from backhoe_planner.planning.sequence.leg import DoneLeg, Leg
from backhoe_planner.planning.sequence.leg_planning import LegPlanner
from backhoe_planner.planning.sequence.next_leg import ending_where_held, ready_for_next
from backhoe_planner.planning.sequence.reach import first_out_of_reach
from backhoe_planner.planning.world.holding import holds_load
from backhoe_planner.planning.world.outcome import bad_posture
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import Certificate, LegCertificate, certify_motion, join_certificates

_CHAINS = 4  # of legs that may be planned, in addition to `Effort.ways_at_once`; chosen


@dataclass(frozen=True, eq=False)
class LegsOutcome:
    """The motion of a sequence of legs, as far as it was found.

    Attributes
    ----------
    done: every leg that was begun; only the last of them may have failed.
    trajectory: of all these legs, with the samples at which they begin.
    certificate: what is proven of the trajectory, as a whole and by leg.
    tried: how many motions with other ends of legs were planned.
    """

    done: tuple[DoneLeg, ...]
    trajectory: Trajectory
    certificate: Certificate
    tried: int = 0

    @property
    def cost(self) -> float:
        """The costs of the legs by their objectives, added up; meaningful if all have the same objective."""
        return sum(motion_cost(leg.problem, leg.motion) for leg in self.done)

    @property
    def failed(self) -> DoneLeg | None:
        """The leg that failed; None if none did."""
        return next((leg for leg in self.done if leg.failed), None)


def plan_legs(
    legs: Iterable[Leg],
    *,
    method: Method = "auto",
    seed: int = 0,
    effort: Effort = EFFORTS["normal"],
    brake: Brake | None = None,
    watch: Watcher | None = None,
    ahead: bool = True,
) -> LegsOutcome:
    """Plan legs one after the other, with the end of each chosen with the later legs in mind.

    Among obstacles that move or appear, and by the law alone, the end of each leg is chosen for that leg alone.

    Parameters
    ----------
    legs: at least one; the problem of the first one gives the start.
    method, seed, effort: of every leg, see `plan`.
    brake: ends a search that takes too long; by default there is no time limit.
    watch: called with every step while the planner works.
    ahead: whether ends are chosen with the later legs in mind.

    Raises
    ------
    InputError: there is no leg, or two have the same name.
    """
    legs = tuple(check_kind(leg, Leg, key="legs") for leg in legs)
    if not legs:
        raise InputError("a sequence has at least one leg", key="legs", found="none")
    names = [leg.name for leg in legs]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise InputError("is the name of two legs", key=f"legs[{index}]", found=name)
    moving = [index for index, leg in enumerate(legs) if leg.problem.wait is None]
    legs = tuple(_ending_exactly(leg) if index in moving[:-1] else leg for index, leg in enumerate(legs))
    planner = LegPlanner(method, seed, effort, brake or Brake(), watch)
    beyond = first_out_of_reach(legs, planner)
    if beyond is not None:
        return _outcome(legs, [beyond], 0)
    ready = ready_for_next(legs)
    ahead = ahead and len(moving) > 1 and method in ("auto", "optimal")
    ahead = ahead and not any(leg.problem.is_dynamic for leg in legs)
    rough = _rough(effort) if ahead else None
    roughly = None if rough is None else (rough, _one_by_one(legs, ready, replace(planner, effort=rough)))
    before = planner.brake.done
    # with the time used up, the same legs again would end at the first
    late = roughly is not None and planner.brake.is_used_up()
    done = roughly[1] if roughly is not None and late else _one_by_one(legs, ready, planner)
    tried = 0
    if roughly is not None and done[-1].failed and _goes_further(roughly[1], done):
        done = roughly[1]
    if ahead:
        worked = np.inf if roughly is None else planner.brake.done - before
        most = (_CHAINS + effort.ways_at_once) * len(moving)
        chain = Chain(legs, ready, done, planner, most=most, rough=roughly, worked=worked)
        # an end that was chosen may be one posture: which goals are left out is known from the legs by themselves
        known = [leg.outcome.findings.left_out for leg in done]
        done, tried = chain.run(), chain.tried
        done = [
            replace(leg, outcome=leg.outcome.adding(left_out=known[index])) if index < len(known) else leg
            for index, leg in enumerate(done)
        ]
    return _outcome(legs, _held_again(legs, ready, done, planner), tried)


def _held_again(
    legs: tuple[Leg, ...], ready: tuple[Leg, ...], done: list[DoneLeg], planner: LegPlanner
) -> list[DoneLeg]:
    """The same legs; if a payload cannot be held where its leg begins, legs that end where it can, if there are any."""
    failed = next((leg for leg in done if leg.failed), None)
    if failed is None or failed is done[0] or holds_load(failed.problem, failed.motion.q[:1]).all():
        return done
    try:
        asked = ending_where_held(legs, ready, done[0].motion.q[0], planner)
    except OutOfTime:
        return done
    if all(one is other for one, other in zip(asked, ready, strict=True)):
        return done
    again = _one_by_one(legs, asked, planner)
    return done if any(leg.failed for leg in again) else again


def _rough(effort: Effort) -> Effort | None:
    """The effort with which many chains are compared; None for the same."""
    if effort.is_hurried:
        return None
    return EFFORTS[effort.begins_with or "quick"]


def _goes_further(rough: list[DoneLeg], done: list[DoneLeg]) -> bool:
    """Whether legs that were planned with less effort are all there, or more of them than when time ran out."""
    ends = [legs[-1].outcome.reason for legs in (rough, done)]
    return not rough[-1].failed or (ends == ["budget", "budget"] and len(rough) > len(done))


def _ending_exactly(leg: Leg) -> Leg:
    """A leg whose search does not use the tolerance of its goals, which is left for going on without a stop."""
    goals = leg.problem.goals
    exact = tuple(goal.exactly for goal in goals)
    return leg if exact == goals else replace(leg, problem=replace(leg.problem, goals=exact))


def _one_by_one(legs: tuple[Leg, ...], ready: tuple[Leg, ...], planner: LegPlanner) -> list[DoneLeg]:
    """The legs planned one by one, until one fails; each to an end from `ready_for_next`, if it can."""
    done: list[DoneLeg] = []
    time, stops = 0.0, any(leg.problem.is_dynamic for leg in legs)
    for leg, asked in zip(legs, ready, strict=True):
        found = _next(leg, asked, done, planner, time)
        rests = SAMPLE_PERIOD * rests_between(done[-1], found) if stops and done and not found.failed else 0.0
        if rests > 0.0:
            rested = _next(leg, asked, done, planner, time + rests)
            found, time = (found, time) if rested.failed else (rested, time + rests)
        done.append(found)
        time += found.motion.duration
        if found.failed:
            break
    if done[-1].failed:
        later = [words for leg in legs[len(done) :] if (words := _impossible(leg, done[-1].motion.q[-1], planner))]
        outcome = done[-1].outcome
        done[-1] = replace(
            done[-1], outcome=replace(outcome, message="; ".join(filter(None, (outcome.message, *later))))
        )
    return done


def _next(leg: Leg, asked: Leg, done: Sequence[DoneLeg], planner: LegPlanner, time: float) -> DoneLeg:
    """One more leg, begun at `time` [s] where the last one ended; to an end from `ready_for_next`, if it can."""
    start = done[-1].motion.q[-1] if done else None
    found = None if asked is leg else planner.plan(leg, start, time=time, asked=asked)
    return planner.plan(leg, start, time=time) if found is None or found.failed else found


def _impossible(leg: Leg, near: Vector, planner: LegPlanner) -> str:
    """Why no motion can end where a leg does, with the joints `near` (n,) before it; empty if one may, or if unknown.

    The leg that fails first is not always the wrong one, so the ends of later legs are checked without planning.
    """
    problem = leg.problem
    if problem.is_dynamic or not problem.goals or any(goal.q is None for goal in problem.goals):
        return ""
    world = World(problem.beginning(near), seed=planner.seed, work=Work(planner.effort, planner.brake))
    found = [bad_posture(world, goal.q, goal.name) for goal in problem.goals if goal.q is not None]
    if any(outcome is None for outcome in found):
        return ""
    return f"leg {leg.name!r} cannot be done either: {'; '.join(outcome.message for outcome in found if outcome)}"


def _outcome(legs: tuple[Leg, ...], done: list[DoneLeg], tried: int) -> LegsOutcome:
    motion = go_over(done)
    ends = (*motion.begins[1:], len(motion) - 1)
    certificates = [
        LegCertificate(
            leg.problem.name,
            first,
            last,
            float(motion.time[first]),
            certify_motion(_begun(leg, index, motion, first), motion.part(first, last)),
        )
        for index, (leg, first, last) in enumerate(zip(done, motion.begins, ends, strict=True))
    ]
    missing = [leg.name for leg in legs[len(done) :]]
    return LegsOutcome(tuple(done), motion, join_certificates(certificates, missing=missing), tried)


def _begun(leg: DoneLeg, index: int, motion: Trajectory, first: int) -> Problem:
    """A leg's problem with the configuration and the time at which its part of the motion begins."""
    if index == 0 and leg.problem.wait is None:
        return leg.problem
    return replace(leg.problem.beginning(motion.q[first]), begins=float(motion.time[first]))
