"""Postures in which a motion to a goal may end.

A goal whose position is out of reach or too near to an obstacle, but not all that is near enough, is replaced by the
same goal with an `aim`: a position that is near enough, and that the tip can reach. With a `tolerance`, the postures
there are moved towards the start as far as it allows, and the end of a motion may move anywhere within it. The
certificate judges by the goal as it was given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from backhoe_planner.arrays import Matrix, Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import (
    BatchKinematics,
    InverseKinematics,
    TargetBatch,
    TipTarget,
    solve_batch,
    solve_inverse_kinematics,
)
from backhoe_planner.motion import KEPT_TO, TO_THE_RIM, Goal, Keep, Problem
from backhoe_planner.planning.result.plan_file import Reason
from backhoe_planner.planning.search.moved_targets import move_aside, move_within_reach
from backhoe_planner.planning.search.postures import POSTURE_SPARE, PostureResult
from backhoe_planner.planning.world.contradictions import find_contradiction
from backhoe_planner.planning.world.free_place import find_free_place
from backhoe_planner.planning.world.holding import holds_load
from backhoe_planner.planning.world.outcome import Outcome, bad_posture, no_posture, rest_at_start
from backhoe_planner.planning.world.world import World
from backhoe_planner.site import ClearanceScreen

_LONG_SEARCH = 8  # times the usual starting points, before a goal is reported to be in collision; chosen
_MOVED = 0.9  # part of a goal's tolerance by which its aim is moved at most; chosen: no rounding exceeds the rest
_PLACES = 25  # on the way to a posture, where it is checked whether the tip is within the tolerance; chosen
_BEGINS = 8  # random postures from which that is searched too, for each of these cones; chosen, 0.1 s in all
_NEARER = 16  # cones between the nearest posture and what is kept, as for a path; chosen
_ANGLES_FIRST = 30.0  # m per rad in the search for the nearest pose: chosen, its angles are then off by mrad at most
_HERE = "\0"  # in a sentence, where a goal is named
# if several goals fail, the mildest reason is reported; the mildest first
_MILDEST: tuple[Reason, ...] = ("goal_breaks_keep", "goal_in_collision", "outside_limits", "unreachable")


@dataclass(frozen=True, eq=False)
class GoalPostures:
    """Clear postures on the goals of a problem, at least one; the quickest to reach first.

    Attributes
    ----------
    clear: (n,) each [rad or m].
    goals: the goal of each posture; with an aim, if its position cannot be had.
    left_out: why other goals have no such posture, one sentence for each.
    """

    clear: tuple[Vector, ...]
    goals: tuple[Goal, ...]
    left_out: tuple[str, ...] = ()

    def by_goal(self) -> list[tuple[Goal, tuple[Vector, ...]]]:
        """Every goal that has a posture, with its postures; the quickest goal to reach first."""
        return [
            (goal, tuple(q for q, own in zip(self.clear, self.goals, strict=True) if own is goal))
            for goal in dict.fromkeys(self.goals)
        ]


def find_goal_postures(
    world: World, goals: Sequence[Goal], *, near: Vector, time: float, more: int = 1, travel: Vector | None = None
) -> GoalPostures | Outcome:
    """Clear postures on any of `goals`; or why there is none.

    Parameters
    ----------
    near: (n,) the present joint positions [rad or m].
    time: at which the positions of the obstacles are taken [s].
    more: times the usual starting points of the inverse kinematics. Every call draws other ones.
    travel: (n,) how far starting points may be from `near` [rad or m]; None for anywhere. With it, no longer search
        is made if all postures found collide.
    """
    found: list[tuple[Vector, Goal]] = []
    failures: list[Outcome] = []
    for goal in goals:
        on = _postures_on(world, goal, near, time, more, travel)
        if isinstance(on, Outcome):
            failures.append(on)
        else:
            found += [(q, on.goal) for q in on.clear]
    if not found:
        order = [_MILDEST.index(failure.reason) for failure in failures]
        first = order.index(min(order))
        mildest, words = failures[first], [failure.message for failure in failures]
        if mildest.reason == "goal_in_collision" and travel is None and goals[first].q is None:
            free = find_free_place(world, goals[first].target, near, time=time)
            words[first] += "" if free is None else f"; {free}"
        return Outcome(mildest.trajectory, mildest.reason, _in_short(words, goals), mildest.findings)
    found, unheld = _held(world.problem, found)
    failed = [failure.message for failure in failures] + unheld
    rate = world.problem.limits.velocity
    found.sort(key=lambda one: float(np.max(np.abs(one[0] - near) / rate)))
    return GoalPostures(tuple(q for q, _ in found), tuple(goal for _, goal in found), tuple(failed))


def _held(problem: Problem, found: list[tuple[Vector, Goal]]) -> tuple[list[tuple[Vector, Goal]], list[str]]:
    """Of postures on goals those in which the machine holds its load; all of them if it holds it in none.

    With them, for each goal that is left out by this, why, in words.
    """
    held = holds_load(problem, np.array([q for q, _ in found]))
    if held.all() or not held.any():
        return found, []
    kept = [one for one, holds in zip(found, held, strict=True) if holds]
    there = [goal for _, goal in kept]
    missing = dict.fromkeys(goal.name for _, goal in found if not any(goal is other for other in there))
    return kept, [f"no posture was found on the {name} in which the machine can hold its load" for name in missing]


def _in_short(words: Sequence[str], goals: Sequence[Goal]) -> str:
    """A sentence for each goal, in one; what holds alike of several goals is said once."""
    names: dict[str, list[str]] = {}
    for sentence, goal in zip(words, goals, strict=True):
        names.setdefault(sentence.replace(f"the {goal.name} ", _HERE, 1), []).append(goal.name)
    found = []
    for sentence, alike in names.items():
        which = f"the {alike[0]} " if len(alike) == 1 else f"the {', '.join(alike[:-1])} and {alike[-1]} "
        every = len(alike) == len(goals) > 1
        found.append(sentence.replace(_HERE, f"each of the {len(goals)} goals " if every else which, 1))
    return "; ".join(found)


def aimed(world: World, goals: Sequence[Goal]) -> list[Goal]:
    """The `goals`, each at one position: with an aim if the required one cannot be had."""
    exact = [goal.exactly for goal in goals]
    return [world.aims.get((goal, True)) or world.aims.get((goal, False)) or goal for goal in exact]


@dataclass(frozen=True, eq=False)
class _OnGoal:
    """Clear postures (n,) on one goal [rad or m], which has an aim if its position cannot be had."""

    goal: Goal
    clear: tuple[Vector, ...]


def _postures_on(
    world: World, goal: Goal, near: Vector, time: float, more: int, travel: Vector | None
) -> _OnGoal | Outcome:
    if goal.q is not None:
        return bad_posture(world, goal.q, goal.name, time=time) or _OnGoal(goal, (goal.q,))
    keep, target = world.problem.keep, goal.search_target
    if keep is None:
        return _on_target(world, target, goal, near, time, more, travel)
    narrowed = keep.narrowed(target)
    within = None
    if narrowed is not None:
        within = _on_target(world, narrowed, goal, near, time, more, travel, is_narrowed=True)
    kept = tuple(q for q in within.clear if keep.holds(q)) if isinstance(within, _OnGoal) else ()
    if kept:
        assert isinstance(within, _OnGoal)
        return _OnGoal(within.goal, kept)
    at_rim = _at_the_rim(world, keep, goal, near, time, more, travel)
    if at_rim is not None:
        return at_rim
    # find out whether the goal itself fails, or `keep` at the goal
    free = _on_target(world, target, goal, near, time, more, travel)
    if isinstance(free, Outcome):
        return free
    kept = tuple(q for q in free.clear if keep.holds(q))
    if kept:
        return _OnGoal(free.goal, kept)
    if isinstance(within, Outcome) and within.reason == "goal_in_collision":
        return within
    nearest = _nearest_to_kept(
        world, keep, replace(target, position=free.goal.search_target.position), free.clear, time
    )
    if keep.holds(nearest):
        return _OnGoal(free.goal, (nearest,))
    contradiction = find_contradiction(keep, world.problem.limits, [near])
    if contradiction:
        return Outcome(rest_at_start(world, nearest), "goal_breaks_keep", contradiction)
    message = _out_of_tolerance(keep, goal) or f"at the {goal.name} {keep.broken(nearest)}"
    if narrowed is not None:  # the goal's own angles leave room for the kept condition
        message = f"no posture was found on the {goal.name} that keeps it: at best {keep.broken(nearest)}"
    return Outcome(rest_at_start(world, nearest), "goal_breaks_keep", message)


def _at_the_rim(
    world: World, keep: Keep, goal: Goal, near: Vector, time: float, more: int, travel: Vector | None
) -> _OnGoal | None:
    """Postures between the part of a cone, or of the tolerance of a goal's angles, that a search uses, and its rim.

    Where a part of the tolerance of the goal does not do, the goal is one of these postures, so that its end is held.
    """
    if not keep.cones:
        return None
    usual, touching = goal.search_target, _where_they_touch(keep, goal)
    for target in (usual, _to_the_rim(goal), *([] if touching is None else [touching])):
        whole = keep.narrowed(target, to_the_rim=True)
        found = None if whole is None else _on_target(world, whole, goal, near, time, more, travel, is_narrowed=True)
        kept = tuple(q for q in found.clear if keep.holds(q)) if isinstance(found, _OnGoal) else ()
        if kept and isinstance(found, _OnGoal):
            if target is usual:
                return _OnGoal(found.goal, kept)
            return _OnGoal(replace(goal, q=kept[0], tolerance=None, rotation_tolerance=None), kept[:1])
        if goal.rotation_tolerance is None:
            break
    return None


def _to_the_rim(goal: Goal) -> TipTarget:
    """The target of a search with all of the tolerance of the goal's angles, but for rounding."""
    target = goal.search_target
    if goal.q is not None or goal.rotation_tolerance is None:
        return target
    turned = TO_THE_RIM * goal.rotation_tolerance
    tilt = None if target.tilt is None else replace(target.tilt, tolerance=turned)
    return replace(target, rotation_tolerance=turned, tilt=tilt)


