"""Planning to a goal: a search for the least-cost motion, then the completed law if the search finds none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from backhoe_planner.digits import beside_bounds
from backhoe_planner.law import run_iteration
from backhoe_planner.motion import Goal
from backhoe_planner.planning.goals.allowed_time import bound_for_allowed_time
from backhoe_planner.planning.goals.goal_postures import GoalPostures, aimed, find_goal_postures
from backhoe_planner.planning.goals.only_way import blocked_way
from backhoe_planner.planning.goals.searches import Searched, search_motion
from backhoe_planner.planning.multistart.incumbent import FoundMotion
from backhoe_planner.planning.reactive.law_timing import speed_up, time_iterates
from backhoe_planner.planning.reactive.reaching import Attempt, approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.result.findings import FastMotion, Findings
from backhoe_planner.planning.result.plan_file import Reason
from backhoe_planner.planning.search.effort import Brake
from backhoe_planner.planning.world.held_load import HeldLoad
from backhoe_planner.planning.world.holding import holds_load, moves_load
from backhoe_planner.planning.world.outcome import Outcome, bad_posture
from backhoe_planner.planning.world.world import World

_STANDS_ON = 1e-6  # rad or m by which a machine that stands on a goal may be off it: the residual of inverse kinematics
_MORE = "the law alone was tried: --method auto searches for other ways as well"
_MOST_POSTURES = 8  # to which the law drives the joints, one attempt each, or ends are fixed; chosen
# times fewer steps of the law where a search along a cone of orientations has failed; chosen: such a step takes
# several ms, and a law that sees only what is near hardly finds what a search did not
_FEWER_IN_CONES = 8


@dataclass(frozen=True, eq=False)
class ToGoal:
    """The task of ending at rest on one of several goals.

    Attributes
    ----------
    goals: any of them will do.
    search_alone: whether the law is not tried if the search finds no motion.
    law_alone: whether there is no search: every motion is that of the law.

    In all methods `stepper` is the motion so far; it is not changed.
    """

    goals: tuple[Goal, ...]
    search_alone: bool = False
    law_alone: bool = False

    def from_rest(self, world: World, stepper: Stepper) -> Outcome:
        """The least-cost motion from rest that the search finds; if it finds none, a motion by the law.

        If the machine already stands on a goal it stays: nothing costs less, however near an obstacle is.
        """
        if self.law_alone:
            return self.by_law(world, stepper)
        if self._is_there(world, stepper):
            return Outcome(stepper.trajectory())
        found = find_goal_postures(world, self.goals, near=stepper.q, time=stepper.time)
        if isinstance(found, Outcome):
            return found
        if self._is_there(world, stepper):  # near enough to a goal out of reach
            return Outcome(stepper.trajectory())
        too_short = self._too_short(world, stepper)
        if too_short is not None:
            return too_short
        blocked = blocked_way(world, stepper.q, found, time=stepper.time)
        if blocked is not None:
            return replace(blocked, trajectory=stepper.trajectory())
        searched = search_motion(world, stepper.q, found, self.goals, time=stepper.time)
        searched = _ending_where_held(world, stepper, found, searched)
        searched = self._holding_the_load(world, stepper, searched)
        if searched.best is not None:
            return _searched_outcome(world, stepper, found, searched, searched.best)
        sampled = _describe_search(world, searched)
        if self.search_alone or searched.ended:
            reason: Reason = "budget" if searched.ended else "blocked"
            message = f"{searched.ended}; {sampled}" if searched.ended else sampled
            return Outcome(stepper.trajectory(), reason, message, Findings(left_out=found.left_out))
        return self._by_law_instead(world, stepper, found, sampled)

    def _by_law_instead(self, world: World, stepper: Stepper, found: GoalPostures, sampled: str) -> Outcome:
        """A motion by the law where a search has found none, for the reason `sampled`."""
        exact = self._found_exactly(world, stepper, found)
        if isinstance(exact, Outcome):  # there are postures within a tolerance, but no position that the law can aim at
            return Outcome(stepper.trajectory(), "blocked", sampled, Findings(left_out=found.left_out))
        if world.problem.keep is not None and world.problem.keep.cones:
            world.work.leave_law_steps(world.work.effort.law_steps // _FEWER_IN_CONES)
        outcome = self._attempts(world, stepper, exact)
        if not outcome.reason and not world.keeps(outcome.trajectory):
            outcome = replace(outcome, reason="blocked", message="the law arrives, but does not satisfy `keep`")
        end = world.kinematics.at(outcome.trajectory.q[-1])
        if not outcome.reason and all(goal.shortfall(end) for goal in self.goals):  # it arrives to 0.02 mrad
            words = "the law arrives, but not within the tolerance of the goal"
            outcome = replace(outcome, reason="blocked", message=words)
        if not outcome.reason:
            return outcome
        return replace(outcome, message=f"{outcome.message}; {sampled}")

    def in_motion(self, world: World, stepper: Stepper) -> Outcome | None:
        """The law's motion straight to a goal, from a motion that need not be at rest; None if it does not arrive."""
        attempt = self._straight(world, stepper, self.goals)
        motion = attempt.stepper.trajectory()
        return Outcome(motion, findings=Findings(way=attempt.way)) if attempt.arrived and world.keeps(motion) else None

    def by_law(self, world: World, stepper: Stepper) -> Outcome:
        """A motion from rest by the completed law alone."""
        found = self._found_exactly(world, stepper)
        if isinstance(found, Outcome):
            return found
        outcome = self._attempts(world, stepper, found)
        return replace(outcome, message=f"{outcome.message}; {_MORE}") if outcome.reason == "blocked" else outcome

    def by_paper(self, world: World, stepper: Stepper) -> Outcome:
        """A motion to the first goal by the paper's iteration as printed; its steps are timed afterwards."""
        target = self.goals[0].target
        steps = run_iteration(world.problem, stepper.q, target, proximity=world.proximity, kinematics=world.kinematics)
        motion = time_iterates(world.problem, steps, proximity=world.proximity)
        return Outcome(motion, findings=Findings(iterations=len(steps) - 1))

    def _holding_the_load(self, world: World, stepper: Stepper, searched: Searched) -> Searched:
        """The result of a search along whose motion the load is held, if that of `searched` needs too much torque.

        `searched` if it does not, or if no such motion is found. Within a cone no such search is made: it takes long.
        """
        best, keep = searched.best, world.problem.keep
        if best is None or searched.ended or (keep is not None and keep.cones):
            return searched
        if moves_load(world.problem, best.motion):
            return searched
        holding = world.keeping(HeldLoad.of(world.problem))
        ends = find_goal_postures(holding, self.goals, near=stepper.q, time=stepper.time)
        if isinstance(ends, Outcome):
            return searched
        again = search_motion(holding, stepper.q, ends, self.goals, time=stepper.time)
        return searched if again.best is None else again

    def _is_there(self, world: World, stepper: Stepper) -> bool:
        """Whether the machine is already on a goal, in a posture in which it may stand.

        Within a tolerance of the position is enough, and so is a millimetre for a goal without one that is known to be
        out of reach: nowhere is the tip exactly on it.
        """
        here = world.kinematics.at(stepper.q)

        def is_on(goal: Goal) -> bool:
            if goal.q is None and goal.tolerance is not None:
                return not goal.shortfall(here) and goal.search_target.distances(here)[1] <= _STANDS_ON
            if goal.aim is not None:
                return not goal.shortfall(here)
            return float(np.max(np.abs(goal.error(here)), initial=0.0)) <= _STANDS_ON

        if not any(is_on(goal) for goal in aimed(world, self.goals)):
            return False
        return bad_posture(world, stepper.q, "start", time=stepper.time) is None

    def _found_exactly(
        self, world: World, stepper: Stepper, known: GoalPostures | None = None
    ) -> GoalPostures | Outcome:
        """Postures for the law, which drives the tip to one position of each goal; the `known` ones if they will do."""
        exact = tuple(goal.exactly for goal in self.goals)
        if known is not None and exact == self.goals:
            return known
        return find_goal_postures(world, exact, near=stepper.q, time=stepper.time)

    def _too_short(self, world: World, stepper: Stepper) -> Outcome | None:
        """The failure where no motion can be as short as max_duration asks; None where one may be."""
        longest = world.problem.max_duration
        if not np.isfinite(longest):
            return None
        least = bound_for_allowed_time(world.problem, stepper.q)
        if least <= longest:
            return None
        shown, allowed = beside_bounds(least, longest)
        message = f"no motion can take less than {shown} s, max_duration allows {allowed} s"
        return Outcome(stepper.trajectory(), "outside_limits", message)

    def _straight(self, world: World, stepper: Stepper, goals: Sequence[Goal]) -> Attempt:
        """The law straight to the first of `goals` at which it arrives, otherwise the attempt that came nearest."""
        attempts = []
        for goal in aimed(world, goals):
            attempts.append(next(approach_goal(stepper, goal, (), work=world.work)))
            if attempts[-1].arrived and world.keeps(attempts[-1].stepper.trajectory()):
                return attempts[-1]
        return min(attempts, key=lambda attempt: attempt.distance)

    def _attempts(self, world: World, stepper: Stepper, found: GoalPostures) -> Outcome:
        """All attempts of the law, at one goal after the other, until one arrives and satisfies `keep`.

        If none of those that arrive satisfies it, the first of them.
        """
        attempts: list[Attempt] = []
        arrived: Attempt | None = None
        for goal, postures in found.by_goal():
            ways = approach_goal(
                stepper, goal, postures[:_MOST_POSTURES], work=world.work, all_ways=world.problem.keep is not None
            )
            for attempt in ways:
                attempts.append(attempt)
                if attempt.arrived and world.keeps(attempt.stepper.trajectory()):
                    return _sped_up(world, stepper, attempt, len(attempts)).adding(left_out=found.left_out)
                arrived = arrived or (attempt if attempt.arrived else None)
        if arrived is not None:
            return _sped_up(world, stepper, arrived, len(attempts)).adding(left_out=found.left_out)
        return describe_attempts(attempts, world.work.brake).adding(left_out=found.left_out)


