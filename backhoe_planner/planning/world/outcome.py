"""The result of a planner, and the messages for what went wrong."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.digits import beside_bounds
from backhoe_planner.machine import InverseKinematics, TipTarget, wrap_angle
from backhoe_planner.motion import Problem, TipPath, Trajectory, angles_in_degrees
from backhoe_planner.planning.result.findings import NOTHING, Findings, NearestPose
from backhoe_planner.planning.result.plan_file import Reason
from backhoe_planner.planning.search.postures import POSTURE_SPARE, PostureResult
from backhoe_planner.planning.stretches.stretch import LawWay
from backhoe_planner.planning.world.clear_joint import find_clear_joint
from backhoe_planner.planning.world.holding import largest_payload, unheld_load
from backhoe_planner.planning.world.world import World
from backhoe_planner.proof import describe_use
from backhoe_planner.site import Obstruction, range_sources

_NEAR = 0.01  # m: a smaller distance is printed in millimetres
_TURN, _GAP = 2.0 * np.pi, 0.25  # rad: one turn, and the gap between found pitches that counts as out of reach; chosen
_STARTS_BETWEEN, _HALVINGS = 10, 4  # of a pitch in such a gap, and how often a gap is halved; chosen
_STARTS_ALONE = 60  # starting points of the inverse kinematics of a position without its orientation; chosen, 40 ms
_DEEP = 20.0  # m inside an obstacle, beyond which it was probably given in other units; chosen
_MILLIMETRES = 100.0  # m out of reach, beyond which a position was probably given in other units; chosen
_SMALL = 1e-6  # m and rad: chosen, far below what a message shows


@dataclass(frozen=True, eq=False)
class Outcome:
    """A motion, and why it does not do the task, if it does not.

    Attributes
    ----------
    trajectory: the motion; if planning failed, the best one found.
    reason: why the task is not done; empty if nothing is known to be wrong.
    message: the same in words; with an empty reason, that time ran out while the motion was being improved.
    findings: the numbers behind reason and message, and how the motion was found.
    law: how the local law follows the path from a configuration in which the motion may begin; None if not computed.
    evades: whether moving obstacles meet the motion that would be best without them, so that this one evades them.
    """

    trajectory: Trajectory
    reason: Reason = ""
    message: str = ""
    findings: Findings = NOTHING
    law: LawWay | None = None
    evades: bool = False

    def adding(self, **findings: Any) -> Outcome:
        """The same outcome with more findings, by their names."""
        return replace(self, findings=self.findings.model_copy(update=findings))


def at_rest(q: Vector) -> Trajectory:
    """A motion that stays at `q` (n,)."""
    return Trajectory.from_steps(np.zeros(1), np.array([q]))


def blocked_path(motion: Trajectory, found: Obstruction, path: TipPath, why: str) -> Outcome:
    """A path that cannot be followed to its end.

    Parameters
    ----------
    motion: along the path up to where it is blocked.
    found: what is in the way, with the part of the path that it blocks.
    why: the end of the message, which says why the obstacle is not bypassed; may be empty.
    """
    assert found.path_from is not None
    assert found.path_to is not None
    begin, end = path.describe(found.path_from), path.describe(found.path_to)
    where = f"at {begin}" if begin == end else f"from {begin} to {end}"
    message = f"the path is blocked {where} of {path.describe_end()} by {found}{why}"
    return Outcome(motion, "blocked", message, Findings(obstruction=by_arc_length(found, path)))


def by_arc_length(found: Obstruction, path: TipPath) -> Obstruction:
    """An obstruction with its part of the path as true arc lengths [m]: turns of the bucket in place do not count."""
    ends = [None if s is None else path.arc(s) for s in (found.path_from, found.path_to)]
    return replace(found, path_from=ends[0], path_to=ends[1])


def bad_start(world: World, start: Vector) -> Outcome | None:
    """Why no motion can begin at `start` (n,); None if one can."""
    return bad_posture(world, start, "start")


def bad_posture(world: World, q: Vector, what: str, *, time: float = 0.0) -> Outcome | None:
    """Why no motion can begin or end at `q` (n,); None if one can.

    Parameters
    ----------
    what: ``start``, or the name of the goal.
    time: at which the positions of the obstacles are taken [s].
    """
    starts = what == "start"
    stays = at_rest(q) if starts else rest_at_start(world, q)
    limits, names = world.problem.limits, world.problem.robot.joint_names
    outside = np.flatnonzero((q < limits.lower) | (q > limits.upper))
    if len(outside):
        meant = angles_in_degrees(world.problem, q)
        words = "; ".join(
            f"{names[j]} {'starts at' if starts else f'at the {what} is'} {_outside(world, j, q[j])}"
            + (f" ({set_by})" if (set_by := _set_by(world, j, above=bool(q[j] > limits.upper[j]))) else "")
            + (f" ({q[j]:.4g} degrees are {meant[j]:.4g} rad)" if np.isfinite(meant[j]) else "")
            for j in outside.tolist()
        )
        return Outcome(stays, "outside_limits", words, Findings(joints=tuple(names[j] for j in outside)))
    contact = world.proximity.tightest(q, time=time)
    if contact is not None and contact.margin < 0.0:
        hint = _only_swung(world, contact, q, time)
        moved = "" if hint and _joints_of(world, contact.link) == {1} else _moved(world, q, time)
        if contact.kind == "obstacle" and contact.distance < -_DEEP:
            moved, hint = "", " (positions and sizes are in metres)"
        message = f"at the {what} {contact.describe()}{moved}{hint}"
        reason: Reason = "start_in_collision" if starts else "goal_in_collision"
        return Outcome(stays, reason, message, Findings(obstruction=contact))
    keep = world.problem.keep
    if keep is not None and not keep.holds(q):
        return Outcome(stays, "start_breaks_keep" if starts else "goal_breaks_keep", f"at the {what} {keep.broken(q)}")
    unheld = unheld_load(world.problem, q)
    if unheld is not None:
        message = f"{describe_use(unheld, f'at the {what}')}; {_held_there(world.problem, q)}"
        return Outcome(stays, "outside_limits", message, Findings(joints=(unheld.joint,)))
    return None


def _held_there(problem: Problem, q: Vector) -> str:
    """How much the machine can hold at rest at `q` (n,), where it cannot hold its payload, in words."""
    most = largest_payload(problem, q)
    if most is None:
        return "the machine cannot hold its own weight there"
    shown = beside_bounds(most, problem.scene.payload, places=".4g")[0]
    return f"the largest payload that it can hold there is {shown} kg"


def _outside(world: World, joint: int, position: float) -> str:
    """A position outside the limits of a joint, with the limits [rad or m]."""
    limits, unit = world.problem.limits, world.problem.robot.joint_units[joint]
    ends = (limits.lower[joint], limits.upper[joint])
    here, lower, upper = beside_bounds(position, *ends, places=".4g", bounds_as=".4g")
    return f"{here} {unit}, allowed {lower} to {upper} {unit}"


def _only_swung(world: World, contact: Obstruction, q: Vector, time: float) -> str:
    """A hint if links that only the first joint moves, such as a swing post, touch the same obstacle; else empty.

    Parameters
    ----------
    contact: the tightest at `q` (n,) and `time` [s]; other links may touch the obstacle less deeply.
    """
    robot, proximity = world.problem.robot, world.proximity
    if contact.kind != "obstacle" or robot.n < 2:
        return ""
    near = [pair.at(away) for pair, away in zip(proximity.pairs, proximity.distances(q, time=time), strict=True)]
    touching = [one.link for one in near if (one.kind, one.name) == (contact.kind, contact.name) and one.distance < 0.0]
    swung = [link for link in dict.fromkeys((contact.link, *touching)) if _joints_of(world, link) == {1}]
    if not swung:
        return ""
    links = ", ".join(dict.fromkeys(own.link for own in robot.pieces if own.joint > 1))
    too = "" if contact.link in swung else f", which {'touches' if len(swung) == 1 else 'touch'} it too"
    return (
        f"; {robot.joint_names[0]} alone moves {' and '.join(swung)}{too}: if that belongs there, say which links must "
        f"keep from {contact.obstacle}, with links: [{links}]"
    )


def _joints_of(world: World, link: str) -> set[int]:
    """The joints that move the pieces of a link, by number; 0 for what stands still."""
    return {own.joint for own in world.problem.robot.pieces if own.link == link}


def _moved(world: World, q: Vector, time: float) -> str:
    """A hint with the least move of one joint that takes `q` (n,) out of a collision; empty if there is none."""
    found = find_clear_joint(world, q, time=time)
    return "" if found is None else f"; {found}"


def no_posture(world: World, found: PostureResult, target: TipTarget, reason: Reason, what: str) -> Outcome | None:
    """Why there is no configuration for a target; None if there is one.

    Parameters
    ----------
    found: the result of the search for configurations on `target`.
    reason: for a target that can be reached, but not without a collision.
    what: the target in words, such as ``goal``.
    """
    if found.clear:
        return None
    if not found.best.reached:
        return out_of_reach(world, found.best, target, what)
    contact = found.contact
    message = f"no configuration for the {what} is free" if contact is None else f"at the {what} {contact.describe()}"
    if contact is not None and contact.margin >= 0.0:  # it counts as blocked nevertheless
        message += f", but the planner keeps {1e3 * POSTURE_SPARE:.0f} mm more at the end of a motion"
    return Outcome(rest_at_start(world, found.best.q), reason, message, Findings(obstruction=contact))


def out_of_reach(world: World, best: InverseKinematics, target: TipTarget, what: str) -> Outcome:
    """The outcome for a target that the tip cannot reach.

    Parameters
    ----------
    best: the nearest configuration.
    what: the target in words, such as ``goal``.
    """
    tip = world.kinematics.at(best.q).tip_position
    metres = f"{best.position_error:.3f} m" if best.position_error > _NEAR else f"{1e3 * best.position_error:.2f} mm"
    errors = ((best.position_error, metres), (best.angle_error, f"{np.degrees(best.angle_error):.1f} deg"))
    away = " and ".join(words for error, words in errors if error > _SMALL)
    wanted, nearest = (", ".join(f"{value:.2f}" for value in position) for position in (target.position, tip))
    message = f"the {what} ({wanted}) is out of reach: the nearest pose is {away} away, at ({nearest})"
    if best.position_error > _MILLIMETRES:
        message += " (positions are in metres)"
    limits, names = world.problem.limits, world.problem.robot.joint_names
    gaps = np.minimum(best.q - limits.lower, limits.upper - best.q)
    at_limit = tuple(name for name, gap in zip(names, gaps, strict=True) if gap < _SMALL)
    if at_limit:
        message += f", with {' and '.join(at_limit)} at the limit"
        middle = 0.5 * (limits.lower + limits.upper)
        set_by = {
            name: words
            for j, name in enumerate(names)
            if name in at_limit and (words := _set_by(world, j, above=bool(best.q[j] > middle[j])))
        }
        if set_by:
            message += f" ({', '.join(f'{name} {words}' for name, words in set_by.items())})"
    held = world.problem.robot.hold
    if held:
        places = [f"{name} {'at' if index else 'is held at'} {held[name]:g}" for index, name in enumerate(held)]
        message += f"; {' and '.join(places)}"
    if target.pitch is not None or target.rotation is not None or target.tilt is not None:
        message += _position_alone(world, target)
    pose = NearestPose(
        q=tuple(best.q), position=tuple(tip), position_error=best.position_error, angle_error=best.angle_error
    )
    return Outcome(rest_at_start(world, best.q), "unreachable", message, Findings(nearest=pose, joints=at_limit))


def _set_by(world: World, joint: int, *, above: bool) -> str:
    """What of the scene sets the lower or upper (`above`) end of a joint's range: ``within road``; empty if nothing."""
    source = range_sources(world.problem.robot, world.problem.scene, joint)[above]
    return f"within {source}" if source else ""


