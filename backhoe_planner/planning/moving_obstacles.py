"""Planning among obstacles that move, and among obstacles that are unknown until they appear.

Moving obstacles: the plan waits until they have passed, keeps out of all the space that
they will occupy, gives way, or goes to where they will not pass. Each of these is planned
as a motion among static obstacles, and used if it is proven clear of the obstacles as
they move.

Obstacles that appear: up to that moment the motion stays as planned, and from there on it
is planned anew. First the plan tries to swerve without stopping (the completed law), then
to brake along the planned motion and go on from rest. If both work, the shorter is used.
Whatever is chosen, obstacles that appear later have no part in it.

All motions keep the limits of drive and tip speed before they are compared with what
moves and appears: a motion that is slowed afterwards is elsewhere when an obstacle appears.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from backhoe_planner.motion import (
    DRIVE_TOLERANCE,
    SAMPLE_PERIOD,
    Trajectory,
    append_motion,
    brake_along,
    drive_of,
    slowed_to_drive,
)
from backhoe_planner.planning.goals.goal_planning import ToGoal
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.result.findings import Findings, Reaction
from backhoe_planner.planning.transit import find_transit
from backhoe_planner.planning.world.outcome import Outcome
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import JOINTS_WITHIN, STEP_ROUNDING, motion_is_clear, segment_is_clear
from backhoe_planner.site import Obstacle, Obstruction, Proximity, sweep

if TYPE_CHECKING:
    from backhoe_planner.planning.path_planning import AlongPath

_BEYOND = "gave way with more than its drive can do, and planned anew"

_Reply = tuple[Outcome, str, float | None]  # the motion, how it goes on in words, and when the machine is at rest [s]

_WAITS = (0.5, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 17.0, 22.0, 30.0)  # s, tried in turn; chosen
_HORIZONS = (3.0, 6.0, 15.0)  # s ahead for which the space of moving obstacles is kept free, in turn; chosen
_SOON = (0.5, 1.5)  # s: shorter horizons, for a route to a refuge; chosen
_REFUGES = 150  # random postures that may be refuges; chosen
_ROOM = 0.02  # m of margin in a refuge; chosen
_RATES = (1.0, 0.7, 0.5, 0.25, 0.1)  # parts of the velocities that a reaction may use, in turn; chosen
_ROUNDING = 1e-6  # part of a duration
_HALVINGS = 4  # of the time between a wait that is too short and one that is not; chosen


def plan_over_time(
    world: World, task: ToGoal | AlongPath, stepper: Stepper, *, known: Outcome | None = None
) -> Outcome:
    """A motion from `stepper`, which is at rest, among all obstacles.

    If none of them moves or appears, it is that of `task.from_rest`.

    Parameters
    ----------
    known: a motion of the task from there among the obstacles as they are at the beginning; it is used where none of
        these moves.
    """
    if not world.problem.is_dynamic:
        return task.from_rest(world, stepper)
    return _OverTime(world, task).plan(stepper, known)


class _OverTime:
    """One task among obstacles that move or appear."""

    def __init__(self, world: World, task: ToGoal | AlongPath) -> None:
        self._world = world
        self._task = task
        self._limits = world.problem.limits
        self._drive = drive_of(world.problem)

    def plan(self, stepper: Stepper, begun: Outcome | None) -> Outcome:
        """A motion from `stepper`, which is at rest, that reacts to every obstacle that appears meanwhile.

        begun: as for `plan_over_time`.
        """
        reactions: list[Reaction] = []
        known_until = stepper.time
        known = self._known(known_until)
        if begun is not None and not any(obstacle.moves for obstacle in known.proximity.obstacles):
            outcome = self._driven(begun, stepper.time)
        else:
            outcome = self._from_rest_among(known, stepper)
        in_time = sorted(self._world.problem.obstacles, key=lambda obstacle: obstacle.appears_at)
        for moment, together in itertools.groupby(in_time, key=lambda obstacle: obstacle.appears_at):
            motion, sudden = outcome.trajectory, tuple(together)
            if not known_until < moment <= motion.duration:
                continue  # afterwards the machine is at rest: at the end, or stopped by another obstacle
            known_until = moment
            if _is_clear(self._world.among(sudden).proximity, motion, moment):
                continue
            waited = min(outcome.findings.waits, _time_at_rest(motion, moment))
            outcome, way, stopped_at = self._react(self._known(moment), motion, moment)
            outcome = outcome.adding(waits=waited + outcome.findings.waits)
            name = self._in_the_way(sudden, motion, moment, outcome.findings.obstruction)
            reactions.append(Reaction(obstacle=name, appears_at=moment, way=way, stopped_at=stopped_at))
            if not outcome.reason and way == _BEYOND:
                outcome = replace(outcome, message=reactions[-1].later(self._world.problem.begins).words)
            elif outcome.reason:
                told = _describe(reactions[-1].later(self._world.problem.begins))
                outcome = replace(outcome, message=f"{told}, and {outcome.message}")
            if not way:
                break
        return outcome.adding(reactions=tuple(reactions))

    def _known(self, moment: float) -> World:
        """The world with the obstacles that have appeared by `moment` [s]."""
        return self._world.among([o for o in self._world.problem.obstacles if o.appears_at <= moment])

    def _in_the_way(
        self, sudden: Sequence[Obstacle], motion: Trajectory, moment: float, found: Obstruction | None
    ) -> str:
        """The name of the obstacle in the way of those that appear at `moment` [s]; `found`, if it is one of them."""
        if len(sudden) == 1:
            return sudden[0].name
        if found is not None and any(obstacle.name == found.name for obstacle in sudden):
            return found.name
        met = (o.name for o in sudden if not _is_clear(self._world.among([o]).proximity, motion, moment))
        return next(met, sudden[0].name)

    def _driven(self, outcome: Outcome, since: float) -> Outcome:
        """The outcome with its motion, at rest at `since` [s], slowed from then on to the drive and the tip's speed."""
        motion = outcome.trajectory
        if outcome.reason or motion.duration <= since:
            return outcome
        row = int(np.searchsorted(motion.time, since - 1e-9))
        after = replace(motion.part(row, len(motion) - 1), before=None)
        slower = slowed_to_drive(self._world.problem, after)
        if slower is after:
            return outcome
        return replace(outcome, trajectory=slower if row == 0 else append_motion(motion.part(0, row), slower))

    def _is_driven(self, motion: Trajectory) -> bool:
        """Whether a motion keeps the drive and the tip's speed as it is."""
        return slowed_to_drive(self._world.problem, motion).duration <= motion.duration * (1.0 + _ROUNDING)

    # --- moving obstacles -----------------------------------------------------------

    def _from_rest_among(self, known: World, stepper: Stepper) -> Outcome:
        """A motion from the end of `stepper`, at rest, among the obstacles of `known`, as they move."""
        obstacles = known.proximity.obstacles
        stepper = stepper.branch(attempt=stepper.attempt, proximity=known.proximity)
        still = known.among([_from_the_beginning(obstacle) for obstacle in obstacles if not obstacle.moves])
        moving = [obstacle.name for obstacle in obstacles if obstacle.moves]
        if not moving:
            return self._driven(self._task.from_rest(still, stepper), stepper.time)
        if isinstance(self._task, ToGoal) and self._task.law_alone:
            return self._task.from_rest(known, stepper)  # the law sees what moves, step by step
        first: Outcome | None = None
        late: Outcome | None = None  # clear, but longer than is allowed
        longest = known.problem.max_duration * (1.0 + JOINTS_WITHIN)
        for found in self._motions(stepper, known, still):
            outcome = self._driven(found, stepper.time)
            if outcome.reason in ("budget", "outside_limits"):  # neither depends on what moves
                return outcome
            first = first or outcome
            clear = not outcome.reason and _is_clear(known.proximity, outcome.trajectory, stepper.time)
            if clear and known.keeps(outcome.trajectory):
                # other motions avoid more space than the obstacles occupy, which may cover a goal
                best = outcome.adding(left_out=first.findings.left_out)
                best = replace(best, evades=outcome is not first)
                if best.trajectory.duration <= longest:
                    return best
                late = late or best
        if late is not None:
            return late
        assert first is not None
        if first.reason:
            return first
        tried = first.trajectory
        spots = [known.proximity.tightest(q, time=t) for q, t in zip(tried.q, tried.time.tolist(), strict=True)]
        tightest = min((spot for spot in spots if spot is not None), key=lambda spot: spot.margin, default=None)
        held = known.stepper(stepper.q)
        held.replay(stepper.trajectory(), stepper.time)
        kept = "" if known.problem.keep is None else " and satisfies `keep` on the whole way"
        message = f"no motion was found that keeps clear of moving obstacles ({moving[0]}){kept}"
        findings = Findings(obstruction=tightest, left_out=first.findings.left_out)
        return Outcome(held.trajectory(), "blocked", message, findings)

    def _motions(self, stepper: Stepper, known: World, still: World) -> Iterator[Outcome]:
        """Motions that may be clear of the moving obstacles, the simplest first."""
        task = self._task
        direct = self._driven(task.from_rest(still, stepper.branch(attempt=1)), stepper.time)
        yield direct
        swerved = self._from_rest_by_law(known, stepper)
        waited = None if direct.reason else _wait(known.proximity, direct, stepper)
        both = [outcome for outcome in (swerved, waited) if outcome is not None]
        yield from sorted(both, key=lambda outcome: outcome.trajectory.duration)
        for horizon in _HORIZONS:
            yield task.from_rest(_swept_world(known, stepper.time, horizon), stepper.branch(attempt=3))
        for wait in _WAITS[1::3]:
            aside = stepper.branch(attempt=4)
            if aside.give_way(stepper.time + wait):
                yield task.from_rest(still, aside)
        for refuge in _refuges(known, stepper):
            onward = self._driven(task.from_rest(still, refuge.branch(attempt=refuge.attempt)), stepper.time)
            yield _aside(known, stepper, onward)
            later = None if onward.reason else _wait(known.proximity, onward, refuge)
            if later is None:
                refuge.rest(stepper.time + _HORIZONS[-1])
                later = task.from_rest(still, refuge)
            yield _aside(known, stepper, later)

    def _from_rest_by_law(self, known: World, stepper: Stepper) -> Outcome | None:
        """The law's motion from the end of `stepper`, at rest, among obstacles as they move; None if there is none."""
        found = self._task.in_motion(known, stepper.branch(attempt=2))
        if found is None or self._is_driven(found.trajectory):
            return found
        slower = self._swerve(known, stepper.trajectory(), stepper.time)
        return slower or self._driven(found, stepper.time)

    # --- appearing obstacles --------------------------------------------------------

    def _react(self, known: World, motion: Trajectory, moment: float) -> _Reply:
        """`motion` up to `moment` [s], then a motion that is clear of the obstacle that appears at that time."""
        motion = _with_sample_behind(motion, moment)
        # the motion reacts at the next sample, where it can change without a shorter step
        moment = float(motion.time[np.searchsorted(motion.time, moment - 1e-9)])
        tightest = known.proximity.tightest(motion.at(moment), time=moment)
        if tightest is not None and tightest.margin < 0.0:
            return self._halt(motion, moment, f"{tightest.describe()} from the first moment on", tightest)
        swerved = self._swerve(known, motion, moment)
        again, way, stopped_at = self._stop_and_plan(known, motion, moment)
        if swerved is not None and (again.reason or swerved.trajectory.duration <= again.trajectory.duration):
            return swerved, "swerved", None
        return again, way, stopped_at

    def _swerve(self, known: World, motion: Trajectory, moment: float) -> Outcome | None:
        """`motion` up to `moment` [s], then the law's motion that does not stop; None if there is none."""
        for stepper in self._in_motion(known, motion, moment):
            swerved = self._task.in_motion(known, stepper)
            if swerved is None or not _is_clear(known.proximity, swerved.trajectory, moment):
                return None
            if self._is_driven(swerved.trajectory):
                return swerved
        return None

    def _in_motion(self, known: World, motion: Trajectory, moment: float) -> Iterator[Stepper]:
        """The machine in `motion` at `moment` [s]; then the same with slower joints, which need less flow and power."""
        speeds = motion.segment_velocities()
        row = int(np.searchsorted(motion.time, moment - 1e-9))
        speed = np.abs(speeds[row - 1]) if row else np.zeros(motion.q.shape[1])
        for rate in _RATES if self._drive.limited else _RATES[:1]:
            world = known if rate == 1.0 else known.slower(np.maximum(speed, rate * self._limits.velocity))
            stepper = world.stepper(motion.q[0])
            stepper.replay(motion, moment)
            yield stepper

    def _stop_and_plan(self, known: World, motion: Trajectory, moment: float) -> _Reply:
        """`motion` up to `moment` [s], then braking to rest, and a new motion from there."""
        stopped, is_driven = self._stop(known, motion, moment)
        if stopped is None:
            kept = "" if known.problem.keep is None else " or violates `keep`"
            return self._halt(motion, moment, f"comes too near to it{kept} even while it brakes")
        outcome = self._from_rest_among(known, stopped)
        moves = any(obstacle.moves for obstacle in known.proximity.obstacles)
        if outcome.reason == "blocked" and moves and not known.problem.objective.is_time:
            fastest = self._from_rest_among(known.for_time(known.work.effort), stopped)
            outcome = outcome if fastest.reason else fastest
        if outcome.reason and outcome.trajectory.duration < stopped.time:
            outcome = replace(outcome, trajectory=stopped.trajectory())
        way = "stopped and planned anew" if is_driven else _BEYOND
        return self._rested(known, outcome, stopped.time), way, stopped.time

    def _rested(self, known: World, outcome: Outcome, stopped_at: float) -> Outcome:
        """The outcome, with a rest of one period at `stopped_at` [s] if it goes on there too soon for its joints."""
        motion = outcome.trajectory
        row = int(np.searchsorted(motion.time, stopped_at - 1e-9))
        if outcome.reason or not 0 < row < len(motion) - 1:
            return outcome
        change = motion.corner_accelerations()[row]
        use = float(np.max(np.abs(change) / self._limits.acceleration)) - JOINTS_WITHIN
        if self._drive.limited:
            driven = self._drive.ratios(motion.q[row : row + 1], motion.v[row : row + 1], change[None])
            use = max(use, float(np.max(driven)) - DRIVE_TOLERANCE)
        rested = _delay(motion, stopped_at, SAMPLE_PERIOD)
        if use <= 1.0 or not _is_clear(known.proximity, rested, stopped_at):
            return outcome
        return replace(outcome, trajectory=rested)

    def _stop(self, known: World, motion: Trajectory, moment: float) -> tuple[Stepper | None, bool]:
        """`motion` up to `moment` [s], then braking to rest; None if no way to brake is clear. And if the drive can."""
        braked = brake_along(motion, moment, self._limits, drive=self._drive)
        if braked is not None and _is_clear(known.proximity, braked, moment) and known.keeps(braked):
            stopped = known.stepper(motion.q[0])
            stopped.replay(braked, braked.duration)
            stopped.v = np.zeros_like(stopped.q)
            return stopped, True
        clear: Stepper | None = None
        for stepper in self._in_motion(known, motion, moment):
            if stepper.give_way(moment):
                if self._is_driven(stepper.trajectory()):
                    return stepper, True
                clear = clear or stepper
        if clear is None:
            return None, True
        return clear, self._drive.use_along(clear.trajectory().moments()).most <= 1.0 + DRIVE_TOLERANCE

    def _halt(self, motion: Trajectory, moment: float, why: str, obstruction: Obstruction | None = None) -> _Reply:
        """`motion` up to `moment` [s], then braking to rest along it, clear or not."""
        halted = brake_along(motion, moment, self._limits, drive=self._drive) or motion
        return Outcome(halted, "blocked", why, Findings(obstruction=obstruction)), "", halted.duration