def _ending_where_held(world: World, stepper: Stepper, found: GoalPostures, searched: Searched) -> Searched:
    """The result of a search whose motion ends where the machine holds its load; `searched` if there is none.

    Where a goal leaves a choice, a search ends in whatever posture of it costs least. If the load cannot be held there
    at rest, the same search follows with ends fixed at the known postures in which it can.
    """
    best = searched.best
    if best is None or searched.ended or holds_load(world.problem, best.motion.q[-1:]).all():
        return searched
    held = np.flatnonzero(holds_load(world.problem, np.array(found.clear)))[:_MOST_POSTURES].tolist()
    goals = [replace(found.goals[k], q=found.clear[k], tolerance=None, rotation_tolerance=None) for k in held]
    if not goals:
        return searched
    fixed = world.ending_at(goals)
    ends = find_goal_postures(fixed, goals, near=stepper.q, time=stepper.time)
    if isinstance(ends, Outcome):
        return searched
    again = search_motion(fixed, stepper.q, ends, goals, time=stepper.time)
    return searched if again.best is None else again


def _searched_outcome(
    world: World, stepper: Stepper, found: GoalPostures, searched: Searched, best: FoundMotion
) -> Outcome:
    """The best motion of a search, with what was found about it."""
    branch, problem = stepper.branch(attempt=stepper.attempt + 1), world.problem
    branch.play(best.motion)
    message = f"{searched.ended}; the search for a better motion was not finished" if searched.ended else ""
    allowed = searched.allowed_time
    if allowed is not None:
        allowed = min(stepper.time + allowed, problem.max_duration)
    # beside obstacles that move, or with a limit of the tip's speed, it would not be as fast
    fast = None if problem.is_dynamic or problem.tip_speed is not None else searched.fast
    findings = Findings(
        way=best.way, allowed_time=allowed, left_out=found.left_out,
        fast=None if fast is None else FastMotion(duration=fast.motion.duration, cost=fast.cost),
    )  # fmt: skip
    return Outcome(branch.trajectory(), message=message, findings=findings)


