"""What a planner hands back, and the words for what went wrong."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backhoe_planner.machine import TipTarget
from backhoe_planner.motion import Trajectory
from backhoe_planner.planning.result.plan import Reason
from backhoe_planner.planning.search.postures import Found
from backhoe_planner.planning.world import World
from backhoe_planner.site import Obstruction

__all__ = ["Outcome", "at_rest", "bad_start", "no_posture", "obstruction_details", "point"]

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outcome:
    """A motion, and why it is not what was asked, if it is not.

    Attributes
    ----------
    trajectory: where planning failed, the best that was found.
    reason, message: empty where nothing is known to be wrong.
    details: numbers behind them.
    """

    trajectory: Trajectory
    reason: Reason = ""
    message: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)


def at_rest(q: Vector) -> Trajectory:
    """A motion that stays at `q` (n,)."""
    return Trajectory.from_steps(np.zeros(1), np.array([q]))


def obstruction_details(found: Obstruction) -> dict[str, Any]:
    """An obstruction in numbers."""
    return {"link": found.link, "obstacle": found.obstacle, "distance": found.distance, "depth": -found.distance}


def point(position: Vector) -> str:
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
        return Outcome(at_rest(start), "outside_limits", words, {"joints": [names[j] for j in outside]})
    contact = world.proximity.tightest(start)
    if contact is not None and contact.margin < 0.0:
        message = f"at the start {contact.describe()}"
        return Outcome(at_rest(start), "start_in_collision", message, obstruction_details(contact))
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
            f"the {what} ({point(target.position)}) is out of reach: "
            f"the nearest pose is {asked} away, at ({point(tip)})"
        )
        limits, names = world.problem.limits, world.problem.robot.joint_names
        at_limit = [
            name for name, q, low, high in zip(names, best.q, limits.lower, limits.upper, strict=True)
            if min(q - low, high - q) < 1e-6
        ]  # fmt: skip
        if at_limit:
            message += f", with {' and '.join(at_limit)} at the limit"
        details = {
            "nearest_q": best.q,
            "nearest_position": tip,
            "position_error": best.position_error,
            "angle_error": best.angle_error,
            "joints_at_limit": at_limit,
        }
        return Outcome(here, "unreachable", message, details)
    contact = found.contact
    if contact is None:
        return Outcome(here, reason, f"no configuration for the {what} is free")
    return Outcome(here, reason, f"at the {what} {contact.describe()}", obstruction_details(contact))
