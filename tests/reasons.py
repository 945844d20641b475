"""Parts of a plan that must exist, or the test fails: its obstruction, the nearest pose, the comparison."""

from __future__ import annotations

from backhoe_planner.planning import LawComparison, NearestPose, Plan
from backhoe_planner.site import Obstruction


def obstruction(plan: Plan) -> Obstruction:
    """The plan's obstruction."""
    found = plan.findings.obstruction
    assert found is not None
    return found


def span(found: Obstruction) -> tuple[float, float]:
    """The obstructed part of the path [m]."""
    assert found.path_from is not None
    assert found.path_to is not None
    return found.path_from, found.path_to


def nearest(plan: Plan) -> NearestPose:
    """The nearest pose that can be reached."""
    found = plan.findings.nearest
    assert found is not None
    return found


def comparison(plan: Plan) -> LawComparison:
    """The objective along the path compared with the local law's."""
    found = plan.metrics.objective
    assert found is not None
    return found


def law_cost(found: LawComparison) -> float:
    """The cost of the local law."""
    assert found.law is not None
    return found.law