def _where_they_touch(keep: Keep, goal: Goal) -> TipTarget | None:
    """The target with the only orientation that is within the tolerance of the goal's angles and within a cone.

    It is on the shortest turn from the orientation of the goal into the cone. The certificate accepts `KEPT_TO` beyond
    the cone, and nothing beyond the tolerance: half of that is used, so that the orientation is within both by more
    than inverse kinematics is off. None if they have nothing in common, if they have more, and for several cones.
    """
    rotation, own = goal.target.rotation, goal.rotation_tolerance
    if goal.q is not None or rotation is None or own is None or len(keep.cones) != 1:
        return None
    (cone,) = keep.cones
    turn = cone.turns(rotation[None])[0]
    angle = float(np.linalg.norm(turn))
    room = own + cone.usable + 0.5 * KEPT_TO - angle
    if not 0.0 <= room <= (1.0 - TO_THE_RIM) * (own + cone.usable) + KEPT_TO:
        return None
    touching = pin.exp3(turn * ((own - 0.5 * room) / angle)) @ rotation
    return replace(goal.search_target, rotation=touching, rotation_tolerance=0.0, tilt=None)


def _out_of_tolerance(keep: Keep, goal: Goal) -> str:
    """Why the tolerance of a goal's angles leaves no room for the cones, in words; empty if it may."""
    rotation, own = goal.target.rotation, goal.rotation_tolerance
    if rotation is None or own is None:
        return ""
    for cone in keep.cones:
        angle = float(cone.angles(rotation[None])[0])
        if angle - own > cone.usable + KEPT_TO:
            degrees = np.degrees([angle - own, cone.usable]).tolist()
            least, most = beside_bounds(*degrees, places=".2f", bounds_as=".4g")
            tolerance = f"rotation_tolerance of {np.degrees(own):.4g} deg"
            return (
                f"at the {goal.name} {cone.describe(angle)}; its {tolerance} leaves {least} deg, more than {most} deg"
            )
    if _where_they_touch(keep, goal) is not None:
        name = keep.cones[0].name
        return f"the {goal.name} has one orientation that keeps `{name}`, and no clear posture was found in it"
    return ""