def _describe_search(world: World, searched: Searched) -> str:
    """What a search without a motion has done, and what may help, in words."""
    sampled = "no motions were sampled"
    if searched.looked_at:
        sampled = f"none of the {searched.looked_at:,} motions that were sampled leads there"
    elif searched.routes:
        lead = "route leads" if searched.routes == 1 else "routes lead"
        sampled = f"{searched.routes} sampled {lead} there, but no motion along it was proven"
    keep = world.problem.keep
    if keep is None or not keep.cones:
        return sampled
    names = " and ".join(cone.name for cone in keep.cones)
    return f"{sampled} within the {names} of `keep`: a greater tolerance, or another start or goal, may help"


def _sped_up(world: World, stepper: Stepper, attempt: Attempt, attempts: int) -> Outcome:
    """The motion of an attempt that arrived, as fast as the limits allow."""
    own = attempt.stepper.trajectory()
    faster = speed_up(stepper, attempt.stepper).trajectory()
    motion = own if world.keeps(own) and not world.keeps(faster) else faster
    return Outcome(motion, findings=Findings(attempts=attempts, way=attempt.way))


def describe_attempts(attempts: Sequence[Attempt], brake: Brake) -> Outcome:
    """The failure if none of `attempts` arrived: the nearest attempt, and what held it back, or that time ran out."""
    nearest = min(attempts, key=lambda attempt: attempt.distance)
    findings = Findings(
        attempts=len(attempts),
        way=attempts[-1].way,
        closest_distance=nearest.distance,
        obstruction=nearest.obstruction,
    )
    held = ""
    if nearest.obstruction is not None:
        held = f", where {nearest.obstruction.link} is held back by {nearest.obstruction.name}"
    which = "the only attempt" if len(attempts) == 1 else f"the closest of {len(attempts)} attempts"
    message = f"{which} came to {nearest.distance:.3f} m of the goal{held}"
    if brake.is_used_up():
        return Outcome(nearest.stepper.trajectory(), "budget", f"{brake.message}; {message}", findings)
    return Outcome(nearest.stepper.trajectory(), "blocked", message, findings)
