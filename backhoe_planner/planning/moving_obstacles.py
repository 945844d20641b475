"""What moves, and what nobody knew of: planning made good while it is carried out.

A way is searched in a world that stands still. What is known and moves is met by time:
the machine waits until it has passed, or keeps out of all the space that it will take
up, or gives way to it. What appears is unknown before: the motion up to that moment is
made as it was planned, and what follows is planned anew from the state the machine then
has. First it is tried to swerve without stopping (the completed law), then the machine
brakes along its way and plans from rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.motion import SAMPLE_PERIOD, Problem, Trajectory, drive_of, retimed
from backhoe_planner.planning.context import Context
from backhoe_planner.planning.outcome import Outcome
from backhoe_planner.planning.reactive.stepping import Stepper
from backhoe_planner.planning.transit import find_transit
from backhoe_planner.proof import segment_is_clear
from backhoe_planner.site import Obstacle, Proximity, swept

__all__ = ["Planned", "changes", "plan_over_time"]

Vector = NDArray[np.float64]

PlanOnce = Callable[[Context, Stepper], Outcome]
Swerve = Callable[[Context, Stepper], Outcome | None]

_WAITS = (0.5, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.0, 13.0, 17.0, 22.0, 30.0)  # s
_HORIZONS = (3.0, 6.0, 15.0)  # s ahead for which the space of what moves is kept free
_SOON = (0.5, 1.5)  # s, where there is a refuge to get to
_REFUGES = 150  # postures that are looked at
_ROOM = 0.02  # m of margin in a refuge
_HALVINGS = 4  # of the time between a wait that is too short and one that is not
_SLOWEST_BRAKING = 0.05  # 1/s^2
_TOUCH = 2e-5  # m


@dataclass(frozen=True)
class Planned:
    """What is asked for, as this module needs it.

    Attributes
    ----------
    once: a motion from rest, in a world that stands still.
    swerve: a motion from any state among what moves, or None where it does not arrive.
    """

    once: PlanOnce
    swerve: Swerve


def plan_over_time(context: Context, asked: Planned, stepper: Stepper) -> Outcome:
    """A motion from `stepper`, which is at rest, among all that stands, moves, and appears.

    Where no obstacle appears or moves it is what `asked.once` gives.
    """
    if not changes(context.problem):
        return asked.once(context, stepper)
    obstacles = context.problem.obstacles
    reactions: list[dict[str, Any]] = []
    outcome = _among_known(context, asked, stepper)
    known_until = stepper.time
    for obstacle in sorted(obstacles, key=lambda obstacle: obstacle.appears_at):
        moment = obstacle.appears_at
        if moment <= known_until:
            continue
        motion = outcome.trajectory
        if moment >= motion.duration and outcome.reason == "":
            break
        if moment >= motion.duration:
            continue  # it stands by then; what stopped it was something else
        known = _known(context, moment)
        if _is_clear(context, known, motion, moment):
            known_until = moment
            continue
        known_until = moment
        reaction = {"obstacle": obstacle.name, "appears_at": moment}
        outcome, what = _react(context, asked, motion, moment)
        reactions.append(reaction | what)
        if outcome.reason:
            outcome = replace(outcome, message=_told(reactions[-1], outcome.message))
            break
    details = dict(outcome.details) | ({"reactions": reactions} if reactions else {})
    return replace(outcome, details=details)


def changes(problem: Problem) -> bool:
    """Whether any obstacle moves or appears."""
    return any(obstacle.moves or obstacle.appears_at > 0.0 for obstacle in problem.obstacles)


def _told(reaction: dict[str, Any], message: str) -> str:
    stopped = f"the machine stops at {reaction['stopped_at']:.2f} s" if "stopped_at" in reaction else "it cannot stop"
    return f"{reaction['obstacle']} appears at {reaction['appears_at']:.2f} s in the way: {stopped}, and {message}"


# --- what moves ---------------------------------------------------------------------


def _among_known(context: Context, asked: Planned, stepper: Stepper) -> Outcome:
    """From rest among the obstacles that are known at that moment, all of them in motion as they are."""
    known = _known(context, stepper.time)
    context = context.knowing(known)
    stepper = stepper.branch(attempt=stepper.attempt, proximity=context.proximity)
    still = [_standing(obstacle) for obstacle in known if not obstacle.moves]
    if len(still) == len(known):
        return asked.once(context.in_world(still), stepper)
    first: Outcome | None = None
    for outcome in _ways(context, asked, stepper, known, still):
        if not outcome.reason and _is_clear(context, known, outcome.trajectory, stepper.time):
            return outcome
        first = first or outcome
    assert first is not None
    if first.reason:
        return first
    moving = next(obstacle.name for obstacle in known if obstacle.moves)
    held = context.stepper(stepper.q)
    held.replay(stepper.trajectory(), stepper.time)
    message = f"no motion was found that keeps clear of what moves ({moving})"
    return Outcome(held.trajectory(), "blocked", message, {"obstacle": moving})


def _ways(
    context: Context, asked: Planned, stepper: Stepper, known: list[Obstacle], still: list[Obstacle]
) -> Iterator[Outcome]:
    """Motions that may be clear of what moves, the simplest first."""
    direct = asked.once(context.in_world(still), stepper.branch(attempt=1))
    yield direct
    swerved = asked.swerve(context, stepper.branch(attempt=2))
    waited = None if direct.reason else _waited(context, direct, stepper, known)
    both = [outcome for outcome in (swerved, waited) if outcome is not None]
    yield from sorted(both, key=lambda outcome: outcome.trajectory.duration)
    for horizon in _HORIZONS:
        world = _swept_world(known, stepper.time, horizon)
        yield asked.once(context.in_world(world), stepper.branch(attempt=3))
    for wait in _WAITS[1::3]:
        aside = stepper.branch(attempt=4)
        if aside.give_way(stepper.time + wait):
            yield asked.once(context.in_world(still), aside)
    for refuge in _refuges(context, stepper, known):
        yield asked.once(context.in_world(still), refuge)


def _waited(context: Context, direct: Outcome, stepper: Stepper, known: list[Obstacle]) -> Outcome | None:
    """The same motion after the shortest wait that is found to be clear, None where none is."""

    def clear(wait: float) -> bool:
        return _is_clear(context, known, _delayed(direct.trajectory, stepper.time, wait), stepper.time)

    before = 0.0
    for wait in _WAITS:
        if not _stands_clear(context, known, stepper, wait):
            return None
        if clear(wait):
            break
        before = wait
    else:
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (before + wait)
        before, wait = (before, middle) if clear(middle) else (middle, wait)
    motion = _delayed(direct.trajectory, stepper.time, wait)
    return replace(direct, trajectory=motion, details=dict(direct.details) | {"waits": wait})


def _swept_world(known: list[Obstacle], since: float, horizon: float) -> list[Obstacle]:
    """What stands, and all the space that what moves takes up for a time [s]."""
    return [swept(o, since, since + horizon) if o.moves else _standing(o) for o in known]


def _refuges(context: Context, stepper: Stepper, known: list[Obstacle]) -> Iterator[Stepper]:
    """Motions to where nothing will pass, at rest there until everything has."""
    robot = context.problem.robot
    rng = np.random.default_rng(context.seed)
    passed = context.in_world(_swept_world(known, stepper.time, _HORIZONS[-1]))
    clear = []
    for spread in np.linspace(0.1, 1.0, _REFUGES):
        q = stepper.q + spread * (robot.random_q(rng) - stepper.q)
        contact = passed.world.tightest(q)
        if contact is None or contact.margin > _ROOM:
            clear.append(q)
    if not clear:
        return
    for horizon in (*_SOON, *_HORIZONS[:-1]):
        world = context.in_world(_swept_world(known, stepper.time, horizon))
        transit = find_transit(world, stepper, clear)
        if transit.stepper is None:
            continue
        if _is_clear(context, known, transit.stepper.trajectory(), stepper.time):
            transit.stepper.rest(stepper.time + _HORIZONS[-1])
            yield transit.stepper


def _stands_clear(context: Context, known: list[Obstacle], stepper: Stepper, wait: float) -> bool:
    proximity = Proximity(context.problem.robot, known)
    return segment_is_clear(proximity, stepper.q, stepper.q, time=stepper.time, dt=wait, depth=12, spare=-_TOUCH)


def _delayed(motion: Trajectory, since: float, wait: float) -> Trajectory:
    """The same motion, standing for `wait` [s] at the time `since`, at which it stands."""
    split = int(np.searchsorted(motion.time, since - 1e-9))
    time = np.concatenate((motion.time[: split + 1], motion.time[split:] + wait))
    return Trajectory.from_steps(time, np.vstack((motion.q[: split + 1], motion.q[split:])))


# --- what appears -------------------------------------------------------------------


def _react(context: Context, asked: Planned, motion: Trajectory, moment: float) -> tuple[Outcome, dict[str, Any]]:
    """A motion that is `motion` up to `moment` and goes on otherwise; and what was done."""
    known = _known(context, moment)
    # it is seen at the next sample, where the motion may change without a shorter step
    moment = float(motion.time[np.searchsorted(motion.time, moment - 1e-9)])
    inside = _inside(context, motion.at(moment), moment)
    if inside is not None:
        halted = _halted(context, motion, moment)
        return Outcome(halted, "blocked", inside), {"stopped_at": halted.duration}
    knowing = context.knowing(known)
    moving = knowing.stepper(motion.q[0])
    moving.replay(motion, moment)
    swerved = asked.swerve(knowing, moving.branch(attempt=1))
    if swerved is not None and not _is_clear(context, known, swerved.trajectory, moment):
        swerved = None
    again, what = _stop_and_plan(context, asked, motion, moment)
    if swerved is not None and (again.reason or _longer(context, swerved) <= _longer(context, again)):
        return swerved, {"way": "swerved"}
    return again, what


def _longer(context: Context, outcome: Outcome) -> float:
    """How long a motion takes once torque, flow and power are looked at too [s]."""
    return retimed(outcome.trajectory, context.problem.limits, drive=drive_of(context.problem)).duration


def _stop_and_plan(
    context: Context, asked: Planned, motion: Trajectory, moment: float
) -> tuple[Outcome, dict[str, Any]]:
    """The motion up to `moment`, to rest, and on from there; and what was done."""
    known = _known(context, moment)
    stopped = _brake(context, known, motion, moment)
    if stopped is None:
        knowing = context.knowing(known)
        stopped = knowing.stepper(motion.q[0])
        stopped.replay(motion, moment)
        if not stopped.give_way(moment):
            halted = _halted(context, motion, moment)
            return Outcome(halted, "blocked", "it comes too near all the same"), {"stopped_at": halted.duration}
    outcome = _among_known(context, asked, stopped)
    if outcome.reason and outcome.trajectory.duration < stopped.time:
        outcome = replace(outcome, trajectory=stopped.trajectory())
    return outcome, {"way": "stopped and planned anew", "stopped_at": stopped.time}


def _inside(context: Context, q: Vector, moment: float) -> str | None:
    """What the machine is too near to at this moment already, in words."""
    contact = Proximity(context.problem.robot, _known(context, moment)).tightest(q, time=moment)
    if contact is None or contact.margin >= 0.0:
        return None
    return f"{contact.describe()} from the first moment on"


def _halted(context: Context, motion: Trajectory, moment: float) -> Trajectory:
    """The motion up to `moment`, and to rest along its own way, be it clear or not."""
    braked = _braked(context, motion, moment)
    return motion if braked is None else braked


def _brake(context: Context, known: list[Obstacle], motion: Trajectory, moment: float) -> Stepper | None:
    """To rest along the motion's own way, as hard as the accelerations allow; None where that is not clear."""
    braked = _braked(context, motion, moment)
    if braked is None or not _is_clear(context, known, braked, moment):
        return None
    stepper = context.stepper(motion.q[0])
    stepper.replay(braked, braked.duration)
    stepper.v = np.zeros_like(stepper.q)
    return stepper