def _nearest_to_kept(world: World, keep: Keep, target: TipTarget, clear: Sequence[Vector], time: float) -> Vector:
    """(n,) the clear posture on a target that comes nearest to what is kept: one of `clear`, or one searched.

    The search, from that one and from random ones, asks for cones that are wider than the kept ones, by less and less.
    """
    nearest = max(clear, key=lambda q: float(np.min(keep.margins(q))))
    wider, missed = keep.widened(nearest), -float(np.min(keep.margins(nearest)))
    narrower = [wider.with_narrower_cone(part * missed) for part in np.linspace(0.0, 1.0, _NEARER).tolist()]
    targets = [one.narrowed(target) for one in narrower if one is not None]
    asked = [one for one in targets if one is not None]
    if not asked:
        return nearest
    found, reached = solve_batch(
        BatchKinematics(world.problem.robot), TargetBatch.of(asked), np.tile(nearest, (len(asked), 1))
    )
    found = np.concatenate((found[reached], *(world.postures.anywhere(one, count=_BEGINS) for one in asked)))
    kept = found[ClearanceScreen(world.proximity, time=time, spare=POSTURE_SPARE).keeps(found)]
    return max((nearest, *kept), key=lambda q: float(np.min(keep.margins(q))))


def _on_target(
    world: World, target: TipTarget, goal: Goal, near: Vector, time: float, more: int, travel: Vector | None, *,
    is_narrowed: bool = False,
) -> _OnGoal | Outcome:  # fmt: skip
    count = more * world.work.effort.starting_points
    look = partial(world.postures.at, near=near, count=count, time=time, hurried=world.work.effort.is_hurried)
    if target.position_tolerance:
        exact = replace(target, position_tolerance=0.0)
        there = _on_target(world, exact, goal.exactly, near, time, more, travel, is_narrowed=is_narrowed)
        if isinstance(there, _OnGoal):
            return _OnGoal(goal, _sooner(world, target, there.clear, near, time))
        anywhere = look(target, travel=travel).clear
        return _OnGoal(goal, anywhere) if anywhere else there

    def at(target: TipTarget) -> PostureResult:
        found = look(target, travel=travel)
        if found.best.reached and not found.clear and travel is None:
            found = world.postures.at(target, near=near, count=_LONG_SEARCH * count, time=time)
        return found

    own = world.aims.get((goal, is_narrowed))
    aim = target if own is None or own.aim is None else replace(target, position=own.aim)
    found = at(aim)
    moved = _within_reach(world, aim, goal, found.best) if own is None and not found.best.reached else None
    if moved is not None:
        aim, found = moved, at(moved)
    # a moving obstacle may be gone when the tip arrives
    if found.best.reached and not found.clear and travel is None and not world.problem.is_dynamic:
        aside = _aside(world, aim, goal, found, time)
        if aside is not None:
            moved = aim = aside[0]
            found = at(aim)
            found = found if found.clear else replace(found, clear=tuple(aside[1]))
    if moved is not None:
        own = world.aims[goal, is_narrowed] = replace(goal, aim=moved.position)
    return no_posture(world, found, aim, "goal_in_collision", goal.name) or _OnGoal(own or goal, found.clear)


