"""How far the tip is turned from what a task requires."""

from __future__ import annotations

from backhoe_planner.planning.result.plan import Plan


def angle_error(plan: Plan) -> float | None:
    """The greatest angle between the tip and the required pitch or orientation [rad]; None if none is required."""
    tracking = plan.certificate.tracking
    number = tracking.goal
    asked = [plan.problem.goals[number - 1].target] if number else [pose.target for pose in plan.scene.waypoints()]
    if not any(target.pitch is not None or target.rotation is not None for target in asked):
        return None
    return tracking.max_angle_error
