"""Quick plans of the scenes of the package."""

from __future__ import annotations

import backhoe_planner as bp
from backhoe_planner.machine import Robot, shipped_folder


def planned(robot: Robot, name: str) -> bp.Plan:
    """A verified plan of the scene with this name."""
    found = bp.plan(robot, bp.load_scene(shipped_folder("scenes") / f"{name}.yaml"), effort="quick")
    assert found.verified, found.message
    return found
