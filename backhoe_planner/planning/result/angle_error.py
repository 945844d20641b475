"""How far the tip is from what a task requires."""

from __future__ import annotations

from backhoe_planner.planning.result.plan import Plan


def angle_error(plan: Plan) -> float | None:
    """The greatest angle from the required pitch, orientation or tilt of the tip [rad]; None if none is required."""
    tracking = plan.certificate.tracking
    number = tracking.goal
    asked = [plan.problem.goals[number - 1].target] if number else [pose.target for pose in plan.scene.waypoints()]
    if all(target.pitch is None and target.rotation is None and target.tilt is None for target in asked):
        return None
    return tracking.max_angle_error


def goal_tolerance(plan: Plan) -> float | None:
    """How far from its position the reached goal lets the tip end [m]; None without a `tolerance`, and for a path."""
    number = plan.certificate.goal
    return plan.problem.goals[number - 1].tolerance if number else None


def has_tip_error(plan: Plan) -> bool:
    """Whether the tip's error says something: of a sequence that is not done it is the way to the next goal."""
    return plan.certificate.tracking.done or not plan.problem.legs