def _position_alone(world: World, target: TipTarget) -> str:
    """A hint if the position of a target can be reached, but not with its orientation; empty otherwise."""
    found = world.postures.anywhere(TipTarget(target.position), count=_STARTS_ALONE)
    if not len(found):
        return ""
    words = "; the position alone can be reached"
    if target.pitch is None:
        return words + ", with another orientation"
    spans = _spans(_pitches(world, target, [world.kinematics.at(q).pitch for q in found]))
    asked = target.pitch[0]
    if any(low <= wrap_angle(asked) <= high for low, high in spans):  # the reach has a gap that the samples do not show
        return words + ", with another pitch"
    return words + f", with a pitch of {' or '.join(_span(low, high) for low, high in spans)} rad"


def _pitches(world: World, target: TipTarget, found: Sequence[float]) -> list[float]:
    """The pitches that were `found` at the position of a target, and those between them that can be reached too."""
    known, tried = sorted(wrap_angle(np.array(found)).tolist()), set[float]()
    for _ in range(_HALVINGS):
        gaps = [(a, b) for a, b in itertools.pairwise(known) if b - a > _GAP and 0.5 * (a + b) not in tried]
        for a, b in gaps:
            middle = 0.5 * (a + b)
            tried.add(middle)
            asked = TipTarget(target.position, pitch=(middle, middle))
            if len(world.postures.anywhere(asked, count=_STARTS_BETWEEN)):
                known.append(middle)
        known.sort()
    return known


def _spans(angles: Sequence[float]) -> list[tuple[float, float]]:
    """The intervals (lowest, highest) in which angles are close together, within half a turn of 0."""
    found = np.sort(wrap_angle(np.array(angles)))
    ends = np.flatnonzero(np.diff(found, append=found[0] + _TURN) > _GAP)
    if not len(ends):
        return [(-np.pi, np.pi)]
    begins = (np.roll(ends, 1) + 1) % len(found)
    spans = [(float(found[a]), float(found[b])) for a, b in zip(begins, ends, strict=True)]
    parts = [[(low, high)] if low <= high else [(low, np.pi), (-np.pi, high)] for low, high in spans]
    return sorted(itertools.chain.from_iterable(parts))


def _span(low: float, high: float) -> str:
    return " to ".join(dict.fromkeys((f"{low:.2f}", f"{high:.2f}")))


def rest_at_start(world: World, q: Vector) -> Trajectory:
    """Rest at the scene's start; if the scene gives no joints for it, at `q` (n,)."""
    return at_rest(q if world.problem.start_q is None else world.problem.start_q)