def _braked(context: Context, motion: Trajectory, moment: float) -> Trajectory | None:
    """The motion with its own clock running slower and slower from `moment` on, until it stands."""
    limits = context.problem.limits
    begun = moment
    rate = 1.0 / SAMPLE_PERIOD
    while rate > _SLOWEST_BRAKING:
        # the motion's own clock runs slower and slower, and stops after 1 / rate
        count = max(int(np.ceil(1.0 / (rate * SAMPLE_PERIOD))), 1)
        run = np.linspace(0.0, 1.0 / rate, count + 1)[1:]
        own = begun + run - 0.5 * rate * run**2
        before = motion.time < begun - 1e-9
        time = np.concatenate((motion.time[before], [begun], begun + run))
        braked = Trajectory.from_steps(time, np.vstack((motion.q[before], motion.at(np.append(begun, own)))))
        if float(np.max(np.abs(braked.accelerations()) / limits.acceleration)) <= 1.0 + 1e-7:
            return braked
        rate *= 0.8
    return None


# --- shared -------------------------------------------------------------------------


def _known(context: Context, moment: float) -> list[Obstacle]:
    return [obstacle for obstacle in context.problem.obstacles if obstacle.appears_at <= moment]


def _standing(obstacle: Obstacle) -> Obstacle:
    """The same, taken to have been there from the beginning."""
    return replace(obstacle, appears_at=0.0)


def _is_clear(context: Context, known: list[Obstacle], motion: Trajectory, since: float) -> bool:
    """Whether a motion provably keeps clear of the obstacles that are known, from `since` [s] on."""
    proximity = Proximity(context.problem.robot, known)
    time = np.append(since, motion.time[motion.time > since + 1e-9])
    q = motion.at(time)
    return all(
        segment_is_clear(proximity, q[k], q[k + 1], time=float(time[k]), dt=float(time[k + 1] - time[k]), depth=9,
                         spare=-_TOUCH)
        for k, _ in enumerate(pairwise(time))
    )  # fmt: skip
