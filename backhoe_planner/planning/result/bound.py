"""The bound beside a plan to a goal: what no motion from its start could fall short of."""

from __future__ import annotations

from backhoe_planner.files.records import Figure, Record
from backhoe_planner.motion import Problem, Trajectory
from backhoe_planner.proof import Certificate, least_duration


class Bound(Record):
    """What no motion from the start of a plan to any of its goals can fall short of.

    It follows from the machine, its limits in the scene and the goals alone. Obstacles, torques and
    engine power are left out, so that the fastest motion there is may well take longer.
    """

    duration: Figure
    """No motion takes less [s]."""
    longer_percent: Figure
    """What the plan's motion takes longer than that [%]."""
    settled: bool
    """Whether the bound is as near as it is sought: to 1 % of the time to the posture in which the plan ends."""


def measure_bound(problem: Problem, trajectory: Trajectory, certificate: Certificate, *, boxes: int) -> Bound | None:
    """The bound of the motions from where a plan begins; None along a path, and where the plan is not verified.

    Parameters
    ----------
    trajectory, certificate: the plan's motion, and what is proven of it.
    boxes: how many boxes of configurations may be looked at.
    """
    if not problem.goals or not certificate.verified:
        return None
    q, duration = trajectory.q, trajectory.duration
    found = least_duration(problem, q[0], known=duration, end=q[-1], boxes=boxes)
    longer = 100.0 * (duration / found.duration - 1.0) if found.duration > 0.0 else 0.0
    return Bound(duration=found.duration, longer_percent=longer, settled=found.settled)
