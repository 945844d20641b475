"""What is shown of a plan that is the recording of a motion driven by hand.

Such a plan has a task only because a scene file must: there was no goal, so none is shown,
and how near the tip came to it says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from backhoe_planner.motion import Problem, build_problem
from backhoe_planner.planning import Plan

__all__ = ["is_driven", "left_out", "shown_problem"]


def is_driven(plan: Plan) -> bool:
    """Whether a plan is a recording."""
    return plan.method == "teleop"


def left_out(plan: Plan) -> tuple[str, ...]:
    """What happened on the site that a recording cannot say, in words; nothing of other plans."""
    recorded = plan.details.get("recorded") if is_driven(plan) and isinstance(plan.details, Mapping) else None
    notes = recorded.get("notes") if isinstance(recorded, Mapping) else None
    return tuple(str(note) for note in notes) if isinstance(notes, (list, tuple)) else ()


def shown_problem(plan: Plan) -> Problem:
    """The problem of a plan as it is shown: that of a recording has no goal."""
    problem = build_problem(plan.robot, plan.scene)
    return replace(problem, goal=None, path=None) if is_driven(plan) else problem
