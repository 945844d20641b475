"""What a planner hands back, and the words for what went wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from backhoe_planner.arrays import Vector
from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import TipPath, Trajectory
from backhoe_planner.planning.result.findings import NOTHING, Findings, NearestPose
from backhoe_planner.planning.result.plan_file import Reason
from backhoe_planner.planning.search.postures import Found
from backhoe_planner.planning.world import World
from backhoe_planner.site import Obstruction


@dataclass(frozen=True, eq=False)
class Outcome:
    """A motion, and why it is not what was asked, if it is not.

    Attributes
    ----------
    trajectory: where planning failed, the best that was found.
    reason: empty where nothing is known to be wrong.
    message: the same in words; beside an empty reason, that time ran out while the motion was made better.
    findings: the numbers behind them, and how the motion was found.
    """

    trajectory: Trajectory
    reason: Reason = ""
    message: str = ""
    findings: Findings = NOTHING

    def adding(self, **findings: Any) -> Outcome:
        """The same with more findings, by their names."""
        return replace(self, findings=self.findings.model_copy(update=findings))


def at_rest(q: Vector) -> Trajectory:
    """A motion that stays at `q` (n,)."""
    return Trajectory.from_steps(np.zeros(1), np.array([q]))


def blocked_path(motion: Trajectory, found: Obstruction, path: TipPath, why: str) -> Outcome:
    """A path that cannot be followed to its end.

    Parameters
    ----------
    motion: up to where it is blocked.
    found: what is in the way, from where to where.
    why: it is not bypassed, in words.
    """
    where = f"from {found.path_from:.2f} m to {found.path_to:.2f} m of {path.length:.2f} m"
    return Outcome(motion, "blocked", f"the path is blocked {where} by {found}{why}", Findings(obstruction=found))


def _point(position: Vector) -> str:
    """A position in words."""
    return ", ".join(f"{value:.2f}" for value in position)


def bad_start(world: World, start: Vector) -> Outcome | None:
    """Why nothing can begin at `start` (n,), None where it can."""
    limits, names = world.problem.limits, world.problem.robot.joint_names
    outside = np.flatnonzero((start < limits.lower) | (start > limits.upper))
    if len(outside):
        words = "; ".join(
            f"{names[j]} starts at {start[j]:.4g}, "
            f"allowed {limits.lower[j]:.4g} to {limits.upper[j]:.4g} (radians or metres)"
            for j in outside
        )
        return Outcome(at_rest(start), "outside_limits", words, Findings(joints=tuple(names[j] for j in outside)))
    contact = world.proximity.tightest(start)
    if contact is not None and contact.margin < 0.0:
        message = f"at the start {contact.describe()}"
        return Outcome(at_rest(start), "start_in_collision", message, Findings(obstruction=contact))
    return None


def no_posture(world: World, found: Found, target: TipTarget, reason: Reason, what: str) -> Outcome | None:
    """Why there is no configuration for a target, None where there is one.

    Parameters
    ----------
    reason: where it can be reached, but not without a collision.
    what: it is, in words.
    """
    if found.clear:
        return None
    best = found.best
    here = at_rest(world.problem.start_q if world.problem.start_q is not None else best.q)
    if not found.reachable:
        tip = world.kinematics.at(best.q).tip_position
        asked = " and ".join(
            part
            for part in (
                f"{best.position_error:.3f} m" if best.position_error > 1e-6 else "",
                f"{np.degrees(best.angle_error):.1f} deg" if best.angle_error > 1e-6 else "",
            )
            if part
        )
        message = (
            f"the {what} ({_point(target.position)}) is out of reach: "
            f"the nearest pose is {asked} away, at ({_point(tip)})"
        )
        limits, names = world.problem.limits, world.problem.robot.joint_names
        at_limit = tuple(
            name for name, q, low, high in zip(names, best.q, limits.lower, limits.upper, strict=True)
            if min(q - low, high - q) < 1e-6
        )  # fmt: skip
        if at_limit:
            message += f", with {' and '.join(at_limit)} at the limit"
        nearest = NearestPose(
            q=tuple(best.q), position=tuple(tip), position_error=best.position_error, angle_error=best.angle_error
        )
        return Outcome(here, "unreachable", message, Findings(nearest=nearest, joints=at_limit))
    contact = found.contact
    if contact is None:
        return Outcome(here, reason, f"no configuration for the {what} is free")
    return Outcome(here, reason, f"at the {what} {contact.describe()}", Findings(obstruction=contact))