def _describe(reaction: Reaction) -> str:
    stopped = "it cannot stop"
    if reaction.stopped_at is not None:
        stopped = f"the machine stops at {reaction.stopped_at:.2f} s"
    return f"{reaction.obstacle} appears at {reaction.appears_at:.2f} s in the way: {stopped}"


def _wait(known: Proximity, direct: Outcome, stepper: Stepper) -> Outcome | None:
    """`direct` after the shortest wait at the end of `stepper` that makes it clear; None if no wait does."""

    def clear(wait: float) -> bool:
        return _is_clear(known, _delay(direct.trajectory, stepper.time, wait), stepper.time)

    before = 0.0
    for wait in _WAITS:
        if not segment_is_clear(
            known, stepper.q, stepper.q, time=stepper.time, dt=wait, depth=12, spare=-STEP_ROUNDING
        ):
            return None
        if clear(wait):
            break
        before = wait
    else:
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + wait)
        before, wait = (before, middle) if clear(middle) else (middle, wait)
    motion = _delay(direct.trajectory, stepper.time, wait)
    allowed = direct.findings.allowed_time
    return replace(direct, trajectory=motion).adding(
        waits=wait, allowed_time=None if allowed is None else allowed + wait
    )


def _swept_world(known: World, since: float, horizon: float) -> World:
    """The world with static obstacles, and with all the space that moving ones occupy for `horizon` [s]."""
    obstacles = known.proximity.obstacles
    return known.among([sweep(o, since, since + horizon) if o.moves else _from_the_beginning(o) for o in obstacles])


