"""Planning to a goal: the completed law first, then sampling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from backhoe_planner.arrays import Vector
from backhoe_planner.law import run_iteration
from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import drive_of, retime, time_polyline
from backhoe_planner.planning.outcome import Outcome, no_posture
from backhoe_planner.planning.reactive.law_timing import shortest_time, speed_up
from backhoe_planner.planning.reactive.reaching import Attempt, approach_goal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.result.findings import Findings
from backhoe_planner.planning.search.effort import Brake, OutOfTime
from backhoe_planner.planning.search.postures import PostureResult
from backhoe_planner.planning.transit import find_transit
from backhoe_planner.planning.world import World

_LONG_SEARCH = 8  # times the usual starting points, before a goal is said to be in collision; chosen
_MOST_POSTURES = 8  # that the law is sent to, one attempt each; chosen


@dataclass(frozen=True, eq=False)
class ToGoal:
    """The task of bringing the tip to a goal, at rest there.

    In all methods `stepper` is the motion so far; it stays as it is.
    """

    goal: TipTarget

    def from_rest(self, world: World, stepper: Stepper) -> Outcome:
        """From rest by the law straight to the goal, else by a sampled way, else by the other ways of the law."""
        found = self._postures(world, stepper)
        if isinstance(found, Outcome):
            return found
        straight = next(approach_goal(stepper, self.goal, (), work=world.work))
        try:
            if straight.arrived:
                return _faster_way(world, stepper, straight, found)
            transit = find_transit(world, stepper, found.clear)
        except OutOfTime as ended:
            if straight.arrived:
                motion, findings = straight.stepper.trajectory(), Findings(way=straight.way)
                return Outcome(motion, message=f"{ended}; a faster motion was not looked for", findings=findings)
            return describe_attempts([straight], world.work.brake)
        if isinstance(transit, Stepper):
            return Outcome(transit.trajectory(), findings=Findings(way="sampled"))
        outcome = self._attempts(world, stepper, found.clear)
        return replace(outcome, message=f"{outcome.message}; {transit}") if outcome.reason else outcome

    def in_motion(self, world: World, stepper: Stepper) -> Outcome | None:
        """By the law straight to the goal, from a motion that need not be at rest; None where it does not arrive."""
        attempt = next(approach_goal(stepper, self.goal, (), work=world.work))
        return Outcome(attempt.stepper.trajectory(), findings=Findings(way=attempt.way)) if attempt.arrived else None

    def by_law(self, world: World, stepper: Stepper) -> Outcome:
        """From rest by the completed law alone."""
        found = self._postures(world, stepper)
        return found if isinstance(found, Outcome) else self._attempts(world, stepper, found.clear)

    def by_paper(self, world: World, stepper: Stepper) -> Outcome:
        """By the paper's iteration as it is printed; its steps are timed afterwards."""
        steps = run_iteration(
            world.problem, stepper.q, self.goal, proximity=world.proximity, kinematics=world.kinematics
        )
        return Outcome(time_polyline(steps, world.problem.limits), findings=Findings(iterations=len(steps) - 1))

    def _postures(self, world: World, stepper: Stepper) -> PostureResult | Outcome:
        """Clear configurations on the goal; or why there is none."""
        count = world.work.effort.starting_points
        found = world.postures.at(self.goal, near=stepper.q, count=count, time=stepper.time)
        if found.best.reached and not found.clear:
            found = world.postures.at(self.goal, near=stepper.q, count=_LONG_SEARCH * count, time=stepper.time)
        return no_posture(world, found, self.goal, "goal_in_collision", "goal") or found

    def _attempts(self, world: World, stepper: Stepper, postures: Sequence[Vector]) -> Outcome:
        """All ways of the law, with `postures` (n,) on the goal, the preferred one first."""
        attempts = list(approach_goal(stepper, self.goal, postures[:_MOST_POSTURES], work=world.work))
        if not attempts[-1].arrived:
            return describe_attempts(attempts, world.work.brake)
        arrived = speed_up(stepper, attempts[-1].stepper)
        return Outcome(arrived.trajectory(), findings=Findings(attempts=len(attempts), way=attempts[-1].way))


def _faster_way(world: World, stepper: Stepper, straight: Attempt, found: PostureResult) -> Outcome:
    """The tip's straight way, or the joints' straight way where that is clear and faster."""
    limits, drive = world.problem.limits, drive_of(world.problem)
    direct = find_transit(world, stepper, found.clear, straight=True)
    joints = direct.trajectory() if isinstance(direct, Stepper) else None
    way = straight.stepper.trajectory()
    least = shortest_time(way.q[way.time >= stepper.time - 1e-9], limits)
    if joints is None or joints.duration - stepper.time > least:
        motion = speed_up(stepper, straight.stepper).trajectory()
        # the law runs the joints at rates that all of them together may not have
        if joints is None or joints.duration >= retime(motion, limits, drive=drive).duration:
            return Outcome(motion, findings=Findings(way=straight.way))
    return Outcome(joints, findings=Findings(way="straight for the joints"))


def describe_attempts(attempts: Sequence[Attempt], brake: Brake) -> Outcome:
    """The attempt that came nearest, and what held it back or that time ran out; none of `attempts` arrived."""
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
    message = f"of {len(attempts)} attempts the closest came to {nearest.distance:.3f} m of the goal{held}"
    if brake.is_used_up():
        return Outcome(nearest.stepper.trajectory(), "budget", f"{brake.message}; {message}", findings)
    return Outcome(nearest.stepper.trajectory(), "blocked", message, findings)