def _sooner(world: World, target: TipTarget, clear: Sequence[Vector], near: Vector, time: float) -> tuple[Vector, ...]:
    """The `clear` postures, each moved towards `near` (n,) to where the tip gets within the tolerance of the target.

    A posture stays as it is if it would not be clear there, or would not keep what is to be kept.
    """
    kinematics, ends, keep = BatchKinematics(world.problem.robot), np.array(clear), world.problem.keep
    part = np.linspace(1.0, 0.0, _PLACES)
    lines = ends + (1.0 - part[:, None, None]) * (near - ends)  # (P, C, n)
    tips = kinematics.at(lines.reshape(-1, ends.shape[1])).tip_position.reshape(*lines.shape[:2], 3)
    within = np.linalg.norm(tips - target.position, axis=2) <= target.position_tolerance
    last = np.maximum(np.cumprod(within, axis=0).sum(axis=0) - 1, 0)
    guesses = lines[last, np.arange(len(ends))]
    moved, reached = solve_batch(kinematics, TargetBatch.of([target] * len(ends)), guesses)
    keeps = ClearanceScreen(world.proximity, time=time, spare=POSTURE_SPARE).keeps(moved) & reached
    return tuple(
        new if kept and (keep is None or keep.holds(new)) else old
        for new, old, kept in zip(moved, ends, keeps, strict=True)
    )


def _within_reach(world: World, target: TipTarget, goal: Goal, best: InverseKinematics) -> TipTarget | None:
    """`target` moved to where the tip can be; None if it would be moved further than the tolerance allows.

    Parameters
    ----------
    target: of the goal, out of reach.
    best: the nearest pose.
    """
    robot, most = world.problem.robot, _MOVED * goal.allowed_off
    if best.position_error > most:  # with the required angles, it would be further away
        return None
    q = solve_inverse_kinematics(robot, target, start=best.q, angle_weight=_ANGLES_FIRST).q
    moved = move_within_reach(robot, target, q, most=most, angle_weight=_ANGLES_FIRST)
    return None if moved is None else moved[0]


def _aside(
    world: World, aim: TipTarget, goal: Goal, found: PostureResult, time: float
) -> tuple[TipTarget, Matrix] | None:
    """`aim` moved away from what all postures found there are too near to, and (C, n) clear postures on it [rad or m].

    None if the tolerance does not allow it.
    """
    screen = ClearanceScreen(world.proximity, time=time, spare=POSTURE_SPARE)
    return move_aside(
        world.proximity, screen, aim, found.blocked, given=goal.target.position, most=_MOVED * goal.allowed_off,
        spare=POSTURE_SPARE, time=time,
    )  # fmt: skip