def _refuges(known: World, stepper: Stepper) -> Iterator[Stepper]:
    """Motions to rest where no moving obstacle will pass."""
    robot, limits, keep = known.problem.robot, known.problem.limits, known.problem.keep
    around = stepper.q + np.pi * np.array([[-1.0], [1.0]])  # half a turn either way, for continuous joints
    lower, upper = np.where(np.isinf(limits.lower), around, np.array([limits.lower, limits.upper]))
    rng = np.random.default_rng(known.seed)
    passed = _swept_world(known, stepper.time, _HORIZONS[-1]).proximity
    clear = []
    for spread in np.linspace(0.1, 1.0, _REFUGES):
        sampled = stepper.q + spread * (robot.random_q(rng) - stepper.q)
        q = sampled if keep is None else keep.project(sampled, lower, upper)
        if q is None:
            continue
        tightest = passed.tightest(q)
        if tightest is None or tightest.margin > _ROOM:
            clear.append(q)
    if not clear:
        return
    for horizon in (*_SOON, *_HORIZONS[:-1]):
        transit = find_transit(_swept_world(known, stepper.time, horizon), stepper, clear)
        if isinstance(transit, Stepper) and _is_clear(known.proximity, transit.trajectory(), stepper.time):
            yield transit


def _aside(known: World, stepper: Stepper, outcome: Outcome) -> Outcome:
    """The outcome by way of a refuge, whose first detour from a path is for what moves past the end of `stepper`."""
    detours = outcome.findings.detours
    if not detours:
        return outcome
    passing = _swept_world(known, stepper.time, _HORIZONS[-1]).proximity.tightest(stepper.q)
    if passing is None:
        return outcome
    first = replace(passing, time=stepper.time, path_from=detours[0].path_from, path_to=detours[0].path_to)
    return outcome.adding(detours=(first, *detours[1:]))


def _delay(motion: Trajectory, since: float, wait: float) -> Trajectory:
    """The same motion with a rest of `wait` [s] more at the time `since` [s], at which it is at rest."""
    split = int(np.searchsorted(motion.time, since - 1e-9))
    time = np.concatenate((motion.time[: split + 1], motion.time[split:] + wait))
    return Trajectory.from_steps(time, np.vstack((motion.q[: split + 1], motion.q[split:])))


def _time_at_rest(motion: Trajectory, until: float) -> float:
    """How long all joints stand still up to `until` [s]."""
    ends = np.minimum(motion.time, until)
    return float(np.sum(np.diff(ends)[np.all(motion.q[1:] == motion.q[:-1], axis=1)]))


def _with_sample_behind(motion: Trajectory, moment: float) -> Trajectory:
    """The same motion with a sample soon behind `moment` [s]: while the machine waits there may be none for long.

    It is a usual step behind the sample before it, and before the next one.
    """
    row = int(np.searchsorted(motion.time, moment - 1e-9))
    at = max(moment, float(motion.time[max(row - 1, 0)]) + SAMPLE_PERIOD)
    if at > motion.time[row] - SAMPLE_PERIOD:
        return motion
    return Trajectory.from_steps(np.insert(motion.time, row, at), np.insert(motion.q, row, motion.at(at), axis=0))


def _from_the_beginning(obstacle: Obstacle) -> Obstacle:
    """The same obstacle, there from the beginning."""
    return replace(obstacle, appears_at=0.0)


def _is_clear(proximity: Proximity, motion: Trajectory, since: float) -> bool:
    """Whether a motion is proven clear from `since` [s] on."""
    time = np.append(since, motion.time[motion.time > since + 1e-9])
    return motion_is_clear(proximity, time, motion.at(time))
